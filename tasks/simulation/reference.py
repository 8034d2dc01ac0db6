"""The reference engine: pybox2d, one world per robot. What the batch engine must equal, bit for bit.

The state of all worlds is gathered into arrays, the motors and the medium are computed for all of them at once, and
written back; a loop over Python polygons would cost ten times as much.

Box2D is deterministic but sensitive to the order in which things are made: links are created from the last to the root,
so that the root heads Box2D's list of bodies and seeds its island; then the joints in the order of their links.
"""

from __future__ import annotations

from typing import Any

import Box2D
import numpy as np
import numpy.typing as npt

from tasks.design.body import KinematicTrees, kinematic_trees
from tasks.design.genes import N_LINKS, Designs
from tasks.simulation.drive import Drive
from tasks.simulation.motion import ANGLE, GROUND_HALF_HEIGHT, GROUND_HALF_WIDTH, OMEGA, VX, VY, Motion, Y
from tasks.world import Environment, LinkStates, Medium, Physics, ResidualSlush, VelocityChange

Float32 = npt.NDArray[np.float32]

THROUGH_ONE_ANOTHER = -1
"""Box2D's group of things that never collide with each other; links belong to it, the ground does not."""


class _Bodies:
    """Handles to many Box2D bodies, whose states go to arrays and back."""

    def __init__(self, bodies: list[Any]) -> None:
        self._bodies = bodies
        # These are views of Box2D's own memory: made once, they always read the present state.
        self._views = [(b, b.position, b.linearVelocity, b.transform.q) for b in bodies]

    def states(self) -> Float32:
        """Read (n_bodies, 6) states."""
        flat: list[float] = []
        for body, position, velocity, _ in self._views:
            flat += (position.x, position.y, body.angle, velocity.x, velocity.y, body.angularVelocity)
        return np.array(flat, dtype=np.float32).reshape(len(self._views), 6)

    def rotations(self) -> Float32:
        """Read (n_bodies, 2) cosines and sines of the angles, as Box2D computed them."""
        flat: list[float] = []
        for _, _, _, rotation in self._views:
            flat += (rotation.c, rotation.s)
        return np.array(flat, dtype=np.float32).reshape(len(self._views), 2)

    def set_velocities(self, vx: Float32, vy: Float32, omega: Float32) -> None:
        """Write (n_bodies,) velocities."""
        for body, x, y, spin in zip(self._bodies, vx.tolist(), vy.tolist(), omega.tolist(), strict=True):
            body.linearVelocity = (x, y)
            body.angularVelocity = spin

    def set_states(self, states: Float32) -> None:
        """Write (n_bodies, 6) states."""
        for body, (x, y, angle, vx, vy, omega) in zip(self._bodies, states.tolist(), strict=True):
            body.transform = ((x, y), angle)
            body.linearVelocity = (vx, vy)
            body.angularVelocity = omega


def _empty_world(physics: Physics) -> Any:
    world = Box2D.b2World(gravity=(0.0, -physics.gravity), doSleep=False)
    world.continuousPhysics = False  # the ground is thick; nothing tunnels
    world.warmStarting = True
    return world


def _link(world: Any, half_width: float, half_height: float, pose: tuple[float, float, float], physics: Physics) -> Any:
    x, y, angle = pose
    body = world.CreateDynamicBody(position=(x, y), angle=angle, allowSleep=False)
    body.CreatePolygonFixture(
        box=(half_width, half_height),
        density=physics.link_density,
        friction=physics.friction,
        restitution=physics.restitution,
        groupIndex=THROUGH_ONE_ANOTHER,
    )
    return body


class _Robot:
    """One robot in a world of its own."""

    def __init__(self, trees: KinematicTrees, design: int, drive: Drive, depth: float, physics: Physics) -> None:
        self.world = _empty_world(physics)
        ground = self.world.CreateStaticBody(position=(0.0, -depth - GROUND_HALF_HEIGHT))
        ground.CreatePolygonFixture(
            box=(GROUND_HALF_WIDTH, GROUND_HALF_HEIGHT), friction=physics.friction, restitution=physics.restitution
        )
        self.links: list[Any] = [None] * N_LINKS
        for link in reversed(range(N_LINKS)):
            pose = (float(trees.x[design, link]), float(trees.y[design, link]), float(trees.angle[design, link]))
            size = (float(trees.half_width[design, link]), float(trees.half_height[design, link]))
            self.links[link] = _link(self.world, *size, pose, physics)
        self.joints = [
            self.world.CreateRevoluteJoint(
                bodyA=self.links[trees.parent[design, link]],
                bodyB=self.links[link],
                localAnchorA=(0.0, float(trees.parent_anchor[design, link])),
                localAnchorB=(0.0, float(trees.child_anchor[design, link])),
                referenceAngle=0.0,
                enableMotor=bool(drive.motor_on[design, link]),
                maxMotorTorque=physics.max_motor_torque,
            )
            for link in range(1, N_LINKS)
        ]


