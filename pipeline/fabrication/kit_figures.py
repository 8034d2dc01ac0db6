"""Two figures of a kit's page: the servos' line and what is asked of them, and the timeline's first seconds."""

from __future__ import annotations

from functools import partial

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from pipeline.fabrication.bench import Bench, driven
from pipeline.report.drawing import FAINT, FIGURE_WIDTH, INK, Drawing, Missing, NothingToDraw, finish
from tasks.design import Designs
from tasks.fabrication.scaling import line_use

COLOURS = ("#1c6fb8", "#dd7700", "#1d6b3c", "#7d4aa5", "#c2185b")
SHOWN = 20.0
"""Of the timeline [s]."""
_POINTS = 1500
"""Of the run in the figure of torques, about so many: of as many equal spans of it the worst instant."""


def torque_figure(design: Designs, bench: Bench) -> Drawing | Missing:
    """Draw every joint's run against the servo's torque–speed line."""
    return finish("torque", "What the joints ask, and what the servo can give", partial(_torque, design, bench))


def _torque(design: Designs, bench: Bench) -> tuple[Figure, str]:
    if bench.simulated is None:
        raise NothingToDraw("the simulation diverged")
    if not bench.loads:
        raise NothingToDraw("no joint is driven")
    figure = Figure(figsize=(FIGURE_WIDTH, 3.3), layout="constrained")
    axes = figure.subplots()
    every = max(1, len(bench.simulated.torque) // _POINTS)
    for column, (joint, colour) in enumerate(zip(driven(design), COLOURS, strict=False)):
        torque = bench.simulated.torque[:, column] * bench.scales.torque / bench.servos_per_joint
        speed = bench.simulated.speed[:, column] * bench.scales.frequency
        shown = worst_of_each(line_use(torque, speed, bench.servo), every)
        axes.plot(
            (np.sign(torque) * speed)[shown],
            np.abs(torque)[shown],
            ".",
            ms=2.5,
            color=colour,
            alpha=0.6,
            label=f"joint {joint}",
        )
    fastest, stall = bench.servo.no_load_speed_rad_s, bench.servo.stall_torque_nm
    axes.plot([-fastest, 0, fastest], [stall, stall, 0], color=INK, label=bench.servo.name)
    axes.set(xlabel="speed in the torque's sense [rad/s]", ylabel="torque of a servo [N·m]", ylim=(0, None))
    axes.grid(True, color=FAINT)
    figure.legend(loc="outside upper center", ncols=3, markerscale=4, fontsize=9)
    instants = "every instant" if every == 1 else f"the worst of every {every} instants"
    return figure, (
        f"The simulated run at the bench's scale, {instants}, against what a {bench.servo.name} can give: its "
        f"straight line from stall to no load. Left of zero the joint is driven by the world and the servo brakes."
    )


def worst_of_each(use: npt.NDArray[np.floating], every: int) -> npt.NDArray[np.int64]:
    """Find the instant of the largest use in each span of a run, so that few points show its worst.

    Args:
        use: (n_steps,) of the servo's line.
        every: steps of a span; the last may be shorter.

    Returns:
        (⌈n_steps / every⌉,) indices.
    """
    return np.array([start + int(use[start : start + every].argmax()) for start in range(0, len(use), every)])


def timeline_figure(bench: Bench) -> Drawing | Missing:
    """Draw the beginning of the timeline."""
    return finish("gait", "Joint angles on the bench", partial(_timeline, bench))


def _timeline(bench: Bench) -> tuple[Figure, str]:
    if bench.timeline is None:
        raise NothingToDraw(
            "the servos can't play this gait; the findings say why" if bench.calibration else "no joint is driven"
        )
    figure = Figure(figsize=(FIGURE_WIDTH, 2.6), layout="constrained")
    axes = figure.subplots()
    time = bench.timeline.time
    shown = time <= SHOWN
    for column, (joint, colour) in enumerate(zip(bench.timeline.joints, COLOURS, strict=False)):
        axes.plot(time[shown], np.degrees(bench.timeline.angle[shown, column]), color=colour, label=f"joint {joint}")
    axes.set(xlabel="time [s]", ylabel="angle from rest [°]")
    axes.grid(True, color=FAINT)
    figure.legend(loc="outside upper center", ncols=5, fontsize=9, columnspacing=1.2, handlelength=1.2)
    return figure, (
        f"The first {min(SHOWN, time[-1]):.0f} of {time[-1]:.0f} s: rising from rest, then the evolved gait. "
        f"It falls back to rest in the same way."
    )
