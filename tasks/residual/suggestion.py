"""Which throws to make next: starts that fill the holes in what an ensemble learned from.

The first half of them covers the range of robots' states evenly. The other half fills holes: states that pilot robots
pass through, far from every throw, and where members disagree. States beyond the range of robots are left out, because
an ensemble that is wrong may throw its pilots there. Throws at the states of robots alone would make things worse:
members then agree where all are wrong.
"""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from tasks.arrays import Bools, Float32, Float64
from tasks.residual.observation import OBSERVATION
from tasks.residual.robot_ranges import RobotRanges, robot_ranges
from tasks.residual.support import deviations, distances
from tasks.residual.throws import Starts, even_starts
from tasks.world import Physics

if TYPE_CHECKING:
    from tasks.residual.ensemble import Ensemble

_A, _Y, _COS, _VX, _VY, _OMEGA = range(len(OBSERVATION))
_SHARE_OF_HOLES = 0.5
_NEARLY = 1.1  # bars may be shorter and longer than robots' links by this factor


@dataclass(frozen=True)
class ThrowLimits:
    """What a hand or a small launcher can throw, in the simulation's units."""

    max_velocity: float = np.inf  # [m/s]
    max_omega: float = np.inf  # [rad/s]
    heights: tuple[float, float] = (-np.inf, np.inf)  # of the bar's centre over the surface [m]
    lengths: tuple[float, ...] = ()  # long axes of the bars [m]; none for any length


def suggest_throws(
    n: int,
    pilots: Float32,
    thrown: Float32,
    ensemble: "Ensemble",
    rng: np.random.Generator,
    *,
    physics: Physics | None = None,
    limits: ThrowLimits | None = None,
) -> Starts:
    """Return the starts of n throws, those that cover the range first: who makes fewer leaves out holes.

    Args:
        n: number of throws.
        pilots: (n_states, 6) observations of the links of pilot robots.
        thrown: (n_transitions, 6) observations of the throws that the ensemble learned from.
        ensemble: networks that observe no more than the paper's six components and their magnitudes.
        rng: source of randomness.
        physics: constants of the base simulator; the paper's by default.
        limits: what can be thrown; by default anything within the range of robots.

    Returns:
        Starts, numbered from 0.

    Raises:
        ValueError: n is less than 1, there are no throws, robots' links are at none of the heights, or no bar is as
            long as a robot's link.
    """
    if n < 1:
        raise ValueError(f"n is {n}, expected at least 1 throw")
    physics = physics or Physics()
    limits = limits or ThrowLimits()
    ranges = robot_ranges(physics)
    _check_bars(ranges, limits)
    least = (limits.max_velocity, limits.max_omega)
    narrow = replace(ranges, max_velocity=min(ranges.max_velocity, least[0]), max_omega=min(ranges.max_omega, least[1]))
    pilots = pilots[_within_range(pilots, narrow) & _possible(pilots, limits)]
    n_holes = min(round(_SHARE_OF_HOLES * n), len(pilots))
    chosen = pilots[_holes(n_holes, pilots, thrown, ensemble)]
    angle = np.arccos(np.clip(chosen[:, _COS], -1, 1)) * rng.choice((-1, 1), n_holes)  # cos θ leaves its sign open
    columns = (np.zeros(n_holes), chosen[:, _Y], angle % (2 * np.pi), *chosen[:, [_VX, _VY, _OMEGA]].T)
    even = even_starts(n - n_holes, physics, rng, ranges=narrow, heights=_heights(ranges, limits))
    length = np.concatenate([even.length_scale, chosen[:, _A].astype(np.float64)])
    state = np.concatenate([even.state, np.stack(columns, axis=1).astype(np.float32)])
    return Starts(np.arange(n), *_throwable(length, state, limits))


def _heights(ranges: RobotRanges, limits: ThrowLimits) -> tuple[float, float]:
    """Return the heights that can be thrown from among those of robots' links [m]."""
    low, high = max(limits.heights[0], -ranges.y_reach), min(limits.heights[1], ranges.y_reach)
    if low >= high:
        raise ValueError(
            f"heights are {limits.heights[0]:g} to {limits.heights[1]:g} m, expected some within {ranges.y_reach:g} m "
            f"of the surface, where robots' links are"
        )
    return low, high


def _check_bars(ranges: RobotRanges, limits: ThrowLimits) -> None:
    shortest, longest = ranges.length_scale
    if limits.lengths and not any(shortest / _NEARLY <= length <= longest * _NEARLY for length in limits.lengths):
        bars = " and ".join(f"{length:g}" for length in sorted(limits.lengths))
        raise ValueError(f"bars are {bars} m long, expected one of {shortest:g} to {longest:g} m, as robots' links are")


def _possible(pilots: Float32, limits: ThrowLimits) -> Bools:
    low, high = limits.heights
    slow = np.hypot(pilots[:, _VX], pilots[:, _VY]) <= limits.max_velocity
    return np.asarray(slow & (pilots[:, _Y] >= low) & (pilots[:, _Y] <= high))


def _throwable(length: Float64, state: Float32, limits: ThrowLimits) -> tuple[Float64, Float32]:
    """Bring starts within limits: slower in the same direction, and with the nearest bar."""
    state = state.copy()
    speed = np.hypot(state[:, 3], state[:, 4])
    state[:, 3:5] *= np.minimum(1, limits.max_velocity / np.maximum(speed, 1e-9))[:, None].astype(np.float32)
    if limits.lengths:
        bars = np.array(limits.lengths)
        length = bars[np.abs(bars[:, None] - length).argmin(axis=0)]
    return length, state


def _within_range(pilots: Float32, ranges: RobotRanges) -> Bools:
    limits = (np.inf, ranges.y_reach, np.inf, ranges.max_velocity, ranges.max_velocity, ranges.max_omega)
    return np.asarray((np.abs(pilots) <= limits).all(axis=1))


def _holes(n: int, pilots: Float32, thrown: Float32, ensemble: "Ensemble") -> list[int]:
    """Select n states of pilots one after another, each far from the throws and from those selected before."""
    if n == 0:
        return []
    scale = deviations(pilots)
    points = pilots / scale
    distance = distances(pilots, thrown, scale).distance
    doubt = _disagreement(pilots, ensemble)
    chosen: list[int] = []
    for _ in range(n):
        best = int(np.argmax(distance * doubt))
        chosen.append(best)
        distance = np.minimum(distance, np.linalg.norm(points - points[best], axis=1))
    return chosen


def _disagreement(pilots: Float32, ensemble: "Ensemble") -> Float64:
    """Return the deviation of the members' predictions over the deviation of the changes that they predict."""
    predicted = ensemble.predict(ensemble.observed(pilots)).astype(np.float64)
    spread = np.maximum(predicted.mean(axis=0).std(axis=0), 1e-12)
    return np.asarray(np.linalg.norm(predicted.std(axis=0) / spread, axis=1))
