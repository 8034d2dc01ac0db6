"""Digests of the code that a stage's results are made by, so that results of other code can be named.

They are part of an item's record and of no key: whether an edit changes results, only its author knows. The code of a
stage is that of the modules that specify and compute its items, and of all that they import of the science, the stages
and the report.
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

    ``stage`` is the digest that counts. ``files``, a digest of all modules as they are, costs milliseconds: where it is
    the same, nothing has to be parsed.
    """
    return {"stage": _stage_digest(*_modules(stage)), "files": _files_digest()}


def is_of_other_code(manifest: Manifest, stage: AnyStage) -> bool:
    """Return whether a different version of the code made an item; False if its record has no digest of it."""
    code = manifest.record.get("code")
    if not isinstance(code, Mapping) or "stage" not in code or code.get("files") == _files_digest():
        return False
    return bool(code["stage"] != _stage_digest(*_modules(stage)))


@functools.cache
def _files_digest() -> str:
    joined = hashlib.sha256()
    for name, content in sources().items():
        joined.update(f"{name} {hashlib.sha256(content).hexdigest()}\n".encode())
    return joined.hexdigest()


def _modules(stage: AnyStage) -> tuple[str, str]:
    return stage.item.__module__, stage.compute.__module__


@functools.cache
def _stage_digest(*modules: str) -> str:
    return code_digest(modules, sources())


def code_digest(modules: Sequence[str], files: Sources) -> str:
    """Return a digest of modules and all that they import, without comments and docstrings."""
    lines = [f"{name} {_parsed(files[name]).digest}\n" for name in sorted(imported(modules, files))]
    return hashlib.sha256("".join(lines).encode()).hexdigest()


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

    digest: str
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
    return _Parsed(hashlib.sha256(ast.unparse(tree).encode()).hexdigest(), tuple(imports))


def _is_text(node: ast.AST) -> bool:
    """Return whether a statement is a string alone: a docstring, also of a constant or a field."""
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
