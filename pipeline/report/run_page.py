"""The page of a built robot's run."""

from functools import partial

from matplotlib.figure import Figure

from pipeline.report.document import TEMPLATES, document
from pipeline.report.drawing import FAINT, FIGURE_WIDTH, INK, finish
from pipeline.report.palette import LOOKS
from pipeline.report.render import as_html, typeset
from tasks.analysis.built_run import RunComparison, RunRow

_SIMULATED, _PREDICTED = LOOKS["true_slush"].color, LOOKS["residual_slush"].color


def render_run(comparison: RunComparison, run: str) -> str:
    """Return the page of a comparison; ``run`` is the name of the video or tracks."""
    body = TEMPLATES.get_template("run.html").render(
        run=run,
        name=comparison.robot.name,
        verdict=verdict(comparison),
        drawing=finish("path", "Path of the root", partial(_path, comparison)),
        table=as_html(RunRow, comparison.rows(), "The run beside its simulation"),
        seconds=comparison.measured.time[-1],
    )
    return document(title=f"Run of {comparison.robot.name}", policy="img-src data:", body=body)


def verdict(comparison: RunComparison) -> str:
    """Say in a sentence whether the robot moved as predicted."""
    speed, predicted = 1000 * comparison.measured.speed, comparison.prediction.interval
    if predicted is None:
        return "No ensemble predicts this run: name the study that it comes from with --study."
    low, high = (1000 * end for end in predicted)
    held = "moved" if low <= speed <= high else "did not move"
    vague = ", but the prediction leaves the direction open" if low < 0 < high else ""
    by = comparison.robot.predicted_by
    return typeset(f"The robot {held} as predicted{vague}: {speed:+z.1f} mm/s, {by} says {low:+z.1f} to {high:+z.1f}.")


def _path(comparison: RunComparison) -> tuple[Figure, str]:
    """Draw x over time, with the prediction as a band."""
    figure = Figure(figsize=(FIGURE_WIDTH, 3.4), layout="constrained")
    axes = figure.subplots()
    measured, simulated = comparison.measured, comparison.simulated
    if (predicted := comparison.prediction.interval) is not None:
        low, high = (1000 * speed * measured.time for speed in predicted)
        axes.fill_between(measured.time, low, high, color=_PREDICTED, alpha=0.25, lw=0, label="predicted")
    axes.plot(simulated.time, 1000 * simulated.x, color=_SIMULATED, label="simulated")
    axes.plot(measured.time, 1000 * measured.x, color=INK, label="measured")
    axes.set(xlabel="time since the gait is steady [s]", ylabel="x [mm]")
    axes.grid(True, color=FAINT)
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure, "The root's position along the tank."
