"""Prediction accuracy of the ensemble. Paper, "Prediction Accuracy" and Fig. 3.

Displacement in True Slush is regressed on the prediction of each member, and on aggregates of the members. A slope
below 1 means that predictions are too optimistic, a low R that they rank designs badly.

Designs of one trial descend from each other, so they are not independent samples. Where the trial of each design is
given, the intervals come from resampling whole trials; resampling designs gives intervals that are too narrow.

Trials of several replicates are predicted by different ensembles. Their intervals are those of
:mod:`tasks.analysis.replicates`, which include the variance between replicates; those of R are symmetric on Fisher's
scale, artanh R, where R is nearly normal (Fisher 1921). Resampling replicates, and trials within them, would not do:
two replicates, resampled, have half of the variance that they are a sample of. How often these intervals contain the
truth is in docs/results.md.

The paper draws 2,376 designs uniformly over the generations of trials in True Slush and on Dry Land, so that the sample
contains early designs that hardly move and late ones that go far.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt
from numpy.random import Generator

from tasks.analysis.replicates import of_means
from tasks.analysis.uncertainty import RESOLUTION, Estimate, bootstrap, is_constant
from tasks.arrays import Bools, Float64, Floats, Int64
from tasks.evolution import Deviation, penalised_mean

Figure = Literal["r", "slope"]  # A figure of a regression: Pearson's R, or the slope of true on predicted

_PENALTIES = (0.0, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0)  # k of μ - kσ; the paper's are 0 and 1
_TAIL = 0.25  # share of the most pessimistic members in the lower quantile and CVaR: two of eight
_MIN_DESIGNS = 3  # any two points lie on a line
_HIGHEST_R = 1 - 1e-12  # of Fisher's transformation, which is infinite at 1


@dataclass(frozen=True)
class Regression:
    """True displacement = intercept + slope · predicted displacement, over designs that diverged in neither."""

    name: str  # name of the predictor, such as "member 0", "mean", "mean - 1 sd" or "min"
    n: int  # designs in the regression
    n_left_out: int  # designs whose predicted or true displacement is not finite
    n_resampled: int  # units that the intervals count as samples: trials, or designs if their trials are unknown
    slope: Estimate
    intercept: Estimate  # [m]
    r: Estimate  # pearson's R
    learned_from: str = "throws"  # settings group of the throws that the ensemble learned from
    n_replicates: int = 1  # replicates of the units; with several, the intervals include the variance between them


@dataclass(frozen=True)
class MembersRange:
    """Range of a figure over the members of an ensemble; the intervals are for other designs, not other members."""

    n: int  # members with a figure
    lowest: Estimate
    median: Estimate
    highest: Estimate


@dataclass(frozen=True, eq=False)
class Histograms:
    """2-D histograms of predicted and true displacement on the same square, one for each predictor."""

    names: tuple[str, ...]
    edges: Float64  # (n_bins + 1,) edges of both axes [m]
    counts: Int64  # (n_predictors, n_bins, n_bins) designs by predicted and true displacement
    n_outside: Int64  # (n_predictors,) designs outside the edges or not finite
    reason: str | None  # why there are no histograms, if so; counts then have no bins


def mean_of_ensemble(group: str) -> str:
    """Name the mean over the ensemble that learned from a group of throws which is not the main one."""
    return f"mean, {group}"


def mean_less_deviations(k: float) -> str:
    """Name the predictor μ - kσ."""
    return f"mean - {k:g} sd" if k else "mean"


_MEMBER = "member "


def members(predicted: Floats) -> dict[str, Float64]:
    """Name each member's row of (n_members, n_designs) predictions."""
    return {f"{_MEMBER}{k}": np.asarray(row, dtype=np.float64) for k, row in enumerate(predicted)}


def is_member(name: str) -> bool:
    """Return whether a prediction is that of one member, by its name."""
    return name.startswith(_MEMBER)


