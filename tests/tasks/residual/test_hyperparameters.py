import numpy as np
import pytest

from tasks.residual import Training
from tasks.residual.hyperparameters import learning_rate


def test_learning_rate_rises_to_its_peak_and_decays_exponentially_to_its_least():
    training = Training(n_iterations=1000, warm_up=0.02)
    rates = np.array([learning_rate(training, i) for i in range(1000)])
    assert rates[0] == pytest.approx(1e-3 / 20)
    assert rates[9] == pytest.approx(1e-3 / 2)
    assert rates[19] == rates[20] == pytest.approx(1e-3)
    assert rates[-1] == pytest.approx(1e-6)
    ratios = rates[21:] / rates[20:-1]
    assert ratios == pytest.approx(1e-3 ** (1 / 979))
    default = Training()
    assert learning_rate(default, 499) == default.learning_rate
    assert learning_rate(default, 49_999) == pytest.approx(1e-6)
    for shortest in (Training(n_iterations=10, warm_up=0.0), Training(n_iterations=10, warm_up=0.5)):
        assert max(learning_rate(shortest, i) for i in range(10)) == 1e-3
        assert learning_rate(shortest, 9) == pytest.approx(1e-6)


def test_learning_rate_decays_by_half_a_cosine():
    training = Training(n_iterations=1001, warm_up=0.2, decay="cosine")
    rates = np.array([learning_rate(training, i) for i in range(200, 1001)])
    assert rates[[0, -1]] == pytest.approx([1e-3, 1e-6])
    assert rates + rates[::-1] == pytest.approx(1e-3 + 1e-6)  # odd about the middle
    assert rates[200] == pytest.approx(1e-6 + (1e-3 - 1e-6) * (1 + 0.5**0.5) / 2)
