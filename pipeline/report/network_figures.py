"""Figures of the throws and the networks: paper, Figs. 2 and 3."""

from itertools import pairwise

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import LinearSegmentedColormap, LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from pipeline.report.drawing import DASHED, DOTTED, FIGURE_WIDTH, INK, NothingToDraw, legend, panel_grid, sampled
from pipeline.report.palette import LOOKS
from pipeline.report.replay import link_corners
from pipeline.report.study_page import StudyPage, page_figure
from tasks.analysis.estimates import Estimate
from tasks.analysis.tables.regressions import CAUTIOUS, MEAN, ensemble_name
from tasks.arrays import Float64

_DENSITY = LinearSegmentedColormap.from_list("density", [(0.87, 0.47, 0.0, 0.18), (0.87, 0.47, 0.0, 1.0)])
"""Opacity grows with the number of designs."""
_N_BINS = 48
_GREY = "#8b93a1"  # of paths
_VIEW = 20.0  # distance shown to either side of the start of a throw [m]
_MOST_SIZES = 3  # panels of sizes


@page_figure(
    "Prediction accuracy",
    section="networks",
    caption="Displacement in {target} against the ensemble’s mean prediction, for designs of whole runs. Darker cells "
    "hold more of them. A slope m below 1 means that the networks overestimate how much robots differ; the dotted line "
    "is for μ − σ.",
)
def prediction_accuracy(page: StudyPage) -> Figure:
    """Draw a 2-D histogram with regression and ideal lines for the mean of each ensemble.

    The square spans 99.8 % of all displacements, so that a single extreme prediction does not stretch it.
    """
    fits = {(row.learned_from, row.name): row for row in page.rows("regressions")}
    points: dict[str, tuple[Float64, Float64]] = {}
    for learner, assessed in page.assessed.items():
        mean = assessed.predicted.mean(axis=0)
        finite = np.isfinite(mean) & np.isfinite(assessed.true)
        if (learner, MEAN) in fits:  # else it was assessed, and is not analysed yet
            points[learner] = mean[finite], assessed.true[finite]
    displacements = np.concatenate([np.empty(0), *(values for pair in points.values() for values in pair)])
    if not len(displacements):
        raise NothingToDraw
    low, high = np.quantile(displacements, (0.001, 0.999))
    margin = 0.02 * (high - low) or 0.5
    low, high = float(low - margin), float(high + margin)
    edges, ends = np.linspace(low, high, _N_BINS + 1), np.array([low, high])
    figure, panels = panel_grid(len(points), row_height=2.45)
    for panel, (learner, (x, y)) in zip(panels, points.items(), strict=True):
        counts = np.histogram2d(x, y, bins=(edges, edges))[0]
        looks = {"cmap": _DENSITY, "norm": LogNorm(1, max(2, int(counts.max()))), "interpolation": "none"}
        # Not exactly square: Matplotlib leaves no room for the labels of a figure whose panels keep their proportions.
        cells = np.ma.masked_equal(counts.T, 0)
        panel.imshow(cells, origin="lower", extent=(low, high, low, high), aspect="auto", **looks)
        panel.plot(ends, ends, color=INK, lw=0.9, ls=DASHED)
        title = [ensemble_name(learner, page.settings.arm_learners)]
        for name, symbol, dashes in ((MEAN, "μ", "-"), (CAUTIOUS, "μ − σ", DOTTED)):
            fit = fits[learner, name]
            if fit.slope.value is not None and fit.intercept.value is not None:
                panel.plot(ends, fit.intercept.value + fit.slope.value * ends, color=INK, lw=1.6, ls=dashes)
            title.append(f"{symbol}: R {_two_digits(fit.r)}, m {_two_digits(fit.slope)}")
        panel.set_title("\n".join(title), fontsize=9)
        panel.set(xlim=(low, high), ylim=(low, high))
        for axis in (panel.xaxis, panel.yaxis):
            axis.set_major_locator(MaxNLocator(4, integer=True))
    figure.supxlabel("predicted displacement [m]")
    figure.supylabel(f"in {page.target} [m]")
    regression = Line2D([], [], color=INK, lw=1.6, label="regression")
    legend(figure, [regression, Line2D([], [], color=INK, lw=0.9, ls=DASHED, label="y = x")], above=True)
    return figure


def _two_digits(estimate: Estimate) -> str:
    return "–" if estimate.value is None else f"{estimate.value:z.2f}".replace("-", "−")


@page_figure(
    "The throws",
    section="networks",
    caption="Paths of the links thrown for {main}, by size. The blue line is the surface. Of one "
    "throw, the link is drawn.",
)
def data_set(page: StudyPage) -> Figure:
    """Draw a panel for each size of projectile: the paths of all throws, and the poses along one of them."""
    throws = page.throws
    if throws is None or len(throws.length_scale) == 0:
        raise NothingToDraw
    sizes, panel_of = np.unique(throws.length_scale, return_inverse=True)
    titles = [f"{size:g} m × {1 / size:.2g} m" for size in sizes]
    if len(sizes) > _MOST_SIZES:  # by thirds of the range
        edges = np.linspace(sizes[0], sizes[-1], 4)
        titles = [f"{low:.1f} to {high:.1f} m long" for low, high in pairwise(edges)]
        panel_of = np.searchsorted(edges[1:-1], throws.length_scale)
    thrown = np.unique(panel_of)  # there may be none in the middle of the range
    figure = Figure(figsize=(FIGURE_WIDTH, 1.6 * len(thrown) + 0.5), layout="constrained")
    panels = figure.subplots(len(thrown), 1, sharex=True, sharey=True, squeeze=False).ravel()
    for panel, number in zip(panels, thrown, strict=True):
        chosen = panel_of == number
        _draw_throws(panel, throws.path[chosen], throws.length_scale[chosen][0])
        panel.axhline(0, color=LOOKS["true_slush"].color, lw=1.2)
        panel.set_title(f"{titles[number]}, {chosen.sum():,} throws")
        panel.set(aspect="equal", xlim=(-_VIEW, _VIEW), ylim=(-6, 0.6 * _VIEW), ylabel="y [m]")
    panels[-1].set_xlabel("x [m]")
    return figure


def _draw_throws(panel: Axes, paths: Float64, length: Float64) -> None:
    """Draw (n_throws, n_steps, 3) paths, and the poses of a link along one of them."""
    xy = paths[:, sampled(paths.shape[1], 40), :2]
    gap = np.full((len(xy), 1, 2), np.nan)  # lifts the pen between throws
    panel.plot(*np.concatenate((xy, gap), axis=1).reshape(-1, 2).T, color=_GREY, lw=0.6, alpha=0.5)
    # The throw drawn with its poses is the longest path among those that stay in view.
    travelled = np.nansum(np.linalg.norm(np.diff(paths[:, :, :2], axis=1), axis=2), axis=1)
    travelled[(np.abs(paths[:, :, :2]) > 0.6 * _VIEW).any(axis=(1, 2))] *= 1e-3
    poses = paths[int(np.argmax(travelled)), :: max(1, paths.shape[1] // 10)]
    outlines = list(link_corners(poses, length))
    panel.add_collection(PolyCollection(outlines, facecolors="none", edgecolors=INK, linewidths=0.9))
