"""Contacts between two bodies: Box2D 2.3's b2ContactSolver, operation by operation."""

from __future__ import annotations

from typing import Any

from tasks.compiled import inline
from tasks.simulation.rigid_bodies.layout import (
    BIAS,
    C_X,
    C_Y,
    CONSTRAINT_POINTS,
    FACE_B,
    INVERSE_INERTIA,
    INVERSE_MASS,
    K_11,
    K_12,
    K_22,
    LOCAL_NORMAL_X,
    LOCAL_NORMAL_Y,
    LOCAL_POINT_X,
    LOCAL_POINT_Y,
    M_11,
    M_12,
    M_22,
    N_X,
    N_Y,
    NORMAL_IMPULSE,
    NORMAL_MASS,
    POINT_COUNT,
    POINT_X,
    POINT_Y,
    RA_X,
    RA_Y,
    RB_X,
    RB_Y,
    TANGENT_IMPULSE,
    TANGENT_MASS,
    V_X,
    V_Y,
    A,
    W,
)
from tasks.simulation.rigid_bodies.records import place, point_at, rotate, transform
from tasks.simulation.simd.lanes import any_lane, load_whole, select, store_whole
from tasks.simulation.trees.contact import (
    BAUMGARTE,
    MAX_CONDITION_NUMBER,
    MAX_LINEAR_CORRECTION,
    POLYGON_RADIUS,
    VELOCITY_THRESHOLD,
)
from tasks.simulation.trees.joint import LINEAR_SLOP, clamp


@inline
def _effective_mass(body_a: Any, body_b: Any, a1: Any, b1: Any, a2: Any, b2: Any) -> Any:
    """MA + mB + iA a1 a2 + iB b1 b2."""
    mA, mB = body_a[INVERSE_MASS], body_b[INVERSE_MASS]
    iA, iB = body_a[INVERSE_INERTIA], body_b[INVERSE_INERTIA]
    return mA + mB + iA * a1 * a2 + iB * b1 * b2


@inline
def _relative_velocity(point: Any, vA_x: Any, vA_y: Any, wA: Any, vB_x: Any, vB_y: Any, wB: Any) -> Any:
    """VB + cross(wB, rB) - vA - cross(wA, rA)."""
    return vB_x - wB * point[RB_Y] - vA_x + wA * point[RA_Y], vB_y + wB * point[RB_X] - vA_y - wA * point[RA_X]


@inline
def initialize_velocity_constraint(contact: Any, body_a: Any, body_b: Any, restitution: Any) -> None:
    """b2ContactSolver::InitializeVelocityConstraints and b2WorldManifold::Initialize (b2Collision.cpp)."""
    face_b = load_whole(contact, FACE_B) != 0
    reference, incident = (body_b, body_a) if face_b else (body_a, body_b)
    n_x, n_y = rotate(reference, contact[LOCAL_NORMAL_X], contact[LOCAL_NORMAL_Y])
    plane_x, plane_y = transform(reference, contact[LOCAL_POINT_X], contact[LOCAL_POINT_Y])
    if face_b:
        contact[N_X], contact[N_Y] = -n_x, -n_y
    else:
        contact[N_X], contact[N_Y] = n_x, n_y
    normal_x, normal_y = contact[N_X], contact[N_Y]
    tangent_x, tangent_y = normal_y, -normal_x
    count = load_whole(contact, POINT_COUNT)
    for j in range(count):
        point = point_at(contact, j)
        clip_x, clip_y = transform(incident, point[POINT_X], point[POINT_Y])
        on_face = POLYGON_RADIUS - ((clip_x - plane_x) * n_x + (clip_y - plane_y) * n_y)
        x = 0.5 * ((clip_x + on_face * n_x) + (clip_x - POLYGON_RADIUS * n_x))
        y = 0.5 * ((clip_y + on_face * n_y) + (clip_y - POLYGON_RADIUS * n_y))
        rA_x, rA_y = x - body_a[C_X], y - body_a[C_Y]
        rB_x, rB_y = x - body_b[C_X], y - body_b[C_Y]
        point[RA_X], point[RA_Y], point[RB_X], point[RB_Y] = rA_x, rA_y, rB_x, rB_y

        rnA, rnB = rA_x * normal_y - rA_y * normal_x, rB_x * normal_y - rB_y * normal_x
        point[NORMAL_MASS] = 1.0 / _effective_mass(body_a, body_b, rnA, rnB, rnA, rnB)
        rtA, rtB = rA_x * tangent_y - rA_y * tangent_x, rB_x * tangent_y - rB_y * tangent_x
        point[TANGENT_MASS] = 1.0 / _effective_mass(body_a, body_b, rtA, rtB, rtA, rtB)
        dv_x, dv_y = _relative_velocity(point, body_a[V_X], body_a[V_Y], body_a[W], body_b[V_X], body_b[V_Y], body_b[W])
        v_rel = normal_x * dv_x + normal_y * dv_y
        point[BIAS] = select(v_rel < -VELOCITY_THRESHOLD, -(restitution * v_rel), 0.0)

    store_whole(contact, CONSTRAINT_POINTS, count)
    if count == 2:
        point_1, point_2 = point_at(contact, 0), point_at(contact, 1)
        rn1A = point_1[RA_X] * normal_y - point_1[RA_Y] * normal_x
        rn1B = point_1[RB_X] * normal_y - point_1[RB_Y] * normal_x
        rn2A = point_2[RA_X] * normal_y - point_2[RA_Y] * normal_x
        rn2B = point_2[RB_X] * normal_y - point_2[RB_Y] * normal_x
        k11 = _effective_mass(body_a, body_b, rn1A, rn1B, rn1A, rn1B)
        k22 = _effective_mass(body_a, body_b, rn2A, rn2B, rn2A, rn2B)
        k12 = _effective_mass(body_a, body_b, rn1A, rn1B, rn2A, rn2B)
        determinant = k11 * k22 - k12 * k12
        if any_lane(k11 * k11 < MAX_CONDITION_NUMBER * determinant):
            inverse = select(determinant != 0.0, 1.0 / determinant, determinant)
            contact[K_11], contact[K_12], contact[K_22] = k11, k12, k22
            contact[M_11], contact[M_12], contact[M_22] = inverse * k22, -inverse * k12, inverse * k11
        else:
            store_whole(contact, CONSTRAINT_POINTS, 1)  # the constraints are redundant: just use one


