"""Figures of champions and their evolution: paper, Fig. 4, and fitness by generation."""

import numpy as np
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

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
from pipeline.report.study_page import StudyPage, page_figure, scale_words
from tasks.analysis.scores import by_arm
from tasks.evolution.map_elites import MEASURES, MapElites

_CURVE_POINTS = 120  # generations drawn per fitness curve
_MOST_DEPTHS = 4  # panels of fitness curves, and depths that fit into a panel of half the width

_TRANSFERS = {"zero_shot": "zero-shot", "adapted": "controller adapted"}


@page_figure(
    "Transfer at the greatest depth",
    section="top",
    caption="{score} in {target}, zero-shot and with controllers adapted to it: means over trials ± 1 SD, and single "
    "trials as points.",
)
def transfer_at_depth(page: StudyPage) -> Figure:
    """Draw a bar for every arm at the greatest depth: mean ± 1 SD in the target, the trials, the paper's mean."""
    tested = [row for row in page.rows("transfer") if row.zero_shot.value is not None]
    if not tested:
        raise NothingToDraw
    depth = max(row.depth for row in tested)
    deepest = [row for row in tested if row.depth == depth]
    figure = Figure(figsize=(FIGURE_WIDTH, 4.1), layout="constrained")
    axes, looks, trials = figure.add_subplot(), page.looks, by_arm(page.rows("scores"))
    small = bool(scale_words(page.settings))  # metres are not comparable with the paper's then
    ticks: dict[str, float] = {}
    x = 0.0
    for row in deepest:
        look, first = looks[row.environment], x
        for quantity in _TRANSFERS:
            mean, stated = getattr(row, quantity), getattr(row, f"paper_{quantity}")
            if mean.value is None:
                continue
            of_arm = trials.get((row.environment, depth), ())
            scores = np.array([score for trial in of_arm if np.isfinite(score := getattr(trial, quantity))])
            fill, hatch = (look.adapted, "////") if quantity == "adapted" else (look.color, "")
            axes.bar(x, mean.value, 0.62, ec=look.color, lw=1.0, fc=fill, hatch=hatch)
            axes.errorbar(x, mean.value, mean.sd or 0.0, ecolor=INK, elinewidth=1.1, capsize=3, capthick=1.1)
            spread = np.linspace(-0.2, 0.2, len(scores)) if len(scores) > 1 else np.zeros(1)
            axes.plot(x + spread, scores, look.marker, ms=3.2, mfc="#ffffff", mec=INK, mew=0.7, ls="none")
            if stated is not None and not small:
                axes.plot([x - 0.31, x + 0.31], [stated] * 2, color=PAPER_MARK, lw=2.5)
            x += 1.0
        ticks[look.label.replace(" ", "\n")] = (first + x - 1.0) / 2
        x += 0.45
    axes.axhline(0, color=INK, lw=0.8)
    axes.set_xticks(list(ticks.values()), list(ticks), fontsize="small" if len(ticks) <= 6 else "x-small")
    axes.tick_params(axis="x", length=0)
    axes.set(xlim=(-0.7, x - 0.65), ylabel=page.score_label, title=f"depth {depth:g} m")
    show_at_least(axes)
    axes.grid(axis="y")
    handles: list[Artist] = [
        Patch(facecolor=FAINT, edgecolor=INK, lw=0.8, label="zero-shot"),
        Patch(facecolor="none", edgecolor=INK, lw=0.8, hatch="////", label="controller adapted"),
    ]
    if not small and any(row.paper_zero_shot is not None for row in deepest):
        handles.append(Line2D([], [], color=PAPER_MARK, lw=2.5, label="paper"))
    legend(figure, handles)
    return figure


@page_figure(
    "Transfer across depths",
    section="transfer",
    caption="{score} in {target} by depth, zero-shot and with controllers adapted to it: means over trials ± 1 SD.",
)
def transfer_across_depths(page: StudyPage) -> Figure:
    """Draw lines over depth for every environment, a panel for zero-shot and one for adapted, with ± 1 SD."""
    rows, looks = page.rows("transfer"), page.looks
    depths = sorted({row.depth for row in rows})
    quantities = [name for name in _TRANSFERS if any(getattr(row, name).value is not None for row in rows)]
    if len(depths) < 2 or not quantities:
        raise NothingToDraw
    n_columns = 2 if len(depths) <= _MOST_DEPTHS else 1
    figure, panels = panel_grid(len(quantities), row_height=2.6, n_columns=n_columns)
    arms = [name for name in looks if any(row.environment == name for row in rows)]
    for panel, quantity in zip(panels, quantities, strict=True):
        for number, name in enumerate(arms):
            look, shift = looks[name], 0.07 * (number - (len(arms) - 1) / 2)
            by_depth = {row.depth: getattr(row, quantity) for row in rows if row.environment == name}
            points = [
                (at + shift, mean.value, mean.sd or 0.0)
                for at, depth in enumerate(depths)
                if (mean := by_depth.get(depth)) is not None and mean.value is not None
            ]
            if points:
                panel.errorbar(*zip(*points, strict=True), color=look.color, marker=look.marker, ms=5, elinewidth=0.9)
        panel.axhline(0, color=INK, lw=0.8)
        panel.set_title(_TRANSFERS[quantity])
        panel.grid(axis="y")
    panels[-1].set_xticks(range(len(depths)), [f"{depth:g}" for depth in depths])
    figure.supxlabel("depth [m]")
    figure.supylabel(page.score_label)
    drawn = [looks[name] for name in arms]
    handles = [Line2D([], [], color=look.color, marker=look.marker, ms=5, label=look.label) for look in drawn]
    legend(figure, handles, n_columns=3 if len(handles) <= 6 else 2, above=True)  # below it would hide the label
    return figure


