"""The README says what is: its pictures and files are there, its commands exist, its figures are measured."""

import json
import re
from pathlib import Path

from benchmarks.readme import PAGES, RESULTS, with_section
from pipeline.cli import app

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()


def test_files_that_it_names_are_there():
    pictures = re.findall(r"\]\((?!http)([^)]+)\)", README)
    named = re.findall(r"`((?:tasks|pipeline|configs|docs|tests|benchmarks)/[\w./-]+)`", README)
    assert pictures and named
    example = "tasks/world/tar.py", "pipeline/stages/mine.py"  # what a reader is told to write
    assert [path for path in [*pictures, *named] if path not in example and not (ROOT / path).exists()] == []


def test_commands_that_it_gives_exist():
    known = {command.name or command.callback.__name__ for command in app.registered_commands}
    given = set(re.findall(r"(?:bin/|`)puddle ([a-z]+)", README))
    assert given and given <= known
    targets = set(re.findall(r"^([a-z]+):.*## ", (ROOT / "Makefile").read_text(), flags=re.M))
    for command in re.findall(r"^make ([a-z]+)", README, flags=re.M):
        assert command in targets


def test_performance_is_that_of_a_benchmark():
    for page, promised in PAGES.items():
        text = page.read_text()
        assert with_section(text, json.loads(RESULTS.read_text()), promised=promised) == text, page.name
