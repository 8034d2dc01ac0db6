"""The rigid-body engine: results do not depend on batches, teams or neighbours. See also tests/parity."""

import numba
import numpy as np
import pytest
from both_engines import Slushes, assert_equal_in_plain_python

from tasks.design import Designs, random_designs, rigid_bodies
from tasks.simulation import DIVERGED, OK, batch, simulate
from tasks.simulation.rigid_bodies import engine, layout, packing, step
from tasks.world import DryLand, Environment, Physics, ResidualSlush, TrueSlush

compiled_only = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="too slow in plain Python")
PHYSICS = Physics(passive_joints="locked", link_collisions=True)
N_DESIGNS = 4 * step.TEAM + 3


@pytest.fixture(scope="module")
def designs() -> Designs:
    return random_designs(N_DESIGNS, np.random.default_rng(8))


class Members(Slushes):
    """Slushes of three densities, the last of which makes fast-spinning links diverge."""

    def __init__(self) -> None:
        super().__init__(0.6, 1.25, 2.0)

    def velocity_change(self, links, physics):
        change = super().velocity_change(links, physics)
        change.omega[2, (links.length_scale[2] > 2.7) & (abs(links.omega[2]) > 1.5)] = np.inf
        return change


@pytest.fixture(params=[DryLand(0.0), TrueSlush(1.0), ResidualSlush(1.0, Members())], ids=lambda e: type(e).__name__)
def environment(request: pytest.FixtureRequest) -> Environment:
    return request.param


def roll_out(designs: Designs, environment: Environment, *, trace: bool = True):
    return batch.roll_out(designs, environment, PHYSICS, n_settle=20, n_measure=130, trace=trace)


@compiled_only
def test_every_order_and_size_of_a_batch_gives_the_same_bits(designs, environment):
    whole = roll_out(designs, environment).trace
    order = np.random.default_rng().permutation(N_DESIGNS)
    np.testing.assert_array_equal(roll_out(designs[order], environment).trace, whole[:, order])
    for n in (1, step.TEAM - 1, step.TEAM + 1):
        np.testing.assert_array_equal(roll_out(designs[-n:], environment).trace, whole[:, -n:])


@compiled_only
@pytest.mark.parametrize("poison", [np.nan, np.inf, 3e38])
@pytest.mark.parametrize("quantity", ["v_x", "w", "a"])
def test_a_robot_that_diverges_leaves_its_neighbours_bits_alone(designs, poison, quantity):
    world = batch.scene_of(TrueSlush(0.5), PHYSICS)
    clean, spoiled = (engine.Robots(designs, 0.5, PHYSICS, n_members=1) for _ in range(2))
    for each in (clean, spoiled):
        each.advance(world, 0, 60, None)
    victim = step.TEAM + 1
    spoiled.records["bodies"][quantity][victim, 0] = poison
    for each in (clean, spoiled):
        each.advance(world, 60, 90, None)
    others = np.arange(N_DESIGNS) != victim
    assert np.isfinite(clean.poses()).all()
    assert np.isnan(spoiled.poses()[victim]).all() or np.isfinite(poison)
    np.testing.assert_array_equal(spoiled.poses()[others], clean.poses()[others])


@compiled_only
def test_a_diverged_robot_has_a_status_and_the_same_fate_as_in_the_reference_engine(designs):
    ours, theirs = (
        simulate(
            designs,
            ResidualSlush(0.5, Members()),
            n_settle=30,
            n_measure=90,
            engine=engine,
            trace=True,
            physics=Physics(link_collisions=True),
        )
        for engine in ("batch", "reference")
    )
    for name in ("status", "displacement", "com_displacement", "trace"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name))
    assert set(ours.status.flat) == {OK, DIVERGED}


def test_pairs_come_in_the_order_in_which_fixtures_are_made():
    designs = random_designs(1, np.random.default_rng(1))
    star = Designs(
        **{
            **dict(designs.arrays()),
            "parent": np.array([[-1, 0, 0, 1, 1, 3]]),
            "motor_on": np.array([[False, False, True, True, False, False]]),
        }
    )
    # Bodies {0, 1, 4}, {2}, {3, 5} are created from the last to the first: links 3, 5; 2; 0, 1, 4.
    rigid = rigid_bodies(star, passive_joints="locked")
    assert rigid.first_link.tolist() == [[0, 0, 2, 3, 0, 3]]
    a, b, n = packing.fixture_pairs(star, rigid, PHYSICS)
    pairs = list(zip(a[0].tolist(), b[0].tolist(), strict=True))[: n[0]]
    ground = [(layout.GROUND, link) for link in (3, 5, 2, 0, 1, 4)]
    # Without (3, 1) and (2, 0), which joints tie, and without links of one body.
    assert pairs == [*ground, (3, 2), (3, 0), (3, 4), (5, 2), (5, 0), (5, 1), (5, 4), (2, 1), (2, 4)]
    a, b, n = packing.fixture_pairs(star, rigid, Physics(passive_joints="locked"))
    assert list(zip(a[0].tolist(), b[0].tolist(), strict=True))[: n[0]] == ground


def test_the_kernels_are_plain_python_too():
    assert_equal_in_plain_python(2, PHYSICS, (5, 3))
