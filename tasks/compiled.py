"""Kernels that are compiled once per machine, and again when their source changes.

numba's disk cache depends on path and content of the file that defines a function. It misses edits of other modules
that the function calls, and compiles copies of the file again, such as those that Ray makes for each session. So the
cache folder is named by a digest of all modules that a kernel is compiled from. It is in the user's cache, which all
processes of a machine share, or in NUMBA_CACHE_DIR if that is set. The package itself may be read-only.
"""

# ruff: noqa: PTH100, PTH103, PTH111, PTH116, PTH118, PTH119, PTH120, PTH207 (tasks import no pathlib)

import glob
import hashlib
import inspect
import os
import sys
import tempfile
from collections.abc import Callable, Sequence
from types import ModuleType
from typing import Any, TypeVar, cast

import numba
from numba.core.caching import UserProvidedCacheLocator
from numba.core.event import Listener, register

F = TypeVar("F", bound=Callable[..., Any])


_KERNELS: dict[Callable[..., Any], tuple[str, int]] = {}
"""Cache folder of each kernel, by its Python function, and about how long it takes to compile [s]."""


class _Announcement(Listener):  # type: ignore[misc]  # numba has no types
    """Prints a line when a kernel is compiled because it was not in the cache."""

    def on_start(self, event: Any) -> None:
        function = event.data["dispatcher"].py_func
        if function in _KERNELS:
            _, seconds = _KERNELS[function]
            print(f"compiling {function.__module__} (once, about {seconds} s)", file=sys.stderr, flush=True)

    def on_end(self, event: Any) -> None:
        pass


register("numba:compile", _Announcement())


class ByContent(UserProvidedCacheLocator):  # type: ignore[misc]
    """Path of a kernel within its cache folder, independent of the path of its module."""

    @classmethod
    def get_suitable_cache_subpath(cls, py_file: str) -> str:
        """Return the name of the module's package."""
        return os.path.basename(os.path.dirname(os.path.abspath(py_file)))


def compiled(function: Callable[..., Any], sources: Sequence[ModuleType], *, seconds: int) -> Callable[..., Any]:
    """Return a kernel that is compiled on its first call, or loaded from the cache.

    Args:
        function: kernel; no closure, because numba's cache never finds a closure again.
        sources: modules whose code or constants the kernel is compiled from.
        seconds: about how long compilation takes, for the announcement.

    Raises:
        ValueError: the kernel is a closure.
    """
    if function.__closure__ is not None:
        raise ValueError(f"{function.__qualname__} is a closure, expected a function of a module")
    if numba.config.DISABLE_JIT:
        return function
    read = [sys.modules[__name__], *sources]  # this module decides on inlining
    digest = hashlib.sha256("\0".join(inspect.getsource(module) for module in read).encode()).hexdigest()
    folder = os.path.join(_cache_folder(), digest[:16])
    before = numba.config.CACHE_DIR, numba.config.CACHE_LOCATOR_CLASSES
    numba.config.CACHE_DIR = folder  # numba reads both when it decorates
    numba.config.CACHE_LOCATOR_CLASSES = f"{__name__}.{ByContent.__name__}"
    try:
        kernel = numba.njit(error_model="numpy", cache=True)(function)
    finally:
        numba.config.CACHE_DIR, numba.config.CACHE_LOCATOR_CLASSES = before

    _KERNELS[function] = folder, seconds
    return cast(Callable[..., Any], kernel)


def is_cached(kernel: Callable[..., Any]) -> bool:
    """Return whether a kernel has been compiled on this machine before, for some types of arguments."""
    function = getattr(kernel, "py_func", None)
    if function not in _KERNELS:
        return True  # there is no compiler
    folder, _ = _KERNELS[function]
    return bool(glob.glob(os.path.join(folder, "*", f"*.{function.__name__}-*.nbc")))


def inline(function: F) -> F:
    """Mark a function that is compiled into its callers."""
    return cast(F, numba.njit(forceinline=True, error_model="numpy")(function))


def _cache_folder() -> str:
    """Find a writable folder for compiled kernels."""
    chosen = os.environ.get("NUMBA_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    for folder in (chosen, tempfile.gettempdir()):
        own = os.path.join(folder, f"puddle-{os.getuid()}")
        try:
            os.makedirs(own, mode=0o700, exist_ok=True)
            if os.stat(own).st_uid == os.getuid() and os.access(own, os.W_OK):  # code is run: the user's own only
                return own
        except OSError:
            continue
    return tempfile.mkdtemp(prefix="puddle-")
