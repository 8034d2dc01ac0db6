"""The README and the pages of docs/ are true: links resolve, commands parse, snippets run, figures were measured."""

import ast
import hashlib
import json
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

from benchmarks import published
from benchmarks.readme import MEASURED, PERFORMANCE_PAGE, with_section
from benchmarks.sentences import with_figures
from pipeline.commands.app import app
from pipeline.commands.options import StudyOptions
from pipeline.config.loading import load, parse, preset_path
from pipeline.config.settings import Settings
from pipeline.report.sensitivity_page import SENSITIVITY, sensitivity_page
from tasks.fabrication.kit_settings import FabricationSettings

ROOT = Path(__file__).parents[2]
README = ROOT / "README.md"
PAGES = [README, ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
MOST_LINES_OF_README = 200

TO_BE_WRITTEN = r".*/(tar|com_displacement|mine)\.py"
"""Files that a reader is asked to write."""

by_page = pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)


def test_the_readme_is_short():
    assert len(README.read_text().splitlines()) <= MOST_LINES_OF_README


def test_the_readme_says_how_the_preset_paper_decides_what_the_paper_leaves_open():
    settings = load(Settings, preset_path("paper"))
    physics, afpo, training = settings.physics, settings.evolution.afpo, settings.training
    numbers = (
        f"{physics.link_density:g} kg/m², friction {physics.friction:g}, restitution {physics.restitution:g};",
        f"{physics.velocity_iterations} velocity and {physics.position_iterations} position iterations",
        f"the speed {physics.motor_gain:g} /s times the angle error",
        f"{afpo.mutation.genes_changed:g} changed genes on average, by Gaussian steps of {afpo.mutation.step:g} of",
        f"weight decay {training.weight_decay:g}; a warm-up of {training.warm_up:g} of",
    )
    text = " ".join(README.read_text(encoding="utf-8").split())
    assert [words for words in numbers if words not in text] == []
    readings = {
        "joints have no limits": physics.joint_limits == "none",
        "the range of motion is an amplitude": physics.range_of_motion == "amplitude",
        "they run while a robot settles, too": physics.motors_while_settling,
        "joints without a motor swing": physics.passive_joints == "swing",
        "a robot's lowest corner is at the surface": physics.spawn == "lowest_corner",
        "drag opposes the velocity": settings.slush.drag == "vector",
        "is integrated exactly over a step": settings.slush.drag_integration == "exact",
        "in adaptation each gene changes as often": settings.transfer.mutation_rate == "per_gene",
        "parents are chosen uniformly": afpo.parent_selection == "uniform",
        "σ over members is the population's": settings.ensemble.deviation == "population",
        "inputs and targets are standardised": training.standardise_targets,
        "Ten are trained; the first eight are the ensemble": (settings.grid.n_trials, settings.ensemble.n_members)
        == (10, 8),
    }
    assert [words for words, is_so in readings.items() if not is_so or words not in text] == []


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


@by_page
def test_files_that_it_names_exist(page):
    pattern = r"`((?:tasks|pipeline|puddle|configs|docs|tests|benchmarks|docker)/[\w./-]*)`"
    named = set(re.findall(pattern, page.read_text()))
    assert [path for path in named if not re.fullmatch(TO_BE_WRITTEN, path) and not (ROOT / path).exists()] == []


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


def test_commands_are_found_in_blocks_and_sentences():
    found = [" ".join(line.words) for line in COMMANDS]
    assert len(found) > 30
    assert "fabricate" in {line.words[0] for line in COMMANDS}
    assert any("--set grid.depths=[0.5,1,3] --set grid.single_member_depths=[0.5,1,3]" in line for line in found)
    assert any(line.endswith("--set training.n_iterations=8000") for line in found)  # the last of two joined lines


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


def test_a_block_without_a_language_is_made_of_commands_or_of_a_picture():
    """So that no command escapes these tests."""
    for block in BLOCKS:
        is_command = [
            bool(re.match(r"(\.venv/bin/)?(puddle|python|make|ray|pip|docker|kubectl) ", line)) for line in block.lines
        ]
        if not block.language and any(is_command):
            others = [line for line, known in zip(block.lines, is_command, strict=True) if not known]
            assert [line for line in others if not re.fullmatch(OF_THE_SHELL, line)] == [], block.page


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


def test_every_snippet_has_a_known_language():
    assert {block.language for block in BLOCKS} <= {"", "bash", "console", "sh", "python", "yaml", "json", "text"}


# -- the tree --------------------------------------------------------------------------------------------------------


