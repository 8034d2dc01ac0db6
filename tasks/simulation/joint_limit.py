"""Limits of a revolute joint: those equations of Box2D 2.3's b2RevoluteJoint, on lanes or numbers, for both engines.

A joint is at a limit from the step in which it begins at or beyond the lower or upper angle. The limit is then solved
with the point that ties the two bodies, as one block of three equations:

    C    = a_B - a_A - limit        Cdot = ω_B - ω_A        J = (0, -1, 0, 1)
    K    = ( K of the point    k_xz )       k_xz = -r_Ay i_A - r_By i_B       k_zz = i_A + i_B
           (                   k_yz )       k_yz =  r_Ax i_A + r_Bx i_B
           ( k_xz    k_yz      k_zz )

The limit only pushes: where its accumulated impulse would pull, it becomes 0, and the point is solved alone. Box2D's
rule for limits that are closer than 4° is left out: a joint's range of motion is 11° or more.
"""

import numpy as np

from tasks.compiled import inline
from tasks.simulation.box2d import ANGULAR_SLOP, MAX_ANGULAR_CORRECTION
from tasks.simulation.simd.lanes import Mask, Numeric, select

_ZERO, _ONE = np.float32(0), np.float32(1)
_AT_LOWER, _BETWEEN, _AT_UPPER = -_ONE, _ZERO, _ONE  # states of a limit


@inline
def limit_state(angle: Numeric, lower: Numeric, upper: Numeric) -> Numeric:
    """Return -1 at the lower limit, 1 at the upper one, and 0 between them.

    Args:
        angle: angle of the joint [rad].
        lower: its least angle [rad].
        upper: its greatest angle [rad].
    """
    return select(angle <= lower, _AT_LOWER, select(angle >= upper, _AT_UPPER, _BETWEEN))


@inline
def solve_with_limit(
    K: tuple[Numeric, ...], inverse_det: Numeric, Cdot: tuple[Numeric, ...], accumulated: Numeric, state: Numeric
) -> tuple[Numeric, ...]:
    """Return the impulses of point and limit, (x, y, z), of joints at a limit.

    Args:
        K: k_xx, k_xy, k_yy, k_xz, k_yz, k_zz.
        inverse_det: 1 / det K of the point.
        Cdot: of the point, x and y, and of the limit.
        accumulated: impulse of the limit so far in this step.
        state: -1 or 1; what is returned for 0 is meaningless.
    """
    k_xx, k_xy, k_yy, k_xz, k_yz, k_zz = K
    b_x, b_y, b_z = Cdot
    # b2Mat33::Solve33, by Cramer's rule: cross(ey, ez), then the triple products.
    c_x, c_y, c_z = k_yy * k_zz - k_yz * k_yz, k_yz * k_xz - k_xy * k_zz, k_xy * k_yz - k_yy * k_xz
    det = k_xx * c_x + k_xy * c_y + k_xz * c_z
    inverse = select(det != _ZERO, _ONE / det, det)
    x = inverse * (b_x * c_x + b_y * c_y + b_z * c_z)
    y = inverse * (
        k_xx * (b_y * k_zz - b_z * k_yz) + k_xy * (b_z * k_xz - b_x * k_zz) + k_xz * (b_x * k_yz - b_y * k_xz)
    )
    z = inverse * (
        k_xx * (k_yy * b_z - k_yz * b_y) + k_xy * (k_yz * b_x - k_xy * b_z) + k_xz * (k_xy * b_y - k_yy * b_x)
    )
    pulls: Mask = select(state < _ZERO, accumulated - z, z - accumulated) < _ZERO
    # b2Mat33::Solve22 of the point, with the limit's impulse taken back.
    to_x, to_y = accumulated * k_xz - b_x, accumulated * k_yz - b_y
    alone_x, alone_y = inverse_det * (k_yy * to_x - k_xy * to_y), inverse_det * (k_xx * to_y - k_xy * to_x)
    return select(pulls, alone_x, -x), select(pulls, alone_y, -y), select(pulls, -accumulated, -z)


@inline
def limit_correction(angle: Numeric, lower: Numeric, upper: Numeric, state: Numeric) -> tuple[Numeric, Numeric]:
    """Return by how much to turn a joint back, and its error [rad]; both are 0 between the limits.

    Args:
        angle: angle of the joint [rad].
        lower: its least angle [rad].
        upper: its greatest angle [rad].
        state: of :func:`limit_state`, at the start of the step.
    """
    below, above = angle - lower, angle - upper
    least, most = below + ANGULAR_SLOP, above - ANGULAR_SLOP
    least = select(least > -MAX_ANGULAR_CORRECTION, least, -MAX_ANGULAR_CORRECTION)
    most = select(most < MAX_ANGULAR_CORRECTION, most, MAX_ANGULAR_CORRECTION)
    least, most = select(least < _ZERO, least, _ZERO), select(most > _ZERO, most, _ZERO)
    at_lower, at_upper = state < _ZERO, state > _ZERO
    return (
        select(at_lower, least, select(at_upper, most, _ZERO)),
        select(at_lower, -below, select(at_upper, above, _ZERO)),
    )
