"""Whether the truth is robust: every champion again from other starts, with shorter steps, with continuous collision.

A champion of the target is the best of all scores of one start at one time step, so its score has luck and errors of
the integrator in it, whereas the target is new to the champions of every other environment.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tasks.analysis.columns import SCORE, OfArm, column, percent
from tasks.analysis.estimates import Estimate, Mean, mean_of, ratio, sample_of
from tasks.analysis.registry import analysis
from tasks.analysis.scores import Champion, arms
from tasks.analysis.study import StudyData
from tasks.arrays import Float64
from tasks.design import Designs
from tasks.simulation import Conditions
from tasks.simulation.engine import BOX2D, engine_in
from tasks.world import EnvironmentName

N_STARTS = 16
CONDITIONS: Mapping[str, Sequence[Conditions]] = {
    "one": [Conditions()],
    "starts": [Conditions(start=100 + k) for k in range(N_STARTS)],  # others than those of the objective
    "half_steps": [Conditions(n_substeps=2)],
    "quarter_steps": [Conditions(n_substeps=4)],
    "continuous": [Conditions(continuous_collision=True)],
}
"""Conditions by the column that has the mean score over them."""


@dataclass(frozen=True)
class RobustnessRow(OfArm):
    """The champions of one environment at one depth, scored zero-shot; shares are of the target's own champions."""

    n: int = column("n", form="{}", meaning="Champions.")
    one: Mean = column("one start", SCORE, meaning="Displacement of the root in the target in one rollout.")
    starts: Mean = column(f"{N_STARTS} starts", SCORE, meaning="Mean over starts with joints 1 mm and 1 mrad off.")
    half_steps: Mean = column("½ step", SCORE, meaning="With half the time step: of 1/120 s, by default.")
    quarter_steps: Mean = column("¼ step", SCORE, meaning="With a quarter of the time step: of 1/240 s, by default.")
    continuous: Mean = column(
        "continuous", SCORE, meaning="With Box2D's continuous collision, at the least depth alone."
    )
    share: Estimate = column("share", form=percent, meaning="Of the target's own champions, in one rollout.")
    quarter_share: Estimate = column("share, ¼ step", form=percent, meaning="The same with a quarter of the time step.")
    passive: Mean = column("motors off", SCORE, meaning="What the same bodies travel without motors.")
    gain_share: Estimate = column("share of gain", form=percent, meaning="Of zero-shot minus motors off.")


@analysis(
    "robustness",
    row=RobustnessRow,
    reads=("champions",),
    answers="Does a score in the target depend on the start, the time step, or how collisions are found?",
    section="transfer",
    cost=N_STARTS + 10,
)
def robustness(study: StudyData) -> list[RobustnessRow]:
    """Score the champions again, arm by arm, the greatest depth first."""
    rows, listed = list[RobustnessRow](), arms(study.trials, study.target)
    for depth in dict.fromkeys(depth for _, depth in listed):
        champions = [champion for champion in study.champions if champion.depth == depth]
        if champions:
            is_box2d = engine_in(study.at_target(depth).medium) in BOX2D
            shallowest = min(depth for _, depth in listed)
            scores = _scores(study, champions, depth, continuous=is_box2d and depth == shallowest)
            rows += [_row(study, arm, champions, scores) for arm in listed if arm[1] == depth]
    return rows


def _scores(study: StudyData, champions: Sequence[Champion], depth: float, *, continuous: bool) -> dict[str, Float64]:
    """Return the champions' scores by the column that has their mean; NaN where it isn't computed, or one diverged.

    The reference engine, which continuous collision needs, takes fifty times as long, and far from the ground finds the
    same.
    """
    designs, target = Designs.concatenate([champion.design for champion in champions]), study.at_target(depth)
    scores = {
        name: np.mean([study.score_under(one, target, designs) for one in conditions], axis=0)
        for name, conditions in CONDITIONS.items()
        if continuous or name != "continuous"
    }
    zero_shot, passive = (np.array([getattr(one, of) for one in champions]) for of in ("zero_shot", "passive"))
    return {"continuous": np.full(len(champions), np.nan), **scores, "passive": passive, "gain": zero_shot - passive}


def _row(
    study: StudyData, arm: tuple[EnvironmentName, float], champions: Sequence[Champion], scores: Mapping[str, Float64]
) -> RobustnessRow:
    replicate, home = np.array([one.replicate for one in champions]), np.array([one.environment for one in champions])

    def mean(of: str) -> Mean:
        return mean_of(scores[of][home == arm[0]])

    def share(of: str) -> Estimate:
        part, whole = (sample_of(scores[of][home == name], replicate[home == name]) for name in (arm[0], study.target))
        return ratio(part, whole, rng=study.rng("robustness", *arm, of))

    return RobustnessRow(
        *arm,
        int((home == arm[0]).sum()),
        mean("one"),
        mean("starts"),
        mean("half_steps"),
        mean("quarter_steps"),
        mean("continuous"),
        share("one"),
        share("quarter_steps"),
        mean("passive"),
        share("gain"),
    )
