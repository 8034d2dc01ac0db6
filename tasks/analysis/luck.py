"""Winner's luck and reach: two ways in which a champion's fitness overstates its worth.

Where fitness is chaotic, as on hard ground, the best of tens of thousands of designs is also the luckiest: a change far
below any manufacturing tolerance alters its path. And fitness is the displacement of the root link between two
instants, which a coiled chain can gain by uncoiling while the robot as a whole stays in place.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator

from tasks.analysis.uncertainty import Estimate, finite, mean
from tasks.arrays import Floats
from tasks.design import Designs, concatenate

_JITTER = 1e-4  # change of each attachment [half heights]: at most 0.01 mm if a metre is built as 70 mm


@dataclass(frozen=True)
class Luck:
    """Scores of a champion and of its copies with jittered attachments; copies that diverge are only counted."""

    claimed: float | None  # fitness where it evolved [m]
    again: float | None  # mean fitness of its copies [m]; None or NaN if all diverged
    loss: Estimate  # ``claimed`` minus ``again`` [m]: positive if copies do worse than the champion
    share_below: float | None  # share of copies with a lower fitness; None or NaN where the loss has no value
    n_diverged: int
    n_tries: int


def jittered(designs: Designs, rng: Generator) -> Designs:
    """Return designs with every attachment moved up or down, or inwards at a gene's bound."""
    moved = {}
    for name in ("parent_attachment", "child_attachment"):
        attachment = getattr(designs, name)
        step = np.where(rng.random(attachment.shape) < 0.5, -_JITTER, _JITTER)
        step = np.where(np.abs(attachment + step) > 1, -step, step)
        moved[name] = np.concatenate((attachment[:, :1], (attachment + step)[:, 1:]), axis=1)  # a root has none
    return replace(designs, **moved)


def luck(champion: Designs, score: Callable[[Designs], Floats], *, rng: Generator, n_tries: int) -> Luck:
    """Return how much of a champion's score copies with jittered attachments lose.

    Args:
        champion: a single design.
        score: simulates n designs where it evolved: (n,) fitness [m], not finite where diverged.
        rng: source of randomness.
        n_tries: number of copies.
    """
    tries = [jittered(champion, rng) for _ in range(n_tries)]
    claimed, *again = np.asarray(score(concatenate([champion, *tries])), dtype=np.float64)
    known = finite(np.array(again))
    loss, share_below = Estimate.missing("the design itself diverges"), np.nan
    if np.isfinite(claimed) and not len(known):
        loss = Estimate.missing(f"all of {n_tries} tries diverged")
    elif np.isfinite(claimed):
        loss, share_below = mean(claimed - known), float(np.mean(known < claimed))
    return Luck(
        claimed=float(claimed),
        again=float(known.mean()) if len(known) else np.nan,
        loss=loss,
        share_below=share_below,
        n_diverged=n_tries - len(known),
        n_tries=n_tries,
    )
