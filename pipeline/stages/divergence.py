"""Messages about designs that diverged: how many and where. Decoded tables in, text out.

A rollout in a sound environment stays finite. So a design that diverges points to an unsound medium, physics or
network. Evolution never lets it survive and figures leave it out, but the user must learn of it.
"""

import numpy as np

from pipeline.stages.segments import draws_of
from pipeline.stages.trial_scores import NO_CHAMPION, TrialScores
from pipeline.store.tables import Columns
from tasks.arrays import Bools


def in_trial(curve: Columns) -> str | None:
    """Describe what diverged while a trial evolved, from its curve; None if nothing did."""
    return _in_generations(curve, "designs") if np.isfinite(curve["best_fitness"][-1]) else NO_CHAMPION


def in_transfer(scores: TrialScores | None, adaptation: Columns | None) -> str | None:
    """Describe which of a trial's champions and its adaptation's designs diverged in the target; None if none did.

    A trial without a champion is left to :func:`in_trial`. ``adaptation`` is the curve of the adaptation, if any.
    """
    if scores is None:
        return None
    parts = []
    if adaptation is not None and np.isfinite(adaptation["best_fitness"][-1]):
        parts.append(_in_generations(adaptation, "designs of the adaptation"))
    elif adaptation is not None:
        parts.append("not adapted: every design of the adaptation diverged")
    for score, whose in ((scores.zero_shot, "the champion"), (scores.adapted, "the adapted champion")):
        if score is not None and np.isnan(score):
            parts.append(f"{whose} diverged in the target")
    return "; ".join(part for part in parts if part) or None


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
