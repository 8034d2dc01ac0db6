"""The batch engine against pybox2d: every float of every step, with ==, on designs drawn anew each time."""

import hashlib
from itertools import pairwise

import numba
import numpy as np
import pytest

from tasks.design import Designs, random_designs
from tasks.residual.ensemble import Ensemble
from tasks.simulation import batch, free_links, reference, rotation
from tasks.simulation.motion import ANGLE, Motion
from tasks.world import DryLand, Environment, Physics, ResidualSlush, Slush, TrueSlush

DEPTHS = (0.0, 0.3, 1.0, 2.5, 9.0)

pytestmark = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="too slow in Python; test_batch.py has a short one")


def test_sines_and_cosines_are_the_platform_s(same_libm: None, seed: int, sines) -> None:
    for ours, theirs in sines(seed):
        np.testing.assert_array_equal(ours, theirs)


def wild(designs: Designs, rng: np.random.Generator) -> Designs:
    """Give designs motors far beyond the paper's range: faster, farther, all on, and from links wound up many turns."""
    n = len(designs)
    return Designs(
        **{
            **dict(designs.arrays()),
            "frequency": rng.uniform(0, 10, n),
            "motion_range": rng.uniform(0, 40, (n, 6)),
            "rest_angle": rng.uniform(-300, 300, (n, 6)),
            "motor_on": np.ones((n, 6), bool),
        }
    )


