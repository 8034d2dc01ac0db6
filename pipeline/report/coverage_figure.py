"""Figures of coverage: how much of what robots do lies outside the throws, before evolution and after it."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from pipeline.report.data import StudyReport
from pipeline.report.drawing import FIGURE_WIDTH, INK, NothingToDraw, legend, show_at_least
from tasks.analysis.coverage import EVERYTHING
from tasks.residual import OBSERVATION
from tasks.world import ENVIRONMENTS

_LABELS = ("length", "height", "angle", "vx", "vy", "spin")
_SEEN_IN = {"dry_land": "random robots in the base simulator", "residual_slush": "robots evolved in the ensemble"}
_TITLES = {"throws": "the paper’s throws", "designed_throws": "throws designed for robots"}


def coverage(report: StudyReport) -> tuple[Figure, str]:
    """Draw a panel for each data set: a bar for each component and kind of robot."""
    found = report.findings.coverage
    if not found:
        raise NothingToDraw(report.findings.why("coverage", "no robots have been compared with the throws yet"))
    figure = Figure(figsize=(FIGURE_WIDTH, 1.9 * len(found) + 0.7), layout="constrained")
    panels = figure.subplots(len(found), 1, sharex=True, squeeze=False).ravel()
    for panel, (words, by_robots) in zip(panels, found.items(), strict=True):
        for number, (seen_in, rows) in enumerate(by_robots.items()):
            shares = {row.component: 100 * row.share_outside for row in rows}
            y = [k + 0.2 * (2 * number - 1) for k in range(len(OBSERVATION))]
            whole = f"{_SEEN_IN[seen_in]}: {shares[EVERYTHING]:.0f} %"
            bars = [shares[name] for name in OBSERVATION]
            panel.barh(y, bars, height=0.36, color=ENVIRONMENTS[seen_in].color, label=whole)
        panel.set_yticks(range(len(OBSERVATION)), _LABELS)
        panel.invert_yaxis()
        panel.set_title(_TITLES.get(words, words))
        panel.legend(loc="best", fontsize=7)
    panels[-1].set_xlabel("share of the states outside the throws [%]")
    return figure, (
        "States of robots’ links before evolution that are outside the throws: farther from the nearest thrown state "
        "than robots’ states are from their mean. There the networks extrapolate, and their members may agree and be "
        "wrong. Each state is counted for the component that separates it most, so a long bar names a hole in the data."
    )


def champion_coverage(report: StudyReport) -> tuple[Figure, str]:
    """Draw a point for each champion: how much of what it does is outside the throws, and what it fails to keep."""
    found = report.findings.champion_coverage
    if not found:
        reason = "no champion that evolved with networks has been compared with the throws yet"
        raise NothingToDraw(report.findings.why("champion_coverage", reason))
    figure = Figure(figsize=(FIGURE_WIDTH, 3.6), layout="constrained")
    axes = figure.add_subplot()
    trials = {(trial.environment, trial.depth, trial.trial): trial for trial in report.trials}
    for environment in dict.fromkeys(environment for environment, _ in found):
        style = ENVIRONMENTS[environment]
        points = [
            (100 * row.coverage.share_outside, trial.predicted - trial.zero_shot)
            for (evolved_in, depth), rows in found.items()
            for row in rows
            if evolved_in == environment and row.coverage.component == EVERYTHING
            if (trial := trials.get((environment, depth, row.trial))) is not None and trial.zero_shot is not None
        ]
        outside, excess = np.array(points).reshape(-1, 2).T
        look: dict[str, Any] = {"marker": style.marker, "color": style.color, "label": style.label}
        axes.plot(outside, excess, ms=4, mew=0, ls="none", alpha=0.6, **look)
    axes.axhline(0, color=INK, lw=0.8)
    axes.set_xlabel("share of a champion’s states outside the throws [%]")
    axes.set_ylabel("predicted − true displacement [m]")
    show_at_least(axes)
    axes.grid()
    legend(figure, axes.get_legend_handles_labels()[0], n_columns=2)
    return figure, (
        "Champions of all depths where they evolved: how much of what they do lies outside the throws, and how far "
        "their displacement in True Slush falls short of the predicted one. The share is known without True Slush: it "
        "shows where to distrust a prediction."
    )
