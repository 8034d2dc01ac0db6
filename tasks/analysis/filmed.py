"""Filmed rollouts: the best champion of an arm in True Slush, and in the environment where it evolved."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tasks.analysis.registry import Champion, StudyData
from tasks.arrays import Float32, Float64
from tasks.world import ENVIRONMENTS, EnvironmentName

NO_MEMBER = -1  # stands for the member in an environment without an ensemble


@dataclass(frozen=True, eq=False)
class Filmed:
    """A rollout of a champion."""

    champion: Champion
    seen_in: EnvironmentName  # environment of the rollout
    member: int  # member of the ensemble, or NO_MEMBER
    displacement: float  # [m]
    trace: Float32  # (1, n_steps, n_links, 6)


def best_of(arm: Sequence[Champion]) -> Champion:
    """Return the champion to film: the best zero-shot, or the best where it evolved if none survives True Slush."""
    scored = np.array([champion.zero_shot for champion in arm])
    return arm[int(np.nanargmax(scored if np.isfinite(scored).any() else [champion.fitness for champion in arm]))]


def film_in_true_slush(study: StudyData, arm: Sequence[Champion]) -> list[Filmed]:
    """Return films of champions of one depth in True Slush; those that diverge are left out."""
    known = [champion for champion in arm if np.isfinite(champion.zero_shot)]
    films = []
    for champion in known:
        rollouts = study.simulate(study.true_slush(champion.depth), champion.design, trace=True)
        assert rollouts.trace is not None
        films.append(Filmed(champion, "true_slush", NO_MEMBER, float(rollouts.displacement[0]), rollouts.trace))
    return films


def film_best(study: StudyData, arm: Sequence[Champion]) -> list[Filmed]:
    """Return films of an arm's best champion: in True Slush and, if it evolved elsewhere, where it evolved.

    In an ensemble, that is the environment of the member whose prediction is the median.
    """
    best = best_of(arm)
    films = film_in_true_slush(study, [best])
    if best.environment == "true_slush":
        return films
    environment = study.home(best)
    rollouts = study.simulate(environment, best.design, trace=True)
    assert rollouts.trace is not None
    if not environment.is_ensemble:
        displacement, member, trace = float(rollouts.displacement[0]), NO_MEMBER, rollouts.trace
    else:
        predicted = rollouts.displacement[:, 0]
        k = median_member(predicted)
        member = study.member(best) if ENVIRONMENTS[best.environment].networks == "one" else k
        displacement, trace = float(predicted[k]), rollouts.trace[k]
    return [*films, Filmed(best, best.environment, member, displacement, trace)]


def median_member(values: Float64) -> int:
    """Return the member with the median of (n_members,) values, the lower of two; non-finite values are ignored."""
    ranked = np.argsort(values, kind="stable")  # NaN, for a rollout that diverged, comes last
    return int(ranked[max(int(np.isfinite(values).sum()) - 1, 0) // 2])
