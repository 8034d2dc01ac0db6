"""Compilation of the kernels beside the first stages of a study."""

import contextlib
import subprocess
import sys
from collections.abc import Iterator

from tasks.world import Physics


@contextlib.contextmanager
def compiling(physics: Physics) -> Iterator[None]:
    """Compile the kernels that this machine lacks in another process, for as long as the context lasts.

    A worker that needs a kernel meanwhile waits for it, and compiles it itself if that process has failed. The other
    machines of a cluster compile their own.

    Args:
        physics: constants of the base simulator, which decide on the kernels.
    """
    process = subprocess.Popen(
        [sys.executable, "-m", "tasks.evolution.compilation", physics.model_dump_json()],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,  # so that Ctrl-C reaches the study alone, which ends this process
    )
    try:
        yield
    finally:
        process.terminate()
        process.wait()
