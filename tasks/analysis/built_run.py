"""A built robot's run beside its simulation and the prediction of its ensemble: how far, how fast, at which gait.

Only the part of the run counts in which the gait is steady. Servos hold the angles between links, whatever water and
tank do to the robot, so the links' angles relative to the root's show when the gait has its full swing.
"""

from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass

import numpy as np
from scipy.signal import lombscargle

from tasks.analysis.columns import column
from tasks.analysis.estimates import Estimate
from tasks.arrays import Float64
from tasks.design import Designs
from tasks.simulation import OK, simulate
from tasks.simulation.box2d import Column
from tasks.world import Environment, Physics

_FREQUENCIES = np.linspace(0.5, 2.0, 1501)  # shares of the gait's that are tried
_MOST_OFF = 0.1  # share by which the frequency of a gait may differ
_STILL = 1e-9  # share of the links' variance below which a link is still but for rounding
_LEAST_SWING = 0.5  # share of the links' motion that a gait must explain
_FULL_SWING = 0.9  # share of the run's full swing above which the gait is steady
_DEVIATIONS = 2.0  # of the ensemble, that its interval has to either side


class RunError(ValueError):
    """A run is not one of this robot, or too short. The message says why."""


LinkPath = tuple[Float64, Float64]  # (n,) times [s] and (n, 3) x, y [m] and angle [rad] of a link


@dataclass(frozen=True, eq=False)
class BuiltRobot:
    """A robot that was built, and how it is simulated."""

    name: str
    design: Designs
    scale: float  # bench metres per simulated metre
    time_scale: float  # bench seconds per simulated second
    environment: Environment
    physics: Physics
    n_settle: int  # steps of a rollout before displacement is measured
    predicted: Float64 | None  # (n_members,) speeds of the root under an ensemble [m/s of the bench]
    predicted_by: str = "the kit's ensemble"

    @property
    def frequency(self) -> float:
        """Frequency of the gait on the bench [Hz]."""
        return float(self.design.frequency[0]) / self.time_scale


@dataclass(frozen=True, eq=False)
class SteadyRun:
    """The steady part of a run, measured or simulated, at bench scale."""

    time: Float64  # (n_frames,) from its beginning [s]
    x: Float64  # (n_frames,) of the root, from where it began [m]
    speed: float  # [m/s]
    frequency: float  # of the gait [Hz]


@dataclass(frozen=True)
class RunRow:
    """A run, its simulation, or its prediction."""

    run: str = column("run", form="{}")
    displacement: float | None = column("displacement", "mm", form="{:+z.0f}", meaning="While the gait was steady.")
    speed: Estimate = column("speed", "mm/s", form="{:+z.1f}", meaning="Without the swing of the gait.")
    frequency: float | None = column("gait", "Hz", form="{:.2f}")


@dataclass(frozen=True, eq=False)
class RunComparison:
    """A run and its simulation."""

    robot: BuiltRobot
    measured: SteadyRun
    simulated: SteadyRun

    @property
    def prediction(self) -> Estimate:
        """Mean speed over the members of the ensemble with two of their deviations to either side [m/s]."""
        if self.robot.predicted is None:
            return Estimate(None)
        mean, spread = float(self.robot.predicted.mean()), _DEVIATIONS * float(self.robot.predicted.std())
        return Estimate(mean, mean - spread, mean + spread)

    def rows(self) -> Sequence[RunRow]:
        """Tabulate the run beside what was expected of it."""
        runs = (("measured", self.measured), ("simulated", self.simulated))
        rows = [RunRow(name, 1000 * run.x[-1], Estimate(1000 * run.speed), run.frequency) for name, run in runs]
        if self.robot.predicted is not None:
            in_mm = Estimate(*(1000 * (speed or 0.0) for speed in astuple(self.prediction)))
            rows.append(RunRow(f"predicted by {self.robot.predicted_by}", None, in_mm, None))
        return rows


