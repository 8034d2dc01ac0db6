"""The figures of a study, by name. The same report always gives the same bytes."""

from collections.abc import Callable
from functools import partial

from matplotlib.figure import Figure

from pipeline.report import accuracy_figure, champion_figures, coverage_figure, ensemble_figures, gap_figures
from pipeline.report.data import StudyReport
from pipeline.report.drawing import Drawing, Missing, finish
from pipeline.report.lineage import family_tree
from tasks.analysis.comparison import CONTRASTS


def draw_all(report: StudyReport) -> dict[str, Drawing | Missing]:
    """Draw the figures that apply to a study, by name; a figure without data gives its reason."""
    return {
        name: finish(name, title, partial(draw, report))
        for name, (title, draw) in FIGURES.items()
        if applies(report, name.removesuffix("_wide"))
    }


def applies(report: StudyReport, part: str) -> bool:
    """Return whether a part of the page has a subject in the study's settings, whether or not it is done yet."""
    evolved_in, several = set(report.environments), len(report.depths) > 1
    if part in ("transfer_across_depths", "transfer_matrix"):
        return several
    if part == "attribution":
        return "true_slush" in evolved_in and len(evolved_in) > 1
    if part == "contrasts":
        return any({a[0], b[0]} <= evolved_in for a, b in CONTRASTS)
    if part in ("prediction_accuracy", "aggregates"):
        return report.trains_networks and bool(evolved_in & {"true_slush", "dry_land"})
    return report.trains_networks or part not in _OF_NETWORKS


_OF_NETWORKS = (
    "data_set",
    "coverage",
    "residual_error",
    "member_error",
    "champion_coverage",
    "phantom_thrust",
    "exploiters",
)
"""Parts of the page about the networks, beside those about their accuracy."""


WIDE = "_wide"  # suffix of the variant for a desktop

FIGURES: dict[str, tuple[str, Callable[[StudyReport], tuple[Figure, str]]]] = {
    "transfer_at_depth": ("Transfer at the greatest depth", champion_figures.transfer_at_depth),
    "transfer_across_depths": ("Transfer across depths", champion_figures.transfer_across_depths),
    "attribution": ("Transfer gap: body and controller", gap_figures.attribution),
    "transfer_matrix": ("Transfer between depths", gap_figures.transfer_matrix),
    "data_set": ("The data set", ensemble_figures.data_set),
    "prediction_accuracy": ("Prediction accuracy", partial(accuracy_figure.prediction_accuracy, n_columns=2)),
    "prediction_accuracy_wide": ("Prediction accuracy", partial(accuracy_figure.prediction_accuracy, n_columns=5)),
    "aggregates": ("Accuracy of members and aggregates", accuracy_figure.aggregates),
    "coverage": ("What the throws cover", coverage_figure.coverage),
    "residual_error": ("Error of the members on throws", ensemble_figures.residual_error),
    "member_error": ("Error of the members on champions", ensemble_figures.member_error),
    "champion_coverage": ("Champions outside the throws", coverage_figure.champion_coverage),
    "phantom_thrust": ("Phantom thrust", ensemble_figures.phantom_thrust),
    "fitness_curves": ("Fitness by generation", partial(champion_figures.fitness_curves, n_columns=2)),
    "fitness_curves_wide": ("Fitness by generation", partial(champion_figures.fitness_curves, n_columns=5)),
    "family_tree": ("Family tree of a champion", family_tree),
}
"""Title and drawing function by name. A figure is drawn for a phone, and its ``_wide`` variant for a desktop."""
