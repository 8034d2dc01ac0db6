"""A built robot's run beside its simulation: speed, gait of each joint, and whether the promise held.

The robot's joints follow a timeline that rises from rest, so where its start is not known, it is the shift in time at
which the joints that the camera saw fit the timeline best. What is common to all joints' lags then vanishes in the
start, and only differences between joints remain.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from tasks.arrays import Float64
from tasks.design import N_LINKS, Designs, rest_pose

_FREQUENCIES = np.linspace(0.5, 2.0, 151)  # shares of the gait's that are tried
_MOST_OFF = 0.1  # share by which the frequency of a gait, or a distance of links, may differ
_LEAST_FRAMES = 3  # in which a gait can be seen
_LEAST_SWING = 0.5  # share of the joints' motion that a gait must explain
_CLEARLY = 0.5  # share of the misfit that a start before the video may have
_LEAST_FOLLOWED = 0.25  # share of the joints' angles that the timeline must explain; servos are mounted a tooth off
_DEVIATIONS = 2.0  # of the ensemble, that its interval has to either side


class RunError(ValueError):
    """A run is not one of this robot. The message says why."""


@dataclass(frozen=True)
class Gait:
    """A joint's oscillation offset + amplitude · sin(2π f t + phase)."""

    amplitude: float  # [rad]
    phase: float  # [rad]
    left: float  # share of the variance that it does not explain


def fit_gait(time: Float64, angle: Float64, frequency: float) -> Gait:
    """Fit a joint's oscillation.

    Args:
        time: (n_frames,) [s].
        angle: (n_frames,) [rad].
        frequency: of the gait [Hz].

    Returns:
        The oscillation.
    """
    turn = 2 * np.pi * frequency * time
    columns = np.stack((np.sin(turn), np.cos(turn), np.ones_like(turn)), axis=1)
    (a, b, c), *_ = np.linalg.lstsq(columns, angle, rcond=None)
    left = angle - columns @ (a, b, c)
    return Gait(float(np.hypot(a, b)), float(np.arctan2(b, a)), float(left.var() / max(angle.var(), 1e-12)))


def joint_angles(design: Designs, joints: tuple[int, ...], angle: Mapping[int, Float64]) -> Float64:
    """Return (n_frames, n_joints) angles of joints from rest, within ±π.

    Args:
        design: one design; joints whose motor is off are locked.
        joints: numbers of the child links.
        angle: (n_frames,) angles of links [rad]; any link of each rigid part will do.

    Raises:
        RunError: no link of a part is given.
    """
    body, rest = _bodies(design), rest_pose(design)[2][0]

    def link_angle(link: int) -> Float64:
        known = [other for other in angle if body[other] == body[link]]
        if not known:
            same = " or ".join(str(other) for other in range(N_LINKS) if body[other] == body[link])
            raise RunError(f"link {link} moves a joint, and no tag of its part was tracked: expected link {same}")
        other = link if link in known else known[0]
        return np.asarray(angle[other] - rest[other] + rest[link])

    parent = design.parent[0]
    turned = [link_angle(j) - link_angle(int(parent[j])) - design.rest_angle[0, j] for j in joints]
    return np.asarray((np.stack(turned, axis=1) + np.pi) % (2 * np.pi) - np.pi)


def check_robot(design: Designs, position: Mapping[int, Float64], scale: float) -> None:
    """Check that links that are one part stay as far apart as they are at rest.

    Args:
        design: one design.
        position: (n_frames, 2) positions of links [m].
        scale: bench metres per simulated metre.

    Raises:
        RunError: they do not.
    """
    body, (x, y, _) = _bodies(design), rest_pose(design)
    links = sorted(position)
    for i, first in enumerate(links):
        for second in links[i + 1 :]:
            if body[first] != body[second]:
                continue
            expected = scale * float(np.hypot(x[0, first] - x[0, second], y[0, first] - y[0, second]))
            found = float(np.median(np.hypot(*(position[first] - position[second]).T)))
            if abs(found - expected) > _MOST_OFF * expected + 0.003:
                raise RunError(
                    f"links {first} and {second} are {1000 * found:.0f} mm apart, expected {1000 * expected:.0f} mm: "
                    f"is this the kit of another robot, or are tags on other links?"
                )


def _bodies(design: Designs) -> list[int]:
    """Return the rigid part of each link."""
    body = list(range(N_LINKS))
    for link in range(1, N_LINKS):
        if not design.motor_on[0, link]:
            body[link] = body[int(design.parent[0, link])]
    return body


