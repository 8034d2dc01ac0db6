"""Compilation of the kernels beside the first stages."""

import psutil

from pipeline.workflow.compiling import compiling
from tasks.world import Physics


def test_the_compiling_process_ends_with_the_study() -> None:
    with compiling(Physics()):
        (process,) = (one for one in psutil.Process().children() if "tasks.evolution.compilation" in one.cmdline())
        assert process.is_running()
    assert not process.is_running()
