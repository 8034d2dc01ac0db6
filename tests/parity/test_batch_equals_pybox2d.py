"""The batch engine against pybox2d: every float of every step, with ==, on designs drawn anew each time."""

from dataclasses import replace

import numba
import numpy as np
import pytest
from both_engines import OTHER_CONSTANTS, STRONG_MOTORS, Slushes, assert_equal, golden_digest, networks, wild
from links_in_box2d import ReferenceFreeLinks

from tasks.design import random_designs
from tasks.residual.observation import OBSERVATION
from tasks.residual.wetted import WETTED
from tasks.simulation import batch, free_links
from tasks.simulation.box2d import Column
from tasks.simulation.simd import rotation
from tasks.simulation.simd.lanes import widest
from tasks.simulation.trees import packing
from tasks.world import DryLand, Environment, Medium, Physics, ResidualSlush, Slush, TrueSlush
from tasks.world.anisotropic_slush import AnisotropicPool, AnisotropicSlush
from tasks.world.flowing_slush import FlowingPool, FlowingSlush

DEPTHS = (0.0, 0.3, 1.0, 2.5, 9.0)
FEWER_DEPTHS = (0.0, 1.0, 9.0)

N_DESIGNS = 9
"""Designs at each depth, drawn anew in each run. pybox2d takes half a second for them."""

pytestmark = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="slow in Python; test_batch.py has a short one")


def test_sines_and_cosines_are_the_platform_s(same_libm: None, seed: int, sines) -> None:
    for ours, theirs in sines(seed):
        np.testing.assert_array_equal(ours, theirs)


@pytest.mark.parametrize("kind", [DryLand, TrueSlush])
@pytest.mark.parametrize("depth", DEPTHS)
def test_every_float_of_every_step(kind: type[DryLand | TrueSlush], depth: float, same_libm: None, seed: int) -> None:
    designs = random_designs(N_DESIGNS, np.random.default_rng(seed))
    motion = assert_equal(designs, kind(depth), Physics(), n_settle=200, n_measure=1200)
    assert np.isfinite(motion.final).all()


@pytest.mark.parametrize("environment", [DryLand(0.0), TrueSlush(1.0)], ids=["dry", "slush"])
def test_ends_of_groups_that_are_stepped_together(environment: Environment, same_libm: None, seed: int) -> None:
    """Without a trace, as in a study, two groups are stepped together; the last has unused lanes."""
    designs = random_designs(2 * widest() + 5, np.random.default_rng(seed))
    assert_equal(designs, environment, Physics(), n_settle=200, n_measure=1200, trace=False)


@pytest.mark.parametrize("kind", [DryLand, TrueSlush])
@pytest.mark.parametrize("depth", FEWER_DEPTHS)
def test_motors_far_beyond_the_paper_s_range(
    kind: type[DryLand | TrueSlush], depth: float, same_libm: None, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    designs = wild(random_designs(N_DESIGNS, rng), rng, motor_on=1.0)
    motion = assert_equal(designs, kind(depth), Physics(**STRONG_MOTORS), n_settle=100, n_measure=700)
    assert abs(motion.final[..., Column.ANGLE]).max() > rotation.NEAR  # so that the other reduction of angles is met


@pytest.mark.parametrize("kind", [DryLand, TrueSlush])
@pytest.mark.parametrize("depth", FEWER_DEPTHS)
def test_physics_of_all_other_constants(
    kind: type[DryLand | TrueSlush], depth: float, same_libm: None, seed: int
) -> None:
    designs = random_designs(N_DESIGNS, np.random.default_rng(seed))
    assert_equal(designs, kind(depth), Physics(**OTHER_CONSTANTS), n_settle=100, n_measure=700)


def test_every_tree(same_libm: None, seed: int) -> None:
    rng = np.random.default_rng(seed)
    designs = random_designs(len(packing.TREES), rng)
    designs = replace(designs, parent=np.array(packing.TREES))
    assert_equal(designs, TrueSlush(0.5), Physics(), n_settle=10, n_measure=150)


@pytest.mark.parametrize(
    "environment", [AnisotropicPool(0.3), AnisotropicPool(2.5), FlowingPool(0.3), FlowingPool(2.5)]
)
def test_other_fluids(environment: Environment, same_libm: None, seed: int) -> None:
    designs = random_designs(11, np.random.default_rng(seed))
    motion = assert_equal(designs, environment, Physics(), n_settle=50, n_measure=350)
    assert np.isfinite(motion.final).all()


@pytest.mark.parametrize("depth", [0.3, 2.5])
def test_residual_slush(depth: float, same_libm: None, seed: int) -> None:
    designs = random_designs(11, np.random.default_rng(seed))
    environment = ResidualSlush(depth, Slushes(1.25, 0.6))
    motion = assert_equal(designs, environment, Physics(), n_settle=50, n_measure=350)
    assert motion.trace.shape == (2, 11, 400, 6, 6)
    # Its first member is the slush that the kernel has built in.
    built_in = batch.roll_out(designs, TrueSlush(depth), Physics(), n_settle=50, n_measure=350, trace=True)
    np.testing.assert_array_equal(built_in.trace[0], motion.trace[0])


@pytest.mark.parametrize("trace", [True, False])
@pytest.mark.parametrize(("inputs", "depth"), [(OBSERVATION, 0.7), (WETTED, 0.7), (WETTED, 0.0), (WETTED, 4.0)])
def test_residual_slush_of_networks(
    inputs: tuple[str, ...], depth: float, trace: bool, same_libm: None, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    designs, environment = random_designs(13, rng), ResidualSlush(depth, networks(rng, inputs))
    assert_equal(designs, environment, Physics(), n_settle=30, n_measure=270, trace=trace)


@pytest.mark.parametrize("speed", [20.0, 200.0])
@pytest.mark.parametrize(
    "medium", [None, Slush(), AnisotropicSlush(), FlowingSlush()], ids=["dry", "slush", "anisotropic", "flowing"]
)
def test_throws(speed: float, medium: Medium | None, same_libm: None, seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = 203
    length_scale = rng.choice([1.0, 2.0, 3.0, 1.7], n)
    state = rng.uniform(-1, 1, (n, 6)) * (0.2, 6, np.pi, speed, speed, speed)
    state = theirs = state.astype(np.float32)
    our_links = free_links.FreeLinks(length_scale, Physics())
    their_links = ReferenceFreeLinks(length_scale, Physics())
    for _ in range(200):
        state, theirs = our_links.step(state, medium), their_links.step(theirs, medium)
        np.testing.assert_array_equal(state, theirs)


@pytest.mark.parametrize(
    ("environment", "digest"),
    [(DryLand(0.0), "c138169907dfda72"), (TrueSlush(1.0), "d94970aaba544355"), (TrueSlush(9.0), "24271ddac0c048bf")],
    ids=["dry", "shallow", "deep"],
)
def test_traces_are_those_of_every_other_platform_and_compiler(environment: Environment, digest: str) -> None:
    assert golden_digest(environment, Physics(), motor_on=0.7) == digest
