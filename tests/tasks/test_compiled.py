"""What is compiled once, and again when its source changes."""

import os
import subprocess
import sys
from pathlib import Path

import numba
import pytest

from tasks.compiled import _warn, compiled

pytestmark = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="there is no compiler")

OUTER = """
import sys, inner
from tasks.compiled import compiled, is_cached
def kernel(x):
    return inner.scaled(x)
if __name__ == "__main__":
    import outer
    kernel = compiled(outer.kernel, [outer, inner], seconds=1)
    cached = is_cached(kernel)
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
            "PYTHONPATH": os.pathsep.join([str(place), *sys.path]),
            "PYTHONDONTWRITEBYTECODE": "1",
        }
        command = [sys.executable, str(place / "outer.py"), *arguments]
        beside = [subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True) for _ in range(others)]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        said = done.stderr + "".join(process.communicate()[1] for process in beside)
        return done.stdout.split(), said.count("compiling outer (once, about 1 s)")

    return run


def test_processes_that_start_together_compile_once(run):
    result, n_compiled = run(10, others=3)
    assert result[0] == "20.0" and n_compiled == 1


def doubled(x):
    return 2 * x


@pytest.fixture
def compile_and_call(tmp_path, monkeypatch, capsys):
    """Call a new kernel as a new process would; return what was said, and the file that is kept."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))

    def call() -> tuple[str, Path]:
        _warn.cache_clear()
        assert compiled(doubled, [sys.modules[__name__]], seconds=1)(21) == 42
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
    before = kept.read_bytes()
    assert compile_and_call() == ("", kept)
    damage(kept)
    said, _ = compile_and_call()
    assert f"the compiled kernel {kept} is damaged and is compiled again" in said and said.count("compiling") == 1
    assert len(kept.read_bytes()) == len(before)
    assert compile_and_call() == ("", kept)


def test_a_kernel_that_can_be_neither_read_nor_kept_is_compiled_every_time(compile_and_call):
    _, kept = compile_and_call()
    kept.unlink()
    kept.mkdir()
    for _ in range(2):
        said, _ = compile_and_call()
        assert "can't be read" in said and "compiling" in said and "could not be kept" in said


def test_an_edit_of_a_module_that_a_kernel_calls_is_not_served_from_the_cache(run):
    assert run(10) == (["20.0", "False"], 1)
    assert run(10) == (["20.0", "True"], 0)
    assert run(30) == (["60.0", "False"], 1)
    assert run(10) == (["20.0", "True"], 0)
    assert run(10, "whole") == (["20", "True"], 1)  # for other arguments it is compiled again, and says so


def test_a_copy_elsewhere_takes_the_same_kernel(run):
    """As on a cluster, where Ray unpacks the sources into a folder of each session."""
    assert run(10) == (["20.0", "False"], 1)
    assert run(10, folder="elsewhere") == (["20.0", "True"], 0)
    assert run(30, folder="elsewhere") == (["60.0", "False"], 1)
    assert run(10, folder="elsewhere") == (["20.0", "True"], 0)


def test_a_closure_is_no_kernel():
    shift = 1.0

    def shifted(block):
        block[0] = block[0] + shift

    with pytest.raises(ValueError, match=r"shifted is a closure, expected a function of a module"):
        compiled(shifted, [], seconds=1)
