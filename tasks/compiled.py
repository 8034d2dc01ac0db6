"""Kernels that are compiled once per machine, and again when their source changes.

Compiled code lies in the user's cache, or in NUMBA_CACHE_DIR if that is set, in a folder that is named by a digest of
what the kernel is compiled from: the modules that it reaches, and the values of their constants. numba's own cache
would miss edits of modules that the kernel calls, compile copies of a file again, such as those that Ray makes for each
session, and run whatever it finds on the disk.
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
import platform
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from types import CodeType, FunctionType, ModuleType
from typing import Any, TypeVar, cast

import numba
import numpy as np
from numba.core import compiler, serialize
from numba.core.caching import NullCache
from numba.core.event import Listener, register

F = TypeVar("F", bound=Callable[..., Any])


_KERNELS: dict[Callable[..., Any], int] = {}
"""About how long each kernel takes to compile [s], by its Python function."""


class _Announcement(Listener):  # type: ignore[misc]  # numba has no types
    """Prints a line when a kernel is compiled because it was not in the cache."""

    def on_start(self, event: Any) -> None:
        function = event.data["dispatcher"].py_func
        if function in _KERNELS:
            about = f"once, about {_KERNELS[function]} s"
            print(f"compiling {function.__module__} ({about})", file=sys.stderr, flush=True)

    def on_end(self, event: Any) -> None:
        pass


register("numba:compile", _Announcement())


_LONGEST_WAIT = 600.0  # time to wait for another process's compilation before compiling as well [s]
_WAIT_IN_SILENCE = 60.0  # time after which the user learns for which process this one waits [s]


class _KernelCache(NullCache):  # type: ignore[misc]
    """The compiled code of a kernel, a file per machine and types of arguments, behind the SHA-256 of its content.

    While one process compiles, the others wait for its result. A file that is damaged is compiled again, and a folder
    that can't be written costs compilation in every process; neither changes a result.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function = function
        self._lock: int | None = None

    @functools.cached_property
    def base(self) -> str:
        """Path of the kernel's files, without what tells them apart."""
        folder = os.path.join(cache_folder(), fingerprint(self._function)[:16])
        return os.path.join(folder, self._function.__name__)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the kernel for a signature, or None; then this process holds the lock and is to compile it."""
        target_context.refresh()
        path = self._path(sig, target_context.codegen())
        found = _read(path, target_context)
        if found is None and self._lock is None:
            self._lock = _locked(f"{self.base}.lock")
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
        return f"{self.base}-{hashlib.sha256(what.encode()).hexdigest()[:16]}.kernel"

    def _unlock(self) -> None:
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None


def _read(path: str, target_context: Any) -> Any:
    """Return a kept kernel; None if there is none or it is damaged."""
    try:
        content = _content(path)
    except FileNotFoundError:
        return None
    except OSError as error:
        _warn(f"a compiled kernel can't be read and is compiled again: {error}")
        return None
    if content is None:
        _warn(f"the compiled kernel {path} is damaged and is compiled again")
        return None
    return compiler.CompileResult._rebuild(target_context, *pickle.loads(content))


def _content(path: str) -> bytes | None:
    """Read the content of a kernel's file; None if it is not what its digest says."""
    with open(path, "rb") as file:
        digest, content = file.read(32), file.read()
    return content if hashlib.sha256(content).digest() == digest else None


@functools.cache
def _warn(message: str) -> None:
    """Print a message, once."""
    print(message, file=sys.stderr, flush=True)


def _locked(path: str) -> int | None:
    """Lock a file and return its descriptor; None where files can't be locked, or another process takes too long."""
    start = time.monotonic()
    with contextlib.suppress(OSError):
        os.makedirs(os.path.dirname(path), mode=0o700, exist_ok=True)
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        while time.monotonic() < start + _LONGEST_WAIT:
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                if time.monotonic() > start + _WAIT_IN_SILENCE:
                    holder = os.pread(descriptor, 1000, 0).decode(errors="replace")
                    _warn(f"waiting for {holder}, which compiles {path}; for {_LONGEST_WAIT / 60:.0f} minutes at most")
                time.sleep(0.1)
            except OSError:
                break
            else:
                with contextlib.suppress(OSError):  # the disk may be full
                    os.ftruncate(descriptor, 0)
                    command = ascii(" ".join(sys.argv))
                    os.pwrite(descriptor, f"process {os.getpid()} on {platform.node()} ({command})".encode(), 0)
                return descriptor
        os.close(descriptor)
    return None


