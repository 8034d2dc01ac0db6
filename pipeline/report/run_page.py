"""The page of a built robot's run."""

from __future__ import annotations

from functools import partial

import numpy as np
from matplotlib.figure import Figure

from pipeline.report.document import TEMPLATES, document, inline_svg
from pipeline.report.drawing import FAINT, FIGURE_WIDTH, INK, finish
from tasks.analysis.built_run import RunComparison
from tasks.world import ENVIRONMENTS

_SIMULATED, _PREDICTED = ENVIRONMENTS["true_slush"].color, ENVIRONMENTS["residual_slush"].color
_PERIODS = 3.0  # of the gait that the figure of the joints shows


def render_run(comparison: RunComparison, run: str) -> str:
    """Return the page of a comparison; ``run`` is the name of the video or tracks."""
    drawn = (("path", "Path of the root", _path), ("joints", "Joints", _joints))
    body = TEMPLATES.get_template("run.html").render(
        run=run,
        name=comparison.robot.name,
        verdict=verdict(comparison),
        figures=[finish(name, title, partial(draw, comparison)) for name, title, draw in drawn],
        rows=figures_of_run(comparison),
        predicted=[in_mm(speed) for speed in comparison.prediction or ()],
        seconds=comparison.measured.time[-1] - comparison.measured.time[0],
        svg=inline_svg,
    )
    return document(title=f"Run of {comparison.robot.name}", policy="img-src data:", body=body)


def figures_of_run(comparison: RunComparison) -> list[tuple[str, ...]]:
    """Return what the terminal and the page say of a run: a quantity, measured, and simulated."""
    robot, both = comparison.robot, (comparison.measured, comparison.simulated)
    words = "lag behind the command" if comparison.start_known else "lag relative to the mean of the joints"
    rows = [
        ("path along the tank", *(f"{1000 * one.x[-1]:+.0f} mm" for one in both)),
        ("mean height of the root over the water", *(f"{1000 * one.y.mean():+z.0f} mm" for one in both)),
        ("speed", *(f"{in_mm(one.speed)} mm/s" for one in both)),
    ]
    for column, joint in enumerate(robot.joints):
        amplitudes = (np.degrees(one.gaits[column].amplitude) for one in both)
        lags = comparison.lags[:, column]
        late = zip(np.degrees(lags), 1000 * lags / (2 * np.pi * robot.frequency), strict=True)
        rows.append((f"joint {joint}, amplitude", *(f"±{degrees:.0f}°" for degrees in amplitudes)))
        rows.append((f"joint {joint}, {words}", *(f"{degrees:+z.0f}° ({ms:+z.0f} ms)" for degrees, ms in late)))
    return rows


def verdict(comparison: RunComparison) -> str:
    """Say in a sentence whether the robot moved as predicted."""
    measured, simulated, prediction = comparison.measured.speed, comparison.simulated.speed, comparison.prediction
    went = f"it went {in_mm(measured)} mm/s"
    if prediction is None:
        share = f"{measured / simulated:.0%} of" if comparison.same_way else "against"
        return (
            f"No ensemble predicts this run: {went}, {share} the {in_mm(simulated)} mm/s of its simulation. Name the "
            f"study that it comes from with --study."
        )
    _, low, high = prediction
    predicted = f"the {in_mm(low)} to {in_mm(high)} mm/s that {comparison.robot.predicted_by} predicted"
    if not low <= measured <= high:
        return f"The robot did not move as predicted: {went}, {'less' if measured < low else 'more'} than {predicted}."
    vague = ", but the prediction leaves the direction open" if low < 0 < high else ""
    return f"The robot moved as predicted{vague}: {went}, within {predicted}."


def in_mm(speed: float) -> str:
    """Write a speed [m/s] in mm/s."""
    return f"{1000 * speed:+z.1f}"


def _path(comparison: RunComparison) -> tuple[Figure, str]:
    """Draw x over time, with the prediction as a band."""
    figure = Figure(figsize=(FIGURE_WIDTH, 4.4), layout="constrained")
    axes, heights = figure.subplots(2, sharex=True, height_ratios=(3, 1))
    time, simulated = (one.time - one.time[0] for one in (comparison.measured, comparison.simulated))
    band = {"color": _PREDICTED, "alpha": 0.25, "lw": 0, "label": "predicted"}
    if comparison.prediction is not None:
        axes.fill_between(time, *(1000 * speed * time for speed in comparison.prediction[1:]), **band)
    for axis, values in ((axes, "x"), (heights, "y")):
        axis.plot(simulated, 1000 * getattr(comparison.simulated, values), color=_SIMULATED, label="simulated")
        axis.plot(time, 1000 * getattr(comparison.measured, values), color=INK, label="measured")
        axis.set(ylabel=f"{values} [mm]")
        axis.grid(True, color=FAINT)
    heights.set(xlabel="time since the gait is steady [s]")
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=3)
    return figure, "The root's position along the tank and over the waterline."


def _joints(comparison: RunComparison) -> tuple[Figure, str]:
    """Draw the angles of the joints over a few periods of the gait."""
    joints, frequency = comparison.robot.joints, comparison.robot.frequency
    figure = Figure(figsize=(FIGURE_WIDTH, 1.0 + 1.6 * len(joints)), layout="constrained")
    every = figure.subplots(len(joints), sharex=True, squeeze=False)[:, 0]
    for column, (axes, joint) in enumerate(zip(every, joints, strict=True)):
        runs = (comparison.simulated, _SIMULATED, "simulated"), (comparison.measured, INK, "measured")
        for run, color, name in runs:
            turns = run.time * frequency
            shown = (turns >= (first := np.ceil(turns[0]))) & (turns <= first + _PERIODS)
            style = "." if name == "measured" else "-"
            axes.plot(turns[shown] - first, np.degrees(run.angle[shown, column]), style, ms=3, color=color, label=name)
        axes.set(ylabel=f"joint {joint} [°]")
        axes.grid(True, color=FAINT)
    every[-1].set(xlabel="periods of the command")
    handles, labels = every[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=2)
    return figure, "Angles from rest, at the same phase of the command."
