"""The objective on figures worked out by hand."""

import numpy as np
import pytest

from tasks.evolution import evaluate, penalised_mean
from tasks.simulation import DIVERGED, OK, Rollouts


def test_the_mean_less_the_deviation() -> None:
    # Of 1, 3, 8: μ = 4, σ² = (9 + 1 + 16) / 3 = 26/3. Of -2, -2, -2: μ = -2, σ = 0.
    displacement = np.array([[1.0, 3.0, 8.0], [-2.0, -2.0, -2.0]])
    sigma = np.sqrt(26 / 3)
    np.testing.assert_allclose(penalised_mean(displacement, disagreement_penalty=1.0), [4 - sigma, -2], rtol=1e-15)
    np.testing.assert_allclose(penalised_mean(displacement, disagreement_penalty=2.0), [4 - 2 * sigma, -2], rtol=1e-15)


def test_without_a_penalty_it_is_the_mean() -> None:
    displacement = np.array([[1.0, 3.0, 8.0]])
    np.testing.assert_array_equal(penalised_mean(displacement, disagreement_penalty=0.0), [4.0])


@pytest.mark.parametrize("penalty", [0.0, 1.0, 3.0])
def test_a_single_world_has_no_disagreement(penalty: float) -> None:
    displacement = np.array([[0.1], [-7.3]])
    np.testing.assert_array_equal(penalised_mean(displacement, disagreement_penalty=penalty), [0.1, -7.3])


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_one_diverged_member_is_enough(bad: float) -> None:
    displacement = np.array([[1.0, bad], [1.0, 3.0]])
    np.testing.assert_array_equal(penalised_mean(displacement, disagreement_penalty=1.0), [-np.inf, 1.0])


def test_members_stand_beside_each_other_in_an_evaluation() -> None:
    rollouts = Rollouts(  # (n_members, n_designs)
        displacement=np.array([[1.0, 4.0, np.nan], [3.0, 4.0, 5.0]]),
        com_displacement=np.array([[0.5, 2.0, np.nan], [1.5, 2.5, 3.0]]),
        status=np.array([[OK, OK, DIVERGED], [OK, OK, OK]]),
        trace=None,
    )
    evaluation = evaluate(rollouts, disagreement_penalty=1.0)
    np.testing.assert_array_equal(evaluation.fitness, [1.0, 4.0, -np.inf])
    np.testing.assert_array_equal(evaluation.displacement, [[1.0, 3.0], [4.0, 4.0], [np.nan, 5.0]])
    np.testing.assert_array_equal(evaluation.com_displacement, [[0.5, 1.5], [2.0, 2.5], [np.nan, 3.0]])


def test_a_world_without_members_is_one() -> None:
    rollouts = Rollouts(
        displacement=np.array([1.0, np.nan]),
        com_displacement=np.array([0.5, np.nan]),
        status=np.array([OK, DIVERGED]),
        trace=None,
    )
    evaluation = evaluate(rollouts, disagreement_penalty=1.0)
    np.testing.assert_array_equal(evaluation.fitness, [1.0, -np.inf])
    np.testing.assert_array_equal(evaluation.displacement, [[1.0], [np.nan]])
