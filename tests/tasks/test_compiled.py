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
import tempfile
from program import inner
from tasks import compiled as compilation
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
from tasks import compiled as compilation
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


@pytest.mark.parametrize(
    "damage",
    [flip, lambda path: path.write_bytes(path.read_bytes()[:-1]), lambda path: path.write_bytes(b"")],
    ids=["flipped bit", "cut", "empty"],
)
def test_a_damaged_kernel_is_compiled_again(compile_and_call, damage):
    said, kept = compile_and_call()
    assert "compiling" in said
    assert compile_and_call() == ("", kept)
    damage(kept)
    said, _ = compile_and_call()
    assert f"the compiled kernel {kept} is damaged and is compiled again" in said and said.count("compiling") == 1
    assert compile_and_call() == ("", kept)


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


def test_without_a_home_kernels_are_kept_among_temporary_files(tmp_path, monkeypatch):
    """A home that is missing below a file can't be made, like one below a folder of others."""
    for name in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    (tmp_path / "file").touch()
    monkeypatch.setenv("HOME", str(tmp_path / "file" / "home"))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    assert Path(compilation.cache_folder()).parent == tmp_path
