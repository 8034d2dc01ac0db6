"""Walls, the floor and memory, planted and absent."""

from dataclasses import replace

import numpy as np
import pytest

from tasks.residual import MeasuredTransitions, Throws, initial_states, simulate_throws
from tasks.tracks.effects import check_falls, contacts, memory, n_contacts
from tasks.tracks.table import Paths, TrackError
from tasks.world import Physics, Slush

ROBOTS = {"y_reach": 2.0, "max_velocity": 4.0, "max_omega": 3.0}  # their states, about
NOISE = (1e-6, 1e-6)  # of measurements [m]
ONE = np.ones(1)  # long axis of the bar [m]
PHYSICS = Physics()


TIME = np.linspace(0, 1, 33)


def paths(x, y) -> Paths:
    """Return one throw at 32 frames a second."""
    pose = np.stack([x, y, np.zeros(33)], axis=1)[None]
    return Paths(np.array([4]), TIME[None], pose, None, np.ones((1, 33), bool))


def reflected(at: float, speed: float):
    """Return the way of a bar that comes back at full speed."""
    return at - np.abs(at - speed * TIME)


@pytest.mark.parametrize("which", ["left", "right", "floor"])
def test_planted_contacts_are_found(which: str) -> None:
    way, level = reflected(0.8, 2.0), np.zeros(33)
    found = contacts(
        {"right": paths(way, level), "left": paths(-way, level), "floor": paths(level, -way)}[which], ONE, NOISE
    )
    frames = {name: np.flatnonzero(getattr(found, name)[0]) for name in ("left", "right", "floor")}
    assert [name for name, at in frames.items() if len(at)] == [which]
    assert TIME[frames[which]] == pytest.approx(0.4, abs=1.5 / 32)
    assert found.around.sum() == 5


def test_slow_turns_of_drag_and_buoyancy_are_no_contacts() -> None:
    # It comes up again at 5 m/s², and is carried back by a current as fast; the top of a flight is no ceiling.
    turns = 2 * TIME - 2.5 * TIME**2
    for x, y in ((turns, -turns), (-turns, turns), (np.zeros(33), reflected(0.8, 2.0))):
        assert not contacts(paths(x, y), ONE, NOISE).around.any()


def several(x, y) -> Paths:
    """Return throws of (n_throws, n_frames) positions."""
    n, n_frames = np.shape(x)
    time = np.broadcast_to(np.arange(n_frames) / 32, (n, n_frames))
    pose = np.stack([x, y, np.zeros((n, n_frames))], axis=-1)
    return Paths(np.arange(n), time, pose, None, np.ones((n, n_frames), bool))


def stopped(at: float, speeds) -> np.ndarray:
    """Return ways of bars of 1 m that stop where their edges are at a place."""
    return np.minimum(np.asarray(speeds)[:, None] * TIME, at - 0.5)


@pytest.mark.parametrize("which", ["left", "right"])
def test_bars_that_stop_at_a_wall_touch_it(which: str) -> None:
    speeds = np.array([1.5, 2.0, 3.0, 0.4])  # the last does not get there
    x = stopped(1.5, speeds) * (1 if which == "right" else -1)
    found = contacts(several(x, np.zeros((4, 33))), np.ones(4), NOISE)
    assert getattr(found, which).any(axis=1).tolist() == [True, True, True, False]
    for throw, speed in enumerate(speeds[:3]):
        at = np.flatnonzero(found.any[throw])
        assert np.abs(at / 32 - 1 / speed).max() < 2.5 / 32
    assert n_contacts(found.any) == 3


def test_bars_that_drag_stops_are_at_no_wall() -> None:
    """They lose nine tenths of their speed in two frames, wherever they are, and three of them at one place."""
    farthest = np.array([1.0, 1.0, 1.0, 0.8, 0.7, 0.6])
    x = farthest[:, None] * (1 - 0.3 ** (32 * TIME))
    assert not contacts(several(x, np.zeros((6, 33))), np.ones(6), NOISE).any.any()


