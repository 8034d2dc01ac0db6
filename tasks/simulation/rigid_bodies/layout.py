"""The records of a robot: Box2D's objects with named fields, all in one block of memory.

A class describes a record to mypy by an example of each field, and :func:`_record_dtype` makes the NumPy dtype from the
examples. numba passes a record as its address, so ``robot.bodies[b].v_x`` is a single load. Names follow Box2D's
members. Quantities are in SI units and in the world's frame, those named local_… in a body's.
"""

from typing import Any

import numpy as np
import numpy.typing as npt
from numpy import float32

from tasks.design.genes import MOST_LINKS

GROUND = MOST_LINKS  # the ground's index among the bodies and among the fixtures
_N_BODIES = MOST_LINKS + 1
MAX_CONTACTS = MOST_LINKS + (MOST_LINKS - 1) * (MOST_LINKS - 2) // 2
"""Every link of the largest robot with the ground, and every two links except those that a joint ties."""

_FLOAT = float32()
_OF_CORNERS = [_FLOAT] * 4  # a quantity of a box's corners or edges; edge i goes from corner i to corner i + 1


class LinkRecord:
    """A link: its state, what a medium reads, and its place in its body (local_…; see tasks.design.RigidBodies).

    The lever is the link's centre less the body's centre of mass; change_… is the velocity change by the medium,
    unkicked_… the velocity now, had only a fluid that reads kicks and gravity acted, and motor_speed what the
    controller commands of the joint with the parent (tasks/simulation/motors.py), whose number is a float for it.
    """

    x, y, angle, vx, vy, omega, cos, sin = [_FLOAT] * 8
    length_scale, mass, inertia = [_FLOAT] * 3
    change_vx, change_vy, change_omega, unkicked_vx, unkicked_vy, unkicked_omega = [_FLOAT] * 6
    parent, motor_speed = [_FLOAT] * 2
    lever_x, lever_y = [_FLOAT] * 2
    body = 0
    local_x, local_y, local_angle, local_cos, local_sin, local_lever_x, local_lever_y = [_FLOAT] * 7
    mass_share, inertia_share, mass_over_inertia = [_FLOAT] * 3


class BodyRecord:
    """b2Body: centre of mass c and angle a, their velocities v and w, origin p and rotation of the body's frame.

    start_p is p at the start of the step, local_center the centre of mass in the body's frame.
    """

    c_x, c_y, a, v_x, v_y, w = [_FLOAT] * 6
    p_x, p_y, cos, sin, start_p_x, start_p_y = [_FLOAT] * 6
    inv_mass, inv_inertia, local_center_x, local_center_y = [_FLOAT] * 4


class FixtureRecord:
    """b2Fixture, b2PolygonShape and b2FixtureProxy: a box, its AABB (lower, upper), and its fat AABB."""

    body = 0
    fat_lower_x, fat_lower_y, fat_upper_x, fat_upper_y = [_FLOAT] * 4
    lower_x, lower_y, upper_x, upper_y = [_FLOAT] * 4
    local_centroid_x, local_centroid_y, centroid_x, centroid_y = [_FLOAT] * 4
    local_vertex_x, local_vertex_y, local_normal_x, local_normal_y = [_OF_CORNERS] * 4
    local_tangent_x, local_tangent_y, vertex_x, vertex_y, normal_x, normal_y = [_OF_CORNERS] * 6


class ContactPointRecord:
    """b2ManifoldPoint and b2VelocityConstraintPoint.

    local is the point in the frame of the body whose edge was clipped, ra and rb from the bodies' centres of mass.
    """

    local_x, local_y = [_FLOAT] * 2
    id = 0
    normal_impulse, tangent_impulse = [_FLOAT] * 2
    ra_x, ra_y, rb_x, rb_y, normal_mass, tangent_mass, velocity_bias = [_FLOAT] * 7


class ContactRecord:
    """b2Contact, b2Manifold and b2ContactVelocityConstraint.

    It exists (0 or 1) while the fat AABBs overlap, and is in the island (0 or 1) once the search has found it.
    local_normal and local_point are the reference edge's normal and centre in the frame of its body, which is B where
    the manifold is flipped (0 or 1; b2Manifold::e_faceB). The normal points from A to B. Of point_count points the
    velocity solver has solved_count: 1 where a block of 2 is ill-conditioned. k is the matrix K of both normal
    impulses, m its inverse.
    """

    fixture_a, fixture_b, body_a, body_b, exists, in_island, point_count, flipped = [0] * 8
    local_normal_x, local_normal_y, local_point_x, local_point_y, normal_x, normal_y = [_FLOAT] * 6
    solved_count = 0
    k11, k12, k22, m11, m12, m22 = [_FLOAT] * 6
    points = [ContactPointRecord()] * 2


class JointRecord:
    """b2RevoluteJoint between the links parent and child.

    ra and rb are the joint seen from the bodies' centres of mass; max_motor_impulse is 0 where there is no motor, and
    motor_work is the motor's work since it began to be counted.
    """

    body_a, body_b, parent, child = [0] * 4
    motor_speed, max_motor_impulse = [_FLOAT] * 2
    local_ra_x, local_ra_y, local_rb_x, local_rb_y, ra_x, ra_y, rb_x, rb_y = [_FLOAT] * 8
    impulse_x, impulse_y, motor_impulse, motor_work = [_FLOAT] * 4
    k_xx, k_xy, k_yy, k_inverse_det, motor_mass = [_FLOAT] * 5


class RobotRecord:
    """A robot alone in its b2World, with room for the largest.

    Bodies are ordered by their first links, fixtures as their links; the ground is the last of both. Contacts are all
    pairs of fixtures that may collide, ordered by their proxies. Lists hold indices: contact_list of the contacts that
    exist, from the oldest to the newest; island_contacts and island_joints in the order in which the search finds
    them. divergence is NaN from where the robot diverged, 0 before.
    """

    links = [LinkRecord()] * MOST_LINKS
    bodies = [BodyRecord()] * _N_BODIES
    fixtures = [FixtureRecord()] * _N_BODIES
    contacts = [ContactRecord()] * MAX_CONTACTS
    joints = [JointRecord()] * (MOST_LINKS - 1)
    divergence = _FLOAT
    n_bodies, n_joints, n_pairs, n_contacts, n_island_contacts, n_island_joints = [0] * 6
    contact_list, island_contacts = [[0] * MAX_CONTACTS] * 2
    island_joints = [0] * (MOST_LINKS - 1)
    stack = [0] * _N_BODIES


Records = npt.NDArray[np.record]  # records of one of these classes


def _record_dtype(record: type) -> np.dtype[Any]:
    """Make the dtype of a class above: float32, int32 for int, and nested records; scalars are np.record."""
    fields: list[Any] = []
    for name, example in vars(record).items():
        if not name.startswith("__"):
            element, shape = (example[0], (len(example),)) if isinstance(example, list) else (example, ())
            scalar = {float32: "f4", int: "i4"}.get(type(element))
            fields.append((name, scalar or _record_dtype(type(element)), shape))
    return np.dtype((np.record, fields))


ROBOT = _record_dtype(RobotRecord)
