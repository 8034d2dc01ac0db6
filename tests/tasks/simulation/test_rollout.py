"""simulate(): its signature, shapes, refusals, and that no rollout knows of another."""

import re
from dataclasses import replace

import numpy as np
import pytest

from tasks.design import DesignError, Designs, concatenate, random_designs
from tasks.simulation import DIVERGED, OK, Rollouts, simulate
from tasks.world import (
    DryLand,
    Environment,
    LinkStates,
    Medium,
    Physics,
    ResidualSlush,
    Slush,
    TrueSlush,
    VelocityChange,
)


def name_of(environment: Environment) -> str:
    return f"{type(environment).__name__}-{environment.depth:g}"


class Replay:
    """An ensemble whose member 0 is the slush itself and whose member 1 is nothing at all."""

    n_members = 2

    def velocity_change(self, links: LinkStates, physics: Physics) -> VelocityChange:
        assert links.y.shape[0] == self.n_members
        change = Slush().velocity_change(links, physics)
        keep = np.float32([1, 0])[:, None, None]
        return VelocityChange(vx=change.vx * keep, vy=change.vy * keep, omega=change.omega * keep)


class Poisoned:
    """The slush, but for links of one length, which get something that is no number when they sink."""

    def __init__(self, length: float, poison: float, what: str) -> None:
        self.length, self.poison, self.what = np.float32(length), np.float32(poison), what

    def velocity_change(self, links: LinkStates, physics: Physics) -> VelocityChange:
        change = vars(Slush().velocity_change(links, physics))
        hit = (links.length_scale == self.length) & (links.y < 0)
        return VelocityChange(**{**change, self.what: np.where(hit, self.poison, change[self.what])})


class OtherSlush(TrueSlush):
    """True slush whose medium is another."""

    def __init__(self, depth: float, medium: Medium) -> None:
        super().__init__(depth)
        object.__setattr__(self, "other", medium)

    @property
    def medium(self) -> Medium:
        return self.other  # type: ignore[attr-defined]


ENVIRONMENTS = [DryLand(0.0), DryLand(1.0), TrueSlush(1.0), TrueSlush(9.0), ResidualSlush(1.0, Replay())]


@pytest.fixture(scope="module")
def designs() -> Designs:
    return random_designs(6, np.random.default_rng(51))


def short(designs: Designs, environment: Environment, n_settle: int = 40, n_measure: int = 60) -> Rollouts:
    return simulate(designs, environment, n_settle=n_settle, n_measure=n_measure, engine="reference", trace=True)


def trace_of(rollouts: Rollouts) -> np.ndarray:
    assert rollouts.trace is not None
    return rollouts.trace


@pytest.mark.parametrize("environment", ENVIRONMENTS, ids=name_of)
def test_shapes(designs: Designs, environment: Environment) -> None:
    # The glossary's order of axes: n_members, n_designs, n_steps, n_links.
    members = (2,) if isinstance(environment, ResidualSlush) else ()
    rollouts = simulate(designs, environment, n_settle=3, n_measure=4, engine="reference", trace=True)
    for name in ("displacement", "com_displacement", "status"):
        assert getattr(rollouts, name).shape == (*members, 6), name
    assert rollouts.displacement.dtype == rollouts.com_displacement.dtype == np.float64
    assert trace_of(rollouts).shape == (*members, 6, 7, 6, 6)
    assert trace_of(rollouts).dtype == np.float32
    assert (rollouts.status == OK).all()


def test_without_a_trace_it_is_the_same(designs: Designs) -> None:
    with_it = short(designs, TrueSlush(1.0))
    without = simulate(designs, TrueSlush(1.0), n_settle=40, n_measure=60, engine="reference")
    assert without.trace is None
    np.testing.assert_array_equal(with_it.displacement, without.displacement)
    np.testing.assert_array_equal(with_it.com_displacement, without.com_displacement)


