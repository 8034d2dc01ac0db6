"""Memory of the fluid, planted and absent."""

from dataclasses import replace

import numpy as np
import pytest

from tasks.residual import MeasuredTransitions, Throws, initial_states, simulate_throws
from tasks.tracks.fluid_memory import memory
from tasks.world import Physics, Slush

ROBOTS = {"y_reach": 2.0, "max_velocity": 4.0, "max_omega": 3.0}  # their states, about
PHYSICS = Physics()


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
