"""The rigid-body engine against pybox2d: every float of every step, with ==."""

from dataclasses import replace

import numba
import numpy as np
import pytest
from both_engines import OTHER_CONSTANTS, STRONG_MOTORS, Slushes, assert_equal, golden_digest, networks, wild

from tasks.design import Morphology, random_designs
from tasks.residual.observation import OBSERVATION
from tasks.residual.wetted import WETTED
from tasks.simulation import batch
from tasks.simulation.box2d import Column
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

pytestmark = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="slow in Python; test_batch.py has a short one")


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
@pytest.mark.parametrize(("inputs", "depth"), [(OBSERVATION, 0.7), (WETTED, 0.7), (WETTED, 0.0), (WETTED, 4.0)])
def test_residual_slush_of_networks(
    inputs: tuple[str, ...], depth: float, trace: bool, variant, same_libm: None, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    designs, environment = random_designs(9, rng), ResidualSlush(depth, networks(rng, inputs))
    assert_equal(designs, environment, Physics(**variant), n_settle=30, n_measure=170, trace=trace)


@pytest.mark.parametrize(
    ("environment", "digest"),
    [(DryLand(0.0), "7c93bc2fa22a46ee"), (TrueSlush(1.0), "1e9bcaa9723a8311"), (TrueSlush(9.0), "e31ac06a40e7f445")],
    ids=["dry", "shallow", "deep"],
)
def test_traces_are_those_of_every_other_platform_and_compiler(environment: Environment, digest: str) -> None:
    assert golden_digest(environment, AS_BUILT, motor_on=0.5) == digest
