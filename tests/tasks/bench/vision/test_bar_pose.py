import numpy as np
import pytest

from tasks.bench.vision.bar_pose import LEAST_NOISE_PX, BarPose, fit_bar, tag_corners, typical_noise

TWO_TAGS = np.concatenate((tag_corners(0.0174, 0.0, 0.09), tag_corners(0.0174, 0.0, -0.09)))


def seen(corners, x, y, angle):
    c, s = np.cos(angle), np.sin(angle)
    return corners @ np.array([[c, s], [-s, c]]) + (x, y)


def test_corners_run_clockwise_from_the_upper_left():
    assert tag_corners(0.02, 0.1, 0.2).tolist() == pytest.approx(
        np.array([(0.09, 0.21), (0.11, 0.21), (0.11, 0.19), (0.09, 0.19)])
    )


@pytest.mark.parametrize("angle", [0.0, 1.0, 3.0, -2.5])
def test_the_pose_of_exact_corners(angle):
    fit = fit_bar(TWO_TAGS, seen(TWO_TAGS, 0.3, -0.1, angle), np.tile(np.eye(2), (8, 1, 1)))
    assert fit.pose == pytest.approx((0.3, -0.1, angle), abs=1e-12) and fit.chi2 < 1e-20 and fit.freedom == 13


def test_the_covariance_is_that_of_least_squares():
    """With n corners, σ 1 px of h metres: the centre has h² / n, the angle h² / Σr²; r is from the mean corner."""
    h = 6e-4
    fit = fit_bar(TWO_TAGS, seen(TWO_TAGS, 0.3, -0.1, 0.7), np.tile(h * np.eye(2), (8, 1, 1)))
    about = TWO_TAGS - TWO_TAGS.mean(axis=0)
    assert np.diag(fit.covariance) == pytest.approx((h**2 / 8, h**2 / 8, h**2 / np.square(about).sum()), rel=1e-9)


def test_errors_are_as_large_as_the_covariance_says():
    """Under perspective, too: the mean of 400 squared errors over their variance is 1 ± 3 √(2 / 400)."""
    rng = np.random.default_rng(2)
    jacobian = np.tile(np.array([[6e-4, 1e-4], [-5e-5, 9e-4]]), (8, 1, 1)) * np.linspace(0.8, 1.2, 8)[:, None, None]
    true = np.array([0.2, 0.1, 0.4])
    exact = seen(TWO_TAGS, *true)
    ratio, fits = np.zeros(3), []
    for _ in range(400):
        noise = np.einsum("nij,nj->ni", jacobian, rng.normal(scale=0.2, size=(8, 2)))
        fit = fit_bar(TWO_TAGS, exact + noise, jacobian)
        ratio += (fit.pose - true) ** 2 / (0.2**2 * np.diag(fit.covariance)) / 400
        fits.append(fit)
    assert ratio == pytest.approx(np.ones(3), abs=3 * np.sqrt(2 / 400))
    assert typical_noise(fits) == pytest.approx(0.2, rel=0.05)
    stated = [fit.deviation(0.2) / np.sqrt(np.diag(fit.covariance)) for fit in fits]
    assert np.median(stated) == pytest.approx(0.2, rel=0.05)


def test_a_blurred_frame_has_more_noise_and_none_has_less_than_can_be_known():
    sharp, blurred, exact = (BarPose(np.zeros(3), np.eye(3), chi2, 13) for chi2 in (13.0, 13 * 25.0, 0.0))
    noise = typical_noise([sharp, sharp, sharp, blurred])
    assert noise == 1.0 and sharp.deviation(noise) == pytest.approx(np.ones(3))
    assert blurred.deviation(noise) == pytest.approx(np.full(3, np.sqrt((8 + 13 * 25) / 21)))
    assert typical_noise([exact, exact]) == LEAST_NOISE_PX
