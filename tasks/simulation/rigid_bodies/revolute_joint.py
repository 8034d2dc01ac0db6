"""Revolute joints with motors between two bodies: Box2D 2.3's b2RevoluteJoint, operation by operation; no limits."""

from __future__ import annotations

from typing import Any

from tasks.compiled import inline
from tasks.simulation.rigid_bodies.layout import (
    ANCHOR_A_X,
    ANCHOR_A_Y,
    ANCHOR_B_X,
    ANCHOR_B_Y,
    C_X,
    C_Y,
    IMPULSE_X,
    IMPULSE_Y,
    INVERSE_INERTIA,
    INVERSE_MASS,
    K_INVERSE_DET,
    K_XX,
    K_XY,
    K_YY,
    LEVER_A_X,
    LEVER_A_Y,
    LEVER_B_X,
    LEVER_B_Y,
    MAX_MOTOR_IMPULSE,
    MOTOR_IMPULSE,
    MOTOR_MASS,
    V_X,
    V_Y,
    A,
    W,
)
from tasks.simulation.rigid_bodies.records import place, rotate
from tasks.simulation.simd.lanes import any_lane, select
from tasks.simulation.trees.joint import LINEAR_SLOP_SQUARED, clamp


@inline
def init_velocity_constraints(joint: Any, body_a: Any, body_b: Any, dt_ratio: Any) -> None:
    """b2RevoluteJoint::InitVelocityConstraints: levers, effective mass, and a start from the last step's impulses."""
    mA, iA, mB, iB = body_a[INVERSE_MASS], body_a[INVERSE_INERTIA], body_b[INVERSE_MASS], body_b[INVERSE_INERTIA]
    rA_x, rA_y = rotate(body_a, joint[ANCHOR_A_X], joint[ANCHOR_A_Y])
    rB_x, rB_y = rotate(body_b, joint[ANCHOR_B_X], joint[ANCHOR_B_Y])
    joint[LEVER_A_X], joint[LEVER_A_Y], joint[LEVER_B_X], joint[LEVER_B_Y] = rA_x, rA_y, rB_x, rB_y

    k_xx = mA + mB + rA_y * rA_y * iA + rB_y * rB_y * iB
    k_xy = -rA_y * rA_x * iA - rB_y * rB_x * iB
    k_yy = mA + mB + rA_x * rA_x * iA + rB_x * rB_x * iB
    determinant = k_xx * k_yy - k_xy * k_xy
    joint[K_XX], joint[K_XY], joint[K_YY] = k_xx, k_xy, k_yy
    joint[K_INVERSE_DET] = select(determinant != 0.0, 1.0 / determinant, determinant)
    joint[MOTOR_MASS] = 1.0 / (iA + iB)

    P_x, P_y, motor_impulse = joint[IMPULSE_X] * dt_ratio, joint[IMPULSE_Y] * dt_ratio, joint[MOTOR_IMPULSE] * dt_ratio
    joint[IMPULSE_X], joint[IMPULSE_Y], joint[MOTOR_IMPULSE] = P_x, P_y, motor_impulse
    body_a[V_X], body_a[V_Y] = body_a[V_X] - mA * P_x, body_a[V_Y] - mA * P_y
    body_a[W] = body_a[W] - iA * ((rA_x * P_y - rA_y * P_x) + motor_impulse)
    body_b[V_X], body_b[V_Y] = body_b[V_X] + mB * P_x, body_b[V_Y] + mB * P_y
    body_b[W] = body_b[W] + iB * ((rB_x * P_y - rB_y * P_x) + motor_impulse)