def shown_in_tree() -> dict[str, list[str]]:
    """Return every folder that the README's tree shows, with the names of what it shows below it."""
    (block,) = re.findall(r"^## Where things are\n.*?^```\n(.*?)^```$", README.read_text(), flags=re.M | re.S)
    shown: dict[str, list[str]] = {"": []}
    above = [""]
    for line in block.splitlines():
        above = above[: 1 + (len(line) - len(line.lstrip())) // 2]
        names = re.match(r"[^\s,]+(?:, [^\s,]+)*", line.strip())[0].split(", ")
        shown[above[-1]] += names
        if names[0].endswith("/"):
            above.append(above[-1] + names[0])
            shown[above[-1]] = []
    return shown


def folders_in(folder: Path) -> set[str]:
    """Return the folders of a folder that hold files of the repository."""
    listed = subprocess.run(["git", "ls-files", folder], cwd=ROOT, capture_output=True, text=True).stdout.splitlines()
    within = [Path(name).relative_to(folder.relative_to(ROOT)).parts for name in listed if (ROOT / name).exists()]
    return {f"{parts[0]}/" for parts in within if len(parts) > 1 and not parts[0].startswith(".")}


def test_the_tree_shows_exactly_the_folders_that_exist():
    shown = shown_in_tree()
    for folder, names in shown.items():
        folders = {name for name in names if name.endswith("/")}
        if folders or folder in ("", "tasks/", "pipeline/"):
            assert folders == folders_in(ROOT / folder), folder or "the root"
        assert [name for name in names if not (ROOT / folder / name).exists()] == []


# -- figures ---------------------------------------------------------------------------------------------------------


def test_performance_is_that_of_a_benchmark():
    text = PERFORMANCE_PAGE.read_text()
    assert with_section(text, json.loads(MEASURED.read_text())) == text


@pytest.mark.parametrize("page", published.PAGES, ids=lambda page: page.name)
def test_results_are_those_of_the_results_files(page):
    text, complaints = published.with_results(page)
    assert not complaints, "\n".join(complaints)
    assert text == page.read_text(encoding="utf-8"), "python -m benchmarks.published"


def test_every_table_of_displacements_is_from_a_results_file():
    """A table with means and deviations of the paper's arms stands between markers."""
    for page in published.PAGES:
        left = published.SECTION.sub("", page.read_text(encoding="utf-8"))
        assert not re.findall(r"^\|.*(?:Residual Slush|Dry Land|True Slush).*±.*\|$", left, re.M), page.name


@pytest.mark.parametrize(
    "path",
    sorted({*published.RESULTS.glob("*.json")} - {ROOT / "docs" / published.PICTURES}),
    ids=lambda path: path.name,
)
def test_a_results_file_names_the_commits_that_it_is_from(path):
    results = json.loads(path.read_text(encoding="utf-8"))
    if results["schema"] == "puddle.recorded":  # of one measurement each
        commits = [of["stated at"] for of in results.values() if isinstance(of, dict)]
    else:
        commits = [of["made_with"]["commit"] for of in results.get("parts", {path.stem: results}).values()]
    assert commits and all(re.fullmatch(r"[0-9a-f]{7,40}(-dirty)?", commit) for commit in commits)


def recorded_pictures() -> dict[str, dict[str, str | None]]:
    return json.loads((ROOT / "docs" / published.PICTURES).read_text(encoding="utf-8"))["pictures"]


def test_pictures_are_drawn_from_the_results_that_are_published():
    shown = {
        name
        for page in published.PAGES
        for name in re.findall(r"!\[[^]]*\]\((?:docs/)?([\w-]+\.(?:png|gif))\)", page.read_text(encoding="utf-8"))
    }
    assert recorded_pictures().keys() == shown
    for name, picture in recorded_pictures().items():
        if picture["results"] is None:  # of no results file, as its note explains
            assert picture["note"], name
        else:
            results = json.loads((published.RESULTS / f"{picture['results']}.json").read_text(encoding="utf-8"))
            assert picture["drawn_from"] == results["digests"][picture["of"]], name


def test_pictures_have_the_bytes_that_were_recorded():
    files = [path for path in (ROOT / "docs").iterdir() if path.suffix in (".png", ".gif")]
    found = {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in files}
    assert found == {name: picture["sha256"] for name, picture in recorded_pictures().items()}


def test_a_page_that_differs_from_its_results_file_is_noticed():
    text = README.read_text(encoding="utf-8")
    assert "17.6 ± 2.5" in text and published.with_sections(text.replace("17.6 ± 2.5", "17.7 ± 2.5")) == text
    sentences = published.SENTENCES["README.md"]
    assert "travel 22 m" in text and with_figures(text.replace("travel 22 m", "travel 15 m"), sentences) == text


def test_sensitivity_is_that_of_its_result():
    page = ROOT / "docs" / "sensitivity.md"
    assert sensitivity_page(SENSITIVITY.validate_json(page.with_suffix(".json").read_bytes())) == page.read_text()


def bounded_names() -> Iterator[str]:
    """Return the names of the figures with a bound in the benchmarks, as regular expressions."""
    for module in sorted((ROOT / "benchmarks").glob("*.py")):
        for call in ast.walk(ast.parse(module.read_text())):
            if isinstance(call, ast.Call) and ast.unparse(call.func) == "Benchmark" and len(call.args) == 4:
                parts = call.args[0].values if isinstance(call.args[0], ast.JoinedStr) else [call.args[0]]
                yield "".join(re.escape(part.value) if isinstance(part, ast.Constant) else ".+" for part in parts)


def test_every_bound_was_measured():
    measured = {figure["name"] for figure in json.loads(MEASURED.read_text())["figures"] if figure["bound"]}
    bounded = list(bounded_names())
    assert len(bounded) > 10
    assert [name for name in bounded if not any(re.fullmatch(name, one) for one in measured)] == []
