"""The cache of compiled kernels: numba's own, in a folder of the user's that no edit can make stale.

numba does not notice the edit of a module that a kernel calls, and runs whatever it finds on the disk. So the folder is
named by a digest of the kernels' sources, numba and the processor, and lists the SHA-256 of its files. The first kernel
of a process checks them; a folder that differs from its list is discarded.

A kernel can be compiled from what its module names, and no more. So its sources are its module and what that imports,
at any depth; for a name that is imported from a package, all that the package imports. A module that a registry finds
in its folder, such as a user's medium, is none of them; if it has a law, the law's kernel is named by its sources.
"""

import contextlib
import fcntl
import functools
import hashlib
import inspect
import json
import os
import re
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import llvmlite.binding
import numba
from numba.core.caching import CompileResultCacheImpl, FunctionCache
from numba.core.event import Listener, register

from pipeline.sources import Sources, imported_names, parsed, read_modules
from tasks.compiled import KERNELS
from tasks.simulation.batch import needed_kernels
from tasks.world import Physics

_MAKES_KERNELS = re.compile(rb"\bcompiled\(|\bnumba\.extending\b")  # or teaches numba what kernels call
_DIGESTS = "digests.json"


def kernel_sources(modules: Sources) -> Sources:
    """Select the modules that kernels are compiled from: those that make kernels and, in turn, all that is imported."""
    return _reached(modules, [name for name, content in modules.items() if _MAKES_KERNELS.search(content)])


def _reached(modules: Sources, pending: list[str]) -> Sources:
    sources: Sources = {}
    while pending:
        name = pending.pop()
        if name in modules and name not in sources:
            sources[name] = modules[name]
            pending += imported_names(parsed(modules[name]))
    return sources


@functools.cache
def cache_folder() -> Path:
    """Return the folder of the kernels that this code and this machine need."""
    processor = llvmlite.binding.get_host_cpu_name(), llvmlite.binding.get_host_cpu_features().flatten()
    content = hashlib.sha256(repr((numba.__version__, sys.version_info[:3], processor)).encode())
    content.update(_joined(kernel_sources(read_modules("tasks"))))
    return users_folder() / content.hexdigest()[:16]


def _joined(sources: Sources) -> bytes:
    return b"".join(f"\0{name}\0".encode() + source for name, source in sorted(sources.items()))


@functools.cache
def _place(module: str) -> str:
    """Name the module of a kernel, and its sources where the folder does not: those of a law in a file of its own."""
    modules = read_modules("tasks")
    if module in kernel_sources(modules):
        return module
    own = inspect.getsource(sys.modules[module]).encode()
    return f"{module}-{hashlib.sha256(_joined(_reached({**modules, module: own}, [module]))).hexdigest()[:16]}"


def users_folder() -> Path:
    """Find a writable folder for compiled kernels: one of this process alone where there is no other."""
    chosen = os.environ.get("NUMBA_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    for folder in (chosen, tempfile.gettempdir()):
        with contextlib.suppress(OSError, RuntimeError):  # RuntimeError: a user without a home
            own = Path(folder).expanduser() / f"puddle-{os.getuid()}"
            own.mkdir(mode=0o700, parents=True, exist_ok=True)
            if own.stat().st_uid == os.getuid() and os.access(own, os.W_OK):  # code is run: the user's own only
                with _locked(own):  # not every file system has locks
                    return own
    return Path(tempfile.mkdtemp(prefix="puddle-"))


def is_sound(folder: Path) -> bool:
    """Return whether a folder holds the files that it lists, and no other kernels."""
    try:
        listed = json.loads((folder / _DIGESTS).read_bytes())
    except FileNotFoundError:
        listed = {}
    except ValueError:
        return False
    return bool(listed == _digests(folder))


def kernel_files(folder: Path) -> list[Path]:
    """List the files of numba's cache: an index and compiled code for each kernel."""
    return sorted(path for path in folder.glob("*") if path.suffix in (".nbi", ".nbc"))


def _digests(folder: Path) -> dict[str, str]:
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in kernel_files(folder)}


@contextlib.contextmanager
def _locked(folder: Path) -> Iterator[None]:
    folder.mkdir(mode=0o700, exist_ok=True)
    with (folder / "lock").open("a+b") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


@functools.cache
def checked_folder() -> Path:
    """Return the folder of the kernels once it is sound, which the first kernel of a process asks for."""
    folder = cache_folder()
    with contextlib.suppress(OSError), _locked(folder):  # else every process compiles its own
        if not is_sound(folder):
            _warn(f"the compiled kernels in {folder} are damaged and are compiled again")
            for path in (*kernel_files(folder), folder / _DIGESTS):
                path.unlink(missing_ok=True)
    return folder


@functools.cache
def _warn(message: str) -> None:
    """Print a message, once."""
    print(message, file=sys.stderr, flush=True)


class _Locator:
    """Tells numba where the files of a kernel are, and what they are called."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self._module = function.__module__

    @classmethod
    def from_function(cls, function: Callable[..., Any], _file: str) -> "_Locator":
        return cls(function)

    def get_cache_path(self) -> str:
        return str(checked_folder())

    def get_source_stamp(self) -> str:
        return ""  # the folder's name is a digest of the sources

    def get_disambiguator(self) -> str:
        return _place(self._module)

    def ensure_cache_path(self) -> None:
        pass


class _Implementation(CompileResultCacheImpl):  # type: ignore[misc]  # numba has no types
    _locator_classes = (_Locator,)


class KernelCache(FunctionCache):  # type: ignore[misc]
    """numba's cache of one kernel."""

    _impl_class = _Implementation

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep the compiled kernel, and list its files."""
        folder = checked_folder()
        try:
            with _locked(folder):
                super().save_overload(sig, data)
                draft = folder / f".{_DIGESTS}"
                draft.write_text(json.dumps(_digests(folder), indent=1))
                draft.replace(folder / _DIGESTS)
        except OSError as error:
            _warn(f"a compiled kernel could not be kept for the next process: {error}")


def seconds_to_compile(physics: Physics) -> float:
    """Return about how long the kernels take that an evolution needs and this machine has not compiled yet [s]."""
    there = {path.name.partition(".py")[0] for path in kernel_files(cache_folder())}
    names = {function: f"{function.__qualname__}-{_place(function.__module__)}" for function in needed_kernels(physics)}
    return float(sum(KERNELS[one] for one, name in names.items() if not any(kept.endswith(name) for kept in there)))


class _Announcement(Listener):  # type: ignore[misc]
    """Prints a line when a kernel is compiled because it was not in the cache."""

    def on_start(self, event: Any) -> None:
        function = event.data["dispatcher"].py_func
        if function in KERNELS:
            about = f"once, about {KERNELS[function]} s"
            print(f"compiling {function.__module__} ({about})", file=sys.stderr, flush=True)

    def on_end(self, event: Any) -> None:
        pass


register("numba:compile", _Announcement())
