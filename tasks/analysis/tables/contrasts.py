"""Contrasts: the arms of a study against the best possible, and learners against what they compete with."""

from collections.abc import Iterator

from tasks.analysis.comparison import Comparison, compare
from tasks.analysis.registry import StudyData, analysis
from tasks.analysis.scores import BEST, Quantity, ScoredArm
from tasks.world import in_order

_TRANSFERRED: tuple[Quantity, ...] = ("zero_shot", "adapted")


@analysis("contrasts", version=3, row=Comparison, reads=("transfer",), answers="Which arms travel farther than others?")
def contrasts(study: StudyData) -> list[Comparison]:
    """Make every contrast at every depth where both arms have trials; Holm's family is all of them."""
    return compare(study.trials, study.trials, list(pairs_of(study)))


def pairs_of(study: StudyData) -> Iterator[tuple[ScoredArm, ScoredArm]]:
    """Yield pairs of arms: each with the best, learners with media, and ensembles with the main one.

    A single network is compared with its own ensemble.
    """
    learners, arms = study.settings.learners, in_order(trial.environment for trial in study.trials)
    media = [name for name in arms if name not in learners and name != BEST[0]]
    ensembles = {learner.data_set: name for name, learner in learners.items() if not learner.is_single}
    main = next(iter(learners.values())).data_set if learners else ""
    for name in arms:
        yield from (((name, quantity), BEST) for quantity in _TRANSFERRED if name != BEST[0])
    for name, learner in learners.items():
        whole = ensembles.get(learner.data_set if learner.is_single else main, name)
        for other in (*media, *([] if whole == name else [whole])):
            yield from (((name, quantity), (other, quantity)) for quantity in _TRANSFERRED)
