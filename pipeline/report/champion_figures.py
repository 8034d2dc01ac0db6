"""Figures of the champions and of how they came about: paper, Fig. 4, and fitness by generation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from pipeline.config.settings import EnvironmentName
from pipeline.report.data import (
    ALL_DIVERGED,
    ENVIRONMENTS,
    PAPER,
    PAPER_DEPTH,
    Estimate,
    Quantity,
    StudyReport,
    TrialResult,
    all_diverged,
    arm,
    deepest_scored,
    depths,
    environments,
    estimate,
)
from pipeline.report.drawing import FAINT, INK, LEAST_RANGE, PAPER_MARK, WIDTH, NothingToDraw, show_at_least

CURVE_POINTS = 120
"""Generations drawn of a fitness curve, so that a page of a hundred curves stays small."""

_NO_TRIALS = "no trial has finished yet"
_NOT_SCORED = "no champion has been scored in True Slush yet"


def _why_not_scored(report: StudyReport) -> str:
    if not report.trials:
        return _NO_TRIALS
    return ALL_DIVERGED if all_diverged(report.trials) else _NOT_SCORED


# -- transfer at one depth: paper, Fig. 4 A ---------------------------------------------------------------------------


def transfer_at_depth(report: StudyReport) -> tuple[Figure, str]:
    """Bars for every arm at the deepest depth: mean ± 1 SD in True Slush, a point for each trial, the paper's mark."""
    depth = deepest_scored(report.trials)
    if depth is None:
        raise NothingToDraw(_why_not_scored(report))
    trials = [trial for trial in report.trials if trial.depth == depth]
    bars: list[tuple[EnvironmentName, Quantity, Estimate]] = [
        (environment, quantity, found)
        for environment in environments(trials)
        for quantity in _TRANSFERS
        if (found := estimate(arm(trials, environment, depth), quantity))
    ]
    figure = Figure(figsize=(WIDTH, 4.1), layout="constrained")
    axes = figure.add_subplot()
    centers, groups = _bar_places(bars)
    for center, (environment, quantity, found) in zip(centers, bars, strict=True):
        _bar(axes, center, environment, quantity, found)
        if depth == PAPER_DEPTH and (environment, quantity) in PAPER:
            axes.plot([center + 0.34, center + 0.56], [PAPER[environment, quantity]] * 2, color=PAPER_MARK, lw=2.5)
    axes.axhline(0, color=INK, lw=0.8)
    axes.set_xticks(
        [float(np.mean(places)) for places in groups.values()],
        [ENVIRONMENTS[environment].label.replace(" ", "\n") for environment in groups],
    )
    axes.tick_params(axis="x", length=0)
    axes.set_xlim(centers[0] - 0.7, centers[-1] + 0.8)
    axes.set_ylabel("displacement in True Slush [m]")
    show_at_least(axes, LEAST_RANGE)
    axes.set_title(f"depth {depth:g} m", loc="left")
    axes.grid(axis="y")
    axes.set_axisbelow(True)
    handles: list[Any] = []
    if any(quantity == "adapted" for _, quantity, _ in bars):
        handles += [
            Patch(facecolor=FAINT, edgecolor=INK, lw=0.8, label="zero-shot"),
            Patch(facecolor="none", edgecolor=INK, lw=0.8, hatch="////", label="controller adapted"),
        ]
    if depth == PAPER_DEPTH:
        handles.append(Line2D([], [], color=PAPER_MARK, lw=2.5, label="paper"))
    if handles:
        figure.legend(handles=handles, loc="outside lower center", ncols=3, handlelength=1.4, columnspacing=1.2)
    return figure, (
        f"Displacement in True Slush at {depth:g} m of the champions evolved in each environment, as they are "
        "(zero-shot) and with their controllers adapted to True Slush. Bars are means over trials, whiskers ± 1 SD, "
        "points the trials." + (" Short marks are the paper’s means." if depth == PAPER_DEPTH else "")
    )


_TRANSFERS: tuple[Quantity, Quantity] = ("zero_shot", "adapted")


def _bar_places(
    bars: Sequence[tuple[EnvironmentName, Quantity, Estimate]],
) -> tuple[list[float], dict[EnvironmentName, list[float]]]:
    """Place bars along x, those of one environment side by side."""
    centers: list[float] = []
    groups: dict[EnvironmentName, list[float]] = {}
    for environment, _, _ in bars:
        gap = 1.0 if environment in groups else 1.45
        centers.append(centers[-1] + gap if centers else 0.0)
        groups.setdefault(environment, []).append(centers[-1])
    return centers, groups


def _bar(axes: Any, center: float, environment: EnvironmentName, quantity: Quantity, found: Estimate) -> None:
    style = ENVIRONMENTS[environment]
    if quantity == "adapted":
        axes.bar(center, found.mean, 0.62, facecolor=style.adapted_color, edgecolor=style.color, hatch="////", lw=1.0)
    else:
        axes.bar(center, found.mean, 0.62, facecolor=style.color, edgecolor=style.color, lw=1.0)
    if found.sd is not None:
        axes.errorbar(center, found.mean, found.sd, ecolor=INK, elinewidth=1.1, capsize=3, capthick=1.1)
    offsets = np.linspace(-0.2, 0.2, found.n) if found.n > 1 else np.zeros(1)
    axes.plot(center + offsets, found.values, style.marker, ms=3.2, mfc="#ffffff", mec=INK, mew=0.7, ls="none")


# -- transfer across depths: paper, Fig. 4 B --------------------------------------------------------------------------


