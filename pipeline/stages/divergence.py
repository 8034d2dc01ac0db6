"""What is said of designs that diverged: how many of how many, and where. Decoded tables in, words out.

A rollout in a sound world stays finite. So a design that diverges tells of a medium, a physics or a network that is not
sound. Evolution never lets it survive and figures leave it out; a person is to hear of it all the same.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from pipeline.stages.segments import drawn_column, rejected_column
from pipeline.store.tables import Columns
from tasks.arrays import Bools
from tasks.evolution import OPERATORS

NO_CHAMPION = "no champion: every design of the trial diverged"
"""What is said of a trial that came to nothing."""


def in_trial(curve: Columns) -> str | None:
    """Say what diverged while a trial evolved; None where nothing did.

    Args:
        curve: the trial's, (n_generations,) each column.
    """
    return _in_generations(curve, "designs") if np.isfinite(curve["best_fitness"][-1]) else NO_CHAMPION


def in_transfer(scores: Mapping[str, Any], adaptation: Columns | None) -> str | None:
    """Say what diverged in True Slush, of a trial's champions and its adaptation's designs; None where nothing did.

    Nothing is said of a trial without a champion: its evolution says why.

    Args:
        scores: the trial's; a displacement is None where the champion's rollout diverged.
        adaptation: the adaptation's curve, (n_generations,) each column; None where there was none.
    """
    if scores["status"] != "ok":
        return None
    said = []
    if adaptation is not None and np.isfinite(adaptation["best_fitness"][-1]):
        said.append(_in_generations(adaptation, "designs of the adaptation"))
    elif adaptation is not None:
        said.append("not adapted: every design of the adaptation diverged")
    for name, whose in (("zero_shot", "the champion"), ("adapted", "the adapted champion")):
        if name in scores and scores[name] is None:
            said.append(f"{whose} diverged in True Slush")
    return "; ".join(part for part in said if part) or None


def in_assessment(predictions: Columns) -> str | None:
    """Say how many of a trial's assessed designs diverged; None where none did.

    Args:
        predictions: (n_designs,) each column, (n_designs, n_members) what members predict [m].
    """
    diverged = somewhere(predictions)
    if not diverged.any():
        return None
    return f"{diverged.sum()} of {len(diverged)} designs diverged, in True Slush or under a member"


def somewhere(predictions: Columns) -> Bools:
    """Tell which assessed designs diverged, in True Slush or under any member: (n_designs,)."""
    finite: Bools = np.isfinite(predictions["true"]) & np.isfinite(predictions["predicted"]).all(axis=1)
    return ~finite


def _in_generations(curve: Columns, designs: str) -> str | None:
    """Count what diverged of all designs of a curve, and say when it began."""
    n_diverged = int(curve["n_diverged"].sum())
    if n_diverged == 0:
        return None
    n_designs = sum(int((curve[drawn_column(name)] - curve[rejected_column(name)]).sum()) for name in OPERATORS)
    first = curve["generation"][np.flatnonzero(curve["n_diverged"])[0]]
    verb, when = ("was", "in") if n_diverged == 1 else ("were", "the first in")
    return f"{n_diverged} of {n_designs:,} {designs} diverged and {verb} set aside; {when} generation {first}"
