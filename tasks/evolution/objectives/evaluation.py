"""The registry of objectives, and fitness from the scores of an ensemble. Paper, "Performance Evaluation"."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from tasks.arrays import Float64
from tasks.parameters import RegisteredNames
from tasks.simulation import Rollouts


@dataclass(frozen=True)
class Objective:
    """A quantity of rollouts that evolution maximises."""

    name: str
    label: str
    unit: str
    score: Callable[[Rollouts], Float64]  # a score for each, in the shape of ``rollouts.displacement``


OBJECTIVES: dict[str, Objective] = {}  # objectives by name

PAPERS_OBJECTIVE = "displacement"

ObjectiveName = Annotated[str, RegisteredNames(OBJECTIVES)]  # name of a registered objective


def register_objective(objective: Objective) -> None:
    """Add an objective to the registry.

    Raises:
        ValueError: another objective has the name.
    """
    if objective.name in OBJECTIVES:
        raise ValueError(f"objective {objective.name!r} is registered twice, expected one objective of that name")
    OBJECTIVES[objective.name] = objective


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Scores of n_designs designs; environments without an ensemble have one member."""

    fitness: Float64  # (n_designs,) in the objective's unit; -inf where any rollout diverged
    displacement: Float64  # (n_designs, n_members) displacement of the root [m]; NaN where diverged
    com_displacement: Float64  # (n_designs, n_members) the same of the whole robot's centre of mass


def evaluate(
    rollouts: Rollouts, *, disagreement_penalty: float, objective: ObjectiveName = PAPERS_OBJECTIVE
) -> Evaluation:
    """Return the scores of rollouts; in an environment without an ensemble, the fitness is the score itself.

    Args:
        rollouts: rollouts of n_designs designs.
        disagreement_penalty: k in μ - k σ over members.
        objective: name of the objective.
    """
    return Evaluation(
        fitness=penalised_mean(
            np.atleast_2d(OBJECTIVES[objective].score(rollouts)).T, disagreement_penalty=disagreement_penalty
        ),
        displacement=np.atleast_2d(rollouts.displacement).T,
        com_displacement=np.atleast_2d(rollouts.com_displacement).T,
    )


def penalised_mean(scores: Float64, *, disagreement_penalty: float) -> Float64:
    """Return (n_designs,) fitness: μ - k σ, where σ is the population deviation of the members. The paper's k is 1.

    Scores are (n_designs, n_members), in the objective's unit. The fitness is -inf where a member's rollout diverged.
    """
    finite = np.asarray(np.isfinite(scores).all(axis=1))
    known = np.where(finite[:, None], scores, 0.0)
    fitness = known.mean(axis=1) - disagreement_penalty * known.std(axis=1)
    return np.where(finite, fitness, -np.inf)