@inline
def warm_start(contact: Any, body_a: Any, body_b: Any, dt_ratio: Any) -> None:
    """b2ContactSolver::WarmStart. A point that is left out keeps its impulses for the next step."""
    mA, iA, mB, iB = body_a[INVERSE_MASS], body_a[INVERSE_INERTIA], body_b[INVERSE_MASS], body_b[INVERSE_INERTIA]
    normal_x, normal_y = contact[N_X], contact[N_Y]
    tangent_x, tangent_y = normal_y, -normal_x
    for j in range(load_whole(contact, CONSTRAINT_POINTS)):
        point = point_at(contact, j)
        normal_impulse, tangent_impulse = dt_ratio * point[NORMAL_IMPULSE], dt_ratio * point[TANGENT_IMPULSE]
        point[NORMAL_IMPULSE], point[TANGENT_IMPULSE] = normal_impulse, tangent_impulse
        P_x = normal_impulse * normal_x + tangent_impulse * tangent_x
        P_y = normal_impulse * normal_y + tangent_impulse * tangent_y
        body_a[W] = body_a[W] - iA * (point[RA_X] * P_y - point[RA_Y] * P_x)
        body_a[V_X], body_a[V_Y] = body_a[V_X] - mA * P_x, body_a[V_Y] - mA * P_y
        body_b[W] = body_b[W] + iB * (point[RB_X] * P_y - point[RB_Y] * P_x)
        body_b[V_X], body_b[V_Y] = body_b[V_X] + mB * P_x, body_b[V_Y] + mB * P_y