def compare_with_simulation(robot: BuiltRobot, paths: Mapping[int, LinkPath]) -> RunComparison:
    """Compare the steady part of a run, the paths of the links that were tracked, with its simulation.

    Raises RunError if the run is not of this robot or too short, or its simulation diverged.
    """
    if 0 not in paths or len(paths) < 2:
        raise RunError(f"expected tags of link 0, the root, and of a link that moves, got links {sorted(paths)}")
    time, root = paths[0]
    links = sorted(set(paths) - {0})
    angle = np.column_stack([np.interp(time, paths[i][0], paths[i][1][:, 2]) for i in links]) - root[:, 2:]
    steady = steady_part(time, angle, 1 / robot.frequency)
    measured = _steady_run(time[steady], root[steady, 0], angle[steady], robot.frequency)
    step = robot.physics.time_step * robot.time_scale
    n_settle, n_measure = robot.n_settle, int(np.ceil(measured.time[-1] / step)) + 1
    rollouts = simulate(
        robot.design, robot.environment, n_settle=n_settle, n_measure=n_measure, trace=True, physics=robot.physics
    )
    if rollouts.trace is None or not (rollouts.status == OK).all():
        raise RunError("its simulation diverged, so there is nothing to compare with")
    trace, time = rollouts.trace[0, n_settle:].astype(np.float64), np.asarray(step * np.arange(n_measure), np.float64)
    angle, x = trace[:, links, Column.ANGLE] - trace[:, :1, Column.ANGLE], robot.scale * trace[:, 0, Column.X]
    return RunComparison(robot, measured, _steady_run(time, x, angle, robot.frequency))


def steady_part(time: Float64, angle: Float64, period: float) -> slice:
    """Return the frames in which (n_frames, n_links) angles have their full swing, from the first to the last.

    Raises RunError if that is shorter than two periods [s].
    """
    first = np.clip(time - period / 2, time[0], max(time[0], time[-1] - period))
    around = zip(np.searchsorted(time, first), np.searchsorted(time, first + period, side="right"), strict=True)
    swing = np.sqrt([angle[start:end].var(axis=0).sum() for start, end in around])
    full = np.flatnonzero(swing >= _FULL_SWING * np.quantile(swing, 0.9))
    lasted = time[full[-1]] - time[full[0]]
    if lasted < 2 * period:
        raise RunError(f"its gait is steady for {lasted:.1f} s, expected at least two periods, {2 * period:.1f} s")
    return slice(full[0], full[-1] + 1)


def gait_frequency(time: Float64, angle: Float64, expected: float) -> float:
    """Return the frequency at which (n_frames, n_links) angles oscillate [Hz].

    Raises RunError if they do not, or not at about the one that is expected.
    """
    tried, share = expected * _FREQUENCIES, angle.var(axis=0) / max(angle.var(axis=0).sum(), 1e-12)
    moves = share > _STILL
    power = [lombscargle(time, of, 2 * np.pi * tried, normalize=True, floating_mean=True) for of in angle.T[moves]]
    explained = share[moves] @ np.reshape(power, (-1, len(tried)))
    frequency = float(tried[int(np.argmax(explained))])
    slack = max(_MOST_OFF, 0.5 / (expected * (time[-1] - time[0])))
    if explained.max() < _LEAST_SWING or abs(frequency / expected - 1) > slack:
        swings = f"swing at {frequency:.2f} Hz" if explained.max() >= _LEAST_SWING else "do not swing"
        raise RunError(
            f"its joints {swings}, expected a gait of {expected:.2f} Hz: is this the kit of another robot, does the "
            f"video play slower than life (--slowdown), or do servos not turn?"
        )
    return frequency


def steady_speed(time: Float64, x: Float64, period: float) -> float:
    """Return a mean speed without the swing of the gait: between the means of x over the first and last period."""
    first, last = time <= time[0] + period, time >= time[-1] - period
    return float((x[last].mean() - x[first].mean()) / (time[last].mean() - time[first].mean()))


def _steady_run(time: Float64, x: Float64, angle: Float64, frequency: float) -> SteadyRun:
    measured = gait_frequency(time, angle, frequency)
    return SteadyRun(time - time[0], x - x[0], steady_speed(time, x, 1 / frequency), measured)
