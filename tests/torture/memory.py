"""A limit on the memory that a test takes."""

import contextlib
from pathlib import Path

MEGABYTE = 2**20


@contextlib.contextmanager
def memory_below(n_bytes: int):
    """Check that the memory of this process does not grow by more than this."""
    Path("/proc/self/clear_refs").write_text("5")  # resets the peak to the present use
    before = _peak()
    yield
    assert _peak() - before < n_bytes


def _peak() -> int:
    (line,) = (line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmHWM"))
    return 1024 * int(line.split()[1])
