"""Box2D 2.3's constants (b2Settings.h), and what both engines share: the ground, a state's columns, the motion."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tasks.arrays import Float32
from tasks.compiled import formula
from tasks.simd.lanes import Numeric, any_lane, select, sqrt

GROUND_HALF_WIDTH = 10_000.0  # [m]; far wider than any robot gets in a rollout
GROUND_HALF_HEIGHT = 10.0  # [m]; far thicker than any link moves in a step (Box2D allows 2 m), so nothing tunnels

LINEAR_SLOP = np.float32(0.005)  # b2_linearSlop [m]: error of a position constraint that is tolerated
LEAST_SEPARATION = np.float32(-3.0) * LINEAR_SLOP  # at which b2ContactSolver is done with positions [m]
POLYGON_RADIUS = np.float32(0.01)  # b2_polygonRadius [m]: skin of a polygon
TOTAL_RADIUS = np.float32(0.02)  # skins of two polygons [m]: vertices nearer than this are contact points
VELOCITY_THRESHOLD = np.float32(1.0)  # b2_velocityThreshold [m/s]: nothing slower bounces
MAX_CONDITION_NUMBER = np.float32(1000.0)  # k_maxConditionNumber: of two contact points that are solved as a block
BAUMGARTE = np.float32(0.2)  # b2_baumgarte: share of a position error that one sweep removes
MAX_LINEAR_CORRECTION = np.float32(0.2)  # b2_maxLinearCorrection [m]: most that one sweep removes
MAX_TRANSLATION = np.float32(2.0)  # b2_maxTranslation [m]: farthest that a body moves in a step
MAX_ROTATION = np.float32(0.5) * np.float32(3.14159265359)  # b2_maxRotation [rad]: farthest that a body turns in a step
MAX_ROTATION_SQUARED = MAX_ROTATION * MAX_ROTATION
LINEAR_SLOP_SQUARED = np.float32(2.5000001e-05)
"""Largest float32 whose square root, in float32, is at most the slop [m²]; it spares a kernel the root."""


class Scene(NamedTuple):
    """Constants that all robots of a call share, rounded once to float32."""

    dt: np.float32  # [s]
    dt_ratio: np.float32  # box2D's dtRatio of a constant time step: 1, up to rounding
    fall: np.float32  # gain of vy by gravity in a step [m/s]
    ground: np.float32  # height of the ground's top [m]
    friction: np.float32
    restitution: np.float32
    motor_gain: np.float32  # [1/s]
    max_motor_speed: np.float32  # [rad/s]; infinite without a limit
    velocity_iterations: int
    position_iterations: int
    n_links: int  # always 6, but known at run time only: otherwise loops are unrolled and outgrow the instruction cache
    motor_work: bool = False  # whether to add up the work of the motors


@formula
def limited(vx: Numeric, vy: Numeric, omega: Numeric, dt: np.float32) -> tuple[Numeric, Numeric, Numeric]:
    """Limit velocities to Box2D's farthest translation and rotation in a step (b2Island::Solve)."""
    translation_x, translation_y, rotation = dt * vx, dt * vy, dt * omega
    squared = translation_x * translation_x + translation_y * translation_y
    too_far, too_much = squared > MAX_TRANSLATION * MAX_TRANSLATION, rotation * rotation > MAX_ROTATION_SQUARED
    if any_lane(too_far | too_much):
        ratio = MAX_TRANSLATION / sqrt(squared)
        vx, vy = select(too_far, vx * ratio, vx), select(too_far, vy * ratio, vy)
        omega = select(too_much, omega * (MAX_ROTATION / abs(rotation)), omega)
    return vx, vy, omega


def top_of_ground(depth: float) -> np.float32:
    """Return the height of the ground's top [m], as Box2D's rounding leaves it."""
    return np.float32(GROUND_HALF_HEIGHT) + np.float32(-depth - GROUND_HALF_HEIGHT)


class Column:
    """Columns of a link's state: x, y [m], angle [rad], vx, vy [m/s], omega [rad/s]."""

    X, Y, ANGLE, VX, VY, OMEGA = range(6)


@dataclass(frozen=True, eq=False)
class Motion:
    """Motion of links as an engine reports it; NaN from the step in which a rollout diverged."""

    settled: Float32  # (n_members, n_designs, n_links, 6) states at the end of settling
    halfway: Float32  # (n_members, n_designs, n_links, 6) states in the middle of the measured steps
    final: Float32  # (n_members, n_designs, n_links, 6) states at the end
    trace: Float32 | None  # (n_members, n_designs, n_steps, n_links, 6) states after each step, if requested
    motor_torque: Float32 | None = None
    """(n_members, n_designs, n_steps, n_links) torque of each joint's motor on the child link [N·m], 0 without a motor.
    Only the reference engine reports it, together with the trace."""
    motor_work: Float32 | None = None
    """(n_members, n_designs, n_links) work of each joint's motor over the measured steps [J], if requested: the sum of
    |J ω|, with J [N·m·s] the motor's impulse in a step, as Box2D's velocity solver leaves it, and ω [rad/s] the angular
    velocity of the child link less that of its parent at the end of that step. Difference, product and sum are float32,
    in the order of the steps."""
