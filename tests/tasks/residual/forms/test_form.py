"""Forms: what all of them promise, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest

from tasks.residual import FORMS, Architecture, Throws, Training, form_named, initial_states, simulate_throws
from tasks.residual.ensemble import Ensemble
from tasks.residual.forms import observe, register_form, velocity_changes
from tasks.residual.forms.plain import PLAIN
from tasks.residual.training import train_member
from tasks.world import Physics, Slush
from tests.tasks.residual.test_ensemble import links


@pytest.mark.parametrize("name", sorted(FORMS))
def test_stored_networks_of_a_form_predict_links_as_they_were_trained(name):
    found = simulate_throws(initial_states(Throws(n_throws=8), np.random.default_rng(1)), 20, Slush(), Physics())
    training = Training(n_iterations=20, batch_size=64, held_out=0.0)
    arrays = train_member(found, Architecture(hidden_layers=1, width=8, form=name), training, seed=1, member=0).arrays()
    ensemble, form = Ensemble.from_members([arrays, arrays]), FORMS[name]
    assert ensemble.form is form and ensemble.weights[0].shape == (2, len(form.inputs) + len(form.unseen), 8)
    states = links((2, 1000))
    change, inputs = ensemble.velocity_change(states, Physics()), observe(form, states)[1]
    seen = inputs[:, : len(form.inputs)]
    hidden = ((seen - arrays["observation_mean"]) / arrays["observation_deviation"]) @ arrays["weight_0"]
    standard = np.maximum(hidden + arrays["bias_0"], 0) @ arrays["weight_1"] + arrays["bias_1"]
    outputs = standard * arrays["residual_deviation"] + arrays["residual_mean"]
    expected = velocity_changes(form, outputs[:, len(form.beside) :], inputs)
    assert np.stack([change.vx, change.vy, change.omega], axis=-1)[1] == pytest.approx(expected, rel=1e-3, abs=1e-4)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({}, "form 'plain' is registered twice"),
        ({"name": "other", "inputs": ("y",)}, "form 'other': read returns 6 inputs, expected 1: y"),
        ({"name": "other", "act": lambda outputs, inputs: outputs[:2]}, "'other': act returns 2 changes, expected 3"),
    ],
)
def test_a_form_that_does_not_fit_itself_is_refused(wrong, said):
    with pytest.raises(ValueError, match=said):
        register_form(replace(PLAIN, **wrong))


def test_an_unknown_form_is_answered_with_the_list():
    with pytest.raises(ValueError, match=r"any of law, .*, plain, signed_angle, wetted, wetted_mass, got 'wet'"):
        form_named("wet")
