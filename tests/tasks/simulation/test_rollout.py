"""simulate(): its signature, shapes, refusals, and that no rollout knows of another."""

from dataclasses import replace

import numpy as np
import pytest

from tasks.design import DesignError, Designs, random_designs
from tasks.simulation import OK, Rollouts, simulate
from tasks.world import DryLand, Environment, Physics, RandomisedSlush, RandomisedSlushes, TrueSlush

ENVIRONMENTS = [
    DryLand(0.0),
    TrueSlush(1.0),
    TrueSlush(9.0),
    RandomisedSlush(1.0, RandomisedSlushes(n_members=2, seed=1)),
]
in_every_environment = pytest.mark.parametrize("environment", ENVIRONMENTS, ids=["dry", "1 m", "9 m", "two members"])
by_either_engine = pytest.mark.parametrize("engine", ["batch", "reference"])


@pytest.fixture(scope="module")
def designs() -> Designs:
    return random_designs(6, np.random.default_rng(51))


def short(designs: Designs, environment: Environment, n_settle: int = 40, n_measure: int = 60) -> Rollouts:
    return simulate(designs, environment, n_settle=n_settle, n_measure=n_measure, engine="reference", trace=True)


@in_every_environment
def test_shapes_and_displacements_are_those_of_the_trace(designs: Designs, environment: Environment) -> None:
    # The glossary's order of axes: n_members, n_designs, n_steps, n_links.
    members = (2,) if environment.is_ensemble else ()
    rollouts = short(designs, environment)
    for name in ("displacement", "com_displacement", "status"):
        assert getattr(rollouts, name).shape == (*members, 6), name
    low, high = rollouts.displacement.min(), rollouts.displacement.max()
    assert f"displacement {low:.2f} to {high:.2f} m; 0 diverged" in repr(rollouts) and len(repr(rollouts)) < 200
    assert rollouts.displacement.dtype == rollouts.com_displacement.dtype == np.float64
    assert rollouts.trace.shape == (*members, 6, 100, 6, 6) and rollouts.trace.dtype == np.float32
    assert (rollouts.status == OK).all()
    x = rollouts.trace[..., 0].astype(np.float64)
    moved = x[..., 99, :] - x[..., 39, :]  # after 40 steps of settling, and at the end
    np.testing.assert_array_equal(rollouts.displacement, moved[..., 0])
    np.testing.assert_allclose(rollouts.com_displacement, moved.mean(axis=-1), rtol=0, atol=1e-14)
    without = simulate(designs, environment, n_settle=40, n_measure=60, engine="reference")
    assert without.trace is None
    np.testing.assert_array_equal(rollouts.displacement, without.displacement)
    alone = short(designs[[4]], environment).trace
    np.testing.assert_array_equal(alone, np.take(rollouts.trace, [4], axis=len(members)))


@pytest.mark.parametrize("link_collisions", [False, True])
@by_either_engine
@pytest.mark.parametrize("trace", [False, True])
def test_no_designs_give_no_rollouts(designs, trace, engine, link_collisions):
    physics = Physics(link_collisions=link_collisions)
    for environment, members in ((ENVIRONMENTS[1], ()), (ENVIRONMENTS[3], (2,))):
        rollouts = simulate(designs[:0], environment, n_measure=60, engine=engine, trace=trace, physics=physics)
        assert rollouts.displacement.shape == rollouts.status.shape == (*members, 0)
        assert not trace or rollouts.trace.shape == (*members, 0, 260, 6, 6)


@by_either_engine
def test_mistakes_are_refused_by_name(designs: Designs, engine: str) -> None:
    broken, wild = designs.parent.copy(), designs.frequency.copy()
    broken[1, 3], wild[5] = 4, np.nan
    for bad, options, error, message in (
        (designs, {"n_settle": -1}, ValueError, "n_settle is -1, expected at least 0"),
        (replace(designs, parent=broken), {}, DesignError, "design 1: parent of link 3 is 4"),
        (replace(designs, frequency=wild), {}, DesignError, "design 5: frequency is nan"),
    ):
        with pytest.raises(error, match=message):
            simulate(bad, DryLand(0.0), engine=engine, **options)


@by_either_engine
@pytest.mark.parametrize("n_settle", [0, 4])
@pytest.mark.parametrize("n_measure", [1, 7, 40])
def test_the_second_half_s_speed_is_that_of_the_trace(engine: str, n_settle: int, n_measure: int) -> None:
    """The second half begins after n_measure // 2 measured steps, so that of an odd number it is the longer one."""
    designs, first = random_designs(3, np.random.default_rng(3)), n_settle + n_measure // 2
    ours = simulate(designs, TrueSlush(1.0), n_settle=n_settle, n_measure=n_measure, engine=engine).second_half_speed
    x = simulate(designs, TrueSlush(1.0), n_settle=0, n_measure=n_settle + n_measure, trace=True).trace[:, :, 0, 0]
    if first:
        seconds = (n_measure - n_measure // 2) / 60
        expected = (x[:, -1].astype(np.float64) - x[:, first - 1]) / seconds
        np.testing.assert_allclose(ours, expected, rtol=1e-12, atol=1e-12)
    assert np.isfinite(ours).all()


@pytest.mark.parametrize("passive_joints", ["swing", "locked"])
@in_every_environment
def test_motor_work_is_that_of_torque_and_speed_after_settling(environment: Environment, passive_joints) -> None:
    """In the trace, a torque is rounded once, a work of n steps n times: by 6e-8 each at the most."""
    designs, physics = random_designs(6, np.random.default_rng(52)), Physics(passive_joints=passive_joints)
    duration = {"n_settle": 40, "n_measure": 60, "physics": physics}
    rollouts = simulate(designs, environment, engine="reference", trace=True, motor_work=True, **duration)
    omega = rollouts.trace[..., 5].astype(np.float64)
    parent = np.broadcast_to(np.maximum(designs.parent, 0)[:, None], omega.shape)
    speed = omega - np.take_along_axis(omega, parent, axis=-1)
    torque = rollouts.motor_torque
    power = np.abs(torque.astype(np.float64) * speed)[..., 40:, :]
    np.testing.assert_allclose(rollouts.motor_work, power.sum(axis=(-1, -2)) * physics.time_step, rtol=60 * 6e-8)
    assert (rollouts.motor_work > 0).all()
    batched = simulate(designs, environment, motor_work=True, **duration)
    np.testing.assert_array_equal(batched.motor_work, rollouts.motor_work)
