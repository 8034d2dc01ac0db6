"""The results of a study in one small file, which documents and other programs can quote: ``results.json``."""

import hashlib
from collections.abc import Sequence
from dataclasses import fields
from typing import Any

from pipeline.report.render import as_json
from pipeline.report.study_page import StudyPage
from pipeline.results.recorded_study import Study
from pipeline.stages import STAGES
from pipeline.store.provenance import environment as provenance
from tasks.analysis.estimates import Mean
from tasks.analysis.scores import ScoredTrial
from tasks.analysis.tables import ANALYSES

_OF_CHAMPION = [field.name for field in fields(ScoredTrial) if field.name not in ("replicate", "status")]
_MEANS = ("predicted", "zero_shot", "adapted")
_DIGITS = 4  # decimals of a displacement [m]


def results_of(study: Study, page: StudyPage) -> dict[str, Any]:
    """Return a study's results: champions, each arm's means and deviations, what they are compared with, and digests.

    Scores are displacements of the root in metres, unless an objective is named. Times are in core-seconds. A stage's
    digest is the SHA-256 of the digests of its items, ordered by label.
    """
    upstream, objective = study.upstream, study.settings.evolution.maximised
    return {
        "schema": "puddle.results",
        "version": 5,
        "study": study.name,
        "source": study.record.source,
        "made_with": dict(provenance()),
        "core_seconds": {stage.name: round(upstream[stage.name].seconds) for stage in STAGES},
        "digests": {stage.name: _digest(study, stage.name) for stage in STAGES},
        "n_replicates": study.settings.replicates,
        "penalty": study.settings.ensemble.disagreement_penalty,
        **({} if objective.is_papers else {"objective": objective.name, "unit": objective.unit}),
        "arms": [
            {
                "environment": row.environment,
                "depth": row.depth,
                **{name: _mean(mean) for name in _MEANS if (mean := getattr(row, name)).n},
            }
            for row in page.rows("transfer")
        ],
        "accuracy": _rows(page, "regressions", lambda row: ANALYSES["regressions"].shown(row)),
        "comparison": [
            {**row, "this_run": row["this_run"].split(" (")[0], "interval": row["this_run"].partition(" (")[2][:-1]}
            for row in _rows(page, "paper", lambda row: True)
        ],
        "robustness": _rows(page, "robustness", lambda row: True),
        "champions": [
            {name: _rounded(getattr(row, name)) for name in _OF_CHAMPION}
            for row in page.rows("scores")
            if row.status == "ok"
        ],
    }


def _rows(page: StudyPage, name: str, chosen: Any) -> list[dict[str, Any]]:
    rows: Sequence[Any] = [row for row in page.rows(name) if chosen(row)]
    return [{key: _rounded(value) for key, value in row.items()} for row in as_json(ANALYSES[name].row, rows)]


def _mean(mean: Mean) -> dict[str, Any]:
    return {"n": mean.n, "mean": _rounded(mean.value), "sd": _rounded(mean.sd)}


def _rounded(value: Any) -> Any:
    return (None if value != value else round(value, _DIGITS)) if isinstance(value, float) else value


def _digest(study: Study, stage: str) -> str:
    done = study.upstream[stage].done
    parts = (part for identity in sorted(done, key=lambda identity: identity.label) for part in done[identity])
    return hashlib.sha256("".join(part.digest for part in parts).encode()).hexdigest()
