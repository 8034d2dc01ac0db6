"""The base simulator's constants: everything Box2D is told about a robot and its ground.

[P] marks what the paper says; the others are our decisions. Froude's law plays what is simulated at another scale.
"""

from __future__ import annotations

from math import sqrt

from pydantic import Field

from tasks.design.body import PassiveJoints
from tasks.parameters import Parameters


class Physics(Parameters):
    """What holds in every environment; a medium adds to it."""

    gravity: float = Field(default=9.8, ge=0.0, le=1000.0)
    """[m/s²], downward. [P]"""
    time_step: float = Field(default=1.0 / 60.0, ge=1e-6, le=0.1)
    """[s]. [P]. In less, a link at 1 m/s would move by less than a few of the steps that float32 has at 1 m."""
    velocity_iterations: int = Field(default=8, ge=1, le=100)
    """Sweeps of Box2D's velocity solver per step; its manual's recommendation."""
    position_iterations: int = Field(default=3, ge=1, le=100)
    """Sweeps at most of Box2D's position solver per step; its manual's recommendation."""
    link_density: float = Field(default=1.0, gt=0.0, le=1000.0)
    """[kg/m²]. Every link has 1 m², so 1 kg; slush of 1.25 kg/m² floats it at 80 % submersion."""
    friction: float = Field(default=0.8, ge=0.0, le=10.0)
    """Coulomb's coefficient between a link and the ground."""
    restitution: float = Field(default=0.0, ge=0.0, le=1.0)
    """Of a link on the ground; 0 does not bounce."""
    motor_gain: float = Field(default=10.0, ge=0.0, le=1e6)
    """[1/s]. A motor's speed is this times the joint's angular error."""
    max_motor_torque: float = Field(default=100.0, ge=0.0, le=1e9)
    """[N·m]. [P]; the robot that was built had 30."""
    passive_joints: PassiveJoints = "swing"
    """A joint whose motor is off swings freely, or is locked at its rest angle, so that its two links are parts of one
    rigid body. [P]: locked in the robot that was built."""
    link_collisions: bool = False
    """Whether links that no joint ties to each other collide; all links collide with the ground. [P]: they did in the
    robot that was built."""


def froude_time(length: float) -> float:
    """Give the seconds that pass while a second of simulation is played at a scale of lengths, by Froude's law.

    Gravity is the same in both, so that a length over a time squared is: t² goes as the length.
    """
    return sqrt(length)
