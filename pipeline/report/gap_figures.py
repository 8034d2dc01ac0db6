"""Figures of the transfer gap: its attribution to body and controller, and transfer between depths."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from pipeline.report.data import StudyReport
from pipeline.report.drawing import FIGURE_WIDTH, INK, NothingToDraw, legend, show_at_least
from pipeline.report.wording import number
from tasks.analysis.attribution import Attribution, TransferMatrix
from tasks.world import ENVIRONMENTS


def attribution(report: StudyReport) -> tuple[Figure, str]:
    """Draw a panel for each arm: the gap to the designs evolved in True Slush by depth, split into its two causes."""
    rows = [row for row in report.findings.attributions if row.gap.value is not None]
    if not rows:
        reasons = (row.gap.reason for row in report.findings.attributions if row.gap.reason)
        reason = next(reasons, "no champion’s controller has been adapted yet")
        raise NothingToDraw(report.findings.why("attributions", reason))
    arms = list(dict.fromkeys(row.evolved_in for row in rows))
    listed = sorted({row.depth for row in rows})
    figure = Figure(figsize=(FIGURE_WIDTH, 2.0 * len(arms) + 0.9), layout="constrained")
    panels = figure.subplots(len(arms), 1, sharex=True, sharey=True, squeeze=False).ravel()
    for panel, arm in zip(panels, arms, strict=True):
        for row in rows:
            if row.evolved_in == arm:
                _stack(panel, listed.index(row.depth), row)
        panel.axhline(0, color=INK, lw=0.8)
        panel.set_title(ENVIRONMENTS[arm].label)
        panel.grid(axis="y")
        panel.set_ylabel("gap [m]")
    is_cut = _limit_by_bars(panels[0], rows)
    show_at_least(panels[0])
    panels[-1].set_xticks(range(len(listed)), [f"{depth:g}" for depth in listed])
    panels[-1].set_xlim(-0.6, len(listed) - 0.4)
    panels[-1].set_xlabel("depth [m]")
    handles = [
        Patch(facecolor="none", edgecolor=INK, lw=0.8, hatch="////", label="controller"),
        Patch(facecolor=INK, edgecolor=INK, lw=0.8, label="body"),
        Line2D([], [], color=INK, marker="D", mfc="#ffffff", ms=4.5, ls="none", label="gap, 95 %"),
    ]
    legend(figure, handles)
    return figure, (
        "How far zero-shot champions fall short, in True Slush, of champions that evolved there (diamonds with 95 % "
        "intervals), and why. The controller’s part (hatched) is recovered when the controller adapts; the body’s part "
        "(plain) remains. A part below 0 compensates for some of the other."
        + (" Intervals that leave their panel go on beyond it." if is_cut else "")
    )


def _limit_by_bars(panel: Any, rows: Sequence[Attribution]) -> bool:
    """Keep intervals from making the bars too small to read; return whether some of them are cut.

    Two replicates leave a single degree of freedom, and intervals ten times as long as the gap.
    """
    parts = (part.value for row in rows for part in (row.gap, row.lost_to_body, row.lost_to_controller))
    most = 2 * max(0.05, *(abs(part) for part in parts if part is not None))
    low, high = panel.get_ylim()
    panel.set_ylim(max(low, -most), min(high, most))
    return bool(low < -most or high > most)


def _stack(panel: Any, place: int, row: Attribution) -> None:
    style = ENVIRONMENTS[row.evolved_in]
    tops = {True: 0.0, False: 0.0}  # parts above and below 0 are stacked separately
    for part, looks in (
        (row.lost_to_body.value, {"facecolor": style.color}),
        (row.lost_to_controller.value, {"facecolor": style.adapted_color, "hatch": "////"}),
    ):
        if part is not None:
            panel.bar(place, part, 0.62, bottom=tops[part >= 0], edgecolor=style.color, lw=1.0, **looks)
            tops[part >= 0] += part
    if row.gap.low is not None and row.gap.high is not None:
        panel.plot([place, place], [row.gap.low, row.gap.high], color=INK, lw=1.1)
    panel.plot(place, row.gap.value, "D", mfc="#ffffff", mec=INK, ms=4.5)


_SHARE_COLORS = LinearSegmentedColormap.from_list("shares", ["#f7f4ec", "#f0c987", "#c9701a", "#5a2a06"])
"""Share of the native champions' displacement, 0 to 1: light to dark, in one hue."""


def transfer_matrix(report: StudyReport) -> tuple[Figure, str]:
    """Draw a heat map for each arm: the depth of evolution by row, the depth of the test by column."""
    matrices = report.findings.transfer_matrices
    tested = [(name, matrix) for name, matrix in matrices.items() if (matrix.n > 0).any()]
    ordered = sorted(tested, key=lambda item: list(ENVIRONMENTS).index(item[0]))
    if not ordered:
        reason = "no champion has been tested at another depth than its own yet"
        raise NothingToDraw(report.findings.why("transfer_matrices", reason))
    n_rows = [len(matrix.trained) for _, matrix in ordered]
    figure = Figure(figsize=(FIGURE_WIDTH, sum(0.34 * n + 0.55 for n in n_rows) + 0.5), layout="constrained")
    panels = figure.subplots(len(ordered), 1, squeeze=False, gridspec_kw={"height_ratios": n_rows}).ravel()
    natives = _natives(dict(ordered).get("true_slush"))
    for panel, (name, matrix) in zip(panels, ordered, strict=True):
        _heat(panel, matrix, natives)
        panel.set_title(f"evolved {ENVIRONMENTS[name].evolved}")
    panels[-1].set_xlabel("depth of the test [m]")
    figure.supylabel("depth of evolution [m]")
    return figure, (
        "Mean displacement [m] in True Slush of champions that evolved at one depth (rows) and were tested at another "
        "(columns). The darker a cell, the closer they come to the champions that evolved in True Slush at the depth "
        "of the test; grey where there are none. On the diagonal, champions are tested where they evolved."
    )


def _natives(matrix: TransferMatrix | None) -> dict[float, float]:
    """Return by depth the mean displacement [m] of designs that evolved in True Slush there, where it is positive."""
    if matrix is None:
        return {}
    means = {
        float(depth): float(matrix.mean[i, j])
        for i, depth in enumerate(matrix.trained)
        for j in np.flatnonzero(matrix.tested == depth)
    }
    return {depth: mean for depth, mean in means.items() if mean > 0}


def _heat(panel: Any, matrix: TransferMatrix, natives: dict[float, float]) -> None:
    norm = Normalize(0.0, 1.0, clip=True)
    for (row, column), value in np.ndenumerate(matrix.mean):
        if not np.isfinite(value):
            continue
        share = value / natives.get(float(matrix.tested[column]), np.nan)
        face = _SHARE_COLORS(norm(share)) if np.isfinite(share) else (0.6, 0.6, 0.6, 0.25)
        panel.fill_between([column - 0.5, column + 0.5], row - 0.5, row + 0.5, facecolor=face, lw=0)
        # Not INK, which changes in dark mode: the colour of the cell does not.
        ink = "#fffffe" if np.isfinite(share) and share > 0.75 else "#000001"
        panel.text(column, row, number(value), ha="center", va="center", fontsize=7.5, color=ink)
    panel.set(xlim=(-0.5, len(matrix.tested) - 0.5), ylim=(len(matrix.trained) - 0.5, -0.5))
    panel.set_xticks(range(len(matrix.tested)), [f"{depth:g}" for depth in matrix.tested])
    panel.set_yticks(range(len(matrix.trained)), [f"{depth:g}" for depth in matrix.trained])
    panel.tick_params(length=0)
