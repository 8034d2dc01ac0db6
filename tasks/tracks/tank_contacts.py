"""Bars that touch the walls or the floor of a tank, which networks of the medium must not learn.

A bar that hits a wall bounces or stops, and one on the floor may rest. Rows around are left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tasks.arrays import Bools, Float64
from tasks.tracks.table import SLOWEST_CONTACT, Paths

_SD_OF_CONTACT = 6.0  # of the difference of two positions, that both speeds exceed
_FRAMES_AROUND = 2  # frames before and after a contact that are left out
_AT_THE_EDGE = 0.1  # from where bars get farthest out or deepest, at which one may touch a wall or the floor [m]
_STOPPED = 0.2  # share of its speed that a bar keeps at most, where it stops
_LEAST_STOPS = 3  # bars that stop at a wall; one alone may have been stopped by drag
_MOST_STOPS_ELSEWHERE = 0.1  # share of the fast bars elsewhere that drag stops as soon
_REST_TIME, _REST_WAY = 1.0, 0.02  # a bar rests that moves by less in this time [s], [m]; buoyancy lifts it by more


@dataclass(frozen=True, eq=False)
class Contacts:
    """Frames at which bars touch a wall or the floor; each (n_throws, n_frames)."""

    left: Bools
    right: Bools
    floor: Bools

    @property
    def any(self) -> Bools:
        """Frames at a contact."""
        return self.left | self.right | self.floor

    @property
    def around(self) -> Bools:
        """Frames at a contact and beside it."""
        at = self.any
        near = at.copy()
        for shift in range(1, _FRAMES_AROUND + 1):
            near[:, shift:] |= at[:, :-shift]
            near[:, :-shift] |= at[:, shift:]
        return near


def n_contacts(at: Bools) -> int:
    """Return the number of contacts in (n_throws, n_frames) frames, each of which may last for several."""
    return int(np.count_nonzero(at[:, 1:] & ~at[:, :-1]) + np.count_nonzero(at[:, 0]))


def contacts(paths: Paths, long_axes: Float64, position_sd: tuple[float, float]) -> Contacts:
    """Find the frames where bars bounce off a wall or the floor, stop at a wall, or rest on the floor.

    ``long_axes`` are those of the (n_throws,) bars, ``position_sd`` the deviations of measurements of x and y; all [m].
    """
    x_sd, y_sd = position_sd
    left, right = _bounces(paths, 0, x_sd)
    floor, _ = _bounces(paths, 1, y_sd)
    reach_x, reach_y = _reach(paths, long_axes)
    left |= _stops(paths, -paths.pose[..., 0], reach_x, x_sd)
    right |= _stops(paths, paths.pose[..., 0], reach_x, x_sd)
    return Contacts(left, right, floor | _rests(paths, reach_y, max(position_sd)))


def _reach(paths: Paths, long_axes: Float64) -> tuple[Float64, Float64]:
    """Return how far each bar reaches from its centre along x and y; each (n_throws, n_frames) [m]."""
    sin, cos = np.abs(np.sin(paths.pose[..., 2])), np.abs(np.cos(paths.pose[..., 2]))
    length = long_axes[:, None]
    return (length * sin + cos / length) / 2, (length * cos + sin / length) / 2


def slowest_contact(frame_interval: float, position_sd: tuple[float, float]) -> float:
    """Return the speed below which a bar may touch a wall or the floor unnoticed [m/s]."""
    return max(SLOWEST_CONTACT, _SD_OF_CONTACT * float(np.sqrt(2)) * max(position_sd) / frame_interval)


def _velocity(paths: Paths, position: Float64, sd: float) -> tuple[Float64, Float64]:
    """Return the velocity in each interval between frames, and the least speed that counts as fast there [m/s]."""
    interval = np.where(paths.seen[:, 1:], np.diff(paths.time, axis=1), np.inf)
    return np.diff(position, axis=1) / interval, np.maximum(
        SLOWEST_CONTACT, _SD_OF_CONTACT * np.sqrt(2) * sd / interval
    )


def _bounces(paths: Paths, axis: int, sd: float) -> tuple[Bools, Bools]:
    """Return the frames at which a coordinate turns upward, and downward, at once.

    Drag never reverses a velocity, and buoyancy does so slowly.
    """
    velocity, least = _velocity(paths, paths.pose[..., axis], sd)
    fast = np.abs(velocity) > least
    up, down = np.zeros((2, *paths.time.shape), dtype=bool)
    before, after, both = velocity[:, :-1], velocity[:, 1:], fast[:, :-1] & fast[:, 1:]
    up[:, 1:-1], down[:, 1:-1] = both & (before < 0) & (after > 0), both & (before > 0) & (after < 0)
    return up, down


def _stops(paths: Paths, outward: Float64, reach: Float64, sd: float) -> Bools:
    """Return the frames at which bars stop where no bar gets farther out, given their positions outward [m].

    Drag, too, may stop a fast bar within a few frames. At a wall several bars stop at one place, and of those that are
    as fast elsewhere hardly any does.
    """
    edge = outward + reach
    velocity, least = _velocity(paths, outward, sd)
    # The bar may touch the wall between two frames: the intervals before and after it are compared.
    fast = (velocity > least)[:, :-2] & paths.seen[:, 3:]
    stops = fast & (velocity[:, 2:] < _STOPPED * velocity[:, :-2])
    near = edge[:, 2:-1] > edge[paths.seen].max() - _AT_THE_EDGE - _SD_OF_CONTACT * sd
    at = np.zeros(paths.time.shape, dtype=bool)
    n_elsewhere, n_stops_elsewhere = np.count_nonzero(fast & ~near), np.count_nonzero(stops & ~near)
    if (stops & near).any(axis=1).sum() >= _LEAST_STOPS and n_stops_elsewhere <= _MOST_STOPS_ELSEWHERE * n_elsewhere:
        at[:, 2:-1] = stops & near
    return at


def _rests(paths: Paths, reach: Float64, sd: float) -> Bools:
    """Return the frames in which bars below the surface lie still where no bar gets deeper: on the floor."""
    n = max(round(_REST_TIME / float(np.median(np.diff(paths.time, axis=1)[paths.seen[:, 1:]]))), 2)  # intervals
    at = np.zeros(paths.time.shape, dtype=bool)
    if paths.time.shape[1] <= n:
        return at
    y, lower = paths.pose[..., 1], paths.pose[..., 1] - reach
    on_floor = (y + reach < 0) & (lower < lower[paths.seen].min() + _AT_THE_EDGE + _SD_OF_CONTACT * sd)
    ways = np.ptp(np.lib.stride_tricks.sliding_window_view(paths.pose[..., :2], n + 1, axis=1), axis=-1)
    still = on_floor[:, n:] & paths.seen[:, n:] & (ways < _REST_WAY + _SD_OF_CONTACT * sd).all(axis=-1)
    for shift in range(n + 1):
        at[:, shift : shift + still.shape[1]] |= still
    return at
