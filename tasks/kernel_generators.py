"""Generators that kernels hold.

numba reads the addresses of a NumPy generator through ctypes, at every call anew: that takes some microseconds, and ten
times as long after a rollout. Those of a held generator it has read.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numba
from numba.experimental import structref
from numpy.random import BitGenerator, Generator

from tasks.compiled import compiled


class _HeldType(numba.types.StructRef):  # type: ignore[misc]  # numba comes without types
    """numba's type of a generator that kernels hold."""


class _Held(structref.StructRefProxy):  # type: ignore[misc]
    """A generator that kernels hold, its ``rng`` there."""


structref.register(_HeldType)
structref.define_proxy(_Held, _HeldType, ["rng"])


class _Plain(NamedTuple):
    """What stands for it in plain Python."""

    rng: Generator


def _held_of(rng: Generator) -> Any:
    return _Held(rng)


_held_kernel = compiled(_held_of, [], seconds=1)


class KernelGenerator(Generator):
    """A generator for several calls of kernels, which take its ``held`` and draw from ``held.rng``."""

    def __init__(self, bit_generator: BitGenerator) -> None:
        super().__init__(bit_generator)
        rng = Generator(bit_generator)
        self.held: Any = _Plain(rng) if numba.config.DISABLE_JIT else _held_kernel(rng)


def hold(rng: Generator) -> KernelGenerator:
    """Make a generator one that kernels can hold; both draw from the same stream."""
    return rng if isinstance(rng, KernelGenerator) else KernelGenerator(rng.bit_generator)
