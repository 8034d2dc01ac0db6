"""The cache of compiled kernels, which this package does not open: it touches no disk.

pipeline/kernels.py sets how to open it. Without that, every process compiles its kernels.
"""

from collections.abc import Callable
from typing import Any

open_cache: Callable[[Callable[..., Any]], Any] | None = None
"""Returns numba's cache of a kernel, given its Python function."""
