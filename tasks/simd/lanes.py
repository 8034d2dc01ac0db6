"""Lanes: vectors of numbers inside numba, one robot per lane, in explicit SIMD instructions.

A kernel on lanes reads like the scalar code that it follows. ``block[row]`` loads a row of float32, and
``block[row] = lanes`` stores one. Operators work lane by lane; :func:`select` replaces a branch. A kernel is compiled
for the number of lanes of its block, and its bits do not depend on that number: every operation is rounded separately,
nothing is contracted or reassociated. A Python number takes the precision of the lanes that it is combined with, as in
NumPy. There are no in-place operators: they would change an array under all its names.

Functions of lanes accept numbers and arrays, too, except those that count or pick lanes. So a formula
(:func:`tasks.compiled.formula`) is written once for kernels and for NumPy. Where it also serves single numbers in a
kernel its constants are float32, because numba widens a number that meets a Python float.

Without the compiler (NUMBA_DISABLE_JIT=1) kernels run in plain Python on NumPy arrays and call the functions below.
Under the compiler, each of these functions is a typing rule and a few instructions: see vectors.py.
"""

import functools
import math
from fractions import Fraction
from typing import Any

import llvmlite.binding as llvm
import numpy as np
import numpy.typing as npt

from tasks.arrays import Bools, Float32

Lanes = npt.NDArray[Any]  # A vector with one number per lane: a SIMD register under the compiler, a NumPy array without
Uniform = float | np.floating  # A number that is the same in all lanes
Numeric = Any  # lanes, or one number in code that the rigid-body engine shares; mypy can't relate the two
Mask = Bools  # A vector with one flag per lane

ALIGNMENT = 64  # size of an AVX-512 register and of a cache line [bytes]


class Block:
    """Rows of lanes in aligned memory; kernels load from it and store to it."""

    def __init__(self, n_rows: int, n_lanes: int) -> None:
        """Allocate n_rows rows of zeros; n_lanes is a power of two."""
        self.rows = aligned((n_rows, n_lanes))
        self.address: int = self.rows.ctypes.data
        self.n_lanes = n_lanes

    def __getitem__(self, row: int) -> Lanes:
        lanes: Lanes = self.rows[row].copy()
        return lanes

    def __setitem__(self, row: int, lanes: npt.ArrayLike) -> None:
        self.rows[row] = lanes


def aligned(shape: tuple[int, ...]) -> Float32:
    """Allocate float32 zeros that begin on a cache line."""
    n_bytes = math.prod(shape) * 4
    memory = np.zeros(n_bytes + ALIGNMENT, np.uint8)
    start = -memory.ctypes.data % ALIGNMENT
    return memory[start : start + n_bytes].view(np.float32).reshape(shape)


def as_block(rows: Float32) -> Block:
    """View an aligned (n_rows, n_lanes) array as a block."""
    view = Block.__new__(Block)
    view.rows, view.n_lanes = rows, rows.shape[1]
    view.address = rows.ctypes.data
    return view


def from_row(block: Any, row: int) -> Any:
    """View a block, or a tuple of arrays, from the given row on."""
    return block[row:] if isinstance(block, tuple) else as_block(block.rows[row:])


def select(mask: Numeric, yes: Numeric, no: Numeric) -> Numeric:
    """Return ``yes`` in lanes where the mask holds, and ``no`` elsewhere; two Python numbers make float32."""
    if hasattr(yes, "where"):  # a tensor, whose gradient a formula keeps
        return yes.where(mask, no)
    if type(yes) is float and type(no) is float:  # a number of NumPy keeps its precision
        yes, no = np.float32(yes), np.float32(no)
    chosen: Any = np.where(mask, yes, no)
    return chosen[()]  # a number if all are numbers


def any_lane(mask: Any) -> bool:
    """Return whether the mask holds in any lane."""
    return bool(np.any(mask))


def sqrt(lanes: Numeric) -> Numeric:
    """Compute the square root, correctly rounded."""
    return np.sqrt(lanes)


def floor(lanes: Numeric) -> Numeric:
    """Round down to an integer."""
    return np.floor(lanes)


def to_double(lanes: Any) -> Any:
    """Widen float32 or int32 lanes to float64."""
    return lanes.astype(np.float64)


def to_single(lanes: Any) -> Any:
    """Round float64 lanes to float32."""
    return lanes.astype(np.float32)


def truncate(lanes: Any) -> Any:
    """Round float64 lanes towards zero to int32, in whose range they must be."""
    return lanes.astype(np.int32)


def fma(a: Any, b: Any, c: Any) -> Any:
    """Return a · b + c of float64 lanes, rounded once."""

    def one(a: float, b: float, c: float) -> float:
        return float(Fraction(a) * Fraction(b) + Fraction(c)) if np.isfinite(a + b + c) else a * b + c

    return np.vectorize(one, otypes=[np.float64])(a, b, c)


def lane(lanes: Any, index: int) -> Any:
    """Return the number in one lane."""
    return lanes[index]


def with_lane(lanes: Any, index: int, number: Any) -> Any:
    """Return lanes with the number in one of them replaced."""
    replaced = lanes.copy()
    replaced[index] = number
    return replaced


def count_lanes(lanes: Any) -> int:
    """Return the number of lanes."""
    return len(lanes)


def call(address: Any, block: Block, factors: Block, number: int) -> None:
    """Call the kernel at an address (:func:`tasks.compiled.entry`) with two blocks and a number."""
    address(block, factors, number)


@functools.cache  # the query of LLVM takes longer than packing designs
def widest() -> int:
    """Return the fastest number of lanes on this machine: those of two vector registers. Bits do not depend on it."""
    features = llvm.get_host_cpu_features()
    if features.get("avx512f"):
        return 32
    if features.get("avx"):
        return 16
    return 8
