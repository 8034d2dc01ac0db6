"""Robots of rigid bodies in the batch engine: packed into blocks, stepped one after the other by a compiled kernel."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from tasks.design import genes
from tasks.design.body import KinematicTrees, RigidBodies, kinematic_trees, rigid_bodies
from tasks.design.genes import N_LINKS, Designs
from tasks.simulation import contact, drive, joint, kernels, lanes, learned, networks, rotation, rows, simd
from tasks.simulation.bodies import broad_phase, contact_solver, island, polygons, records, revolute_joint, step
from tasks.simulation.bodies import rows as body_rows
from tasks.simulation.compiled import compiled
from tasks.simulation.drive import Drive
from tasks.simulation.free_links import sines_and_cosines
from tasks.simulation.kernels import World
from tasks.simulation.lanes import Block
from tasks.simulation.motion import GROUND_HALF_HEIGHT, GROUND_HALF_WIDTH
from tasks.simulation.networks import PackedNetworks
from tasks.simulation.rigid import PlacedLinks, body_change
from tasks.world import LinkStates, Medium, Physics
from tasks.world import slush as slush_source

Float32 = npt.NDArray[np.float32]
Indices = npt.NDArray[np.int64]

_SOURCES = [
    genes, slush_source, drive, lanes, simd, rows, rotation, joint, contact, kernels,
    body_rows, records, polygons, broad_phase, contact_solver, revolute_joint, island, step,
]  # fmt: skip
_advance = compiled(step.advance_bodies, _SOURCES, seconds=30)
_advance_in_learned_medium = compiled(
    learned.advancing(
        _advance.inner,
        networks.run_networks.inner,
        (body_rows.CHANGE_VX, body_rows.CHANGE_VY, body_rows.CHANGE_OMEGA),
    ),
    [*_SOURCES, networks, learned],
    seconds=30,
)

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
    mass = rho * area
    center = center * (one / area)[..., None]
    from_origin = center + s
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
        mass: (n_designs, n_links) of the fixtures; center and inertia likewise.

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
        inverse_mass = one / total
        local = local * inverse_mass[..., None]
        inverse_inertia = one / (moment - total * _dot(local, local))
    return inverse_mass, inverse_inertia, local


class Robots:
    """Robots in blocks of one lane: robot number member · n_designs + design."""

    def __init__(self, designs: Designs, depth: float, physics: Physics, *, n_members: int) -> None:
        """Spawn n_members robots of each of n_designs designs over ground at a depth [m]."""
        self.n_robots = n_members * len(designs)
        self._n_members = n_members
        self._physics = physics
        self._block = Block(self.n_robots * body_rows.N_ROWS, 1)
        self._no_trace = Block(1, 1)
        self.blocks = self._block.rows.reshape(self.n_robots, body_rows.N_ROWS, 1)
        self._designs = designs
        trees = kinematic_trees(designs, density=physics.link_density)
        self._rigid = rigid_bodies(designs, passive_joints=physics.passive_joints)
        records = pack(designs, trees, self._rigid, depth, physics)
        self.blocks[..., 0] = np.tile(records, (n_members, 1))

    def _columns(self, *first_rows: int) -> Float32:
        """Read (n_robots, n_links, n_columns) quantities of the links."""
        return np.stack([self.blocks[:, row : row + N_LINKS, 0] for row in first_rows], axis=-1)

    def poses(self) -> Float32:
        """Read (n_robots, n_links, 6) states; NaN where diverged."""
        state = self._columns(rows.X, rows.Y, rows.ANGLE, rows.VX, rows.VY, rows.OMEGA)
        state[np.isnan(self.blocks[:, rows.DIVERGENCE, 0])] = np.nan
        return state

    def advance(self, world: World, first_step: int, n_steps: int, kept: Float32 | None) -> None:
        """Take steps, and keep the states after each in (n_robots, at least n_steps, n_links, 6) if that is given."""
        each = self.n_robots if kept is None else step.TEAM
        for first in range(0, self.n_robots, each):
            n_robots = min(each, self.n_robots - first)
            trace = self._no_trace if kept is None else Block(n_robots * n_steps * rows.N_TRACED, 1)
            block = lanes.from_row(self._block, first * body_rows.N_ROWS)
            with np.errstate(all="ignore"):  # without the compiler the lanes are NumPy's, and it would warn
                _advance(block, n_robots, world, first_step, n_steps, trace, kept is not None)
            if kept is not None:
                states = trace.rows.reshape(n_robots, n_steps, 6, N_LINKS)
                kept[first : first + n_robots] = states.transpose(0, 1, 3, 2)

    def advance_among(self, learned_medium: PackedNetworks, world: World, first_step: int, n_steps: int) -> None:
        """Take steps in a medium that is one network for each member: all of it in one kernel, and without a trace."""
        n_designs = self.n_robots // learned_medium.n_members
        x, out = learned_medium.room(n_designs * N_LINKS)
        observed = np.array([rows.QUANTITIES[name] for name in learned_medium.inputs], np.int64)
        with np.errstate(all="ignore"):
            _advance_in_learned_medium(
                self._block, self.blocks, world, first_step, n_steps, np.arange(self.n_robots), n_designs, observed,
                learned_medium.layers, learned_medium.sizes, x, out, learned_medium.between, self._no_trace,
            )  # fmt: skip

    def push(self, medium: Medium) -> None:
        """Let a medium act on every link, and the links on their bodies, as the reference engine does."""
        shape = (self._n_members, len(self._designs), N_LINKS)
        columns = self._columns(*rows.QUANTITIES.values()).reshape(*shape, -1)
        links = LinkStates(**dict(zip(rows.QUANTITIES, np.moveaxis(columns, -1, 0), strict=True)))
        change = medium.velocity_change(links, self._physics)
        state = self.poses().reshape(*shape, 6)
        levers = self._columns(body_rows.WORLD_LEVER_X, body_rows.WORLD_LEVER_Y).reshape(*shape, 2)
        placed = PlacedLinks(state=state, cos=links.cos, sin=links.sin, lever_x=levers[..., 0], lever_y=levers[..., 1])
        of_body = body_change(self._rigid, placed, change)
        numbers = self.blocks[..., 0].reshape(self._n_members, len(self._designs), -1)
        design, link = np.nonzero(self._rigid.is_first)
        body = _body_number(self._rigid)[design, link]
        for row, added in ((body_rows.V_X, of_body.vx), (body_rows.V_Y, of_body.vy), (body_rows.W, of_body.omega)):
            where = (slice(None), design, body_rows.BODIES + body * body_rows.N_BODY + row)
            with np.errstate(invalid="ignore"):  # of robots that have diverged
                numbers[where] = (numbers[where] + added[:, design, link]).astype(np.float32)


def _body_number(rigid: RigidBodies) -> Indices:
    """(n_designs, n_links) number of the body that each link belongs to: in the order of their first links."""
    number = np.cumsum(rigid.is_first, axis=1) - 1
    return np.take_along_axis(number, rigid.first_link, axis=1)


def _pairs(designs: Designs, rigid: RigidBodies, physics: Physics) -> tuple[Indices, Indices, Indices]:
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
    _pack_fixtures(records, range(N_LINKS), _body_number(rigid), vertices, normals, centroid)

    design, link = np.nonzero(rigid.is_first)
    base = body_rows.BODIES + _body_number(rigid)[design, link] * body_rows.N_BODY
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

    fixture_a, fixture_b, n_pairs = _pairs(designs, rigid, physics)
    base = body_rows.CONTACTS + np.arange(body_rows.MAX_CONTACTS) * body_rows.N_CONTACT
    body = np.concatenate([_body_number(rigid), np.full((len(designs), 1), GROUND)], axis=1)
    whole = records.view(np.int32)
    whole[:, body_rows.N_PAIRS] = n_pairs
    for row, quantity in (
        (body_rows.FIXTURE_A, fixture_a),
        (body_rows.FIXTURE_B, fixture_b),
        (body_rows.CONTACT_BODY_A, np.take_along_axis(body, fixture_a, axis=1)),
        (body_rows.CONTACT_BODY_B, np.take_along_axis(body, fixture_b, axis=1)),
    ):
        whole[:, base + row] = quantity
    return records


def _pack_links(records: Float32, designs: Designs, trees: KinematicTrees, rigid: RigidBodies) -> None:
    drive = Drive.of(designs)
    length = designs.length_scale.astype(np.float32)
    for row, quantity in (
        (rows.HALF_HEIGHT, trees.half_height),
        (rows.LENGTH, length),
        (rows.WIDTH, 1 / length),
        (rows.MASS, trees.mass),
        (rows.INERTIA, trees.inertia),
        (rows.PARENT, trees.parent[:, 1:]),
        (rows.PHASE, drive.phase_turns[:, 1:]),
        (rows.MOTION_RANGE, drive.motion_range[:, 1:]),
        (rows.REST_ANGLE, drive.rest_angle[:, 1:]),
        (rows.FREQUENCY, drive.frequency),
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
    number = _body_number(rigid)
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


def _pack_ground(records: Float32, depth: float) -> None:
    """Pack one static box: without mass, at an angle of 0."""
    single = np.float32
    body = body_rows.BODIES + GROUND * body_rows.N_BODY
    y = single(-depth - GROUND_HALF_HEIGHT)
    records[:, [body + body_rows.P_Y, body + body_rows.C_Y]] = y
    records[:, body + body_rows.Q_C] = 1.0
    half_width, half_height = np.full(1, GROUND_HALF_WIDTH, single), np.full(1, GROUND_HALF_HEIGHT, single)
    _pack_fixtures(records, [GROUND], GROUND, *boxes(half_width, half_height), np.zeros((1, 2), single))
