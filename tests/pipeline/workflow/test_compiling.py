"""Compilation of the kernels while the cluster starts."""

import psutil
import pytest

from pipeline.workflow.compiling import compiling
from tasks.world import Physics


def test_the_compiling_process_ends_with_a_study_that_fails() -> None:
    before = set(psutil.Process().children())
    with pytest.raises(ZeroDivisionError), compiling(Physics()):
        (process,) = set(psutil.Process().children()) - before
        assert process.is_running()
        raise ZeroDivisionError
    assert not process.is_running()