def transfer_across_depths(report: StudyReport) -> tuple[Figure, str]:
    """Lines over depth for every environment, zero-shot solid and adapted dashed, with bands of ± 1 SD."""
    listed = depths(report.trials)
    if len(listed) < 2:
        raise NothingToDraw("it compares depths, and so far there are trials at one alone" if listed else _NO_TRIALS)
    figure = Figure(figsize=(WIDTH, 4.3), layout="constrained")
    axes = figure.add_subplot()
    handles: list[Any] = []
    anything_adapted = False
    for environment in environments(report.trials):
        style = ENVIRONMENTS[environment]
        for quantity in _TRANSFERS:
            points = [
                (depth, found)
                for depth in listed
                if (found := estimate(arm(report.trials, environment, depth), quantity))
            ]
            if points:
                adapted = quantity == "adapted"
                anything_adapted |= adapted
                _line_with_band(axes, points, style.color, style.marker, adapted=adapted)
                if not any(handle.get_label() == style.label for handle in handles):
                    handles.append(Line2D([], [], color=style.color, marker=style.marker, ms=5, label=style.label))
    if not handles:
        raise NothingToDraw(_why_not_scored(report))
    if anything_adapted:
        handles += [
            Line2D([], [], color=INK, label="zero-shot"),
            Line2D([], [], color=INK, ls=(0, (3, 2)), label="adapted"),
        ]
    axes.axhline(0, color=INK, lw=0.8)
    axes.set_xlabel("depth [m]")
    axes.set_ylabel("displacement in True Slush [m]")
    axes.grid()
    axes.set_axisbelow(True)
    figure.legend(handles=handles, loc="outside lower center", ncols=3, handlelength=2.2, columnspacing=1.2)
    return figure, (
        "Displacement in True Slush over depth of the champions evolved in each environment: as they are (solid), "
        "and with their controllers adapted to True Slush (dashed, hollow). Lines are means over trials, bands ± 1 SD."
    )


def _line_with_band(
    axes: Any, points: Sequence[tuple[float, Estimate]], color: str, marker: str, *, adapted: bool
) -> None:
    x = np.array([depth for depth, _ in points])
    mean = np.array([found.mean for _, found in points])
    sd = np.array([found.sd or 0.0 for _, found in points])
    axes.fill_between(x, mean - sd, mean + sd, color=color, alpha=0.14 if adapted else 0.22, lw=0)
    axes.plot(
        x,
        mean,
        color=color,
        marker=marker,
        ms=5,
        mfc="#ffffff" if adapted else color,
        mec=color,
        ls=(0, (3, 2)) if adapted else "-",
    )


# -- fitness by generation --------------------------------------------------------------------------------------------


def fitness_curves(report: StudyReport, *, n_columns: int) -> tuple[Figure, str]:
    """Panels, one for each depth: best fitness by generation where the robots evolve, mean ± 1 SD over trials."""
    trials = [trial for trial in report.trials if np.isfinite(trial.curve).any()]
    if not trials:
        raise NothingToDraw(ALL_DIVERGED if all_diverged(report.trials) else "no trial has finished a generation yet")
    listed = depths(trials)
    n_columns = min(n_columns, len(listed))
    n_rows = -(-len(listed) // n_columns)
    width = WIDTH * max(1.0, n_columns / 2)
    height = (2.9 if n_columns == 1 else 1.9) * n_rows + 0.75
    figure = Figure(figsize=(width, height), layout="constrained")
    panels = figure.subplots(n_rows, n_columns, sharex=True, sharey=True, squeeze=False).ravel()
    for panel, depth in zip(panels, listed, strict=False):
        for environment in environments(trials):
            _curve(panel, arm(trials, environment, depth), environment)
        panel.set_title(f"depth {depth:g} m", loc="left")
        panel.grid()
        panel.set_axisbelow(True)
    show_at_least(panels[0], LEAST_RANGE)
    panels[0].xaxis.set_major_locator(MaxNLocator(5, integer=True))
    for panel in panels[len(listed) :]:
        panel.set_visible(False)
    for panel in panels[max(0, len(listed) - n_columns) : len(listed)]:
        panel.xaxis.set_tick_params(labelbottom=True)
    figure.supxlabel("generation", fontsize=10.5)
    figure.supylabel("best fitness [m]", fontsize=10.5)
    handles = [
        Line2D([], [], color=ENVIRONMENTS[environment].color, label=ENVIRONMENTS[environment].label)
        for environment in environments(trials)
    ]
    columns = len(handles) if n_columns > 2 else 2
    figure.legend(handles=handles, loc="outside upper center", ncols=columns, handlelength=1.8, columnspacing=1.2)
    return figure, (
        "Best fitness so far by generation, in the world where the robots evolve. Lines are means over trials, bands "
        "± 1 SD."
    )


def _curve(panel: Any, trials: Sequence[TrialResult], environment: EnvironmentName) -> None:
    if not trials:
        return
    # Trials that are still running are cut where the shortest ends, so that a mean is always over the same trials.
    n_generations = min(len(trial.curve) for trial in trials)
    shown = np.unique(np.linspace(0, n_generations - 1, CURVE_POINTS).round().astype(int))
    curves = np.array([np.asarray(trial.curve)[shown] for trial in trials])
    usable = np.isfinite(curves).all(axis=0)  # early generations may hold diverged robots alone
    shown, curves = shown[usable], curves[:, usable]
    mean, color = curves.mean(axis=0), ENVIRONMENTS[environment].color
    if len(curves) > 1:
        sd = curves.std(axis=0, ddof=1)
        panel.fill_between(shown, mean - sd, mean + sd, color=color, alpha=0.22, lw=0)
    panel.plot(shown, mean, color=color)
