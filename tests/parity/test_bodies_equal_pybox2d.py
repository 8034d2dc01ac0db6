"""The rigid-body engine against pybox2d: every float of every step, with ==."""

from dataclasses import replace

import Box2D
import numba
import numpy as np
import pytest
from both_engines import OTHER_CONSTANTS, STRONG_MOTORS, Slushes, assert_equal, golden_digest, networks, wild

from tasks.design import Morphology, random_designs
from tasks.simulation import batch
from tasks.simulation.box2d import Column
from tasks.simulation.rigid_bodies import broad_phase, layout, polygons
from tasks.simulation.simd.rotation import NEAR
from tasks.simulation.trees import packing
from tasks.world import DryLand, Environment, Physics, ResidualSlush, TrueSlush

VARIANTS = {
    "locked, colliding": {"passive_joints": "locked", "link_collisions": True},
    "locked": {"passive_joints": "locked"},
    "colliding": {"link_collisions": True},
}
AS_BUILT = Physics(**VARIANTS["locked, colliding"], max_motor_torque=30.0)
BUILDABLE = Morphology(n_actuated=2, unjoined_links="apart")

pytestmark = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="slow in Python; test_engine.py has a short one")


@pytest.fixture(params=VARIANTS.values(), ids=VARIANTS)
def variant(request) -> dict:
    return request.param


@pytest.mark.parametrize("kind", [DryLand, TrueSlush])
@pytest.mark.parametrize("depth", [0.0, 0.3, 2.0, 9.0])
def test_every_float_of_every_step(kind, depth: float, variant, same_libm: None, seed: int) -> None:
    # Links of most random designs overlap at the spawn and push each other apart.
    designs = random_designs(9, np.random.default_rng(seed))
    motion = assert_equal(designs, kind(depth), Physics(**variant), n_settle=20, n_measure=280)
    assert np.isfinite(motion.final).all()


@pytest.mark.parametrize("environment", [DryLand(0.0), TrueSlush(0.3), TrueSlush(2.0)], ids=str)
def test_robots_that_can_be_built(environment: Environment, same_libm: None, seed: int) -> None:
    designs = random_designs(9, np.random.default_rng(seed), morphology=BUILDABLE)
    motion = assert_equal(designs, environment, AS_BUILT, n_settle=20, n_measure=1380)
    ghosts = AS_BUILT.model_copy(update={"link_collisions": False})
    through_one_another = batch.roll_out(designs, environment, ghosts, n_settle=20, n_measure=1380, trace=False)
    assert (motion.final != through_one_another.final).any()  # links did collide


@pytest.mark.parametrize("kind", [DryLand, TrueSlush])
@pytest.mark.parametrize("depth", [0.0, 2.0])
def test_motors_far_beyond_the_paper_s_range(kind, depth: float, variant, same_libm: None, seed: int) -> None:
    rng = np.random.default_rng(seed)
    designs = wild(random_designs(9, rng), rng, motor_on=0.8)
    motion = assert_equal(designs, kind(depth), Physics(**variant, **STRONG_MOTORS), n_settle=20, n_measure=480)
    assert abs(motion.final[..., Column.ANGLE]).max() > NEAR  # so the reduction of large angles is tested too


@pytest.mark.parametrize("environment", [DryLand(0.3), TrueSlush(0.3), TrueSlush(9.0)], ids=str)
def test_physics_of_all_other_constants(environment, variant, same_libm: None, seed: int) -> None:
    designs, physics = random_designs(9, np.random.default_rng(seed)), Physics(**variant, **OTHER_CONSTANTS)
    assert_equal(designs, environment, physics, n_settle=20, n_measure=380)


def test_every_tree(same_libm: None, seed: int) -> None:
    designs = random_designs(len(packing.TREES), np.random.default_rng(seed))
    designs = replace(designs, parent=np.array(packing.TREES))
    assert_equal(designs, TrueSlush(0.5), Physics(link_collisions=True), n_settle=20, n_measure=40)
    assert_equal(designs, DryLand(0.0), AS_BUILT, n_settle=20, n_measure=40)


def test_residual_slush(variant, same_libm: None, seed: int) -> None:
    designs = random_designs(13, np.random.default_rng(seed))
    environment = ResidualSlush(0.5, Slushes(1.25, 0.6, precision=np.float64))
    motion = assert_equal(designs, environment, Physics(**variant), n_settle=20, n_measure=280)
    assert motion.trace is not None and motion.trace.shape == (2, 13, 300, 6, 6)


