"""The science: what one unit of work computes. No files, no Ray, no MLflow; arrays in, arrays out."""

from collections.abc import Callable
from typing import Any

open_kernel_cache: Callable[[Callable[..., Any]], Any] | None = None
"""Returns the cache of a compiled kernel, given its Python function. Unless the pipeline sets it (pipeline/kernels.py),
every process compiles its kernels."""
