import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from tasks.residual import Architecture
from tasks.residual.network import ResidualNetwork, Standardisation, dropout_mask


@given(seed=st.integers(0, 2**32 - 1), scale=st.floats(1e-3, 1e3), shift=st.floats(-3, 3))
def test_standardised_data_have_mean_0_deviation_1_and_come_back(seed, scale, shift):
    rng = np.random.default_rng(seed)
    observation, residual = (scale * (rng.normal(size=(2, 500, 6)) + shift)).astype(np.float32)
    s = Standardisation.of(observation, residual, standardise_targets=True)
    for standard in (s.standard_observation(observation), s.standard_residual(residual)):
        # A mean within 4 deviations of zero is rounded by 4 · 2^-24 of a deviation, three times over.
        assert standard.mean(axis=0, dtype=float) == pytest.approx(np.zeros(6), abs=12 * 2**-24)
        assert standard.std(axis=0, dtype=float) == pytest.approx(np.ones(6), rel=1e-6)
    back = s.residual(s.standard_residual(residual))
    assert back == pytest.approx(residual, rel=0, abs=scale * 8 * 4 * 2**-24)


def test_a_constant_column_is_centred_and_not_scaled():
    rows = np.random.default_rng(0).normal(size=(1000, 6)).astype(np.float32)
    rows[:, 0] = 0.1  # its mean in floating point need not be 0.1
    s = Standardisation.of(rows, rows, standardise_targets=True)
    assert s.observation_deviation[0] == 1.0 and s.residual_deviation[0] == 1.0
    assert np.abs(s.standard_observation(rows)[:, 0]).max() < 1e-7


def test_targets_may_keep_si_units():
    rows = np.random.default_rng(0).normal(3, 2, size=(1000, 6)).astype(np.float32)
    s = Standardisation.of(rows, rows, standardise_targets=False)
    assert (s.standard_residual(rows) == rows).all()
    assert s.observation_mean == pytest.approx(3, abs=0.4)


def test_network_has_the_architecture_it_was_given():
    network = ResidualNetwork(Architecture(hidden_layers=3, width=10))
    arrays = network.arrays()
    shapes = [arrays[f"weight_{i}"].shape for i in range(4)]
    assert shapes == [(6, 10), (10, 10), (10, 10), (10, 6)]
    assert [arrays[f"bias_{i}"].shape for i in range(4)] == [(10,), (10,), (10,), (6,)]
    assert len(arrays) == 8


def test_arrays_reproduce_the_network():
    network = ResidualNetwork(Architecture(hidden_layers=2, width=8)).eval()
    arrays = network.arrays()
    x = np.random.default_rng(0).normal(size=(50, 6)).astype(np.float32)
    h = np.maximum(x @ arrays["weight_0"] + arrays["bias_0"], 0)
    h = np.maximum(h @ arrays["weight_1"] + arrays["bias_1"], 0)
    expected = network(torch.from_numpy(x)).detach().numpy()
    assert h @ arrays["weight_2"] + arrays["bias_2"] == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("p", [0.001, 0.1, 0.9])
def test_dropout_drops_a_share_p_and_keeps_the_mean(p):
    torch.manual_seed(0)
    mask = dropout_mask(torch.Size((4000, 256)), p, torch.device("cpu"))
    n = mask.numel()
    dropped = mask == 0
    assert (mask[~dropped] == torch.tensor(1 / (1 - p), dtype=torch.float32)).all()
    deviation = (n * p * (1 - p)) ** 0.5
    assert int(dropped.sum()) == pytest.approx(n * p, abs=5 * deviation)
    # In any quarter too, the last included: the gaps reach the end.
    for quarter in dropped.view(4, -1):
        assert int(quarter.sum()) == pytest.approx(n * p / 4, abs=5 * deviation / 2)
    # Independent: a unit and the next are both dropped p² of the time.
    flat = dropped.flatten()
    both = int((flat[1:] & flat[:-1]).sum())
    assert both == pytest.approx(n * p * p, abs=5 * max((n * p * p) ** 0.5, deviation * 2 * p) + 1)


def test_dropout_acts_in_training_alone():
    network = ResidualNetwork(Architecture(hidden_layers=2, width=64, dropout=0.5))
    x = torch.ones(3, 6)
    network.train()
    assert (network(x) != network(x)).any()
    network.eval()
    assert (network(x) == network(x)).all()
