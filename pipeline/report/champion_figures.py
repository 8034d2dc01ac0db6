"""Figures of the champions and of their evolution: paper, Fig. 4, and fitness by generation."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from pipeline.report import data
from pipeline.report.data import ALL_DIVERGED, Measure, StudyReport, TrialMean, TrialResult
from pipeline.report.drawing import (
    FAINT,
    FIGURE_WIDTH,
    INK,
    PAPER_MARK,
    NothingToDraw,
    legend,
    panel_grid,
    sampled,
    show_at_least,
)
from tasks.analysis import paper
from tasks.evolution import OBJECTIVES
from tasks.world import ENVIRONMENTS, EnvironmentName

CURVE_POINTS = 120  # generations drawn per fitness curve, so that a page of a hundred curves stays small

_MOST_IN_THREE_COLUMNS = 6  # entries of a legend; with more arms, some have long names
_MOST_LARGE_LABELS, _MOST_SMALL_LABELS = 5, 6  # arms whose names fit side by side in the usual size, and a smaller one

_TRANSFERS: tuple[Measure, Measure] = ("zero_shot", "adapted")
_NO_TRIALS = "no trial has finished yet"


def _why_not_scored(report: StudyReport) -> str:
    if not report.trials:
        return _NO_TRIALS
    return ALL_DIVERGED if data.all_diverged(report.trials) else "no champion has been tested in True Slush yet"


def transfer_at_depth(report: StudyReport) -> tuple[Figure, str]:
    """Draw a bar for every arm at the greatest depth: mean ± 1 SD in True Slush, the trials, the paper's mean."""
    depth = data.deepest_scored(report.trials)
    if depth is None:
        raise NothingToDraw(_why_not_scored(report))
    trials = [trial for trial in report.trials if trial.depth == depth]
    figure = Figure(figsize=(FIGURE_WIDTH, 4.1), layout="constrained")
    axes = figure.add_subplot()
    ticks: dict[str, float] = {}
    center, adapted = 0.0, False
    for environment in data.environments(trials):
        centers = []
        for measure in _TRANSFERS:
            if found := data.trial_mean(data.arm(trials, environment, depth), measure):
                centers.append(center)
                _bar(axes, center, environment, measure, found)
                if (stated := data.paper_mean(environment, measure, depth)) is not None:
                    axes.plot([center + 0.34, center + 0.56], [stated] * 2, color=PAPER_MARK, lw=2.5)
                adapted |= measure == "adapted"
                center += 1.0
        if centers:
            ticks[ENVIRONMENTS[environment].label.replace(" ", "\n")] = float(np.mean(centers))
            center += 0.45
    axes.axhline(0, color=INK, lw=0.8)
    axes.set_xticks(list(ticks.values()), list(ticks), fontsize=_label_size(len(ticks)))
    axes.tick_params(axis="x", length=0)
    axes.set_xlim(-0.7, center - 0.65)
    axes.set_ylabel("displacement in True Slush [m]")
    show_at_least(axes)
    axes.set_title(f"depth {depth:g} m")
    axes.grid(axis="y")
    handles: list[Artist] = []
    if adapted:
        handles += [
            Patch(facecolor=FAINT, edgecolor=INK, lw=0.8, label="zero-shot"),
            Patch(facecolor="none", edgecolor=INK, lw=0.8, hatch="////", label="controller adapted"),
        ]
    if depth == paper.DEPTH:
        handles.append(Line2D([], [], color=PAPER_MARK, lw=2.5, label="paper"))
    legend(figure, handles)
    return figure, (
        f"Displacement in True Slush at {depth:g} m of the champions of each environment: zero-shot, and with their "
        "controllers adapted to True Slush. Bars are means over trials, whiskers ± 1 SD, and points single trials."
        + (" Short marks are the paper’s means." if depth == paper.DEPTH else "")
    )


def _label_size(n_arms: int) -> str | None:
    """Return a size in which the names of arms fit side by side."""
    return None if n_arms <= _MOST_LARGE_LABELS else "small" if n_arms <= _MOST_SMALL_LABELS else "x-small"


def _bar(axes: Any, center: float, environment: EnvironmentName, measure: Measure, found: TrialMean) -> None:
    style = ENVIRONMENTS[environment]
    fill = {"facecolor": style.adapted_color, "hatch": "////"} if measure == "adapted" else {"facecolor": style.color}
    axes.bar(center, found.mean, 0.62, edgecolor=style.color, lw=1.0, **fill)
    if found.sd is not None:
        axes.errorbar(center, found.mean, found.sd, ecolor=INK, elinewidth=1.1, capsize=3, capthick=1.1)
    offsets = np.linspace(-0.2, 0.2, len(found.values)) if found.sd is not None else np.zeros(1)
    axes.plot(center + offsets, found.values, style.marker, ms=3.2, mfc="#ffffff", mec=INK, mew=0.7, ls="none")


