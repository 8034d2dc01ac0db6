"""Winner's luck, and reach: two ways in which a champion's fitness is not worth what it says.

The best of tens of thousands of designs is also the luckiest where fitness is chaotic, as on hard ground: a design
moved by less than any builder could keep goes a different way. And fitness is the displacement of the root link between
two instants, which a coiled chain can gain by uncoiling, without the robot going anywhere.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from numpy.random import Generator

from tasks.analysis.uncertainty import Estimate, mean
from tasks.arrays import Float64, Floats
from tasks.design import Designs, concatenate

JITTER = 1e-4
"""How far each attachment is moved [half heights]: at 70 mm a metre, at most 0.01 mm."""
ATTACHMENTS = ("parent_attachment", "child_attachment")


@dataclass(frozen=True, eq=False)
class Luck:
    """What designs are worth when tried again; diverged tries are left out and counted."""

    claimed: Float64
    """(n_designs,) score as evolved [m]; not finite where diverged."""
    again: Float64
    """(n_designs, n_tries) score with moved attachments [m]; not finite where diverged."""
    n_diverged: npt.NDArray[np.int64]
    """(n_designs,) tries that diverged."""
    loss: tuple[Estimate, ...]
    """Of each design: claimed less the mean when tried again [m]; positive is luck that a copy does not have."""
    share_below: Float64
    """(n_designs,) share of the tries that scored less than claimed; NaN where the loss has no value either."""


def jittered(designs: Designs, rng: Generator, *, jitter: float = JITTER) -> Designs:
    """Move every attachment by the jitter up or down, at a gene's bound inward; all else stays as it is."""
    moved = {}
    for name in ATTACHMENTS:
        attachment = getattr(designs, name)
        step = np.where(rng.random(attachment.shape) < 0.5, -jitter, jitter)
        step = np.where(np.abs(attachment + step) > 1, -step, step)
        moved[name] = np.concatenate((attachment[:, :1], (attachment + step)[:, 1:]), axis=1)  # a root has none
    return replace(designs, **moved)


def luck(
    designs: Designs, score: Callable[[Designs], Floats], *, rng: Generator, n_tries: int = 32, jitter: float = JITTER
) -> Luck:
    """Try designs again with their attachments moved by next to nothing.

    Args:
        designs: n_designs champions.
        score: simulates n designs where they evolved, all at once: (n,) their fitness [m], not finite where diverged.
        rng: source of randomness.
        n_tries: times that each is tried again.
        jitter: how far an attachment moves [half heights].
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
    """Displacement of the root that is not displacement of the robot."""

    displacement: Float64
    """(n_designs,) of the root [m]."""
    com_displacement: Float64
    """(n_designs,) of the whole robot's centre of mass [m]."""
    reach: Float64
    """(n_designs,) the difference: gained by stretching out towards +x [m]; NaN where diverged."""


def reach(displacement: Floats, com_displacement: Floats) -> Reach:
    """Compare the two measures of (n_designs,) rollouts [m]."""
    root, whole = (np.asarray(moved, dtype=np.float64) for moved in (displacement, com_displacement))
    return Reach(root, whole, root - whole)
