"""Revolute joints with motors, on lanes: Box2D 2.3's b2RevoluteJoint, without limits, operation by operation.

Every lane is a robot with a tree of its own, so the parent of a joint is another row in each: it is gathered from the
rows of the links that it may be, and scattered back to them.
"""

from __future__ import annotations

from typing import Any

from tasks.compiled import inline
from tasks.simulation.box2d import LINEAR_SLOP_SQUARED
from tasks.simulation.simd.lanes import from_row, select
from tasks.simulation.simd.rotation import sincos
from tasks.simulation.trees.layout import (
    ANGLE,
    CHILD_ANCHOR,
    COS,
    IMPULSE_X,
    IMPULSE_Y,
    INVERSE_INERTIA,
    INVERSE_MASS,
    K_INVERSE_DET,
    K_XX,
    K_XY,
    K_YY,
    MAX_MOTOR_IMPULSE,
    MOTOR_IMPULSE,
    MOTOR_MASS,
    MOTOR_SPEED,
    OMEGA,
    PARENT,
    PARENT_ANCHOR,
    PARENT_INVERSE_INERTIA,
    PARENT_INVERSE_MASS,
    RA_X,
    RA_Y,
    RB_X,
    RB_Y,
    SIN,
    VX,
    VY,
    X,
    Y,
)


@inline
def clamp(a: Any, low: Any, high: Any) -> Any:
    """b2Clamp."""
    least = select(a < high, a, high)
    return select(low > least, low, least)


@inline
def of_parent(links: Any, parent: Any, joint: int) -> Any:
    """Gather a quantity of each lane's parent of a joint; it has a row of ``links`` for each link that this may be."""
    gathered = links[0]
    for link in range(1, joint + 1):
        gathered = select(parent == link, links[link], gathered)
    return gathered


@inline
def to_parent(links: Any, parent: Any, joint: int, value: Any) -> None:
    """Scatter a quantity to each lane's parent of a joint, in its rows ``links``."""
    for link in range(joint + 1):
        links[link] = select(parent == link, value, links[link])


@inline
def init_velocity_constraint(block: Any, joint: int, dt_ratio: Any) -> None:
    """b2RevoluteJoint::InitVelocityConstraints: levers, effective mass, and a start from the last step's impulses."""
    child = joint + 1
    parent = block[PARENT + joint]
    mA, iA = block[PARENT_INVERSE_MASS + joint], block[PARENT_INVERSE_INERTIA + joint]
    mB, iB = block[INVERSE_MASS + child], block[INVERSE_INERTIA + child]

    rA_x = -(of_parent(from_row(block, SIN), parent, joint) * block[PARENT_ANCHOR + joint])
    rA_y = of_parent(from_row(block, COS), parent, joint) * block[PARENT_ANCHOR + joint]
    rB_x = -(block[SIN + child] * block[CHILD_ANCHOR + joint])
    rB_y = block[COS + child] * block[CHILD_ANCHOR + joint]
    block[RA_X + joint], block[RA_Y + joint] = rA_x, rA_y
    block[RB_X + joint], block[RB_Y + joint] = rB_x, rB_y

    k_xx = mA + mB + rA_y * rA_y * iA + rB_y * rB_y * iB
    k_xy = -rA_y * rA_x * iA - rB_y * rB_x * iB
    k_yy = mA + mB + rA_x * rA_x * iA + rB_x * rB_x * iB
    det = k_xx * k_yy - k_xy * k_xy
    block[K_XX + joint], block[K_XY + joint], block[K_YY + joint] = k_xx, k_xy, k_yy
    block[K_INVERSE_DET + joint] = select(det != 0.0, 1.0 / det, det)
    block[MOTOR_MASS + joint] = 1.0 / (iA + iB)

    P_x, P_y = block[IMPULSE_X + joint] * dt_ratio, block[IMPULSE_Y + joint] * dt_ratio
    motor_impulse = block[MOTOR_IMPULSE + joint] * dt_ratio
    block[IMPULSE_X + joint], block[IMPULSE_Y + joint], block[MOTOR_IMPULSE + joint] = P_x, P_y, motor_impulse

    to_parent(from_row(block, VX), parent, joint, of_parent(from_row(block, VX), parent, joint) - mA * P_x)
    to_parent(from_row(block, VY), parent, joint, of_parent(from_row(block, VY), parent, joint) - mA * P_y)
    wA = of_parent(from_row(block, OMEGA), parent, joint)
    to_parent(from_row(block, OMEGA), parent, joint, wA - iA * ((rA_x * P_y - rA_y * P_x) + motor_impulse))
    block[VX + child] = block[VX + child] + mB * P_x
    block[VY + child] = block[VY + child] + mB * P_y
    block[OMEGA + child] = block[OMEGA + child] + iB * ((rB_x * P_y - rB_y * P_x) + motor_impulse)


