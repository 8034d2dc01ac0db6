"""Objectives and fitness on figures worked out by hand."""

from dataclasses import replace

import numpy as np
import pytest

from tasks.evolution import OBJECTIVES, evaluate, penalised_mean
from tasks.evolution.objectives import Objective, register_objective
from tasks.simulation import DIVERGED, OK, Rollouts

ENSEMBLE = Rollouts(  # (n_members, n_designs)
    displacement=np.array([[1.0, 4.0, np.nan], [3.0, 4.0, 5.0]]),
    com_displacement=np.array([[0.5, 2.0, np.nan], [1.5, 2.5, 3.0]]),
    second_half_speed=np.array([[0.1, 0.3, np.nan], [0.3, 0.3, 0.4]]),
    status=np.array([[OK, OK, DIVERGED], [OK, OK, OK]]),
    trace=None,
)


def test_fitness_is_the_mean_minus_the_deviation() -> None:
    # 1, 3, 8: μ = 4, σ² = (9 + 1 + 16) / 3 = 26/3. -2, -2, -2: μ = -2, σ = 0.
    scores = np.array([[1.0, 3.0, 8.0], [-2.0, -2.0, -2.0]])
    sigma = np.sqrt(26 / 3)
    np.testing.assert_allclose(penalised_mean(scores, disagreement_penalty=1.0), [4 - sigma, -2], rtol=1e-15)
    np.testing.assert_allclose(penalised_mean(scores, disagreement_penalty=2.0), [4 - 2 * sigma, -2], rtol=1e-15)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_one_diverged_member_is_enough(bad: float) -> None:
    scores = np.array([[1.0, bad], [1.0, 3.0]])
    np.testing.assert_array_equal(penalised_mean(scores, disagreement_penalty=1.0), [-np.inf, 1.0])


def test_an_environment_without_members_has_one() -> None:
    first = [getattr(ENSEMBLE, name)[0] for name in ("displacement", "com_displacement", "second_half_speed", "status")]
    evaluation = evaluate(Rollouts(*first, trace=None), disagreement_penalty=1.0)
    np.testing.assert_array_equal(evaluation.fitness, [1.0, 4.0, -np.inf])
    np.testing.assert_array_equal(evaluation.displacement, [[1.0], [4.0], [np.nan]])


@pytest.fixture
def com():
    """The displacement of the centre of mass, registered as an objective."""
    objective = Objective("com", "Displacement of the centre of mass", "m", lambda rollouts: rollouts.com_displacement)
    register_objective(objective)
    yield objective
    del OBJECTIVES["com"]


def test_a_registered_objective_decides_the_fitness(com: Objective) -> None:
    # 0.5 and 1.5: μ = 1, σ = 0.5. 2 and 2.5: μ = 2.25, σ = 0.25.
    evaluation = evaluate(ENSEMBLE, disagreement_penalty=1.0, objective=com.name)
    np.testing.assert_array_equal(evaluation.fitness, [0.5, 2.0, -np.inf])
    np.testing.assert_array_equal(evaluation.displacement[0], [1.0, 3.0])


def test_a_score_of_another_shape_is_refused(com: Objective, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(OBJECTIVES, com.name, replace(com, score=lambda rollouts: rollouts.com_displacement[0]))
    expected = r"'com': its score has shape \(3,\), expected that of rollouts.displacement, \(2, 3\)"
    with pytest.raises(ValueError, match=expected):
        evaluate(ENSEMBLE, disagreement_penalty=1.0, objective=com.name)


def test_speed_in_the_second_half_is_an_objective() -> None:
    # 0.1 and 0.3: μ = 0.2, σ = 0.1.
    evaluation = evaluate(ENSEMBLE, disagreement_penalty=1.0, objective="second_half_speed")
    np.testing.assert_allclose(evaluation.fitness, [0.1, 0.3, -np.inf], rtol=1e-15)


def test_displacement_per_energy_and_the_least_work_that_counts() -> None:
    rollouts = replace(ENSEMBLE, motor_work=np.array([[500.0, 0.0, np.nan], [1500.0, 29.4, 500.0]]))
    evaluation = evaluate(rollouts, disagreement_penalty=0.0, objective="displacement_per_energy")
    # 1 m by 0.5 kJ, 3 m by 1.5 kJ: 2 m/kJ each. 4 m by nothing and by 29.4 J, which both count as 58.8 J: 4 / 0.0588.
    np.testing.assert_allclose(evaluation.fitness, [2.0, 4 / 0.0588, -np.inf], rtol=1e-15)
    np.testing.assert_array_equal(evaluation.displacement[0], [1.0, 3.0])


def test_a_generalist_is_scored_by_its_mean_over_depths() -> None:
    """The mean over depths comes first, so that members disagree only where they do so in the mean."""
    deeper = replace(ENSEMBLE, displacement=np.array([[5.0, 0.0, 1.0], [3.0, 0.0, 1.0]]))
    mean = {"disagreement_penalty": 1.0, "objective": "mean_over_depths"}
    evaluation = evaluate(ENSEMBLE, varied=[ENSEMBLE, deeper], **mean)
    # Members' means over depths: 3 and 3; 2 and 2. The third diverges in its own depth, under the first member.
    np.testing.assert_array_equal(evaluation.fitness, [3.0, 2.0, -np.inf])
    np.testing.assert_array_equal(evaluation.displacement, ENSEMBLE.displacement.T)
    np.testing.assert_array_equal(evaluate(ENSEMBLE, varied=[deeper], **mean).fitness, [3.0, 0.0, -np.inf])
    deeper = replace(deeper, status=np.full((2, 3), OK))
    lost = replace(deeper, displacement=np.array([[5.0, np.nan, 1.0], [3.0, 0.0, 1.0]]))
    np.testing.assert_array_equal(evaluate(deeper, varied=[deeper, lost], **mean).fitness, [3.0, -np.inf, 1.0])
