"""A camera's plane: the same points there and back, and fits that find the plane that made the points."""

import numpy as np
import pytest

from tasks.bench.vision.plane import CalibrationError, Lens, SeenPlane, assumed_lens, fit_plane

BENT = Lens((1500.0, 1490.0), (966.0, 533.0), (-0.12, 0.05, 0.0005, -0.0004, 0.01))
PLANE = SeenPlane(BENT, np.array([[1.0, 0.02, -0.6], [0.01, -1.0, 0.3], [0.05, 0.03, 1.9]]))
GRID = np.stack(np.meshgrid(np.linspace(0, 1.2, 5), np.linspace(0, 0.6, 4)), axis=-1).reshape(-1, 2)


def test_pixels_and_metres_undo_each_other():
    assert PLANE.metres(PLANE.pixels(GRID)) == pytest.approx(GRID, abs=1e-9)


def test_the_lens_is_opencvs():
    cv2 = pytest.importorskip("cv2", reason="opencv-python-headless is not installed")
    rays = GRID - 0.4
    camera = np.array([[BENT.focal[0], 0, BENT.centre[0]], [0, BENT.focal[1], BENT.centre[1]], [0, 0, 1]])
    points = np.column_stack((rays, np.ones(len(rays))))
    pixels, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), camera, np.array(BENT.distortion))
    assert BENT.distorted(rays) == pytest.approx(pixels[:, 0], abs=1e-9)


def test_a_fit_finds_the_plane():
    plane, misfit = fit_plane(GRID, PLANE.pixels(GRID), BENT)
    assert misfit < 1e-6 and plane.to_rays == pytest.approx(PLANE.to_rays / PLANE.to_rays[2, 2], abs=1e-7)


def test_a_fit_finds_the_first_radial_term_of_an_unknown_lens():
    """k1 (r / f)² is what bends, so that another focal length needs another k1; the plane comes out the same."""
    bent = SeenPlane(Lens((1500.0, 1500.0), (959.5, 539.5), (-0.1, 0.0, 0.0, 0.0, 0.0)), PLANE.to_rays)
    plane, misfit = fit_plane(GRID, bent.pixels(GRID), assumed_lens(1920, 1080), radial=True)
    assert misfit < 1e-3 and plane.lens.distortion[0] == pytest.approx(-0.1 * (1.2 * 1920 / 1500) ** 2, rel=1e-3)
    assert plane.metres(bent.pixels(GRID)) == pytest.approx(GRID, abs=1e-6)


def test_the_jacobian_is_the_change_of_metres_per_pixel():
    pixels = PLANE.pixels(GRID)
    step = np.array([0.05, -0.03])
    moved = PLANE.metres(pixels + step) - PLANE.metres(pixels)
    assert np.einsum("nij,j->ni", PLANE.jacobian(pixels), step) == pytest.approx(moved, rel=2e-3, abs=1e-9)


def test_noise_of_the_corners_is_what_the_fit_leaves():
    """With n residuals and 8 parameters, the estimate's relative deviation is 1 / √(2 (n - 8)) = 0.12."""
    noise = np.random.default_rng(3).normal(scale=0.3, size=GRID.shape)
    _, misfit = fit_plane(GRID, PLANE.pixels(GRID) + noise, BENT)
    assert misfit == pytest.approx(0.3, rel=3 * 0.12)


def test_points_that_make_no_plane():
    line = np.column_stack([np.linspace(0, 1, 5)] * 2)
    with pytest.raises(CalibrationError, match="lie on a line"):
        fit_plane(line, PLANE.pixels(line), BENT)
