"""Packing robots of rigid bodies into blocks: what Box2D makes of bodies, fixtures and joints as they are created."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from tasks.arrays import Float32, Int64
from tasks.design.body import KinematicTrees, RigidBodies
from tasks.design.genes import N_LINKS, Designs
from tasks.simulation.box2d import GROUND_HALF_HEIGHT, GROUND_HALF_WIDTH
from tasks.simulation.controller import Controllers
from tasks.simulation.free_links import sines_and_cosines
from tasks.simulation.rigid_bodies import layout as body_rows
from tasks.simulation.trees import layout
from tasks.world import Physics

GROUND = body_rows.GROUND


def boxes(half_width: Float32, half_height: Float32) -> tuple[Float32, Float32]:
    """b2PolygonShape::SetAsBox: the (..., 4, 2) vertices and normals of boxes."""
    vertices = np.stack(
        [
            np.stack([x, y], axis=-1)
            for x, y in (
                (-half_width, -half_height),
                (half_width, -half_height),
                (half_width, half_height),
                (-half_width, half_height),
            )
        ],
        axis=-2,
    )
    normals = np.array([(0, -1), (1, 0), (0, 1), (-1, 0)], np.float32)
    return vertices, np.broadcast_to(normals, vertices.shape)


def _rotated(vectors: Float32, cos: Float32, sin: Float32) -> Float32:
    """b2Mul(q, v) of (..., 4, 2) vectors."""
    x, y = vectors[..., 0], vectors[..., 1]
    c, s = cos[..., None], sin[..., None]
    return np.stack([c * x - s * y, s * x + c * y], axis=-1)


def compute_mass(vertices: Float32, density: float) -> tuple[Float32, Float32, Float32]:
    """b2PolygonShape::ComputeMass, operation by operation in float32.

    Args:
        vertices: (..., 4, 2) in the body's frame [m].
        density: [kg/m²]

    Returns:
        (...) mass [kg], (..., 2) centre [m], (...) moment of inertia about the frame's origin [kg·m²].
    """
    single = np.float32
    half, quarter, one = single(0.5), single(0.25), single(1)
    third = one / single(3)
    s = vertices[..., 0, :] + vertices[..., 1, :] + vertices[..., 2, :] + vertices[..., 3, :]
    s = s * quarter
    area, inertia = np.zeros(s.shape[:-1], single), np.zeros(s.shape[:-1], single)
    center = np.zeros_like(s)
    for i in range(4):
        e1, e2 = vertices[..., i, :] - s, vertices[..., (i + 1) % 4, :] - s
        (ex1, ey1), (ex2, ey2) = np.moveaxis(e1, -1, 0), np.moveaxis(e2, -1, 0)
        D = ex1 * ey2 - ey1 * ex2
        triangle_area = half * D
        area = area + triangle_area
        center = center + (triangle_area * third)[..., None] * (e1 + e2)
        intx2 = ex1 * ex1 + ex2 * ex1 + ex2 * ex2
        inty2 = ey1 * ey1 + ey2 * ey1 + ey2 * ey2
        inertia = inertia + (quarter * third * D) * (intx2 + inty2)
    rho = single(density)
    mass: Float32 = rho * area
    center = center * (one / area)[..., None]
    from_origin: Float32 = center + s
    inertia = rho * inertia + mass * (_dot(from_origin, from_origin) - _dot(center, center))
    return mass, from_origin, inertia


def _dot(a: Float32, b: Float32) -> Float32:
    product: Float32 = a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1]
    return product


def reset_mass_data(
    rigid: RigidBodies, mass: Float32, center: Float32, inertia: Float32
) -> tuple[Float32, Float32, Float32]:
    """b2Body::ResetMassData: add up the fixtures, of which Box2D lists the last one first.

    Args:
        rigid: which links make up a body.
        mass: (n_designs, n_links) of the fixtures [kg].
        center: (n_designs, n_links, 2) in their bodies' frames [m].
        inertia: (n_designs, n_links) about the frames' origins [kg·m²].

    Returns:
        (n_designs, n_links) inverse mass, inverse inertia and (n_designs, n_links, 2) centre of mass of the bodies, at
        their first links.
    """
    design = np.arange(len(mass))
    total, moment = np.zeros_like(mass), np.zeros_like(inertia)
    local = np.zeros_like(center)
    for link in reversed(range(N_LINKS)):
        first = rigid.first_link[:, link]
        total[design, first] += mass[:, link]
        local[design, first] += mass[:, link, None] * center[:, link]
        moment[design, first] += inertia[:, link]
    one = np.float32(1)
    with np.errstate(divide="ignore", invalid="ignore"):  # where no body is
        inverse_mass: Float32 = (one / total).astype(np.float32)
        local = (local * inverse_mass[..., None]).astype(np.float32)
        inverse_inertia: Float32 = (one / (moment - total * _dot(local, local))).astype(np.float32)
    return inverse_mass, inverse_inertia, local


def body_number(rigid: RigidBodies) -> Int64:
    """(n_designs, n_links) number of the body that each link belongs to: in the order of their first links."""
    number = np.cumsum(rigid.is_first, axis=1) - 1
    return np.take_along_axis(number, rigid.first_link, axis=1)


def fixture_pairs(designs: Designs, rigid: RigidBodies, physics: Physics) -> tuple[Int64, Int64, Int64]:
    """List the pairs of fixtures that may collide, in the order of their proxies' numbers.

    Proxies are numbered as the fixtures were made: the ground's; then, from the body with the last first link to the
    root's, those of each body's links. Of a pair A is the one with the lower number.

    Returns:
        (n_designs, n) fixtures A, (n_designs, n) fixtures B, (n_designs,) how many of the n pairs there are.
    """
    n_designs = len(designs)
    made = np.argsort((N_LINKS - rigid.first_link) * N_LINKS + np.arange(N_LINKS), axis=1)
    made = np.concatenate([np.full((n_designs, 1), GROUND), made], axis=1)
    first, second = np.triu_indices(N_LINKS + 1, 1)
    a, b = made[:, first], made[:, second]
    may = a == GROUND
    if physics.link_collisions:
        link_a, design = np.minimum(a, N_LINKS - 1), np.arange(n_designs)[:, None]
        apart = rigid.first_link[design, link_a] != rigid.first_link[design, b]
        unjoined = (designs.parent[design, link_a] != b) & (designs.parent[design, b] != link_a)
        may = may | (apart & unjoined)
    order = np.argsort(~may, axis=1, kind="stable")[:, : body_rows.MAX_CONTACTS]
    return np.take_along_axis(a, order, axis=1), np.take_along_axis(b, order, axis=1), may.sum(axis=1)


def pack(designs: Designs, trees: KinematicTrees, rigid: RigidBodies, depth: float, physics: Physics) -> Float32:
    """Fill (n_designs, N_ROWS) blocks with what does not change, and with the bodies as they are made."""
    single = np.float32
    records = np.zeros((len(designs), body_rows.N_ROWS), single)
    _pack_links(records, designs, trees, rigid)

    spin, turn = sines_and_cosines(rigid.angle.ravel())
    vertices, normals = boxes(trees.half_width, trees.half_height)
    cos, sin = turn.reshape(rigid.angle.shape), spin.reshape(rigid.angle.shape)
    centroid = np.stack([rigid.x, rigid.y], axis=-1)
    vertices, normals = _rotated(vertices, cos, sin) + centroid[..., None, :], _rotated(normals, cos, sin)
    inverse_mass, inverse_inertia, center = reset_mass_data(rigid, *compute_mass(vertices, physics.link_density))
    _pack_fixtures(records, range(N_LINKS), body_number(rigid), vertices, normals, centroid)

    design, link = np.nonzero(rigid.is_first)
    base = body_rows.BODIES + body_number(rigid)[design, link] * body_rows.N_BODY
    for row, quantity in (
        (body_rows.P_X, trees.x),
        (body_rows.P_Y, trees.y),
        (body_rows.A, trees.angle),
        (body_rows.INVERSE_MASS, inverse_mass),
        (body_rows.INVERSE_INERTIA, inverse_inertia),
        (body_rows.CENTER_X, center[..., 0]),
        (body_rows.CENTER_Y, center[..., 1]),
    ):
        records[design, base + row] = quantity[design, link]
    records.view(np.int32)[:, body_rows.N_BODIES] = rigid.is_first.sum(axis=1)
    _pack_joints(records, designs, trees, rigid, center, physics)
    _pack_ground(records, depth)

    _pack_contacts(records, designs, rigid, physics)
    return records


def _pack_links(records: Float32, designs: Designs, trees: KinematicTrees, rigid: RigidBodies) -> None:
    controllers = Controllers.of(designs)
    length = designs.length_scale.astype(np.float32)
    for row, quantity in (
        (layout.HALF_HEIGHT, trees.half_height),
        (layout.LONG_AXIS, length),
        (layout.SHORT_AXIS, 1 / length),
        (layout.MASS, trees.mass),
        (layout.INERTIA, trees.inertia),
        (layout.PARENT, trees.parent[:, 1:]),
        (layout.PHASE, controllers.phase_turns[:, 1:]),
        (layout.MOTION_RANGE, controllers.motion_range[:, 1:]),
        (layout.REST_ANGLE, controllers.rest_angle[:, 1:]),
        (layout.FREQUENCY, controllers.frequency),
        (body_rows.PLACE_X, rigid.x),
        (body_rows.PLACE_Y, rigid.y),
        (body_rows.PLACE_ANGLE, rigid.angle),
        (body_rows.PLACE_COS, rigid.cos),
        (body_rows.PLACE_SIN, rigid.sin),
        (body_rows.LEVER_X, rigid.lever_x),
        (body_rows.LEVER_Y, rigid.lever_y),
        (body_rows.MASS_SHARE, rigid.mass_share),
        (body_rows.INERTIA_SHARE, rigid.inertia_share),
        (body_rows.MASS_OVER_INERTIA, rigid.mass_over_inertia),
    ):
        records[:, row : row + quantity.shape[1]] = quantity


def _pack_fixtures(
    records: Float32,
    numbers: Sequence[int],
    body: npt.ArrayLike,
    vertices: Float32,
    normals: Float32,
    centroid: Float32,
) -> None:
    """Pack boxes as the fixtures of some numbers: (..., n, 4, 2) vertices and normals, (..., n, 2) centroids."""
    base = body_rows.FIXTURES + np.array(numbers) * body_rows.N_FIXTURE
    records.view(np.int32)[:, base + body_rows.FIXTURE_BODY] = body
    records[:, base + body_rows.CENTROID_X] = centroid[..., 0]
    records[:, base + body_rows.CENTROID_Y] = centroid[..., 1]
    corner = base[:, None] + np.arange(4)
    records[:, corner + body_rows.VERTEX_X], records[:, corner + body_rows.VERTEX_Y] = np.moveaxis(vertices, -1, 0)
    edges = np.roll(vertices, -1, axis=-2) - vertices
    tangents = edges * (np.float32(1) / np.sqrt(_dot(edges, edges)))[..., None]  # b2Vec2::Normalize
    records[:, corner + body_rows.TANGENT_X], records[:, corner + body_rows.TANGENT_Y] = np.moveaxis(tangents, -1, 0)
    records[:, corner + body_rows.NORMAL_X], records[:, corner + body_rows.NORMAL_Y] = np.moveaxis(normals, -1, 0)


def _pack_joints(
    records: Float32, designs: Designs, trees: KinematicTrees, rigid: RigidBodies, center: Float32, physics: Physics
) -> None:
    """Joints by their links; anchors from the centres of mass, as b2RevoluteJoint takes them in every step."""
    design, link = np.nonzero(rigid.is_first & (np.arange(N_LINKS) > 0))
    number = body_number(rigid)
    parent = designs.parent[design, link]
    above = center[design, rigid.first_link[design, parent]]
    own = center[design, link]
    max_motor_impulse = np.float32(physics.time_step) * np.float32(physics.max_motor_torque)
    base = body_rows.JOINTS + (number[design, link] - 1) * body_rows.N_JOINT
    for row, which in (
        (body_rows.BODY_A, number[design, parent]),
        (body_rows.BODY_B, number[design, link]),
        (body_rows.LINK, link),
    ):
        records.view(np.int32)[design, base + row] = which
    for row, quantity in (
        (body_rows.ANCHOR_A_X, rigid.joint_x[design, link] - above[:, 0]),
        (body_rows.ANCHOR_A_Y, rigid.joint_y[design, link] - above[:, 1]),
        (body_rows.ANCHOR_B_X, -own[:, 0]),
        (body_rows.ANCHOR_B_Y, trees.child_anchor[design, link] - own[:, 1]),
        (body_rows.MAX_MOTOR_IMPULSE, designs.motor_on[design, link] * max_motor_impulse),
    ):
        records[design, base + row] = quantity
    records.view(np.int32)[:, body_rows.N_JOINTS_HERE] = rigid.is_first.sum(axis=1) - 1


def _pack_contacts(records: Float32, designs: Designs, rigid: RigidBodies, physics: Physics) -> None:
    fixture_a, fixture_b, n_pairs = fixture_pairs(designs, rigid, physics)
    body = np.concatenate([body_number(rigid), np.full((len(designs), 1), GROUND)], axis=1)
    base = body_rows.CONTACTS + np.arange(body_rows.MAX_CONTACTS) * body_rows.N_CONTACT
    whole = records.view(np.int32)
    whole[:, body_rows.N_PAIRS] = n_pairs
    for row, number in (
        (body_rows.FIXTURE_A, fixture_a),
        (body_rows.FIXTURE_B, fixture_b),
        (body_rows.CONTACT_BODY_A, np.take_along_axis(body, fixture_a, axis=1)),
        (body_rows.CONTACT_BODY_B, np.take_along_axis(body, fixture_b, axis=1)),
    ):
        whole[:, base + row] = number


def _pack_ground(records: Float32, depth: float) -> None:
    """Pack one static box: without mass, at an angle of 0."""
    single = np.float32
    body = body_rows.BODIES + GROUND * body_rows.N_BODY
    y = single(-depth - GROUND_HALF_HEIGHT)
    records[:, [body + body_rows.P_Y, body + body_rows.C_Y]] = y
    records[:, body + body_rows.Q_C] = 1.0
    half_width, half_height = np.full(1, GROUND_HALF_WIDTH, single), np.full(1, GROUND_HALF_HEIGHT, single)
    _pack_fixtures(records, [GROUND], GROUND, *boxes(half_width, half_height), np.zeros((1, 2), single))
