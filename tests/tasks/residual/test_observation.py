"""What networks observe."""

import numpy as np
import pytest
from pydantic import ValidationError

from tasks.residual import Architecture, Throws, initial_states, simulate_throws
from tasks.residual.ensemble import Ensemble
from tasks.residual.hyperparameters import Training
from tasks.residual.observation import OBSERVATION, observe
from tasks.residual.training import train_member
from tasks.world import LinkStates, Physics, Slush

RICH = (*OBSERVATION, "sin_angle")


def links(n=1000, seed=0):
    rng = np.random.default_rng(seed)
    angle = rng.uniform(-9, 9, n)
    y, vx, vy, omega = rng.normal(size=(4, n)) * 3
    arrays = (rng.uniform(1, 3, n), np.ones(n), np.ones(n), y, np.cos(angle), np.sin(angle), vx, vy, omega)
    return LinkStates(*(array.astype(np.float32) for array in arrays))


def test_a_network_of_other_inputs_predicts_links_as_it_was_trained():
    found = simulate_throws(initial_states(Throws(n_throws=8), np.random.default_rng(1)), 20, Slush(), Physics())
    training = Training(n_iterations=20, batch_size=64, held_out=0.0)
    architecture = Architecture(hidden_layers=1, width=8, observation=RICH)
    arrays = train_member(found, architecture, training, seed=1, member=0).arrays()
    ensemble = Ensemble.from_members([arrays, arrays])
    assert ensemble.inputs == RICH and ensemble.weights[0].shape == (2, 7, 8)
    states = LinkStates(**{name: np.stack([array, array]) for name, array in vars(links()).items()})
    change = ensemble.velocity_change(states, Physics())
    expected = ensemble.predict(observe(vars(states), RICH))
    assert np.stack([change.vx, change.vy, change.omega], axis=-1) == pytest.approx(expected, rel=1e-4, abs=1e-5)


def test_an_input_is_named_once_and_is_known():
    with pytest.raises(ValidationError, match="observation repeats an input"):
        Architecture(observation=("y", "y"))
    with pytest.raises(ValidationError):
        Architecture(observation=("temperature",))