@inline
def solve_velocity_constraint(contact: Any, body_a: Any, body_b: Any, friction: Any) -> None:
    """b2ContactSolver::SolveVelocityConstraints: friction at each point, then the normal impulses, of two as a block.

    The impulses stay where they are for the next step, so there is nothing left for StoreImpulses.
    """
    mA, iA, mB, iB = body_a[INVERSE_MASS], body_a[INVERSE_INERTIA], body_b[INVERSE_MASS], body_b[INVERSE_INERTIA]
    vA_x, vA_y, wA = body_a[V_X], body_a[V_Y], body_a[W]
    vB_x, vB_y, wB = body_b[V_X], body_b[V_Y], body_b[W]
    normal_x, normal_y = contact[N_X], contact[N_Y]
    tangent_x, tangent_y = normal_y, -normal_x
    count = load_whole(contact, CONSTRAINT_POINTS)
    for j in range(count):
        point = point_at(contact, j)
        dv_x, dv_y = _relative_velocity(point, vA_x, vA_y, wA, vB_x, vB_y, wB)
        vt = dv_x * tangent_x + dv_y * tangent_y
        max_friction = friction * point[NORMAL_IMPULSE]
        old = point[TANGENT_IMPULSE]
        new = clamp(old - point[TANGENT_MASS] * vt, -max_friction, max_friction)
        point[TANGENT_IMPULSE] = new
        P_x, P_y = (new - old) * tangent_x, (new - old) * tangent_y
        vA_x, vA_y = vA_x - mA * P_x, vA_y - mA * P_y
        wA = wA - iA * (point[RA_X] * P_y - point[RA_Y] * P_x)
        vB_x, vB_y = vB_x + mB * P_x, vB_y + mB * P_y
        wB = wB + iB * (point[RB_X] * P_y - point[RB_Y] * P_x)

    point_1, point_2 = point_at(contact, 0), point_at(contact, 1)
    dv_x, dv_y = _relative_velocity(point_1, vA_x, vA_y, wA, vB_x, vB_y, wB)
    b1 = (dv_x * normal_x + dv_y * normal_y) - point_1[BIAS]
    a1 = point_1[NORMAL_IMPULSE]
    if count == 1:
        x1 = a1 - point_1[NORMAL_MASS] * b1
        x1 = select(x1 > 0.0, x1, 0.0)
        point_1[NORMAL_IMPULSE] = x1
        P_x, P_y = (x1 - a1) * normal_x, (x1 - a1) * normal_y
        turn_a, turn_b = point_1[RA_X] * P_y - point_1[RA_Y] * P_x, point_1[RB_X] * P_y - point_1[RB_Y] * P_x
    else:
        dv_x, dv_y = _relative_velocity(point_2, vA_x, vA_y, wA, vB_x, vB_y, wB)
        b2 = (dv_x * normal_x + dv_y * normal_y) - point_2[BIAS]
        a2 = point_2[NORMAL_IMPULSE]
        x1, x2 = _solve_block(contact, point_1[NORMAL_MASS], point_2[NORMAL_MASS], a1, a2, b1, b2)
        point_1[NORMAL_IMPULSE], point_2[NORMAL_IMPULSE] = x1, x2
        P1_x, P1_y = (x1 - a1) * normal_x, (x1 - a1) * normal_y
        P2_x, P2_y = (x2 - a2) * normal_x, (x2 - a2) * normal_y
        P_x, P_y = P1_x + P2_x, P1_y + P2_y
        turn_a = (point_1[RA_X] * P1_y - point_1[RA_Y] * P1_x) + (point_2[RA_X] * P2_y - point_2[RA_Y] * P2_x)
        turn_b = (point_1[RB_X] * P1_y - point_1[RB_Y] * P1_x) + (point_2[RB_X] * P2_y - point_2[RB_Y] * P2_x)
    body_a[V_X], body_a[V_Y], body_a[W] = vA_x - mA * P_x, vA_y - mA * P_y, wA - iA * turn_a
    body_b[V_X], body_b[V_Y], body_b[W] = vB_x + mB * P_x, vB_y + mB * P_y, wB + iB * turn_b


@inline
def solve_velocity_constraint_on_ground(contact: Any, body_b: Any, friction: Any) -> None:
    """Do the same where body A is the ground: the normal is (0, 1), and what Box2D multiplies by 0 or 1 is left out."""
    mB, iB = body_b[INVERSE_MASS], body_b[INVERSE_INERTIA]
    vx, vy, w = body_b[V_X], body_b[V_Y], body_b[W]
    count = load_whole(contact, CONSTRAINT_POINTS)
    for j in range(count):
        point = point_at(contact, j)
        max_friction = friction * point[NORMAL_IMPULSE]
        old = point[TANGENT_IMPULSE]
        new = clamp(old - point[TANGENT_MASS] * (vx - w * point[RB_Y]), -max_friction, max_friction)
        point[TANGENT_IMPULSE] = new
        vx = vx + mB * (new - old)
        w = w - iB * (point[RB_Y] * (new - old))

    point_1, point_2 = point_at(contact, 0), point_at(contact, 1)
    b1 = (vy + w * point_1[RB_X]) - point_1[BIAS]
    a1 = point_1[NORMAL_IMPULSE]
    if count == 1:
        x1 = a1 - point_1[NORMAL_MASS] * b1
        x1 = select(x1 > 0.0, x1, 0.0)
        point_1[NORMAL_IMPULSE] = x1
        impulse, turn = x1 - a1, point_1[RB_X] * (x1 - a1)
    else:
        b2 = (vy + w * point_2[RB_X]) - point_2[BIAS]
        a2 = point_2[NORMAL_IMPULSE]
        x1, x2 = _solve_block(contact, point_1[NORMAL_MASS], point_2[NORMAL_MASS], a1, a2, b1, b2)
        point_1[NORMAL_IMPULSE], point_2[NORMAL_IMPULSE] = x1, x2
        impulse = (x1 - a1) + (x2 - a2)
        turn = point_1[RB_X] * (x1 - a1) + point_2[RB_X] * (x2 - a2)
    body_b[V_X], body_b[V_Y], body_b[W] = vx, vy + mB * impulse, w + iB * turn


