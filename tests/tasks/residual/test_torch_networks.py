"""Networks that torch evaluates in each step: the batch engine's outputs and rollouts, up to roundings."""

import numpy as np
import pytest

from pipeline.cluster import connect
from tasks.design import random_designs
from tasks.residual import Architecture
from tasks.residual.ensemble import Ensemble
from tasks.residual.served_ensemble import TOLERANCE, ServedEnsemble
from tasks.residual.torch_networks import OutOfTolerance, TorchNetworks
from tasks.simulation import simulate
from tasks.world import Physics, ResidualSlush
from tests.tasks.residual.test_ensemble import members, observations


def ensembles(**size):
    local = Ensemble.from_members(members(Architecture(**size))[1])
    return local, ServedEnsemble(local.weights, local.biases, local.form, connect)


@pytest.mark.parametrize("size", [{"hidden_layers": 1, "width": 7}, {}])
def test_outputs_are_those_of_the_batch_engine(size):
    local, served = ensembles(**size)
    x = observations(100)
    expected = local.predict(x)
    assert abs(served.predict(x) - expected).max() < 2 * TOLERANCE * abs(expected).max()


def test_rollouts_are_those_of_the_batch_engine():
    """Also in shorter steps, whose changes are smaller. Under water nothing makes small differences grow."""
    designs = random_designs(6, np.random.default_rng(1))
    for physics in (Physics(), Physics(time_step=1 / 120)):
        local, served = (
            simulate(designs, ResidualSlush(30.0, one), n_settle=5, n_measure=40, physics=physics)
            for one in ensembles(hidden_layers=2, width=32)
        )
        assert abs(local.displacement).max() > 0.1
        np.testing.assert_allclose(served.displacement, local.displacement, atol=1e-4)


def test_roundings_of_tf32_are_out_of_tolerance(monkeypatch):
    local, served = ensembles(hidden_layers=2, width=32)
    rounded = [((w.view(np.int32) & ~0x1FFF).view(np.float32), b) for w, b in served.layers]  # 10 bits of 23
    monkeypatch.setattr("tasks.residual.torch_networks._exactly", lambda layers, x: local.predict(x))
    x, y = np.zeros((3, 64, 6), np.float32), np.zeros((3, 64, 3), np.float32)
    with pytest.raises(OutOfTolerance, match=r"errors of 0.000\d of the largest, expected less than 1e-05"):
        TorchNetworks(rounded, x, y)
