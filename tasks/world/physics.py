"""Constants of the rigid-body simulator, and Froude's law of scaling.

[P] marks constants that the paper states; the others are our decisions.
"""

from math import sqrt

from pydantic import Field

from tasks.design.body import PassiveJoints
from tasks.parameters import Parameters


class Physics(Parameters):
    """Constants that hold in every environment."""

    gravity: float = Field(default=9.8, ge=0.0, le=1000.0)
    """[m/s²], downward. [P]"""
    time_step: float = Field(default=1.0 / 60.0, ge=1e-6, le=0.1)
    """[s]. [P]. In a shorter step than the bound, a link at 1 m/s would move by few float32 roundings at 1 m."""
    velocity_iterations: int = Field(default=8, ge=1, le=100)
    """Sweeps of Box2D's velocity solver per step, as its manual recommends."""
    position_iterations: int = Field(default=3, ge=1, le=100)
    """Most sweeps of Box2D's position solver per step, as its manual recommends."""
    link_density: float = Field(default=1.0, gt=0.0, le=1000.0)
    """[kg/m²]. Every link has 1 m², so 1 kg; it floats in slush of 1.25 kg/m² with 80 % submerged."""
    friction: float = Field(default=0.8, ge=0.0, le=10.0)
    """Coefficient of Coulomb friction between a link and the ground."""
    restitution: float = Field(default=0.0, ge=0.0, le=1.0)
    """Coefficient of restitution between a link and the ground; 0 does not bounce."""
    motor_gain: float = Field(default=10.0, ge=0.0, le=1e6)
    """[1/s]. A motor's speed is the gain times the joint's angular error."""
    max_motor_torque: float = Field(default=100.0, ge=0.0, le=1e9)
    """[N·m]. [P]; the robot that was built had 30."""
    max_motor_speed: float | None = Field(default=None, gt=0.0, le=1e6)
    """[rad/s]. Fastest that a motor turns its joint; null: no limit. Other forces may turn the joint faster."""
    passive_joints: PassiveJoints = "swing"
    """A joint whose motor is off swings freely, or is locked at its rest angle, which fuses its links to a rigid body.
    [P]: locked in the robot that was built."""
    link_collisions: bool = False
    """Whether links that no joint connects collide; all links collide with the ground. [P]: they did in the robot that
    was built."""
    continuous_collision: bool = False
    """Whether Box2D stops fast links where they touch the ground within a step, its default, in place of pushing them
    out after it. The ground is thick, so nothing tunnels. The reference engine does it, about fifty times as slowly."""


def froude_time(length: float) -> float:
    """Return the scale of time for a scale of lengths, by Froude's law.

    Gravity has the same value at both scales, so time squared scales as length.
    """
    return sqrt(length)
