"""Lanes under the compiler against NumPy's float32, lane by lane and bit by bit, for several numbers of lanes."""

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from tasks.compiled import inline
from tasks.simulation.simd.lanes import Block, floor, select, sqrt, to_double, to_single, truncate

pytestmark = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="these are the compiled lanes")

WIDTHS = (1, 2, 4, 8, 16, 32)
N_RESULTS = 16


@inline
def calculate(x, y):
    low = select(x < y, x, y)
    wide = to_double(x)
    whole = truncate(to_double(select(abs(x) < 1e6, x, 0.0)))
    return (
        x + y,
        x - y,
        x * y,
        x / y,
        x * y + 0.1,
        1 - x,
        -x,
        abs(x),
        sqrt(abs(y)),
        floor(x),
        low,
        select((x <= y) & ~(y == 0.0) | (x != x), 1.0, -1.0),
        select((x > 0.5) | (y >= 3), x, 2),
        to_single(wide * wide + 0.1),
        to_single(to_double((whole + 5) >> 1)),
        to_single(to_double(whole & 3)),
    )


def kernel(block, out):
    results = calculate(block[0], block[1])
    for row in range(N_RESULTS):
        out[row] = results[row]


compiled_kernel = numba.njit(error_model="numpy")(kernel)

numbers = st.floats(width=32, allow_nan=True, allow_infinity=True, allow_subnormal=True)


@settings(max_examples=60)
@given(arrays(np.float32, (2, 32), elements=numbers))
def test_every_operation_equals_numpy_s_in_every_lane(numbers):
    with np.errstate(all="ignore"):
        expected = np.stack([np.broadcast_to(r, 32) for r in calculate.py_func(*numbers)]).astype(np.float32)
    for width in WIDTHS:
        block, out = Block(2, width), Block(N_RESULTS, width)
        block.rows[:] = numbers[:, :width]
        compiled_kernel(block, out)
        np.testing.assert_array_equal(out.rows, expected[:, :width])
