"""Kernels that are compiled once per machine, and again when their source changes.

Compiled code lies in the user's cache, or in NUMBA_CACHE_DIR if that is set, in a folder that is named by a digest of
all modules that a kernel is compiled from. numba's own cache would miss edits of modules that the kernel calls, compile
copies of a file again, such as those that Ray makes for each session, and run whatever it finds on the disk.
"""

# ruff: noqa: PTH103, PTH105, PTH111, PTH116, PTH118, PTH120, PTH123, PTH207 (tasks import no pathlib)

import contextlib
import fcntl
import functools
import glob
import hashlib
import inspect
import os
import pickle
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from types import ModuleType
from typing import Any, TypeVar, cast

import numba
from numba.core import compiler, serialize
from numba.core.caching import NullCache
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


_LONGEST_WAIT = 600.0  # time to wait for another process's compilation before compiling as well [s]


class _KernelCache(NullCache):  # type: ignore[misc]
    """The compiled code of a kernel, a file per machine and types of arguments, behind the SHA-256 of its content.

    While one process compiles, the others wait for its result. A file that is damaged is compiled again, and a folder
    that can't be written costs compilation in every process; neither changes a result.
    """

    def __init__(self, function: Callable[..., Any], folder: str) -> None:
        self._base = os.path.join(folder, function.__name__)
        self._lock: int | None = None

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the kernel for a signature, or None; then this process holds the lock and is to compile it."""
        target_context.refresh()
        path = self._path(sig, target_context.codegen())
        found = _read(path, target_context)
        if found is None and self._lock is None:
            self._lock = _locked(f"{self._base}.lock")
            found = _read(path, target_context)
            if found is not None:
                self._unlock()
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep the compiled kernel and let other processes have it."""
        content = serialize.dumps(data._reduce())
        path = self._path(sig, data.codegen)
        try:
            descriptor, draft = tempfile.mkstemp(dir=os.path.dirname(path))
            try:
                with os.fdopen(descriptor, "wb") as file:
                    file.write(hashlib.sha256(content).digest() + content)
                    file.flush()
                    os.fsync(descriptor)
                os.replace(draft, path)
            except OSError:
                os.unlink(draft)  # noqa: PTH108
                raise
        except OSError as error:
            _warn(f"a compiled kernel could not be kept for the next process: {error}")
        self._unlock()

    def _path(self, signature: Any, codegen: Any) -> str:
        what = repr((numba.__version__, sys.version_info, str(signature), codegen.magic_tuple()))
        return f"{self._base}-{hashlib.sha256(what.encode()).hexdigest()[:16]}.kernel"

    def _unlock(self) -> None:
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None


def _read(path: str, target_context: Any) -> Any:
    """Return a kept kernel; None if there is none or it is damaged."""
    try:
        with open(path, "rb") as file:
            digest, content = file.read(32), file.read()
    except FileNotFoundError:
        return None
    except OSError as error:
        _warn(f"a compiled kernel can't be read and is compiled again: {error}")
        return None
    if hashlib.sha256(content).digest() != digest:
        _warn(f"the compiled kernel {path} is damaged and is compiled again")
        return None
    return compiler.CompileResult._rebuild(target_context, *pickle.loads(content))


@functools.cache
def _warn(message: str) -> None:
    """Print a message, once."""
    print(message, file=sys.stderr, flush=True)


def _locked(path: str) -> int | None:
    """Lock a file and return its descriptor; None where files can't be locked, or another process takes too long."""
    end = time.monotonic() + _LONGEST_WAIT
    with contextlib.suppress(OSError):
        os.makedirs(os.path.dirname(path), mode=0o700, exist_ok=True)
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        while time.monotonic() < end:
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                time.sleep(0.1)
            except OSError:
                break
            else:
                return descriptor
        os.close(descriptor)
    return None


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
    kernel = numba.njit(error_model="numpy")(function)
    kernel._cache = _KernelCache(function, folder)
    _KERNELS[function] = folder, seconds
    return cast(Callable[..., Any], kernel)


def is_cached(kernel: Callable[..., Any]) -> bool:
    """Return whether a kernel has been compiled on this machine before, for some types of arguments."""
    function = getattr(kernel, "py_func", None)
    if function not in _KERNELS:
        return True  # there is no compiler
    folder, _ = _KERNELS[function]
    return bool(glob.glob(os.path.join(folder, f"{function.__name__}-*.kernel")))


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
