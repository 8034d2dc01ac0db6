"""Contrasts: the arms of a study against the best possible, and against each other."""

from tasks.analysis.comparison import Comparison, compare
from tasks.analysis.registry import StudyData, analysis
from tasks.analysis.scores import BEST, Quantity, ScoredArm

_TRANSFERRED: tuple[Quantity, ...] = ("zero_shot", "adapted")
_AGAINST_BEST = ("dry_land", "residual_slush", "single_member", "designed_throws", "randomised_slush")
_AGAINST_EACH_OTHER = (
    ("residual_slush", "dry_land"),
    ("residual_slush", "single_member"),
    ("designed_throws", "residual_slush"),
    ("designed_throws", "designed_single_member"),
    ("residual_slush", "randomised_slush"),
)

CONTRASTS: tuple[tuple[ScoredArm, ScoredArm], ...] = (
    *(((arm, quantity), BEST) for arm in _AGAINST_BEST for quantity in _TRANSFERRED),
    *(((a, quantity), (b, quantity)) for a, b in _AGAINST_EACH_OTHER for quantity in _TRANSFERRED),
    (("residual_slush", "zero_shot"), ("dry_land", "adapted")),
)


@analysis("contrasts", version=2, row=Comparison, reads=("transfer",), answers="Which arms travel farther than others?")
def contrasts(study: StudyData) -> list[Comparison]:
    """Make every contrast at every depth where both arms have trials; Holm's family is all of them."""
    return compare(study.trials, study.trials, CONTRASTS)