@pytest.mark.parametrize("environment", ENVIRONMENTS, ids=name_of)
def test_displacement_is_the_traces(designs: Designs, environment: Environment) -> None:
    rollouts = short(designs, environment, 40, 60)
    x = trace_of(rollouts)[..., 0].astype(np.float64)
    moved = x[..., 99, :] - x[..., 39, :]  # after 40 steps of settling, and at the end
    np.testing.assert_array_equal(rollouts.displacement, moved[..., 0])
    np.testing.assert_allclose(rollouts.com_displacement, moved.mean(axis=-1), rtol=0, atol=1e-14)


@pytest.mark.parametrize("environment", ENVIRONMENTS, ids=name_of)
def test_order_and_company_do_not_matter(designs: Designs, environment: Environment) -> None:
    together = trace_of(short(designs, environment))
    axis = together.ndim - 4
    order = [3, 0, 5, 1, 4, 2]
    np.testing.assert_array_equal(trace_of(short(designs[order], environment)), np.take(together, order, axis=axis))
    np.testing.assert_array_equal(trace_of(short(designs[4], environment)), np.take(together, [4], axis=axis))
    crowd = concatenate([random_designs(9, np.random.default_rng(52)), designs])
    np.testing.assert_array_equal(
        trace_of(short(crowd, environment)),
        np.concatenate([trace_of(short(crowd[:9], environment)), together], axis=axis),
    )


@pytest.mark.parametrize("depth", [0.0, 1.0])
def test_each_member_is_simulated_alone(designs: Designs, depth: float) -> None:
    both = trace_of(short(designs, ResidualSlush(depth, Replay())))
    np.testing.assert_array_equal(both[0], trace_of(short(designs, TrueSlush(depth))))
    np.testing.assert_array_equal(both[1], trace_of(short(designs, DryLand(depth))))


@pytest.mark.parametrize("what", ["vx", "vy", "omega"])
@pytest.mark.parametrize("poison", [np.nan, np.inf, -np.inf])
def test_a_rollout_that_diverges_touches_no_other(designs: Designs, what: str, poison: float) -> None:
    ill = 2
    medium = Poisoned(float(np.float32(designs.length_scale[ill, 4])), poison, what)
    rollouts = short(designs, OtherSlush(9.0, medium))
    assert rollouts.status.tolist() == [OK, OK, DIVERGED, OK, OK, OK]
    healthy = short(designs, TrueSlush(9.0))
    trace, expected = trace_of(rollouts), trace_of(healthy)
    for design in range(6):
        if design == ill:
            continue
        np.testing.assert_array_equal(trace[design], expected[design])
        assert rollouts.displacement[design] == healthy.displacement[design]
        assert rollouts.com_displacement[design] == healthy.com_displacement[design]
    assert np.isnan(rollouts.displacement[ill])
    assert np.isnan(rollouts.com_displacement[ill])
    # Up to then it went like its healthy twin; from then on there is nothing, not even a stale state.
    finite = np.isfinite(trace[ill]).all(axis=(1, 2))
    first_bad = int(np.argmin(finite))
    assert 0 < first_bad < 100
    np.testing.assert_array_equal(trace[ill, :first_bad], expected[ill, :first_bad])
    assert np.isnan(trace[ill, first_bad:]).all()
    torque, expected_torque = rollouts.motor_torque, healthy.motor_torque
    np.testing.assert_array_equal(torque[ill, :first_bad], expected_torque[ill, :first_bad])
    assert np.isnan(torque[ill, first_bad:]).all()
    np.testing.assert_array_equal(np.delete(torque, ill, axis=0), np.delete(expected_torque, ill, axis=0))


@pytest.mark.parametrize("link_collisions", [False, True])
@pytest.mark.parametrize("engine", ["batch", "reference"])
@pytest.mark.parametrize("trace", [False, True])
@pytest.mark.parametrize("environment", [TrueSlush(1.0), ResidualSlush(1.0, Replay())], ids=name_of)
def test_no_designs_give_no_rollouts(designs, environment, trace, engine, link_collisions):
    physics = Physics(link_collisions=link_collisions)
    members = (2,) if isinstance(environment, ResidualSlush) else ()
    rollouts = simulate(
        designs[:0], environment, n_settle=40, n_measure=60, engine=engine, trace=trace, physics=physics
    )
    assert rollouts.displacement.shape == rollouts.status.shape == (*members, 0)
    assert not trace or trace_of(rollouts).shape == (*members, 0, 100, 6, 6)


