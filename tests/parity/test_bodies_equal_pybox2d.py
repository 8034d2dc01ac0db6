"""Robots of rigid bodies that collide, in the batch engine, against pybox2d: every float of every step, with ==."""

import hashlib
from dataclasses import replace
from itertools import pairwise

import Box2D
import numba
import numpy as np
import pytest

from tasks.design import Designs, Morphology, kinematic_trees, random_designs, rigid_bodies
from tasks.residual.ensemble import Ensemble
from tasks.simulation import batch, reference
from tasks.simulation.bodies import broad_phase, polygons, robots, rows
from tasks.simulation.drive import Drive
from tasks.simulation.lanes import Block
from tasks.simulation.motion import GROUND_HALF_HEIGHT, GROUND_HALF_WIDTH, Motion
from tasks.simulation.rotation import NEAR
from tasks.world import DryLand, Environment, Physics, ResidualSlush, Slush, TrueSlush, VelocityChange

VARIANTS = {
    "locked, colliding": {"passive_joints": "locked", "link_collisions": True},
    "locked": {"passive_joints": "locked"},
    "colliding": {"link_collisions": True},
}
AS_BUILT = Physics(**VARIANTS["locked, colliding"], max_motor_torque=30.0)
BUILDABLE = Morphology(n_actuated=2, unjoined_links="apart")

pytestmark = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="too slow in Python; test_robots.py has a short one")


@pytest.fixture(params=VARIANTS.values(), ids=VARIANTS)
def variant(request) -> dict:
    return request.param


def assert_equal(designs: Designs, environment: Environment, physics: Physics, n_steps: int) -> Motion:
    """Both engines agree; give their motion."""
    steps = {"n_settle": 20, "n_measure": n_steps - 20, "trace": True}
    ours = batch.roll_out(designs, environment, physics, **steps)
    theirs = reference.roll_out(designs, environment, physics, **steps)
    np.testing.assert_array_equal(ours.trace, theirs.trace)
    np.testing.assert_array_equal(ours.settled, theirs.settled)
    np.testing.assert_array_equal(ours.final, theirs.final)
    return ours


@pytest.mark.parametrize("kind", [DryLand, TrueSlush])
@pytest.mark.parametrize("depth", [0.0, 0.3, 2.0, 9.0])
def test_every_float_of_every_step(kind, depth: float, variant, same_libm: None, seed: int) -> None:
    # Links of most random designs overlap at the spawn, and push each other apart for good.
    designs = random_designs(25, np.random.default_rng(seed))
    motion = assert_equal(designs, kind(depth), Physics(**variant), 300)
    assert np.isfinite(motion.final).all()


@pytest.mark.parametrize("environment", [DryLand(0.0), TrueSlush(0.3), TrueSlush(2.0)], ids=str)
def test_robots_that_can_be_built(environment: Environment, same_libm: None, seed: int) -> None:
    designs = random_designs(16, np.random.default_rng(seed), morphology=BUILDABLE)
    motion = assert_equal(designs, environment, AS_BUILT, 1400)
    through_one_another = batch.roll_out(
        designs, environment, replace_physics(AS_BUILT, link_collisions=False), n_settle=20, n_measure=1380, trace=False
    )
    assert (motion.final != through_one_another.final).any()  # links did collide


def replace_physics(physics: Physics, **changes) -> Physics:
    return Physics(**{**physics.model_dump(), **changes})


@pytest.mark.parametrize("environment", [DryLand(0.0), TrueSlush(2.0)], ids=str)
def test_the_length_of_a_study_of_the_robot_that_was_built(environment, same_libm: None, seed: int) -> None:
    designs = random_designs(4, np.random.default_rng(seed), morphology=BUILDABLE)
    assert_equal(designs, environment, AS_BUILT, 6000)


