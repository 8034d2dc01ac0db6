"""What is compiled once, and again when its source changes."""

import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numba
import pytest

from tasks import compiled as compilation
from tasks.compiled import _warn, compiled, dependencies, fingerprint
from tasks.design import genes
from tasks.simulation import box2d
from tasks.simulation.trees import layout, step

ROOT = Path(__file__).parents[2]

pytestmark = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="there is no compiler")

OUTER = """
import sys
from program import inner
from tasks.compiled import compiled, uncompiled_kernels
def kernel(x):
    return inner.scaled(x)
if __name__ == "__main__":
    from program import outer
    kernel = compiled(outer.kernel, seconds=1)
    cached = not uncompiled_kernels()
    print(kernel(2.0 if len(sys.argv) == 1 else 2), cached)
"""

INNER = """
from tasks.compiled import inline
@inline
def scaled(x):
    return x * {}
"""


@pytest.fixture
def run(tmp_path):
    """Run a kernel that calls a function of another module; return its result and how often it was compiled."""

    def run(factor, *arguments, folder="here", others=0):
        place = tmp_path / folder / "program"
        place.mkdir(parents=True, exist_ok=True)
        (place / "outer.py").write_text(OUTER)
        (place / "inner.py").write_text(INNER.format(factor))
        environment = {
            **os.environ,
            "NUMBA_CACHE_DIR": str(tmp_path / "cache"),
            "PYTHONPATH": os.pathsep.join([str(place.parent), *sys.path]),
            "PYTHONDONTWRITEBYTECODE": "1",
        }
        command = [sys.executable, str(place / "outer.py"), *arguments]
        beside = [subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True) for _ in range(others)]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        said = done.stderr + "".join(process.communicate()[1] for process in beside)
        return done.stdout.split(), said.count("compiling program.outer (once, about 1 s)")

    return run


def doubled(x):
    return 2 * x


@pytest.fixture
def compile_and_call(tmp_path, monkeypatch, capsys):
    """Call a new kernel as a new process would; return what was said, and the file that is kept."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))

    def call() -> tuple[str, Path]:
        _warn.cache_clear()
        assert compiled(doubled, seconds=1)(21) == 42
        (kept,) = tmp_path.glob("*/*/doubled-*.kernel")
        return capsys.readouterr().err, kept

    return call


def flip(path):
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


def test_who_waits_for_a_compilation_learns_which_process_compiles(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(compilation, "_WAIT_IN_SILENCE", 0.1)
    monkeypatch.setattr(compilation, "_LONGEST_WAIT", 0.5)
    held = compilation._locked(str(tmp_path / "doubled.lock"))
    assert compilation._locked(str(tmp_path / "doubled.lock")) is None  # it compiles as well
    os.close(held)
    assert f"waiting for process {os.getpid()} on " in capsys.readouterr().err


@pytest.mark.parametrize(
    "damage",
    [flip, lambda path: path.write_bytes(path.read_bytes()[:-1]), lambda path: path.write_bytes(b"")],
    ids=["flipped bit", "cut", "empty"],
)
def test_a_damaged_kernel_is_compiled_again(compile_and_call, damage):
    said, kept = compile_and_call()
    assert "compiling" in said
    before = kept.read_bytes()
    assert compile_and_call() == ("", kept)
    damage(kept)
    said, _ = compile_and_call()
    assert f"the compiled kernel {kept} is damaged and is compiled again" in said and said.count("compiling") == 1
    assert len(kept.read_bytes()) == len(before)
    assert compile_and_call() == ("", kept)


def test_without_a_home_kernels_are_kept_among_temporary_files(tmp_path, monkeypatch):
    """A home that is missing below a file can't be made, like one below a folder of others."""
    for name in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    (tmp_path / "file").touch()
    monkeypatch.setenv("HOME", str(tmp_path / "file" / "home"))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    assert Path(compilation.cache_folder()).parent == tmp_path


def test_a_kernel_that_can_be_neither_read_nor_kept_is_compiled_every_time(compile_and_call):
    _, kept = compile_and_call()
    kept.unlink()
    kept.mkdir()
    for _ in range(2):
        said, _ = compile_and_call()
        assert "can't be read" in said and "compiling" in said and "could not be kept" in said


