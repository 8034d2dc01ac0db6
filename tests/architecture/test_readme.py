"""The pages say what is: pictures and files are there, commands are taken as given, figures are measured."""

import ast
import json
import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
import typer

from benchmarks.readme import PAGE, RESULTS, with_section
from pipeline.commands.app import app
from pipeline.commands.options import StudyOptions
from pipeline.config.loading import parse
from pipeline.fabrication.choices import FabricationSettings

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()
WITH_COMMANDS = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def test_files_that_it_names_are_there():
    pictures = re.findall(r"\]\((?!http)([^)]+)\)", README)
    named = re.findall(r"`((?:tasks|pipeline|configs|docs|tests|benchmarks)/[\w./-]+)`", README)
    assert pictures and named
    example = "tasks/world/tar.py", "pipeline/stages/mine.py"  # what a reader is told to write
    assert [path for path in [*pictures, *named] if path not in example and not (ROOT / path).exists()] == []


# -- commands --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Given:
    """A command line that a page gives."""

    words: list[str]
    """After the program's name."""
    comment: str
    """What it says beside it, of other options."""


def given(page: Path) -> Iterator[Given]:
    """Find the command lines of a page: those of its code blocks, and those in its sentences."""
    fenced, text = r"^```\n(.*?)^```$", page.read_text()
    blocks = re.findall(fenced, text, flags=re.M | re.S)
    lines = [line for block in blocks for line in block.replace("\\\n", " ").splitlines()]
    lines += [" ".join(code.split()) for code in re.findall(r"`([^`]+)`", re.sub(fenced, "", text, flags=re.M | re.S))]
    for line in lines:
        if found := re.fullmatch(r"(?:\.venv/bin/)?puddle (.+?)(?: > \S+)?(?:\s+# (.*))?", line):
            yield Given(shlex.split(found[1]), found[2] or "")


COMMANDS = [
    pytest.param(line, id=f"{page.name}: {' '.join(line.words)}") for page in WITH_COMMANDS for line in given(page)
]


def test_commands_are_found_wherever_they_stand():
    found = [" ".join(case.values[0].words) for case in COMMANDS]
    assert len(found) > 30
    assert "fabricate" in found  # of a sentence
    assert any("--set grid.depths=[0.5,1,3] --set grid.single_member_depths=[0.5,1,3]" in line for line in found)
    assert any(line.endswith("--set training.loss=mse") for line in found)  # after three lines of a block


@pytest.mark.parametrize("line", COMMANDS)
def test_a_command_is_taken_as_it_is_given(line):
    name, *arguments = line.words
    command = typer.main.get_command(app).commands[name]
    options = command.make_context(name, arguments).params
    known = {option for parameter in command.params for option in parameter.opts}
    assert set(re.findall(r"--[a-z]+(?:-[a-z]+)*", line.comment)) <= known
    overrides = (*(options.get("overrides") or ()), *re.findall(r"[a-z_]+\.[a-z_.]+=[^\s,]+", line.comment))
    if name == "fabricate":
        parse(FabricationSettings, "", name="the kit's settings", overrides=overrides)
        overrides = ()
    if options.get("preset"):
        StudyOptions(options["preset"], None, overrides, ROOT).settings()


def test_targets_of_make_that_it_gives_exist():
    targets = set(re.findall(r"^([a-z]+):.*## ", (ROOT / "Makefile").read_text(), flags=re.M))
    for command in re.findall(r"^make ([a-z]+)", README, flags=re.M):
        assert command in targets


# -- where things are ------------------------------------------------------------------------------------------------


def shown_in_tree() -> dict[str, list[str]]:
    """Give every folder that the README's tree shows, with the lines below it."""
    (block,) = re.findall(r"^## Where things are\n\n```\n(.*?)^```$", README, flags=re.M | re.S)
    shown: dict[str, list[str]] = {"": []}
    above = [""]
    for line in block.splitlines():
        above = above[: 1 + (len(line) - len(line.lstrip())) // 2]
        shown[above[-1]].append(line.strip())
        if (first := line.split()[0]).endswith("/"):
            above.append(above[-1] + first)
            shown[above[-1]] = []
    return shown


def test_the_tree_names_every_module_or_the_folder_that_holds_it():
    shown = shown_in_tree()
    missing = []
    for path in [*ROOT.glob("tasks/**/*.py"), *ROOT.glob("pipeline/**/*.py")]:
        folders = [f"{folder.relative_to(ROOT)}/" for folder in path.parents[: -len(ROOT.parts)]]
        nearest = next(folder for folder in folders if folder in shown)
        whole = not shown[nearest]  # nothing is shown of it, so its own line is about all that it holds
        named = nearest == folders[0] and path.name in re.findall(r"\w+\.py", " ".join(shown[nearest]))
        if not (whole or named or path.name == "__init__.py"):
            missing.append(str(path.relative_to(ROOT)))
    assert missing == []


def test_what_the_tree_names_is_there():
    for folder, lines in shown_in_tree().items():
        for line in lines:
            names = re.match(r"[^\s,]+(?:, [^\s,]+)*", line)[0].split(", ")
            assert [name for name in names if not (ROOT / folder / name).exists()] == []


def test_performance_is_that_of_a_benchmark():
    text = PAGE.read_text()
    assert with_section(text, json.loads(RESULTS.read_text())) == text


def promised_names() -> Iterator[str]:
    """Give the names of the figures that the benchmarks promise something of, as regular expressions."""
    for module in sorted((ROOT / "benchmarks").glob("*.py")):
        for call in ast.walk(ast.parse(module.read_text())):
            if isinstance(call, ast.Call) and ast.unparse(call.func) == "Figure" and len(call.args) == 4:
                parts = call.args[0].values if isinstance(call.args[0], ast.JoinedStr) else [call.args[0]]
                yield "".join(re.escape(part.value) if isinstance(part, ast.Constant) else ".+" for part in parts)


def test_every_promise_was_measured():
    measured = {figure["name"] for figure in json.loads(RESULTS.read_text())["figures"] if figure["promise"]}
    promised = list(promised_names())
    assert len(promised) > 10
    assert [name for name in promised if not any(re.fullmatch(name, one) for one in measured)] == []