def test_two_bars_that_stop_at_one_place_may_do_so_by_chance() -> None:
    x = stopped(1.5, [1.5, 2.0, 0.4])
    assert not contacts(several(x, np.zeros((3, 33))), np.ones(3), NOISE).any.any()


def test_a_bar_that_lies_on_the_floor_rests_there() -> None:
    sinking = np.maximum(-1 - 2 * np.arange(80) / 32, -3.0)
    rising = -3 + 0.5 * np.abs(np.arange(80) / 32 - 1) ** 2  # turns at the same depth, as buoyancy makes it
    floating = np.zeros(80)
    y = np.stack([sinking, rising, floating])
    found = contacts(several(np.zeros((3, 80)), y), np.ones(3), NOISE)
    assert np.flatnonzero(found.floor[0]).tolist() == list(range(32, 80)) and not found.any[1:].any()
    assert n_contacts(found.floor) == 1


@pytest.mark.parametrize("factor", [0.5, 1.2, 2.0])
def test_bars_that_fall_too_fast_or_too_slowly_are_refused(factor: float) -> None:
    """Throws through air, of a tank whose scale is off by a factor; by a fifth is a warning."""
    throws = initial_states(Throws(n_throws=20, **ROBOTS), np.random.default_rng(2))
    state = throws.state.copy()
    state[:, 1] += 30
    exact = simulate_throws(replace(throws, state=state), 30, Slush(), PHYSICS)
    plain = MeasuredTransitions(**exact.columns(), residual_sd=np.full_like(exact.residual, 1e-3))
    gravity = PHYSICS.gravity * factor  # of the simulator; bars fall as ever
    residual = plain.residual.copy()
    residual[:, 4] += (gravity - PHYSICS.gravity) * PHYSICS.time_step
    fallen = replace(plain, residual=residual)
    if factor == 1.2:
        assert check_falls(fallen, gravity, PHYSICS.time_step).acceleration == pytest.approx(-9.8, abs=0.01)
        return
    with pytest.raises(TrackError, match=r"bars above the water fall at 9\.8 ± .* expected"):
        check_falls(fallen, gravity, PHYSICS.time_step)


def test_noise_makes_no_contacts() -> None:
    rng = np.random.default_rng(1)
    still = paths(*(0.02 * rng.normal(size=(2, 33))))
    assert contacts(still, ONE, NOISE).around.any()
    assert not contacts(still, ONE, (0.02, 0.02)).around.any()


def test_memory_is_found_where_it_is_planted_and_nowhere_else() -> None:
    throws = initial_states(Throws(n_throws=150, **ROBOTS), np.random.default_rng(2))
    exact = simulate_throws(throws, 60, Slush(), PHYSICS)
    plain = MeasuredTransitions(**exact.columns(), residual_sd=np.zeros_like(exact.residual))
    assert not memory(plain, PHYSICS.time_step, 0.02).found
    velocity = exact.state.reshape(150, 60, 6)[..., 3:5]
    before = np.zeros_like(velocity)
    before[:, 6:] = (velocity[:, 6:] - velocity[:, :-6]) / 6
    residual = exact.residual.copy()
    residual[:, 3:5] -= 0.4 * before.reshape(-1, 2)
    found = memory(replace(plain, residual=residual), PHYSICS.time_step, 0.02)
    assert found.found and found.share == pytest.approx(-0.4, abs=0.15)


def test_memory_is_not_tested_where_noise_hides_it() -> None:
    throws = initial_states(Throws(n_throws=40, **ROBOTS), np.random.default_rng(2))
    exact = simulate_throws(throws, 30, Slush(), PHYSICS)
    noisy = MeasuredTransitions(**exact.columns(), residual_sd=np.ones_like(exact.residual))
    assert memory(noisy, PHYSICS.time_step, 0.02).n_rows == 0
