"""Figures of the throws and the networks: paper, Figs. 2 and 3."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.colors import LinearSegmentedColormap, LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from pipeline.report.drawing import DASHED, DOTTED, FIGURE_WIDTH, INK, NothingToDraw, legend, panel_grid, sampled
from pipeline.report.palette import LOOKS
from pipeline.report.replay import link_corners
from tasks.analysis.estimates import Estimate
from tasks.analysis.study import Assessed
from tasks.analysis.tables.regressions import CAUTIOUS, MEAN, Regression, ensemble_name
from tasks.arrays import Float64, Int64
from tasks.residual import NO_LEARNERS, Learner

_DENSITY = LinearSegmentedColormap.from_list("density", [(0.87, 0.47, 0.0, 0.18), (0.87, 0.47, 0.0, 1.0)])
"""Opacity grows with the number of designs."""
_N_BINS = 48
_COLORS = ("#dd7700", "#1c6fb8", "#7d4aa5")  # of projectiles, from short to long
_VIEW = 20.0  # distance shown to either side of the start of a throw [m]
_MOST_SIZES = 3  # panels of sizes


@dataclass(frozen=True, eq=False)
class ThrowPaths:
    """The throws of a data set."""

    length_scale: Float64  # (n_throws,) long axis of the link [m]
    path: Float64  # (n_throws, n_steps, 3) x, y [m], angle [rad]; NaN where a throw lacks a step


def data_set(throws: ThrowPaths | None) -> Figure:
    """Draw a panel for each size of projectile: the paths of all throws, and the poses along one of them."""
    if throws is None or len(throws.length_scale) == 0:
        raise NothingToDraw
    sizes, group = np.unique(throws.length_scale, return_inverse=True)
    titles = [f"{size:g} m × {1 / size:.2g} m" for size in sizes]
    if len(sizes) > _MOST_SIZES:  # by thirds of the range
        edges = np.linspace(sizes[0], sizes[-1], 4)
        titles = [f"{low:.1f} to {high:.1f} m long" for low, high in pairwise(edges)]
        group = np.searchsorted(edges[1:-1], throws.length_scale)
    figure = Figure(figsize=(FIGURE_WIDTH, 1.6 * len(titles) + 0.5), layout="constrained")
    panels = figure.subplots(len(titles), 1, sharex=True, sharey=True, squeeze=False).ravel()
    for number, (panel, title) in enumerate(zip(panels, titles, strict=True)):
        _paths(panel, throws, group == number, _COLORS[number % len(_COLORS)])
        panel.axhline(0, color=LOOKS["true_slush"].color, lw=1.2)
        panel.set_title(f"{title}, {(group == number).sum():,} throws")
        panel.set(aspect="equal", xlim=(-_VIEW, _VIEW), ylim=(-6, 0.6 * _VIEW), ylabel="y [m]")
    panels[-1].set_xlabel("x [m]")
    return figure


def _paths(panel: Any, throws: ThrowPaths, chosen: Int64, color: str) -> None:
    paths = throws.path[chosen]
    xy = paths[:, sampled(paths.shape[1], 40), :2]
    gap = np.full((len(xy), 1, 2), np.nan)  # lifts the pen between throws
    panel.plot(*np.concatenate((xy, gap), axis=1).reshape(-1, 2).T, color=color, lw=0.6, alpha=0.5)
    # The throw drawn with its poses is the longest path among those that stay in view.
    length = np.nansum(np.linalg.norm(np.diff(paths[:, :, :2], axis=1), axis=2), axis=1)
    length[(np.abs(paths[:, :, :2]) > 0.6 * _VIEW).any(axis=(1, 2))] *= 1e-3
    poses = paths[int(np.argmax(length)), :: max(1, paths.shape[1] // 10)]
    outlines = list(link_corners(poses, throws.length_scale[chosen][0]))
    panel.add_collection(PolyCollection(outlines, facecolors="none", edgecolors=INK, linewidths=0.9))


def prediction_accuracy(
    assessed: Mapping[str, Assessed],
    regressions: Sequence[Regression],
    target: str,
    learners: Mapping[str, Learner] = NO_LEARNERS,
) -> Figure:
    """Draw a 2-D histogram with regression and ideal lines for the mean of each ensemble.

    The square spans 99.8 % of all displacements, so that a single extreme prediction does not stretch it.
    """
    fits = {(row.learned_from, row.name): row for row in regressions}
    panels: dict[str, tuple[Float64, Float64]] = {}
    for group, one in assessed.items():
        mean = one.predicted.mean(axis=0)
        known = np.isfinite(mean) & np.isfinite(one.true)
        if (group, MEAN) in fits:  # else it was assessed, and is not analysed yet
            panels[group] = mean[known], one.true[known]
    shown = np.concatenate([values for pair in panels.values() for values in pair]) if panels else np.empty(0)
    if not len(shown):
        raise NothingToDraw
    low, high = np.quantile(shown, (0.001, 0.999))
    margin = 0.02 * (high - low) or 0.5
    low, high = float(low - margin), float(high + margin)
    edges = np.linspace(low, high, _N_BINS + 1)
    figure, drawn = panel_grid(len(panels), 2, row_height=2.45)
    for panel, (group, (x, y)) in zip(drawn, panels.items(), strict=True):
        counts = np.histogram2d(x, y, bins=(edges, edges))[0]
        seen = np.ma.masked_equal(counts.T, 0)
        looks = {"cmap": _DENSITY, "norm": LogNorm(1, max(2, int(counts.max()))), "interpolation": "none"}
        # Not exactly square: Matplotlib leaves no room for the labels of a figure whose panels keep their proportions.
        panel.imshow(seen, origin="lower", extent=(low, high, low, high), aspect="auto", **looks)
        panel.plot([low, high], [low, high], color=INK, lw=0.9, ls=DASHED)
        title = [ensemble_name(group, learners)]
        for name, symbol, dashes in ((MEAN, "μ", "-"), (CAUTIOUS, "μ − σ", DOTTED)):
            fit = fits[group, name]
            if fit.slope.value is not None and fit.intercept.value is not None:
                ends = np.array([low, high])
                panel.plot(ends, fit.intercept.value + fit.slope.value * ends, color=INK, lw=1.6, ls=dashes)
            title.append(f"{symbol}: R {_two_digits(fit.r)}, m {_two_digits(fit.slope)}")
        panel.set_title("\n".join(title), fontsize=9)
        panel.set(xlim=(low, high), ylim=(low, high))
        for axis in (panel.xaxis, panel.yaxis):
            axis.set_major_locator(MaxNLocator(4, integer=True))
    figure.supxlabel("predicted displacement [m]")
    figure.supylabel(f"in {target} [m]")
    handles = [Line2D([], [], color=INK, lw=1.6, label="regression"), Line2D([], [], color=INK, lw=0.9, ls=DASHED)]
    handles[1].set_label("y = x")
    legend(figure, handles, above=True)
    return figure


def _two_digits(found: Estimate) -> str:
    return "–" if found.value is None else f"{found.value:z.2f}".replace("-", "−")
