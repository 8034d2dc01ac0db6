"""The results of a study in one small file, which documents and other programs can quote: ``results.json``."""

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise

import numpy as np

from pipeline.results.recorded_study import CHAMPIONS, Study
from pipeline.stages import STAGES
from pipeline.store.encoding import Json
from pipeline.store.manifest import Manifest
from pipeline.store.provenance import environment as provenance
from pipeline.workflow.identity import TrialId, arms_of, trials_of
from tasks.analysis.coverage import EVERYTHING
from tasks.analysis.equivalence import VERDICTS
from tasks.analysis.paper import is_t_test
from tasks.analysis.prediction import mean_less_deviations

SCHEMA = "puddle.results"
VERSION = 2
_TRIAL = ("environment", "depth", "trial")
_QUANTITIES = ("predicted", "predicted_sd", "fitness", "zero_shot", "adapted")
_SHARES_OUTSIDE = (0.0, 0.1, 0.3, 0.6, 1.01)  # limits of groups of champions; the last includes 1
_DIGITS = 4  # decimals of a displacement [m]
_DIGITS_OF_DIGEST = 16  # hexadecimal, of a champion's


def results_of(study: Study) -> dict[str, Json]:
    """Return a study's results: champions, each arm's means and deviations, what they are compared with, and digests.

    Displacements are in metres, of the root: ``predicted`` where a champion evolved, for an ensemble the mean μ over
    its members; ``predicted_sd`` is their deviation σ, and ``fitness`` what evolution maximised, μ - kσ, with
    ``penalty`` as k. ``comparison`` has the paper's numbers and statements beside the study's, and ``verdicts`` counts
    them. ``variance`` splits the deviation of each arm of several replicates. Times are in core-seconds. A stage's
    digest is the SHA-256 of the digests of its items, ordered by label, and a champion has the first digits of those of
    its own evolution and transfer.
    """
    upstream = study.upstream
    seconds: dict[str, Json] = {stage.name: round(upstream[stage.name].seconds) for stage in STAGES}
    digests: dict[str, Json] = {stage.name: _digest(study, stage.name) for stage in STAGES}
    champions = study.table(CHAMPIONS).to_pylist() if CHAMPIONS in study.tables else []
    comparison = _comparison(study)
    of_trials = _digests_of_trials(study)
    known = [
        {name: _rounded(row.get(name)) for name in (*_TRIAL, *_QUANTITIES)}
        | {"digests": of_trials[tuple(row[name] for name in _TRIAL)]}
        for row in champions
    ]
    return {
        "schema": SCHEMA,
        "version": VERSION,
        "study": study.name,
        "source": study.record.source,
        "made_with": dict(provenance()),
        "core_seconds": seconds,
        "digests": digests,
        "n_replicates": study.settings.replicates,
        "penalty": study.settings.ensemble.disagreement_penalty,
        "arms": [
            {
                "environment": arm.environment,
                "depth": arm.depth,
                **_moments([r for r in known if _is_of(r, arm.environment, arm.depth)]),
            }
            for arm in arms_of(trials_of(study.settings, "transfer"))
        ],
        "accuracy": _accuracy(study),
        "verdicts": _verdicts(comparison),
        "comparison": list(comparison),
        "variance": _variance(study),
        "coverage": _coverage(study, champions),
        "champions": list(known),
    }


def _is_of(row: Mapping[str, Json], environment: str, depth: float) -> bool:
    return row["environment"] == environment and row["depth"] == depth


def _moments(rows: Sequence[Mapping[str, Json]]) -> dict[str, Json]:
    """Return n, mean and sample deviation of each quantity; those that are missing are left out."""
    found: dict[str, Json] = {}
    for name in _QUANTITIES:
        values = np.array([row[name] for row in rows if row[name] is not None], dtype=np.float64)
        if len(values):
            sd = _rounded(float(values.std(ddof=1))) if len(values) > 1 else None
            found[name] = {"n": len(values), "mean": _rounded(float(values.mean())), "sd": sd}
    return found


