"""The records of a robot: Box2D's objects with named fields, all in one block of memory.

Each class describes a record twice: to mypy, and to :func:`record_dtype`, which makes the NumPy dtype. numba passes a
record as its address, so ``robot.bodies[b].v_x`` is a single load. Names follow Box2D's members. Quantities are in SI
units; those without a suffix _local or local_ are in the world's frame.
"""

from __future__ import annotations

from typing import Annotated, Any, get_args, get_type_hints

import numpy as np
import numpy.typing as npt
from numpy import float32

from tasks.design.genes import N_JOINTS, N_LINKS

GROUND = N_LINKS
"""The ground's index among the bodies and among the fixtures."""
N_BODIES = N_LINKS + 1
MAX_CONTACTS = N_LINKS + N_LINKS * (N_LINKS - 1) // 2 - N_JOINTS
"""Every link with the ground, and every two links except those that a joint ties."""

OfCorners = Annotated[list[float32], 4]
"""A quantity of a box's four corners or edges; edge i goes from corner i to corner i + 1."""


class Link:
    """A link: its state, what a medium needs to know of it, and its place in its body (tasks.design.RigidBodies)."""

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
    """Velocity change by the medium, to be given to the body."""
    change_vy: float32
    change_omega: float32
    lever_x: float32
    """The link's centre less the body's centre of mass."""
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


class Body:
    """b2Body."""

    c_x: float32
    """Centre of mass."""
    c_y: float32
    a: float32
    """Angle."""
    v_x: float32
    """Velocity of the centre of mass."""
    v_y: float32
    w: float32
    """Angular velocity."""
    p_x: float32
    """Origin of the body's frame."""
    p_y: float32
    cos: float32
    sin: float32
    start_p_x: float32
    """Origin of the body's frame at the start of the step."""
    start_p_y: float32
    inv_mass: float32
    inv_inertia: float32
    local_center_x: float32
    """Centre of mass in the body's frame."""
    local_center_y: float32


class Fixture:
    """b2Fixture, b2PolygonShape and b2FixtureProxy: a box, its AABB, and the fat AABB in the broad phase."""

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


class ContactPoint:
    """b2ManifoldPoint and b2VelocityConstraintPoint."""

    local_x: float32
    """The point in the frame of the body whose edge was clipped."""
    local_y: float32
    id: int
    """b2ContactID; see polygons.py."""
    normal_impulse: float32
    tangent_impulse: float32
    ra_x: float32
    """The point from body A's centre of mass."""
    ra_y: float32
    rb_x: float32
    rb_y: float32
    normal_mass: float32
    tangent_mass: float32
    velocity_bias: float32


class Contact:
    """b2Contact, b2Manifold and b2ContactVelocityConstraint."""

    fixture_a: int
    fixture_b: int
    body_a: int
    body_b: int
    exists: int
    """Whether the fat AABBs overlap; 0 or 1."""
    point_count: int
    """Points of the manifold."""
    flipped: int
    """Whether the reference edge is body B's (b2Manifold::e_faceB); 0 or 1."""
    local_normal_x: float32
    """Of the reference edge, in its body's frame."""
    local_normal_y: float32
    local_point_x: float32
    """Centre of the reference edge, in its body's frame."""
    local_point_y: float32
    normal_x: float32
    """From A to B."""
    normal_y: float32
    solved_count: int
    """Points that the velocity solver has: 1 where a block of 2 is ill-conditioned."""
    k11: float32
    """K of both normal impulses, and its inverse M."""
    k12: float32
    k22: float32
    m11: float32
    m12: float32
    m22: float32
    points: Annotated[list[ContactPoint], 2]


class Joint:
    """b2RevoluteJoint, and the controller of its motor (tasks/simulation/controller.py)."""

    body_a: int
    body_b: int
    parent: int
    """The links that it joins."""
    child: int
    phase_turns: float32
    motion_range: float32
    rest_angle: float32
    motor_speed: float32
    max_motor_impulse: float32
    """0 where there is no motor."""
    local_ra_x: float32
    """The joint from body A's centre of mass, in the body's frame."""
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


class Robot:
    """A robot alone in its b2World; lists hold indices, of which the first few count."""

    links: Annotated[list[Link], N_LINKS]
    bodies: Annotated[list[Body], N_BODIES]
    """Ordered by their first links; the ground is the last."""
    fixtures: Annotated[list[Fixture], N_BODIES]
    """A link's has its index; the ground's is the last."""
    contacts: Annotated[list[Contact], MAX_CONTACTS]
    """All pairs of fixtures that may collide, ordered by their proxies."""
    joints: Annotated[list[Joint], N_JOINTS]
    frequency: float32
    divergence: float32
    """NaN from where the robot diverged; 0 before."""
    n_bodies: int
    """Without the ground."""
    n_joints: int
    n_pairs: int
    n_contacts: int
    n_island_contacts: int
    n_island_joints: int
    contact_list: Annotated[list[int], MAX_CONTACTS]
    """Contacts that exist, from the oldest to the newest."""
    island_contacts: Annotated[list[int], MAX_CONTACTS]
    """Contacts that touch, in the order in which the island's search finds them."""
    island_joints: Annotated[list[int], N_JOINTS]
    stack: Annotated[list[int], N_BODIES]
    """Bodies that the search still has to visit."""


Records = npt.NDArray[np.record]
"""Records of one of these classes."""


def record_dtype(record: type) -> np.dtype[Any]:
    """Make the dtype of a class above: float32, int32 for int, and nested records; scalars are np.record."""
    fields: list[Any] = []
    for name, hint in get_type_hints(record, include_extras=True).items():
        shape = getattr(hint, "__metadata__", ())
        element = get_args(get_args(hint)[0])[0] if shape else hint
        fields.append((name, {float32: "f4", int: "i4"}.get(element) or record_dtype(element), shape))
    return np.dtype((np.record, fields))


ROBOT = record_dtype(Robot)
