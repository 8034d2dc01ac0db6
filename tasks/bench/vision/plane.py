"""A camera that sees a plane: pixels to metres and back, and how the noise of a pixel becomes one of metres.

Bars move in a plane parallel to the front of the tank, which one homography maps to the picture of a lens without
distortion. The lens is OpenCV's: radial terms k1, k2, k3 and tangential terms p1, p2. Pixel centres have whole
coordinates, x to the right and y down; in the tank x is to the right and y up.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from tasks.arrays import Float64, Floats

_N_INVERSIONS = 20  # fixed-point iterations of the distortion; each gains a digit for the lenses of phones
_FOCAL_WIDTHS = 1.2  # focal length that is assumed of an unknown lens, in widths of the picture


class CalibrationError(ValueError):
    """Points can't be those of a plane. The message says why."""


@dataclass(frozen=True)
class Lens:
    """A lens without or with distortion."""

    focal: tuple[float, float]  # along x and y [px]
    centre: tuple[float, float]  # principal point [px]
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)  # k1, k2, p1, p2, k3

    def distorted(self, rays: Float64) -> Float64:
        """Return the pixels of (n, 2) rays, given by where they meet the plane at distance 1 before the camera."""
        x, y = rays.T
        k1, k2, p1, p2, k3 = self.distortion
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        bent = np.stack(
            (x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y),
            axis=1,
        )
        return np.asarray(bent * self.focal + self.centre)

    def rays(self, pixels: Float64) -> Float64:
        """Undo :func:`distorted`."""
        rays = seen = (pixels - self.centre) / self.focal
        for _ in range(_N_INVERSIONS if any(self.distortion) else 0):
            rays = rays + seen - (self.distorted(rays) - self.centre) / self.focal
        return np.asarray(rays)


def assumed_lens(width: int, height: int) -> Lens:
    """Return a lens without distortion for pictures of a size [px]."""
    focal = _FOCAL_WIDTHS * width
    return Lens((focal, focal), ((width - 1) / 2, (height - 1) / 2))


@dataclass(frozen=True, eq=False)
class SeenPlane:
    """A plane as a camera sees it."""

    lens: Lens
    to_rays: Float64  # (3, 3) homography from metres in the plane to rays

    def pixels(self, metres: Float64) -> Float64:
        """Return the (n, 2) pixels of (n, 2) points of the plane [m]."""
        return self.lens.distorted(_mapped(self.to_rays, metres))

    def metres(self, pixels: Float64) -> Float64:
        """Return the (n, 2) points of the plane [m] at (n, 2) pixels."""
        return _mapped(np.linalg.inv(self.to_rays), self.lens.rays(pixels))

    def jacobian(self, pixels: Float64) -> Float64:
        """Return the (n, 2, 2) derivatives of metres with respect to pixels [m/px], by central differences."""
        columns = [self.metres(pixels + step) - self.metres(pixels - step) for step in np.eye(2) / 2]
        return np.stack(columns, axis=2)


def _mapped(homography: Floats, points: Float64) -> Float64:
    scaled = points @ homography[:, :2].T + homography[:, 2]
    return np.asarray(scaled[:, :2] / scaled[:, 2:])


def fit_plane(metres: Float64, pixels: Float64, lens: Lens, *, radial: bool = False) -> tuple[SeenPlane, float]:
    """Fit the plane through points whose pixels are known, by least squares of the distances in the picture.

    Args:
        metres: (n_points, 2) points of the plane [m], at least 8.
        pixels: (n_points, 2) where they are seen [px].
        lens: the lens.
        radial: whether to fit the lens's k1 too, where no board has been filmed.

    Returns:
        The plane, and the root mean square of the distances left, per degree of freedom [px].
    """
    rays, (x, y), zero, one = lens.rays(pixels), metres.T, np.zeros(len(metres)), np.ones(len(metres))
    first = np.stack((x, y, one, zero, zero, zero, -rays[:, 0] * x, -rays[:, 0] * y, -rays[:, 0]), axis=1)
    second = np.stack((zero, zero, zero, x, y, one, -rays[:, 1] * x, -rays[:, 1] * y, -rays[:, 1]), axis=1)
    _, sizes, directions = np.linalg.svd(np.concatenate((first, second)))
    start = directions[-1]
    if sizes[7] < 1e-6 * sizes[0] or abs(start[8]) < 1e-9:
        raise CalibrationError("the points lie on a line: expected the corners of a rectangle")

    def plane(values: Float64) -> SeenPlane:
        bent = Lens(lens.focal, lens.centre, (values[8], *lens.distortion[1:])) if radial else lens
        return SeenPlane(bent, np.append(values[:8], 1.0).reshape(3, 3))

    values = np.append(start[:8] / start[8], lens.distortion[:1] if radial else ())
    fit = least_squares(lambda guess: (plane(guess).pixels(metres) - pixels).ravel(), values, x_scale="jac", xtol=1e-12)
    return plane(fit.x), float(np.sqrt(2 * fit.cost / max(pixels.size - len(values), 1)))
