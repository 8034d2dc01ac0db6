"""Whether another simulator says the same: the transfer of champions in each engine in which they are scored."""

from collections.abc import Sequence
from dataclasses import dataclass

from tasks.analysis.columns import SCORE, OfArm, column, percent
from tasks.analysis.estimates import Estimate, Mean
from tasks.analysis.registry import analysis
from tasks.analysis.scores import ScoredTrial, by_arm
from tasks.analysis.study import StudyData
from tasks.analysis.tables.transfer import transfer_rows

_ALIKE = 0.15


@dataclass(frozen=True)
class EngineRow(OfArm):
    """The champions of one environment at one depth, in one engine."""

    engine: str = column("engine", form="{}")
    zero_shot: Mean = column("zero-shot", SCORE, meaning="Displacement of the root in the target, as it is.")
    zero_shot_share: Estimate = column("share", form=percent, meaning="Of the target's own, in the same engine.")
    adapted: Mean = column("adapted", SCORE, meaning="With a controller that evolved in the target.")
    adapted_share: Estimate = column("share, adapted", form=percent, meaning="Of the same mean.")
    alike: int = column("alike", form="{}", meaning="Champions that get as far zero-shot as in Box2D, within 15 %.")
    n: int = column("n", form="{}", meaning="Trials.")


def _n_alike(trials: Sequence[ScoredTrial], in_box2d: Sequence[ScoredTrial]) -> int:
    pairs = zip(trials, in_box2d, strict=True)
    return sum(abs(one.zero_shot - other.zero_shot) <= _ALIKE * abs(other.zero_shot) for one, other in pairs)


@analysis(
    "engines",
    row=EngineRow,
    reads=("champions",),
    answers="Do champions do as well in another simulator?",
    section="transfer",
    needs_engines=True,
)
def engines(study: StudyData) -> list[EngineRow]:
    """Average the trials of each arm in each engine, the greatest depth first."""
    in_box2d = by_arm(study.trials)
    rows = [
        EngineRow(
            row.environment,
            row.depth,
            engine,
            row.zero_shot,
            row.zero_shot_share,
            row.adapted,
            row.adapted_share,
            _n_alike(by_arm(trials)[row.environment, row.depth], in_box2d[row.environment, row.depth]),
            row.n,
        )
        for engine, trials in study.in_engines.items()
        for row in transfer_rows(trials, study.target)
    ]
    arms = list(dict.fromkeys((row.environment, row.depth) for row in rows))
    return sorted(rows, key=lambda row: arms.index((row.environment, row.depth)))
