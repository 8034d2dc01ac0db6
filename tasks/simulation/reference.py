"""The reference engine: pybox2d, one world per robot. The batch engine equals it bit for bit.

The states of all worlds are gathered into arrays; motors and medium are computed for all of them at once and written
back. A Python loop over links would take ten times as long.

Box2D is deterministic, but depends on the order of creation: first the ground; then the rigid bodies, from the one with
the last first link to the root's, so that the root heads Box2D's list of bodies and seeds its island, each with its
links' fixtures in the order of the links; then the joints in the order of their links. (Box2D's lists run backwards: a
body lists its last link's fixture first, and adds masses in that order.)
"""

from typing import Any

import Box2D
import numpy as np

from tasks.arrays import Float32, Int64
from tasks.design.body import KinematicTrees, RigidBodies, kinematic_trees, rigid_bodies
from tasks.design.genes import MOST_LINKS, Designs
from tasks.simulation.box2d import GROUND_HALF_HEIGHT, GROUND_HALF_WIDTH, Column, Motion
from tasks.simulation.controller import Controllers, fastest, motor_speed
from tasks.simulation.fused_links import PlacedLinks, body_change, place_links
from tasks.world import Environment, LinkStates, Medium, Physics, VelocityChange
from tasks.world.medium import MediumInRollout

_COLLIDES_WITH_GROUND_ONLY = {"groupIndex": -1}
"""Filter of links that pass through each other: fixtures of one negative group never collide. The ground is in none."""
GROUND_BIT = 1 << MOST_LINKS  # collision category of the ground; a link's category is the bit of its number


def empty_world(physics: Physics) -> Any:
    """Make a world without bodies."""
    world = Box2D.b2World(gravity=(0.0, -physics.gravity), doSleep=False)
    world.continuousPhysics = physics.continuous_collision
    world.warmStarting = True
    return world


def _collides(parents: Int64, link: int, physics: Physics) -> dict[str, int]:
    """Return the filter of a link: it collides with the ground and, if links do, with all that no joint ties to it."""
    if not physics.link_collisions:
        return _COLLIDES_WITH_GROUND_ONLY
    joined = (link, parents[link], *np.flatnonzero(parents == link))
    unjoined = sum(1 << other for other in range(len(parents)) if other not in joined)
    return {"categoryBits": 1 << link, "maskBits": GROUND_BIT | unjoined}


class _Robot:
    """One robot in a world of its own."""

    def __init__(
        self,
        trees: KinematicTrees,
        rigid: RigidBodies,
        design: int,
        controllers: Controllers,
        depth: float,
        physics: Physics,
    ) -> None:
        self.world = empty_world(physics)
        ground = self.world.CreateStaticBody(position=(0.0, -depth - GROUND_HALF_HEIGHT))
        ground.CreatePolygonFixture(
            box=(GROUND_HALF_WIDTH, GROUND_HALF_HEIGHT),
            friction=physics.friction,
            restitution=physics.restitution,
            categoryBits=GROUND_BIT,
        )
        first_link, parents = rigid.first_link[design], trees.parent[design]
        body_of: dict[int, Any] = {}
        for first in reversed(np.unique(first_link).tolist()):
            pose = (float(trees.x[design, first]), float(trees.y[design, first]), float(trees.angle[design, first]))
            body_of[first] = self.world.CreateDynamicBody(position=pose[:2], angle=pose[2], allowSleep=False)
            for link in np.flatnonzero(first_link == first).tolist():
                box: tuple[Any, ...] = (float(trees.half_width[design, link]), float(trees.half_height[design, link]))
                if link != first:
                    centre = (float(rigid.x[design, link]), float(rigid.y[design, link]))
                    box = (*box, centre, float(rigid.angle[design, link]))
                body_of[first].CreatePolygonFixture(
                    box=box,
                    density=physics.link_density,
                    friction=physics.friction,
                    restitution=physics.restitution,
                    **_collides(parents, link, physics),
                )
        self.bodies = [body_of[first] for first in sorted(body_of)]  # in the order of their first links
        self.joints = {  # by their child links
            link: self.world.CreateRevoluteJoint(
                bodyA=body_of[first_link[parents[link]]],
                bodyB=body_of[link],
                localAnchorA=(float(rigid.joint_x[design, link]), float(rigid.joint_y[design, link])),
                localAnchorB=(0.0, float(trees.child_anchor[design, link])),
                referenceAngle=0.0,
                enableMotor=bool(controllers.motor_on[design, link]),
                maxMotorTorque=physics.max_motor_torque,
                collideConnected=physics.link_collisions,  # the filters except links that a joint ties
            )
            for link in sorted(body_of)
            if link > 0
        }


class _Links:
    """Links of many robots, with their states as arrays."""

    def __init__(self, robots: list[_Robot], rigid: RigidBodies, n_members: int) -> None:
        self._rigid = rigid
        bodies = [body for robot in robots for body in robot.bodies]
        # Views of Box2D's memory: they always read the present state.
        self._views = [(b, b.position, b.linearVelocity, b.transform.q) for b in bodies]
        shape = (n_members, *rigid.first_link.shape)
        self._is_first = np.broadcast_to(rigid.is_first, shape)
        number = np.cumsum(self._is_first.ravel()).reshape(shape) - 1
        self._body_of_link = np.take_along_axis(number, np.broadcast_to(rigid.first_link, shape), axis=2)

    def place(self) -> PlacedLinks:
        """Read the present states of all links, with cosines and sines as Box2D computed them."""
        read = [(x.x, x.y, b.angle, v.x, v.y, b.angularVelocity, q.c, q.s) for b, x, v, q in self._views]
        of_link = np.array(read, dtype=np.float32).reshape(-1, 8)[self._body_of_link]
        with np.errstate(invalid="ignore", over="ignore"):  # of worlds that have diverged
            return place_links(self._rigid, of_link[..., :6], of_link[..., 6], of_link[..., 7])

    def push(self, links: PlacedLinks, change: VelocityChange) -> None:
        """Change the velocities of all bodies by the changes of their links."""
        with np.errstate(invalid="ignore", over="ignore"):  # of worlds that have diverged
            of_body = body_change(self._rigid, links.lever_x, links.lever_y, change)
            added = np.stack((of_body.vx, of_body.vy, of_body.omega), axis=-1)[self._is_first]
            read = [(v.x, v.y, body.angularVelocity) for body, _, v, _ in self._views]
            velocities = (np.array(read, dtype=np.float32).reshape(-1, 3) + added).astype(np.float32)
        for (body, *_), (vx, vy, omega) in zip(self._views, velocities.tolist(), strict=True):
            body.linearVelocity = (vx, vy)
            body.angularVelocity = omega


