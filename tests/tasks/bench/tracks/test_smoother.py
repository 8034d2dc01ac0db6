"""The smoother against motions known in closed form, and against least squares."""

import numpy as np
import pytest

from tasks.bench.tracks.smoother import Measured, smooth


def measured(time, value) -> Measured:
    """Return one coordinate of throws of equally many frames."""
    time, value = np.broadcast_arrays(np.atleast_2d(time), np.atleast_2d(value))
    return Measured(np.array(time, float), np.array(value, float), np.ones(value.shape, bool), None)


def many_times(n: int, seconds: float, n_throws: int):
    return np.broadcast_to(np.linspace(0, seconds, n), (n_throws, n)).copy()


def test_a_parabola_is_followed_exactly_between_uneven_frames() -> None:
    rng = np.random.default_rng(1)
    time = np.sort(rng.uniform(0, 1, (6, 12)), axis=1)
    time[:, 0], time[:, -1] = 0, 1
    v0, a = rng.normal(size=(2, 6, 1))
    at = many_times(61, 1.0, 6)
    smoothed = smooth(measured(time, 3 + v0 * time + a * time**2 / 2), at)
    np.testing.assert_allclose(smoothed.mean[..., 0], 3 + v0 * at + a * at**2 / 2, atol=1e-4)
    np.testing.assert_allclose(smoothed.mean[..., 1], v0 + a * at, atol=2e-3)
    np.testing.assert_allclose(smoothed.mean[:, 5:-5, 2], np.broadcast_to(a, (6, 51)), atol=0.05)


@pytest.mark.parametrize("noise", [1e-3, 1e-2])
def test_noise_is_estimated_from_the_data(noise: float) -> None:
    rng = np.random.default_rng(2)
    time = np.linspace(0, 2, 60)
    true = rng.normal(size=(20, 1)) * time + rng.normal(size=(20, 1)) * time**2
    smoothed = smooth(measured(time, true + noise * rng.normal(size=true.shape)), many_times(10, 2.0, 20))
    # 1,200 measurements fix a deviation within 1 / √2400 = 2 %, fewer by what the motion takes up: three deviations.
    assert smoothed.noise == pytest.approx(noise, rel=0.1)


def test_deviations_cover_the_errors() -> None:
    """With motion and noise from the model itself, errors over their deviations have a deviation of 1."""
    rng = np.random.default_rng(3)
    time, fine = np.linspace(0, 2, 41), 20
    dt = time[1] / fine
    jerk = rng.normal(size=(40, 40 * fine)) * 3.0 / np.sqrt(dt)
    a = np.cumsum(jerk * dt, axis=1)
    v = np.cumsum(a * dt, axis=1)
    p = np.cumsum(v * dt, axis=1)
    at_frames = np.concatenate([np.zeros((40, 1)), p[:, fine - 1 :: fine]], axis=1)
    smoothed = smooth(measured(time, at_frames + 0.01 * rng.normal(size=at_frames.shape)), np.tile(time, (40, 1)))
    velocity = np.concatenate([np.zeros((40, 1)), v[:, fine - 1 :: fine]], axis=1)
    change = np.diff(smoothed.mean[..., 1], axis=1) - np.diff(velocity, axis=1)
    P, C = smoothed.covariance[..., 1, 1], smoothed.with_next[:, :-1, 1, 1]
    of_change = (change / np.sqrt(P[:, 1:] + P[:, :-1] - 2 * C)).std()
    of_velocity = ((smoothed.mean[..., 1] - velocity) / np.sqrt(P)).std()
    assert 0.7 < of_change < 1.1 and 0.7 < of_velocity < 1.1  # heavy tails make it a little too careful


def test_throws_of_different_lengths_do_not_change_one_another() -> None:
    time = np.linspace(0, 1, 21)
    short = time[:15]
    both = np.stack([time, np.concatenate([short, np.full(6, short[-1])])])
    value = np.sin(both)
    seen = np.stack([np.ones(21, bool), np.arange(21) < 15])
    sd = np.full(both.shape, 1e-3)
    at = np.stack([np.linspace(0, 1, 30), np.minimum(np.linspace(0, 1, 30), short[-1])])
    together = smooth(Measured(both, value, seen, sd), at)
    assert np.abs(together.mean[1, :, 1] - np.cos(at[1])).max() < 0.05
    assert np.isfinite(together.covariance).all() and np.isfinite(together.with_next).all()


def test_given_deviations_are_used() -> None:
    time = np.linspace(0, 1, 21)
    true = np.tile(time**2, (8, 1))
    rng = np.random.default_rng(7)
    sd = np.full(true.shape, 1e-4)
    sd[:, 10] = 1.0
    value = true + 1e-4 * rng.normal(size=true.shape)
    value[:, 10] += 0.3  # a bad frame that says so
    smoothed = smooth(Measured(np.tile(time, (8, 1)), value, np.ones(true.shape, bool), sd), np.tile(time, (8, 1)))
    np.testing.assert_allclose(smoothed.mean[..., 0], true, atol=1e-3)