def compiled(function: Callable[..., Any], *, seconds: int) -> Callable[..., Any]:
    """Return a kernel that is compiled on its first call, or loaded from the cache.

    Args:
        function: kernel; no closure, because numba's cache never finds a closure again.
        seconds: about how long compilation takes, for the announcement.

    Raises:
        ValueError: the kernel is a closure.
    """
    if function.__closure__ is not None:
        raise ValueError(f"{function.__qualname__} is a closure, expected a function of a module")
    if numba.config.DISABLE_JIT:
        return function
    kernel = numba.njit(error_model="numpy")(function)
    kernel._cache = _KernelCache(function)
    _KERNELS[function] = seconds
    return cast(Callable[..., Any], kernel)


def uncompiled_kernels() -> dict[str, int]:
    """Return about how long each kernel takes to compile [s] that this machine has not compiled yet, by its name.

    Only the kernels of modules that this process has imported are known.
    """
    return {
        f"{function.__module__}.{function.__name__}": seconds
        for function, seconds in _KERNELS.items()
        if not glob.glob(f"{glob.escape(_KernelCache(function).base)}-*.kernel")
    }


def check_cache() -> dict[str, bool]:
    """Check every file of the cache, those of kernels that this process does not use included.

    Returns:
        Whether each compiled kernel can be read and is what its digest says, by its path.
    """
    sound = {}
    for path in glob.glob(os.path.join(glob.escape(cache_folder()), "*", "*.kernel")):
        sound[path] = False
        with contextlib.suppress(OSError):
            sound[path] = _content(path) is not None
    return sound


def inline(function: F) -> F:
    """Mark a function that is compiled into its callers."""
    return cast(F, numba.njit(forceinline=True, error_model="numpy")(function))


def fingerprint(function: Callable[..., Any]) -> str:
    """Return a digest of all that a kernel is compiled from: sources of modules, and values of constants."""
    modules, constants = dependencies(function)
    sources = [inspect.getsource(sys.modules[name]) for name in sorted(modules | {__name__})]
    return hashlib.sha256("\0".join([*sources, *sorted(constants)]).encode()).hexdigest()


def dependencies(function: Callable[..., Any]) -> tuple[set[str], set[str]]:
    """Find what a kernel is compiled from, by following the names in its code.

    Args:
        function: the kernel's Python function. Only modules of its own top-level package are followed.

    Returns:
        The names of the modules whose functions it reaches, or that teach numba to compile these; and a line for each
        constant that they use.
    """
    package = function.__module__.partition(".")[0]
    modules: set[str] = set()
    constants: set[str] = set()
    followed: set[int] = set()
    left: list[Any] = [function]
    while left:
        one = left.pop()
        # numba's and functools' wrappers have the function that they wrap
        one = getattr(one, "py_func", None) or getattr(one, "_defn", None) or getattr(one, "__wrapped__", one)
        if not isinstance(one, FunctionType) or id(one) in followed or one.__module__.partition(".")[0] != package:
            continue
        followed.add(id(one))
        modules.add(one.__module__)
        for name, value in _globals_in(one):
            if isinstance(value, np.ndarray):
                constants.add(f"{name} = {value.dtype} {value.tolist()}")
            elif isinstance(value, _CONSTANTS):
                constants.add(f"{name} = {value!r}")
            else:
                left.append(value)
    for name, module in sys.modules.copy().items():  # another thread may import meanwhile
        if name.partition(".")[0] == package:
            used = _modules_in(module)
            if "llvmlite.ir" in used and used & modules:  # it writes the instructions of their functions
                modules.add(name)
    return modules, constants


_CONSTANTS = (bool, int, float, str, tuple, np.generic, np.dtype)  # what numba compiles by value, besides arrays


def _globals_in(function: FunctionType) -> Iterator[tuple[str, Any]]:
    """Yield the globals that a function's code names, and those of modules that it names, with their values."""
    codes, names = [function.__code__], set[str]()
    while codes:
        code = codes.pop()
        names |= set(code.co_names)
        codes += [constant for constant in code.co_consts if isinstance(constant, CodeType)]
    for name in names & function.__globals__.keys():
        value = function.__globals__[name]
        yield name, value
        if isinstance(value, ModuleType):
            yield from ((attribute, vars(value)[attribute]) for attribute in names & vars(value).keys())
    for cell in function.__closure__ or ():
        yield "cell", cell.cell_contents


def _modules_in(module: ModuleType) -> set[str]:
    """Return the names of the modules among a module's globals."""
    return {value.__name__ for value in vars(module).values() if isinstance(value, ModuleType)}


def cache_folder() -> str:
    """Find a writable folder for compiled kernels: one of this process alone where there is no other."""
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
