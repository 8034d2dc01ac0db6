"""What the README and the pages of docs/ show works: links resolve, commands parse, snippets run."""

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
import typer
import yaml

from pipeline.commands.app import app
from pipeline.commands.options import StudyOptions
from pipeline.config.loading import parse
from tasks.bench.fabrication.kit_settings import FabricationSettings

ROOT = Path(__file__).parents[2]
PAGES = {
    path.name: path.read_text() for path in (ROOT / "README.md", ROOT / "CONTRIBUTING.md", *ROOT.glob("docs/*.md"))
}
FENCED = r"^```(\w*)\n(.*?)^```$"
BLOCKS = [(page, *found) for page, text in PAGES.items() for found in re.findall(FENCED, text, flags=re.M | re.S)]


def code_lines() -> list[tuple[str, str]]:
    """Return the lines of code of all pages, in blocks and in sentences, with continued ones joined."""
    lines = [(page, line) for page, _, text in BLOCKS for line in text.replace("\\\n", " ").splitlines()]
    for page, text in PAGES.items():
        inline = re.findall(r"`([^`]+)`", re.sub(FENCED, "", text, flags=re.M | re.S))
        lines += [(page, " ".join(code.split())) for code in inline]
    return lines


COMMANDS = [
    (page, shlex.split(found[1]))
    for page, line in code_lines()
    if (found := re.fullmatch(r"(?:\.venv/bin/)?puddle ([a-z][^#]+?)(?: > \S+)?(?:\s+#.*)?", line.strip()))
]


def anchors(text: str) -> set[str]:
    """Return the anchors that GitHub makes of a page's headings."""
    headings = re.findall(r"^#+ (.+)$", text, flags=re.M)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES)
def test_links_resolve(page):
    folder = ROOT if (ROOT / page).exists() else ROOT / "docs"
    for link in re.findall(r"\]\(([^)\s]+)\)", PAGES[page]):
        path, _, anchor = link.partition("#")
        if not re.match(r"https?:|mailto:", link):
            target = folder / (path or page)
            assert target.exists(), link
            assert not anchor or anchor in anchors(target.read_text()), link


@pytest.mark.parametrize(
    ("page", "words"), COMMANDS, ids=lambda part: part if isinstance(part, str) else " ".join(part)
)
def test_a_command_parses(page, words):
    name, *arguments = [word for word in words if word != "…"]
    command = typer.main.get_command(app).commands[name]
    while hasattr(command, "commands"):  # a group: puddle servo play
        name, *arguments = arguments
        command = command.commands[name]
    if arguments == ["--list-ports"]:  # lists them, and is done
        return
    options = command.make_context(name, arguments, resilient_parsing=not arguments).params
    overrides = options.get("overrides") or ()
    if name == "fabricate":
        parse(FabricationSettings, "", name="the kit's settings", overrides=overrides)
    elif (
        "preset" in options
        and not (options.get("study") or options.get("settings_file"))  # of a reader's own study or file
        and not re.search("honey|springs|com_displacement|link_axes|wet_swing", " ".join(overrides))  # of the recipes
    ):
        StudyOptions(preset=options["preset"], overrides=overrides).settings()


@pytest.mark.parametrize(("page", "language", "text"), [block for block in BLOCKS if block[1] in ("python", "yaml")])
def test_snippets_are_well_formed(page, language, text):
    if language == "yaml":
        yaml.safe_load(text)
    else:
        compile(text, page, "exec")


def test_the_python_of_the_readme_runs():
    (text,) = (text for page, language, text in BLOCKS if (page, language) == ("README.md", "python"))
    quick, n_changed = re.subn(r"range\(\d+\)", "range(1)", text)
    assert n_changed == 1
    ran = subprocess.run([sys.executable, "-c", quick], cwd=ROOT, capture_output=True, text=True)
    assert ran.returncode == 0 and ran.stdout.startswith("in slush:"), ran.stderr
