"""Sine and cosine on lanes: the exact bits of the C library's sincosf, which Box2D calls.

Follows glibc 2.28 and later (sysdeps/ieee754/flt-32/s_sincosf.h, by Arm; the variant with fused multiply-adds, which it
selects on every processor of the last ten years): the angle is reduced, and a polynomial is evaluated, in double
precision. Without fused operations one value in a million differs. On a platform whose sincosf is another function the
engines differ, and the tests fail.
"""

from typing import Any

import numpy as np

from tasks.compiled import inline
from tasks.simd import lanes

NEAR = 120.0  # angles below this [rad] are reduced by one multiply-add, others by integer arithmetic
_TWO_OVER_PI_SCALED = float.fromhex("0x1.45F306DC9C883p+23")  # 2/π · 2^24
_HALF_PI = float.fromhex("0x1.921FB54442D18p0")
_PI_63 = float.fromhex("0x1.921FB54442D18p-62")  # 2π · 2^-64
_C1 = float.fromhex("-0x1.ffffffd0c621cp-2")
_C2 = float.fromhex("0x1.55553e1068f19p-5")
_C3 = float.fromhex("-0x1.6c087e89a359dp-10")
_C4 = float.fromhex("0x1.99343027bf8c3p-16")
_S1 = float.fromhex("-0x1.555545995a603p-3")
_S2 = float.fromhex("0x1.1107605230bc4p-7")
_S3 = float.fromhex("-0x1.994eb3774cf24p-13")
_BITS_OF_FOUR_OVER_PI = 0xA2F9836E4E441529FC2757D1F534DDC0DB6295993C439041
_FOUR_OVER_PI = np.array([_BITS_OF_FOUR_OVER_PI >> 184 - 8 * i & 0xFFFFFFFF for i in range(24)], np.uint64)
"""Bits of 4/π, 32 at a time, each starting 8 further on than the one before."""


@inline
def _reduce_large(angle: Any) -> Any:
    """Reduce |angle| to a rest in [-π/4, π/4] and a quadrant, by fixed-point multiplication with 4/π."""
    bits = np.int64(np.float32(angle).view(np.int32)) & 0xFFFFFFFF
    first = (bits >> 26) & 15
    mantissa = np.uint64(((bits & 0xFFFFFF) | 0x800000) << ((bits >> 23) & 7)) & np.uint64(0xFFFFFFFF)
    high = (mantissa * _FOUR_OVER_PI[first]) << np.uint64(32)
    low = (mantissa * _FOUR_OVER_PI[first + 8]) >> np.uint64(32)
    turns = (high | low) + mantissa * _FOUR_OVER_PI[first + 4]
    n = (turns + np.uint64(1 << 61)) >> np.uint64(62)
    rest = turns - (n << np.uint64(62))
    return np.float64(np.int64(rest)) * _PI_63, np.int32(n)


@inline
def _reduce(angle: Any) -> Any:
    """Reduce float64 angles below NEAR as well."""
    n = (lanes.truncate(angle * _TWO_OVER_PI_SCALED) + 0x800000) >> 24
    return lanes.fma(lanes.to_double(n), -_HALF_PI, angle), n


@inline
def _reduce_far(angle: Any) -> Any:
    """Reduce one float32 angle that is large, infinite or NaN to the rest, the quadrant and the signs."""
    rest, n = _reduce_large(angle)
    return rest if abs(angle) < np.inf else np.nan, n, n + (1 if angle < np.float32(0.0) else 0)


@inline
def _evaluate(x: Any, n: Any, signs: Any) -> Any:
    """Evaluate both polynomials of the rest, and assign them by quadrant."""
    x2 = x * x
    x3 = x2 * x
    x4 = x2 * x2
    s = lanes.to_single(lanes.fma(x3 * x2, lanes.fma(x2, _S3, _S2), lanes.fma(x3, _S1, x)))
    c = lanes.to_single(lanes.fma(x4 * x2, lanes.fma(x2, _C4, _C3), lanes.fma(x4, _C2, lanes.fma(x2, _C1, 1.0))))
    s = lanes.select(((signs + 1) & 2) == 2, -s, s)
    c = lanes.select((signs & 2) == 2, -c, c)
    odd = (n & 1) == 1
    return lanes.select(odd, c, s), lanes.select(odd, s, c)


@inline
def sincos(angle: lanes.Lanes) -> tuple[lanes.Lanes, lanes.Lanes]:
    """Compute sine and cosine of angles [rad]."""
    near = abs(angle) < NEAR
    x, n = _reduce(lanes.to_double(lanes.select(near, angle, 0.0)))
    signs = n
    if lanes.any_lane(~near):
        for i in range(lanes.count_lanes(angle)):
            one = lanes.lane(angle, i)
            if not abs(one) < NEAR:
                rest, quadrant, sign = _reduce_far(one)
                x = lanes.with_lane(x, i, rest)
                n = lanes.with_lane(n, i, quadrant)
                signs = lanes.with_lane(signs, i, sign)
    sin, cos = _evaluate(x, n, signs)
    return sin, cos


@inline
def scalar_sincos(angle: np.float32) -> tuple[np.float32, np.float32]:
    """Compute sine and cosine of one angle [rad]."""
    if abs(angle) < NEAR:
        x, n = _reduce(lanes.to_double(angle))
        signs = n
    else:
        x, n, signs = _reduce_far(angle)
    sin, cos = _evaluate(x, n, signs)
    return sin, cos
