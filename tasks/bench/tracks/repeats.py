"""Frames that show the picture before once more: phones, screen recorders and editors write them to keep a rate."""

import numpy as np

from tasks.arrays import Bools, Float64


def repeated(pose: Float64, tolerance: Float64, least_way: Float64) -> Bools:
    """Return which of the (n_frames, 3) poses of a bar that moves on are those of the frame before.

    Coordinates of one picture differ by at most ``tolerance``; those of a bar that moves, by more than ``least_way``.
    """
    same = np.append(False, (np.abs(np.diff(pose, axis=0)) <= tolerance).all(axis=1))
    new = np.flatnonzero(~same)
    way = np.diff(pose[new], axis=0)
    towards = np.sign(way) * (np.abs(way) > least_way)
    ends = (towards[:1], towards, towards[-1:]) if len(way) else (np.zeros((2, pose.shape[1])),)
    either = np.concatenate(ends)  # towards each picture that is new, and from the last one
    moving = (either[:-1] * either[1:] > 0).any(axis=1)
    n_shown = np.diff(np.append(new, len(pose)))
    # A bar may be held before a throw and rest after it, but no longer than pictures are repeated within the throw.
    moving[[0, -1]] &= n_shown[[0, -1]] <= np.max(n_shown[1:-1][moving[1:-1]], initial=1)
    return np.asarray(same & np.repeat(moving, n_shown))
