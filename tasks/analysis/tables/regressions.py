"""Accuracy of the ensembles. Paper, "Prediction Accuracy" and Fig. 3.

Displacement in the target is regressed on the prediction of each member, on their mean μ, and on μ - σ. A slope below 1
means that predictions differ too much between designs, a low R that they rank designs badly. Designs of one trial
descend from each other, so the intervals come from resampling whole trials. Trials of several replicates are predicted
by different ensembles; their intervals are by pseudo-values, those of R on Fisher's scale, where R is nearly normal.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import astuple, dataclass

import numpy as np

from tasks.analysis.columns import column
from tasks.analysis.estimates import MISSING, RESOLUTION, Estimate, bootstrap, of_means
from tasks.analysis.registry import analysis
from tasks.analysis.study import Assessed, StudyData
from tasks.arrays import Float64, Int64
from tasks.evolution import penalised_mean
from tasks.residual.learner import NO_LEARNERS, Learner, arm_kind

MEAN, CAUTIOUS = "mean", "mean - 1 sd"  # the paper's two aggregates, μ and μ − σ
_METRICS = {CAUTIOUS: "mean_less_1_sd"}
_MIN_DESIGNS = 3  # any two points lie on a line
_HIGHEST_R = 1 - 1e-12  # of Fisher's transformation, which is infinite at 1


def ensemble_name(name: str, learners: Mapping[str, Learner] = NO_LEARNERS) -> str:
    """Name the ensemble of a learner."""
    return arm_kind(name, learners).label


def predictor_name(name: str) -> str:
    """Write a predictor by its symbol, if it is an aggregate of the members."""
    return {MEAN: "μ", CAUTIOUS: "μ − σ"}.get(name, name)


@dataclass(frozen=True)
class Regression:
    """True displacement = intercept + slope · predicted displacement, over designs that diverged in neither."""

    learned_from: str = column("ensemble", form=ensemble_name, meaning="The learner whose throws it learned from.")
    name: str = column("by", form=predictor_name, meaning="A member, their mean μ, or μ less a deviation over members.")
    r: Estimate = column("R", form="{:z.2f}", meaning="Pearson's correlation.")
    slope: Estimate = column("slope", form="{:z.2f}", meaning="Below 1, predictions differ too much between designs.")
    intercept: Estimate = column("intercept", "m", form="{:z.2f}", shown=False)
    within: float | None = column(
        "within 2σ", form="{:.0%}", meaning="Share of designs that get to μ ± 2σ; ideally 95 %."
    )


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
    reads=("predictions",),
    answers="How well do the networks predict where designs get?",
    section="networks",
    shown=lambda row: row.name in (MEAN, CAUTIOUS),
    metrics=_metrics,
)
def regressions(study: StudyData) -> list[Regression]:
    """Assess the ensembles of all data sets."""
    return [row for data_set in study.settings.data_sets for row in regressions_of(study, data_set)]


def regressions_of(study: StudyData, data_set: str) -> list[Regression]:
    """Regress true displacement on every predictor of a data set's ensemble.

    Intervals come from the same resamples for all predictors and ensembles, which predict the same designs.
    """
    assessed, rng = study.assessed(data_set), study.rng("accuracy", "throws")
    return [] if assessed is None else accuracy(assessed, data_set, rng)


def predictors_of(predicted: Float64) -> dict[str, Float64]:
    """Return the predictions of each of n_members members, (n_members, n_designs), and their aggregates, by name."""
    cautious = penalised_mean(predicted.T, disagreement_penalty=1.0)
    return {**{f"member {k}": row for k, row in enumerate(predicted)}, MEAN: predicted.mean(axis=0), CAUTIOUS: cautious}


def accuracy(assessed: Assessed, data_set: str, rng: np.random.Generator) -> list[Regression]:
    """Assess the ensemble that learned from a data set, by the designs that diverged nowhere."""
    predictors = predictors_of(assessed.predicted)
    x, y = np.stack(list(predictors.values())), assessed.true
    used = np.isfinite(y) & np.isfinite(x).all(axis=0)
    estimates: Sequence[Estimate] = [MISSING] * 3 * len(x)
    has_r = False
    if used.sum() >= _MIN_DESIGNS:
        has_r = bool(np.ptp(y[used]) > RESOLUTION)
        _, first, trial = np.unique(np.array(assessed.trial)[used], return_index=True, return_inverse=True)
        rows, figures = _moments(x[:, used], y[used])
        sums = np.zeros((len(first), rows.shape[1]))
        np.add.at(sums, trial, rows)
        estimates = _estimated(figures, sums, assessed.replicate[used][first], rng)
    off, sigma = abs(predictors[MEAN] - y)[used], assessed.predicted[:, used].std(axis=0)
    within = {MEAN: float((off <= 2 * sigma).mean())} if used.any() else {}
    of_each = zip(predictors, estimates[::3], estimates[1::3], estimates[2::3], strict=True)
    return [
        Regression(data_set, name, r if has_r else MISSING, slope, intercept, within.get(name))
        for name, r, slope, intercept in of_each
    ]


def _moments(x: Float64, y: Float64) -> tuple[Float64, Callable[[Float64], Float64]]:
    """Return rows of 1, u, w, u², w², uw for each predictor, and the regressions by their means.

    u, w are (n_predictors, n_designs) x and y, centred and scaled. Sums of squares then lose no digits, and a resample
    without spread is recognised.
    """
    x0, sx = x.mean(axis=1), np.where(np.ptp(x, axis=1) > RESOLUTION, x.std(axis=1), np.nan)
    y0, sy = y.mean(), y.std() or 1.0
    u, w = (x - x0[:, None]) / sx[:, None], np.broadcast_to((y - y0) / sy, x.shape)

    def figures(means: Float64) -> Float64:
        """Fit least squares to (..., n_predictors * 6) means: (..., n_predictors * 3) Pearson's R, slope, intercept."""
        share, *sums = np.moveaxis(means.reshape(*means.shape[:-1], len(x), 6), -1, 0)
        u1, w1, uu, ww, uw = (total / share for total in sums)
        var_u, var_w = (np.where(v > 1e-20, v, np.nan) for v in (uu - u1 * u1, ww - w1 * w1))
        slope = (uw - u1 * w1) / var_u * sy / sx
        r = np.clip((uw - u1 * w1) / np.sqrt(var_u * var_w), -1, 1)
        return np.stack((r, slope, (y0 + sy * w1) - slope * (x0 + sx * u1)), axis=-1).reshape(*means.shape[:-1], -1)

    return np.stack((np.ones_like(u), u, w, u * u, w * w, u * w), axis=-1).swapaxes(0, 1).reshape(len(y), -1), figures


def _estimated(
    figures: Callable[[Float64], Float64], rows: Float64, replicate: Int64, rng: np.random.Generator
) -> Sequence[Estimate]:
    if len(np.unique(replicate)) < 2:
        return bootstrap(figures, rows, rng=rng)

    def on_fishers_scale(means: Float64) -> Float64:
        scaled = figures(means)
        scaled[..., ::3] = np.arctanh(np.clip(scaled[..., ::3], -_HIGHEST_R, _HIGHEST_R))
        return scaled

    return [
        Estimate(*(end if end is None else math.tanh(end) for end in astuple(estimate))) if i % 3 == 0 else estimate
        for i, estimate in enumerate(of_means(on_fishers_scale, rows, replicate))
    ]
