"""Figures of a kit's page: the loads against the servo's torque–speed line, and the start of the timeline."""

from functools import partial

import numpy as np
from matplotlib.figure import Figure

from pipeline.fabrication.bench import Bench
from pipeline.report.drawing import FAINT, FIGURE_WIDTH, INK, Drawing, Missing, NothingToDraw, finish
from tasks.arrays import Floats, Int64
from tasks.design import Designs
from tasks.fabrication.scaling import line_use
from tasks.fabrication.timeline import driven_joints

_JOINT_COLOURS = ("#1c6fb8", "#dd7700", "#1d6b3c", "#7d4aa5", "#c2185b")
_SHOWN = 20.0  # of the timeline [s]
_POINTS = 1500  # of the run, about: the worst instant of as many equal spans


def torque_figure(design: Designs, bench: Bench) -> Drawing | Missing:
    """Draw the load of every joint against the servo's torque–speed line."""
    return finish("torque", "Loads of the joints and limits of the servo", partial(_torque, design, bench))


def _torque(design: Designs, bench: Bench) -> tuple[Figure, str]:
    if bench.simulated is None:
        raise NothingToDraw("the simulation diverged")
    if not bench.loads:
        raise NothingToDraw("no joint has a servo")
    figure = Figure(figsize=(FIGURE_WIDTH, 3.3), layout="constrained")
    axes = figure.subplots()
    every = max(1, len(bench.simulated.torque) // _POINTS)
    for column, (joint, colour) in enumerate(zip(driven_joints(design), _JOINT_COLOURS, strict=False)):
        torque = bench.simulated.torque[:, column] * bench.scales.torque / bench.servos_per_joint
        speed = bench.simulated.speed[:, column] * bench.scales.frequency
        shown = worst_of_each(line_use(torque, speed, bench.servo), every)
        x, y = (np.sign(torque) * speed)[shown], np.abs(torque)[shown]
        axes.plot(x, y, ".", ms=2.5, color=colour, alpha=0.6, label=f"joint {joint}")
    fastest, stall = bench.servo.no_load_speed_rad_s, bench.servo.stall_torque_nm
    axes.plot([-fastest, 0, fastest], [stall, stall, 0], color=INK, label=bench.servo.name)
    axes.set(xlabel="speed in the direction of the torque [rad/s]", ylabel="torque per servo [N·m]", ylim=(0, None))
    axes.grid(True, color=FAINT)
    figure.legend(loc="outside upper center", ncols=3, markerscale=4, fontsize=9)
    instants = "every time step" if every == 1 else f"the worst of every {every} time steps"
    return figure, (
        f"The simulated run at bench scale ({instants}) and the torque–speed line of a {bench.servo.name}, from stall "
        f"to no load. Left of zero the environment moves the joint and the servo brakes."
    )


def worst_of_each(use: Floats, every: int) -> Int64:
    """Return the (⌈n_steps / every⌉,) indices of the largest use (n_steps,) in each span of a run."""
    return np.array([start + int(use[start : start + every].argmax()) for start in range(0, len(use), every)])


def timeline_figure(bench: Bench) -> Drawing | Missing:
    """Draw the start of the timeline."""
    return finish("gait", "Joint angles on the bench", partial(_timeline, bench))


def _timeline(bench: Bench) -> tuple[Figure, str]:
    if bench.timeline is None:
        raise NothingToDraw(
            "the servos can't play this gait; the findings say why" if bench.calibration else "no joint has a servo"
        )
    figure = Figure(figsize=(FIGURE_WIDTH, 2.6), layout="constrained")
    axes = figure.subplots()
    time = bench.timeline.time
    shown = time <= _SHOWN
    for column, (joint, colour) in enumerate(zip(bench.timeline.joints, _JOINT_COLOURS, strict=False)):
        axes.plot(time[shown], np.degrees(bench.timeline.angle[shown, column]), color=colour, label=f"joint {joint}")
    axes.set(xlabel="time [s]", ylabel="angle from rest [°]")
    axes.grid(True, color=FAINT)
    figure.legend(loc="outside upper center", ncols=5, fontsize=9, columnspacing=1.2, handlelength=1.2)
    return figure, (
        f"The first {min(_SHOWN, time[-1]):.0f} of {time[-1]:.0f} s. The amplitude rises from rest to the evolved "
        f"gait; at the end it falls in the same way."
    )
