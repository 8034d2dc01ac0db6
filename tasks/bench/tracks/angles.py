"""Angles that are known up to half a turn or less, as programs for pictures give them.

An ellipse or the moments of a shape are the same after half a turn, a rectangle of least area after a quarter turn, and
a tilt has no sign. While a bar turns evenly, such angles jump, or turn back.
"""

import numpy as np

from tasks.arrays import Bools, Float64

_LIKE = 0.3  # by which a turn between two frames may differ from those around it [rad]
_EVEN = 1.5  # factor by which an interval may exceed those around it
_LEAST_TURN = 0.03  # between two frames, that shows where angles turn back [rad]
_NOISE = 0.02  # by which angles may differ for their noise [rad]


def jumps(time: Float64, angle: Float64, seen: Bools, by: float) -> Bools:
    """Return at which of the (n_throws, n_frames) frames angles jump by so much, between even turns."""
    at, interval, turn = np.zeros(seen.shape, dtype=bool), np.diff(time, axis=1), np.diff(angle, axis=1)
    before, after = turn[:, :-2], turn[:, 2:]
    even = seen[:, 3:] & (interval[:, 1:-1] < _EVEN * np.minimum(interval[:, :-2], interval[:, 2:]))
    size = np.abs(turn[:, 1:-1] - (before + after) / 2)
    at[:, 2:-1] = even & (np.abs(before - after) < _LIKE) & (np.abs(size - by) < _LIKE)
    return at


def folds(angle: Float64, seen: Bools) -> Bools:
    """Return at which frames angles turn back as fast as they came, at a quarter turn's multiple that none exceeds."""
    at = np.zeros(seen.shape, dtype=bool)
    for outward in (angle, -angle):
        edge = np.ceil((outward[seen].max() - _NOISE) / (np.pi / 2)) * np.pi / 2
        turn, short = np.diff(outward, axis=1), edge - outward
        into, out = turn[:, :-2], -turn[:, 2:]
        beyond = short[:, 1:-2] + short[:, 2:-1]  # the turn between these frames, had it gone on
        like = np.maximum(np.minimum(into, out) / 3, _NOISE)
        alike = (np.abs(into - out) < like) & (np.abs(beyond - (into + out) / 2) < like)
        at[:, 2:-1] |= seen[:, 3:] & alike & (np.minimum(into, out) > _LEAST_TURN)
    return at
