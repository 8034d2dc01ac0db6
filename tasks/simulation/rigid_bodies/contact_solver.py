"""Contacts between two bodies: Box2D 2.3's b2ContactSolver, operation by operation.

At a point with normal n from A to B, tangent t = (n_y, -n_x), and r the point seen from each centre of mass:

    C    = dot(pB - pA, n), the separation; pA and pB are the deepest points of both bodies
    Cdot = dot(vB + cross(wB, rB) - vA - cross(wA, rA), n)        along t for friction
    J    = [-n  -cross(rA, n)  n  cross(rB, n)]                   for (vA, wA, vB, wB)
    K    = J M⁻¹ Jᵀ = mA + mB + iA cross(rA, n)² + iB cross(rB, n)²

m and i are inverse masses and inertias. The accumulated normal impulse x satisfies x ≥ 0, Cdot - bias ≥ 0 and
x (Cdot - bias) = 0; friction stays within ± μ x. Two points share a matrix K, whose K₁₂ has the cross products of both.
"""

from numpy import float32

import tasks.simulation.box2d as box2d
from tasks.compiled import inline
from tasks.simulation.rigid_bodies.layout import BodyRecord, ContactPointRecord, ContactRecord, RobotRecord
from tasks.simulation.rigid_bodies.transform import place, rotate, transform
from tasks.simulation.trees.joint import clamp

_ZERO, _HALF, _ONE = float32(0), float32(0.5), float32(1)


@inline
def _effective_mass(
    body_a: BodyRecord, body_b: BodyRecord, a1: float32, b1: float32, a2: float32, b2: float32
) -> float32:
    """Compute an element of K, given cross(rA, n) and cross(rB, n) of its two points."""
    mA, mB, iA, iB = body_a.inv_mass, body_b.inv_mass, body_a.inv_inertia, body_b.inv_inertia
    return mA + mB + iA * a1 * a2 + iB * b1 * b2


@inline
def _relative_velocity(
    point: ContactPointRecord, vA_x: float32, vA_y: float32, wA: float32, vB_x: float32, vB_y: float32, wB: float32
) -> tuple[float32, float32]:
    """VB + cross(wB, rB) - vA - cross(wA, rA)."""
    return vB_x - wB * point.rb_y - vA_x + wA * point.ra_y, vB_y + wB * point.rb_x - vA_y - wA * point.ra_x


@inline
def initialize_velocity_constraint(robot: RobotRecord, contact: ContactRecord, restitution: float32) -> None:
    """b2ContactSolver::InitializeVelocityConstraints and b2WorldManifold::Initialize (b2Collision.cpp)."""
    body_a, body_b = robot.bodies[contact.body_a], robot.bodies[contact.body_b]
    flipped = contact.flipped != 0
    reference, incident = (body_b, body_a) if flipped else (body_a, body_b)
    n_x, n_y = rotate(reference, (contact.local_normal_x, contact.local_normal_y))
    plane_x, plane_y = transform(reference, (contact.local_point_x, contact.local_point_y))
    normal_x, normal_y = (-n_x, -n_y) if flipped else (n_x, n_y)
    tangent_x, tangent_y = normal_y, -normal_x
    contact.normal_x, contact.normal_y = normal_x, normal_y
    for j in range(contact.point_count):
        # The point lies midway between the surfaces of both skins.
        point = contact.points[j]
        clip_x, clip_y = transform(incident, (point.local_x, point.local_y))
        on_face = box2d.POLYGON_RADIUS - ((clip_x - plane_x) * n_x + (clip_y - plane_y) * n_y)
        x = _HALF * ((clip_x + on_face * n_x) + (clip_x - box2d.POLYGON_RADIUS * n_x))
        y = _HALF * ((clip_y + on_face * n_y) + (clip_y - box2d.POLYGON_RADIUS * n_y))
        rA_x, rA_y, rB_x, rB_y = x - body_a.c_x, y - body_a.c_y, x - body_b.c_x, y - body_b.c_y
        point.ra_x, point.ra_y, point.rb_x, point.rb_y = rA_x, rA_y, rB_x, rB_y

        rnA, rnB = rA_x * normal_y - rA_y * normal_x, rB_x * normal_y - rB_y * normal_x
        point.normal_mass = _ONE / _effective_mass(body_a, body_b, rnA, rnB, rnA, rnB)
        rtA, rtB = rA_x * tangent_y - rA_y * tangent_x, rB_x * tangent_y - rB_y * tangent_x
        point.tangent_mass = _ONE / _effective_mass(body_a, body_b, rtA, rtB, rtA, rtB)
        dv_x, dv_y = _relative_velocity(point, body_a.v_x, body_a.v_y, body_a.w, body_b.v_x, body_b.v_y, body_b.w)
        v_rel = normal_x * dv_x + normal_y * dv_y
        point.velocity_bias = -(restitution * v_rel) if v_rel < -box2d.VELOCITY_THRESHOLD else _ZERO

    contact.solved_count = contact.point_count
    if contact.point_count == 2:
        _initialize_block(contact, body_a, body_b)


