from dataclasses import replace

import numpy as np
import pyarrow as pa
import pytest
from pydantic import ValidationError

from tasks.residual import STATE, Throws, Transitions, form_named, initial_states, robot_ranges, simulate_throws
from tasks.residual.forms import kicks_unseen
from tasks.residual.throws import throw
from tasks.world import LinkStates, Physics, Slush
from tasks.world.medium import MediumError
from tasks.world.slush import slush_change, submerged_part

PHYSICS = Physics()
SLUSH = Slush()


@pytest.fixture(scope="module")
def starts():
    return initial_states(Throws(n_throws=24), np.random.default_rng(7))


@pytest.fixture(scope="module")
def transitions(starts):
    return simulate_throws(starts, 30, SLUSH, PHYSICS)


def test_starts_fill_their_ranges():
    throws = Throws(n_throws=20_000, length_scales=(1.0, 2.5))
    starts = initial_states(throws, np.random.default_rng(0))
    low = [-0.2, -6, 0, -20, -20, -20]
    high = [0.2, 6, 2 * np.pi, 20, 20, 20]
    width = np.subtract(high, low)
    # 20,000 draws come within 1e-3 of each end of a range but for a chance of exp(-20).
    assert (starts.state >= np.array(low, np.float32)).all() and (starts.state <= np.array(high, np.float32)).all()
    assert (starts.state.min(axis=0) < low + 1e-3 * width).all()
    assert (starts.state.max(axis=0) > high - 1e-3 * width).all()
    # A share of 1/2 of 20,000 has a deviation of 0.0035.
    assert set(starts.length_scale) == {1.0, 2.5}
    assert np.mean(starts.length_scale == 1.0) == pytest.approx(0.5, abs=5 * 0.0035)


def test_residual_is_the_slush_s_velocity_change_and_its_time_integral(transitions):
    a, x = transitions.length_scale, transitions.state.astype(float)
    _, y, angle, vx, vy, omega = x.T
    inertia = (a**2 + a**-2.0) / 12  # of mass 1
    links = LinkStates(a, np.ones_like(a), inertia, y, np.cos(angle), np.sin(angle), vx, vy, omega)
    change = SLUSH.velocity_change(links, PHYSICS)
    expected = np.stack((change.vx, change.vy, change.omega), axis=1)
    # In float32 a velocity below 64 is rounded by 2^-19 at most, a few times a step; the change itself, of up to 28,
    # comes from a chain of some twenty roundings of 2^-24 each.
    tolerance = 4 * 2**-19 + 20 * 2**-24 * 28
    assert np.abs(transitions.residual[:, 3:] - expected).max() < tolerance
    # Positions below 64 m (angles below 64 rad) are rounded likewise, and follow the velocities by dt.
    positions = transitions.residual[:, :3]
    assert np.abs(positions - PHYSICS.time_step * transitions.residual[:, 3:]).max() < 4 * 2**-19
    assert np.abs(x[:, :3]).max() < 64


def test_transitions_are_made_of_a_table_of_states(transitions):
    """Those of the same throws, but for the last step of each, whose end the table lacks."""
    columns = {name: transitions.state[:, number] for number, name in enumerate(STATE)}
    table = pa.table({"throw": transitions.throw, "length_scale": transitions.length_scale, **columns})
    expected = transitions[transitions.step < 29]
    for states in (table, table.to_pandas(), columns | transitions.columns()):
        made = Transitions.of_states(states)
        for name in Transitions.__dataclass_fields__:
            np.testing.assert_array_equal(getattr(made, name), getattr(expected, name), err_msg=name)
    with pytest.raises(ValueError, match=r"expected a table with columns throw, length_scale, x.* no 'length_scale'"):
        Transitions.of_states({"throw": transitions.throw, **columns})
    assert len(repr(transitions)) < 250


def test_a_throw_does_not_depend_on_its_chunk(starts, transitions):
    chunks = [starts[:1], starts[1:6], starts[6:]]
    joined = Transitions.concatenate([simulate_throws(chunk, 30, SLUSH, PHYSICS) for chunk in chunks])
    for name in Transitions.__dataclass_fields__:
        assert (getattr(joined, name) == getattr(transitions, name)).all(), name
        assert getattr(joined, name).dtype == getattr(transitions, name).dtype


@pytest.mark.parametrize(
    "wrong", [{"n_throws": 1}, {"length_scales": ()}, {"max_velocity": float("nan")}, {"throw_speed": "uniform"}]
)
def test_wrong_settings_are_refused(wrong):
    with pytest.raises(ValidationError, match=next(iter(wrong))):
        Throws(**wrong)


class Heavy(Slush):
    """A slush that takes back a share of what joints and strikes did to the part of a link that is in it."""

    reads_kicks = True
    share: float = 0.6

    def factors(self, physics):
        return (*super().factors(physics), self.share)

    @staticmethod
    def law(factors, links):
        area, _ = submerged_part(links.length_scale, links.y, links.cos, links.sin)
        x, y, angle = slush_change(factors, links, links.vx)
        back = factors[4] * area
        return x - back * links.kick_vx, y - back * links.kick_vy, angle - back * links.kick_omega


def test_a_struck_bar_is_answered_by_a_fluid_that_reads_kicks():
    throws = Throws(n_throws=40, n_steps=60, design="struck")
    starts = initial_states(throws, np.random.default_rng(3), PHYSICS)
    heavy, light = (simulate_throws(starts, 60, Heavy(share=share), PHYSICS) for share in (0.6, 0.0))
    struck = heavy.kick.any(axis=1)
    assert struck.mean() == pytest.approx(0.2, abs=4 * (0.16 / 2400) ** 0.5) and not heavy.kick[heavy.step == 0].any()
    ranges = robot_ranges(PHYSICS)
    assert np.abs(heavy.kick).max(axis=0) == pytest.approx([ranges.max_kick] * 2 + [ranges.max_kick_omega], rel=0.04)
    links = heavy.links(PHYSICS)
    area, _ = submerged_part(links.length_scale, links.y, links.cos, links.sin)
    change = Slush().velocity_change(links, PHYSICS)
    without = np.stack((change.vx, change.vy, change.omega), axis=1)
    # As above, and a kick is measured to four roundings of velocities below 64.
    assert np.abs(heavy.residual[:, 3:] - without + 0.6 * area[:, None] * heavy.kick).max() < 10 * 2**-19
    plain, of_mass = form_named("plain"), form_named("wetted_mass")
    assert "takes back" in kicks_unseen(plain, heavy) and not kicks_unseen(of_mass, heavy) + kicks_unseen(plain, light)


def test_drag_alone_answers_no_strikes():
    """Of these strikes it takes back 7 %, more than chance."""
    assert not kicks_unseen(form_named("plain"), throw("true_slush", Throws(n_throws=50, n_steps=200, design="struck")))


def test_a_medium_that_gives_no_finite_change_is_an_error(starts):
    class Hot(Slush):
        def velocity_change(self, links, physics):
            change = super().velocity_change(links, physics)
            return replace(change, vx=np.where(links.y < -6.01, np.inf, change.vx))

    with pytest.raises(MediumError, match=r"^Hot: expected finite states, got \[.*nan.*\] \(x, y, .*\) after step"):
        simulate_throws(starts, 30, Hot(), PHYSICS)
