"""The batch engine by itself: nothing but the clock depends on lanes, batches or neighbours. See also tests/parity."""

import numba
import numpy as np
import pytest
from both_engines import Slushes, assert_equal_in_plain_python, networks

from tasks.design import Designs, random_designs
from tasks.residual.forms.wetted import WETTED
from tasks.simd.lanes import widest
from tasks.simulation import DIVERGED, OK, batch, simulate
from tasks.simulation.trees import step
from tasks.world import DryLand, Environment, Physics, ResidualSlush, TrueSlush

pytestmark = pytest.mark.slow

compiled_only = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="too slow in plain Python")
TREES, BODIES = Physics(), Physics(passive_joints="locked", link_collisions=True)
N_DESIGNS = 45  # no multiple of any number of lanes but 1, nor of a team of rigid bodies
either_engine = pytest.mark.parametrize("physics", [TREES, BODIES], ids=["trees", "rigid bodies"])


@pytest.fixture(scope="module")
def designs() -> Designs:
    return random_designs(N_DESIGNS, np.random.default_rng(8))


class Poisonous(Slushes):
    """Slushes of three densities, the last of which makes fast-spinning links diverge."""

    def __init__(self) -> None:
        super().__init__(0.6, 1.25, 2.0)

    def velocity_change(self, links, physics):
        change = super().velocity_change(links, physics)
        change.omega[2, (links.length_scale[2] > 2.7) & (abs(links.omega[2]) > 1.5)] = np.inf
        return change


ENVIRONMENTS = [
    DryLand(0.0),
    TrueSlush(1.0),
    ResidualSlush(1.0, Poisonous()),
    ResidualSlush(0.7, networks(np.random.default_rng(9))),
    ResidualSlush(0.7, networks(np.random.default_rng(9), WETTED)),
]


def test_as_many_populations_are_batched_as_fill_the_groups_that_are_stepped_together():
    room = step.MAX_GROUPS_AT_ONCE * widest()
    for n_robots in range(1, room + 1):
        n = batch.n_that_fill_lanes(n_robots, TREES)
        assert n * n_robots <= room < (n + 1) * n_robots
    assert batch.n_that_fill_lanes(room + 1, TREES) == 1
    assert batch.n_that_fill_lanes(1, Physics(link_collisions=True)) == 1  # it has no lanes


@compiled_only
@either_engine
@pytest.mark.parametrize("environment", ENVIRONMENTS, ids=["dry", "slush", "slushes", "networks", "wetted"])
def test_every_order_size_and_number_of_lanes_gives_the_same_bits(designs: Designs, environment: Environment, physics):
    """With a trace, and in one kernel without it, as in a study."""

    def ends(designs: Designs, trace: bool = False, n_lanes: int | None = None) -> np.ndarray:
        motion = batch.roll_out(
            designs, environment, physics, n_settle=20, n_measure=130, trace=trace, n_lanes=n_lanes or widest()
        )
        return motion.trace[:, :, -1] if trace else motion.final

    whole = ends(designs)
    assert np.isfinite(whole).mean() > 0.5
    order = np.random.default_rng().permutation(N_DESIGNS)
    for trace in (False, True):
        np.testing.assert_array_equal(ends(designs[order], trace), whole[:, order])
    for n_designs in (1, 3, 7, 33):
        np.testing.assert_array_equal(ends(designs[-n_designs:]), whole[:, -n_designs:])
    if physics is TREES and not hasattr(environment.medium, "networks"):  # whose kernel takes long to compile anew
        np.testing.assert_array_equal(ends(designs, n_lanes=widest() // 2), whole)


@compiled_only
@pytest.mark.parametrize("collisions", [False, True])
def test_a_diverged_robot_has_a_status_and_the_same_fate_as_in_the_reference_engine(designs, collisions):
    ours, theirs = (
        simulate(
            designs,
            ResidualSlush(0.5, Poisonous()),
            n_settle=30,
            n_measure=90,
            engine=engine,
            trace=True,
            physics=Physics(link_collisions=collisions),
        )
        for engine in ("batch", "reference")
    )
    for name in ("status", "displacement", "com_displacement", "trace"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name))
    assert set(ours.status[2]) == {OK, DIVERGED} and (ours.status[:2] == OK).all()
    diverged = ours.status == DIVERGED
    assert np.isnan(ours.displacement[diverged]).all() and np.isnan(ours.com_displacement[diverged]).all()
    # Until it diverges a robot has all its states, and from then on none, nor a torque.
    for of_links in (ours.trace[diverged], theirs.motor_torque[diverged]):
        missing = np.isnan(of_links.reshape(*of_links.shape[:2], -1))
        assert (missing.any(axis=2) == missing.all(axis=2)).all() and missing[:, -1].all() and not missing[:, 0].any()
        assert (np.diff(missing[..., 0], axis=1) >= 0).all()


@pytest.mark.parametrize(("n_designs", "physics", "n_steps"), [(2, TREES, (12, 12)), (1, BODIES, (5, 3))])
def test_the_kernels_are_plain_python_too(n_designs, physics, n_steps):
    assert_equal_in_plain_python(n_designs, physics, n_steps)