def wild(designs: Designs, rng: np.random.Generator) -> Designs:
    """Motors far beyond the paper's range: faster, farther, all on but a few, from links wound up many turns."""
    n = len(designs)
    return replace(
        designs,
        frequency=rng.uniform(0, 10, n),
        motion_range=rng.uniform(0, 40, (n, 6)),
        rest_angle=rng.uniform(-300, 300, (n, 6)),
        motor_on=rng.random((n, 6)) < 0.8,
    )


@pytest.mark.parametrize("kind", [DryLand, TrueSlush])
@pytest.mark.parametrize("depth", [0.0, 2.0])
def test_motors_far_beyond_the_paper_s_range(kind, depth: float, variant, same_libm: None, seed: int) -> None:
    rng = np.random.default_rng(seed)
    designs = wild(random_designs(16, rng), rng)
    physics = Physics(**variant, max_motor_torque=1e4, motor_gain=60.0)
    motion = assert_equal(designs, kind(depth), physics, 500)
    assert abs(motion.final[..., 2]).max() > NEAR  # so that the other reduction of angles is met


@pytest.mark.parametrize("environment", [DryLand(0.3), TrueSlush(0.3), TrueSlush(9.0)], ids=str)
def test_physics_of_all_other_constants(environment, variant, same_libm: None, seed: int) -> None:
    physics = Physics(
        **variant,
        gravity=3.7,
        time_step=0.0123,
        velocity_iterations=3,
        position_iterations=11,
        link_density=2.7,
        friction=0.31,
        restitution=0.45,
        motor_gain=3.0,
        max_motor_torque=31.0,
    )
    assert_equal(random_designs(20, np.random.default_rng(seed)), environment, physics, 400)


@pytest.mark.parametrize("n_actuated", range(6))
def test_every_number_of_motors(n_actuated: int, same_libm: None, seed: int) -> None:
    designs = random_designs(12, np.random.default_rng(seed), morphology=Morphology(n_actuated=n_actuated))
    assert (designs.motor_on[:, 1:].sum(axis=1) == n_actuated).all()
    assert_equal(designs, TrueSlush(0.5), AS_BUILT, 200)


def test_every_tree(same_libm: None, seed: int) -> None:
    designs = random_designs(len(batch.TREES), np.random.default_rng(seed))
    designs = replace(designs, parent=np.array(batch.TREES))
    assert_equal(designs, TrueSlush(0.5), Physics(link_collisions=True), 60)
    assert_equal(designs, DryLand(0.0), AS_BUILT, 60)


class TwoSlushes:
    """An ensemble of exact members, which computes in double precision: the slush and one half as dense."""

    n_members = 2

    def velocity_change(self, links, physics):
        each = []
        for k, slush in enumerate((Slush(), Slush(density=0.6))):
            member = type(links)(**{name: array[k].astype(float) for name, array in vars(links).items()})
            each.append(vars(slush.velocity_change(member, physics)))
        return VelocityChange(**{name: np.stack([change[name] for change in each]) for name in each[0]})


def test_residual_slush(variant, same_libm: None, seed: int) -> None:
    designs = random_designs(13, np.random.default_rng(seed))
    motion = assert_equal(designs, ResidualSlush(0.5, TwoSlushes()), Physics(**variant), 300)
    assert motion.trace is not None and motion.trace.shape == (2, 13, 300, 6, 6)


@pytest.mark.parametrize("trace", [True, False])
def test_residual_slush_of_networks(trace: bool, variant, same_libm: None, seed: int) -> None:
    rng = np.random.default_rng(seed)
    sizes = (6, 40, 40, 3)
    weights = [(rng.normal(size=(3, a, b)) / np.sqrt(a)).astype(np.float32) for a, b in pairwise(sizes)]
    weights[-1] *= np.float32(0.05)  # changes of the size of the slush's
    biases = [(0.01 * rng.normal(size=(3, b))).astype(np.float32) for b in sizes[1:]]
    environment = ResidualSlush(0.7, Ensemble(weights=tuple(weights), biases=tuple(biases)))
    designs = random_designs(9, rng)
    ours, theirs = (
        engine.roll_out(designs, environment, Physics(**variant), n_settle=30, n_measure=170, trace=trace)
        for engine in (batch, reference)
    )
    np.testing.assert_array_equal(ours.settled, theirs.settled)
    np.testing.assert_array_equal(ours.final, theirs.final)
    if trace:
        np.testing.assert_array_equal(ours.trace, theirs.trace)


