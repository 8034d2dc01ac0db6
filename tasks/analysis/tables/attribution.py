"""Attribution of the transfer gap to controller and body. Paper, "Evolution" and Fig. 4.

Champions are tested in True Slush as they are (zero-shot) and with a controller that evolved there (adapted). Designs
that evolved in True Slush mark the best possible displacement. So the gap has two parts:

    best - zero_shot  =  (adapted - zero_shot)  +  (best - adapted)
      the gap             lost to the controller     lost to the body

A part can be negative: adaptation from scratch may find a worse controller than the design's own, and the body's part
is then too large by the same amount. Adapted designs were searched longer than zero-shot ones, which favours them.
"""

from dataclasses import dataclass, replace

import numpy as np

from tasks.analysis.comparison import difference
from tasks.analysis.estimates import Estimate, Sample, ratio, sum_of_means
from tasks.analysis.registry import StudyData, analysis, column
from tasks.analysis.scores import BEST
from tasks.analysis.tables.transfer import environment_name, percent


@dataclass(frozen=True)
class Attribution:
    """The transfer gap of one arm at one depth: means over trials, and shares."""

    environment: str = column("evolved in", form=environment_name)
    depth: float = column("depth", "m", form="{:g}")
    n: int = column("n", form="{}", meaning="Trials with a zero-shot and an adapted displacement.")
    gap: Estimate = column("gap", "m", meaning="How far zero-shot champions fall short of those of True Slush.")
    lost_to_controller: Estimate = column("controller", "m", meaning="Part that adapting the controller recovers.")
    lost_to_body: Estimate = column("body", "m", meaning="Part that remains after it.")
    recovered_zero_shot: Estimate = column("zero-shot of E", form=percent)
    recovered_adapted: Estimate = column("adapted of E", form=percent)


@analysis(
    "attribution",
    row=Attribution,
    reads=("transfer",),
    answers="Is the transfer gap the body's fault, or the controller's?",
)
def attribution(study: StudyData) -> list[Attribution]:
    """Split the transfer gap of every arm except True Slush, at each depth."""
    scores, rng = study.scores, study.rng("attribution")
    rows = []
    for environment, depth in scores.arms():
        best, own = scores.sample(BEST, depth), scores.rows(environment, depth)
        both = own[np.isfinite(scores.zero_shot[own]) & np.isfinite(scores.adapted[own])]
        if environment == BEST[0] or len(best) == 0 or len(own) == 0:
            continue
        Z, A = (Sample(values[both], scores.replicate[both]) for values in (scores.zero_shot, scores.adapted))
        shares = (ratio(scores.sample((environment, name), depth), best, rng=rng) for name in ("zero_shot", "adapted"))
        parts = difference(best, Z)[0], sum_of_means(replace(Z, values=A.values - Z.values)), difference(best, A)[0]
        rows.append(Attribution(environment, depth, len(both), *parts, *shares))
    return rows
