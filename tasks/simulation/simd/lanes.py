"""Lanes: vectors of numbers inside numba, one robot per lane, in explicit SIMD instructions.

A kernel written on lanes reads like the scalar code that it follows: ``block[row]`` loads the lanes of a row of float32
and ``block[row] = lanes`` stores them; the operators work lane by lane; :func:`select` takes the place of a branch. A
kernel is compiled for as many lanes as its block has, and gives the same bits for any number: every operation is
rounded on its own, nothing is contracted or reassociated. A Python number that meets lanes takes their precision, as
in NumPy. There are no in-place operators, which would change an array under every name that it has.

Functions that take lanes take numbers too, except those that count or pick lanes. So a formula that must be the same in
the tree engine and in scalar code is written once; its constants are float32, because numba widens a number that meets
a Python float.

Without the compiler (NUMBA_DISABLE_JIT=1) the same kernels run in plain Python, their lanes being NumPy arrays, and the
functions below are what they call. Under the compiler each of these is a typing rule and a few instructions instead:
see simd.py.
"""

from __future__ import annotations

import functools
import math
from fractions import Fraction
from typing import Any

import llvmlite.binding as llvm
import numpy as np
import numpy.typing as npt

ALIGNMENT = 64
"""Bytes: a whole AVX-512 register, a whole cache line."""


class Block:
    """Rows of lanes in aligned memory: what kernels load from and store to."""

    def __init__(self, n_rows: int, n_lanes: int) -> None:
        """Make n_rows rows of 0.

        Raises:
            ValueError: the number of lanes is not a power of two.
        """
        if n_lanes < 1 or n_lanes & (n_lanes - 1):
            raise ValueError(f"a block has {n_lanes} lanes, expected a power of two")
        self.rows = aligned((n_rows, n_lanes))
        self.address: int = self.rows.ctypes.data
        self.n_lanes = n_lanes

    def __getitem__(self, row: int) -> npt.NDArray[np.float32]:
        lanes: npt.NDArray[np.float32] = self.rows[row].copy()
        return lanes

    def __setitem__(self, row: int, lanes: npt.ArrayLike) -> None:
        self.rows[row] = lanes


def aligned(shape: tuple[int, ...]) -> npt.NDArray[np.float32]:
    """Zeros in float32 that begin on a boundary of a cache line."""
    n_bytes = math.prod(shape) * 4
    memory = np.zeros(n_bytes + ALIGNMENT, np.uint8)
    start = -memory.ctypes.data % ALIGNMENT
    return memory[start : start + n_bytes].view(np.float32).reshape(shape)


def as_block(rows: npt.NDArray[np.float32]) -> Block:
    """View (n_rows, n_lanes) numbers in aligned memory as a block."""
    view = Block.__new__(Block)
    view.rows, view.n_lanes = rows, rows.shape[1]
    view.address = rows.ctypes.data
    return view


def from_row(block: Any, row: int) -> Any:
    """View a block from a row on."""
    return as_block(block.rows[row:])


def count_parts(block: Any) -> int:
    """Count the parts of a block: 2 halves of its lanes, or 1 if they fill no more than a vector register."""
    return n_parts(int(block.n_lanes))


def n_parts(n_lanes: int) -> int:
    """Count the parts of so many lanes."""
    return 2 if n_lanes > widest() // 2 else 1


def part(block: Any, index: int) -> Any:
    """View some of a block's lanes in all its rows: one of its parts."""
    n_lanes = block.n_lanes // count_parts(block)
    return as_block(block.rows[:, index * n_lanes : (index + 1) * n_lanes])


def select(mask: Any, yes: Any, no: Any) -> Any:
    """Take ``yes`` in the lanes where the mask holds, ``no`` in the others; two Python numbers make float32."""
    if isinstance(yes, float) and isinstance(no, float):
        yes, no = np.float32(yes), np.float32(no)
    return np.where(mask, yes, no)[()]  # of numbers a number


def any_lane(mask: Any) -> bool:
    """Tell whether the mask holds in any lane."""
    return bool(np.any(mask))


def sqrt(lanes: Any) -> Any:
    """Take the square root, correctly rounded."""
    return np.sqrt(lanes)


def floor(lanes: Any) -> Any:
    """Round down to a whole number."""
    return np.floor(lanes)


def to_double(lanes: Any) -> Any:
    """Widen float32 or int32 lanes to float64."""
    return lanes.astype(np.float64)


def to_single(lanes: Any) -> Any:
    """Round float64 lanes to float32."""
    return lanes.astype(np.float32)


def truncate(lanes: Any) -> Any:
    """Round float64 lanes towards zero, to int32; they must fit."""
    return lanes.astype(np.int32)


def fma(a: Any, b: Any, c: Any) -> Any:
    """Multiply and add float64 lanes, a · b + c, rounded once."""

    def one(a: float, b: float, c: float) -> float:
        return float(Fraction(a) * Fraction(b) + Fraction(c)) if np.isfinite(a + b + c) else a * b + c

    return np.vectorize(one, otypes=[np.float64])(a, b, c)


def lane(lanes: Any, index: int) -> Any:
    """Take one lane's number."""
    return lanes[index]


def with_lane(lanes: Any, index: int, number: Any) -> Any:
    """Replace one lane's number."""
    replaced = lanes.copy()
    replaced[index] = number
    return replaced


def count_lanes(lanes: Any) -> int:
    """Count the lanes."""
    return len(lanes)


@functools.cache  # asking LLVM takes longer than packing designs
def widest() -> int:
    """Count the lanes that this machine favours, those of two vector registers; the bits do not depend on it."""
    features = llvm.get_host_cpu_features()
    if features.get("avx512f"):
        return 32
    if features.get("avx"):
        return 16
    return 8
