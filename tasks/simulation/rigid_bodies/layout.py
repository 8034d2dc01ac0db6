"""The records of a robot: Box2D's objects with named fields, all in one block of memory.

Each class describes a record twice: to mypy, and to :func:`record_dtype`, which makes the NumPy dtype. numba passes a
record as its address, so ``robot.bodies[b].v_x`` is a single load. Names follow Box2D's members. Quantities are in SI
units and in the world's frame, those named local_… in a body's.
"""

from typing import Annotated, Any, get_args, get_type_hints

import numpy as np
import numpy.typing as npt
from numpy import float32

from tasks.design.genes import N_JOINTS, N_LINKS

GROUND = N_LINKS  # the ground's index among the bodies and among the fixtures
N_BODIES = N_LINKS + 1
MAX_CONTACTS = N_LINKS + N_LINKS * (N_LINKS - 1) // 2 - N_JOINTS
"""Every link with the ground, and every two links except those that a joint ties."""

OfCorners = Annotated[list[float32], 4]
"""A quantity of a box's four corners or edges; edge i goes from corner i to corner i + 1."""


class LinkRecord:
    """A link: its state, what a medium reads, and its place in its body (local_…; see tasks.design.RigidBodies).

    The lever is the link's centre less the body's centre of mass; change_… is the velocity change by the medium.
    """

    x: float32
    y: float32
    angle: float32
    vx: float32
    vy: float32
    omega: float32
    cos: float32
    sin: float32
    length_scale: float32
    width: float32
    mass: float32
    inertia: float32
    change_vx: float32
    change_vy: float32
    change_omega: float32
    lever_x: float32
    lever_y: float32
    body: int
    local_x: float32
    local_y: float32
    local_angle: float32
    local_cos: float32
    local_sin: float32
    local_lever_x: float32
    local_lever_y: float32
    mass_share: float32
    inertia_share: float32
    mass_over_inertia: float32


class BodyRecord:
    """b2Body: centre of mass c and angle a, their velocities v and w, origin p and rotation of the body's frame.

    start_p is p at the start of the step, local_center the centre of mass in the body's frame.
    """

    c_x: float32
    c_y: float32
    a: float32
    v_x: float32
    v_y: float32
    w: float32
    p_x: float32
    p_y: float32
    cos: float32
    sin: float32
    start_p_x: float32
    start_p_y: float32
    inv_mass: float32
    inv_inertia: float32
    local_center_x: float32
    local_center_y: float32


class FixtureRecord:
    """b2Fixture, b2PolygonShape and b2FixtureProxy: a box, its AABB (lower, upper), and its fat AABB."""

    body: int
    fat_lower_x: float32
    fat_lower_y: float32
    fat_upper_x: float32
    fat_upper_y: float32
    lower_x: float32
    lower_y: float32
    upper_x: float32
    upper_y: float32
    local_centroid_x: float32
    local_centroid_y: float32
    centroid_x: float32
    centroid_y: float32
    local_vertex_x: OfCorners
    local_vertex_y: OfCorners
    local_normal_x: OfCorners
    local_normal_y: OfCorners
    local_tangent_x: OfCorners
    local_tangent_y: OfCorners
    vertex_x: OfCorners
    vertex_y: OfCorners
    normal_x: OfCorners
    normal_y: OfCorners


class ContactPointRecord:
    """b2ManifoldPoint and b2VelocityConstraintPoint.

    local is the point in the frame of the body whose edge was clipped, ra and rb from the bodies' centres of mass.
    """

    local_x: float32
    local_y: float32
    id: int
    normal_impulse: float32
    tangent_impulse: float32
    ra_x: float32
    ra_y: float32
    rb_x: float32
    rb_y: float32
    normal_mass: float32
    tangent_mass: float32
    velocity_bias: float32


class ContactRecord:
    """b2Contact, b2Manifold and b2ContactVelocityConstraint.

    It exists (0 or 1) while the fat AABBs overlap. local_normal and local_point are the reference edge's normal and
    centre in the frame of its body, which is B where the manifold is flipped (0 or 1; b2Manifold::e_faceB). The normal
    points from A to B. Of point_count points the velocity solver has solved_count: 1 where a block of 2 is
    ill-conditioned. k is the matrix K of both normal impulses, m its inverse.
    """

    fixture_a: int
    fixture_b: int
    body_a: int
    body_b: int
    exists: int
    point_count: int
    flipped: int
    local_normal_x: float32
    local_normal_y: float32
    local_point_x: float32
    local_point_y: float32
    normal_x: float32
    normal_y: float32
    solved_count: int
    k11: float32
    k12: float32
    k22: float32
    m11: float32
    m12: float32
    m22: float32
    points: Annotated[list[ContactPointRecord], 2]


class JointRecord:
    """b2RevoluteJoint between the links parent and child, and its controller (tasks/simulation/controller.py).

    ra and rb are the joint seen from the bodies' centres of mass; max_motor_impulse is 0 where there is no motor.
    """

    body_a: int
    body_b: int
    parent: int
    child: int
    phase_turns: float32
    motion_range: float32
    rest_angle: float32
    motor_speed: float32
    max_motor_impulse: float32
    local_ra_x: float32
    local_ra_y: float32
    local_rb_x: float32
    local_rb_y: float32
    ra_x: float32
    ra_y: float32
    rb_x: float32
    rb_y: float32
    impulse_x: float32
    impulse_y: float32
    motor_impulse: float32
    k_xx: float32
    k_xy: float32
    k_yy: float32
    k_inverse_det: float32
    motor_mass: float32


class RobotRecord:
    """A robot alone in its b2World.

    Bodies are ordered by their first links, fixtures as their links; the ground is the last of both. Contacts are all
    pairs of fixtures that may collide, ordered by their proxies. Lists hold indices: contact_list of the contacts that
    exist, from the oldest to the newest; island_contacts and island_joints in the order in which the search finds
    them. divergence is NaN from where the robot diverged, 0 before.
    """

    links: Annotated[list[LinkRecord], N_LINKS]
    bodies: Annotated[list[BodyRecord], N_BODIES]
    fixtures: Annotated[list[FixtureRecord], N_BODIES]
    contacts: Annotated[list[ContactRecord], MAX_CONTACTS]
    joints: Annotated[list[JointRecord], N_JOINTS]
    frequency: float32
    divergence: float32
    n_bodies: int
    n_joints: int
    n_pairs: int
    n_contacts: int
    n_island_contacts: int
    n_island_joints: int
    contact_list: Annotated[list[int], MAX_CONTACTS]
    island_contacts: Annotated[list[int], MAX_CONTACTS]
    island_joints: Annotated[list[int], N_JOINTS]
    stack: Annotated[list[int], N_BODIES]


Records = npt.NDArray[np.record]  # records of one of these classes


def record_dtype(record: type) -> np.dtype[Any]:
    """Make the dtype of a class above: float32, int32 for int, and nested records; scalars are np.record."""
    fields: list[Any] = []
    for name, hint in get_type_hints(record, include_extras=True).items():
        shape = getattr(hint, "__metadata__", ())
        element = get_args(get_args(hint)[0])[0] if shape else hint
        fields.append((name, {float32: "f4", int: "i4"}.get(element) or record_dtype(element), shape))
    return np.dtype((np.record, fields))


ROBOT = record_dtype(RobotRecord)
