"""The results of a study in one small file, which documents and other programs can quote: ``results.json``."""

import hashlib
from collections.abc import Iterable, Sequence
from typing import Any

from pipeline.report.page import StudyPage
from pipeline.report.render import as_json
from pipeline.results.recorded_study import Study
from pipeline.stages import STAGES
from pipeline.store.encoding import Json
from pipeline.store.manifest import Manifest
from pipeline.store.provenance import environment as provenance
from pipeline.workflow.identity import TrialId
from tasks.analysis.estimates import Mean
from tasks.analysis.tables import ANALYSES

_TRIAL = ("environment", "depth", "trial")
_SCORES = ("predicted", "predicted_sd", "fitness", "zero_shot", "adapted")
_MEANS = ("predicted", "zero_shot", "adapted")
_DIGITS = 4  # decimals of a displacement [m]
_DIGITS_OF_DIGEST = 16  # hexadecimal, of a champion's


def results_of(study: Study, page: StudyPage) -> dict[str, Any]:
    """Return a study's results: champions, each arm's means and deviations, what they are compared with, and digests.

    Displacements are in metres, of the root. Times are in core-seconds. A stage's digest is the SHA-256 of the digests
    of its items, ordered by label, and a champion has the first digits of those of its own evolution and transfer.
    """
    upstream, of_trials = study.upstream, dict[tuple[Json, ...], dict[str, str]]()
    for stage in ("evolve", "transfer"):
        for trial, parts in upstream[stage].done.items():
            assert isinstance(trial, TrialId)
            key = trial.environment, trial.depth, trial.index
            of_trials.setdefault(key, {})[stage] = _joined(parts)[:_DIGITS_OF_DIGEST]
    champions = [row for row in page.rows("scores") if row.status == "ok"]
    return {
        "schema": "puddle.results",
        "version": 4,
        "study": study.name,
        "source": study.record.source,
        "made_with": dict(provenance()),
        "core_seconds": {stage.name: round(upstream[stage.name].seconds) for stage in STAGES},
        "digests": {stage.name: _digest(study, stage.name) for stage in STAGES},
        "n_replicates": study.settings.replicates,
        "penalty": study.settings.ensemble.disagreement_penalty,
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
        "luck": _rows(page, "luck", lambda row: True),
        "champions": [
            {name: _rounded(getattr(row, name)) for name in (*_TRIAL, *_SCORES)}
            | {"digests": of_trials.get(tuple(getattr(row, name) for name in _TRIAL), {})}
            for row in champions
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
    return _joined(part for identity in sorted(done, key=lambda identity: identity.label) for part in done[identity])


def _joined(parts: Iterable[Manifest]) -> str:
    return hashlib.sha256("".join(part.digest for part in parts).encode()).hexdigest()