@inline
def _initialize_block(contact: ContactRecord, body_a: BodyRecord, body_b: BodyRecord) -> None:
    """K of both points and its inverse; an ill-conditioned K means that the points are redundant, and one is left."""
    normal_x, normal_y = contact.normal_x, contact.normal_y
    point_1, point_2 = contact.points[0], contact.points[1]
    rn1A, rn1B = point_1.ra_x * normal_y - point_1.ra_y * normal_x, point_1.rb_x * normal_y - point_1.rb_y * normal_x
    rn2A, rn2B = point_2.ra_x * normal_y - point_2.ra_y * normal_x, point_2.rb_x * normal_y - point_2.rb_y * normal_x
    k11 = _effective_mass(body_a, body_b, rn1A, rn1B, rn1A, rn1B)
    k22 = _effective_mass(body_a, body_b, rn2A, rn2B, rn2A, rn2B)
    k12 = _effective_mass(body_a, body_b, rn1A, rn1B, rn2A, rn2B)
    determinant = k11 * k22 - k12 * k12
    if k11 * k11 < box2d.MAX_CONDITION_NUMBER * determinant:
        inverse_det = _ONE / determinant if determinant != 0.0 else determinant
        contact.k11, contact.k12, contact.k22 = k11, k12, k22
        contact.m11, contact.m12, contact.m22 = inverse_det * k22, -inverse_det * k12, inverse_det * k11
    else:
        contact.solved_count = 1


@inline
def warm_start(robot: RobotRecord, contact: ContactRecord, dt_ratio: float32) -> None:
    """b2ContactSolver::WarmStart. A redundant point keeps its impulses for the next step."""
    body_a, body_b = robot.bodies[contact.body_a], robot.bodies[contact.body_b]
    mA, iA, mB, iB = body_a.inv_mass, body_a.inv_inertia, body_b.inv_mass, body_b.inv_inertia
    normal_x, normal_y = contact.normal_x, contact.normal_y
    tangent_x, tangent_y = normal_y, -normal_x
    for j in range(contact.solved_count):
        point = contact.points[j]
        normal_impulse, tangent_impulse = dt_ratio * point.normal_impulse, dt_ratio * point.tangent_impulse
        point.normal_impulse, point.tangent_impulse = normal_impulse, tangent_impulse
        P_x = normal_impulse * normal_x + tangent_impulse * tangent_x
        P_y = normal_impulse * normal_y + tangent_impulse * tangent_y
        body_a.w = body_a.w - iA * (point.ra_x * P_y - point.ra_y * P_x)
        body_a.v_x, body_a.v_y = body_a.v_x - mA * P_x, body_a.v_y - mA * P_y
        body_b.w = body_b.w + iB * (point.rb_x * P_y - point.rb_y * P_x)
        body_b.v_x, body_b.v_y = body_b.v_x + mB * P_x, body_b.v_y + mB * P_y


