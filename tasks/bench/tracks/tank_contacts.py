"""Bars that touch the walls or the floor of a tank, which networks of the medium must not learn.

A bar that hits a wall bounces or stops, and one on the floor may rest. Rows around are left out.
"""

from __future__ import annotations

import numpy as np

from tasks.arrays import Bools, Float64
from tasks.bench.tracks.table import SLOWEST_CONTACT, Paths

_SD_OF_CONTACT = 6.0  # of the difference of two positions, that both speeds exceed
_AT_THE_EDGE = 0.1  # from where bars get farthest out or deepest, at which one may touch a wall or the floor [m]
_STOPPED = 0.2  # share of its speed that a bar keeps at most, where it stops
_LEAST_STOPS = 3  # bars that stop at a wall; one alone may have been stopped by drag
_MOST_STOPS_ELSEWHERE = 0.1  # share of the fast bars elsewhere that drag stops as soon
_REST_TIME, _REST_WAY = 1.0, 0.02  # a bar rests that moves by less in this time [s], [m]; buoyancy lifts it by more


def contacts(paths: Paths, long_axes: Float64, position_sd: tuple[float, float]) -> Bools:
    """Find the (n_throws, n_frames) frames where bars bounce off a wall or the floor, stop at a wall, or rest.

    ``long_axes`` are those of the (n_throws,) bars, ``position_sd`` the deviations of measurements of x and y; all [m].
    """
    (x, y, _), (x_sd, y_sd) = np.moveaxis(paths.pose, -1, 0), position_sd
    reach_x, reach_y = _reach(paths, long_axes)
    at = _bounces(paths, -y, y_sd) | _rests(paths, reach_y, max(position_sd))
    for outward in (-x, x):
        at |= _bounces(paths, outward, x_sd) | _stops(paths, outward, reach_x, x_sd)
    return at


def n_contacts(at: Bools) -> int:
    """Return the number of contacts in (n_throws, n_frames) frames, each of which may last for several."""
    return int(np.count_nonzero(at[:, 1:] & ~at[:, :-1]) + np.count_nonzero(at[:, 0]))


def _reach(paths: Paths, long_axes: Float64) -> tuple[Float64, Float64]:
    """Return how far each bar reaches from its centre along x and y; each (n_throws, n_frames) [m]."""
    sin, cos = np.abs(np.sin(paths.pose[..., 2])), np.abs(np.cos(paths.pose[..., 2]))
    length = long_axes[:, None]
    return (length * sin + cos / length) / 2, (length * cos + sin / length) / 2


def _velocity(paths: Paths, position: Float64, sd: float) -> tuple[Float64, Float64]:
    """Return the velocity in each interval between frames, and the least speed that counts as fast there [m/s]."""
    interval = np.where(paths.seen[:, 1:], np.diff(paths.time, axis=1), np.inf)
    least = np.maximum(SLOWEST_CONTACT, _SD_OF_CONTACT * np.sqrt(2) * sd / interval)
    return np.diff(position, axis=1) / interval, least


def _bounces(paths: Paths, outward: Float64, sd: float) -> Bools:
    """Return the frames at which bars turn back at once, given their positions outward [m].

    Drag never reverses a velocity, and buoyancy does so slowly.
    """
    velocity, least = _velocity(paths, outward, sd)
    at = np.zeros(paths.time.shape, dtype=bool)
    at[:, 1:-1] = (velocity > least)[:, :-1] & (velocity < -least)[:, 1:]
    return at


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
