"""The family tree of a champion: who it descends from, how each came about, and what that changed."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from pipeline.report.data import StudyReport
from pipeline.report.drawing import FAINT, INK, WIDTH, NothingToDraw
from pipeline.report.findings import Ancestor, Family

LOOKS = {
    "random": ("s", "#1d6b3c", "random design"),
    "mutation": ("o", "#1c6fb8", "mutation"),
    "crossover": ("D", "#dd7700", "crossover"),
}
"""Marker, colour and name of each operator."""


MOST_MARKERS = 400
"""Ancestors up to which every one has a marker; of more, those on the main line alone."""


def main_line(family: Family) -> list[Ancestor]:
    """Follow the champion back through the fitter parent of each, the youngest first."""
    by_identity = {ancestor.identity: ancestor for ancestor in family.ancestors}
    line = [family.ancestors[-1]]
    while parents := [by_identity[parent] for parent in line[-1].parents if parent in by_identity]:
        line.append(max(parents, key=lambda parent: (parent.fitness, parent.identity)))
    return line


def family_tree(report: StudyReport) -> tuple[Figure, str]:
    """Draw ancestors by the generation of their birth and their fitness, joined to their parents."""
    family = report.findings.family
    if family is None or not family.ancestors:
        raise NothingToDraw(report.findings.why("family", "no champion’s ancestors have been traced yet"))
    shown = [ancestor for ancestor in family.ancestors if np.isfinite(ancestor.fitness)]
    places = {ancestor.identity: (ancestor.generation, ancestor.fitness) for ancestor in shown}
    line = main_line(family)
    on_line = {ancestor.identity for ancestor in line}
    figure = Figure(figsize=(WIDTH, 4.2), layout="constrained")
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
    if len(shown) > MOST_MARKERS:
        shown = [ancestor for ancestor in shown if ancestor.identity in on_line]
    for operator, (marker, color, _) in LOOKS.items():
        born = [places[ancestor.identity] for ancestor in shown if ancestor.operator == operator]
        if born:
            axes.plot(*zip(*born, strict=True), marker, color=color, mec=INK, mew=0.5, ms=4.2, ls="none", zorder=3)
    axes.plot(*places[family.ancestors[-1].identity], "*", color="#ffd24d", mec=INK, mew=0.8, ms=13, zorder=4)
    axes.set_xlabel("generation of birth")
    axes.set_ylabel("fitness where it evolved [m]")
    axes.xaxis.set_major_locator(MaxNLocator(5, integer=True))
    axes.grid()
    axes.set_axisbelow(True)
    handles = [
        Line2D([], [], marker=marker, color=color, mec=INK, mew=0.5, ms=5, ls="none", label=name)
        for marker, color, name in LOOKS.values()
    ]
    handles.append(Line2D([], [], marker="*", color="#ffd24d", mec=INK, mew=0.8, ms=11, ls="none", label="champion"))
    figure.legend(handles=handles, loc="outside lower center", ncols=2, handlelength=1.2, columnspacing=1.2)
    return figure, (
        f"Everyone that a champion descends from ({family.label}): {len(family.ancestors)} designs, by when they were "
        f"born and how fit they were. The dark line goes back through the fitter parent of each, over "
        f"{len(line)} designs."
    )
