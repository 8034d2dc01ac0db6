"""Figures of transfer gaps: whose fault they are, and how far a design's depth can be from where it is used."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from pipeline.report.data import ENVIRONMENTS, StudyReport
from pipeline.report.drawing import INK, LEAST_RANGE, WIDTH, NothingToDraw, show_at_least
from pipeline.report.wording import number
from tasks.analysis import Attribution, TransferMatrix


def attribution(report: StudyReport) -> tuple[Figure, str]:
    """Panels, one for each arm: the gap to True Slush's own designs by depth, split into controller and body."""
    rows = [row for row in report.findings.attributions if row.gap.value is not None]
    if not rows:
        raise NothingToDraw(report.findings.why("attributions", _no_gap(report.findings.attributions)))
    arms = list(dict.fromkeys(row.evolved_in for row in rows))
    listed = sorted({row.depth for row in rows})
    figure = Figure(figsize=(WIDTH, 2.0 * len(arms) + 0.9), layout="constrained")
    panels = figure.subplots(len(arms), 1, sharex=True, sharey=True, squeeze=False).ravel()
    for panel, arm in zip(panels, arms, strict=True):
        for row in rows:
            if row.evolved_in == arm:
                _stack(panel, listed.index(row.depth), row)
        panel.axhline(0, color=INK, lw=0.8)
        panel.set_title(ENVIRONMENTS[arm].label, loc="left")
        panel.grid(axis="y")
        panel.set_axisbelow(True)
        panel.set_ylabel("gap [m]")
    show_at_least(panels[0], LEAST_RANGE)
    panels[-1].set_xticks(range(len(listed)), [f"{depth:g}" for depth in listed])
    panels[-1].set_xlim(-0.6, len(listed) - 0.4)
    panels[-1].set_xlabel("depth [m]")
    handles = [
        Patch(facecolor="none", edgecolor=INK, lw=0.8, hatch="////", label="controller"),
        Patch(facecolor=INK, edgecolor=INK, lw=0.8, label="body"),
        Line2D([], [], color=INK, marker="D", mfc="#ffffff", ms=4.5, ls="none", label="gap, 95 %"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=3, handlelength=1.4, columnspacing=1.2)
    return figure, (
        "How much less far champions get in True Slush, zero-shot, than those that evolved there (diamonds, with 95 % "
        "intervals), and what is to blame: the controller (hatched) is what adapting it wins back, the body (plain) "
        "what even an adapted controller does not. A part below 0 made up for some of the other."
    )


def _no_gap(rows: Any) -> str:
    return next((row.gap.reason for row in rows if row.gap.reason), "no champion’s controller has been adapted yet")


def _stack(panel: Any, place: int, row: Attribution) -> None:
    style = ENVIRONMENTS[row.evolved_in]
    tops = {True: 0.0, False: 0.0}  # parts above 0 and below it are stacked apart
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


SHARES = LinearSegmentedColormap.from_list("shares", ["#f7f4ec", "#f0c987", "#c9701a", "#5a2a06"])
"""From nothing of the native champions' way to all of it: light to dark, in one hue."""


def transfer_matrix(report: StudyReport) -> tuple[Figure, str]:
    """Heat maps, one for each arm: trained at a depth (rows), tested at another (columns)."""
    matrices = {name: matrix for name, matrix in report.findings.transfer_matrices.items() if (matrix.n > 0).any()}
    if not matrices:
        raise NothingToDraw(
            report.findings.why("transfer_matrices", "no champion has been tested at a depth other than its own yet")
        )
    ordered = [(name, matrices[name]) for name in ENVIRONMENTS if name in matrices]
    heights = [0.34 * len(matrix.trained) + 0.55 for _, matrix in ordered]
    figure = Figure(figsize=(WIDTH, sum(heights) + 0.5), layout="constrained")
    panels = figure.subplots(
        len(ordered), 1, squeeze=False, gridspec_kw={"height_ratios": [len(m.trained) for _, m in ordered]}
    ).ravel()
    natives = _natives(matrices.get("true_slush"))
    for panel, (name, matrix) in zip(panels, ordered, strict=True):
        _heat(panel, matrix, natives)
        panel.set_title(f"evolved {ENVIRONMENTS[name].evolved}", loc="left")
    panels[-1].set_xlabel("tested at [m]")
    figure.supylabel("evolved at [m]", fontsize=10.5)
    return figure, (
        "Mean displacement [m] in True Slush of champions that evolved at one depth (rows) and were tested at another "
        "(columns). The darker a cell, the closer they come to those that evolved in True Slush at the depth of the "
        "test; grey where there are none. On the diagonal, champions are where they evolved."
    )


def _natives(matrix: TransferMatrix | None) -> dict[float, float]:
    """Give the mean displacement [m] of designs that evolved in True Slush by depth, where they get anywhere."""
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
        face = SHARES(norm(share)) if np.isfinite(share) else (0.6, 0.6, 0.6, 0.25)
        panel.fill_between([column - 0.5, column + 0.5], row - 0.5, row + 0.5, facecolor=face, lw=0)
        dark = np.isfinite(share) and share > 0.75
        # Not INK: these stand on a cell's colour, which is the same by day and by night.
        panel.text(
            column, row, number(value), ha="center", va="center", fontsize=7.5, color="#fffffe" if dark else "#000001"
        )
    panel.set_xlim(-0.5, len(matrix.tested) - 0.5)
    panel.set_ylim(len(matrix.trained) - 0.5, -0.5)
    panel.set_xticks(range(len(matrix.tested)), [f"{depth:g}" for depth in matrix.tested])
    panel.set_yticks(range(len(matrix.trained)), [f"{depth:g}" for depth in matrix.trained])
    panel.tick_params(length=0)
