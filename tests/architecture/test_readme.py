"""What the README and the pages of docs/ show works: links resolve, commands parse, snippets run."""

import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
import typer
import yaml
from typer.testing import CliRunner

from pipeline.commands.app import app
from pipeline.commands.options import StudyOptions
from pipeline.config.loading import parse
from tasks.fabrication.kit_settings import FabricationSettings

ROOT = Path(__file__).parents[2]
README = ROOT / "README.md"
PAGES = [README, ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
by_page = pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)


# -- links -----------------------------------------------------------------------------------------------------------


def anchors(page: Path) -> set[str]:
    """Return the anchors that GitHub makes of a page's headings."""
    headings = re.findall(r"^#+ (.+)$", page.read_text(), flags=re.M)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@by_page
def test_links_resolve(page):
    for link in re.findall(r"\]\(([^)\s]+)\)", page.read_text()):
        path, _, anchor = link.partition("#")
        if not re.match(r"https?:|mailto:", link):
            target = page.parent / path if path else page
            assert target.exists(), link
            assert not anchor or anchor in anchors(target), link


# -- commands --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Block:
    """A fenced block of a page."""

    page: str
    language: str
    text: str

    @property
    def lines(self) -> list[str]:
        """Its lines, with continued lines joined."""
        return [line for line in self.text.replace("\\\n", " ").splitlines() if line.strip()]


FENCED = r"^```(\w*)\n(.*?)^```$"
BLOCKS = [
    Block(page.name, language, text)
    for page in PAGES
    for language, text in re.findall(FENCED, page.read_text(), flags=re.M | re.S)
]

COMMAND = r"(?:\.venv/bin/)?puddle ([^#]+?)(?: > \S+)?(?:\s+# (.*))?"
OF_THE_SHELL = r"(\.venv/bin/python -m pip install|ray start|export|\(umask|sbatch|squeue) .*"
"""Commands of other programs, which the pages show as they are."""


@dataclass(frozen=True)
class CommandLine:
    """A `puddle` command line that a page shows."""

    page: str
    words: list[str]
    """Its words after the program's name."""
    comment: str
    """The comment beside it, which may name other options."""


def inline_code(page: Path) -> Iterator[str]:
    """Find the code in the sentences of a page."""
    for code in re.findall(r"`([^`]+)`", re.sub(FENCED, "", page.read_text(), flags=re.M | re.S)):
        yield " ".join(code.split())


def command_lines() -> Iterator[CommandLine]:
    """Find the `puddle` commands of all pages, in their blocks and in their sentences."""
    lines = [(block.page, line) for block in BLOCKS for line in block.lines]
    lines += [(page.name, code) for page in PAGES for code in inline_code(page)]
    for page, line in lines:
        if found := re.fullmatch(COMMAND, line.strip()):
            yield CommandLine(page, shlex.split(found[1]), found[2] or "")


COMMANDS = list(command_lines())
KNOWN = typer.main.get_command(app).commands


@pytest.mark.parametrize("line", COMMANDS, ids=lambda line: f"{line.page}: {' '.join(line.words)}")
def test_a_command_parses(line):
    name, *arguments = [word for word in line.words if word != "…"]
    if name.startswith("--"):
        assert CliRunner().invoke(app, line.words).exit_code == 0
        return
    command = KNOWN[name]
    while hasattr(command, "commands"):  # a group: puddle servo play
        name, *arguments = arguments
        command = command.commands[name]
    options = command.make_context(name, arguments).params
    known = {option for parameter in command.params for option in parameter.opts}
    assert set(re.findall(r"--[a-z]+(?:-[a-z]+)*", line.comment)) <= known
    overrides = (*(options.get("overrides") or ()), *re.findall(r"[a-z_]+\.[a-z_.]+=[^\s,]+", line.comment))
    if name == "fabricate":
        parse(FabricationSettings, "", name="the kit's settings", overrides=overrides)
        overrides = ()
    own = options.get("study") or options.get("settings_file")  # of a reader's own study or file
    if "preset" in options and not own and not re.search("tar_pit|com_displacement", " ".join(overrides)):  # recipes
        StudyOptions(preset=options["preset"], overrides=overrides).settings()


def test_targets_of_make_exist():
    targets = set(re.findall(r"^([a-z]+):.*## ", (ROOT / "Makefile").read_text(), flags=re.M))
    given = [line for block in BLOCKS for line in block.lines] + [code for page in PAGES for code in inline_code(page)]
    named = {found[1] for line in given if (found := re.match(r"make ([a-z]+)\b", line))}
    assert {"study", "test"} <= named <= targets


# -- snippets --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("block", [block for block in BLOCKS if block.language == "python"], ids=lambda one: one.page)
def test_python_compiles(block):
    compile(block.text, block.page, "exec")


def test_the_python_of_the_readme_runs():
    (block,) = (block for block in BLOCKS if (block.page, block.language) == ("README.md", "python"))
    quick, n_changed = re.subn(r"range\(\d+\)", "range(1)", block.text)
    assert n_changed == 1
    ran = subprocess.run([sys.executable, "-c", quick], cwd=ROOT, capture_output=True, text=True)
    assert ran.returncode == 0 and ran.stdout.startswith("in slush:"), ran.stderr


@pytest.mark.parametrize(
    "block", [block for block in BLOCKS if block.language in ("yaml", "json")], ids=lambda b: b.page
)
def test_yaml_and_json_load(block):
    yaml.safe_load(block.text)