@inline
def solve_velocity_constraint(robot: RobotRecord, contact: ContactRecord, friction: float32) -> None:
    """b2ContactSolver::SolveVelocityConstraints: friction at each point, then the normal impulses, of two as a block.

    The impulses stay in the contact for the next step, so StoreImpulses has nothing to do.
    """
    body_a, body_b = robot.bodies[contact.body_a], robot.bodies[contact.body_b]
    mA, iA, mB, iB = body_a.inv_mass, body_a.inv_inertia, body_b.inv_mass, body_b.inv_inertia
    vA_x, vA_y, wA = body_a.v_x, body_a.v_y, body_a.w
    vB_x, vB_y, wB = body_b.v_x, body_b.v_y, body_b.w
    normal_x, normal_y = contact.normal_x, contact.normal_y
    tangent_x, tangent_y = normal_y, -normal_x
    for j in range(contact.solved_count):
        point = contact.points[j]
        dv_x, dv_y = _relative_velocity(point, vA_x, vA_y, wA, vB_x, vB_y, wB)
        impulse = _friction_impulse(point, dv_x * tangent_x + dv_y * tangent_y, friction)
        P_x, P_y = impulse * tangent_x, impulse * tangent_y
        vA_x, vA_y = vA_x - mA * P_x, vA_y - mA * P_y
        wA = wA - iA * (point.ra_x * P_y - point.ra_y * P_x)
        vB_x, vB_y = vB_x + mB * P_x, vB_y + mB * P_y
        wB = wB + iB * (point.rb_x * P_y - point.rb_y * P_x)

    point_1, point_2 = contact.points[0], contact.points[1]
    dv_x, dv_y = _relative_velocity(point_1, vA_x, vA_y, wA, vB_x, vB_y, wB)
    Cdot_1 = dv_x * normal_x + dv_y * normal_y
    if contact.solved_count == 1:
        impulse = _normal_impulse(point_1, Cdot_1)
        P_x, P_y = impulse * normal_x, impulse * normal_y
        turn_a, turn_b = point_1.ra_x * P_y - point_1.ra_y * P_x, point_1.rb_x * P_y - point_1.rb_y * P_x
    else:
        dv_x, dv_y = _relative_velocity(point_2, vA_x, vA_y, wA, vB_x, vB_y, wB)
        d_1, d_2 = _normal_impulses(contact, Cdot_1, dv_x * normal_x + dv_y * normal_y)
        P1_x, P1_y = d_1 * normal_x, d_1 * normal_y
        P2_x, P2_y = d_2 * normal_x, d_2 * normal_y
        P_x, P_y = P1_x + P2_x, P1_y + P2_y
        turn_a = (point_1.ra_x * P1_y - point_1.ra_y * P1_x) + (point_2.ra_x * P2_y - point_2.ra_y * P2_x)
        turn_b = (point_1.rb_x * P1_y - point_1.rb_y * P1_x) + (point_2.rb_x * P2_y - point_2.rb_y * P2_x)
    body_a.v_x, body_a.v_y, body_a.w = vA_x - mA * P_x, vA_y - mA * P_y, wA - iA * turn_a
    body_b.v_x, body_b.v_y, body_b.w = vB_x + mB * P_x, vB_y + mB * P_y, wB + iB * turn_b


@inline
def _friction_impulse(point: ContactPointRecord, Cdot: float32, friction: float32) -> float32:
    """Accumulate the tangential impulse of a point within ± μ times its normal impulse; return the change."""
    max_friction = friction * point.normal_impulse
    old = point.tangent_impulse
    point.tangent_impulse = clamp(old - point.tangent_mass * Cdot, -max_friction, max_friction)
    return point.tangent_impulse - old


@inline
def _normal_impulse(point: ContactPointRecord, Cdot: float32) -> float32:
    """Accumulate the normal impulse of a single point, at least 0; return the change."""
    old = point.normal_impulse
    new = old - point.normal_mass * (Cdot - point.velocity_bias)
    point.normal_impulse = new if new > 0.0 else _ZERO
    return point.normal_impulse - old


@inline
def _normal_impulses(contact: ContactRecord, Cdot_1: float32, Cdot_2: float32) -> tuple[float32, float32]:
    """Accumulate the normal impulses of two points together; return the changes."""
    point_1, point_2 = contact.points[0], contact.points[1]
    a1, a2 = point_1.normal_impulse, point_2.normal_impulse
    x1, x2 = _solve_block(contact, a1, a2, Cdot_1 - point_1.velocity_bias, Cdot_2 - point_2.velocity_bias)
    point_1.normal_impulse, point_2.normal_impulse = x1, x2
    return x1 - a1, x2 - a2


