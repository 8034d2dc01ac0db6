"""Where an ensemble hallucinates: what its members disagree about, and which designs live off it.

Members saw the same throws. Where throws were dense they agree, and what they say is true; where they disagree, most of
them are wrong, and evolution goes where a wrong one pushes. None of this needs the true medium. What it cannot show is
an error that all members share: for that see :mod:`tasks.analysis.novelty`, and where the truth is known
:mod:`tasks.analysis.member_error`.

Entry i of a trace is the state after step i, so what is shown there is what is said of step i + 1.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import Literal

import numpy as np

from tasks.arrays import Float32, Float64, Floats
from tasks.design import Designs, kinematic_trees
from tasks.residual import STATE
from tasks.world import EnsembleMedium, LinkStates, Medium, Physics


def link_states(designs: Designs, trace: Floats, physics: Physics) -> LinkStates:
    """Read a trace as the states of links, as a medium wants them.

    Args:
        designs: n_designs designs.
        trace: (..., n_designs, n_steps, n_links, 6) in the order of STATE, such as :class:`Rollouts` keeps.
        physics: the base simulator's constants.

    Returns:
        Arrays of shape (..., n_designs, n_steps, n_links), float32 as the trace is.
    """
    n_designs, n_links = designs.length_scale.shape
    if trace.ndim < 4 or (trace.shape[-4], *trace.shape[-2:]) != (n_designs, n_links, len(STATE)):
        expected = f"(..., {n_designs} designs, n_steps, {n_links} links, {len(STATE)})"
        raise ValueError(f"trace has shape {trace.shape}, expected {expected}")
    trees = kinematic_trees(designs, density=physics.link_density)
    shape = trace.shape[:-1]
    length_scale, mass, inertia = (
        np.broadcast_to(array.astype(trace.dtype)[:, None], shape)
        for array in (designs.length_scale, trees.mass, trees.inertia)
    )
    _, y, angle, vx, vy, omega = np.moveaxis(trace, -1, 0)
    return LinkStates(length_scale, mass, inertia, y, np.cos(angle), np.sin(angle), vx, vy, omega)


def acceleration(medium: Medium, links: LinkStates, physics: Physics) -> Float64:
    """Say what a medium does to links: (..., 3) mean acceleration over a step, of x, y [m/s²] and angle [rad/s²]."""
    change = medium.velocity_change(links, physics)
    return np.stack((change.vx, change.vy, change.omega), axis=-1).astype(np.float64) / physics.time_step


def member_accelerations(ensemble: EnsembleMedium, links: LinkStates, physics: Physics) -> Float64:
    """Ask every member about the same links.

    Args:
        ensemble: n_members members.
        links: arrays of any one shape.
        physics: the base simulator's constants.

    Returns:
        (n_members, *shape, 3) as :func:`acceleration`.
    """
    repeated = LinkStates(
        *(
            np.broadcast_to(array, (ensemble.n_members, *array.shape))
            for array in (getattr(links, field.name) for field in fields(LinkStates))
        )
    )
    return acceleration(ensemble, repeated, physics)


def size(accelerations: Floats, links: LinkStates) -> Float64:
    """Take the root mean square over a link's points of (..., 3) accelerations [m/s²].

    A point r from the centre has a + α × r, whose mean square over the link is |a|² + α² I / m: translation and
    rotation in one unit, weighted as kinetic energy weights them.
    """
    ax, ay, alpha = np.moveaxis(np.asarray(accelerations, dtype=np.float64), -1, 0)
    return np.asarray(np.sqrt(ax * ax + ay * ay + alpha * alpha * (links.inertia / links.mass)), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Disagreement:
    """What the members say of the states that designs pass through; NaN from where a rollout diverged.

    With a single member there is nobody to disagree: all is NaN, and the reason says so.
    """

    deviation: Float32
    """(n_designs, n_steps, n_links, 3) standard deviation over members of each acceleration [m/s², m/s², rad/s²]."""
    magnitude: Float32
    """(n_designs, n_steps, n_links) the same as one number, by :func:`size` [m/s²]."""
    departure: Float32
    """(n_members, n_designs, n_steps, n_links) how far a member is from the members' median, by :func:`size` [m/s²]. Of
    three or more members, one that is wrong alone departs alone; of two, both depart alike."""
    thrust: Float32
    """(n_members, n_designs, n_steps, n_links) the part of it along x, signed: positive pushes ahead [m/s²]."""
    reason: str | None

    def by_design(self) -> Float64:
        """Take the mean magnitude over a rollout: (n_designs,) [m/s²]; NaN where there is no finite state."""
        return _mean_of_finite(self.magnitude)

    def member_thrust(self) -> Float64:
        """Take each member's mean departure along x over a rollout: (n_members, n_designs) [m/s²]."""
        return _mean_of_finite(self.thrust)


