"""Messages about designs that diverged: how many and where. Decoded tables in, text out.

A rollout in a sound environment stays finite. So a design that diverges points to an unsound medium, physics or
network. Evolution never lets it survive and figures leave it out, but the user must learn of it.
"""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from pipeline.config.settings import Settings
from pipeline.stages.reader import StudyReader, read_study
from pipeline.stages.segments import draws_of
from pipeline.stages.trial_scores import NO_CHAMPION, Scores
from pipeline.store.store import Store
from pipeline.store.tables import Columns
from pipeline.workflow.identity import ChainId, TrialId
from pipeline.workflow.stage import Upstream
from tasks.arrays import Bools


def found(study: StudyReader, stage: str) -> dict[ChainId, str]:
    """Describe what diverged in a stage, by chain; chains that stayed finite are left out."""
    read, describe = _DESCRIBED[stage]
    return {chain: message for chain, content in read(study).items() if (message := describe(content))}


def in_stage(stage: str) -> Callable[[Settings, Upstream, Store], Mapping[ChainId, str]]:
    """Return what describes for the workflow what diverged in a stage."""
    return lambda settings, upstream, store: found(read_study(settings, upstream, store), stage)


def in_trial(curve: Columns) -> str | None:
    """Describe what diverged while a trial evolved, from its curve; None if nothing did."""
    return _in_generations(curve, "designs") if np.isfinite(curve["best_fitness"][-1]) else NO_CHAMPION


def in_adaptation(curve: Columns) -> str | None:
    """Describe what diverged while a champion's controller adapted, likewise."""
    if np.isfinite(curve["best_fitness"][-1]):
        return _in_generations(curve, "designs of the adaptation")
    return "not adapted: every design of the adaptation diverged"


def in_transfer(scores: Scores | None) -> str | None:
    """Describe which of a trial's champions diverged in the target; a trial without one is left to its evolution."""
    champions = {"zero_shot": "the champion", "adapted": "the adapted champion"}
    lost = [whose for name, whose in champions.items() if scores and name in scores and scores[name] is None]
    return "; ".join(f"{whose} diverged in the target" for whose in lost) or None


def in_assessment(predictions: Columns) -> str | None:
    """Count which of a trial's assessed designs diverged; None if none did."""
    diverged = somewhere(predictions)
    if not diverged.any():
        return None
    return f"{diverged.sum()} of {len(diverged)} designs diverged, in the target or under a member"


def somewhere(predictions: Columns) -> Bools:
    """Return which assessed designs diverged, in the target or under any member: (n_designs,)."""
    finite: Bools = np.isfinite(predictions["true"]) & np.isfinite(predictions["predicted"]).all(axis=1)
    return ~finite


def _in_generations(curve: Columns, designs: str) -> str | None:
    """Count the designs of a curve that diverged, and give the first generation."""
    n_diverged = int(curve["n_diverged"].sum())
    if n_diverged == 0:
        return None
    n_designs = sum(drawn - rejected for drawn, rejected in draws_of([curve]).values())
    first = curve["generation"][np.flatnonzero(curve["n_diverged"])[0]]
    verb, when = ("was", "in") if n_diverged == 1 else ("were", "the first in")
    return f"{n_diverged} of {n_designs:,} {designs} diverged and {verb} discarded; {when} generation {first}"


def _adaptations(study: StudyReader) -> Mapping[TrialId, Columns]:
    """Return the curves of the adaptations of champions; where there was no champion, there was nothing to adapt."""
    evolved = study.curves()
    lost = {trial for trial, curve in evolved.items() if not np.isfinite(curve["best_fitness"][-1])}
    return {
        trial: curve for trial, curve in study.curves("adaptations").items() if trial.in_stage("evolve") not in lost
    }


_DESCRIBED: Mapping[str, tuple[Callable[[StudyReader], Mapping[Any, Any]], Callable[[Any], str | None]]] = {
    "evolve": (StudyReader.curves, in_trial),
    "adapt": (_adaptations, in_adaptation),
    "transfer": (lambda study: study.scores, in_transfer),
    "assess": (lambda study: study.predictions, in_assessment),
}
"""How to read the stages whose designs may diverge, and what describes one of their chains."""

STAGES = tuple(_DESCRIBED)
