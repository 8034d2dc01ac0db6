"""Walls and the floor, planted and absent."""

import numpy as np
import pytest

from tasks.bench.tracks.table import Paths
from tasks.bench.tracks.tank_contacts import contacts, n_contacts

TIME = np.linspace(0, 1, 33)
LEVEL = np.zeros(33)


def contacts_of(x, y, noise: float = 1e-6) -> np.ndarray:
    """Look for contacts of upright bars of 1 m, at 32 frames a second, with noise of measurements [m]."""
    x, y = np.broadcast_arrays(np.atleast_2d(x), np.atleast_2d(y))
    time = np.broadcast_to(np.arange(x.shape[1]) / 32, x.shape)
    paths = Paths(np.arange(len(x)), time, np.stack([x, y, 0 * time], axis=-1), None, np.ones(x.shape, bool))
    return contacts(paths, np.ones(len(x)), (noise, noise))


def reflected(at: float, speed: float):
    """Return the way of a bar that comes back at full speed."""
    return at - np.abs(at - speed * TIME)


def stopped(at: float, speeds) -> np.ndarray:
    """Return ways of bars of 1 m that stop where their edges are at a place."""
    return np.minimum(np.asarray(speeds)[:, None] * TIME, at - 0.5)


@pytest.mark.parametrize(
    ("x", "y"),
    [(reflected(0.8, 2.0), LEVEL), (-reflected(0.8, 2.0), LEVEL), (LEVEL, -reflected(0.8, 2.0))],
    ids=["right", "left", "floor"],
)
def test_planted_contacts_are_found(x, y) -> None:
    assert TIME[contacts_of(x, y)[0]] == pytest.approx([0.4], abs=1.5 / 32)


TURNS = 2 * TIME - 2.5 * TIME**2  # comes back at 5 m/s²
FARTHEST = np.array([1.0, 1.0, 1.0, 0.8, 0.7, 0.6])[:, None]


@pytest.mark.parametrize(
    ("x", "y"),
    [
        (TURNS, -TURNS),  # a current carries it back, and buoyancy up
        (-TURNS, TURNS),
        (LEVEL, reflected(0.8, 2.0)),  # the top of a flight is no ceiling
        (FARTHEST * (1 - 0.3 ** (32 * TIME)), LEVEL),  # drag takes nine tenths in two frames, of three at one place
        (stopped(1.5, [1.5, 2.0, 0.4]), LEVEL),  # two that stop at one place may do so by chance
    ],
)
def test_what_a_fluid_does_is_no_contact(x, y) -> None:
    assert not contacts_of(x, y).any()


@pytest.mark.parametrize("sign", [1, -1])
def test_bars_that_stop_at_a_wall_touch_it(sign: int) -> None:
    speeds = np.array([1.5, 2.0, 3.0, 0.4])  # the last does not get there
    at = contacts_of(sign * stopped(1.5, speeds), LEVEL)
    assert at.any(axis=1).tolist() == [True, True, True, False]
    for throw, speed in enumerate(speeds[:3]):
        assert np.abs(np.flatnonzero(at[throw]) / 32 - 1 / speed).max() < 2.5 / 32
    assert n_contacts(at) == 3


def test_a_bar_that_lies_on_the_floor_rests_there() -> None:
    time = np.arange(80) / 32
    sinking, floating = np.maximum(-1 - 2 * time, -3.0), 0 * time
    rising = -3 + 0.5 * np.abs(time - 1) ** 2  # turns at the same depth, as buoyancy makes it
    at = contacts_of(0 * time, np.stack([sinking, rising, floating]))
    assert np.flatnonzero(at[0]).tolist() == list(range(32, 80)) and not at[1:].any()
    assert n_contacts(at) == 1


def test_noise_and_fast_frames_hide_slow_contacts() -> None:
    """A contact is noticed from six deviations of a difference between two frames on; noise alone is not."""
    sd = 0.02
    for noise, least in ((sd, 6 * np.sqrt(2) * sd * 32), (1e-6, 0.5)):
        for factor, noticed in ((1.05, True), (0.95, False)):
            way = reflected(0.5 * factor * least, factor * least)  # at the middle frame
            assert contacts_of(way, LEVEL, noise).any() == noticed
    still = sd * np.random.default_rng(1).normal(size=(2, 33))
    assert contacts_of(*still).any() and not contacts_of(*still, sd).any()