def record(shape: Box2D.b2PolygonShape, xf: Box2D.b2Transform) -> tuple[Block, Block]:
    """A box and where it is, as the kernels have them."""
    body, box = Block(rows.N_BODY, 1), Block(rows.N_FIXTURE, 1)
    body.rows[[rows.P_X, rows.P_Y, rows.Q_C, rows.Q_S], 0] = *xf.position, xf.q.c, xf.q.s
    box.rows[[rows.CENTROID_X, rows.CENTROID_Y], 0] = shape.centroid
    corners = np.float32(shape.vertices)
    edges = np.roll(corners, -1, axis=0) - corners
    tangents = edges * (np.float32(1) / np.sqrt(edges[:, 0] * edges[:, 0] + edges[:, 1] * edges[:, 1]))[:, None]
    for row, vectors in ((rows.VERTEX_X, corners), (rows.NORMAL_X, np.float32(shape.normals)),
                         (rows.TANGENT_X, tangents)):  # fmt: skip
        box.rows[row : row + 8, 0] = vectors.T.ravel()
    broad_phase.orient(body, box)
    return body, box


def assert_same_manifold(a: Box2D.b2PolygonShape, xf_a, b: Box2D.b2PolygonShape, xf_b, *, on_ground: bool) -> int:
    """Ours is b2CollidePolygons' manifold, to the bit; give its number of points."""
    theirs = Box2D.b2Manifold()
    Box2D.b2CollidePolygons(theirs, a, xf_a, b, xf_b)
    contact = Block(rows.N_CONTACT, 1)
    polygons.collide_polygons(contact, *record(a, xf_a), *record(b, xf_b), on_ground)
    ours, whole = contact.rows[:, 0], contact.rows.view(np.int32)[:, 0]
    assert whole[rows.POINT_COUNT] == theirs.pointCount
    if theirs.pointCount:
        assert whole[rows.FACE_B] == (theirs.type_ == Box2D.b2Manifold.e_faceB)
        assert tuple(ours[[rows.LOCAL_NORMAL_X, rows.LOCAL_NORMAL_Y]]) == tuple(theirs.localNormal)
        assert tuple(ours[[rows.LOCAL_POINT_X, rows.LOCAL_POINT_Y]]) == tuple(theirs.localPoint)
    for point, at in zip(theirs.points[: theirs.pointCount], (rows.POINTS, rows.POINTS + rows.N_POINT), strict=False):
        assert tuple(ours[[at + rows.POINT_X, at + rows.POINT_Y]]) == tuple(point.localPoint)
        feature = point.id.cf
        number = feature.indexA + polygons.INDEX_B * feature.indexB
        number += polygons.FACE_OF_A * feature.typeA + polygons.FACE_OF_B * feature.typeB
        assert whole[at + rows.ID] == number
    return int(theirs.pointCount)


def transform(x: float, y: float, angle: float) -> Box2D.b2Transform:
    xf = Box2D.b2Transform()
    xf.Set((float(x), float(y)), float(angle))
    return xf


def test_manifolds_are_those_of_b2_collide_polygons(seed: int) -> None:
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(3000):
        shapes = [
            Box2D.b2PolygonShape(box=(*map(float, rng.uniform(0.2, 1.5, 2)), tuple(map(float, rng.normal(size=2))),
                                      float(rng.choice([0, np.pi / 2, rng.uniform(-4, 4)]))))
            for _ in range(2)
        ]  # fmt: skip
        # Wherever the boxes' bodies are, the centres of the boxes are near each other.
        places = [transform(*rng.normal(size=2), rng.choice([0, np.pi, rng.uniform(-9, 9)])) for _ in range(2)]
        apart = places[0] * shapes[0].centroid - places[1] * shapes[1].centroid
        places[1].position = places[1].position + apart + Box2D.b2Vec2(*rng.normal(size=2))
        found.append(assert_same_manifold(shapes[0], places[0], shapes[1], places[1], on_ground=False))
    assert np.bincount(found, minlength=3).min() > 30


