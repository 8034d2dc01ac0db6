"""Winner's luck: every champion again, from starts that differ by a millimetre and a milliradian.

A rollout repeats itself exactly. A champion of the target is the best of all scores of one start, so its score has luck
in it that the next start has not, whereas the target is new to the champions of every other environment.
"""

from dataclasses import dataclass

import numpy as np

from tasks.analysis.columns import SCORE, OfArm, column
from tasks.analysis.estimates import Estimate, Mean, mean_of, sample_of, sum_of_means
from tasks.analysis.registry import analysis
from tasks.analysis.scores import Champion, arms
from tasks.analysis.study import StudyData
from tasks.design import Designs, jittered

N_STARTS = 32
_SHIFT, _TURN = 1e-3, 1e-3  # of every joint along its links [m], and of its angle [rad]


@dataclass(frozen=True)
class LuckRow(OfArm):
    """The champions of one environment at one depth, scored zero-shot from one start and from many."""

    n: int = column("n", form="{}", meaning="Champions with a finite score from every start.")
    one: Mean = column("one start", SCORE, meaning="Zero-shot, as in every other table.")
    again: Mean = column(f"{N_STARTS} starts", SCORE, meaning="Mean over starts with joints 1 mm and 1 mrad off.")
    luck: Estimate = column("luck", SCORE, form="{:z.2f}", meaning="One start minus the mean over many.")


@analysis(
    "luck",
    row=LuckRow,
    reads=("champions",),
    answers="How much of a score in the target is luck: from one start, and over starts that are a millimetre off?",
    section="transfer",
    cost=N_STARTS,
)
def luck(study: StudyData) -> list[LuckRow]:
    """Score the champions again, arm by arm, the greatest depth first."""
    rows = []
    for arm in arms(study.trials):
        own = [champion for champion in study.champions if (champion.environment, champion.depth) == arm]
        one = np.array([champion.zero_shot for champion in own])
        again = np.array([scored_again(study, champion) for champion in own])
        lost = sample_of(one - again, np.array([champion.replicate for champion in own], np.int64))
        known = np.isfinite(one) & np.isfinite(again)
        rows.append(LuckRow(*arm, len(lost), mean_of(one[known]), mean_of(again[known]), sum_of_means(lost)))
    return rows


def scored_again(study: StudyData, champion: Champion) -> float:
    """Return a champion's mean score over the starts; NaN if one diverged."""
    return float(study.score(study.at_target(champion.depth), moved_joints(study, champion))[:, 0].mean())


def moved_joints(study: StudyData, champion: Champion) -> Designs:
    """Return N_STARTS copies of a champion with every joint a millimetre and a milliradian off, either way."""
    rng = study.rng("luck", champion.environment, champion.depth, str(champion.trial))
    copies = Designs.concatenate([champion.design] * N_STARTS)
    length = copies.length_scale
    shifts = {
        "parent_attachment": _SHIFT / (np.take_along_axis(length, np.maximum(copies.parent, 0), axis=1) / 2),
        "child_attachment": _SHIFT / (length / 2),
        "rest_angle": np.full_like(length, _TURN),
    }
    return jittered(copies, rng, shifts)