def aggregates(predicted: Floats, deviation: Deviation = "population") -> dict[str, Float64]:
    """Aggregate (n_members, n_designs) predictions [m] in several ways, by name; not finite where any member diverged.

    CVaR is the mean of the lowest quarter of the members; the last member counts in part if that is not a whole number.
    The deviation says what σ is in μ - kσ.
    """
    of_members = np.asarray(predicted, dtype=np.float64)
    ranked = np.sort(of_members, axis=0)  # NaN last, and so into every weighted sum below
    weight = np.clip(_TAIL * len(ranked) - np.arange(len(ranked)), 0, 1)
    return {
        **{
            mean_less_deviations(k): penalised_mean(of_members.T, disagreement_penalty=k, deviation=deviation)
            for k in _PENALTIES
        },
        "min": of_members.min(axis=0),
        "median": np.median(of_members, axis=0),
        f"quantile {_TAIL:g}": np.quantile(of_members, _TAIL, axis=0),
        f"CVaR {_TAIL:g}": (weight @ ranked) / weight.sum(),
    }


def regress(
    predictors: Mapping[str, Floats],
    true: Floats,
    *,
    rng: Generator,
    trial: npt.ArrayLike | None = None,
    replicate: npt.ArrayLike | None = None,
) -> tuple[Regression, ...]:
    """Return the regression of true displacement on each predictor, with intervals from the same resamples.

    Args:
        predictors: (n_designs,) predicted displacement [m] by name; not finite where diverged.
        true: (n_designs,) displacement in True Slush [m].
        rng: source of randomness.
        trial: (n_designs,) trial of each design; designs count as independent if not given.
        replicate: (n_designs,) replicate of each design, the same for all of a trial; one if not given.
    """
    if not predictors:
        return ()
    x, y, used, units, lines = _lines_of_units(predictors, true, trial, replicate)
    figures: tuple[Estimate, ...] = (Estimate.missing("no designs"),) * (3 * len(x))
    if len(y):
        is_r = np.arange(3 * len(x)) % 3 == 2
        figures = _estimates(lambda means: lines(means).reshape(*means.shape[:-1], -1), units, is_r, rng)
    return tuple(
        _regression(name, x[i][used[i]], y[used[i]], len(y), units, figures[3 * i : 3 * i + 3])
        for i, name in enumerate(predictors)
    )


@dataclass(frozen=True, eq=False)
class _Units:
    """What the intervals count as samples: trials, or designs if their trials are unknown."""

    rows: Float64  # (n_units, n_columns), whose means decide the figures
    replicate: Int64  # (n_units,)

    @property
    def n_replicates(self) -> int:
        return len(np.unique(self.replicate))


def _estimates(
    statistic: Callable[[Float64], Float64], units: _Units, is_r: Bools, rng: Generator
) -> tuple[Estimate, ...]:
    """Estimate functions of means, of which some are Pearson's R, with the variance between replicates if any."""
    undefined = "there is no spread"
    if units.n_replicates < 2:
        return bootstrap(statistic, units.rows, rng=rng, undefined=undefined)

    def on_fishers_scale(means: Float64) -> Float64:
        figures = statistic(means)
        return np.where(is_r, np.arctanh(np.clip(figures, -_HIGHEST_R, _HIGHEST_R)), figures)

    found = of_means(on_fishers_scale, units.rows, units.replicate, undefined=undefined)
    return tuple(_from_fishers_scale(estimate) if r else estimate for estimate, r in zip(found, is_r, strict=True))


def _from_fishers_scale(found: Estimate) -> Estimate:
    value, low, high = (None if end is None else math.tanh(end) for end in (found.value, found.low, found.high))
    return Estimate(value, low, high, found.reason)


