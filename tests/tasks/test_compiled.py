"""What is compiled once, and again when its source changes."""

import os
import subprocess
import sys

import numba
import pytest

from tasks.compiled import compiled

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
    """Run a kernel that calls a function of another module; return its result and whether it was compiled."""

    def run(factor, *arguments, folder="here"):
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
        done = subprocess.run(
            [sys.executable, str(place / "outer.py"), *arguments],
            env=environment,
            capture_output=True,
            text=True,
            check=True,
        )
        return done.stdout.split(), done.stderr.count("compiling outer (once, about 1 s)")

    return run


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
