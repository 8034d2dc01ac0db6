"""Walls and the floor, planted and absent."""

import numpy as np
import pytest

from tasks.tracks.table import Paths
from tasks.tracks.tank_contacts import contacts, n_contacts, slowest_contact

NOISE = (1e-6, 1e-6)  # of measurements [m]
ONE = np.ones(1)  # long axis of the bar [m]
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


def test_noise_makes_no_contacts() -> None:
    rng = np.random.default_rng(1)
    still = paths(*(0.02 * rng.normal(size=(2, 33))))
    assert contacts(still, ONE, NOISE).around.any()
    assert not contacts(still, ONE, (0.02, 0.02)).around.any()


def test_noise_and_fast_frames_hide_slow_contacts() -> None:
    """The slowest that is noticed is noticed, and a little slower ones are not."""
    sd = 0.02
    least = slowest_contact(1 / 32, (sd, sd))
    assert slowest_contact(1 / 64, (sd, sd)) == 2 * least and slowest_contact(1 / 32, NOISE) == 0.5
    for factor, found in ((1.05, True), (0.95, False)):
        way = reflected(0.5 * factor * least, factor * least)  # at the middle frame
        assert contacts(paths(way, np.zeros(33)), ONE, (sd, sd)).right.any() == found