@inline
def _solve_block(contact: Any, normal_mass_1: Any, normal_mass_2: Any, a1: Any, a2: Any, b1: Any, b2: Any) -> Any:
    """Solve the linear complementarity problem b = K x + b', x ≥ 0, b ≥ 0, x · b = 0: the first case that holds."""
    k12 = contact[K_12]
    b1, b2 = b1 - (contact[K_11] * a1 + k12 * a2), b2 - (k12 * a1 + contact[K_22] * a2)
    x1 = -(contact[M_11] * b1 + contact[M_12] * b2)
    x2 = -(contact[M_12] * b1 + contact[M_22] * b2)
    zero = 0.0 * k12
    if any_lane((x1 >= 0.0) & (x2 >= 0.0)):
        return x1, x2
    x1 = -(normal_mass_1 * b1)
    if any_lane((x1 >= 0.0) & (k12 * x1 + b2 >= 0.0)):
        return x1, zero
    x2 = -(normal_mass_2 * b2)
    if any_lane((x2 >= 0.0) & (k12 * x2 + b1 >= 0.0)):
        return zero, x2
    if any_lane((b1 >= 0.0) & (b2 >= 0.0)):
        return zero, zero
    return a1, a2


@inline
def solve_position_constraint(contact: Any, body_a: Any, body_b: Any) -> Any:
    """b2ContactSolver::SolvePositionConstraints and b2PositionSolverManifold: push out; return the least separation."""
    mA, iA, mB, iB = body_a[INVERSE_MASS], body_a[INVERSE_INERTIA], body_b[INVERSE_MASS], body_b[INVERSE_INERTIA]
    face_b = load_whole(contact, FACE_B) != 0
    reference, incident = (body_b, body_a) if face_b else (body_a, body_b)
    least = 0.0 * mA
    for j in range(load_whole(contact, POINT_COUNT)):
        point = point_at(contact, j)
        n_x, n_y = rotate(reference, contact[LOCAL_NORMAL_X], contact[LOCAL_NORMAL_Y])
        plane_x, plane_y = transform(reference, contact[LOCAL_POINT_X], contact[LOCAL_POINT_Y])
        clip_x, clip_y = transform(incident, point[POINT_X], point[POINT_Y])
        separation = (clip_x - plane_x) * n_x + (clip_y - plane_y) * n_y - POLYGON_RADIUS - POLYGON_RADIUS
        least = select(least < separation, least, separation)
        C = clamp(BAUMGARTE * (separation + LINEAR_SLOP), -MAX_LINEAR_CORRECTION, 0.0)
        if any_lane(C == 0.0):
            continue  # nothing moves
        if face_b:
            n_x, n_y = -n_x, -n_y
        cA_x, cA_y, cB_x, cB_y = body_a[C_X], body_a[C_Y], body_b[C_X], body_b[C_Y]
        rA_x, rA_y, rB_x, rB_y = clip_x - cA_x, clip_y - cA_y, clip_x - cB_x, clip_y - cB_y
        rnA, rnB = rA_x * n_y - rA_y * n_x, rB_x * n_y - rB_y * n_x
        impulse = -C / _effective_mass(body_a, body_b, rnA, rnB, rnA, rnB)
        P_x, P_y = impulse * n_x, impulse * n_y
        if any_lane(mA != 0.0):  # the ground does not move
            place(body_a, cA_x - mA * P_x, cA_y - mA * P_y, body_a[A] - iA * (rA_x * P_y - rA_y * P_x))
        place(body_b, cB_x + mB * P_x, cB_y + mB * P_y, body_b[A] + iB * (rB_x * P_y - rB_y * P_x))
    return least