def _lines_of_units(
    predictors: Mapping[str, Floats], true: Floats, trial: npt.ArrayLike | None, replicate: npt.ArrayLike | None
) -> tuple[Float64, Float64, Bools, _Units, Callable[[Float64], Float64]]:
    """Return predictions, truth, a mask of finite pairs, independent units, and the lines of (..., n_columns) means.

    A line has a slope, an intercept and Pearson's R: (..., n_predictors, 3).
    """
    x = np.stack([np.asarray(row, dtype=np.float64) for row in predictors.values()])
    y = np.asarray(true, dtype=np.float64)
    if y.shape != x.shape[1:]:
        raise ValueError(f"true has shape {y.shape}, expected that of each predictor, {x.shape[1:]}")
    used = np.isfinite(x) & np.isfinite(y)
    # Centred and scaled, so that sums of squares lose no digits and a resample without spread is recognised.
    x0, sx = zip(*(_centre_and_scale(row[mask]) for row, mask in zip(x, used, strict=True)), strict=True)
    y0, sy = zip(*(_centre_and_scale(y[mask]) for mask in used), strict=True)
    centre = np.array((x0, y0, sx, sy))
    u = np.where(used, (np.where(used, x, 0.0) - centre[0, :, None]) / centre[2, :, None], 0.0)
    w = np.where(used, (np.where(used, y, 0.0) - centre[1, :, None]) / centre[3, :, None], 0.0)
    sums = np.stack((used, u, w, u * u, w * w, u * w), axis=-1)  # (n_predictors, n_designs, 6)
    rows = sums.transpose(1, 0, 2).reshape(len(y), 6 * len(x))
    own = np.zeros(len(y), dtype=np.int64) if replicate is None else np.asarray(replicate)
    if trial is not None:
        labels, first, group = np.unique(np.asarray(trial), return_index=True, return_inverse=True)
        grouped = np.zeros((len(labels), rows.shape[1]))
        np.add.at(grouped, group, rows)
        rows, own = grouped, own[first]
    return x, y, used, _Units(rows, own), lambda means: _line(means.reshape(*means.shape[:-1], len(x), 6), centre)


def _centre_and_scale(values: Float64) -> tuple[float, float]:
    if len(values) == 0:
        return 0.0, 1.0
    return float(values.mean()), 1.0 if is_constant(values) else float(values.std())


def _line(moments: Float64, centre: Float64) -> Float64:
    """Fit least squares to (..., 6) means of 1, u, w, u², w², uw: (..., 3) slope, intercept, Pearson's R."""
    x0, y0, sx, sy = centre
    share, u, w, uu, ww, uw = np.moveaxis(moments, -1, 0)
    u, w, uu, ww, uw = (m / share for m in (u, w, uu, ww, uw))
    spread = 1e-20  # of variances that are near 1 unless a resample repeats one point
    var_u = np.where(uu - u * u > spread, uu - u * u, np.nan)
    var_w = np.where(ww - w * w > spread, ww - w * w, np.nan)
    cov = uw - u * w
    slope = cov / var_u * sy / sx
    r = np.clip(cov / np.sqrt(var_u * var_w), -1, 1)
    intercept = (y0 + sy * w) - slope * (x0 + sx * u)
    return np.stack((slope, intercept, r), axis=-1)


def _regression(
    name: str, x: Float64, y: Float64, n_designs: int, units: _Units, figures: tuple[Estimate, ...]
) -> Regression:
    slope, intercept, r = figures
    n = len(x)
    reason = None
    if n < _MIN_DESIGNS:
        reason = f"{n} designs with a finite predicted and true displacement, expected {_MIN_DESIGNS} or more"
    elif is_constant(x, resolution=RESOLUTION):
        reason = "every design is predicted to go equally far"
    if reason is not None:
        slope = intercept = r = Estimate.missing(reason)
    elif is_constant(y, resolution=RESOLUTION):
        r = Estimate.missing("every design truly goes equally far")
    n_replicates = max(units.n_replicates, 1)
    return Regression(name, n, n_designs - n, len(units.rows), slope, intercept, r, n_replicates=n_replicates)


def accuracy(
    predicted: Floats,
    true: Floats,
    *,
    rng: Generator,
    trial: npt.ArrayLike | None = None,
    replicate: npt.ArrayLike | None = None,
    deviation: Deviation = "population",
) -> tuple[Regression, ...]:
    """Return the regression of true displacement on each member's prediction and on every aggregate (Fig. 3).

    Args:
        predicted: (n_members, n_designs) displacement [m]; NaN where diverged.
        true: (n_designs,) displacement in True Slush [m]; NaN where diverged.
        rng: source of randomness.
        trial: (n_designs,) trial of each design; see :func:`regress`.
        replicate: (n_designs,) replicate of each design; see :func:`regress`.
        deviation: what σ is in μ - kσ.
    """
    aggregated = aggregates(predicted, deviation) if len(predicted) else {}
    return regress(members(predicted) | aggregated, true, rng=rng, trial=trial, replicate=replicate)