@inline
def _solve_block(contact: ContactRecord, a1: float32, a2: float32, b1: float32, b2: float32) -> tuple[float32, float32]:
    """Solve the linear complementarity problem of two points for their accumulated impulses x.

        b = K x + b'      x ≥ 0      b ≥ 0      x · b = 0

    with b' = b - K a, where a are the impulses so far. Of the four cases the first that holds is the solution.
    """
    k12 = contact.k12
    b1, b2 = b1 - (contact.k11 * a1 + k12 * a2), b2 - (k12 * a1 + contact.k22 * a2)
    x1 = -(contact.m11 * b1 + contact.m12 * b2)  # b = 0
    x2 = -(contact.m12 * b1 + contact.m22 * b2)
    if x1 >= 0.0 and x2 >= 0.0:
        return x1, x2
    x1 = -(contact.points[0].normal_mass * b1)  # b1 = 0 and x2 = 0
    if x1 >= 0.0 and k12 * x1 + b2 >= 0.0:
        return x1, _ZERO
    x2 = -(contact.points[1].normal_mass * b2)  # x1 = 0 and b2 = 0
    if x2 >= 0.0 and k12 * x2 + b1 >= 0.0:
        return _ZERO, x2
    if b1 >= 0.0 and b2 >= 0.0:  # x = 0
        return _ZERO, _ZERO
    return a1, a2


@inline
def solve_position_constraint(robot: RobotRecord, contact: ContactRecord) -> float32:
    """b2ContactSolver::SolvePositionConstraints and b2PositionSolverManifold.

    A fraction of the separation beyond the slop is corrected: P = -C / K with C = clamp(β (separation + slop)). Returns
    the least separation before the correction [m], at most 0.
    """
    body_a, body_b = robot.bodies[contact.body_a], robot.bodies[contact.body_b]
    mA, iA, mB, iB = body_a.inv_mass, body_a.inv_inertia, body_b.inv_mass, body_b.inv_inertia
    flipped = contact.flipped != 0
    reference, incident = (body_b, body_a) if flipped else (body_a, body_b)
    least = _ZERO
    for j in range(contact.point_count):
        point = contact.points[j]
        n_x, n_y = rotate(reference, (contact.local_normal_x, contact.local_normal_y))
        plane_x, plane_y = transform(reference, (contact.local_point_x, contact.local_point_y))
        clip_x, clip_y = transform(incident, (point.local_x, point.local_y))
        separation = (clip_x - plane_x) * n_x + (clip_y - plane_y) * n_y - box2d.POLYGON_RADIUS - box2d.POLYGON_RADIUS
        least = least if least < separation else separation
        C = clamp(box2d.BAUMGARTE * (separation + box2d.LINEAR_SLOP), -box2d.MAX_LINEAR_CORRECTION, _ZERO)
        if C == 0.0:
            continue  # nothing moves
        if flipped:
            n_x, n_y = -n_x, -n_y
        cA_x, cA_y, cB_x, cB_y = body_a.c_x, body_a.c_y, body_b.c_x, body_b.c_y
        rA_x, rA_y, rB_x, rB_y = clip_x - cA_x, clip_y - cA_y, clip_x - cB_x, clip_y - cB_y
        rnA, rnB = rA_x * n_y - rA_y * n_x, rB_x * n_y - rB_y * n_x
        impulse = -C / _effective_mass(body_a, body_b, rnA, rnB, rnA, rnB)
        P_x, P_y = impulse * n_x, impulse * n_y
        if mA != 0.0:  # not the ground
            place(body_a, (cA_x - mA * P_x, cA_y - mA * P_y), body_a.a - iA * (rA_x * P_y - rA_y * P_x))
        place(body_b, (cB_x + mB * P_x, cB_y + mB * P_y), body_b.a + iB * (rB_x * P_y - rB_y * P_x))
    return least
