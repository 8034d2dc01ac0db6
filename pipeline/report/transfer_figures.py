"""Figures of champions and their evolution: paper, Fig. 4, and fitness by generation."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from pipeline.config.settings import EvolutionSettings
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
from pipeline.report.palette import Look
from tasks.analysis.scores import ScoredTrial
from tasks.analysis.tables.elites import Elite
from tasks.analysis.tables.transfer import TransferRow
from tasks.arrays import Float64
from tasks.evolution.map_elites import MEASURES, MapElites

_CURVE_POINTS = 120  # generations drawn per fitness curve
_MOST_DEPTHS = 4  # panels of fitness curves, and depths that fit into a panel of half the width

_TRANSFERS = {"zero_shot": "zero-shot", "adapted": "controller adapted"}


def transfer_at_depth(
    rows: Sequence[TransferRow], scores: Sequence[ScoredTrial], looks: Mapping[str, Look], label: str
) -> Figure:
    """Draw a bar for every arm at the greatest depth: mean ± 1 SD in the target, the trials, the paper's mean."""
    known = [row for row in rows if row.zero_shot.value is not None]
    if not known:
        raise NothingToDraw
    depth = max(row.depth for row in known)
    figure = Figure(figsize=(FIGURE_WIDTH, 4.1), layout="constrained")
    axes, shown = figure.add_subplot(), [row for row in known if row.depth == depth]
    ticks: dict[str, float] = {}
    center = 0.0
    for row in shown:
        look, centers = looks[row.environment], []
        for quantity in _TRANSFERS:
            mean, stated = getattr(row, quantity), getattr(row, f"paper_{quantity}")
            if mean.value is None:
                continue
            own = [one for one in scores if (one.environment, one.depth) == (row.environment, depth)]
            values = np.array([value for one in own if np.isfinite(value := getattr(one, quantity))])
            adapted = quantity == "adapted"
            color = look.adapted if adapted else look.color
            axes.bar(center, mean.value, 0.62, ec=look.color, lw=1.0, fc=color, hatch="////" if adapted else "")
            axes.errorbar(center, mean.value, mean.sd or 0.0, ecolor=INK, elinewidth=1.1, capsize=3, capthick=1.1)
            spread = np.linspace(-0.2, 0.2, len(values)) if len(values) > 1 else np.zeros(1)
            axes.plot(center + spread, values, look.marker, ms=3.2, mfc="#ffffff", mec=INK, mew=0.7, ls="none")
            if stated is not None:
                axes.plot([center + 0.34, center + 0.56], [stated] * 2, color=PAPER_MARK, lw=2.5)
            centers.append(center)
            center += 1.0
        ticks[look.label.replace(" ", "\n")] = float(np.mean(centers))
        center += 0.45
    axes.axhline(0, color=INK, lw=0.8)
    axes.set_xticks(list(ticks.values()), list(ticks), fontsize="small" if len(ticks) <= 6 else "x-small")
    axes.tick_params(axis="x", length=0)
    axes.set_xlim(-0.7, center - 0.65)
    axes.set_ylabel(label)
    show_at_least(axes)
    axes.set_title(f"depth {depth:g} m")
    axes.grid(axis="y")
    handles: list[Artist] = [
        Patch(facecolor=FAINT, edgecolor=INK, lw=0.8, label="zero-shot"),
        Patch(facecolor="none", edgecolor=INK, lw=0.8, hatch="////", label="controller adapted"),
    ]
    if any(row.paper_zero_shot is not None for row in shown):
        handles.append(Line2D([], [], color=PAPER_MARK, lw=2.5, label="paper"))
    legend(figure, handles)
    return figure


