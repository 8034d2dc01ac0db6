"""Everything around the science: how a study is spread over machines, kept, resumed, tracked and shown."""

import os
from collections.abc import Callable
from typing import Any

import tasks


def _open_cache(function: Callable[..., Any]) -> Any:
    from pipeline.kernels import KernelCache  # imports numba, which a command need not do

    return KernelCache(function)


# In whatever process imports this package: a user's, the driver's, a worker's.
tasks.open_kernel_cache = _open_cache
if "PUDDLE_EXTENSIONS" in os.environ:
    from pipeline.extensions import import_given

    import_given()