def _mean_of_finite(values: Float32) -> Float64:
    """Mean over the last two axes, steps and links."""
    known = np.isfinite(values)
    n = known.sum(axis=(-2, -1))
    total = np.where(known, values, 0.0).sum(axis=(-2, -1), dtype=np.float64)
    return np.where(n > 0, total / np.maximum(n, 1), np.nan)


def disagreement(designs: Designs, trace: Floats, ensemble: EnsembleMedium, physics: Physics) -> Disagreement:
    """Map what members disagree about along rollouts, whichever world these were made in.

    Args:
        designs: n_designs designs.
        trace: (n_designs, n_steps, n_links, 6) of True Slush or of one member's world.
        ensemble: n_members members.
        physics: the base simulator's constants.
    """
    if trace.ndim != 4:
        raise ValueError(f"trace has shape {trace.shape}, expected (n_designs, n_steps, n_links, 6), of one world")
    shape = trace.shape[:-1]
    n_members = ensemble.n_members
    deviation = np.full((*shape, 3), np.nan, np.float32)
    magnitude = np.full(shape, np.nan, np.float32)
    departure, thrust = np.full((2, n_members, *shape), np.nan, np.float32)
    if n_members == 1:
        alone = "a single member has nobody to disagree with"
        return Disagreement(deviation, magnitude, departure, thrust, alone)
    for i in range(len(designs)):  # one at a time: a rollout of eight members is 10 MB
        links = link_states(designs[i], trace[i : i + 1], physics)
        said = member_accelerations(ensemble, links, physics)
        deviation[i] = said.std(axis=0)[0]
        magnitude[i] = size(deviation[i : i + 1], links)[0]
        departures = said - np.median(said, axis=0)
        departure[:, i] = size(departures, links)[:, 0]
        thrust[:, i] = departures[:, 0, ..., 0]
    return Disagreement(deviation, magnitude, departure, thrust, None)


@dataclass(frozen=True)
class Exploiter:
    """A design of the ranking."""

    rank: int
    """From 1; designs that are tied share the best of their ranks."""
    design: int
    """Its index."""
    predicted: float | None
    """[m]; None where diverged."""
    true: float | None
    """In True Slush [m]; None where unknown or diverged."""
    excess: float | None
    """predicted - true: what was imagined [m]."""
    disagreement: float | None
    """Of the members about it [m, or the unit in which it was given]; None where unknown."""
    ranked_by: Literal["excess", "disagreement", "nothing"]
    reason: str | None
    """Why the excess, or all, is missing."""


def rank_exploiters(
    predicted: Floats, *, true: Floats | None = None, disagreement: Floats | None = None
) -> tuple[Exploiter, ...]:
    """Rank designs by how much of what they are predicted to do is imagined, the worst first.

    Where the truth is known, by predicted less true; equals by disagreement. A user without True Slush ranks by what
    the members disagree about. Designs with no truth come after those with it, and those that can't be ranked last.

    Args:
        predicted: (n_designs,) displacement where they evolved [m].
        true: (n_designs,) displacement in True Slush [m].
        disagreement: (n_designs,) such as σ over members of the displacement, or :meth:`Disagreement.by_design`.
    """
    n = len(predicted)
    columns = [_known(column, n) for column in (predicted, true, disagreement)]
    keys, entries = [], []
    for design, (said, truth, doubt) in enumerate(zip(*columns, strict=True)):
        excess = said - truth if said is not None and truth is not None else None
        ranked_by: Literal["excess", "disagreement", "nothing"] = "nothing"
        reason = None
        if excess is not None:
            ranked_by = "excess"
        else:
            reason = "diverged in True Slush" if true is not None else "True Slush is not known"
            if said is None:
                reason = "diverged where it evolved"
            if doubt is not None:
                ranked_by = "disagreement"
        kind = ("excess", "disagreement", "nothing").index(ranked_by)
        keys.append((kind, -(excess or 0.0), -(doubt or 0.0)))
        entries.append((design, said, truth, excess, doubt, ranked_by, reason))
    order = sorted(range(n), key=lambda i: (keys[i], i))
    ranked: list[Exploiter] = []
    for place, i in enumerate(order):
        tied = place > 0 and keys[i] == keys[order[place - 1]]
        ranked.append(Exploiter(ranked[-1].rank if tied else place + 1, *entries[i]))
    return tuple(ranked)


def _known(column: Floats | None, n: int) -> Iterator[float | None]:
    """Numbers that are finite, None for the others."""
    values = np.full(n, np.nan) if column is None else np.asarray(column, dtype=np.float64)
    if values.shape != (n,):
        raise ValueError(f"a column has shape {values.shape}, expected ({n} designs,)")
    return (float(value) if np.isfinite(value) else None for value in values)
