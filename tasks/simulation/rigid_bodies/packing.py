"""Packing robots into records: b2Body, b2Fixture and b2Joint as Box2D creates them."""

import numpy as np
import numpy.typing as npt

from tasks.arrays import Float32, Int64
from tasks.design.body import KinematicTrees, RigidBodies
from tasks.design.genes import Designs
from tasks.simulation.box2d import GROUND_HALF_HEIGHT, GROUND_HALF_WIDTH
from tasks.simulation.free_links import sines_and_cosines
from tasks.simulation.rigid_bodies.layout import GROUND, ROBOT, Records
from tasks.world.physics import Physics


def boxes(half_width: Float32, half_height: Float32) -> tuple[Float32, Float32]:
    """b2PolygonShape::SetAsBox: the (..., 4, 2) vertices and normals of boxes."""
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)], np.float32)
    vertices = np.stack([half_width, half_height], axis=-1)[..., None, :] * corners
    normals = np.array([(0, -1), (1, 0), (0, 1), (-1, 0)], np.float32)
    return vertices, np.broadcast_to(normals, vertices.shape)


def _dot(a: Float32, b: Float32) -> Float32:
    product: Float32 = a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1]
    return product


def compute_mass(vertices: Float32, density: float) -> tuple[Float32, Float32, Float32]:
    """b2PolygonShape::ComputeMass, operation by operation in float32; density in [kg/m²], (..., 4, 2) vertices in [m].

    Returns (...) mass [kg], (..., 2) centre [m], (...) moment of inertia about the frame's origin [kg·m²].
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


def _rotated(vectors: Float32, cos: Float32, sin: Float32) -> Float32:
    """b2Mul(q, v) of (..., 4, 2) vectors."""
    x, y = vectors[..., 0], vectors[..., 1]
    c, s = cos[..., None], sin[..., None]
    return np.stack([c * x - s * y, s * x + c * y], axis=-1)


def _reset_mass_data(
    rigid: RigidBodies, mass: Float32, center: Float32, inertia: Float32
) -> tuple[Float32, Float32, Float32]:
    """b2Body::ResetMassData: add up the fixtures, of which Box2D lists the last one first.

    Returns (n_designs, n_links) inverse mass, inverse inertia and (n_designs, n_links, 2) centre of mass of the bodies,
    at their first links.
    """
    design = np.arange(len(mass))
    total, moment = np.zeros_like(mass), np.zeros_like(inertia)
    local = np.zeros_like(center)
    for link in reversed(range(mass.shape[1])):
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


def body_index(rigid: RigidBodies) -> Int64:
    """(n_designs, n_links) index of the body that each link belongs to; bodies are ordered by their first links."""
    number = np.cumsum(rigid.is_first, axis=1) - 1
    return np.take_along_axis(number, rigid.first_link, axis=1)


def fixture_pairs(designs: Designs, rigid: RigidBodies, physics: Physics) -> tuple[Int64, Int64, Int64]:
    """Return (n_designs, n_pairs) fixtures A and B that may collide, ordered by their proxies, and how many count.

    Proxies are numbered as the fixtures are created: the ground's, then those of each body's links, from the body with
    the last first link to the root's. A is the fixture with the lower proxy.
    """
    n_designs, n_links = designs.parent.shape
    created = np.argsort((n_links - rigid.first_link) * n_links + np.arange(n_links), axis=1)
    created = np.concatenate([np.full((n_designs, 1), GROUND), created], axis=1)
    first, second = np.triu_indices(n_links + 1, 1)
    a, b = created[:, first], created[:, second]
    may = a == GROUND
    if physics.link_collisions:
        link_a, design = np.minimum(a, n_links - 1), np.arange(n_designs)[:, None]
        apart = rigid.first_link[design, link_a] != rigid.first_link[design, b]
        unjoined = (designs.parent[design, link_a] != b) & (designs.parent[design, b] != link_a)
        may = may | (apart & unjoined)
    order = np.argsort(~may, axis=1, kind="stable")[:, : int(may.sum(axis=1).max(initial=0))]
    return np.take_along_axis(a, order, axis=1), np.take_along_axis(b, order, axis=1), may.sum(axis=1)


def pack(designs: Designs, trees: KinematicTrees, rigid: RigidBodies, depth: float, physics: Physics) -> Records:
    """Return (n_designs,) records of robots, with bodies, fixtures and joints as Box2D creates them."""
    robots = np.zeros(len(designs), ROBOT)
    index = body_index(rigid)
    spin, turn = sines_and_cosines(rigid.angle.ravel())
    vertices, normals = boxes(trees.half_width, trees.half_height)
    cos, sin = turn.reshape(rigid.angle.shape), spin.reshape(rigid.angle.shape)
    centroid = np.stack([rigid.x, rigid.y], axis=-1)
    vertices, normals = _rotated(vertices, cos, sin) + centroid[..., None, :], _rotated(normals, cos, sin)
    inverse_mass, inverse_inertia, center = _reset_mass_data(rigid, *compute_mass(vertices, physics.link_density))

    n_links = designs.room
    _pack_links(robots["links"][:, :n_links], designs, trees, rigid)
    robots["n_bodies"] = rigid.is_first.sum(axis=1)
    design, link = np.nonzero(rigid.is_first)
    for name, quantity in (
        ("p_x", trees.x),
        ("p_y", trees.y),
        ("a", trees.angle),
        ("inv_mass", inverse_mass),
        ("inv_inertia", inverse_inertia),
        ("local_center_x", center[..., 0]),
        ("local_center_y", center[..., 1]),
    ):
        robots["bodies"][name][design, index[design, link]] = quantity[design, link]
    _pack_fixtures(robots["fixtures"][:, :n_links], index, vertices, normals, centroid)
    _pack_ground(robots, depth)
    _pack_joints(robots, designs, trees, rigid, center, physics)

    fixture_a, fixture_b, robots["n_pairs"] = fixture_pairs(designs, rigid, physics)
    contacts = robots["contacts"][:, : fixture_a.shape[1]]
    contacts["fixture_a"], contacts["fixture_b"] = fixture_a, fixture_b
    for name, fixture in (("body_a", fixture_a), ("body_b", fixture_b)):
        contacts[name] = np.take_along_axis(robots["fixtures"]["body"], fixture, axis=1)
    return robots


def _pack_links(links: Records, designs: Designs, trees: KinematicTrees, rigid: RigidBodies) -> None:
    links["length_scale"], links["parent"] = designs.length_scale, designs.parent
    links["mass"], links["inertia"] = trees.mass, trees.inertia
    links["body"] = body_index(rigid)
    for name in ("x", "y", "angle", "cos", "sin", "lever_x", "lever_y"):
        links[f"local_{name}"] = getattr(rigid, name)
    for name in ("mass_share", "inertia_share", "mass_over_inertia"):
        links[name] = getattr(rigid, name)


def _pack_fixtures(
    fixtures: Records, body: npt.ArrayLike, vertices: Float32, normals: Float32, centroid: Float32
) -> None:
    """Pack (..., n, 4, 2) vertices and normals and (..., n, 2) centroids of boxes."""
    edges = np.roll(vertices, -1, axis=-2) - vertices
    tangents = edges * (np.float32(1) / np.sqrt(_dot(edges, edges)))[..., None]  # b2Vec2::Normalize
    fixtures["body"] = body
    for k, axis in enumerate("xy"):
        fixtures[f"local_centroid_{axis}"] = centroid[..., k]
        fixtures[f"local_vertex_{axis}"] = vertices[..., k]
        fixtures[f"local_normal_{axis}"] = normals[..., k]
        fixtures[f"local_tangent_{axis}"] = tangents[..., k]


def _pack_joints(
    robots: Records, designs: Designs, trees: KinematicTrees, rigid: RigidBodies, center: Float32, physics: Physics
) -> None:
    """Pack the joints, ordered by their child links."""
    design, link = np.nonzero(rigid.is_first & (designs.parent >= 0))
    index, parent = body_index(rigid), designs.parent[design, link]
    center_a, center_b = center[design, rigid.first_link[design, parent]], center[design, link]
    max_motor_impulse = np.float32(physics.time_step) * np.float32(physics.max_motor_torque)
    for name, quantity in (
        ("body_a", index[design, parent]),
        ("body_b", index[design, link]),
        ("parent", parent),
        ("child", link),
        ("local_ra_x", rigid.joint_x[design, link] - center_a[:, 0]),
        ("local_ra_y", rigid.joint_y[design, link] - center_a[:, 1]),
        ("local_rb_x", -center_b[:, 0]),
        ("local_rb_y", trees.child_anchor[design, link] - center_b[:, 1]),
        ("max_motor_impulse", designs.motor_on[design, link] * max_motor_impulse),
    ):
        robots["joints"][name][design, index[design, link] - 1] = quantity
    robots["n_joints"] = rigid.is_first.sum(axis=1) - 1


def _pack_ground(robots: Records, depth: float) -> None:
    """Pack one static box: without mass, at an angle of 0."""
    single = np.float32
    body = robots["bodies"][:, GROUND]
    body["p_y"] = body["c_y"] = single(-depth - GROUND_HALF_HEIGHT)
    body["cos"] = 1.0
    half_width, half_height = np.full(1, GROUND_HALF_WIDTH, single), np.full(1, GROUND_HALF_HEIGHT, single)
    vertices, normals = boxes(half_width, half_height)
    _pack_fixtures(robots["fixtures"][:, GROUND:], GROUND, vertices, normals, np.zeros((1, 2), single))