def roll_out(
    designs: Designs, environment: Environment, physics: Physics, *, n_settle: int, n_measure: int, trace: bool
) -> Motion:
    """Simulate designs in an environment; see :func:`tasks.simulation.simulate`."""
    n_members = environment.ensemble.n_members if isinstance(environment, ResidualSlush) else 1
    n_designs, n_steps = len(designs), n_settle + n_measure
    shape = (n_members, n_designs, N_LINKS)
    trees = kinematic_trees(designs, density=physics.link_density)
    drive = Drive.of(designs)
    robots = [
        _Robot(trees, design, drive, environment.depth, physics)
        for _ in range(n_members)
        for design in range(n_designs)
    ]
    bodies = _Bodies([link for robot in robots for link in robot.links])
    alive = np.ones((n_members, n_designs), dtype=bool)
    state = bodies.states().reshape(*shape, 6)
    kept = np.full((n_members, n_designs, n_steps, N_LINKS, 6), np.nan, np.float32) if trace else None
    settled = state
    for step in range(n_steps):
        _command_motors(robots, drive, trees, state, step, physics)
        if environment.medium is not None:
            _push(bodies, environment.medium, designs, trees, state, physics)
        for robot, robot_alive in zip(robots, alive.flat, strict=True):
            if robot_alive:
                robot.world.Step(physics.time_step, physics.velocity_iterations, physics.position_iterations)
                robot.world.ClearForces()
        # A world that turned non-finite is not stepped again: Box2D takes NaN in and gives NaN out, silently.
        state = bodies.states().reshape(*shape, 6)
        alive &= np.isfinite(state).all(axis=(2, 3))
        state[~alive] = np.nan
        if kept is not None:
            kept[:, :, step] = state
        if step + 1 == n_settle:
            settled = state
    return Motion(settled=settled, final=state, trace=kept)


def _command_motors(
    robots: list[_Robot], drive: Drive, trees: KinematicTrees, state: Float32, step: int, physics: Physics
) -> None:
    """Set each driven joint's motor speed to gain · (θ* - θ)."""
    angle = state[..., ANGLE]
    parent = np.broadcast_to(np.maximum(trees.parent, 0), angle.shape)
    joint_angle = angle - np.take_along_axis(angle, parent, axis=2)
    error = drive.target_angle(step, physics.time_step) - joint_angle
    speed = (np.float32(physics.motor_gain) * error).reshape(len(robots), N_LINKS)[:, 1:].tolist()
    on = np.broadcast_to(drive.motor_on, angle.shape).reshape(len(robots), N_LINKS)[:, 1:].tolist()
    for robot, speeds, flags in zip(robots, speed, on, strict=True):
        for joint, joint_speed, flag in zip(robot.joints, speeds, flags, strict=True):
            if flag:
                joint.motorSpeed = joint_speed


def _push(
    bodies: _Bodies, medium: Medium, designs: Designs, trees: KinematicTrees, state: Float32, physics: Physics
) -> None:
    """Add the medium's velocity change to every link."""
    shape = state.shape[:3]
    rotation = bodies.rotations().reshape(*shape, 2)
    links = LinkStates(
        length_scale=np.broadcast_to(designs.length_scale.astype(np.float32), shape),
        mass=np.broadcast_to(trees.mass, shape),
        inertia=np.broadcast_to(trees.inertia, shape),
        y=state[..., Y],
        cos=rotation[..., 0],
        sin=rotation[..., 1],
        vx=state[..., VX],
        vy=state[..., VY],
        omega=state[..., OMEGA],
    )
    change = medium.velocity_change(links, physics)
    bodies.set_velocities(*_pushed(links, change))


def _pushed(links: LinkStates, change: VelocityChange) -> tuple[Float32, Float32, Float32]:
    """Velocities with a change added, flattened and in the engine's precision."""
    velocities = (links.vx + change.vx, links.vy + change.vy, links.omega + change.omega)
    vx, vy, omega = (v.astype(np.float32).ravel() for v in velocities)
    return vx, vy, omega


class FreeLinks:
    """Single links without ground or joints: what is thrown. Paper, "Dataset Collection"."""

    def __init__(self, length_scale: npt.NDArray[np.floating], physics: Physics) -> None:
        """Make (n_links,) links of given long axes [m]."""
        self._physics = physics
        self._world = _empty_world(physics)
        width = 1.0 / length_scale
        mass = physics.link_density * width * length_scale
        self._length_scale = length_scale.astype(np.float32)
        self._mass = mass.astype(np.float32)
        self._inertia = (mass * (width**2 + length_scale**2) / 12).astype(np.float32)
        self._bodies = _Bodies(
            [
                _link(self._world, w / 2, a / 2, (0.0, 0.0, 0.0), physics)
                for w, a in zip(width, length_scale, strict=True)
            ]
        )

    def step(self, state: Float32, medium: Medium | None) -> Float32:
        """Take one step from given states; what was before them is forgotten.

        Args:
            state: (n_links, 6) x, y [m], angle [rad], vx, vy [m/s], omega [rad/s].
            medium: what surrounds the links; None is dry land.

        Returns:
            (n_links, 6) the next states.
        """
        self._bodies.set_states(state)
        if medium is not None:
            rotation = self._bodies.rotations()
            links = LinkStates(
                length_scale=self._length_scale,
                mass=self._mass,
                inertia=self._inertia,
                y=state[:, Y],
                cos=rotation[:, 0],
                sin=rotation[:, 1],
                vx=state[:, VX],
                vy=state[:, VY],
                omega=state[:, OMEGA],
            )
            self._bodies.set_velocities(*_pushed(links, medium.velocity_change(links, self._physics)))
        physics = self._physics
        self._world.Step(physics.time_step, physics.velocity_iterations, physics.position_iterations)
        self._world.ClearForces()
        return self._bodies.states()
