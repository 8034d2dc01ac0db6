import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from tasks.residual import Architecture
from tasks.residual.network import Standardisation, initial_weights


@settings(max_examples=20)  # a million numbers each
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


def test_initial_weights_are_those_of_torch_s_linear_layers():
    """Uniform within ±1 / √n_in: the extremes of 250,000 samples come within 1e-3 of it, and moments are known."""
    weights = initial_weights(Architecture(hidden_layers=3, width=500).sizes, np.random.default_rng(1))
    assert [weights[f"weight_{i}"].shape for i in range(4)] == [(6, 500), (500, 500), (500, 500), (500, 6)]
    assert [weights[f"bias_{i}"].shape for i in range(4)] == [(500,), (500,), (500,), (6,)]
    assert len(weights) == 8 and {array.dtype for array in weights.values()} == {np.dtype(np.float32)}
    theirs = torch.nn.Linear(500, 500).weight.detach().numpy()
    for array in (weights["weight_1"], theirs):
        assert np.abs(array).max() == pytest.approx(500**-0.5, rel=1e-3)
        assert array.std() == pytest.approx((3 * 500) ** -0.5, rel=0.01)