@inline
def solve_velocity_constraint(block: Any, joint: int) -> None:
    """b2RevoluteJoint::SolveVelocityConstraints: the motor, then the point."""
    child = joint + 1
    parent = block[PARENT + joint]
    mA, iA = block[PARENT_INVERSE_MASS + joint], block[PARENT_INVERSE_INERTIA + joint]
    mB, iB = block[INVERSE_MASS + child], block[INVERSE_INERTIA + child]
    rA_x, rA_y = block[RA_X + joint], block[RA_Y + joint]
    rB_x, rB_y = block[RB_X + joint], block[RB_Y + joint]
    vA_x = of_parent(from_row(block, VX), parent, joint)
    vA_y = of_parent(from_row(block, VY), parent, joint)
    wA = of_parent(from_row(block, OMEGA), parent, joint)
    vB_x, vB_y, wB = block[VX + child], block[VY + child], block[OMEGA + child]

    # A motor that is off has no impulse to give.
    Cdot = wB - wA - block[MOTOR_SPEED + joint]
    old_impulse = block[MOTOR_IMPULSE + joint]
    max_impulse = block[MAX_MOTOR_IMPULSE + joint]
    new_impulse = clamp(old_impulse - block[MOTOR_MASS + joint] * Cdot, -max_impulse, max_impulse)
    block[MOTOR_IMPULSE + joint] = new_impulse
    impulse = new_impulse - old_impulse
    wA = wA - iA * impulse
    wB = wB + iB * impulse

    Cdot_x = vB_x - wB * rB_y - vA_x + wA * rA_y
    Cdot_y = vB_y + wB * rB_x - vA_y - wA * rA_x
    k_xy, inverse_det = block[K_XY + joint], block[K_INVERSE_DET + joint]
    impulse_x = inverse_det * (k_xy * Cdot_y - block[K_YY + joint] * Cdot_x)
    impulse_y = inverse_det * (k_xy * Cdot_x - block[K_XX + joint] * Cdot_y)
    block[IMPULSE_X + joint] = block[IMPULSE_X + joint] + impulse_x
    block[IMPULSE_Y + joint] = block[IMPULSE_Y + joint] + impulse_y

    to_parent(from_row(block, VX), parent, joint, vA_x - mA * impulse_x)
    to_parent(from_row(block, VY), parent, joint, vA_y - mA * impulse_y)
    to_parent(from_row(block, OMEGA), parent, joint, wA - iA * (rA_x * impulse_y - rA_y * impulse_x))
    block[VX + child] = vB_x + mB * impulse_x
    block[VY + child] = vB_y + mB * impulse_y
    block[OMEGA + child] = wB + iB * (rB_x * impulse_y - rB_y * impulse_x)


@inline
def solve_position_constraint(block: Any, joint: int, unsolved: Any) -> Any:
    """b2RevoluteJoint::SolvePositionConstraints in the unsolved lanes; return where the joint was good enough."""
    child = joint + 1
    parent = block[PARENT + joint]
    mA, iA = block[PARENT_INVERSE_MASS + joint], block[PARENT_INVERSE_INERTIA + joint]
    mB, iB = block[INVERSE_MASS + child], block[INVERSE_INERTIA + child]
    cA_x, cA_y = of_parent(from_row(block, X), parent, joint), of_parent(from_row(block, Y), parent, joint)
    cB_x, cB_y = block[X + child], block[Y + child]

    rA_x = -(of_parent(from_row(block, SIN), parent, joint) * block[PARENT_ANCHOR + joint])
    rA_y = of_parent(from_row(block, COS), parent, joint) * block[PARENT_ANCHOR + joint]
    rB_x = -(block[SIN + child] * block[CHILD_ANCHOR + joint])
    rB_y = block[COS + child] * block[CHILD_ANCHOR + joint]

    C_x = cB_x + rB_x - cA_x - rA_x
    C_y = cB_y + rB_y - cA_y - rA_y
    good_enough = C_x * C_x + C_y * C_y <= LINEAR_SLOP_SQUARED

    # The sums associate otherwise than in the velocity constraint.
    k_xx = mA + mB + iA * rA_y * rA_y + iB * rB_y * rB_y
    k_xy = -iA * rA_x * rA_y - iB * rB_x * rB_y
    k_yy = mA + mB + iA * rA_x * rA_x + iB * rB_x * rB_x
    det = k_xx * k_yy - k_xy * k_xy
    inverse_det = select(det != 0.0, 1.0 / det, det)
    impulse_x = select(unsolved, inverse_det * (k_xy * C_y - k_yy * C_x), 0.0)
    impulse_y = select(unsolved, inverse_det * (k_xy * C_x - k_xx * C_y), 0.0)

    aA = of_parent(from_row(block, ANGLE), parent, joint) - iA * (rA_x * impulse_y - rA_y * impulse_x)
    sin_A, cos_A = sincos(aA)
    to_parent(from_row(block, X), parent, joint, cA_x - mA * impulse_x)
    to_parent(from_row(block, Y), parent, joint, cA_y - mA * impulse_y)
    to_parent(from_row(block, ANGLE), parent, joint, aA)
    to_parent(from_row(block, SIN), parent, joint, sin_A)
    to_parent(from_row(block, COS), parent, joint, cos_A)
    aB = block[ANGLE + child] + iB * (rB_x * impulse_y - rB_y * impulse_x)
    sin_B, cos_B = sincos(aB)
    block[X + child], block[Y + child] = cB_x + mB * impulse_x, cB_y + mB * impulse_y
    block[ANGLE + child], block[SIN + child], block[COS + child] = aB, sin_B, cos_B
    return good_enough
