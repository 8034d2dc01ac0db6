"""Kernels are compiled once on a machine, again when their source changes, and never loaded damaged."""

import inspect
import os
import shutil
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numba
import pytest

from pipeline import kernels
from tasks.compiled import KERNELS, compiled
from tasks.simulation import fluids
from tasks.simulation.fluids import Rows
from tasks.simulation.trees import step
from tasks.world.flowing_slush import FlowingSlush

ROOT = Path(__file__).parents[2]

pytestmark = [pytest.mark.slow, pytest.mark.skipif(numba.config.DISABLE_JIT, reason="there is no compiler")]

DESIGNS = "import sys, numpy, puddle; puddle.random_designs(int(sys.argv[1]), numpy.random.default_rng(1))"


@pytest.fixture
def compilations(tmp_path):
    """Draw designs in a new process, as a user of `puddle` does; return what was compiled."""

    def run(place: Path = ROOT) -> list[str]:
        environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": str(place)}
        command = [sys.executable, "-c", DESIGNS, "3"]
        done = subprocess.run(command, env=environment, cwd=tmp_path, capture_output=True, text=True, check=True)
        return [line for line in done.stderr.splitlines() if line.startswith("compiling tasks.")]

    return run


def test_a_kernel_is_compiled_once_until_a_source_is_edited(compilations, tmp_path):
    """A copy elsewhere takes it, too: on a cluster Ray unpacks the sources into a folder of each session."""
    assert compilations()
    for package in ("tasks", "pipeline", "puddle"):
        shutil.copytree(ROOT / package, tmp_path / "copy" / package, ignore=shutil.ignore_patterns("__pycache__"))
    assert compilations(tmp_path / "copy") == []
    with (tmp_path / "copy" / "tasks" / "design" / "genes.py").open("a") as file:
        file.write("# edited\n")
    assert compilations(tmp_path / "copy")
    assert compilations() == []


def test_processes_that_need_a_kernel_at_once_compile_it_once(compilations, tmp_path):
    with ThreadPoolExecutor() as pool:
        lines = [line for done in pool.map(lambda _: compilations(), range(2)) for line in done]
    assert lines and len(lines) == len(set(lines))
    assert not [*tmp_path.glob("cache/*/.*")]


def modules_reached(function, reached: dict[object, str]) -> dict[object, str]:
    """Follow the names in a function's code to the functions that it calls; return the module of each."""
    function = getattr(function, "py_func", function)
    if not hasattr(function, "__code__") or function in reached:
        return reached
    reached[function] = function.__module__
    for name in (names := function.__code__.co_names):
        named = function.__globals__.get(name)
        for value in [getattr(named, one, None) for one in names] if inspect.ismodule(named) else [named]:
            modules_reached(value, reached)
    return reached


def test_a_module_of_any_function_that_a_kernel_calls_is_a_source():
    for kernel in KERNELS:
        own = {module for module in modules_reached(kernel, {}).values() if module.startswith("tasks.")}
        assert own <= kernels.kernel_sources(kernel).keys(), kernel


def test_an_edit_of_a_medium_compiles_no_kernel_but_that_of_its_law():
    media = {"tasks.world.randomised_slush", "tasks.world.flowing_slush", "tasks.world.anisotropic_slush"}
    assert not media & kernels.kernel_sources(step.advance).keys()
    law = fluids._kernel(FlowingSlush.law, Rows((0,) * 10, (0,) * 3, (0,) * 3, 1), 0).py_func
    assert media & kernels.kernel_sources(law).keys() == {"tasks.world.flowing_slush"}
    assert "tasks.simulation.fluids" in kernels.kernel_sources(law)


def test_imports_of_sources_are_sources_and_packages_around_them_are_not():
    modules = {"tasks.a": b"import tasks.c.d", "tasks.b": b"from tasks import a", "tasks.c": b"", "tasks.c.d": b""}
    assert kernels.sources_of(modules, {"tasks.b"}).keys() == {"tasks.a", "tasks.b", "tasks.c.d"}


def doubled(x):
    return 2 * x


@pytest.fixture
def compile_and_call(tmp_path, monkeypatch, capsys):
    """Call a new kernel as a new process would; return what was said."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))

    def call() -> str:
        assert compiled(doubled, seconds=1)(21) == 42
        return capsys.readouterr().err

    return call


def flip(content: bytes) -> bytes:
    middle = len(content) // 2
    return content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :]


@pytest.mark.parametrize(
    "damage", [flip, lambda content: content[:-2], lambda content: b""], ids=["flipped bit", "cut", "empty"]
)
def test_a_damaged_kernel_is_compiled_again_with_one_line(compile_and_call, tmp_path, damage):
    assert compile_and_call().count("compiling") == 1
    assert compile_and_call() == ""
    (path,) = tmp_path.glob("*/*")
    path.write_bytes(damage(path.read_bytes()))
    said = compile_and_call()
    assert said.count(f"the compiled kernel {path} is damaged") == 1 and said.count("compiling") == 1
    assert compile_and_call() == ""


def undoable(number):
    return number.undone


def test_what_does_not_compile_keeps_no_other_process_waiting(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    with pytest.raises(numba.TypingError):
        compiled(undoable, seconds=1)(21)
    assert not [*tmp_path.glob("*/.*")]


def test_without_a_home_kernels_are_kept_among_temporary_files(tmp_path, monkeypatch):
    """A home that is missing below a file can't be made, like one below a folder of others."""
    for name in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    (tmp_path / "file").touch()
    monkeypatch.setenv("HOME", str(tmp_path / "file" / "home"))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    assert kernels.users_folder().parent == tmp_path
