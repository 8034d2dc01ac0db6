"""The tables of the page as CSV files beside it, and links to files for readers who go on with them."""

from collections.abc import Mapping, Sequence
from typing import TypeVar

import numpy as np

from pipeline.report.data import StudyReport
from pipeline.report.findings import Ancestor, ChampionRow, ExploiterRow, TankRow
from pipeline.store.tables import Columns, columns_of, csv_of, text
from pipeline.text import escape
from tasks.analysis.against_paper import Row
from tasks.analysis.comparison import Contrast
from tasks.analysis.variance_split import VarianceRow

_Row = TypeVar("_Row")


def tables_of(report: StudyReport) -> dict[str, bytes]:
    """Return the tables of the page that have rows as CSV, by file name."""
    found = report.findings
    tables = {
        "transfer": _scores(report),
        "paper": columns_of(Row, found.against_paper),
        "contrasts": columns_of(Contrast, found.contrasts),
        "variance": columns_of(VarianceRow, found.replicated),
        "exploiters": columns_of(ExploiterRow, found.exploiters),
        "luck": _by_arm(ChampionRow, found.champions),
        "tank": _by_arm(TankRow, found.tank_tests),
        "lineage": _lineage(found.family.ancestors if found.family else ()),
    }
    return {f"{name}.csv": csv_of(columns) for name, columns in tables.items() if len(next(iter(columns.values())))}


def links(*files: str) -> str:
    """Return a line of links that download files, each named by its type."""
    linked = (f'<a href="{escape(file)}" download>{escape(_kind(file))}</a>' for file in files)
    return f'<p class="small downloads">Download {" · ".join(linked)}</p>'


def _kind(file: str) -> str:
    name, _, suffix = file.rpartition(".")
    return f"{suffix.upper()} (wide)" if name.endswith("_wide") else suffix.upper()


def _scores(report: StudyReport) -> Columns:
    trials = report.trials
    scores = ("predicted", "zero_shot", "zero_shot_com", "adapted", "adapted_com", "predicted_sd", "fitness")
    return {
        "environment": text([trial.environment for trial in trials]),
        "depth": np.array([trial.depth for trial in trials]),
        "trial": np.array([trial.trial for trial in trials]),
        **{name: np.array([getattr(trial, name) for trial in trials], dtype=np.float64) for name in scores},
    }


def _by_arm(kind: type[_Row], rows: Mapping[str, Sequence[_Row]]) -> Columns:
    arms = text([arm for arm, of_arm in rows.items() for _ in of_arm])
    return {"arm": arms, **columns_of(kind, [row for of_arm in rows.values() for row in of_arm])}


def _lineage(ancestors: Sequence[Ancestor]) -> Columns:
    n_changed = [ancestor.n_genes_changed for ancestor in ancestors]
    return {
        "identity": np.array([ancestor.identity for ancestor in ancestors]),
        "generation": np.array([ancestor.generation for ancestor in ancestors]),
        "age": np.array([ancestor.age for ancestor in ancestors]),
        "operator": text([ancestor.operator for ancestor in ancestors]),
        "parents": text(["/".join(map(str, ancestor.parents)) for ancestor in ancestors]),
        "fitness": np.array([ancestor.fitness for ancestor in ancestors]),
        "n_genes_changed": np.array(n_changed, dtype=np.float64),
    }
