"""Names: one thing has a name that no other thing has, and a module is small enough to read."""

import ast
import re
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from pathlib import PurePath

import pytest
from source import ROOT, SOURCES, syntax, tracked_files

SAME_ROLE = {
    "fabrication": {"tasks", "pipeline"},
    "vision": {"tasks", "pipeline"},
    "controller": {"tasks/simulation", "pipeline/servo"},
    "layout": {"tasks/simulation/trees", "tasks/simulation/rigid_bodies"},
    "packing": {"tasks/simulation/trees", "tasks/simulation/rigid_bodies"},
    "step": {"tasks/simulation/trees", "tasks/simulation/rigid_bodies"},
    "report": {"pipeline", "pipeline/stages"},
}
"""Modules and packages that share a name because they play the same role in two packages, and where they are."""

OF_A_CONTRACT = {"STAGE"}
"""Constants that every module of a kind defines."""

WITH_BENCHMARKS = [*SOURCES, *tracked_files("benchmarks/*.py")]
MOST_LOOSE_MODULES = 4
MOST_LINES = 450


def defined(name: str) -> Iterator[str]:
    """Find the classes and public constants of a module: type aliases too, but no type variables."""
    for node in syntax(name).body:
        if isinstance(node, ast.ClassDef):
            yield node.name
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
        of_type = "TypeVar" in ast.unparse(node) if isinstance(node, ast.Assign) else False
        for target in targets:
            if (
                isinstance(target, ast.Name)
                and re.match(r"[A-Z]", target.id)
                and not of_type
                and target.id not in OF_A_CONTRACT
            ):
                yield target.id


@cache
def homes() -> dict[str, set[str]]:
    """Give the modules that define each class and public constant."""
    found = defaultdict(set)
    for module in WITH_BENCHMARKS:
        for name in defined(module):
            found[name].add(module)
    return found


@pytest.mark.parametrize("module", WITH_BENCHMARKS)
def test_a_class_or_public_constant_has_a_name_that_no_other_has(module: str) -> None:
    twice = {name: sorted(homes()[name] - {module}) for name in defined(module) if len(homes()[name]) > 1}
    if twice:
        pytest.fail("\n".join(f"{module}: {name} also in {', '.join(at)}" for name, at in twice.items()), pytrace=False)


def test_modules_share_a_name_only_where_they_play_the_same_role() -> None:
    folders = defaultdict(set)
    for path in map(PurePath, SOURCES):
        of_package = path.name == "__init__.py"
        if path.name != "__main__.py" and path.stem != path.parent.name:  # store/store.py
            folders[path.parent.name if of_package else path.stem].add(str(path.parents[1 if of_package else 0]))
    shared = {name: at for name, at in folders.items() if len(at) > 1}
    assert shared == {name: at for name, at in SAME_ROLE.items() if name in shared}


@pytest.mark.parametrize("package", ["pipeline", "tasks"])
def test_few_modules_lie_loose(package: str) -> None:
    loose = [name for name in SOURCES if re.fullmatch(rf"{package}/\w+\.py", name) and "__" not in name]
    assert len(loose) <= MOST_LOOSE_MODULES + (package == "tasks"), loose


@pytest.mark.parametrize("module", SOURCES)
def test_a_module_is_short_enough_to_read(module: str) -> None:
    n_lines = len((ROOT / module).read_text().splitlines())
    assert n_lines <= MOST_LINES, f"{module} has {n_lines} lines, expected at most {MOST_LINES}"
