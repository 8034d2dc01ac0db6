"""Everything around the science: how a study is spread over machines, kept, resumed, tracked and shown."""

from collections.abc import Callable
from typing import Any

from tasks import kernel_cache


def _open_cache(function: Callable[..., Any]) -> Any:
    from pipeline.kernels import KernelCache  # imports numba, which a command need not do

    return KernelCache(function)


kernel_cache.open_cache = _open_cache  # in whatever process imports this package: a user's, the driver's, a worker's
