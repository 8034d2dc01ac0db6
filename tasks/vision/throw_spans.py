"""Where throws begin and end in the frames of a video.

A throw of a bar begins in the first frame in which all its tags are seen and its centre is in the zone, the rectangle
of the tank's corner tags: whoever holds the bar covers a tag, or is outside the zone. It ends when the bar leaves the
zone, is not seen for a while, or rests. The bar must then be covered, or out of the zone, before it is thrown again.
"""

from dataclasses import dataclass

import numpy as np

from tasks.arrays import Bools, Float64, Ints


@dataclass(frozen=True)
class ThrowRule:
    """The rule by which a throw begins and ends."""

    max_gap: float = 0.1  # longest time without a sight of the bar [s]
    rest_time: float = 0.5  # a bar rests if in this time [s]
    rest_distance: float = 0.005  # its centre moves less than this [m]
    rest_turn: float = 0.05  # and it turns by less than this [rad]
    min_frames: int = 5  # a shorter throw is left out


THROW_RULE = ThrowRule()
"""What `puddle track` does."""


def throw_spans(
    time: Float64, n_seen: Ints, pose: Float64, in_zone: Bools, *, n_tags: int, rule: ThrowRule
) -> list[Ints]:
    """Find the throws of one bar in one video.

    Args:
        time: (n_frames,) times of the frames [s].
        n_seen: (n_frames,) number of the bar's tags that are seen.
        pose: (n_frames, 3) x, y [m] and angle [rad] of the bar; anything where no tag is seen.
        in_zone: (n_frames,) whether the bar's centre is in the zone.
        n_tags: number of tags on the bar.
        rule: when a throw ends.

    Returns:
        The indices of the frames in which the bar is seen, for each throw.
    """
    spans: list[Ints] = []
    current: list[int] = []
    armed = True

    def end() -> None:
        if len(current) >= rule.min_frames:
            spans.append(np.array(current))
        current.clear()

    for frame in range(len(time)):
        inside = n_seen[frame] > 0 and bool(in_zone[frame])
        if current:
            if n_seen[frame] == 0 and time[frame] - time[current[-1]] <= rule.max_gap:
                continue
            armed = not inside
            if not inside or time[frame] - time[current[-1]] > rule.max_gap:
                end()
                continue
            current.append(frame)
            if (rest := _rests_since(time, pose, current, rule)) is not None:
                del current[rest + 1 :]
                end()
        elif not inside or n_seen[frame] < n_tags:
            armed = True
        elif armed:
            current.append(frame)
            armed = False
    end()
    return spans


def _rests_since(time: Float64, pose: Float64, current: list[int], rule: ThrowRule) -> int | None:
    """Return the position in a throw since which its bar rests, if it does."""
    since = int(np.searchsorted(time[current], time[current[-1]] - rule.rest_time, side="right")) - 1
    if since < 0:
        return None
    moved = np.unwrap(pose[current[since:]], axis=0, period=2 * np.pi) - pose[current[since]]
    still = np.hypot(moved[:, 0], moved[:, 1]).max() < rule.rest_distance and np.ptp(moved[:, 2]) < rule.rest_turn
    return since if still else None