def test_an_unknown_engine_is_refused_by_name(designs: Designs) -> None:
    with pytest.raises(ValueError, match="engine is 'bullet', expected 'batch' or 'reference'"):
        simulate(designs, DryLand(0.0), engine="bullet")  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("steps", "message"),
    [
        ({"n_settle": -1}, "n_settle is -1, expected at least 0"),
        ({"n_measure": 0}, "n_measure is 0, expected at least 1"),
        ({"n_measure": -5}, "n_measure is -5, expected at least 1"),
    ],
)
@pytest.mark.parametrize("engine", ["batch", "reference"])
def test_impossible_numbers_of_steps_are_refused_by_name(
    designs: Designs, steps: dict[str, int], message: str, engine: str
) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        simulate(designs, DryLand(0.0), engine=engine, **steps)  # type: ignore[arg-type]


@pytest.mark.parametrize("engine", ["batch", "reference"])
def test_bad_designs_are_refused_by_index_and_gene(designs: Designs, engine: str) -> None:
    broken = designs.parent.copy()
    broken[1, 3] = 4
    wild = designs.frequency.copy()
    wild[5] = np.nan
    with pytest.raises(DesignError, match="design 1: parent of link 3 is 4"):
        simulate(replace(designs, parent=broken), DryLand(0.0), engine=engine)  # type: ignore[arg-type]
    with pytest.raises(DesignError, match="design 5: frequency is nan"):
        simulate(replace(designs, frequency=wild), DryLand(0.0), engine=engine)  # type: ignore[arg-type]


@pytest.mark.parametrize("engine", ["batch", "reference"])
@pytest.mark.parametrize("n_settle", [0, 4])
@pytest.mark.parametrize("n_measure", [1, 2, 7, 40])
def test_the_second_half_s_speed_is_that_of_the_trace(engine: str, n_settle: int, n_measure: int) -> None:
    """The second half begins after n_measure // 2 measured steps, so that of an odd number it is the longer one."""
    designs, first = random_designs(3, np.random.default_rng(3)), n_settle + n_measure // 2
    for trace in (False, True):
        ours = simulate(
            designs, TrueSlush(1.0), n_settle=n_settle, n_measure=n_measure, engine=engine, trace=trace
        ).second_half_speed
        x = simulate(designs, TrueSlush(1.0), n_settle=0, n_measure=n_settle + n_measure, trace=True).trace[:, :, 0, 0]
        if first:
            seconds = (n_measure - n_measure // 2) / 60
            expected = (x[:, -1].astype(np.float64) - x[:, first - 1]) / seconds
            np.testing.assert_allclose(ours, expected, rtol=1e-12, atol=1e-12)
        assert np.isfinite(ours).all()


@pytest.mark.parametrize("locked", [False, True])
@pytest.mark.parametrize("environment", ENVIRONMENTS, ids=name_of)
def test_motor_work_is_that_of_torque_and_speed_after_settling(environment: Environment, locked: bool) -> None:
    """In the trace, a torque is rounded once, a work of n steps n times: by 6e-8 each at the most."""
    designs = random_designs(6, np.random.default_rng(52))
    physics = Physics(passive_joints="locked") if locked else Physics()
    duration = {"n_settle": 40, "n_measure": 60, "physics": physics}
    rollouts = simulate(designs, environment, engine="reference", trace=True, motor_work=True, **duration)
    assert rollouts.motor_torque is not None and rollouts.motor_work is not None
    omega = trace_of(rollouts)[..., 5].astype(np.float64)
    parent = np.broadcast_to(np.maximum(designs.parent, 0)[:, None], omega.shape)
    speed = omega - np.take_along_axis(omega, parent, axis=-1)
    power = np.abs(rollouts.motor_torque.astype(np.float64) * speed)[..., 40:, :]
    np.testing.assert_allclose(rollouts.motor_work, power.sum(axis=(-1, -2)) * physics.time_step, rtol=60 * 6e-8)
    assert (rollouts.motor_work > 0).all()
    batched = simulate(designs, environment, motor_work=True, **duration)
    np.testing.assert_array_equal(batched.motor_work, rollouts.motor_work)
