"""The figures of a study, by name. The same report always gives the same bytes."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from matplotlib.figure import Figure

from pipeline.report.accuracy_figure import aggregates, prediction_accuracy
from pipeline.report.champion_figures import fitness_curves, transfer_across_depths, transfer_at_depth
from pipeline.report.data import StudyReport
from pipeline.report.drawing import Drawing, Missing, finish
from pipeline.report.ensemble_figures import data_set, member_error, phantom_thrust, residual_error
from pipeline.report.gap_figures import attribution, transfer_matrix
from pipeline.report.lineage import family_tree


def draw_all(report: StudyReport) -> dict[str, Drawing | Missing]:
    """Draw every figure of a study, by name; one that cannot be drawn says why."""
    return {name: finish(name, title, partial(draw, report)) for name, (title, draw) in FIGURES.items()}


FIGURES: dict[str, tuple[str, Callable[[StudyReport], tuple[Figure, str]]]] = {
    "transfer_at_depth": ("Transfer at the deepest depth", transfer_at_depth),
    "transfer_across_depths": ("Transfer across depths", transfer_across_depths),
    "attribution": ("The gap by body and controller", attribution),
    "transfer_matrix": ("Transfer between depths", transfer_matrix),
    "data_set": ("The data set", data_set),
    "prediction_accuracy": ("Prediction accuracy", partial(prediction_accuracy, n_columns=2)),
    "prediction_accuracy_wide": ("Prediction accuracy", partial(prediction_accuracy, n_columns=5)),
    "aggregates": ("What the members say together", aggregates),
    "residual_error": ("Error of the residual ensemble on throws", residual_error),
    "member_error": ("Error of the members where robots go", member_error),
    "phantom_thrust": ("Phantom thrust", phantom_thrust),
    "fitness_curves": ("Fitness by generation", partial(fitness_curves, n_columns=2)),
    "fitness_curves_wide": ("Fitness by generation", partial(fitness_curves, n_columns=5)),
    "family_tree": ("Family tree of a champion", family_tree),
}
"""Name -> title and how to draw it. A figure with a ``_wide`` twin is drawn for a phone, the twin for a desk."""
