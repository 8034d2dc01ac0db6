"""The engine MuJoCo: another simulator of the same robots, to try what evolved in Box2D. It needs the package mujoco.

A robot is the model of :mod:`tasks.simulation.mjcf`. Its motors and contacts are soft and want short steps, so each
step of the physics is divided into several. In each of these a medium acts as a force and a torque on every link.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from tasks.arrays import Float32, Float64
from tasks.design.body import kinematic_trees
from tasks.design.genes import N_LINKS, Designs
from tasks.simulation.box2d import Column, Motion
from tasks.simulation.conditions import Conditions
from tasks.simulation.controller import Controllers
from tasks.simulation.mjcf import LONGEST_STEP, mjcf
from tasks.world import Environment, LinkStates, Physics
from tasks.world.medium import MediumInRollout

_LACKS = {"restitution": 0.0, "max_motor_speed": None, "continuous_collision": False}


class EngineError(ValueError):
    """The engine is not here, or lacks what is asked of it."""


class _Robot:
    """One robot in a world of its own."""

    def __init__(self, mujoco: Any, design: Designs, depth: float, physics: Physics) -> None:
        self._mujoco = mujoco
        self.model = model = mujoco.MjModel.from_xml_string(mjcf(design, depth, physics))
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET  # a state that is not finite is a status
        self.data = mujoco.MjData(model)
        self._bodies = [model.body(f"link-{link}").id for link in range(N_LINKS)]
        self.motors = [int(model.actuator(k).name.removeprefix("motor-")) for k in range(model.nu)]
        self._motor_speeds = [model.joint(f"joint-{link}").dofadr[0] for link in self.motors]
        hinges = {model.joint(k).name: model.joint(k).qposadr[0] for k in range(model.njnt)}
        self._turns = [link for link in range(N_LINKS) if link == 0 or f"joint-{link}" in hinges]
        self._hinges = [hinges[f"joint-{link}" if link else "root-angle"] for link in self._turns]
        self._to_parent = np.where(np.arange(N_LINKS) > 0, design.rest_angle[0], 0.0)  # angles, also of fixed links
        self._path = np.eye(N_LINKS)  # 1 where a link is on the path from the root to another, or is that link
        for link in range(1, N_LINKS):
            self._path[link] += self._path[design.parent[0, link]]

    def state(self) -> Float64:
        """Return (n_links, 6) states before a step."""
        self._mujoco.mj_step1(self.model, self.data)
        data, bodies = self.data, self._bodies
        self._to_parent[self._turns] = data.qpos[self._hinges]
        x, _, y = data.xipos[bodies].T
        _, turning, _, vx, _, vy = data.cvel[bodies].T  # where a link is at the robot's centre of mass
        centre_x, _, centre_y = data.subtree_com[bodies[0]]
        vx, vy = vx + turning * (y - centre_y), vy - turning * (x - centre_x)
        return np.stack((x, y, self._path @ self._to_parent, vx, vy, -turning), axis=1)

    def step(self, targets: Float32, force: Float64 | None) -> Float64:
        """Take a step with (n_links,) target angles and (n_links, 3) forces and torques; return the motors' work."""
        self.data.ctrl[:] = targets[self.motors]
        if force is not None:
            self.data.xfrc_applied[np.ix_(self._bodies, (0, 2, 4))] = force * (1, 1, -1)  # angles turn from x to z
        self._mujoco.mj_step2(self.model, self.data)
        work = np.zeros(N_LINKS)
        speeds = self.data.qvel[self._motor_speeds]
        work[self.motors] = np.abs(self.data.actuator_force * speeds) * self.model.opt.timestep
        return work


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
    """Return the motion of designs in an environment; the arguments are those of tasks.simulation.rollout.simulate.

    Raises:
        EngineError: mujoco is not installed, or the physics have what it lacks.
    """
    try:
        import mujoco
    except ModuleNotFoundError:
        raise EngineError("engine mujoco: expected the package mujoco, which `pip install mujoco` installs") from None
    for name, without in _LACKS.items():
        if (value := getattr(physics, name)) != without:
            raise EngineError(f"physics.{name} is {value}, which the engine mujoco lacks: expected {without}")
    shorter = Conditions(n_substeps=math.ceil(physics.time_step / LONGEST_STEP - 1e-9))
    physics, environment = shorter.of_physics(physics), shorter.of_environment(environment)
    shape = environment.n_members, len(designs), N_LINKS
    robots = [
        _Robot(mujoco, designs[k : k + 1], environment.depth, physics)
        for _ in range(shape[0])
        for k in range(len(designs))
    ]
    controllers = Controllers(designs, physics, environment.depth)
    trees = kinematic_trees(designs, density=physics.link_density)
    length, mass, inertia = (
        np.broadcast_to(of.astype(np.float32), shape) for of in (designs.length_scale, trees.mass, trees.inertia)
    )

    medium = MediumInRollout(environment.medium, environment.depth) if environment.medium else None

    def states() -> Float32:
        return np.stack([robot.state() for robot in robots]).reshape(*shape, 6).astype(np.float32)

    def forces(state: Float32) -> Float64 | None:
        if medium is None:
            return None
        x, y, angle, vx, vy, omega = np.moveaxis(state, -1, 0)
        turned = np.cos(angle), np.sin(angle)
        links = LinkStates(length, mass, inertia, y, *turned, vx, vy, omega, x=x, parent=designs.parent)
        change = medium.velocity_change(links, physics)
        impulse = np.stack((mass * change.vx, mass * change.vy, inertia * change.omega), axis=-1)
        return (impulse / physics.time_step).reshape(-1, N_LINKS, 3)

    recorded, work = [], np.zeros((len(robots), N_LINKS))
    state = states()
    settled = halfway = state
    n_steps = n_settle + n_measure
    for step in range(n_steps * shorter.n_substeps):
        cos, sin = np.cos(state[..., Column.ANGLE]), np.sin(state[..., Column.ANGLE])
        force, targets = forces(state), controllers.target_angle(step, state, cos, sin).reshape(-1, N_LINKS)
        done = [robot.step(targets[k], None if force is None else force[k]) for k, robot in enumerate(robots)]
        state = states()
        if step >= n_settle * shorter.n_substeps:
            work += done
        whole, part = divmod(step + 1, shorter.n_substeps)
        if part == 0 and trace:
            recorded.append(state)
        if part == 0 and whole == n_settle:
            settled = state
        if part == 0 and whole == n_settle + n_measure // 2:
            halfway = state
    return Motion(
        settled=settled,
        halfway=halfway,
        final=state,
        trace=np.stack(recorded, axis=2) if trace else None,
        motor_work=work.reshape(shape).astype(np.float32) if motor_work else None,
    )
