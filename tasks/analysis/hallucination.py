"""Hallucinated dynamics: where the members of an ensemble disagree, and which designs exploit it.

All members learned from the same throws. Where throws were dense they agree and are right; where they disagree, most of
them are wrong, and evolution exploits a wrong one. None of this needs the true medium. Disagreement does not show an
error that all members share: see :mod:`tasks.analysis.novelty` and, where the truth is known,
:mod:`tasks.analysis.member_error`.

Entry i of a trace is the state after step i, so predictions from it belong to step i + 1.
"""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from tasks.arrays import Float32, Float64, Floats
from tasks.design import Designs, kinematic_trees
from tasks.residual import STATE
from tasks.world import EnsembleMedium, LinkStates, Medium, Physics


def link_states(designs: Designs, trace: Floats, physics: Physics) -> LinkStates:
    """Return a trace as the link states that a medium reads: (..., n_designs, n_steps, n_links), float32 like it.

    Args:
        designs: n_designs designs.
        trace: (..., n_designs, n_steps, n_links, 6) in the order of STATE, as in :class:`Rollouts`.
        physics: the base simulator's constants.

    Raises:
        ValueError: the trace has another shape.
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
    """Return a medium's mean accelerations over a step: (..., 3) of x, y [m/s²] and angle [rad/s²].

    Args:
        medium: the medium.
        links: link states of shape (...).
        physics: the base simulator's constants.
    """
    change = medium.velocity_change(links, physics)
    return np.stack((change.vx, change.vy, change.omega), axis=-1).astype(np.float64) / physics.time_step


def member_accelerations(ensemble: EnsembleMedium, links: LinkStates, physics: Physics) -> Float64:
    """Return what every member predicts for the same links: (n_members, ..., 3) accelerations [m/s², m/s², rad/s²].

    Args:
        ensemble: n_members members.
        links: link states of shape (...).
        physics: the base simulator's constants.
    """
    repeated = (np.broadcast_to(array, (ensemble.n_members, *array.shape)) for array in vars(links).values())
    return acceleration(ensemble, LinkStates(*repeated), physics)


def size(accelerations: Floats, links: LinkStates) -> Float64:
    """Return the root mean square of (..., 3) accelerations over a link's points: (...) [m/s²].

    A point r from the centre accelerates with a + α × r, whose mean square over the link is |a|² + α² I / m. So
    translation and rotation have one unit and are weighted as in kinetic energy.
    """
    ax, ay, alpha = np.moveaxis(np.asarray(accelerations, dtype=np.float64), -1, 0)
    return np.asarray(np.sqrt(ax * ax + ay * ay + alpha * alpha * (links.inertia / links.mass)), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Disagreement:
    """Disagreement of the members along rollouts; NaN once a rollout has diverged, and throughout with one member."""

    magnitude: Float32  # (n_designs, n_steps, n_links) deviation over members, by :func:`size` [m/s²]
    departure: Float32
    """(n_members, n_designs, n_steps, n_links) a member's distance from the members' median, by :func:`size` [m/s²]. Of
    three or more members, one that alone is wrong departs alone; two always depart alike."""
    thrust: Float32  # (n_members, n_designs, n_steps, n_links) the departure along x [m/s²]; positive pushes forwards
    reason: str | None  # why all is NaN, if so

    def by_design(self) -> Float64:
        """Return the mean magnitude over each rollout: (n_designs,) [m/s²]; NaN where no state is finite."""
        return _mean_of_finite(self.magnitude)

    def member_thrust(self) -> Float64:
        """Return the mean thrust of each member over each rollout: (n_members, n_designs) [m/s²]."""
        return _mean_of_finite(self.thrust)


def _mean_of_finite(values: Float32) -> Float64:
    """Average over the last two axes, steps and links."""
    known = np.isfinite(values)
    n = known.sum(axis=(-2, -1))
    total = np.where(known, values, 0.0).sum(axis=(-2, -1), dtype=np.float64)
    return np.where(n > 0, total / np.maximum(n, 1), np.nan)


def disagreement(designs: Designs, trace: Floats, ensemble: EnsembleMedium, physics: Physics) -> Disagreement:
    """Return how the members disagree along rollouts, in whichever environment these were made.

    Args:
        designs: n_designs designs.
        trace: (n_designs, n_steps, n_links, 6) states in True Slush or with one member.
        ensemble: n_members members.
        physics: the base simulator's constants.

    Raises:
        ValueError: the trace has another shape.
    """
    if trace.ndim != 4:
        raise ValueError(f"trace has shape {trace.shape}, expected (n_designs, n_steps, n_links, 6)")
    if ensemble.n_members == 1:
        unknown = np.full((1, *trace.shape[:-1]), np.nan, np.float32)
        return Disagreement(unknown[0], unknown, unknown, "a single member can't disagree")
    links = link_states(designs, trace, physics)
    predicted = member_accelerations(ensemble, links, physics)
    departures = predicted - np.median(predicted, axis=0)
    return Disagreement(
        magnitude=size(predicted.std(axis=0).astype(np.float32), links).astype(np.float32),
        departure=size(departures, links).astype(np.float32),
        thrust=departures[..., 0].astype(np.float32),
        reason=None,
    )


_RankedBy = Literal["excess", "disagreement", "nothing"]  # best first


@dataclass(frozen=True)
class Exploiter:
    """A design in the ranking of exploiters."""

    rank: int  # rank from 1; tied designs share the best of their ranks
    design: int  # index of the design
    predicted: float | None  # displacement where it evolved [m]; None where diverged
    true: float | None  # displacement in True Slush [m]; None where unknown or diverged
    excess: float | None  # predicted - true: the hallucinated displacement [m]
    disagreement: float | None  # disagreement of the members, in the unit of the argument; None where unknown
    ranked_by: _RankedBy
    reason: str | None  # why the excess, or every figure, is missing


def rank_exploiters(predicted: Floats, true: Floats, disagreement: Floats) -> tuple[Exploiter, ...]:
    """Return the designs ranked by hallucinated displacement, the largest first.

    Designs with a known truth come first, ranked by predicted - true and, if equal, by disagreement. Designs without
    follow, ranked by disagreement. Designs that can't be ranked come last.

    Args:
        predicted: (n_designs,) displacement where the designs evolved [m].
        true: (n_designs,) displacement in True Slush [m].
        disagreement: (n_designs,) such as σ of the displacement over members, or :meth:`Disagreement.by_design`.
    """
    columns = ([float(x) if np.isfinite(x) else None for x in column] for column in (predicted, true, disagreement))
    keys, entries = [], []
    for design, (prediction, truth, doubt) in enumerate(zip(*columns, strict=True)):
        excess = prediction - truth if prediction is not None and truth is not None else None
        ranked_by: _RankedBy = "nothing" if doubt is None else "disagreement"
        reason = None
        if excess is not None:
            ranked_by = "excess"
        else:
            reason = "diverged where it evolved" if prediction is None else "diverged in True Slush"
        keys.append((get_args(_RankedBy).index(ranked_by), -(excess or 0.0), -(doubt or 0.0)))
        entries.append((design, prediction, truth, excess, doubt, ranked_by, reason))
    ranked: list[Exploiter] = []
    order = sorted(range(len(keys)), key=keys.__getitem__)  # stable: tied designs keep their order
    for rank, i in enumerate(order, start=1):
        tied = rank > 1 and keys[i] == keys[order[rank - 2]]
        ranked.append(Exploiter(ranked[-1].rank if tied else rank, *entries[i]))
    return tuple(ranked)