def transfer_across_depths(rows: Sequence[TransferRow], looks: Mapping[str, Look], label: str) -> Figure:
    """Draw lines over depth for every environment, a panel for zero-shot and one for adapted, with ± 1 SD."""
    listed = sorted({row.depth for row in rows})
    drawn = [name for name in _TRANSFERS if any(getattr(row, name).value is not None for row in rows)]
    if len(listed) < 2 or not drawn:
        raise NothingToDraw
    figure, panels = panel_grid(len(drawn), 2 if len(listed) <= _MOST_DEPTHS else 1, row_height=2.6)
    present = [name for name in looks if any(row.environment == name for row in rows)]
    for panel, quantity in zip(panels, drawn, strict=True):
        for number, name in enumerate(present):
            look, shift = looks[name], 0.07 * (number - (len(present) - 1) / 2)
            own = sorted((row for row in rows if row.environment == name), key=lambda row: row.depth)
            found = [(row.depth, mean) for row in own if (mean := getattr(row, quantity)).value is not None]
            if found:
                at = [listed.index(depth) + shift for depth, _ in found]
                means, sds = zip(*((mean.value, mean.sd or 0.0) for _, mean in found), strict=True)
                panel.errorbar(at, means, sds, color=look.color, marker=look.marker, ms=5, elinewidth=0.9)
        panel.axhline(0, color=INK, lw=0.8)
        panel.set_title(_TRANSFERS[quantity])
        panel.grid(axis="y")
    panels[-1].set_xticks(range(len(listed)), [f"{depth:g}" for depth in listed])
    figure.supxlabel("depth [m]")
    figure.supylabel(label)
    handles = [
        Line2D([], [], color=looks[name].color, marker=looks[name].marker, ms=5, label=looks[name].label)
        for name in present
    ]
    legend(figure, handles, n_columns=3 if len(handles) <= 6 else 2, above=True)  # below it would hide the label
    return figure


Curves = Mapping[tuple[str, float], Sequence[Float64]]  # best fitness by generation of each trial, by arm


def fitness_curves(curves: Curves, label: str, looks: Mapping[str, Look]) -> Figure:
    """Draw a panel for some depths: best fitness by generation where the robots evolve, mean ± 1 SD over trials."""
    known = {arm: [curve for curve in own if np.isfinite(curve).any()] for arm, own in curves.items()}
    known = {arm: own for arm, own in known.items() if own}
    if not known:
        raise NothingToDraw
    listed = sorted({depth for _, depth in known})
    shown = [listed[i] for i in sampled(len(listed), _MOST_DEPTHS)]
    figure, panels = panel_grid(len(shown), 2, row_height=2.9 if len(shown) == 1 else 1.9)
    present = [name for name in looks if any(name == environment for environment, _ in known)]
    for panel, depth in zip(panels, shown, strict=True):
        for name in present:
            _curve(panel, known.get((name, depth), ()), looks[name].color)
        panel.set_title(f"depth {depth:g} m")
        panel.grid()
    show_at_least(panels[0])
    panels[0].xaxis.set_major_locator(MaxNLocator(5, integer=True))
    figure.supxlabel("generation")
    figure.supylabel(label)
    handles = [Line2D([], [], color=looks[name].color, label=looks[name].label) for name in present]
    legend(figure, handles, n_columns=2, above=True)
    return figure


def _curve(panel: Any, curves: Sequence[Float64], color: str) -> None:
    if not curves:
        return
    # Trials that are still running are cut where the shortest ends, so that a mean is always over the same trials.
    shown = sampled(min(map(len, curves)), _CURVE_POINTS)
    best = np.array([np.asarray(curve)[shown] for curve in curves])
    usable = np.isfinite(best).all(axis=0)  # every robot of an early generation may have diverged
    best = best[:, usable]
    mean, sd = best.mean(axis=0), best.std(axis=0, ddof=1) if len(best) > 1 else 0.0
    panel.fill_between(shown[usable], mean - sd, mean + sd, color=color, alpha=0.22, lw=0)
    panel.plot(shown[usable], mean, color=color)


def elites(rows: Sequence[Elite], evolution: EvolutionSettings, looks: Mapping[str, Look]) -> Figure:
    """Draw a panel for every environment at the greatest depth: the best fitness over trials of each cell of bodies."""
    if not rows or not isinstance(search := evolution.optimiser, MapElites):
        raise NothingToDraw
    depth = max(row.depth for row in rows)
    shown = [row for row in rows if row.depth == depth]
    present = [name for name in looks if any(row.environment == name for row in shown)]
    figure, panels = panel_grid(len(present), 2, row_height=2.9)
    low, high = min(row.fitness for row in shown), max(row.fitness for row in shown)
    (left, right), (bottom, top) = MEASURES.values()
    for panel, name in zip(panels, present, strict=True):
        best = np.full(search.cells[::-1], np.nan)
        for row in shown:
            if row.environment == name:
                at = row.size_cell, row.length_cell
                best[at] = np.fmax(best[at], row.fitness)
        image = panel.imshow(
            best, origin="lower", extent=(left, right, bottom, top), aspect="auto", vmin=low, vmax=high
        )
        panel.set_title(f"{looks[name].label}, {depth:g} m")
    figure.supxlabel("body length at rest [m]")
    figure.supylabel("body size: sum of links [m]")
    figure.colorbar(image, ax=list(panels), label=evolution.maximised.with_unit("fitness"))
    return figure
