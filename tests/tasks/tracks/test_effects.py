"""Walls, the floor and memory, planted and absent."""

from dataclasses import replace

import numpy as np
import pytest

from tasks.residual import MeasuredTransitions, Throws, initial_states, simulate_throws
from tasks.tracks.effects import contacts, memory
from tasks.tracks.table import Paths
from tasks.world import Physics, Slush

ROBOTS = {"y_reach": 2.0, "max_velocity": 4.0, "max_omega": 3.0}  # their states, about
NOISE = (1e-6, 1e-6)  # of measurements [m]
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
        {"right": paths(way, level), "left": paths(-way, level), "floor": paths(level, -way)}[which], NOISE
    )
    frames = {name: np.flatnonzero(getattr(found, name)[0]) for name in ("left", "right", "floor")}
    assert [name for name, at in frames.items() if len(at)] == [which]
    assert TIME[frames[which]] == pytest.approx(0.4, abs=1.5 / 32)
    assert found.around.sum() == 5


def test_slow_turns_of_drag_and_buoyancy_are_no_contacts() -> None:
    # It comes up again at 5 m/s², and is carried back by a current as fast; the top of a flight is no ceiling.
    turns = 2 * TIME - 2.5 * TIME**2
    for x, y in ((turns, -turns), (-turns, turns), (np.zeros(33), reflected(0.8, 2.0))):
        assert not contacts(paths(x, y), NOISE).around.any()


def test_noise_makes_no_contacts() -> None:
    rng = np.random.default_rng(1)
    still = paths(*(0.02 * rng.normal(size=(2, 33))))
    assert contacts(still, NOISE).around.any()
    assert not contacts(still, (0.02, 0.02)).around.any()


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
