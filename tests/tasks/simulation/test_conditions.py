"""Conditions of rollouts: starts, shorter steps, depths and continuous collision."""

from itertools import pairwise

import numpy as np
import pytest

from tasks.design import Designs, random_designs, rest_pose
from tasks.residual.ensemble import Ensemble
from tasks.residual.forms import form_named
from tasks.simulation import Conditions, simulate
from tasks.world import ENVIRONMENTS, DryLand, LinkStates, MeanResidual, Physics, Pool, ResidualSlush, TrueSlush
from tasks.world.residual_slush import at_time_step

KICKS = ("kick_vx", "kick_vy", "kick_omega")


def test_every_joint_of_another_start_is_a_millimetre_and_a_milliradian_off():
    one = random_designs(50, np.random.default_rng(3))
    moved = Conditions(start=7).of_designs(one)
    np.testing.assert_allclose(np.abs(moved.rest_angle - one.rest_angle)[:, 1:], 1e-3, atol=1e-12)
    shift = np.abs(moved.child_attachment - one.child_attachment) * one.length_scale / 2
    np.testing.assert_allclose(shift, [[0] + [1e-3] * 5] * len(one), atol=1e-12)
    x, y, _ = rest_pose(moved)
    # A joint moves by 1 mm on either link, and what hangs on it turns by 1 mrad: at most 5 joints, links of up to 3 m.
    assert np.hypot(x - rest_pose(one)[0], y - rest_pose(one)[1]).max() < 5 * (2e-3 + 5e-3 * 3)
    assert (moved.rest_angle != Conditions(start=8).of_designs(one).rest_angle).any()


def test_the_start_of_a_design_does_not_depend_on_the_others():
    designs, start = random_designs(5, np.random.default_rng(4)), Conditions(start=2)
    alone = Designs.concatenate([start.of_designs(designs[k : k + 1]) for k in range(5)])
    np.testing.assert_array_equal(alone.table, start.of_designs(designs).table)
    assert Conditions().of_designs(designs) is designs


@pytest.fixture(scope="module")
def ensemble():
    rng, form = np.random.default_rng(5), form_named("wetted")
    sizes = (len(form.inputs), 8, len(form.outputs))
    weights = tuple(rng.normal(size=(2, *shape)).astype(np.float32) for shape in pairwise(sizes))
    return Ensemble(weights, tuple(rng.normal(size=(2, n)).astype(np.float32) for n in sizes[1:]), form)


def test_networks_change_a_shorter_step_in_proportion(ensemble):
    home = ResidualSlush(depth=3.0, ensemble=ensemble)
    finer = at_time_step(Conditions(depth=1.0).of_environment(home), 1 / 240)
    links = LinkStates(*np.random.default_rng(6).normal(size=(9, 2, 3, 6)).astype(np.float32))
    whole, part = (at.medium.velocity_change(links, Physics()) for at in (home, finer))
    assert finer.depth == 1.0 and np.abs(whole.omega).max() > 0
    for name in ("vx", "vy", "omega"):
        np.testing.assert_allclose(getattr(part, name), getattr(whole, name) / 4, rtol=1e-6)
    assert Conditions().of_environment(home) is home and at_time_step(home, 1 / 60) is home
    mean = MeanResidual(3.0, ensemble)
    alone = LinkStates(*(array[:1] for array in vars(links).values()))
    whole, part = (at.medium.velocity_change(alone, Physics()) for at in (mean, at_time_step(mean, 1 / 240)))
    np.testing.assert_allclose(part.vx, whole.vx / 4, rtol=1e-5)


def test_added_mass_takes_back_the_same_share_of_a_kick_in_shorter_steps():
    rng, form = np.random.default_rng(5), form_named("wetted_mass")
    weight = np.zeros((1, len(form.inputs) + len(form.unseen), len(form.outputs)), np.float32)
    weight[:, : len(form.inputs)] = rng.normal(size=(1, len(form.inputs), len(form.outputs)))
    whole = ResidualSlush(3.0, Ensemble((weight,), (np.full((1, len(form.outputs)), 0.5, np.float32),), form))
    states = rng.uniform(0.2, 0.9, size=(9, 1, 3, 6)).astype(np.float32)
    states[3] = -2.0  # y: under water
    taken = []
    for at in (whole, at_time_step(whole, 1 / 240)):
        kicked, unkicked = (
            at.medium.velocity_change(LinkStates(*states, **dict.fromkeys(KICKS, kick * states[0])), Physics())
            for kick in (0.3, 0.0)
        )
        taken.append([getattr(kicked, name) - getattr(unkicked, name) for name in ("vx", "vy", "omega")])
    assert np.abs(taken[0]).max() > 0.05
    np.testing.assert_allclose(*taken, atol=1e-5)  # a few units of float32 in changes of up to 10


@pytest.mark.parametrize("name", ["true_slush", "flowing_slush"])
def test_a_fitted_law_knows_the_time_step(name):
    fluid, form = ENVIRONMENTS[name].settings(), form_named(f"law:{name}")
    assert form.factors_in_proportion[:3] == (True, True, True) and form.factors_in_proportion[4:] in ((), (False,))
    factors = np.array(fluid.factors(Physics()), np.float32)
    layers = ((1, len(form.unseen), 1), (1, 1, len(factors)))
    law = Ensemble(
        tuple(np.zeros(of, np.float32) for of in layers), (np.zeros((1, 1), np.float32), factors[None]), form
    )
    links = LinkStates(*np.abs(np.random.default_rng(6).normal(size=(9, 1, 3, 6))).astype(np.float32))
    finer, learned = Physics(time_step=1 / 240), ResidualSlush(depth=3.0, ensemble=law)
    found, expected = (of.velocity_change(links, finer) for of in (at_time_step(learned, 1 / 240).medium, fluid))
    for part in ("vx", "vy", "omega"):
        np.testing.assert_allclose(getattr(found, part), getattr(expected, part), rtol=1e-5, atol=1e-9)
    designs, steps = random_designs(4, np.random.default_rng(3)), {"n_settle": 0, "n_measure": 60}
    for engine in ("batch", "reference"):
        there, here = (
            simulate(designs, at, physics=finer, engine=engine, **steps).displacement
            for at in (learned, Pool(3.0, fluid))
        )
        np.testing.assert_allclose(there[0], here, atol=1e-4)  # float32, over a quarter of a second


def test_a_medium_knows_the_time_step_itself():
    assert at_time_step(TrueSlush(depth=3.0), 1 / 240) == TrueSlush(depth=3.0)
    assert Conditions(n_substeps=4).of_physics(Physics()) == Physics(time_step=1 / 240)


def test_continuous_collision_matters_where_robots_touch_the_ground():
    designs, steps = random_designs(4, np.random.default_rng(3)), {"n_settle": 20, "n_measure": 60}
    physics = Conditions(continuous_collision=True).of_physics(Physics())
    for world, touches in ((DryLand(depth=0.0), True), (TrueSlush(depth=9.0), False)):
        moved = simulate(designs, world, engine="reference", physics=physics, **steps).displacement
        usual = simulate(designs, world, **steps).displacement
        assert (moved != usual).any() == touches
        np.testing.assert_array_equal(simulate(designs, world, physics=physics, **steps).displacement, moved)
