"""Figures of prediction accuracy: paper, Fig. 3, and every way of aggregating the ensemble members."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.colors import LinearSegmentedColormap, LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from pipeline.report.data import StudyReport
from pipeline.report.drawing import (
    DASHED,
    DOTTED,
    FIGURE_WIDTH,
    INK,
    PAPER_MARK,
    NothingToDraw,
    count,
    draw_interval,
    legend,
    panel_grid,
)
from pipeline.report.wording import signed
from tasks.analysis import paper
from tasks.analysis.prediction import Figure as Statistic
from tasks.analysis.prediction import Regression, is_member, mean_less_deviations, mean_of_ensemble
from tasks.analysis.uncertainty import Estimate
from tasks.evolution import PAPERS_OBJECTIVE
from tasks.world import ENVIRONMENTS

_MEAN, _CAUTIOUS = mean_less_deviations(0), mean_less_deviations(1)  # the paper's two aggregates, μ and μ − σ

_DENSITY = LinearSegmentedColormap.from_list("density", [(0.87, 0.47, 0.0, 0.18), (0.87, 0.47, 0.0, 1.0)])
"""Opacity grows with the number of designs, so that it is legible on a light and on a dark page."""

_MEMBER, _AGGREGATE = (ENVIRONMENTS["single_member"].color, "o"), (ENVIRONMENTS["residual_slush"].color, "D")
_NOT_ASSESSED = "no design has been simulated under every member yet"


def prediction_accuracy(report: StudyReport, *, n_columns: int) -> tuple[Figure, str]:
    """Draw 2-D histograms with regression and ideal lines, for each member and for the mean of every ensemble."""
    accuracy = report.findings.accuracy
    if accuracy is None or accuracy.histograms.reason is not None:
        reason = accuracy and accuracy.histograms.reason
        raise NothingToDraw(report.findings.why("accuracy", reason or _NOT_ASSESSED))
    histograms = accuracy.histograms
    fits = {fit.name: fit for fit in accuracy.regressions}
    ensembles = _ensembles(report.findings.other_regressions) | {_MEAN: ("ensemble", fits)}
    figure, panels = panel_grid(len(histograms.names), n_columns, row_height=2.45)
    norm = LogNorm(1, max(2, int(histograms.counts.max())))
    low, high = float(histograms.edges[0]), float(histograms.edges[-1])
    for panel, name, counts in zip(panels, histograms.names, histograms.counts, strict=True):
        seen = np.ma.masked_equal(counts.T, 0)
        square = (low, high, low, high)
        looks = {"cmap": _DENSITY, "norm": norm, "interpolation": "none"}
        # Not exactly square: Matplotlib leaves no room for the labels of a figure whose panels keep their proportions.
        panel.imshow(seen, origin="lower", extent=square, aspect="auto", **looks)
        panel.plot([low, high], [low, high], color=INK, lw=0.9, ls=DASHED)
        label, found = ensembles.get(name, (name, fits))
        title = [label]
        for predictor, dashes in ((_MEAN, "-"), (_CAUTIOUS, DOTTED)) if name in ensembles else ((name, "-"),):
            if fit := found.get(predictor):
                _regression_line(panel, fit, low, high, dashes)
                symbol = f"{_symbols(predictor)}: " if name in ensembles else ""
                title.append(f"{symbol}R {_two_digits(fit.r)}, m {_two_digits(fit.slope)}")
        panel.set_title("\n".join(title), fontsize=9)
        panel.set(xlim=(low, high), ylim=(low, high))
        panel.xaxis.set_major_locator(MaxNLocator(4, integer=True))
        panel.yaxis.set_major_locator(MaxNLocator(4, integer=True))
    figure.supxlabel("predicted displacement [m]")
    figure.supylabel("displacement in True Slush [m]")
    handles = [
        Line2D([], [], color=INK, lw=1.6, label="regression"),
        Line2D([], [], color=INK, lw=1.6, ls=DOTTED, label="regression on μ − σ"),
        Line2D([], [], color=INK, lw=0.9, ls=DASHED, label="y = x"),
    ]
    legend(figure, handles, above=True)
    n = max((fit.n for fit in accuracy.regressions), default=0)
    fitness = ", the fitness in Residual Slush" if report.findings.objective == PAPERS_OBJECTIVE else ""
    return figure, (
        f"Displacement in {accuracy.depth:g} m of True Slush against the displacement that each member predicts, and "
        f"against the mean μ of the members, for {n} designs from all generations of evolution in True Slush and on "
        "Dry Land. Darker cells hold more designs. R is Pearson’s correlation and m the slope of the regression: a "
        "slope below 1 means that the model overestimates how far robots get. The dotted line is the regression on "
        f"μ − σ{fitness}. {_of_others(histograms.names, ensembles)}{_outside(histograms.n_outside)}"
    )


_Fits = Mapping[str, Regression]


def _ensembles(regressions: Sequence[Regression]) -> dict[str, tuple[str, _Fits]]:
    """Return a title and the regressions of the ensembles other than the main one, by the name of their means."""
    titles = {kind.learns_from: kind.label for kind in ENVIRONMENTS.values() if kind.networks == "all"}
    groups = dict.fromkeys(fit.learned_from for fit in regressions)
    return {
        mean_of_ensemble(group): (
            f"ensemble, {titles[group].lower()}",
            {fit.name: fit for fit in regressions if fit.learned_from == group},
        )
        for group in groups
    }


def _of_others(names: Sequence[str], ensembles: Mapping[str, tuple[str, _Fits]]) -> str:
    drawn = [ensembles[name][0].removeprefix("ensemble, ") for name in names if name in ensembles and name != _MEAN]
    if len(drawn) > 1:
        return f"The last panels show the ensembles that learned from {' and '.join(drawn)}. "
    return f"The last panel shows the ensemble that learned from {drawn[0]}. " if drawn else ""


def _outside(n_outside: Any) -> str:
    most = int(np.max(n_outside, initial=0))
    return f"Designs outside a panel or diverged: at most {most}." if most else "No design lies outside."


def _two_digits(found: Estimate) -> str:
    return "–" if found.value is None else signed("{:.2f}", found.value)


def _regression_line(panel: Any, fit: Regression, low: float, high: float, dashes: Any) -> None:
    if fit.slope.value is not None and fit.intercept.value is not None:
        x = np.array([low, high])
        panel.plot(x, fit.intercept.value + fit.slope.value * x, color=INK, lw=1.6, ls=dashes)


def aggregates(report: StudyReport) -> tuple[Figure, str]:
    """Draw R and slope with their intervals, for every member and every way of aggregating the members."""
    accuracy = report.findings.accuracy
    found = accuracy.regressions if accuracy else ()
    fits = [fit for fit in found if fit.r.value is not None]
    if accuracy is None or not fits:
        reason = next((fit.r.reason for fit in found if fit.r.reason), _NOT_ASSESSED)
        raise NothingToDraw(report.findings.why("accuracy", reason))
    beside_paper = accuracy.depth == paper.DEPTH
    figure = Figure(figsize=(FIGURE_WIDTH, 0.24 * len(fits) + 1.3), layout="constrained")
    panels = figure.subplots(1, 2, sharey=True)
    statistics: tuple[tuple[Statistic, str], ...] = (("r", "Pearson’s R"), ("slope", "slope"))
    for panel, (statistic, label) in zip(panels, statistics, strict=True):
        panel.axvline(1.0, color=INK, lw=0.9, ls=DASHED)
        for row, fit in enumerate(fits):
            draw_interval(panel, row, getattr(fit, statistic), *(_MEMBER if _is_member(fit) else _AGGREGATE))
        if beside_paper:
            _paper_marks(panel, fits, statistic)
        panel.set_xlabel(label)
        panel.grid(axis="x")
    panels[0].set_yticks(range(len(fits)), [_symbols(fit.name) for fit in fits], fontsize=9)
    panels[0].invert_yaxis()
    handles = [
        Line2D([], [], color=color, marker=marker, ms=4.5, lw=2.2, label=label)
        for (color, marker), label in ((_MEMBER, "member"), (_AGGREGATE, "aggregate"))
    ]
    if beside_paper:
        handles.append(Line2D([], [], color=PAPER_MARK, marker="|", ms=9, mew=2.5, ls="none", label="paper"))
    legend(figure, handles)
    members = [fit for fit in fits if _is_member(fit)]
    return figure, (
        "Correlation and slope of the regression of true on predicted displacement, with 95 % intervals"
        f"{' that include the variance between replicates' if fits[0].n_replicates > 1 else ''}, for "
        f"{count(members, 'member')} and for aggregates of the members: the mean minus k standard deviations, the "
        "minimum, the median, a low quantile, and CVaR, the mean of the lowest quarter. The dashed line marks the "
        "ideal value of both."
        + (" Vertical marks are the paper’s values; the band is its range over members." if beside_paper else "")
    )


def _is_member(fit: Regression) -> bool:
    return is_member(fit.name)


def _symbols(predictor: str) -> str:
    """Write a predictor in the paper's symbols."""
    if predictor == _MEAN:
        return "μ"
    return predictor.replace("mean - 1 sd", "μ − σ").replace("mean - ", "μ − ").replace(" sd", " σ")


def _paper_marks(panel: Any, fits: Sequence[Regression], statistic: Statistic) -> None:
    for row, fit in enumerate(fits):
        if stated := paper.AGGREGATES.get((fit.name, statistic)):
            panel.plot([stated[0]] * 2, [row - 0.42, row + 0.42], color=PAPER_MARK, lw=2.5)
    members = [row for row, fit in enumerate(fits) if _is_member(fit)]
    if members:
        low, high, _ = paper.RANGES[statistic]
        panel.fill_betweenx([min(members) - 0.45, max(members) + 0.45], low, high, color=PAPER_MARK, alpha=0.13, lw=0)