def transfer_across_depths(report: StudyReport) -> tuple[Figure, str]:
    """Draw lines over depth for every environment, a panel for zero-shot and one for adapted, with ± 1 SD."""
    listed = data.depths(report.trials)
    if len(listed) < 2:
        raise NothingToDraw("it compares depths, and all trials so far are at one depth" if listed else _NO_TRIALS)
    present = data.environments(report.trials)
    lines = {
        measure: {
            environment: points
            for environment in present
            if (points := _over_depths(report.trials, environment, measure, listed))
        }
        for measure in _TRANSFERS
    }
    drawn = [measure for measure in _TRANSFERS if lines[measure]]
    if not drawn:
        raise NothingToDraw(_why_not_scored(report))
    figure = Figure(figsize=(FIGURE_WIDTH, 2.8 * len(drawn) + 1.0), layout="constrained")
    panels = figure.subplots(len(drawn), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
    for panel, measure in zip(panels, drawn, strict=True):
        for environment, points in lines[measure].items():
            style, shift = ENVIRONMENTS[environment], 0.07 * (present.index(environment) - (len(present) - 1) / 2)
            at = [listed.index(depth) + shift for depth, _ in points]
            mean, sd = np.array([(found.mean, found.sd or 0.0) for _, found in points]).T
            panel.errorbar(at, mean, sd, color=style.color, marker=style.marker, ms=5, elinewidth=0.9)
        panel.axhline(0, color=INK, lw=0.8)
        panel.set_title(_TITLES[measure])
        panel.grid(axis="y")
    panels[-1].set_xticks(range(len(listed)), [f"{depth:g}" for depth in listed])
    panels[-1].set_xlabel("depth [m]")
    figure.supylabel("displacement in True Slush [m]")
    styles = [
        ENVIRONMENTS[environment] for environment in present if any(environment in lines[measure] for measure in drawn)
    ]
    handles = [Line2D([], [], color=style.color, marker=style.marker, ms=5, label=style.label) for style in styles]
    legend(figure, handles, n_columns=3 if len(handles) <= _MOST_IN_THREE_COLUMNS else 2)
    return figure, (
        "Displacement in True Slush by depth, for the champions of each environment: zero-shot, and with their "
        "controllers adapted to True Slush. Marks are means over trials, whiskers ± 1 SD; depths are evenly spaced."
    )


_TITLES: Mapping[Measure, str] = {"zero_shot": "zero-shot", "adapted": "controller adapted"}


def _over_depths(
    trials: Sequence[TrialResult], environment: EnvironmentName, measure: Measure, depths: Sequence[float]
) -> list[tuple[float, TrialMean]]:
    """Return the means of an arm, by depth."""
    means = ((depth, data.trial_mean(data.arm(trials, environment, depth), measure)) for depth in depths)
    return [(depth, found) for depth, found in means if found]


DASHES = (0, (3, 2))


def _mean_and_band(axes: Any, x: Any, mean: Any, sd: Any, color: str, *, dashed: bool = False) -> None:
    axes.fill_between(x, mean - sd, mean + sd, color=color, alpha=0.14 if dashed else 0.22, lw=0)
    axes.plot(x, mean, color=color, ls=DASHES if dashed else "-")


def fitness_curves(report: StudyReport, *, n_columns: int) -> tuple[Figure, str]:
    """Draw a panel for each depth: best fitness by generation where the robots evolve, mean ± 1 SD over trials."""
    trials = [trial for trial in report.trials if np.isfinite(trial.curve).any()]
    if not trials:
        diverged = data.all_diverged(report.trials)
        raise NothingToDraw(ALL_DIVERGED if diverged else "no trial has finished a generation yet")
    listed = data.depths(trials)
    figure, panels = panel_grid(len(listed), n_columns, row_height=2.9 if min(n_columns, len(listed)) == 1 else 1.9)
    present = data.environments(trials)
    for panel, depth in zip(panels, listed, strict=True):
        for environment in present:
            draw_curve(panel, data.arm(trials, environment, depth), ENVIRONMENTS[environment].color)
        panel.set_title(f"depth {depth:g} m")
        panel.grid()
    show_at_least(panels[0])
    panels[0].xaxis.set_major_locator(MaxNLocator(5, integer=True))
    figure.supxlabel("generation")
    figure.supylabel(f"best fitness [{OBJECTIVES[report.findings.objective].unit}]")
    handles = [Line2D([], [], color=ENVIRONMENTS[name].color, label=ENVIRONMENTS[name].label) for name in present]
    wide = min(n_columns, len(listed)) > 2
    legend(figure, handles, n_columns=len(handles) if wide else 2, above=True)
    return figure, (
        f"Best fitness ({report.findings.selected_for}) so far by generation, in the environment where the robots "
        "evolve. Lines are means over trials, bands ± 1 SD."
    )


def draw_curve(panel: Any, trials: Sequence[TrialResult], color: str, *, dashed: bool = False) -> None:
    """Draw the best fitness of an arm by generation: the mean over its trials with a band of ± 1 SD.

    Args:
        panel: where to draw.
        trials: of the arm; nothing is drawn where there are none.
        color: of the line and the band.
        dashed: whether the line is dashed and the band lighter.
    """
    if not trials:
        return
    # Trials that are still running are cut where the shortest ends, so that a mean is always over the same trials.
    shown = sampled(min(len(trial.curve) for trial in trials), CURVE_POINTS)
    curves = np.array([np.asarray(trial.curve)[shown] for trial in trials])
    usable = np.isfinite(curves).all(axis=0)  # every robot of an early generation may have diverged
    curves = curves[:, usable]
    sd = curves.std(axis=0, ddof=1) if len(curves) > 1 else np.zeros(curves.shape[1])
    _mean_and_band(panel, shown[usable], curves.mean(axis=0), sd, color, dashed=dashed)
