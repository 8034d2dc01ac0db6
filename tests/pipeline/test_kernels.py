"""Kernels are compiled once on a machine, again when their source changes, and never loaded damaged."""

import inspect
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numba
import pytest

from pipeline import kernels
from pipeline.kernels import kernel_sources
from pipeline.sources import read_modules
from tasks.compiled import KERNELS, compiled
from tasks.world import Physics

ROOT = Path(__file__).parents[2]

pytestmark = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="there is no compiler")

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
    with (tmp_path / "copy" / "tasks" / "world" / "physics.py").open("a") as file:
        file.write("# edited\n")
    assert compilations(tmp_path / "copy")
    assert compilations() == []


MODULES = read_modules("tasks")


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


def test_a_module_of_any_function_that_kernels_call_is_a_source():
    reached: dict[object, str] = {}
    for kernel in KERNELS:
        modules_reached(kernel, reached)
    own = {module for module in reached.values() if module.startswith("tasks.")}
    assert {"tasks.simd.rotation", "tasks.design.variation_kernels"} <= own <= kernel_sources(MODULES).keys()
    assert "tasks.world.slush" in kernel_sources(MODULES)  # coupled.py calls a formula of it


def test_imports_of_sources_are_sources_and_packages_around_them_are_not():
    modules = {"tasks.a": b"import tasks.c.d", "tasks.b": b"compiled(f)", "tasks.c": b"", "tasks.c.d": b""}
    assert kernel_sources(modules).keys() == {"tasks.b"}
    modules["tasks.b"] += b"\nfrom tasks import a"
    assert kernel_sources(modules).keys() == {"tasks.a", "tasks.b", "tasks.c.d"}


@pytest.mark.parametrize(
    "name", ["world.flowing_slush", "world.randomised_slush", "residual.training", "evolution.afpo"]
)
def test_an_edit_of_another_module_compiles_nothing(name):
    """Such as a medium, which a registry finds in its folder."""
    edited = {**MODULES, f"tasks.{name}": b"from tasks.world.slush import Slush"}
    assert kernel_sources(edited) == kernel_sources(MODULES)


def test_a_medium_with_a_kernel_of_its_own_is_a_source():
    own = {"tasks.world.honey": b"push = compiled(_push, seconds=1)"}
    assert kernel_sources({**MODULES, **own}) == kernel_sources(MODULES) | own


def doubled(x):
    return 2 * x


@pytest.fixture
def compile_and_call(tmp_path, monkeypatch, capsys):
    """Call a new kernel as a new process would; return what was said."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    cached = kernels.cache_folder, kernels.checked_folder, kernels._warn

    def call() -> str:
        for function in cached:
            function.cache_clear()
        assert compiled(doubled, seconds=1)(21) == 42
        return capsys.readouterr().err

    yield call
    for function in cached:
        function.cache_clear()


def flip(path):
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


@pytest.mark.parametrize("name", ["*.nbc", "*.nbi", "digests.json"])
@pytest.mark.parametrize(
    "damage",
    [flip, lambda path: path.write_bytes(path.read_bytes()[:-2]), lambda path: path.write_bytes(b""), Path.unlink],
    ids=["flipped bit", "cut", "empty", "gone"],
)
def test_a_damaged_cache_is_discarded_with_one_line(compile_and_call, tmp_path, name, damage):
    assert compile_and_call().count("compiling") == 1
    assert compile_and_call() == ""
    (path,) = tmp_path.glob(f"*/*/{name}")
    damage(path)
    assert not kernels.is_sound(path.parent)
    said = compile_and_call()
    assert said.count(f"the compiled kernels in {path.parent} are damaged") == 1 and said.count("compiling") == 1
    assert kernels.is_sound(path.parent) and compile_and_call() == ""


def test_what_is_compiled_takes_no_more_time(compile_and_call, monkeypatch):
    monkeypatch.setattr(kernels, "needed_kernels", lambda physics: [doubled])
    compile_and_call()
    assert kernels.seconds_to_compile(Physics()) == 0
    kernels.cache_folder.cache_clear()
    shutil.rmtree(kernels.cache_folder())
    assert kernels.seconds_to_compile(Physics()) == 1


def test_without_a_home_kernels_are_kept_among_temporary_files(tmp_path, monkeypatch):
    """A home that is missing below a file can't be made, like one below a folder of others."""
    for name in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    (tmp_path / "file").touch()
    monkeypatch.setenv("HOME", str(tmp_path / "file" / "home"))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    assert kernels.users_folder().parent == tmp_path
