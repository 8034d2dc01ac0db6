"""Kernels: functions that numba compiles on their first call, or finds in a cache."""

import re
import sys
from collections.abc import Callable
from functools import cached_property
from types import FunctionType
from typing import Any, TypeVar, cast

import numba
import numba.extending
from numba.core.caching import NullCache
from numba.core.errors import NumbaError

import tasks

F = TypeVar("F", bound=Callable[..., Any])

KERNELS: dict[Callable[..., Any], int] = {}
"""About how long each kernel takes to compile [s], by its Python function; of the modules imported so far."""


class _Cache(NullCache):  # type: ignore[misc]  # numba has no types
    """A kernel's cache, opened on the first call."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function = function

    @cached_property
    def _opened(self) -> Any:
        in_a_file = hasattr(sys.modules.get(self._function.__module__), "__file__")  # and not in a notebook
        return tasks.open_kernel_cache(self._function) if tasks.open_kernel_cache and in_a_file else NullCache()

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        return self._opened.load_overload(sig, target_context)

    def save_overload(self, sig: Any, data: Any) -> None:
        self._opened.save_overload(sig, data)


def compiled(function: Callable[..., Any], *, seconds: int) -> Callable[..., Any]:
    """Return a kernel that is compiled on its first call, or loaded from the cache.

    Args:
        function: kernel; no closure, because numba's cache never finds a closure again.
        seconds: about how long compilation takes, for the announcement.
    """
    if function.__closure__ is not None:
        raise ValueError(f"{function.__qualname__} is a closure, expected a function of a module")
    if numba.config.DISABLE_JIT:
        return function
    kernel = numba.njit(error_model="numpy")(function)
    kernel._cache = _Cache(function)
    KERNELS[function] = seconds
    return cast(Callable[..., Any], kernel)


def specialised(template: Any, law: Any, *, seconds: int, **constants: Any) -> Callable[..., Any]:
    """Return a kernel that is a template with globals of its own: a formula as LAW, and constants by name.

    numba's cache would never find a closure again.
    """
    kernel = with_law(template, inline(law), **constants)
    kernel.__module__ = law.__module__
    return compiled(kernel, seconds=seconds)


def with_law(template: Any, law: Any, **constants: Any) -> Any:
    """Return a function that is a template with globals of its own: a formula as LAW, and constants by name."""
    function: Any = FunctionType(template.__code__, {**template.__globals__, "LAW": law, **constants})
    plain = getattr(law, "py_func", law)
    function.__qualname__ = f"{template.__name__} {plain.__qualname__} {plain.__code__.co_firstlineno} {constants}"
    return function


def uncompiled(error: NumbaError, law: Any) -> str:
    """Say in a line that a formula does not compile, and where it is."""
    named = re.search(r'File "(.*?)", line (\d+)', str(error))
    place = f"{named[1]}:{named[2]}" if named else law.__module__
    return (
        f"{place}: {law.__qualname__} does not compile: "
        "expected operators, abs, formulas and functions of tasks.simd.lanes"
    )


def entry(kernel: Any, *arguments: Any) -> Any:
    """Compile a kernel for arguments such as the given ones, and return its address, which kernels call it by.

    Without the compiler it is the function itself.
    """
    if numba.config.DISABLE_JIT:
        return kernel
    types = tuple(map(numba.typeof, arguments))
    if types not in kernel.overloads:
        kernel.compile(types)
    compiled_for = kernel.overloads[types]
    return compiled_for.library.get_pointer_to_function(compiled_for.fndesc.llvm_func_name)


def formula(function: F) -> F:
    """Mark a function that Python calls as it stands, and kernels compile into themselves: one text for both."""
    return cast(F, numba.extending.register_jitable(forceinline=True, error_model="numpy")(function))


def inline(function: F) -> F:
    """Mark a function that is compiled into its callers."""
    return cast(F, numba.njit(forceinline=True, error_model="numpy")(function))
