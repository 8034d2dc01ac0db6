"""Kernels compiled once per machine, and again when their source changes.

numba keys its cache on disk by the file of the function itself: where that lies, and what it holds. It does not see an
edit of another module that the function calls, and a copy elsewhere, such as Ray makes for each session on a cluster,
would be compiled anew. So the folder of the cache is named by a digest of all the modules that go into a kernel, not
by their place. It lies in the user's cache, which all processes of a machine share, or in NUMBA_CACHE_DIR if that is
set, and needs no write access to the package.
"""

# (no pathlib in tasks, and this is the one place that keeps a file)

# ruff: noqa: PTH100, PTH103, PTH111, PTH116, PTH118, PTH119, PTH120, PTH207 (tasks import no pathlib)

from __future__ import annotations

import glob
import hashlib
import inspect
import os
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any, TypeVar, cast

import numba
from numba.core.caching import UserProvidedCacheLocator
from numba.core.event import Listener, register

F = TypeVar("F", bound=Callable[..., Any])


@dataclass(frozen=True)
class _Cached:
    """Where a kernel is kept, and about how long it takes to make."""

    folder: str
    seconds: int


_KERNELS: dict[Callable[..., Any], _Cached] = {}
"""By their functions in Python."""


class _Word(Listener):  # type: ignore[misc]  # numba has no types
    """Tells whoever waits that a kernel is being compiled: for these arguments it was not in the cache."""

    def on_start(self, event: Any) -> None:
        function = event.data["dispatcher"].py_func
        if function in _KERNELS:
            about = f"once, about {_KERNELS[function].seconds} s"
            print(f"compiling {function.__module__} ({about})", file=sys.stderr, flush=True)

    def on_end(self, event: Any) -> None:
        pass


register("numba:compile", _Word())


class ByContent(UserProvidedCacheLocator):  # type: ignore[misc]
    """Where numba keeps a kernel within its folder: the same wherever its module lies."""

    @classmethod
    def get_suitable_cache_subpath(cls, py_file: str) -> str:
        """Give the name of the module's package."""
        return os.path.basename(os.path.dirname(os.path.abspath(py_file)))


def compiled(function: Callable[..., Any], sources: Sequence[ModuleType], *, seconds: int) -> Callable[..., Any]:
    """Compile a kernel on its first call, or take it from the cache.

    Args:
        function: the kernel. A closure has another key in numba's cache in every process, and would never be found.
        sources: the modules whose code or constants go into it.
        seconds: about how long compilation takes, for a word to whoever waits.

    Raises:
        ValueError: the kernel is a closure.
    """
    if function.__closure__ is not None:
        raise ValueError(f"{function.__qualname__} is a closure, expected a function of a module")
    if numba.config.DISABLE_JIT:
        return function
    read = [sys.modules[__name__], *sources]  # how pieces are inlined counts too
    digest = hashlib.sha256("\0".join(inspect.getsource(module) for module in read).encode()).hexdigest()
    folder = os.path.join(_cache_folder(), digest[:16])
    before = numba.config.CACHE_DIR, numba.config.CACHE_LOCATOR_CLASSES
    numba.config.CACHE_DIR = folder  # numba reads both here, where the function is decorated
    numba.config.CACHE_LOCATOR_CLASSES = f"{__name__}.{ByContent.__name__}"
    try:
        kernel = numba.njit(error_model="numpy", cache=True)(function)
    finally:
        numba.config.CACHE_DIR, numba.config.CACHE_LOCATOR_CLASSES = before

    _KERNELS[function] = _Cached(folder, seconds)
    return cast(Callable[..., Any], kernel)


def is_cached(kernel: Callable[..., Any]) -> bool:
    """Tell whether a compiled kernel has been made before on this machine, for some arguments."""
    function = getattr(kernel, "py_func", None)
    if function not in _KERNELS:
        return True  # there is no compiler
    found = glob.glob(os.path.join(_KERNELS[function].folder, "*", f"*.{function.__name__}-*.nbc"))
    return bool(found)


def inline(function: F) -> F:
    """Mark a piece of a kernel: compiled into whatever calls it."""
    return cast(F, numba.njit(forceinline=True, error_model="numpy")(function))


def _cache_folder() -> str:
    """Find a folder for compiled kernels that can be written to."""
    chosen = os.environ.get("NUMBA_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    for folder in (chosen, tempfile.gettempdir()):
        own = os.path.join(folder, f"puddle-{os.getuid()}")
        try:
            os.makedirs(own, mode=0o700, exist_ok=True)
            if os.stat(own).st_uid == os.getuid() and os.access(own, os.W_OK):  # compiled code is trusted: ours alone
                return own
        except OSError:
            continue
    return tempfile.mkdtemp(prefix="puddle-")
