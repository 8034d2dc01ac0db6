"""The obvious script: one robot in pybox2d, with Python loops over links and a polygon clipper for the slush.

A careful reader of the paper would write it first; the batch engine's speed is compared with it. It implements the same
specification (tasks/world/slush.py) by other means, so its robots agree with ours up to rounding and chaos.
"""

from __future__ import annotations

import math
from typing import Any

import Box2D

from tasks.design import Designs
from tasks.design.body import kinematic_trees
from tasks.world import Physics, Slush

_Point = tuple[float, float]


def clip_below(polygon: list[_Point], height: float) -> list[_Point]:
    """Clip the part of a polygon below a height (Sutherland and Hodgman)."""
    below: list[_Point] = []
    for (x1, y1), (x2, y2) in zip(polygon, polygon[1:] + polygon[:1], strict=True):
        if y1 <= height:
            below.append((x1, y1))
        if (y1 <= height) != (y2 <= height):
            t = (height - y1) / (y2 - y1)
            below.append((x1 + t * (x2 - x1), height))
    return below


def area_and_second_moment(polygon: list[_Point], about: _Point) -> tuple[float, float]:
    """Compute area and polar second moment of a polygon about a point."""
    area = moment = 0.0
    px, py = about
    for (x1, y1), (x2, y2) in zip(polygon, polygon[1:] + polygon[:1], strict=True):
        x1, y1, x2, y2 = x1 - px, y1 - py, x2 - px, y2 - py
        cross = x1 * y2 - x2 * y1
        area += cross / 2
        moment += cross * (x1 * x1 + x1 * x2 + x2 * x2 + y1 * y1 + y1 * y2 + y2 * y2) / 12
    return area, moment


class Robot:
    """One design in True Slush."""

    def __init__(self, designs: Designs, index: int, depth: float, physics: Physics, slush: Slush) -> None:
        self.design, self.physics, self.slush = designs[index], physics, slush
        tree = kinematic_trees(self.design, density=physics.link_density)
        self.world: Any = Box2D.b2World(gravity=(0, -physics.gravity), doSleep=False)
        self.world.continuousPhysics = False
        ground = self.world.CreateStaticBody(position=(0, -depth - 10))
        ground.CreatePolygonFixture(box=(10_000, 10), friction=physics.friction)
        self.links: list[Any] = []
        for i in reversed(range(6)):  # Box2D's solver begins with the body that was created last: the root
            link = self.world.CreateDynamicBody(
                position=(float(tree.x[0, i]), float(tree.y[0, i])), angle=float(tree.angle[0, i])
            )
            box = (float(tree.half_width[0, i]), float(tree.half_height[0, i]))
            link.CreatePolygonFixture(box=box, density=physics.link_density, friction=physics.friction, groupIndex=-1)
            self.links.insert(0, link)
        self.joints = [
            self.world.CreateRevoluteJoint(
                bodyA=self.links[tree.parent[0, i]],
                bodyB=self.links[i],
                localAnchorA=(0, float(tree.parent_anchor[0, i])),
                localAnchorB=(0, float(tree.child_anchor[0, i])),
                enableMotor=bool(self.design.motor_on[0, i]),
                maxMotorTorque=physics.max_motor_torque,
                referenceAngle=0,
            )
            for i in range(1, 6)
        ]
        self.time = 0.0

    def step(self) -> None:
        """Take one step."""
        design, physics, slush = self.design, self.physics, self.slush
        for i, joint in enumerate(self.joints, start=1):
            if design.motor_on[0, i]:
                swing = math.sin(2 * math.pi * design.frequency[0] * self.time + design.phase[0, i])
                target = design.rest_angle[0, i] + design.motion_range[0, i] * swing
                joint.motorSpeed = float(physics.motor_gain * (target - joint.angle))
        for link in self.links:
            corners = [tuple(link.transform * vertex) for vertex in link.fixtures[0].shape.vertices]
            wet = clip_below(corners, 0.0)
            if len(wet) < 3:
                continue
            area, moment = area_and_second_moment(wet, tuple(link.worldCenter))
            dt, velocity, omega = physics.time_step, link.linearVelocity, link.angularVelocity
            k = 0.5 * slush.density * slush.linear_drag * area / link.mass
            divisor = 1 + k * velocity.length * dt
            lift = slush.density * physics.gravity * area / link.mass * dt
            link.linearVelocity = (velocity.x / divisor, velocity.y / divisor + lift)
            k_r = slush.density * slush.angular_drag * moment / link.inertia
            link.angularVelocity = omega / (1 + k_r * abs(omega) * dt)
        self.world.Step(physics.time_step, physics.velocity_iterations, physics.position_iterations)
        self.world.ClearForces()
        self.time += physics.time_step
