"""Figures of prediction accuracy: paper, Fig. 3, and beyond it every way of taking the members together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.colors import LinearSegmentedColormap, LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from pipeline.report.data import ENVIRONMENTS, PAPER_DEPTH, StudyReport
from pipeline.report.drawing import INK, PAPER_MARK, WIDTH, NothingToDraw, count
from tasks.analysis import Estimate, Regression
from tasks.analysis.paper import AGGREGATES, RANGES
from tasks.analysis.prediction import mean_less_deviations

MEAN, CAUTIOUS = mean_less_deviations(0), mean_less_deviations(1)
"""The paper's two aggregates, μ and μ − σ."""

DENSITY = LinearSegmentedColormap.from_list("density", [(0.87, 0.47, 0.0, 0.18), (0.87, 0.47, 0.0, 1.0)])
"""The more designs, the less of the page shows through: legible by day and by night."""


def prediction_accuracy(report: StudyReport, *, n_columns: int) -> tuple[Figure, str]:
    """Panels, one for each member and one for their mean: 2-D histograms with regression and ideal lines."""
    accuracy = report.findings.accuracy
    if accuracy is None or accuracy.histograms.reason is not None:
        reason = "no design has been simulated under every member yet"
        raise NothingToDraw(report.findings.why("accuracy", (accuracy and accuracy.histograms.reason) or reason))
    histograms = accuracy.histograms
    fits = {fit.name: fit for fit in accuracy.regressions}
    n_columns = min(n_columns, len(histograms.names))
    n_rows = -(-len(histograms.names) // n_columns)
    figure = Figure(figsize=(WIDTH * max(1.0, n_columns / 2), 2.45 * n_rows + 0.75), layout="constrained")
    panels = figure.subplots(n_rows, n_columns, sharex=True, sharey=True, squeeze=False).ravel()
    norm = LogNorm(1, max(2, int(histograms.counts.max())))
    low, high = float(histograms.edges[0]), float(histograms.edges[-1])
    for panel, name, counts in zip(panels, histograms.names, histograms.counts, strict=False):
        seen = np.ma.masked_equal(counts.T, 0)
        panel.imshow(seen, origin="lower", extent=(low, high, low, high), cmap=DENSITY, norm=norm, interpolation="none")
        panel.plot([low, high], [low, high], color=INK, lw=0.9, ls=(0, (4, 3)))
        lines = [(fits.get(name), "-")] + ([(fits.get(CAUTIOUS), (0, (1, 1.2)))] if name == MEAN else [])
        words = []
        for fit, dashes in lines:
            if fit is not None:
                _regression_line(panel, fit, low, high, dashes)
                symbol = {MEAN: "μ: ", CAUTIOUS: "μ − σ: "}.get(fit.name, "")
                words.append(f"{symbol}R {_two(fit.r)}, m {_two(fit.slope)}")
        title = "ensemble" if name == MEAN else name
        panel.set_title("\n".join((title, *words)), loc="left", fontsize=9)
        panel.set_xlim(low, high)
        panel.set_ylim(low, high)
        panel.xaxis.set_major_locator(MaxNLocator(4, integer=True))
        panel.yaxis.set_major_locator(MaxNLocator(4, integer=True))
    for panel in panels[len(histograms.names) :]:
        panel.set_visible(False)
    for panel in panels[max(0, len(histograms.names) - n_columns) : len(histograms.names)]:
        panel.xaxis.set_tick_params(labelbottom=True)
    figure.supxlabel("predicted displacement [m]", fontsize=10.5)
    figure.supylabel("displacement in True Slush [m]", fontsize=10.5)
    handles = [
        Line2D([], [], color=INK, lw=1.6, label="regression"),
        Line2D([], [], color=INK, lw=1.6, ls=(0, (1, 1.2)), label="that of μ − σ"),
        Line2D([], [], color=INK, lw=0.9, ls=(0, (4, 3)), label="y = x"),
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=3, handlelength=1.9, columnspacing=1.2)
    n = max((fit.n for fit in accuracy.regressions), default=0)
    return figure, (
        f"Displacement in {accuracy.depth:g} m of True Slush of {n} designs from all generations of evolution in True "
        "Slush and on Dry Land, against what each member predicts, and against the mean μ of the members; the more "
        "designs, the deeper the colour. R is Pearson’s correlation, m the regression’s slope: below 1, the world "
        "promises more than it keeps. The dotted line is the regression on μ − σ, the fitness in Residual Slush. "
        f"{_outside(histograms.n_outside)}"
    )


def _outside(n_outside: Any) -> str:
    most = int(np.max(n_outside, initial=0))
    return f"Up to {most} designs of a panel lie outside it or diverged." if most else "No design lies outside."


def _two(found: Estimate) -> str:
    return "–" if found.value is None else f"{found.value:.2f}".replace("-", "−")


def _regression_line(panel: Any, fit: Regression, low: float, high: float, dashes: Any) -> None:
    if fit.slope.value is None or fit.intercept.value is None:
        return
    x = np.array([low, high])
    panel.plot(x, fit.intercept.value + fit.slope.value * x, color=INK, lw=1.6, ls=dashes)


def aggregates(report: StudyReport) -> tuple[Figure, str]:
    """Draw R and slope with their intervals of every member and of every way to take the members together."""
    accuracy = report.findings.accuracy
    fits = [fit for fit in accuracy.regressions if fit.r.value is not None] if accuracy else []
    if accuracy is None or not fits:
        reasons = [fit.r.reason for fit in accuracy.regressions if fit.r.reason] if accuracy else []
        reason = reasons[0] if reasons else "no design has been simulated under every member yet"
        raise NothingToDraw(report.findings.why("accuracy", reason))
    figure = Figure(figsize=(WIDTH, 0.24 * len(fits) + 1.3), layout="constrained")
    panels = figure.subplots(1, 2, sharey=True)
    for panel, (figure_name, label, ideal) in zip(
        panels, (("r", "Pearson’s R", 1.0), ("slope", "slope", 1.0)), strict=True
    ):
        panel.axvline(ideal, color=INK, lw=0.9, ls=(0, (4, 3)))
        _forest(panel, fits, figure_name)
        if accuracy.depth == PAPER_DEPTH:
            _paper_marks(panel, fits, figure_name)
        panel.set_xlabel(label)
        panel.grid(axis="x")
        panel.set_axisbelow(True)
    panels[0].set_yticks(range(len(fits)), [_shown(fit.name) for fit in fits], fontsize=9)
    panels[0].invert_yaxis()
    handles = [
        Line2D([], [], color=_MEMBER, marker="o", ms=4.5, lw=2.2, label="a member"),
        Line2D([], [], color=_TOGETHER, marker="D", ms=4.5, lw=2.2, label="together"),
    ]
    if accuracy.depth == PAPER_DEPTH:
        handles.append(Line2D([], [], color=PAPER_MARK, marker="|", ms=9, mew=2.5, ls="none", label="paper"))
    figure.legend(handles=handles, loc="outside lower center", ncols=3, handlelength=1.6, columnspacing=1.2)
    n_members = [fit for fit in fits if fit.name.startswith("member ")]
    return figure, (
        f"Correlation and slope of true on predicted displacement with their 95 % intervals: of "
        f"{count(n_members, 'member')}, "
        "and of what the members say together: the mean less k deviations, the lowest, the median, a low quantile, and "
        "CVaR, the mean of the lowest quarter. Both are best at the dashed line."
        + (
            " Upright marks are the paper’s; the band is its range over members."
            if accuracy.depth == PAPER_DEPTH
            else ""
        )
    )


_MEMBER, _TOGETHER = ENVIRONMENTS["single_member"].color, ENVIRONMENTS["residual_slush"].color


def _shown(name: str) -> str:
    """Write a predictor as the paper does."""
    if name == MEAN:
        return "μ"
    return name.replace("mean - 1 sd", "μ − σ").replace("mean - ", "μ − ").replace(" sd", " σ")


def _forest(panel: Any, fits: Sequence[Regression], figure_name: str) -> None:
    for row, fit in enumerate(fits):
        found: Estimate = getattr(fit, figure_name)
        alone = fit.name.startswith("member ")
        color, marker = (_MEMBER, "o") if alone else (_TOGETHER, "D")
        if found.low is not None and found.high is not None:
            panel.plot([found.low, found.high], [row, row], color=color, lw=2.2)
        if found.value is not None:
            panel.plot(found.value, row, marker, color=color, mec=INK, mew=0.7, ms=4.5)


def _paper_marks(panel: Any, fits: Sequence[Regression], figure_name: Any) -> None:
    rows: Mapping[str, int] = {fit.name: row for row, fit in enumerate(fits)}
    for (name, of), (stated, _) in AGGREGATES.items():
        if of == figure_name and name in rows:
            panel.plot([stated, stated], [rows[name] - 0.42, rows[name] + 0.42], color=PAPER_MARK, lw=2.5)
    alone = [row for name, row in rows.items() if name.startswith("member ")]
    if alone:
        low, high, _ = RANGES[figure_name]
        panel.fill_betweenx([min(alone) - 0.45, max(alone) + 0.45], low, high, color=PAPER_MARK, alpha=0.13, lw=0)
