"""The reference engine: the motors' law, the joints' hold, and a step worked out by an obvious script of its own."""

from itertools import pairwise

import Box2D
import numpy as np
import pytest
import shapely

from tasks.design import Designs, kinematic_trees, random_designs
from tasks.simulation import simulate
from tasks.world import TrueSlush

DT, G = 1 / 60, 9.8
X, Y, ANGLE, VX, VY, OMEGA = range(6)


def obvious_script(designs: Designs, design: int, depth: float, n_steps: int) -> np.ndarray:
    """A robot in slush as one would first write it: pybox2d, a loop over links, shapely for what is submerged."""
    trees = kinematic_trees(designs, density=1.0)
    world = Box2D.b2World(gravity=(0, -G), doSleep=False)
    world.continuousPhysics = False
    ground = world.CreateStaticBody(position=(0, -depth - 10))
    ground.CreatePolygonFixture(box=(10_000, 10), friction=0.8)
    links = {}
    for link in (5, 4, 3, 2, 1, 0):
        a = designs.length_scale[design, link]
        at = (float(trees.x[design, link]), float(trees.y[design, link]))
        links[link] = world.CreateDynamicBody(position=at, angle=float(trees.angle[design, link]))
        links[link].CreatePolygonFixture(box=(float(0.5 / a), float(a / 2)), density=1, friction=0.8, groupIndex=-1)
    joints = {}
    for link in range(1, 6):
        parent = int(designs.parent[design, link])
        joints[link] = world.CreateRevoluteJoint(
            bodyA=links[parent],
            bodyB=links[link],
            localAnchorA=(0, float(trees.parent_anchor[design, link])),
            localAnchorB=(0, float(trees.child_anchor[design, link])),
            enableMotor=bool(designs.motor_on[design, link]),
            maxMotorTorque=100,
            referenceAngle=0,
        )
    states = []
    for step in range(n_steps):
        for link, joint in joints.items():
            swing = np.sin(2 * np.pi * designs.frequency[design] * step * DT + designs.phase[design, link])
            target = designs.rest_angle[design, link] + designs.motion_range[design, link] * swing
            joint.motorSpeed = float(10 * (target - joint.angle))
        for link, body in links.items():
            a = designs.length_scale[design, link]
            rectangle = shapely.box(-0.5 / a, -a / 2, 0.5 / a, a / 2)
            c, s, y = np.cos(body.angle), np.sin(body.angle), body.position.y
            placed = shapely.transform(rectangle, lambda p, c=c, s=s: p @ np.array([[c, s], [-s, c]]))
            part = placed.intersection(shapely.box(-10, -20, 10, -y))
            area, moment = part.area, 0.0
            if area > 0:
                # The triangles that the part's edges span with the centre: A (p² + p·q + q²) / 6 each, signed.
                for p, q in pairwise(shapely.get_coordinates(shapely.orient_polygons(part))):
                    moment += (p[0] * q[1] - p[1] * q[0]) / 2 * (p @ p + p @ q + q @ q) / 6
            v, omega = np.array(body.linearVelocity), body.angularVelocity
            v = v / (1 + 0.5 * 1.25 * 10 * area * np.hypot(*v) * DT)
            v[1] += 1.25 * G * area * DT
            inertia = (a**2 + a**-2) / 12
            omega = omega / (1 + 1.25 * 20 * moment / inertia * abs(omega) * DT)
            body.linearVelocity, body.angularVelocity = (float(v[0]), float(v[1])), float(omega)
        world.Step(DT, 8, 3)
        states.append(
            [(*links[i].position, links[i].angle, *links[i].linearVelocity, links[i].angularVelocity) for i in range(6)]
        )
    return np.array(states)


@pytest.mark.parametrize("design", range(4))
def test_the_engine_agrees_with_the_obvious_script(design: int) -> None:
    designs = random_designs(4, np.random.default_rng(65))
    n_steps = 150
    trace = simulate(designs, TrueSlush(9.0), n_settle=0, n_measure=n_steps, engine="reference", trace=True).trace
    assert trace is not None
    expected = obvious_script(designs, design, 9.0, n_steps)
    # The script computes motors and slush in float64: a rounding of 1e-7 apart at first, 2e-6 m or rad after 2.5 s.
    np.testing.assert_allclose(trace[design][..., :3], expected[..., :3], rtol=0, atol=2e-5)