def check_frequency(time: Float64, angle: Float64, frequency: float) -> None:
    """Check that joints oscillate at the frequency of a gait.

    Args:
        time: (n_frames,) [s].
        angle: (n_frames, n_joints) [rad].
        frequency: expected [Hz].

    Raises:
        RunError: they do not, or do not swing at all.
    """
    if len(time) < _LEAST_FRAMES:
        raise RunError(f"it is seen in {len(time)} frame{'s' * (len(time) != 1)}, expected at least {_LEAST_FRAMES}")
    variance = np.maximum(angle.var(axis=0), 1e-12)
    left = [
        np.average([fit_gait(time, joint_angle, frequency * share).left for joint_angle in angle.T], weights=variance)
        for share in _FREQUENCIES
    ]
    if min(left) > 1 - _LEAST_SWING:
        raise RunError(
            f"its joints do not swing, expected a gait of {frequency:.2f} Hz: do its servos turn, and is this the kit "
            f"of another robot?"
        )
    found = float(_FREQUENCIES[int(np.argmin(left))])
    slack = max(_MOST_OFF, 0.5 / (frequency * float(time[-1] - time[0])))
    if abs(found - 1) > slack:
        raise RunError(
            f"its joints swing at {found * frequency:.2f} Hz, expected {frequency:.2f} Hz: is this the kit of another "
            f"robot, does the video play slower than life (--slowdown), or is scaling.law another one?"
        )


def start_of_run(time: Float64, angle: Float64, commanded_time: Float64, commanded: Float64) -> float:
    """Return the time at which a timeline began [s], as the joints' angles show it.

    It is in the video, unless an earlier one fits clearly better. The command is scaled to the range through which each
    joint swings: a weak servo does not reach its command, and the closest shift would be the one that commands nothing.

    Args:
        time: (n_frames,) times of the frames [s].
        angle: (n_frames, n_joints) angles of joints from rest [rad].
        commanded_time: (n_commands,) times of the timeline [s].
        commanded: (n_commands, n_joints) commanded angles from rest [rad].

    Raises:
        RunError: the joints do not follow the timeline.
    """
    reached, asked = (np.ptp(np.quantile(angles, (0.02, 0.98), axis=0), axis=0) for angles in (angle, commanded))
    scaled = commanded * (reached / np.maximum(asked, 1e-9))

    def misfit(start: float) -> float:
        columns = [np.interp(time - start, commanded_time, column, left=0.0, right=0.0) for column in scaled.T]
        return float(np.square(angle - np.stack(columns, axis=1)).mean())

    coarse = np.arange(time[0] - commanded_time[-1], time[-1], 0.04)
    misfits = np.array([misfit(start) for start in coarse])
    filmed = np.where(coarse >= time[0], misfits, np.inf)
    best = float(coarse[int(np.argmin(misfits if misfits.min() < _CLEARLY * filmed.min() else filmed))])
    fine = best + np.linspace(-0.04, 0.04, 41)
    best = float(fine[int(np.argmin([misfit(start) for start in fine]))])
    if misfit(best) > (1 - _LEAST_FOLLOWED) * float(np.square(angle).mean()):
        raise RunError(
            "its joints do not follow the kit's timeline wherever it may begin: film the run from before the servos "
            "start, check that this is its kit, or give --start"
        )
    return best


@dataclass(frozen=True)
class Promise:
    """What an ensemble predicts of a run."""

    mean: float
    low: float
    high: float

    def holds(self, value: float) -> bool:
        """Return whether a value is inside the interval."""
        return self.low <= value <= self.high


def promise_of(predictions: Float64) -> Promise:
    """Return the mean of (n_members,) predictions, with two of their standard deviations to either side."""
    mean, spread = float(predictions.mean()), _DEVIATIONS * float(predictions.std())
    return Promise(mean, mean - spread, mean + spread)


def steady_speed(time: Float64, x: Float64, period: float) -> float:
    """Return a mean speed without the swing of the gait: between the means of x over the first and last period.

    Args:
        time: (n_frames,) [s].
        x: (n_frames,) [m].
        period: of the gait [s].

    Raises:
        RunError: the run is shorter than two periods.
    """
    if time[-1] - time[0] < 2 * period:
        raise RunError(
            f"the gait is steady for {time[-1] - time[0]:.1f} s, expected at least two periods, {2 * period:.1f} s: "
            f"film a longer part of the run"
        )
    first, last = time <= time[0] + period, time >= time[-1] - period
    return float((x[last].mean() - x[first].mean()) / (time[last].mean() - time[first].mean()))