WILD = Physics(max_motor_torque=1e4, motor_gain=60.0)
OTHERWISE = Physics(
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


def both(
    designs: Designs, environment: Environment, physics: Physics, *, n_settle: int, n_measure: int
) -> tuple[Motion, Motion]:
    steps = {"n_settle": n_settle, "n_measure": n_measure, "trace": True}
    return (
        batch.roll_out(designs, environment, physics, **steps),
        reference.roll_out(designs, environment, physics, **steps),
    )


def assert_equal(ours: Motion, theirs: Motion) -> None:
    assert ours.trace is not None and theirs.trace is not None
    np.testing.assert_array_equal(ours.trace, theirs.trace)
    np.testing.assert_array_equal(ours.settled, theirs.settled)
    np.testing.assert_array_equal(ours.final, theirs.final)


@pytest.mark.parametrize("kind", [DryLand, TrueSlush])
@pytest.mark.parametrize("depth", DEPTHS)
def test_every_float_of_every_step(kind: type[DryLand | TrueSlush], depth: float, same_libm: None, seed: int) -> None:
    designs = random_designs(37, np.random.default_rng(seed))
    ours, theirs = both(designs, kind(depth), Physics(), n_settle=200, n_measure=1200)
    assert np.isfinite(ours.final).all()
    assert_equal(ours, theirs)


@pytest.mark.parametrize("kind", [DryLand, TrueSlush])
@pytest.mark.parametrize("depth", DEPTHS)
def test_motors_far_beyond_the_paper_s_range(
    kind: type[DryLand | TrueSlush], depth: float, same_libm: None, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    designs = wild(random_designs(33, rng), rng)
    ours, theirs = both(designs, kind(depth), WILD, n_settle=100, n_measure=1300)
    assert abs(theirs.final[..., ANGLE]).max() > rotation.NEAR  # so that the other reduction of angles is met
    assert_equal(ours, theirs)


@pytest.mark.parametrize("kind", [DryLand, TrueSlush])
@pytest.mark.parametrize("depth", DEPTHS)
def test_physics_of_all_other_constants(
    kind: type[DryLand | TrueSlush], depth: float, same_libm: None, seed: int
) -> None:
    designs = random_designs(33, np.random.default_rng(seed))
    assert_equal(*both(designs, kind(depth), OTHERWISE, n_settle=100, n_measure=700))


def test_every_tree(same_libm: None, seed: int) -> None:
    rng = np.random.default_rng(seed)
    designs = random_designs(len(batch.TREES), rng)
    designs = Designs(**{**dict(designs.arrays()), "parent": np.array(batch.TREES)})
    assert_equal(*both(designs, TrueSlush(0.5), Physics(), n_settle=10, n_measure=150))


class TwoSlushes:
    """An ensemble of exact members: the slush and one half as dense."""

    n_members = 2

    def velocity_change(self, links, physics):
        each = []
        for k, slush in enumerate((Slush(), Slush(density=0.6))):
            member = type(links)(**{name: array[k] for name, array in vars(links).items()})
            each.append(slush.velocity_change(member, physics))
        return type(each[0])(**{name: np.stack([vars(c)[name] for c in each]) for name in vars(each[0])})


@pytest.mark.parametrize("depth", [0.3, 2.5])
def test_residual_slush(depth: float, same_libm: None, seed: int) -> None:
    designs = random_designs(21, np.random.default_rng(seed))
    environment = ResidualSlush(depth, TwoSlushes())
    ours, theirs = both(designs, environment, Physics(), n_settle=50, n_measure=350)
    assert ours.trace.shape == (2, 21, 400, 6, 6)
    assert_equal(ours, theirs)
    # Its first member is the slush that the kernel has built in.
    built_in = batch.roll_out(designs, TrueSlush(depth), Physics(), n_settle=50, n_measure=350, trace=True)
    np.testing.assert_array_equal(built_in.trace[0], ours.trace[0])


def ensemble(rng: np.random.Generator) -> Ensemble:
    """Three untrained networks whose changes are of the size of the slush's."""
    sizes = (6, 40, 40, 3)
    weights = [(rng.normal(size=(3, a, b)) / np.sqrt(a)).astype(np.float32) for a, b in pairwise(sizes)]
    weights[-1] *= np.float32(0.05)
    biases = [(0.01 * rng.normal(size=(3, b))).astype(np.float32) for b in sizes[1:]]
    return Ensemble(weights=tuple(weights), biases=tuple(biases))


@pytest.mark.parametrize("trace", [True, False])
def test_residual_slush_of_networks(trace: bool, same_libm: None, seed: int) -> None:
    rng = np.random.default_rng(seed)
    designs, environment = random_designs(13, rng), ResidualSlush(0.7, ensemble(rng))
    ours, theirs = (
        engine.roll_out(designs, environment, Physics(), n_settle=30, n_measure=270, trace=trace)
        for engine in (batch, reference)
    )
    assert (ours.trace is not None) == trace
    if ours.trace is not None and theirs.trace is not None:
        np.testing.assert_array_equal(ours.trace, theirs.trace)
    np.testing.assert_array_equal(ours.settled, theirs.settled)
    np.testing.assert_array_equal(ours.final, theirs.final)


@pytest.mark.parametrize("speed", [20.0, 200.0])
@pytest.mark.parametrize("medium", [None, Slush()], ids=["dry", "slush"])
def test_throws(speed: float, medium: Slush | None, same_libm: None, seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = 203
    length_scale = rng.choice([1.0, 2.0, 3.0, 1.7], n)
    state = rng.uniform(-1, 1, (n, 6)) * (0.2, 6, np.pi, speed, speed, speed)
    state = theirs = state.astype(np.float32)
    our_links = free_links.FreeLinks(length_scale, Physics())
    their_links = reference.FreeLinks(length_scale, Physics())
    for _ in range(200):
        state, theirs = our_links.step(state, medium), their_links.step(theirs, medium)
        np.testing.assert_array_equal(state, theirs)


def golden_designs() -> Designs:
    """Eight designs from uniform numbers alone, so that no other function of ours changes them."""
    u = np.random.default_rng(20251121).random((8, 6, 8))
    child = np.arange(6) > 0
    return Designs(
        length_scale=1 + 2 * u[..., 0],
        parent=np.where(child, np.floor(u[..., 1] * np.arange(6)), -1).astype(int),
        parent_attachment=child * (2 * u[..., 2] - 1),
        child_attachment=child * (2 * u[..., 3] - 1),
        rest_angle=child * np.pi * (2 * u[..., 4] - 1),
        phase=child * 2 * np.pi * u[..., 5],
        motion_range=child * (0.2 + 1.3 * u[..., 6]),
        motor_on=child & (u[..., 7] < 0.7),
        frequency=0.3 * u[:, 0, 1],
    )


@pytest.mark.parametrize(
    ("environment", "digest"),
    [
        (DryLand(0.0), "c138169907dfda72"),
        (TrueSlush(1.0), "d94970aaba544355"),
        (TrueSlush(9.0), "24271ddac0c048bf"),
    ],
    ids=["dry", "shallow", "deep"],
)
def test_traces_are_those_of_every_other_platform_and_compiler(environment: Environment, digest: str) -> None:
    trace = batch.roll_out(golden_designs(), environment, Physics(), n_settle=200, n_measure=1200, trace=True).trace
    assert trace is not None
    assert hashlib.sha256(np.ascontiguousarray(trace + 0.0, dtype="<f4").tobytes()).hexdigest()[:16] == digest