@page_figure(
    "Fitness by generation",
    section="evolution",
    caption="Best fitness so far in the environment where the robots evolve: means over trials, bands of ± 1 SD.",
)
def fitness_curves(page: StudyPage) -> Figure:
    """Draw a panel for some depths: best fitness by generation where the robots evolve, mean ± 1 SD over trials."""
    finite = {arm: [curve for curve in curves if np.isfinite(curve).any()] for arm, curves in page.curves.items()}
    curves = {arm: trials for arm, trials in finite.items() if trials}
    if not curves:
        raise NothingToDraw
    depths = sorted({depth for _, depth in curves})
    shown = [depths[i] for i in sampled(len(depths), _MOST_DEPTHS)]
    figure, panels = panel_grid(len(shown), row_height=2.9 if len(shown) == 1 else 1.9)
    looks = {name: look for name, look in page.looks.items() if any(name == arm for arm, _ in curves)}
    for panel, depth in zip(panels, shown, strict=True):
        for name, look in looks.items():
            if trials := curves.get((name, depth)):
                # Trials that are still running are cut where the shortest ends: a mean is always over the same trials.
                generation = sampled(min(map(len, trials)), _CURVE_POINTS)
                best = np.array([np.asarray(curve)[generation] for curve in trials])
                usable = np.isfinite(best).all(axis=0)  # every robot of an early generation may have diverged
                best, generation = best[:, usable], generation[usable]
                mean, sd = best.mean(axis=0), best.std(axis=0, ddof=1) if len(best) > 1 else 0.0
                panel.fill_between(generation, mean - sd, mean + sd, color=look.color, alpha=0.22, lw=0)
                panel.plot(generation, mean, color=look.color)
        panel.set_title(f"depth {depth:g} m")
        panel.grid()
    show_at_least(panels[0])
    panels[0].xaxis.set_major_locator(MaxNLocator(5, integer=True))
    figure.supxlabel("generation")
    figure.supylabel(page.settings.evolution.maximised.with_unit("best fitness"))
    handles = [Line2D([], [], color=look.color, label=look.label) for look in looks.values()]
    legend(figure, handles, n_columns=2, above=True)
    return figure


@page_figure(
    "The fittest robot of each kind of body",
    section="evolution",
    caption="Fitness of the best robot of each cell over all trials at the greatest depth, in the environment where "
    "the robots evolve. Cells at the edge hold what lies beyond. The viewer plays those of the target, under Elites; "
    "the table elites.csv names every robot.",
)
def elites(page: StudyPage) -> Figure:
    """Draw a panel for every environment at the greatest depth: the best fitness over trials of each cell of bodies."""
    evolution, rows = page.settings.evolution, page.rows("elites")
    if not rows or not isinstance(search := evolution.optimiser, MapElites):
        raise NothingToDraw
    depth = max(row.depth for row in rows)
    deepest = [row for row in rows if row.depth == depth]
    looks = {name: look for name, look in page.looks.items() if any(row.environment == name for row in deepest)}
    figure, panels = panel_grid(len(looks), row_height=2.9)
    low, high = min(row.fitness for row in deepest), max(row.fitness for row in deepest)
    (left, right), (bottom, top) = MEASURES.values()
    for panel, (name, look) in zip(panels, looks.items(), strict=True):
        best = np.full(search.cells[::-1], np.nan)
        for row in deepest:
            if row.environment == name:
                cell = row.size_cell, row.length_cell
                best[cell] = np.fmax(best[cell], row.fitness)
        image = panel.imshow(
            best, origin="lower", extent=(left, right, bottom, top), aspect="auto", vmin=low, vmax=high
        )
        panel.set_title(f"{look.label}, {depth:g} m")
    figure.supxlabel("body length at rest [m]")
    figure.supylabel("body size: sum of links [m]")
    figure.colorbar(image, ax=list(panels), label=evolution.maximised.with_unit("fitness"))
    return figure