@pytest.mark.parametrize("trace", [True, False])
def test_residual_slush_of_networks(trace: bool, variant, same_libm: None, seed: int) -> None:
    rng = np.random.default_rng(seed)
    designs, environment = random_designs(9, rng), ResidualSlush(0.7, networks(rng))
    assert_equal(designs, environment, Physics(**variant), n_settle=30, n_measure=170, trace=trace)


def place_box(robot: np.record, index: int, shape: Box2D.b2PolygonShape, xf: Box2D.b2Transform) -> None:
    """Write a box and its body to the records of a robot, as the kernels have them."""
    body, box = robot.bodies[index], robot.fixtures[index]
    (body.p_x, body.p_y), body.cos, body.sin = xf.position, xf.q.c, xf.q.s
    box.local_centroid_x, box.local_centroid_y = shape.centroid
    corners, normals = np.float32(shape.vertices), np.float32(shape.normals)
    edges = np.roll(corners, -1, axis=0) - corners
    tangents = edges * (np.float32(1) / np.sqrt(edges[:, 0] * edges[:, 0] + edges[:, 1] * edges[:, 1]))[:, None]
    for name, vectors in (("vertex", corners), ("normal", normals), ("tangent", tangents)):
        box[f"local_{name}_x"], box[f"local_{name}_y"] = vectors.T
    broad_phase.orient(body, box)


def assert_same_manifold(a: Box2D.b2PolygonShape, xf_a, b: Box2D.b2PolygonShape, xf_b, *, on_ground: bool) -> int:
    """Check that our manifold is that of b2CollidePolygons, to the bit; return its number of points."""
    theirs = Box2D.b2Manifold()
    Box2D.b2CollidePolygons(theirs, a, xf_a, b, xf_b)
    robot = np.zeros(1, layout.ROBOT)[0]
    contact, index = robot.contacts[0], layout.GROUND if on_ground else 1
    contact.fixture_a = contact.body_a = index
    place_box(robot, index, a, xf_a)
    place_box(robot, 0, b, xf_b)
    polygons.collide_polygons(robot, contact)
    assert contact.point_count == theirs.pointCount
    if theirs.pointCount:
        assert contact.flipped == (theirs.type_ == Box2D.b2Manifold.e_faceB)
        assert (contact.local_normal_x, contact.local_normal_y) == tuple(theirs.localNormal)
        assert (contact.local_point_x, contact.local_point_y) == tuple(theirs.localPoint)
    for theirs_point, point in zip(theirs.points[: theirs.pointCount], contact.points, strict=False):
        assert (point.local_x, point.local_y) == tuple(theirs_point.localPoint)
        feature = theirs_point.id.cf
        number = feature.indexA + polygons.INDEX_B * feature.indexB
        number += polygons.FACE_OF_A * feature.typeA + polygons.FACE_OF_B * feature.typeB
        assert point.id == number
    return int(theirs.pointCount)


def transform(x: float, y: float, angle: float) -> Box2D.b2Transform:
    xf = Box2D.b2Transform()
    xf.Set((float(x), float(y)), float(angle))
    return xf


def test_manifolds_are_those_of_b2_collide_polygons(seed: int) -> None:
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(1500):
        shapes = [
            Box2D.b2PolygonShape(
                box=(
                    *map(float, rng.uniform(0.2, 1.5, 2)),
                    tuple(map(float, rng.normal(size=2))),
                    float(rng.choice([0, np.pi / 2, rng.uniform(-4, 4)])),
                )
            )
            for _ in range(2)
        ]
        # The centres of the boxes are near each other, wherever the bodies are.
        places = [transform(*rng.normal(size=2), rng.choice([0, np.pi, rng.uniform(-9, 9)])) for _ in range(2)]
        apart = places[0] * shapes[0].centroid - places[1] * shapes[1].centroid
        places[1].position = places[1].position + apart + Box2D.b2Vec2(*rng.normal(size=2))
        found.append(assert_same_manifold(shapes[0], places[0], shapes[1], places[1], on_ground=False))
    assert np.bincount(found, minlength=3).min() > 30


@pytest.mark.parametrize(
    ("environment", "digest"),
    [(DryLand(0.0), "7c93bc2fa22a46ee"), (TrueSlush(1.0), "1e9bcaa9723a8311"), (TrueSlush(9.0), "e31ac06a40e7f445")],
    ids=["dry", "shallow", "deep"],
)
def test_traces_are_those_of_every_other_platform_and_compiler(environment: Environment, digest: str) -> None:
    assert golden_digest(environment, AS_BUILT, motor_on=0.5) == digest
