"""The table of ensembles: how well each predicts, by the throws that it learned from."""

from collections.abc import Sequence

from pipeline.report.findings import Findings
from pipeline.report.wording import interval, table
from tasks.analysis.prediction import Regression, mean_less_deviations
from tasks.world import ENVIRONMENTS

_AGGREGATES = {mean_less_deviations(0): "μ", mean_less_deviations(1): "μ − σ"}


def ensembles_table(findings: Findings) -> str:
    """Tabulate R and slope of the aggregates of every ensemble; nothing where there is a single one."""
    if findings.accuracy is None or not findings.other_regressions:
        return ""
    rows = [*findings.accuracy.regressions, *findings.other_regressions]
    cells = [_cells(row) for row in rows if row.name in _AGGREGATES]
    title = "Accuracy by the throws that an ensemble learned from"
    return f"<h3>{title}</h3>" + table(("Ensemble", "Predictor", "R", "Slope"), cells, title, kind="plain")


def _cells(row: Regression) -> Sequence[str]:
    ensembles = {kind.learns_from: kind for kind in ENVIRONMENTS.values() if kind.networks == "all"}
    ensemble = ensembles[row.learned_from]
    figures = (interval(figure, "{:.2f}") for figure in (row.r, row.slope))
    return (f"{ensemble.label} <i>{ensemble.symbol}</i>", _AGGREGATES[row.name], *figures)
