"""Winner's luck and reach: two ways in which a champion's fitness overstates its worth.

Where fitness is chaotic, as on hard ground, the best of tens of thousands of designs is also the luckiest: a change far
below any manufacturing tolerance alters its path. And fitness is the displacement of the root link between two
instants, which a coiled chain can gain by uncoiling while the robot as a whole stays in place.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator

from tasks.analysis.uncertainty import Estimate, mean
from tasks.arrays import Float64, Floats, Int64
from tasks.design import Designs, concatenate

_JITTER = 1e-4  # change of each attachment [half heights]: at most 0.01 mm if a metre is built as 70 mm


@dataclass(frozen=True, eq=False)
class Luck:
    """Scores of designs in repeated tries with jittered attachments; diverged tries are left out and counted."""

    claimed: Float64  # (n_designs,) score as evolved [m]; not finite where diverged
    again: Float64  # (n_designs, n_tries) score with jittered attachments [m]; not finite where diverged
    n_diverged: Int64  # (n_designs,) tries that diverged
    loss: tuple[Estimate, ...]
    """For each design, claimed - mean of the tries [m]; positive if copies do worse than the champion."""
    share_below: Float64  # (n_designs,) share of the tries that scored below the claim; NaN where the loss has no value


def jittered(designs: Designs, rng: Generator, *, jitter: float = _JITTER) -> Designs:
    """Return designs with every attachment moved up or down, or inwards at a gene's bound.

    Args:
        designs: n_designs designs.
        rng: source of randomness.
        jitter: change of each attachment [half heights].
    """
    moved = {}
    for name in ("parent_attachment", "child_attachment"):
        attachment = getattr(designs, name)
        step = np.where(rng.random(attachment.shape) < 0.5, -jitter, jitter)
        step = np.where(np.abs(attachment + step) > 1, -step, step)
        moved[name] = np.concatenate((attachment[:, :1], (attachment + step)[:, 1:]), axis=1)  # a root has none
    return replace(designs, **moved)


def luck(
    designs: Designs, score: Callable[[Designs], Floats], *, rng: Generator, n_tries: int = 32, jitter: float = _JITTER
) -> Luck:
    """Return the scores of designs in repeated tries with jittered attachments.

    Args:
        designs: n_designs champions.
        score: simulates n designs where they evolved: (n,) fitness [m], not finite where diverged.
        rng: source of randomness.
        n_tries: number of tries for each design.
        jitter: change of each attachment [half heights].
    """
    n = len(designs)
    tries = [jittered(designs, rng, jitter=jitter) for _ in range(n_tries)]
    scored = np.asarray(score(concatenate([designs, *tries])), dtype=np.float64).reshape(1 + n_tries, n)
    claimed, again = scored[0], scored[1:].T
    known = np.isfinite(again)
    losses, share_below = [], np.full(n, np.nan)
    for i in range(n):
        if not np.isfinite(claimed[i]):
            losses.append(Estimate.missing("the design itself diverges"))
        elif not known[i].any():
            losses.append(Estimate.missing(f"all of {n_tries} tries diverged"))
        else:
            losses.append(mean(claimed[i] - again[i]))
            share_below[i] = np.mean(again[i, known[i]] < claimed[i])
    return Luck(claimed, again, n_tries - known.sum(axis=1), tuple(losses), share_below)


@dataclass(frozen=True, eq=False)
class Reach:
    """Displacement of the root without displacement of the robot."""

    displacement: Float64  # (n_designs,) displacement of the root [m]
    com_displacement: Float64  # (n_designs,) displacement of the whole robot's centre of mass [m]
    reach: Float64  # (n_designs,) difference, gained by stretching towards +x [m]; NaN where diverged


def reach(displacement: Floats, com_displacement: Floats) -> Reach:
    """Return the difference of the two (n_designs,) displacements of rollouts [m]."""
    root, whole = (np.asarray(moved, dtype=np.float64) for moved in (displacement, com_displacement))
    return Reach(root, whole, root - whole)
