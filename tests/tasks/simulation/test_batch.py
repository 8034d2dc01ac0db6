"""The batch engine by itself: nothing but the clock depends on lanes, batches or neighbours. See also tests/parity."""

import numba
import numpy as np
import pytest
from both_engines import Slushes, assert_equal_in_plain_python, networks

from tasks.design import Designs, random_designs
from tasks.simulation import DIVERGED, OK, batch, simulate
from tasks.simulation.box2d import Motion
from tasks.simulation.simd.lanes import widest
from tasks.simulation.trees import step
from tasks.simulation.trees.groups import Groups
from tasks.simulation.trees.layout import OMEGA, VX
from tasks.world import DryLand, Environment, Physics, ResidualSlush, Slush, TrueSlush, VelocityChange

compiled_only = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="too slow in plain Python")
PHYSICS = Physics()
N_DESIGNS = 45  # no multiple of any number of lanes but 1


@pytest.fixture(scope="module")
def designs() -> Designs:
    return random_designs(N_DESIGNS, np.random.default_rng(8))


ENVIRONMENTS = [DryLand(0.0), TrueSlush(1.0), ResidualSlush(1.0, Slushes(0.6, 1.25, 2.0))]


def roll_out(designs: Designs, environment: Environment, n_lanes: int) -> Motion:
    return batch.roll_out(designs, environment, PHYSICS, n_settle=20, n_measure=130, trace=True, n_lanes=n_lanes)


@pytest.fixture(scope="module", params=ENVIRONMENTS, ids=lambda e: type(e).__name__)
def environment(request: pytest.FixtureRequest) -> Environment:
    return request.param


@pytest.fixture(scope="module")
def whole(designs: Designs, environment: Environment) -> np.ndarray:
    trace = roll_out(designs, environment, widest()).trace
    assert trace is not None and np.isfinite(trace).all()
    return trace


def test_as_many_populations_are_batched_as_fill_the_groups_that_are_stepped_together():
    room = step.MAX_GROUPS_AT_ONCE * widest()
    for n_robots in range(1, room + 1):
        n = batch.n_that_fill_lanes(n_robots, PHYSICS)
        assert n * n_robots <= room < (n + 1) * n_robots
    assert batch.n_that_fill_lanes(room + 1, PHYSICS) == 1
    assert batch.n_that_fill_lanes(1, Physics(link_collisions=True)) == 1  # it has no lanes


@compiled_only
@pytest.mark.parametrize("n_lanes", [widest() // 2, 1])  # see test_lanes.py for all operations on all numbers
def test_every_number_of_lanes_gives_the_same_bits(designs, environment, whole, n_lanes):
    np.testing.assert_array_equal(roll_out(designs, environment, n_lanes).trace, whole)


@compiled_only
def test_every_order_of_designs_gives_the_same_bits(designs, environment, whole):
    order = np.random.default_rng().permutation(N_DESIGNS)
    np.testing.assert_array_equal(roll_out(designs[order], environment, widest()).trace, whole[:, order])


@compiled_only
def test_among_networks_neither_order_nor_size_of_the_batch_matters(designs):
    """In one kernel and without a trace, as in a study."""
    rng = np.random.default_rng()
    environment = ResidualSlush(0.7, networks(rng))

    def ends(designs: Designs) -> np.ndarray:
        return batch.roll_out(designs, environment, PHYSICS, n_settle=20, n_measure=80, trace=False).final

    whole = ends(designs)
    assert np.isfinite(whole).all()
    order = rng.permutation(N_DESIGNS)
    np.testing.assert_array_equal(ends(designs[order]), whole[:, order])
    for n_designs in (1, 7, 33):
        np.testing.assert_array_equal(ends(designs[-n_designs:]), whole[:, -n_designs:])


@compiled_only
@pytest.mark.parametrize("poison", [np.nan, np.inf, -np.inf, 3e38])
@pytest.mark.parametrize("row", [VX, OMEGA + 3])
def test_a_robot_that_diverges_leaves_its_neighbours_bits_alone(designs, poison, row):
    scene = batch.scene_of(TrueSlush(0.5), PHYSICS)
    clean, spoiled = (Groups(designs, PHYSICS, n_members=1, n_lanes=widest()) for _ in range(2))
    for groups in (clean, spoiled):
        groups.advance(scene, 0, 60, None)
    victim = 21  # with neighbours on either side, in its part of the group and in the other
    group, lane = divmod(victim, widest())
    spoiled.blocks[group, row, lane] = poison
    for groups in (clean, spoiled):
        groups.advance(scene, 60, 90, None)
    others = np.arange(N_DESIGNS) != victim
    assert np.isfinite(clean.poses()).all()
    assert np.isnan(spoiled.poses()[victim]).all() or np.isfinite(poison)
    np.testing.assert_array_equal(spoiled.poses()[others], clean.poses()[others])


class Poisonous:
    """An ensemble of one: slush that gives links of some lengths a speed that is no number, once they whirl."""

    n_members = 1

    def velocity_change(self, links, physics):
        change = vars(Slush().velocity_change(links, physics))
        hit = (links.length_scale > 2.7) & (abs(links.omega) > 1.5)
        return VelocityChange(**{**change, "omega": np.where(hit, np.float32(np.inf), change["omega"])})


@compiled_only
def test_a_diverged_robot_has_a_status_and_the_same_fate_as_in_the_reference_engine(designs):
    environment = ResidualSlush(0.5, Poisonous())
    ours, theirs = (
        simulate(designs, environment, n_settle=30, n_measure=90, engine=engine, trace=True)
        for engine in ("batch", "reference")
    )
    for name in ("status", "displacement", "com_displacement", "trace"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name))
    assert set(ours.status.flat) == {OK, DIVERGED}
    assert np.isnan(ours.displacement[ours.status == DIVERGED]).all()


def test_the_kernels_are_plain_python_too():
    assert_equal_in_plain_python(4, PHYSICS, (15, 15))
