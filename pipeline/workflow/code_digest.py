"""Digests of the code that a stage's results are made by, so that results of other code can be named.

They are part of an item's record and of no key: whether an edit changes results, only its author knows. The code of a
stage is that of the modules that specify and compute its items, of a user's extensions, and of all that they import of
the science, the stages and the report. A module that is added changes the results of none that was there.
"""

from __future__ import annotations

import ast
import functools
import hashlib
from collections.abc import Mapping, Sequence
from typing import Any

from pipeline.extensions import given
from pipeline.sources import imported_names, parsed, reached, read_modules
from pipeline.store.manifest import Manifest
from pipeline.workflow.stage import AnyStage

PACKAGES = ("tasks", "pipeline.stages", "pipeline.report")
"""Packages that make results. What the others write carries a version, or is the same for all stages."""

_DISCOVERY = "tasks.discovery"


@functools.cache
def recorded_code(stage: AnyStage) -> dict[str, str]:
    """Return what an item's record says of the code that made it: a short digest of each module of its stage."""
    extensions = {name: text.encode() for name, (_, text) in given().items()}
    of_stage = stage.item.__module__, stage.compute.__module__
    modules = digests([*of_stage, *extensions], read_modules(*PACKAGES) | extensions)
    return {"modules": " ".join(sorted(modules))}


def is_of_other_code(manifest: Manifest, stage: AnyStage) -> bool:
    """Return whether a module that made an item has changed since."""
    made = set(manifest.record.get("code", {}).get("modules", "").split())
    today = set(recorded_code(stage)["modules"].split())
    return not (made <= today or today <= made)  # a module that is gone, such as a medium's, changes no other


def digests(modules: Sequence[str], files: Mapping[str, bytes]) -> set[str]:
    """Return a short digest of each of some modules and of all that they import, without comments and docstrings.

    Imports inside functions count. A package below ``PACKAGES`` is imported with each of its modules, and one that uses
    tasks.discovery imports all of its modules.
    """
    own = files.keys() - set(PACKAGES)

    def imports_of(name: str) -> Sequence[str]:
        if name not in own:
            return ()
        _, imports = _parsed(files[name])
        discovered = [module for module in files if module.startswith(f"{name}.")] if _DISCOVERY in imports else []
        return [name.rpartition(".")[0], *imports, *discovered]

    texts = {name: _parsed(files[name])[0] for name in reached(modules, imports_of) & own}
    return {hashlib.sha256(f"{name} {text}".encode()).hexdigest()[:8] for name, text in texts.items()}


@functools.cache
def _parsed(source: bytes) -> tuple[str, Sequence[str]]:
    """Return a module's code without its comments and docstrings, and the names that it imports."""
    tree = parsed(source)
    return ast.dump(_WithoutTexts().visit(tree)), imported_names(tree)


class _WithoutTexts(ast.NodeTransformer):
    """Removes statements that are a string alone: docstrings, also of a constant or a field."""

    def visit_Expr(self, node: ast.Expr) -> Any:
        is_text = isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
        return None if is_text else self.generic_visit(node)