@inline
def solve_velocity_constraints(joint: Any, body_a: Any, body_b: Any, motor_speed: Any) -> None:
    """b2RevoluteJoint::SolveVelocityConstraints: the motor, then the point."""
    mA, iA, mB, iB = body_a[INVERSE_MASS], body_a[INVERSE_INERTIA], body_b[INVERSE_MASS], body_b[INVERSE_INERTIA]
    vA_x, vA_y, wA = body_a[V_X], body_a[V_Y], body_a[W]
    vB_x, vB_y, wB = body_b[V_X], body_b[V_Y], body_b[W]
    rA_x, rA_y, rB_x, rB_y = joint[LEVER_A_X], joint[LEVER_A_Y], joint[LEVER_B_X], joint[LEVER_B_Y]

    # A motor that is off has no impulse to give.
    Cdot = wB - wA - motor_speed
    old_impulse, max_impulse = joint[MOTOR_IMPULSE], joint[MAX_MOTOR_IMPULSE]
    new_impulse = clamp(old_impulse - joint[MOTOR_MASS] * Cdot, -max_impulse, max_impulse)
    joint[MOTOR_IMPULSE] = new_impulse
    wA = wA - iA * (new_impulse - old_impulse)
    wB = wB + iB * (new_impulse - old_impulse)

    Cdot_x = vB_x - wB * rB_y - vA_x + wA * rA_y
    Cdot_y = vB_y + wB * rB_x - vA_y - wA * rA_x
    k_xy, inverse_det = joint[K_XY], joint[K_INVERSE_DET]
    impulse_x = inverse_det * (k_xy * Cdot_y - joint[K_YY] * Cdot_x)
    impulse_y = inverse_det * (k_xy * Cdot_x - joint[K_XX] * Cdot_y)
    joint[IMPULSE_X], joint[IMPULSE_Y] = joint[IMPULSE_X] + impulse_x, joint[IMPULSE_Y] + impulse_y
    body_a[V_X], body_a[V_Y] = vA_x - mA * impulse_x, vA_y - mA * impulse_y
    body_a[W] = wA - iA * (rA_x * impulse_y - rA_y * impulse_x)
    body_b[V_X], body_b[V_Y] = vB_x + mB * impulse_x, vB_y + mB * impulse_y
    body_b[W] = wB + iB * (rB_x * impulse_y - rB_y * impulse_x)


@inline
def solve_position_constraints(joint: Any, body_a: Any, body_b: Any) -> bool:
    """b2RevoluteJoint::SolvePositionConstraints; return whether the joint was good enough."""
    mA, iA, mB, iB = body_a[INVERSE_MASS], body_a[INVERSE_INERTIA], body_b[INVERSE_MASS], body_b[INVERSE_INERTIA]
    cA_x, cA_y, cB_x, cB_y = body_a[C_X], body_a[C_Y], body_b[C_X], body_b[C_Y]
    rA_x, rA_y = rotate(body_a, joint[ANCHOR_A_X], joint[ANCHOR_A_Y])
    rB_x, rB_y = rotate(body_b, joint[ANCHOR_B_X], joint[ANCHOR_B_Y])
    C_x, C_y = cB_x + rB_x - cA_x - rA_x, cB_y + rB_y - cA_y - rA_y

    # The sums associate otherwise than in the velocity constraint.
    k_xx = mA + mB + iA * rA_y * rA_y + iB * rB_y * rB_y
    k_xy = -iA * rA_x * rA_y - iB * rB_x * rB_y
    k_yy = mA + mB + iA * rA_x * rA_x + iB * rB_x * rB_x
    determinant = k_xx * k_yy - k_xy * k_xy
    inverse_det = select(determinant != 0.0, 1.0 / determinant, determinant)
    impulse_x = inverse_det * (k_xy * C_y - k_yy * C_x)
    impulse_y = inverse_det * (k_xy * C_x - k_xx * C_y)
    turn_a, turn_b = rA_x * impulse_y - rA_y * impulse_x, rB_x * impulse_y - rB_y * impulse_x
    place(body_a, cA_x - mA * impulse_x, cA_y - mA * impulse_y, body_a[A] - iA * turn_a)
    place(body_b, cB_x + mB * impulse_x, cB_y + mB * impulse_y, body_b[A] + iB * turn_b)
    return any_lane(C_x * C_x + C_y * C_y <= LINEAR_SLOP_SQUARED)
