"""The pose of a bar from the corners of its tags, and its uncertainty from the corners' noise.

A corner's noise in the picture, of the same deviation σ in x and y, becomes a covariance σ² J Jᵀ in the plane with the
Jacobian J of the map from pixels to metres. Weighted least squares of the rigid motion that takes the bar's corners to
those seen then give the pose and its covariance. σ is not assumed: it follows from what the fits leave over all frames,
and a frame whose corners fit worse than the others, as where motion blurs them, has a larger one.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tasks.arrays import Float64

_N_STEPS = 4  # Gauss-Newton steps from the closed form without weights
_PRIOR = 8.0  # degrees of freedom that all frames together count for in the noise of one of them
LEAST_NOISE_PX = 0.02  # below which no corner is known


@dataclass(frozen=True, eq=False)
class BarPose:
    """Pose of a bar in one frame, for corner noise of 1 px."""

    pose: Float64  # (3,) x, y of the centre [m] and angle of the long axis from the vertical [rad]
    covariance: Float64  # (3, 3) of the pose, per px² of corner noise
    chi2: float  # sum of squares of what the fit leaves [px²]
    freedom: int  # its degrees of freedom

    def deviation(self, typical: float) -> Float64:
        """Return the (3,) standard deviations of the pose, for the noise of corners in the median frame [px].

        The noise in this frame leans on that one: it counts as much as its degrees of freedom, against 8 of the median.
        """
        noise = np.sqrt((_PRIOR * typical**2 + self.chi2) / (_PRIOR + self.freedom))
        return np.asarray(noise * np.sqrt(np.diag(self.covariance)))


def tag_corners(size: float, across: float, along: float) -> Float64:
    """Return (4, 2) corners of a tag on its bar [m], from the one at its upper left on clockwise, as detectors do.

    ``size`` is the edge of its black square; its centre lies ``across`` along the short axis, ``along`` the long one.
    """
    half = size / 2
    corners = [(-half, half), (half, half), (half, -half), (-half, -half)]
    return np.asarray(np.array(corners) + np.array((across, along)))


def fit_bar(corners: Float64, seen: Float64, jacobian: Float64) -> BarPose:
    """Fit the pose of a bar.

    Args:
        corners: (n_corners, 2) corners of its tags in its own frame [m], at least 4.
        seen: (n_corners, 2) where they are seen in the plane [m].
        jacobian: (n_corners, 2, 2) derivatives of ``seen`` with respect to pixels [m/px].
    """
    (a, b), (c, d) = (corners - corners.mean(axis=0)).T @ (seen - seen.mean(axis=0))
    angle = np.arctan2(b - c, a + d)
    weights = np.linalg.inv(jacobian @ jacobian.swapaxes(1, 2))
    pose = np.array([*(seen.mean(axis=0) - _turned(corners.mean(axis=0, keepdims=True), angle)[0]), angle])
    for _ in range(_N_STEPS):
        turned = _turned(corners, pose[2])
        left = seen - turned - pose[:2]
        slopes = np.zeros((len(corners), 2, 3))
        slopes[:, 0, 0] = slopes[:, 1, 1] = 1
        slopes[:, 0, 2], slopes[:, 1, 2] = -turned[:, 1], turned[:, 0]
        information = np.einsum("nia,nij,njb->ab", slopes, weights, slopes)
        pose = pose + np.linalg.solve(information, np.einsum("nia,nij,nj->a", slopes, weights, left))
    left = seen - _turned(corners, pose[2]) - pose[:2]
    chi2 = float(np.einsum("ni,nij,nj->", left, weights, left))
    return BarPose(pose, np.linalg.inv(information), chi2, 2 * len(corners) - 3)


def _turned(points: Float64, angle: float) -> Float64:
    c, s = np.cos(angle), np.sin(angle)
    return np.asarray(points @ np.array([[c, s], [-s, c]]))


def typical_noise(fits: Sequence[BarPose]) -> float:
    """Estimate the deviation of the corners' noise in the median frame [px] from what the fits leave; 0 without any."""
    squares = [fit.chi2 / fit.freedom for fit in fits]
    return max(float(np.sqrt(np.median(squares))), LEAST_NOISE_PX) if squares else 0.0
