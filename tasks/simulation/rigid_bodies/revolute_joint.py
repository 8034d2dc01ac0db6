"""Revolute joints with motors: Box2D 2.3's b2RevoluteJoint, operation by operation.

The constraints, their Jacobians and K are those of tasks/simulation/trees/joint.py.
"""

from numpy import float32

from tasks.compiled import inline
from tasks.simulation.box2d import LINEAR_SLOP_SQUARED, Scene
from tasks.simulation.rigid_bodies.layout import JointRecord, RobotRecord
from tasks.simulation.rigid_bodies.transform import place, rotate
from tasks.simulation.trees.joint import clamp

_ZERO, _ONE = float32(0), float32(1)


@inline
def init_velocity_constraints(robot: RobotRecord, joint: JointRecord, scene: Scene) -> None:
    """b2RevoluteJoint::InitVelocityConstraints: levers, K, and the warm start with the last step's impulses."""
    body_a, body_b = robot.bodies[joint.body_a], robot.bodies[joint.body_b]
    mA, iA, mB, iB = body_a.inv_mass, body_a.inv_inertia, body_b.inv_mass, body_b.inv_inertia
    rA_x, rA_y = rotate(body_a, (joint.local_ra_x, joint.local_ra_y))
    rB_x, rB_y = rotate(body_b, (joint.local_rb_x, joint.local_rb_y))
    joint.ra_x, joint.ra_y, joint.rb_x, joint.rb_y = rA_x, rA_y, rB_x, rB_y

    k_xx = mA + mB + rA_y * rA_y * iA + rB_y * rB_y * iB
    k_xy = -rA_y * rA_x * iA - rB_y * rB_x * iB
    k_yy = mA + mB + rA_x * rA_x * iA + rB_x * rB_x * iB
    determinant = k_xx * k_yy - k_xy * k_xy
    joint.k_xx, joint.k_xy, joint.k_yy = k_xx, k_xy, k_yy
    joint.k_inverse_det = _ONE / determinant if determinant != 0.0 else determinant
    joint.motor_mass = _ONE / (iA + iB)

    dt_ratio = scene.dt_ratio
    P_x, P_y, motor_impulse = joint.impulse_x * dt_ratio, joint.impulse_y * dt_ratio, joint.motor_impulse * dt_ratio
    joint.impulse_x, joint.impulse_y, joint.motor_impulse = P_x, P_y, motor_impulse
    turn_a, turn_b = (rA_x * P_y - rA_y * P_x) + motor_impulse, (rB_x * P_y - rB_y * P_x) + motor_impulse
    body_a.v_x, body_a.v_y, body_a.w = body_a.v_x - mA * P_x, body_a.v_y - mA * P_y, body_a.w - iA * turn_a
    body_b.v_x, body_b.v_y, body_b.w = body_b.v_x + mB * P_x, body_b.v_y + mB * P_y, body_b.w + iB * turn_b


@inline
def solve_velocity_constraints(robot: RobotRecord, joint: JointRecord) -> None:
    """b2RevoluteJoint::SolveVelocityConstraints: the motor, then the point."""
    body_a, body_b = robot.bodies[joint.body_a], robot.bodies[joint.body_b]
    mA, iA, mB, iB = body_a.inv_mass, body_a.inv_inertia, body_b.inv_mass, body_b.inv_inertia
    vA_x, vA_y, wA = body_a.v_x, body_a.v_y, body_a.w
    vB_x, vB_y, wB = body_b.v_x, body_b.v_y, body_b.w
    rA_x, rA_y, rB_x, rB_y = joint.ra_x, joint.ra_y, joint.rb_x, joint.rb_y

    # The impulse stays within ± max_motor_impulse, which is 0 for a motor that is off.
    Cdot = wB - wA - joint.motor_speed
    old_impulse, max_impulse = joint.motor_impulse, joint.max_motor_impulse
    new_impulse = clamp(old_impulse - joint.motor_mass * Cdot, -max_impulse, max_impulse)
    joint.motor_impulse = new_impulse
    wA = wA - iA * (new_impulse - old_impulse)
    wB = wB + iB * (new_impulse - old_impulse)

    # P = -K⁻¹ Cdot, with the inverse of a 2 × 2 matrix written out.
    Cdot_x = vB_x - wB * rB_y - vA_x + wA * rA_y
    Cdot_y = vB_y + wB * rB_x - vA_y - wA * rA_x
    k_xy, inverse_det = joint.k_xy, joint.k_inverse_det
    P_x = inverse_det * (k_xy * Cdot_y - joint.k_yy * Cdot_x)
    P_y = inverse_det * (k_xy * Cdot_x - joint.k_xx * Cdot_y)
    joint.impulse_x, joint.impulse_y = joint.impulse_x + P_x, joint.impulse_y + P_y
    body_a.v_x, body_a.v_y = vA_x - mA * P_x, vA_y - mA * P_y
    body_a.w = wA - iA * (rA_x * P_y - rA_y * P_x)
    body_b.v_x, body_b.v_y = vB_x + mB * P_x, vB_y + mB * P_y
    body_b.w = wB + iB * (rB_x * P_y - rB_y * P_x)


@inline
def add_motor_work(robot: RobotRecord, joint: JointRecord) -> None:
    """Add |J ω| of a step to the motor's work; see :class:`tasks.simulation.box2d.Motion`."""
    speed = robot.bodies[joint.body_b].w - robot.bodies[joint.body_a].w
    joint.motor_work = joint.motor_work + abs(joint.motor_impulse * speed)


@inline
def solve_position_constraints(robot: RobotRecord, joint: JointRecord) -> bool:
    """b2RevoluteJoint::SolvePositionConstraints. Returns whether the error was small before the correction."""
    body_a, body_b = robot.bodies[joint.body_a], robot.bodies[joint.body_b]
    mA, iA, mB, iB = body_a.inv_mass, body_a.inv_inertia, body_b.inv_mass, body_b.inv_inertia
    cA_x, cA_y, cB_x, cB_y = body_a.c_x, body_a.c_y, body_b.c_x, body_b.c_y
    rA_x, rA_y = rotate(body_a, (joint.local_ra_x, joint.local_ra_y))
    rB_x, rB_y = rotate(body_b, (joint.local_rb_x, joint.local_rb_y))
    C_x, C_y = cB_x + rB_x - cA_x - rA_x, cB_y + rB_y - cA_y - rA_y

    # The products associate otherwise than in the velocity constraint, and so round otherwise.
    k_xx = mA + mB + iA * rA_y * rA_y + iB * rB_y * rB_y
    k_xy = -iA * rA_x * rA_y - iB * rB_x * rB_y
    k_yy = mA + mB + iA * rA_x * rA_x + iB * rB_x * rB_x
    determinant = k_xx * k_yy - k_xy * k_xy
    inverse_det = _ONE / determinant if determinant != 0.0 else determinant
    P_x = inverse_det * (k_xy * C_y - k_yy * C_x)
    P_y = inverse_det * (k_xy * C_x - k_xx * C_y)
    place(body_a, (cA_x - mA * P_x, cA_y - mA * P_y), body_a.a - iA * (rA_x * P_y - rA_y * P_x))
    place(body_b, (cB_x + mB * P_x, cB_y + mB * P_y), body_b.a + iB * (rB_x * P_y - rB_y * P_x))
    return bool(C_x * C_x + C_y * C_y <= LINEAR_SLOP_SQUARED)
