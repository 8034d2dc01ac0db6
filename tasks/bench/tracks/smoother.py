"""A Rauch-Tung-Striebel smoother for tracked coordinates: positions, velocities and their covariances at any times.

Each coordinate of each throw (x, y and the angle) is a state (p, v, a), whose acceleration is a random walk:

    p' = v,  v' = a,  a' = white noise of spectral density q / w,  measured p = p + noise of deviation r

Where a throw meets the water its acceleration jumps, which no Gaussian of one size expects. So the noise of the
acceleration has Student's t distribution: each interval between two frames has a weight w of its own, and the noise in
it has the density q / w. The weights are found by expectation-maximisation (Lange, Little & Taylor 1989, "Robust
Statistical Modeling Using the t Distribution"): w = (ν + 3) / (ν + d²), where d² is the interval's expected squared
deviation. q and r, where r is not given, maximise the likelihood of all throws' innovations; all throws share them.

Rauch, Tung & Striebel 1965, "Maximum likelihood estimates of linear dynamic systems".
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from tasks.arrays import Bools, Float64, Ints

_N_STATES = 3  # position, velocity, acceleration
_FREEDOM = 2.0  # ν: degrees of freedom of the acceleration's noise; small, because water is met at once
_N_SWEEPS = 4  # of expectation-maximisation
_LEAST_NOISE = 1e-6  # deviation of a measurement, as a share of the greatest way between two frames
_LOG_RATIOS = {True: (-7.0, 16.0), False: (-9.0, 7.0)}  # of process noise to measurements' noise, or to the scale
_I = np.eye(_N_STATES)


@dataclass(frozen=True, eq=False)
class Measured:
    """One coordinate of several throws, padded to the longest; axis 0 is the throw."""

    time: Float64  # (n_throws, n_frames) [s], increasing; padding repeats the last time
    value: Float64  # (n_throws, n_frames) [m] or [rad]
    seen: Bools  # (n_throws, n_frames) False in padding
    sd: Float64 | None = None  # (n_throws, n_frames) deviation of each measurement; None to estimate one for all


@dataclass(frozen=True, eq=False)
class Smoothed:
    """States at the given times; axis 0 is the throw, axis 1 the time."""

    mean: Float64  # (n_throws, n_times, 3) position, velocity, acceleration
    covariance: Float64  # (n_throws, n_times, 3, 3)
    with_next: Float64  # (n_throws, n_times, 3, 3) covariance with the state at the next time; 0 for the last
    noise: float  # deviation r of a measurement [m] or [rad]; the root mean square of those given


def smooth(measured: Measured, times: Float64) -> Smoothed:
    """Estimate the states of a coordinate of all throws, their covariances, and the noise.

    ``times`` is (n_throws, n_times), increasing within each throw's frames; padding repeats the last time [s].
    """
    scale = _Scale.of(measured)
    at_frames = _Chain(measured.time, measured.value - measured.value[:, :1], measured.seen, measured.sd, scale)
    weight = np.ones_like(at_frames.interval)
    noise = _Noise(process=0.3, measurement=1e-3 if measured.sd is None else 1.0)
    for _ in range(_N_SWEEPS):
        noise = _most_likely(at_frames, weight, noise)
        weight = at_frames.weights(noise, weight)
    return _at(measured, times, scale, _most_likely(at_frames, weight, noise), weight)


@dataclass(frozen=True)
class _Noise:
    """The noise in units of the scale."""

    process: float
    measurement: float  # where deviations are given, their factor, 1


@dataclass(frozen=True)
class _Scale:
    """Scales that make the problem dimensionless: the time between frames, and the greatest way in it."""

    time: float
    way: float

    @staticmethod
    def of(measured: Measured) -> _Scale:
        both = measured.seen[:, 1:] & measured.seen[:, :-1]
        interval, way = np.diff(measured.time)[both], np.abs(np.diff(measured.value)[both])
        return _Scale(float(np.median(interval)), max(float(np.max(way)), 1e-9))


def _most_likely(chain: _Chain, weight: Float64, before: _Noise) -> _Noise:
    """Return the noise that maximises the likelihood of the innovations.

    If all deviations are multiplied by one factor, so are those of the innovations: where the measurements' noise is
    not given, the factor follows from their mean square, and only the ratio of both kinds of noise is searched.
    """

    def innovations(log_ratio: float) -> tuple[float, float]:
        noise = _Noise(np.exp(log_ratio) * before.measurement, before.measurement)
        *_, squares, log_variances, n = chain.filter(noise, weight)
        if chain.sd is not None:
            return 1.0, squares + log_variances
        factor = max(squares / n, np.square(_LEAST_NOISE / before.measurement))
        return factor, log_variances + n * np.log(factor) + squares / factor

    likeliest = scipy.optimize.minimize_scalar(
        lambda at: innovations(at)[1], bounds=_LOG_RATIOS[chain.sd is None], options={"xatol": 0.05}
    )
    factor = np.sqrt(innovations(float(likeliest.x))[0])
    measurement = float(before.measurement * factor)
    return _Noise(float(np.exp(likeliest.x)) * measurement, measurement)


class _Chain:
    """Points in time, some of them measured, of all throws at once; all in units of the scale."""

    def __init__(self, time: Float64, value: Float64, seen: Bools, sd: Float64 | None, scale: _Scale) -> None:
        self.interval = d = np.diff(time) / scale.time
        self.value = value / scale.way
        self.seen = seen
        self.sd = None if sd is None else np.maximum(sd / scale.way, _LEAST_NOISE)
        zero, one = np.zeros_like(d), np.ones_like(d)
        self.step = _matrices(((one, d, d**2 / 2), (zero, one, d), (zero, zero, one)))
        # The covariance that white noise of density 1 in the acceleration's rate adds over an interval.
        rows = ((d**5 / 20, d**4 / 8, d**3 / 6), (d**4 / 8, d**3 / 3, d**2 / 2), (d**3 / 6, d**2 / 2, d))
        self.spread = _matrices(rows)

    def filter(self, noise: _Noise, weight: Float64) -> tuple[Float64, Float64, Float64, Float64, float, float, int]:
        """Return the predicted and filtered means and covariances, and sums over innovations.

        The sums are those of squared innovations over their variances, of the variances' logarithms, and the number;
        the innovations that fix a throw's first state do not count.
        """
        n, n_points = self.value.shape
        of_measurement = np.ones(self.value.shape) if self.sd is None else self.sd
        variance, q = np.square(noise.measurement * of_measurement), noise.process**2
        mean, covariance = np.zeros((n, _N_STATES)), np.broadcast_to(np.diag([1.0, 4.0, 16.0]), (n, 3, 3))
        means, covariances = np.empty((n, n_points, 3)), np.empty((n, n_points, 3, 3))
        predicted, predicted_covariances = np.empty_like(means), np.empty_like(covariances)
        squares, log_variances, n_counted, n_seen = 0.0, 0.0, 0, np.zeros(n)
        for k in range(n_points):
            if k:
                F = self.step[:, k - 1]
                mean = np.einsum("nij,nj->ni", F, mean)
                Q = self.spread[:, k - 1] * (q / weight[:, k - 1])[:, None, None]
                covariance = F @ covariance @ F.transpose(0, 2, 1) + Q
            predicted[:, k], predicted_covariances[:, k] = mean, covariance
            seen = self.seen[:, k]
            innovation, S = self.value[:, k] - mean[:, 0], covariance[:, 0, 0] + variance[:, k]
            gain = np.where(seen[:, None], covariance[:, :, 0] / S[:, None], 0.0)
            mean = mean + gain * np.where(seen, innovation, 0.0)[:, None]
            kept = np.broadcast_to(_I, (n, 3, 3)).copy()
            kept[:, :, 0] -= gain
            covariance = kept @ covariance @ kept.transpose(0, 2, 1)  # Joseph's form stays positive
            covariance = covariance + gain[:, :, None] * gain[:, None, :] * variance[:, k, None, None]
            counted = seen & (n_seen >= _N_STATES)
            squares += float(np.sum((innovation**2 / S)[counted]))
            log_variances += float(np.sum(np.log(S)[counted]))
            n_counted += int(counted.sum())
            n_seen += seen
            means[:, k], covariances[:, k] = mean, covariance
        return predicted, predicted_covariances, means, covariances, squares, log_variances, max(n_counted, 1)

    def smoothed(self, noise: _Noise, weight: Float64) -> tuple[Float64, Float64, Float64]:
        """Return (n, n_points) smoothed means, covariances, and covariances of each state with the next."""
        predicted, predicted_covariances, means, covariances, *_ = self.filter(noise, weight)
        with_next = np.zeros_like(covariances)
        for k in range(means.shape[1] - 2, -1, -1):
            F = self.step[:, k]
            gain = np.linalg.solve(predicted_covariances[:, k + 1], F @ covariances[:, k]).transpose(0, 2, 1)
            gain[self.interval[:, k] == 0] = _I
            means[:, k] += np.einsum("nij,nj->ni", gain, means[:, k + 1] - predicted[:, k + 1])
            change = covariances[:, k + 1] - predicted_covariances[:, k + 1]
            covariances[:, k] += gain @ change @ gain.transpose(0, 2, 1)
            with_next[:, k] = gain @ covariances[:, k + 1]
        return means, covariances, with_next

    def weights(self, noise: _Noise, weight: Float64) -> Float64:
        """Return the expected weight of each interval."""
        means, P, with_next = self.smoothed(noise, weight)
        F = self.step
        residual = means[:, 1:] - np.einsum("nkij,nkj->nki", F, means[:, :-1])
        crossed = F @ with_next[:, :-1]
        of_noise = P[:, 1:] + F @ P[:, :-1] @ F.transpose(0, 1, 3, 2) - crossed - crossed.transpose(0, 1, 3, 2)
        of_noise += residual[..., :, None] * residual[..., None, :]
        moved = self.interval > 0
        Q = np.where(moved[..., None, None], self.spread, _I) * noise.process**2
        squared = np.trace(np.linalg.solve(Q, of_noise), axis1=-2, axis2=-1)
        return np.where(moved, (_FREEDOM + _N_STATES) / (_FREEDOM + np.maximum(squared, 0)), 1.0)


def _matrices(rows: tuple[tuple[Float64, ...], ...]) -> Float64:
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def _at(measured: Measured, times: Float64, scale: _Scale, noise: _Noise, weight: Float64) -> Smoothed:
    """Smooth at frames and further times together, and return the states at these times."""
    n, n_frames = measured.time.shape
    n_times = times.shape[1]
    both = np.concatenate([measured.time, times], axis=1)
    order = np.argsort(both, axis=1, kind="stable")
    rank = np.argsort(order, axis=1, kind="stable")[:, n_frames:]  # where each of the times is
    rows = np.arange(n)[:, None]

    def merged(of_frames: Float64, elsewhere: float) -> Float64:
        return np.concatenate([of_frames, np.full((n, n_times), elsewhere)], axis=1)[rows, order]

    seen = merged(measured.seen.astype(float), 0.0) > 0
    sd = None if measured.sd is None else merged(measured.sd, 1.0)
    chain = _Chain(both[rows, order], merged(measured.value - measured.value[:, :1], 0.0), seen, sd, scale)
    interval = np.maximum(np.cumsum(order < n_frames, axis=1)[:, :-1] - 1, 0)
    weight_at = np.take_along_axis(weight, np.minimum(interval, max(n_frames - 2, 0)), axis=1)
    means, covariances, with_next = chain.smoothed(noise, weight_at)

    unit = scale.way / scale.time ** np.arange(_N_STATES)
    mean = means[rows, rank] * unit
    mean[..., 0] += measured.value[:, :1]
    units = unit[:, None] * unit
    given = measured.sd
    deviation = noise.measurement * scale.way if given is None else np.sqrt(np.mean(np.square(given[measured.seen])))
    between = _between(covariances, with_next, rank) * units
    return Smoothed(mean, covariances[rows, rank] * units, between, float(deviation))


def _between(covariances: Float64, with_next: Float64, rank: Ints) -> Float64:
    """Return the covariance of the states at each of the times and the next one: the product of the gains in between.

    ``covariances`` and ``with_next`` are those of all points, ``rank`` (n, n_times) the points that are asked for.
    """
    n, n_times = rank.shape
    rows, gain, between = np.arange(n), np.zeros_like(covariances), np.zeros((n, n_times, 3, 3))
    solved = np.linalg.solve(covariances[:, 1:] + 1e-18 * _I, with_next[:, :-1].transpose(0, 1, 3, 2))
    gain[:, :-1] = solved.transpose(0, 1, 3, 2)
    for i in range(n_times - 1):
        product = np.broadcast_to(_I, (n, 3, 3))
        at = rank[:, i].copy()
        for _ in range(int(np.max(rank[:, i + 1] - rank[:, i]))):
            on = at < rank[:, i + 1]
            product = np.where(on[:, None, None], product @ gain[rows, at], product)
            at = at + on
        between[:, i] = product @ covariances[rows, rank[:, i + 1]]
    return between