def roll_out(
    designs: Designs,
    environment: Environment,
    physics: Physics,
    *,
    n_settle: int,
    n_measure: int,
    trace: bool,
    motor_work: bool = False,
) -> Motion:
    """Return the motion of designs in an environment.

    The arguments are those of :func:`tasks.simulation.rollout.simulate`; ``trace`` also records the motor torques.
    """
    n_members, n_steps = environment.n_members, n_settle + n_measure
    n_designs, n_links = designs.parent.shape
    trees = kinematic_trees(designs, density=physics.link_density)
    rigid = rigid_bodies(designs, passive_joints=physics.passive_joints)
    controllers = Controllers(designs, physics, environment.depth)
    robots = [
        _Robot(trees, rigid, design, controllers, environment.depth, physics)
        for _ in range(n_members)
        for design in range(n_designs)
    ]
    links = _Links(robots, rigid, n_members)
    alive = np.ones((n_members, n_designs), dtype=bool)
    placed = links.place()
    recorded = np.full((n_members, n_designs, n_steps, n_links, 6), np.nan, np.float32) if trace else None
    torque = np.zeros((n_members, n_designs, n_steps, n_links), np.float32) if trace else None
    work = np.zeros((n_members, n_designs, n_links), np.float32) if motor_work else None
    settled = halfway = placed.state
    medium = MediumInRollout(environment.medium, environment.depth) if environment.medium else None
    for step in range(n_steps):
        _command_motors(robots, controllers, placed, step, physics)
        if medium is not None:
            _push(links, medium, designs, trees, placed, physics)
        for robot, robot_alive in zip(robots, alive.flat, strict=True):
            if robot_alive:
                robot.world.Step(physics.time_step, physics.velocity_iterations, physics.position_iterations)
                robot.world.ClearForces()
        # A world that became non-finite is not stepped again: Box2D would silently go on with NaN.
        placed = links.place()
        alive &= np.isfinite(placed.state).all(axis=(2, 3))
        placed.state[~alive] = np.nan
        if recorded is not None:
            recorded[:, :, step] = placed.state
        if torque is not None:
            torque[:, :, step] = _motor_impulses(robots, placed.cos.shape) * np.float32(1.0 / physics.time_step)
            torque[~alive, step] = np.nan
        if work is not None and step >= n_settle:
            speed = controllers.less_parent(placed.state[..., Column.OMEGA])
            work += np.abs(_motor_impulses(robots, placed.cos.shape) * speed)
        if step + 1 == n_settle:
            settled = placed.state
        if step + 1 == n_settle + n_measure // 2:
            halfway = placed.state
    return Motion(
        settled=settled, halfway=halfway, final=placed.state, trace=recorded, motor_torque=torque, motor_work=work
    )


def _motor_impulses(robots: list[_Robot], shape: tuple[int, ...]) -> Float32:
    """Read the motor impulses of the last step; (n_members, n_designs, n_links) is their shape [N·m·s]."""
    impulse = np.zeros((len(robots), shape[2]), np.float32)
    for row, robot in zip(impulse, robots, strict=True):
        for link, joint in robot.joints.items():
            row[link] = joint.GetMotorTorque(1.0)  # the impulse over an inverse time step of 1, which rounds nothing
    return impulse.reshape(shape)


def _command_motors(
    robots: list[_Robot], controllers: Controllers, placed: PlacedLinks, step: int, physics: Physics
) -> None:
    """Set the speed of each motor that is on to gain · (θ* - θ), within its limit."""
    angle = placed.state[..., Column.ANGLE]
    target = controllers.target_angle(step, placed.state, placed.cos, placed.sin)
    speed = motor_speed(target, controllers.less_parent(angle), np.float32(physics.motor_gain), fastest(physics))
    speeds_of_robots = speed.reshape(len(robots), speed.shape[-1]).tolist()
    on = np.broadcast_to(controllers.motor_on, angle.shape).reshape(len(robots), angle.shape[-1]).tolist()
    for robot, speeds, flags in zip(robots, speeds_of_robots, on, strict=True):
        for link, joint in robot.joints.items():
            if flags[link]:
                joint.motorSpeed = speeds[link]


def _push(
    links: _Links, medium: Medium, designs: Designs, trees: KinematicTrees, placed: PlacedLinks, physics: Physics
) -> None:
    """Change the velocities of all bodies by the medium's push on their links."""
    x, y, _, vx, vy, omega = np.moveaxis(placed.state, -1, 0)
    length, mass, inertia = (
        np.broadcast_to(of_design, y.shape)
        for of_design in (designs.length_scale.astype(np.float32), trees.mass, trees.inertia)
    )
    states = LinkStates(length, mass, inertia, y, placed.cos, placed.sin, vx, vy, omega, x=x, parent=designs.parent)
    links.push(placed, medium.velocity_change(states, physics))
