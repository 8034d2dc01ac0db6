"""The registry of objectives, and fitness from the scores of an ensemble. Paper, "Performance Evaluation"."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from tasks.arrays import Float64
from tasks.discovery import register
from tasks.simulation import OK, Conditions, Rollouts


@dataclass(frozen=True)
class Objective:
    """A quantity of rollouts that evolution maximises."""

    name: str
    label: str
    unit: str
    score: Callable[[Rollouts], Float64]  # a score for each, in the shape of ``rollouts.displacement``
    motor_work: bool = False  # whether the score needs ``rollouts.motor_work``
    over_depths: bool = False  # whether it is the mean of the scores at several depths, which are a setting
    trace: bool = False  # whether the score needs ``rollouts.trace``
    conditions: tuple[Conditions, ...] = ()  # of rollouts that it is the mean of the scores of; none: the study's own

    @property
    def is_papers(self) -> bool:
        """Whether it is the paper's, whose scores are displacements."""
        return self.name == PAPERS_OBJECTIVE

    def in_words(self, depths: Sequence[float] = ()) -> str:
        """Name it within a sentence, with the depths [m] that it is the mean over: none, or at least two."""
        if not depths:
            return self.label.lower()
        *others, last = (f"{depth:g}" for depth in depths)
        return f"{self.label.lower()} over depths of {', '.join(others)} and {last} m"

    def with_unit(self, words: str) -> str:
        """Add the unit to a heading, if there is one."""
        return f"{words} [{self.unit}]" if self.unit else words


OBJECTIVES: dict[str, Objective] = {}  # objectives by name

PAPERS_OBJECTIVE = "displacement"

ObjectiveName: TypeAlias = str  # name of a registered objective


def register_objective(objective: Objective) -> None:
    """Add an objective to the registry; raise ValueError if the name is taken."""
    register(OBJECTIVES, "objective", objective.name, objective)


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Scores of n_designs designs; environments without an ensemble have one member."""

    fitness: Float64  # (n_designs,) in the objective's unit; -inf where any rollout diverged, in any conditions
    displacement: Float64  # (n_designs, n_members) displacement of the root [m]; NaN where diverged
    com_displacement: Float64  # (n_designs, n_members) the same of the whole robot's centre of mass
    scores: Float64  # (n_designs, n_members) by the objective


def evaluate(
    rollouts: Rollouts,
    *,
    disagreement_penalty: float,
    objective: ObjectiveName = PAPERS_OBJECTIVE,
    varied: Sequence[Rollouts] = (),
) -> Evaluation:
    """Return the scores of rollouts; in an environment without an ensemble, the fitness is the score itself.

    Args:
        rollouts: rollouts of n_designs designs.
        disagreement_penalty: k in μ - k σ over members.
        objective: name of the objective.
        varied: rollouts of the same designs under the same members at each depth, or in each of the conditions, that
            the objective is the mean over.

    Raises:
        ValueError: an objective over conditions has no such rollouts, or another has some; or its scores have another
            shape.
    """
    chosen = OBJECTIVES[objective]
    is_mean = chosen.over_depths or bool(chosen.conditions)
    if is_mean != bool(varied):
        expected = "at least 1" if is_mean else "0"
        raise ValueError(f"objective {chosen.name!r}: varied has length {len(varied)}, expected {expected}")
    scores = _mean_score(chosen, rollouts, varied) if is_mean else chosen.score(rollouts)
    if np.shape(scores) != rollouts.displacement.shape:
        expected = f"that of rollouts.displacement, {rollouts.displacement.shape}"
        raise ValueError(f"objective {chosen.name!r}: its score has shape {np.shape(scores)}, expected {expected}")
    by_member = np.atleast_2d(scores).T
    return Evaluation(
        fitness=penalised_mean(by_member, disagreement_penalty=disagreement_penalty),
        displacement=np.atleast_2d(rollouts.displacement).T,
        com_displacement=np.atleast_2d(rollouts.com_displacement).T,
        scores=by_member,
    )


def _mean_score(objective: Objective, rollouts: Rollouts, varied: Sequence[Rollouts]) -> Float64:
    """Return the mean score over varied rollouts; NaN where one of them diverged, or the study's own."""
    mean = np.mean([objective.score(each) for each in varied], axis=0)
    return np.where(rollouts.status == OK, mean, np.nan)


def penalised_mean(scores: Float64, *, disagreement_penalty: float) -> Float64:
    """Return (n_designs,) fitness: μ - k σ over members. The paper's k is 1.

    Args:
        scores: (n_designs, n_members), in the objective's unit. The fitness is -inf where a member's rollout diverged.
        disagreement_penalty: k.
    """
    finite = np.asarray(np.isfinite(scores).all(axis=1))
    known = np.where(finite[:, None], scores, 0.0)
    fitness = known.mean(axis=1) - disagreement_penalty * disagreement(known)
    return np.where(finite, fitness, -np.inf)


def disagreement(scores: Float64) -> Float64:
    """Return (n_designs,) σ of (n_designs, n_members) scores over members, with n_members in its denominator."""
    sigma: Float64 = scores.std(axis=1)
    return sigma
