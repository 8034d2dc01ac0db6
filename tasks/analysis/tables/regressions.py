"""Accuracy of the ensembles. Paper, "Prediction Accuracy" and Fig. 3.

Displacement in the target is regressed on the prediction of each member, on their mean μ, and on μ - σ. A slope below 1
means that predictions are too optimistic, a low R that they rank designs badly. Designs of one trial descend from each
other, so the intervals come from resampling whole trials. Trials of several replicates are predicted by different
ensembles; their intervals are by pseudo-values, those of R on Fisher's scale, where R is nearly normal.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import astuple, dataclass

import numpy as np

from tasks.analysis.estimates import MISSING, RESOLUTION, Estimate, bootstrap, is_constant, of_means
from tasks.analysis.registry import Assessed, StudyData, analysis, column
from tasks.arrays import Bools, Float64, Int64
from tasks.evolution import Deviation, penalised_mean
from tasks.residual import ensemble_of_data_set
from tasks.world import environment_kind

MEAN, CAUTIOUS = "mean", "mean - 1 sd"  # the paper's two aggregates, μ and μ − σ
_METRICS = {CAUTIOUS: "mean_less_1_sd"}
_MIN_DESIGNS = 3  # any two points lie on a line
_HIGHEST_R = 1 - 1e-12  # of Fisher's transformation, which is infinite at 1


def ensemble_name(group: str) -> str:
    """Name the ensemble that learned from a data set."""
    return environment_kind(ensemble_of_data_set(group)).label


def predictor_name(name: str) -> str:
    """Write a predictor by its symbol, if it is an aggregate of the members."""
    return {MEAN: "μ", CAUTIOUS: "μ − σ"}.get(name, name)


@dataclass(frozen=True)
class Regression:
    """True displacement = intercept + slope · predicted displacement, over designs that diverged in neither."""

    learned_from: str = column("ensemble", form=ensemble_name, meaning="Data set that it learned from.")
    name: str = column("by", form=predictor_name, meaning="A member, their mean μ, or μ less a deviation over members.")
    r: Estimate = column("R", form="{:z.2f}", meaning="Pearson's correlation.")
    slope: Estimate = column("slope", form="{:z.2f}", meaning="Below 1, predictions are too optimistic.")
    intercept: Estimate = column("intercept", "m", form="{:z.2f}", shown=False)


def _metrics(rows: Sequence[Regression]) -> dict[str, float | None]:
    """Return R and slope of the main ensemble."""
    main = [row for row in rows if row.learned_from == rows[0].learned_from]
    return {
        f"accuracy.{figure}.{_METRICS.get(row.name, row.name.replace(' ', '-'))}": getattr(row, figure).value
        for row in main
        for figure in ("r", "slope")
    }


@analysis(
    "regressions",
    row=Regression,
    reads=("assess",),
    answers="How well do the networks predict where designs get?",
    section="networks",
    shown=lambda row: row.name in (MEAN, CAUTIOUS),
    metrics=_metrics,
)
def regressions(study: StudyData) -> list[Regression]:
    """Assess the ensembles of all data sets."""
    return [row for data_set in study.settings.data_sets for row in regressions_of(study, data_set)]


def regressions_of(study: StudyData, data_set: str) -> list[Regression]:
    """Regress true displacement on every predictor of a data set's ensemble, with intervals from the same resamples."""
    assessed, rng = study.assessed(data_set), study.rng("accuracy", data_set)
    return [] if assessed is None else accuracy(assessed, data_set, study.settings.deviation, rng)


def predictors_of(predicted: Float64, deviation: Deviation) -> dict[str, Float64]:
    """Return the predictions of each of n_members members, (n_members, n_designs), and their aggregates, by name."""
    cautious = penalised_mean(predicted.T, disagreement_penalty=1.0, deviation=deviation)
    return {**{f"member {k}": row for k, row in enumerate(predicted)}, MEAN: predicted.mean(axis=0), CAUTIOUS: cautious}


def accuracy(assessed: Assessed, group: str, deviation: Deviation, rng: np.random.Generator) -> list[Regression]:
    """Assess the ensemble that learned from a data set."""
    predictors, y = predictors_of(assessed.predicted, deviation), assessed.true
    moments, lines = list[Float64](), dict[str, Callable[[Float64], Float64]]()
    for name, x in predictors.items():
        used = np.isfinite(x) & np.isfinite(y)
        if used.sum() >= _MIN_DESIGNS and not is_constant(x[used], resolution=RESOLUTION):
            rows, lines[name] = _moments(x, y, used)
            moments.append(rows)
    trials, first, trial = np.unique(assessed.trial, return_index=True, return_inverse=True)

    def figures(means: Float64) -> Float64:
        """Return R, slope and intercept of each predictor in turn."""
        parts = np.split(means, len(lines), axis=-1)
        return np.concatenate([line(part) for line, part in zip(lines.values(), parts, strict=True)], axis=-1)

    found: dict[str, Sequence[Estimate]] = {}
    if lines:
        sums = np.zeros((len(trials), 6 * len(lines)))
        np.add.at(sums, trial, np.concatenate(moments, axis=1))
        estimates = _estimated(figures, sums, assessed.replicate[first], rng)
        found = {name: estimates[3 * i : 3 * i + 3] for i, name in enumerate(lines)}
    spread = not is_constant(y[np.isfinite(y)], resolution=RESOLUTION)
    of_all = {name: found.get(name, (MISSING,) * 3) for name in predictors}
    return [Regression(group, name, r if spread else MISSING, *line) for name, (r, *line) in of_all.items()]


def _moments(x: Float64, y: Float64, used: Bools) -> tuple[Float64, Callable[[Float64], Float64]]:
    """Return (n_designs, 6) of 1, u, w, u², w², uw, and the line of their means; u, w are x, y centred and scaled.

    Sums of squares then lose no digits, and a resample without spread is recognised.
    """
    x0, sx = float(x[used].mean()), float(x[used].std())
    y0, sy = float(y[used].mean()), float(y[used].std()) or 1.0
    u, w = np.where(used, (x - x0) / sx, 0.0), np.where(used, (y - y0) / sy, 0.0)

    def line(means: Float64) -> Float64:
        """Fit least squares to (..., 6) means: (..., 3) Pearson's R, slope, intercept."""
        share, *sums = np.moveaxis(means, -1, 0)
        u1, w1, uu, ww, uw = (one / share for one in sums)
        var_u, var_w = (np.where(v > 1e-20, v, np.nan) for v in (uu - u1 * u1, ww - w1 * w1))
        slope = (uw - u1 * w1) / var_u * sy / sx
        r = np.clip((uw - u1 * w1) / np.sqrt(var_u * var_w), -1, 1)
        return np.stack((r, slope, (y0 + sy * w1) - slope * (x0 + sx * u1)), axis=-1)

    return np.stack((used, u, w, u * u, w * w, u * w), axis=-1), line


def _estimated(
    figures: Callable[[Float64], Float64], rows: Float64, replicate: Int64, rng: np.random.Generator
) -> Sequence[Estimate]:
    if len(np.unique(replicate)) < 2:
        return bootstrap(figures, rows, rng=rng)

    def on_fishers_scale(means: Float64) -> Float64:
        found = figures(means)
        found[..., ::3] = np.arctanh(np.clip(found[..., ::3], -_HIGHEST_R, _HIGHEST_R))
        return found

    return [
        Estimate(*(end if end is None else math.tanh(end) for end in astuple(one))) if i % 3 == 0 else one
        for i, one in enumerate(of_means(on_fishers_scale, rows, replicate))
    ]
