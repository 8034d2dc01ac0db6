"""The sources of this code: its modules' files, and what each of them imports."""

import ast
import functools
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

Sources = dict[str, bytes]  # content of modules, by name


@functools.cache
def read_modules(*packages: str) -> Sources:
    """Read the modules of some packages."""
    root = Path(__file__).resolve().parents[1]
    paths = [path for package in packages for path in root.joinpath(*package.split(".")).rglob("*.py")]
    names = [".".join(path.relative_to(root).with_suffix("").parts).removesuffix(".__init__") for path in paths]
    return {name: path.read_bytes() for name, path in zip(names, paths, strict=True)}


def parsed(source: bytes) -> ast.Module:
    """Parse a module; one that can't be imported, because of its syntax, counts as empty."""
    try:
        return ast.parse(source)
    except SyntaxError:
        return ast.Module([], [])


def imported_names(tree: ast.AST) -> Sequence[str]:
    """List the modules that a module imports, also inside functions, and whatever it imports from one."""
    names: list[str] = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names += [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
    return names


def reached(names: Iterable[str], imports_of: Callable[[str], Iterable[str]]) -> set[str]:
    """Return some modules and all that they import, at any depth."""
    known: set[str] = set()
    pending = [*names]
    while pending:
        name = pending.pop()
        if name not in known:
            known.add(name)
            pending += imports_of(name)
    return known