def _accuracy(study: Study) -> list[Json]:
    """Return R and slope of the mean over members and of the mean less a deviation, for every ensemble."""
    if "regressions" not in study.tables:
        return []
    shown = (mean_less_deviations(0), mean_less_deviations(1))
    return [
        {name: _rounded(row[name]) for name in ("learned_from", "name", "n", "r", "slope")}
        for row in study.table("regressions").to_pylist()
        if row["name"] in shown
    ]


def _comparison(study: Study) -> list[dict[str, Json]]:
    """Return the paper's numbers and statements, what this study has instead, and the verdicts."""
    if "paper" not in study.tables:
        return []
    shown = ("what", "paper", "this_run", "interval", "p", "verdict")
    return [{name: _rounded(row[name]) for name in shown} for row in study.table("paper").to_pylist()]


def _verdicts(comparison: Sequence[Mapping[str, Json]]) -> dict[str, Json]:
    """Count the paper's t tests and its other results by the verdict of this study."""
    found: dict[str, Json] = {}
    for name, is_test in (("t_tests", True), ("other", False)):
        verdicts = [row["verdict"] for row in comparison if is_t_test(str(row["what"])) == is_test]
        found[name] = {verdict: verdicts.count(verdict) for verdict in VERDICTS}
    return found


def _variance(study: Study) -> list[Json]:
    """Return the deviations between and within the replicates of arms that have several [m]."""
    if "variance" not in study.tables:
        return []
    share = ("share_between", "share_between_low", "share_between_high")
    shown = ("depth", "quantity", "n", "n_replicates", "sd_between", "sd_within", *share)
    return [
        {"environment": row["environment"], **{name: _rounded(row[name]) for name in shown}}
        for row in study.table("variance").to_pylist()
        if row["n_replicates"] > 1
    ]


def _coverage(study: Study, champions: Sequence[Mapping[str, Json]]) -> list[Json]:
    """Group champions by how much of what they do lies outside their throws: n, and mean displacements [m]."""
    if "champion_coverage" not in study.tables:
        return []
    outside = {
        tuple(row[key] for key in _TRIAL): row["share_outside"]
        for row in study.table("champion_coverage").to_pylist()
        if row["component"] == EVERYTHING
    }
    found: list[Json] = []
    for low, high in pairwise(_SHARES_OUTSIDE):
        rows = [
            champion
            for champion in champions
            if low <= outside.get(tuple(champion[key] for key in _TRIAL), np.nan) < high
        ]
        both = [
            (row["predicted"], row["zero_shot"]) for row in rows if None not in (row["predicted"], row["zero_shot"])
        ]
        if both:
            predicted, zero_shot = np.array(both, dtype=np.float64).mean(axis=0).tolist()
            found.append(
                {
                    "share_outside": [low, min(high, 1.0)],
                    "n": len(both),
                    "predicted": _rounded(predicted),
                    "zero_shot": _rounded(zero_shot),
                }
            )
    return found


def _rounded(value: Json) -> Json:
    if not isinstance(value, float):
        return value
    return round(value, _DIGITS) if np.isfinite(value) else None


def _digest(study: Study, stage: str) -> str:
    done = study.upstream[stage].done
    return _joined(part for identity in sorted(done, key=lambda identity: identity.label) for part in done[identity])


def _digests_of_trials(study: Study) -> dict[tuple[Json, ...], dict[str, Json]]:
    """Return the first digits of the digests of each trial's items, by its environment, depth and number."""
    found: dict[tuple[Json, ...], dict[str, Json]] = {}
    for stage in ("evolve", "transfer"):
        for trial, parts in study.upstream[stage].done.items():
            assert isinstance(trial, TrialId)
            of_trial = found.setdefault((trial.environment, trial.depth, trial.index), {})
            of_trial[stage] = _joined(parts)[:_DIGITS_OF_DIGEST]
    return found


def _joined(parts: Iterable[Manifest]) -> str:
    return hashlib.sha256("".join(part.digest for part in parts).encode()).hexdigest()