def members_ranges(
    predicted: Floats,
    true: Floats,
    *,
    rng: Generator,
    trial: npt.ArrayLike | None = None,
    replicate: npt.ArrayLike | None = None,
) -> dict[Figure, MembersRange]:
    """Return the lowest, median and highest figure of the members' regressions.

    Designs are resampled, members are not: resampled members could never exceed the range of the original ones.

    Args:
        predicted: (n_members, n_designs) displacement [m]; NaN where diverged.
        true: (n_designs,) displacement in True Slush [m]; NaN where diverged.
        rng: source of randomness.
        trial: (n_designs,) trial of each design; see :func:`regress`.
        replicate: (n_designs,) replicate of each design; see :func:`regress`.
    """
    used = np.isfinite(predicted) & np.isfinite(true)
    fit = {
        name: row
        for (name, row), mask in zip(members(predicted).items(), used, strict=True)
        if mask.sum() >= _MIN_DESIGNS and not is_constant(row[mask], resolution=RESOLUTION)
    }
    if not fit:
        missing = Estimate.missing("no member has a regression")
        return dict.fromkeys(("slope", "r"), MembersRange(0, missing, missing, missing))
    *_, units, lines = _lines_of_units(fit, true, trial, replicate)

    def ends(means: Float64) -> Float64:
        figures = lines(means)[..., (0, 2)]  # (..., n_members, 2): slope and R
        return np.concatenate([statistic(figures, axis=-2) for statistic in (np.min, np.median, np.max)], axis=-1)

    found = _estimates(ends, units, np.arange(6) % 2 == 1, rng)
    return {"slope": MembersRange(len(fit), *found[0::2]), "r": MembersRange(len(fit), *found[1::2])}


def histograms(predictors: Mapping[str, Floats], true: Floats, *, n_bins: int = 48) -> Histograms:
    """Return counts of designs by predicted and true displacement, on the same square for every predictor.

    The square spans 99.8 % of all displacements, so that a single extreme prediction does not stretch it.

    Args:
        predictors: (n_designs,) predicted displacement [m] by name.
        true: (n_designs,) displacement in True Slush [m].
        n_bins: number of bins along each side.
    """
    names = tuple(predictors)
    x = np.array([*predictors.values()], dtype=np.float64).reshape(len(names), len(true))
    y = np.broadcast_to(np.asarray(true, dtype=np.float64), x.shape)
    used = np.isfinite(x) & np.isfinite(y)
    everything = np.concatenate((x[used], y[used]))
    if len(everything) == 0:
        none = np.zeros((len(names), 0, 0), np.int64)
        reason = "no design with a finite predicted and true displacement"
        return Histograms(names, np.zeros(0), none, np.full(len(names), len(true), np.int64), reason)
    low, high = np.quantile(everything, (0.001, 0.999))
    margin = 0.02 * (high - low) or 0.5  # a single value gets a metre around it
    edges = np.linspace(low - margin, high + margin, n_bins + 1)
    counts = np.stack(
        [
            np.histogram2d(a[mask], b[mask], bins=(edges, edges))[0].astype(np.int64)
            for a, b, mask in zip(x, y, used, strict=True)
        ]
    )
    return Histograms(names, edges, counts, len(true) - counts.sum(axis=(1, 2)), None)


def spread_evenly(n_designs: int, n_trials: int) -> list[int]:
    """Split a number of designs over trials into parts that differ by at most one."""
    return [n_designs * (i + 1) // n_trials - n_designs * i // n_trials for i in range(n_trials)]


def draw_over_generations(generation: npt.ArrayLike, n_designs: int, rng: Generator) -> Int64:
    """Return indices of designs drawn without replacement from a trial, each generation with equal probability.

    Args:
        generation: (n_evaluated,) generation of each design of the trial.
        n_designs: number of designs to draw; all are drawn if there are fewer.
        rng: source of randomness.
    """
    _, which, n_in = np.unique(np.asarray(generation), return_inverse=True, return_counts=True)
    share = 1 / n_in[which]
    n_drawn = min(n_designs, len(which))
    return np.sort(rng.choice(len(which), size=n_drawn, replace=False, p=share / share.sum()))
