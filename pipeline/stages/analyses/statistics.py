"""Statistics of scores and predictions, without simulation: the paper's figures 3 and 4 as tables.

Part of the stage analyse, whose page lists the tables.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pipeline.stages.analyses.analysis_tables import Reasons, Tables
from pipeline.stages.analyses.specs import StatisticsSpec
from pipeline.stages.assess import assessed_among, read_predictions
from pipeline.stages.data_sets import replicate_of
from pipeline.stages.transfer import SCORE, SCORED
from pipeline.stages.trial_scores import NO_CHAMPION, OK_STATUS, SCORE_NAMES, decode_scores
from pipeline.store.tables import Columns, columns_of, text
from pipeline.workflow.identity import InputName, TrialId
from pipeline.workflow.stage import Files, Inputs, Job
from tasks.analysis.against_paper import Row, against_paper
from tasks.analysis.attribution import Attribution, attribute
from tasks.analysis.comparison import CONTRASTS, PAPERS_CONTRASTS, Contrast, sweep
from tasks.analysis.paper import DEPTH, name_of
from tasks.analysis.prediction import (
    Regression,
    accuracy,
    aggregates,
    histograms,
    mean_less_deviations,
    mean_of_ensemble,
    members,
    members_ranges,
)
from tasks.analysis.scores import Scores
from tasks.analysis.variance_split import VarianceRow, variances
from tasks.arrays import Float64, Int64
from tasks.evolution import Deviation
from tasks.seeding import generator


@dataclass(frozen=True)
class ScoreRow:
    """The scores of one champion [m]; NaN where they are missing."""

    environment: str
    depth: float
    trial: int
    replicate: int  # of the throws and networks that it depends on; 0 where it evolved without networks
    fitness: float  # where it evolved: μ - kσ for an ensemble
    predicted: float  # displacement of the root where it evolved: the mean over members for an ensemble, μ
    predicted_sd: float  # its standard deviation over members, σ; NaN without an ensemble
    zero_shot: float  # displacement of the root in True Slush
    zero_shot_com: float  # displacement of the centre of mass in True Slush
    zero_shot_reach: float  # the difference of the two
    adapted: float
    adapted_com: float
    adapted_reach: float
    status: str


def _score_rows(trials: Sequence[TrialId], inputs: Inputs, failed: Mapping[str, str]) -> list[ScoreRow]:
    """Return the scores of every trial, or the reason why it has none."""
    rows = []
    for trial in trials:
        scored, label = inputs.get(InputName(SCORED, trial)), trial.label
        scores = decode_scores(scored[SCORE], label) if scored else None
        status = OK_STATUS if scores else NO_CHAMPION if scored else failed.get(label, "not done")
        values = scores.by_name() if scores else dict.fromkeys(SCORE_NAMES)
        known: dict[str, float] = {name: np.nan if value is None else value for name, value in values.items()}
        reach = {f"{name}_reach": known[name] - known[f"{name}_com"] for name in ("zero_shot", "adapted")}
        rows.append(
            ScoreRow(
                environment=trial.environment,
                depth=trial.depth,
                trial=trial.index,
                replicate=replicate_of(trial),
                status=status,
                **known,
                **reach,
            )
        )
    return rows


def compute(job: Job[StatisticsSpec], inputs: Inputs) -> tuple[Tables, Reasons]:
    """Make every table that needs no rollout."""
    spec = job.spec
    rng = generator(spec.seed, "analyse", "statistics")
    table = columns_of(ScoreRow, _score_rows(spec.trials, inputs, job.spec.failed))
    columns = ("environment", "depth", "trial", "predicted", "zero_shot", "adapted", "replicate")
    scores = Scores(*(table[name] for name in columns))
    main = spec.throw_groups[0] if spec.throw_groups else ""
    shares = assessed_among(inputs, main) if main else []
    predicted, true, trial, replicate = predictions = _predictions(spec, shares)
    others = {group: _predictions(spec, assessed_among(inputs, group)) for group in spec.throw_groups[1:]}
    regressions = _accuracy(spec, main, predictions, rng)
    of_ranges = generator(spec.seed, "analyse", "members-ranges")
    ranges = members_ranges(predicted, true, rng=of_ranges, trial=trial, replicate=replicate)
    reasons: Reasons = {} if shares else dict.fromkeys(("regressions", "histograms"), job.spec.not_assessed)
    if shares and not (np.isfinite(predicted).all(axis=0) & np.isfinite(true)).any():
        lost = "every assessed design diverged, in True Slush or under a member"
        reasons |= dict.fromkeys(("regressions", "histograms"), lost)
    contrasts = sweep(scores, rng=rng)
    made = {(contrast.a, contrast.b) for contrast in contrasts}
    evolved_in = {trial.environment for trial in spec.trials}
    expected = {environment for pair in PAPERS_CONTRASTS for environment, _ in pair} | evolved_in
    wanted = [(a, b) for a, b in CONTRASTS if {a[0], b[0]} <= expected]
    lacking = [f"{name_of(a)} against {name_of(b)}" for a, b in wanted if (a, b) not in made]
    if lacking:
        reasons["contrasts"] = f"no depth has scores of both sides: {'; '.join(lacking)}"
    attributions = attribute(scores, rng=rng)
    if not attributions:
        reasons["attribution"] = "every trial evolved in True Slush: there is no gap"
    at_papers_depth = shares and spec.assessed_depth == DEPTH
    assessed = (regressions, ranges) if at_papers_depth else ((), {})
    return {
        "scores": table,
        "regressions": columns_of(Regression, [*regressions, *_of_other_ensembles(spec, others)]),
        "histograms": _drawn(predictions, others, spec.deviation),
        "contrasts": columns_of(Contrast, contrasts),
        "attribution": columns_of(Attribution, attributions),
        "variance": columns_of(VarianceRow, variances(scores)),
        "paper": columns_of(Row, against_paper(scores, *assessed, rng=rng)),
    }, reasons


_Predictions = tuple[Float64, Float64, list[str], Int64]


def _of_other_ensembles(spec: StatisticsSpec, others: Mapping[str, _Predictions]) -> list[Regression]:
    """Assess the ensembles that learned from other throws than the main one."""
    return [
        row
        for group, predictions in others.items()
        for row in _accuracy(spec, group, predictions, generator(spec.seed, "analyse", "accuracy", group))
    ]


def _accuracy(
    spec: StatisticsSpec, group: str, predictions: _Predictions, rng: np.random.Generator
) -> list[Regression]:
    """Assess the ensemble that learned from a group of throws."""
    predicted, true, trial, replicate = predictions
    rows = accuracy(predicted, true, rng=rng, trial=trial, replicate=replicate, deviation=spec.deviation)
    return [replace(row, learned_from=group) for row in rows]


def _predictions(spec: StatisticsSpec, shares: Sequence[Files]) -> _Predictions:
    """Return (n_members, n_designs) predicted and (n_designs,) true displacement, each design's trial and replicate.

    With several replicates, member k is the k-th of that replicate's ensemble which the design's trial uses.
    """
    if not shares:
        return np.zeros((0, 0)), np.zeros(0), [], np.zeros(0, np.int64)
    table = read_predictions(shares)
    trial = [f"{environment}/{k}" for environment, k in zip(table["environment"], table["trial"], strict=True)]
    return table["predicted"].T, table["true"], trial, table["trial"] % spec.trials[0].n_replicates


def _drawn(predictions: _Predictions, others: Mapping[str, _Predictions], deviation: Deviation) -> Columns:
    """Count true over predicted displacement, for each member, their mean, and their mean minus a deviation.

    Args:
        predictions: those of the main ensemble.
        others: those of the other ensembles, by the group of throws that they learned from; only their means count.
        deviation: what σ over members is.
    """
    predicted, true, _, _ = predictions
    together = aggregates(predicted, deviation) if len(predicted) else {}
    chosen = {name: together[name] for name in (mean_less_deviations(0), mean_less_deviations(1)) if name in together}
    of_others = {
        mean_of_ensemble(group): each.mean(axis=0)
        for group, (each, of_same, *_) in others.items()
        if len(each) and np.array_equal(of_same, true, equal_nan=True)
    }
    found = histograms(members(predicted) | chosen | of_others, true)
    n = len(found.names)
    if found.reason is not None:  # nothing was assessed, or every design diverged, which the regressions state
        none = np.zeros((0, 1), np.int64)
        return {"name": text([]), "n_outside": none[:, 0], "edges": none.astype(np.float64), "counts": none}
    return {
        "name": text(found.names),
        "n_outside": found.n_outside,
        "edges": np.tile(found.edges, (n, 1)),
        "counts": found.counts.reshape(n, -1),
    }
