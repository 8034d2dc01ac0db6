"""What the engines share: Box2D's constants (Common/b2Settings.h), the ground, and the motion that they report."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tasks.arrays import Float32

GROUND_HALF_WIDTH = 10_000.0
"""[m]. Far wider than any robot gets in a rollout."""
GROUND_HALF_HEIGHT = 10.0
"""[m]. Far thicker than any link moves in a step (Box2D allows 2 m), so nothing tunnels."""

POLYGON_RADIUS = np.float32(0.01)
"""b2_polygonRadius [m]: the skin of a polygon."""
TOTAL_RADIUS = np.float32(0.02)
"""Both skins [m]: the distance within which two polygons touch."""
LINEAR_SLOP = np.float32(0.005)
"""b2_linearSlop [m]: the error of a constraint that is left alone."""
VELOCITY_THRESHOLD = np.float32(1.0)
"""b2_velocityThreshold [m/s]: slower contacts do not bounce."""
MAX_CONDITION_NUMBER = np.float32(1000.0)
"""Of the matrix K of two contact points, in b2ContactSolver."""
BAUMGARTE = np.float32(0.2)
"""b2_baumgarte: the share of an overlap that is corrected at once."""
MAX_LINEAR_CORRECTION = np.float32(0.2)
"""b2_maxLinearCorrection [m]."""
LEAST_SEPARATION = np.float32(-3.0) * LINEAR_SLOP
"""Separation of a contact that is left alone by the position solver [m]."""
MAX_TRANSLATION = np.float32(2.0)
"""b2_maxTranslation [m]: no body moves farther in a step."""
MAX_ROTATION = np.float32(0.5) * np.float32(3.14159265359)
"""b2_maxRotation [rad]."""
MAX_ROTATION_SQUARED = MAX_ROTATION * MAX_ROTATION


def largest_square(root: float) -> np.float32:
    """Find the largest float32 whose root, rounded to float32, is at most the given one."""
    square = np.float32(root) * np.float32(root)
    while np.sqrt(np.nextafter(square, np.float32(np.inf))) <= np.float32(root):
        square = np.nextafter(square, np.float32(np.inf))
    while np.sqrt(square) > np.float32(root):
        square = np.nextafter(square, np.float32(0.0))
    return square


LINEAR_SLOP_SQUARED = largest_square(float(LINEAR_SLOP))
"""For comparisons of a length with the slop without a root [m²]."""


class Column:
    """Columns of a link's state: x, y [m], angle [rad], vx, vy [m/s], omega [rad/s]."""

    X, Y, ANGLE, VX, VY, OMEGA = range(6)


@dataclass(frozen=True, eq=False)
class Motion:
    """Where the links were, as an engine reports it; NaN from where a rollout diverged."""

    settled: Float32
    """(n_members, n_designs, n_links, 6) states at the end of settling."""
    final: Float32
    """(n_members, n_designs, n_links, 6) states at the end."""
    trace: Float32 | None
    """(n_members, n_designs, n_steps, n_links, 6) states after each step, if asked for."""
    motor_torque: Float32 | None = None
    """(n_members, n_designs, n_steps, n_links) what each joint's motor gave in each step, on the child link [N·m], 0
    where there is no motor. Of the reference engine alone, with the trace."""
