"""Where throws begin and end in the frames of a video.

A throw of a bar begins in the first frame in which all its tags are seen and its centre is in the zone, the rectangle
of the tank's corner tags: whoever holds the bar covers a tag, or is outside the zone. It ends when the bar leaves the
zone, is not seen for a while, or rests. The bar must then be covered, or out of the zone, before it is thrown again.
"""

import numpy as np

from tasks.arrays import Bools, Float64, Ints

_MAX_GAP = 0.1  # longest time without a sight of the bar [s]
_REST_TIME, _REST_DISTANCE, _REST_TURN = 0.5, 0.005, 0.05  # a bar rests that moves by less in this time [s], [m], [rad]
MIN_FRAMES = 5  # a shorter throw is left out


def throw_spans(time: Float64, n_seen: Ints, pose: Float64, in_zone: Bools, *, n_tags: int) -> list[Ints]:
    """Find the throws of one bar in one video.

    Args:
        time: (n_frames,) times of the frames [s].
        n_seen: (n_frames,) number of the bar's tags that are seen.
        pose: (n_frames, 3) x, y [m] and angle [rad] of the bar; anything where no tag is seen.
        in_zone: (n_frames,) whether the bar's centre is in the zone.
        n_tags: number of tags on the bar.

    Returns:
        The indices of the frames in which the bar is seen, for each throw.
    """
    throws: list[list[int]] = []
    current: list[int] = []
    armed = True
    for frame in range(len(time)):
        inside = n_seen[frame] > 0 and bool(in_zone[frame])
        if current:
            late = time[frame] - time[current[-1]] > _MAX_GAP
            if n_seen[frame] == 0 and not late:
                continue
            armed = not inside
            if inside and not late:
                current.append(frame)
                rest = _rests_since(time, pose, current)
                if rest is None:
                    continue
                del current[rest + 1 :]
            throws.append(current)
            current = []
        elif not inside or n_seen[frame] < n_tags:
            armed = True
        elif armed:
            current, armed = [frame], False
    return [np.array(throw) for throw in (*throws, current) if len(throw) >= MIN_FRAMES]


def _rests_since(time: Float64, pose: Float64, current: list[int]) -> int | None:
    """Return the position in a throw since which its bar rests, if it does."""
    since = int(np.searchsorted(time[current], time[current[-1]] - _REST_TIME, side="right")) - 1
    if since < 0:
        return None
    moved = np.unwrap(pose[current[since:]], axis=0, period=2 * np.pi) - pose[current[since]]
    still = np.hypot(moved[:, 0], moved[:, 1]).max() < _REST_DISTANCE and np.ptp(moved[:, 2]) < _REST_TURN
    return since if still else None
