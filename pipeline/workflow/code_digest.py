"""Digests of the code that a stage's results are made by, so that results of other code can be named.

They are part of an item's record and of no key: whether an edit changes results, only its author knows. The code of a
stage is that of the modules that specify and compute its items, and of all that they import of the science, the stages
and the report. A module that is added changes the results of none that was there.
"""

from __future__ import annotations

import ast
import functools
import hashlib
import importlib.util
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from pipeline.store.manifest import Manifest
from pipeline.workflow.stage import AnyStage

PACKAGES = ("tasks", "pipeline.stages", "pipeline.report")
"""Packages that make results. What the others write carries a version, or is the same for all stages."""

Sources = Mapping[str, bytes]  # content of modules, by name


@functools.cache
def sources() -> Sources:
    """Read the modules of the packages that make results."""
    found = {}
    for package in PACKAGES:
        specification = importlib.util.find_spec(package)
        assert specification is not None and specification.submodule_search_locations
        folder = Path(specification.submodule_search_locations[0])
        for path in sorted(folder.rglob("*.py")):
            parts = path.relative_to(folder).with_suffix("").parts
            found[".".join([package, *(part for part in parts if part != "__init__")])] = path.read_bytes()
    return found


def recorded_code(stage: AnyStage) -> dict[str, str]:
    """Return what an item's record says of the code that made it.

    ``modules`` lists a short digest of every module that the stage imports, directly or not. ``files``, a digest of all
    modules as they are, costs milliseconds: where it is the same, nothing has to be parsed.
    """
    return {"modules": " ".join(sorted(_digests(*_modules(stage)))), "files": _files_digest()}


def is_of_other_code(manifest: Manifest, stage: AnyStage) -> bool:
    """Return whether a module that made an item has changed since, or is gone. Items of earlier versions do not say."""
    code = manifest.record.get("code")
    if not isinstance(code, Mapping) or "modules" not in code or code.get("files") == _files_digest():
        return False
    return not set(str(code["modules"]).split()) <= _digests(*_modules(stage))


@functools.cache
def _files_digest() -> str:
    return hashlib.sha256(repr(sorted(sources().items())).encode()).hexdigest()


def _modules(stage: AnyStage) -> tuple[str, str]:
    return stage.item.__module__, stage.compute.__module__


@functools.cache
def _digests(*modules: str) -> set[str]:
    return digests(modules, sources())


def digests(modules: Sequence[str], files: Sources) -> set[str]:
    """Return a short digest of each of some modules and of all that they import, without comments and docstrings."""
    return {
        hashlib.sha256(f"{name} {_parsed(files[name]).text}".encode()).hexdigest()[:8]
        for name in imported(modules, files)
    }


def imported(modules: Sequence[str], files: Sources) -> set[str]:
    """Return the names of modules and of those that they import directly or not, also inside functions.

    A package below ``PACKAGES`` is imported with each of its modules, and one that uses ``pkgutil`` imports all of its
    modules.
    """
    found: set[str] = set()
    pending = [*modules]
    while pending:
        name = pending.pop()
        if name in found or name not in files:
            continue
        found.add(name)
        parent = name.rpartition(".")[0]
        pending += [] if parent in PACKAGES else [parent]
        for imported_from, names in _parsed(files[name]).imports:
            inner = [one for one in names if one in files]
            pending += inner if len(inner) == len(names) else [imported_from, *inner]
            if imported_from == "pkgutil":
                pending += [one for one in files if one.startswith(f"{name}.")]
    return found


@dataclass(frozen=True)
class _Parsed:
    """What counts of a module."""

    text: str
    imports: tuple[tuple[str, tuple[str, ...]], ...]  # modules, each with what is imported from it, by full names


@functools.cache
def _parsed(source: bytes) -> _Parsed:
    tree = ast.parse(source)
    imports: list[tuple[str, tuple[str, ...]]] = []
    pending: list[ast.AST] = [tree]
    while pending:
        node = pending.pop()
        if isinstance(node, ast.Import):
            imports += [(alias.name, (alias.name,)) for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            imports.append((node.module, tuple(f"{node.module}.{alias.name}" for alias in node.names)))
        for part in ("body", "orelse", "finalbody", "handlers", "cases"):
            if isinstance(statements := getattr(node, part, None), list):
                statements[:] = [one for one in statements if not _is_text(one)]
                pending += statements
    return _Parsed(ast.unparse(tree), tuple(imports))


def _is_text(node: ast.AST) -> bool:
    """Return whether a statement is a string alone: a docstring, also of a constant or a field."""
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