def test_processes_share_a_kernel_until_a_module_that_it_calls_is_edited(run):
    """Those that start together compile it once, and copies elsewhere take it too.

    On a cluster Ray unpacks the sources into a folder of each session.
    """
    result, n_compiled = run(10, others=3)
    assert result[0] == "20.0" and n_compiled == 1
    assert run(10, folder="elsewhere") == (["20.0", "True"], 0)
    assert run(30, folder="elsewhere") == (["60.0", "False"], 1)
    assert run(30) == (["60.0", "True"], 0)
    assert run(10) == (["20.0", "True"], 0)
    assert run(10, "whole") == (["20", "True"], 1)  # for other arguments it is compiled again, and says so


def test_a_closure_is_no_kernel():
    shift = 1.0

    def shifted(block):
        block[0] = block[0] + shift

    with pytest.raises(ValueError, match=r"shifted is a closure, expected a function of a module"):
        compiled(shifted, seconds=1)


# -- what a kernel is compiled from ----------------------------------------------------------------------------------

EDITED = """
import json, linecache, sys
from tasks import compiled
from tasks.simulation import batch

def fingerprints():
    linecache.clearcache()
    return {f"{kernel.__module__}.{kernel.__name__}": compiled.fingerprint(kernel) for kernel in compiled._KERNELS}

before = fingerprints()
reached = {f"{kernel.__module__}.{kernel.__name__}": compiled.dependencies(kernel)[0] for kernel in compiled._KERNELS}
changed = {}
for module in sorted({"tasks.world.registry"}.union(*reached.values())):
    with open(sys.modules[module].__file__, "a") as file:
        file.write("# edited\\n")
    after = fingerprints()
    changed[module] = sorted(kernel for kernel in after if after[kernel] != before[kernel])
    before = after
json.dump([{kernel: sorted(modules) for kernel, modules in reached.items()}, changed], sys.stdout)
"""


def test_an_edit_of_any_module_compiles_the_kernels_that_reach_it_and_no_other(tmp_path):
    shutil.copytree(ROOT / "tasks", tmp_path / "tasks")
    environment = os.environ | {"PYTHONPATH": str(tmp_path)}
    words = [sys.executable, "-c", EDITED]
    done = subprocess.run(words, env=environment, cwd=tmp_path, capture_output=True, text=True, check=True)
    reached, changed = json.loads(done.stdout)
    assert len(reached) >= 13 and len(changed) >= 18
    assert changed.pop("tasks.world.registry") == []  # no kernel reaches it
    for module, kernels in changed.items():
        assert kernels == sorted(kernel for kernel, modules in reached.items() if module in modules), module


@pytest.mark.parametrize(("module", "constant"), [(layout, "OMEGA"), (box2d, "BAUMGARTE"), (genes, "N_LINKS")])
def test_another_value_of_a_constant_is_another_kernel(module, constant, monkeypatch):
    """Its module may do without functions that the kernel calls."""
    kernel = step.advance if module is not genes else genes.find_fault
    before = fingerprint(kernel)
    value = getattr(module, constant)
    for namespace in (module, *(sys.modules[name] for name in dependencies(kernel)[0])):
        if getattr(namespace, constant, None) is value:
            monkeypatch.setattr(namespace, constant, type(value)(2 * value))
    assert fingerprint(kernel) != before


CALLED = """
import json, sys
import numpy as np
from tasks.compiled import dependencies
from tasks.design import random_designs
from tasks.simulation import simulate
from tasks.simulation.rigid_bodies import step as bodies
from tasks.simulation.trees import step as trees
from tasks.world import DryLand, Physics

kernels = {trees.advance.__code__: set(), bodies.advance_robots.__code__: set()}
inside = []

def note(frame, event, argument):
    if event == "call":
        if frame.f_code in kernels:
            inside.append(frame.f_code)
        elif inside:
            kernels[inside[-1]].add(frame.f_globals["__name__"])
    elif event == "return" and inside and frame.f_code is inside[-1]:
        inside.pop()

designs = random_designs(1, np.random.default_rng(1))
for physics in (Physics(), Physics(link_collisions=True)):
    sys.setprofile(note)
    simulate(designs, DryLand(0.0), physics=physics, n_settle=0, n_measure=8, engine="batch")
    sys.setprofile(None)
called = [sorted(name for name in names if name.startswith("tasks.")) for names in kernels.values()]
print(json.dumps([called, [sorted(dependencies(kernel)[0]) for kernel in (trees.advance, bodies.advance_robots)]]))
"""


def test_what_a_kernel_calls_in_plain_python_is_among_what_it_is_compiled_from():
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1", "PYTHONPATH": str(ROOT)}
    words = [sys.executable, "-c", CALLED]
    done = subprocess.run(words, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    for called, found in zip(*json.loads(done.stdout), strict=True):
        assert len(called) >= 4 and set(called) <= set(found)
