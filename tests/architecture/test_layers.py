"""Structure: who may import whom, no files in tasks/, one order of axes."""

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SCIENCE = sorted((ROOT / "tasks").rglob("*.py"))

COMPILERS_CACHE = ROOT / "tasks/compiled.py"
"""The only module that uses a folder: numba's cache of compiled kernels. No result of a task passes through it."""

FILE_MODULES = {
    "pathlib",
    "io",
    "shutil",
    "tempfile",
    "glob",
    "fileinput",
    "mmap",
    "pickle",
    "shelve",
    "sqlite3",
    "zipfile",
    "gzip",
    "csv",
    "subprocess",
    "socket",
    "urllib",
    "http",
    "random",
    "time",
    "datetime",
}
"""Ways to files, other machines, a clock and a global generator: a task is arrays in, arrays out."""

FILE_CALLS = re.compile(
    r"open|print|input"
    r"|os\.(?!environ\b).*"
    r"|(np|numpy|torch)\.(save.*|load.*|genfromtxt|fromfile|memmap)"
    r"|.*\.(tofile|read_text|write_text|read_bytes|write_bytes)"
)
"""Calls that read or write files or the terminal, as they stand in the source."""


def test_the_contracts_of_imports_hold() -> None:
    script = "from importlinter.cli import lint_imports; raise SystemExit(lint_imports(no_cache=True))"
    done = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert re.search(r"Contracts: \d+ kept, 0 broken", done.stdout), done.stdout


def imported(tree: ast.AST) -> Iterator[str]:
    """Return the top-level names of the packages that a module imports."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name.split(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module.split(".")[0]


def called(tree: ast.AST) -> Iterator[str]:
    """Return the functions that a module calls, as they stand in the source: ``open``, ``np.load``."""
    yield from (ast.unparse(node.func) for node in ast.walk(tree) if isinstance(node, ast.Call))


@pytest.mark.parametrize("module", SCIENCE, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_science_touches_no_files(module: Path) -> None:
    if module == COMPILERS_CACHE:
        pytest.skip("the compiler's cache")
    tree = ast.parse(module.read_text())
    assert not FILE_MODULES & set(imported(tree))
    assert not [call for call in called(tree) if FILE_CALLS.fullmatch(call)]


@pytest.mark.parametrize("module", SCIENCE, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_science_draws_from_no_global_generator(module: Path) -> None:
    """Numbers come from a Generator that is passed in; numpy's and torch's global ones are never seeded."""
    for node in ast.walk(ast.parse(module.read_text())):
        if isinstance(node, ast.Attribute) and ast.unparse(node.value) in {"np.random", "numpy.random"}:
            allowed = {"Generator", "SeedSequence", "default_rng"}
            assert node.attr in allowed, f"line {node.lineno}: np.random.{node.attr}"
        if isinstance(node, ast.Call) and ast.unparse(node.func).endswith("default_rng"):
            assert node.args, f"line {node.lineno}: a generator without a seed"