def test_the_ground_s_top_is_always_the_face_that_touches(seed: int) -> None:
    rng = np.random.default_rng(seed)
    ground = Box2D.b2PolygonShape(box=(GROUND_HALF_WIDTH, GROUND_HALF_HEIGHT))
    found = []
    for _ in range(3000):
        half_height = float(rng.uniform(0.5, 1.5))
        link = Box2D.b2PolygonShape(box=(0.25 / half_height, half_height))
        depth, x = float(rng.choice([0, 0.3, 9])), float(rng.uniform(-1, 1) * 10 ** rng.uniform(-1, 3.5))
        angle = float(rng.choice([0, np.pi / 2, rng.normal() * 1e-4, rng.uniform(-9, 9)]))
        rise = half_height * abs(np.cos(angle)) + 0.25 / half_height * abs(np.sin(angle))
        sunk = float(rng.choice([0.01, 0.1, 1])) * float(rng.normal())
        at = transform(x, -depth + rise - sunk, angle)
        below = transform(0.0, -depth - GROUND_HALF_HEIGHT, 0.0)
        found.append(assert_same_manifold(ground, below, link, at, on_ground=True))
    assert np.bincount(found, minlength=3).min() > 30


def test_masses_are_those_of_b2_body(seed: int) -> None:
    physics = Physics(passive_joints="locked", link_density=1.7)
    designs = random_designs(40, np.random.default_rng(seed))
    trees, rigid = kinematic_trees(designs, density=1.7), rigid_bodies(designs, passive_joints="locked")
    packed = robots.Robots(designs, 0.0, physics, n_members=1).blocks[..., 0]
    for design in range(len(designs)):
        bodies = reference._Robot(trees, rigid, design, Drive.of(designs), 0.0, physics).bodies
        for number, body in enumerate(bodies):
            ours = packed[design, rows.BODIES + number * rows.N_BODY :][: rows.N_BODY]
            assert tuple(ours[[rows.CENTER_X, rows.CENTER_Y]]) == tuple(body.localCenter)
            assert ours[rows.INVERSE_MASS] == np.float32(1) / np.float32(body.mass)


@pytest.mark.parametrize(
    ("environment", "digest"),
    [(DryLand(0.0), "7c93bc2fa22a46ee"), (TrueSlush(1.0), "1e9bcaa9723a8311"), (TrueSlush(9.0), "e31ac06a40e7f445")],
    ids=["dry", "shallow", "deep"],
)
def test_traces_are_those_of_every_other_platform_and_compiler(environment: Environment, digest: str) -> None:
    # Designs from uniform numbers alone, so that no other function of ours changes them.
    u = np.random.default_rng(20251121).random((8, 6, 8))
    child = np.arange(6) > 0
    designs = Designs(
        length_scale=1 + 2 * u[..., 0],
        parent=np.where(child, np.floor(u[..., 1] * np.arange(6)), -1).astype(int),
        parent_attachment=child * (2 * u[..., 2] - 1),
        child_attachment=child * (2 * u[..., 3] - 1),
        rest_angle=child * np.pi * (2 * u[..., 4] - 1),
        phase=child * 2 * np.pi * u[..., 5],
        motion_range=child * (0.2 + 1.3 * u[..., 6]),
        motor_on=child & (u[..., 7] < 0.5),
        frequency=0.3 * u[:, 0, 1],
    )
    trace = batch.roll_out(designs, environment, AS_BUILT, n_settle=200, n_measure=1200, trace=True).trace
    assert trace is not None
    assert hashlib.sha256(np.ascontiguousarray(trace + 0.0, dtype="<f4").tobytes()).hexdigest()[:16] == digest
