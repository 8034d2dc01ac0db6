"""The family tree of a champion: its ancestors, the operators that made them, and their fitness."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from pipeline.report.data import StudyReport
from pipeline.report.drawing import FAINT, FIGURE_WIDTH, INK, NothingToDraw, legend
from pipeline.report.findings import Ancestor, Family
from tasks.evolution import OBJECTIVES

_OPERATOR_LOOKS = {
    "random": ("s", "#1d6b3c", "random design"),
    "mutation": ("o", "#1c6fb8", "mutation"),
    "crossover": ("D", "#dd7700", "crossover"),
}
"""Marker, colour and label by operator."""

_MOST_MARKERS = 400  # number of ancestors above which only those on the main line have markers


def main_line(family: Family) -> list[Ancestor]:
    """Follow the champion back through the fitter parent of each ancestor, youngest first."""
    by_identity = {ancestor.identity: ancestor for ancestor in family.ancestors}
    line = [family.ancestors[-1]]
    while parents := [by_identity[parent] for parent in line[-1].parents if parent in by_identity]:
        line.append(max(parents, key=lambda parent: (parent.fitness, parent.identity)))
    return line


def family_tree(report: StudyReport) -> tuple[Figure, str]:
    """Draw ancestors by generation of birth and fitness, joined to their parents."""
    family = report.findings.family
    if family is None or not family.ancestors:
        raise NothingToDraw(report.findings.why("family", "no champion’s ancestors have been traced yet"))
    shown = [ancestor for ancestor in family.ancestors if np.isfinite(ancestor.fitness)]
    places = {ancestor.identity: (ancestor.generation, ancestor.fitness) for ancestor in shown}
    line = main_line(family)
    on_line = {ancestor.identity for ancestor in line}
    figure = Figure(figsize=(FIGURE_WIDTH, 4.2), layout="constrained")
    axes = figure.add_subplot()
    for on_it, color, width in ((False, FAINT, 0.7), (True, INK, 1.3)):
        strokes = [
            stroke
            for ancestor in shown
            for parent in ancestor.parents
            if parent in places and ({ancestor.identity, parent} <= on_line) == on_it
            for stroke in (places[parent], places[ancestor.identity], (np.nan, np.nan))  # the last lifts the pen
        ]
        if strokes:
            axes.plot(*zip(*strokes, strict=True), zorder=1 + on_it, color=color, lw=width)
    if len(shown) > _MOST_MARKERS:
        shown = [ancestor for ancestor in shown if ancestor.identity in on_line]
    champion: dict[str, Any] = {"color": "#ffd24d", "mec": INK, "mew": 0.8, "ls": "none", "marker": "*"}
    handles = []
    for operator, (marker, color, label) in _OPERATOR_LOOKS.items():
        looks: dict[str, Any] = {"marker": marker, "color": color, "mec": INK, "mew": 0.5, "ls": "none"}
        born = [places[ancestor.identity] for ancestor in shown if ancestor.operator == operator]
        if born:
            axes.plot(*zip(*born, strict=True), ms=4.2, zorder=3, **looks)
        handles.append(Line2D([], [], ms=5, label=label, **looks))
    axes.plot(*places[family.ancestors[-1].identity], ms=13, zorder=4, **champion)
    handles.append(Line2D([], [], ms=11, label="champion", **champion))
    axes.set_xlabel("generation of birth")
    axes.set_ylabel(f"fitness where it evolved [{OBJECTIVES[report.findings.objective].unit}]")
    axes.xaxis.set_major_locator(MaxNLocator(5, integer=True))
    axes.grid()
    legend(figure, handles, n_columns=2)
    return figure, (
        f"The ancestors of a champion ({family.label}): {len(family.ancestors)} designs, by generation of birth and "
        f"fitness. The dark line follows the fitter parent of each, over {len(line)} designs."
    )
