"""The cache of compiled kernels on this machine: a file for each, named by a digest of all that it follows from.

numba's own cache does not notice the edit of a module that a kernel calls. A kernel can be compiled from what its
module names, and no more. So its sources are its module and what that imports, at any depth; for a name that is
imported from a package, the package too, but not all of its modules. A medium that a registry finds in its folder, or a
file of a user's, is a source of its own law alone.
"""

import contextlib
import fcntl
import functools
import hashlib
import inspect
import os
import pickle
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numba
from numba.core.compiler import CompileResult
from numba.core.event import Listener, register
from numba.core.serialize import dumps

from pipeline.sources import Sources, imported_names, parsed, reached, read_modules
from tasks.compiled import KERNELS

_LANES = "tasks.simd.vectors"  # teaches numba what kernels call, without being imported by them


def sources_of(modules: Sources, names: set[str]) -> Sources:
    """Select some modules, and those that they import, at any depth."""
    imported = reached(names, lambda name: _imports(modules[name]) if name in modules else ())
    return {name: modules[name] for name in imported & modules.keys()}


@functools.cache
def _imports(source: bytes) -> list[str]:
    return [*imported_names(parsed(source))]


def kernel_sources(function: Callable[..., Any]) -> Sources:
    """Return what a kernel is compiled from: the modules of its code and of the laws in it, and their imports."""
    modules, names = read_modules("tasks"), {name for code in _with_laws(function) for name in code}
    own = {name: inspect.getsource(sys.modules[name]).encode() for name in names - modules.keys()}
    return sources_of(modules | own, names | {_LANES})


def _with_laws(function: Any) -> Iterator[tuple[str, str]]:
    yield function.__module__, function.__globals__["__name__"]
    if law := function.__globals__.get("LAW"):
        yield from _with_laws(getattr(law, "py_func", law))


def users_folder() -> Path:
    """Find a writable folder for compiled kernels: one of this process alone where there is no other."""
    chosen = os.environ.get("NUMBA_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    for folder in (chosen, tempfile.gettempdir()):
        with contextlib.suppress(OSError, RuntimeError):  # RuntimeError: a user without a home
            own = Path(folder).expanduser() / f"puddle-{os.getuid()}"
            own.mkdir(mode=0o700, parents=True, exist_ok=True)
            if own.stat().st_uid == os.getuid() and os.access(own, os.W_OK):  # code is run: the user's own only
                return own
    return Path(tempfile.mkdtemp(prefix="puddle-"))


@functools.cache
def _warn(message: str) -> None:
    """Print a message, once."""
    print(message, file=sys.stderr, flush=True)


_locks: dict[Callable[..., Any], Any] = {}  # open files of the kernels that this process compiles


def _lock(function: Callable[..., Any], file: Path) -> None:
    """Wait until no other process compiles a kernel, and keep others waiting; where a file can't be locked, do not."""
    with contextlib.suppress(OSError):
        _locks[function] = file.with_name(f".{file.name}-lock").open("wb")
        fcntl.flock(_locks[function], fcntl.LOCK_EX)


def _unlock(function: Callable[..., Any]) -> None:
    if lock := _locks.pop(function, None):
        Path(lock.name).unlink(missing_ok=True)  # who waits for it looks for the kernel then
        lock.close()


class KernelCache:
    """The compiled code of one kernel, as numba asks for it by signature."""

    def __init__(self, function: Callable[..., Any]) -> None:
        """Open the cache of a kernel, given its Python function."""
        self._function, self._module = function, function.__module__
        self._source = hashlib.sha256(repr((function.__qualname__, sorted(kernel_sources(function).items()))).encode())

    def _file(self, signature: Any, codegen: Any) -> Path:
        digest = self._source.copy()
        digest.update(repr((signature, codegen.magic_tuple(), numba.__version__, sys.version_info[:3])).encode())
        return users_folder() / f"{self._module}-{digest.hexdigest()[:16]}"

    def load_overload(self, signature: Any, target_context: Any) -> Any:
        """Return the code for a signature, None if it is not here, when others wait until this process has compiled it.

        A damaged file counts as none.
        """
        target_context.refresh()
        file = self._file(signature, target_context.codegen())
        if not file.exists():
            _lock(self._function, file)
        try:
            content = file.read_bytes()
        except OSError:
            return None
        _unlock(self._function)
        if hashlib.sha256(content[32:]).digest() == content[:32]:
            return CompileResult._rebuild(target_context, *pickle.loads(content[32:]))
        print(f"the compiled kernel {file} is damaged and is compiled again", file=sys.stderr, flush=True)
        return None

    def save_overload(self, signature: Any, result: Any) -> None:
        """Keep the code for a signature."""
        code, file = dumps(result._reduce()), self._file(signature, result.codegen)
        draft = file.with_name(f".{file.name}-{os.getpid()}")
        try:
            draft.write_bytes(hashlib.sha256(code).digest() + code)
            draft.replace(file)
        except OSError as error:
            _warn(f"a compiled kernel could not be kept for the next process: {error}")
        _unlock(self._function)


class _Announcement(Listener):  # type: ignore[misc]  # numba has no types
    """Prints a line when a kernel is compiled because it was not in the cache, and lets others try if it fails."""

    def on_start(self, event: Any) -> None:
        function = event.data["dispatcher"].py_func
        if function in KERNELS:
            about = f"once, about {KERNELS[function]} s"
            print(f"compiling {function.__module__} ({about})", file=sys.stderr, flush=True)

    def on_end(self, event: Any) -> None:
        if sys.exc_info()[0]:  # it does not compile
            _unlock(event.data["dispatcher"].py_func)


register("numba:compile", _Announcement())
