"""The engine MuJoCo: another simulator of the same robots, to try what evolved in Box2D. It needs the package mujoco.

A robot is the model of :mod:`tasks.simulation.mjcf`. Its motors and contacts are soft and want short steps, so each
step of the physics is divided into several. In each of these a medium acts as a force and a torque on every link, and
MuJoCo's own fluid by the share of every link that is under water.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from tasks.arrays import Float32, Float64, Floats, Int64
from tasks.design.body import kinematic_trees
from tasks.design.genes import Designs
from tasks.simulation.box2d import Column, Motion
from tasks.simulation.conditions import Conditions
from tasks.simulation.controller import Controllers
from tasks.simulation.mjcf import LONGEST_STEP, free_links_mjcf, mjcf
from tasks.world import Environment, LinkStates, Physics
from tasks.world.medium import MediumInRollout
from tasks.world.mujoco_fluid import MujocoFluid
from tasks.world.residual_slush import at_time_step
from tasks.world.slush import submerged_part

_LACKS = {"restitution": 0.0, "max_motor_speed": None, "continuous_collision": False}


class EngineError(ValueError):
    """The engine is not here, or lacks what is asked of it."""


class _Robot:
    """One robot in a world of its own."""

    def __init__(self, mujoco: Any, design: Designs, depth: float, physics: Physics, fluid: MujocoFluid | None) -> None:
        self._mujoco = mujoco
        self.model = model = _compiled(mujoco, mjcf(design, depth, physics, fluid))
        self.data = mujoco.MjData(model)
        n_links = design.room
        self._bodies = [model.body(f"link-{link}").id for link in range(n_links)]
        self._immersion = _Immersion(model, self._bodies)
        self.motors = [int(model.actuator(k).name.removeprefix("motor-")) for k in range(model.nu)]
        self._motor_speeds = [model.joint(f"joint-{link}").dofadr[0] for link in self.motors]
        hinges = {model.joint(k).name: model.joint(k).qposadr[0] for k in range(model.njnt)}
        self._turns = [link for link in range(n_links) if link == 0 or f"joint-{link}" in hinges]
        self._hinges = [hinges[f"joint-{link}" if link else "root-angle"] for link in self._turns]
        self._to_parent = np.where(design.parent[0] >= 0, design.rest_angle[0], 0.0)  # angles, also of fixed links
        self._path = np.eye(n_links)  # 1 where a link is on the path from the root to another, or is that link
        for link in range(1, n_links):
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

    def step(self, targets: Float32, force: Float64 | None, share: Floats | None) -> Float64:
        """Take a step with (n_links,) target angles; return the motors' work.

        ``force`` are the (n_links, 3) forces and torques of a medium, ``share`` what (n_links,) of links is submerged.
        """
        self.data.ctrl[:] = targets[self.motors]
        if force is not None:
            self.data.xfrc_applied[np.ix_(self._bodies, (0, 2, 4))] = force * (1, 1, -1)  # angles turn from x to z
        if share is not None:
            self._immersion.set(share)
            self._mujoco.mj_passive(self.model, self.data)
        self._mujoco.mj_step2(self.model, self.data)
        work = np.zeros(len(self._bodies))
        speeds = self.data.qvel[self._motor_speeds]
        work[self.motors] = np.abs(self.data.actuator_force * speeds) * self.model.opt.timestep
        return work


class _Immersion:
    """Lets bodies of one geom each feel the fluid by the share [of 1 m²] of them that is under water.

    A geom's fluid coefficients, and with them its forces and their derivatives in an implicit step, are scaled. (The
    first, which scales forces, leaves the derivatives as they are; and where it is 0, another model takes over.)
    Buoyancy is gravity compensation, in units of the body's weight.
    """

    def __init__(self, model: Any, bodies: Sequence[int] | Int64) -> None:
        self._model, self._bodies, self._geoms = model, bodies, model.body_geomadr[bodies]
        self._wet = model.geom_fluid[self._geoms, 1:].copy()

    def set(self, share: Floats) -> None:
        """Set the submerged share of each body."""
        model, bodies = self._model, self._bodies
        model.geom_fluid[self._geoms, 1:] = share[:, None] * self._wet
        model.body_gravcomp[bodies] = model.opt.density * share / model.body_mass[bodies]


def _imported(physics: Physics) -> Any:
    """Return the package; raise EngineError if it is not installed, or the physics have what it lacks."""
    try:
        import mujoco
    except ModuleNotFoundError:
        raise EngineError(
            "engine mujoco: mujoco is not installed; run `make setup EXTRAS=mujoco` in the checkout; without one, "
            "`pip install 'puddle[mujoco]'`"
        ) from None
    for name, without in _LACKS.items():
        if (value := getattr(physics, name)) != without:
            raise EngineError(f"physics.{name} is {value}, which the engine mujoco lacks: expected {without}")
    return mujoco


def _compiled(mujoco: Any, xml: str) -> Any:
    """Return a model, whose states are not reset where they are not finite: that is a status of a rollout."""
    model = mujoco.MjModel.from_xml_string(xml)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    return model


def _shorter(physics: Physics) -> Conditions:
    return Conditions(n_substeps=math.ceil(physics.time_step / LONGEST_STEP - 1e-9))


def free_links(length_scale: Floats, physics: Physics, fluid: MujocoFluid) -> Callable[[Float32], Float32]:
    """Return what takes a step of the physics with single links, without ground or joints, in MuJoCo's own fluid.

    Both of its arrays are (n_links, 6) states in the order of :class:`tasks.simulation.box2d.Column`.
    """
    mujoco, shorter = _imported(physics), _shorter(physics)
    model = _compiled(mujoco, free_links_mjcf(length_scale, shorter.of_physics(physics), fluid))
    data, immersion = mujoco.MjData(model), _Immersion(model, np.arange(1, len(length_scale) + 1))

    def step(state: Float32) -> Float32:
        data.qpos[:], data.qvel[:] = state[:, :3].ravel(), state[:, 3:].ravel()
        for _ in range(shorter.n_substeps):
            _, y, angle = data.qpos.reshape(-1, 3).T
            immersion.set(submerged_part(length_scale, y, np.cos(angle), np.sin(angle))[0])
            mujoco.mj_step(model, data)
        return np.concatenate((data.qpos.reshape(-1, 3), data.qvel.reshape(-1, 3)), axis=1).astype(np.float32)

    return step


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
    """Return the motion of designs in an environment; the arguments are those of tasks.simulation.rollout.simulate."""
    mujoco, shorter = _imported(physics), _shorter(physics)
    physics = shorter.of_physics(physics)
    environment = at_time_step(environment, physics.time_step)
    medium = MediumInRollout(environment.medium, environment.depth) if environment.medium else None
    fluid = environment.medium if isinstance(environment.medium, MujocoFluid) else None
    shape = environment.n_members, *designs.parent.shape
    robots = [
        _Robot(mujoco, designs[k : k + 1], environment.depth, physics, fluid)
        for _ in range(shape[0])
        for k in range(len(designs))
    ]
    controllers = Controllers(designs, physics, environment.depth)
    trees = kinematic_trees(designs, density=physics.link_density)
    length, mass, inertia = (
        np.broadcast_to(of.astype(np.float32), shape) for of in (designs.length_scale, trees.mass, trees.inertia)
    )

    def states() -> Float32:
        return np.stack([robot.state() for robot in robots]).reshape(*shape, 6).astype(np.float32)

    def actions(state: Float32, cos: Float32, sin: Float32) -> tuple[Any, Any]:
        """Return each robot's forces by the medium, and the submerged shares of its links in MuJoCo's own fluid."""
        nothing = [None] * len(robots)
        x, y, _, vx, vy, omega = np.moveaxis(state, -1, 0)
        if fluid is not None:
            return nothing, submerged_part(length, y, cos, sin)[0].reshape(-1, shape[2])
        if medium is None:
            return nothing, nothing
        links = LinkStates(length, mass, inertia, y, cos, sin, vx, vy, omega, x=x, parent=designs.parent)
        change = medium.velocity_change(links, physics)
        impulse = np.stack((mass * change.vx, mass * change.vy, inertia * change.omega), axis=-1)
        return (impulse / physics.time_step).reshape(-1, shape[2], 3), nothing

    recorded, work, state = [], np.zeros((len(robots), shape[2])), states()
    instants = {0: state}
    for step in range(n_settle + n_measure):
        for substep in range(step * shorter.n_substeps, (step + 1) * shorter.n_substeps):
            cos, sin = np.cos(state[..., Column.ANGLE]), np.sin(state[..., Column.ANGLE])
            targets = controllers.target_angle(substep, state, cos, sin).reshape(-1, shape[2])
            acting = zip(robots, targets, *actions(state, cos, sin), strict=True)
            done = [robot.step(*given) for robot, *given in acting]
            state = states()
            if step >= n_settle:
                work += done
        if trace:
            recorded.append(state)
        if step + 1 in (n_settle, n_settle + n_measure // 2):
            instants[step + 1] = state
    return Motion(
        settled=instants[n_settle],
        halfway=instants[n_settle + n_measure // 2],
        final=state,
        trace=np.stack(recorded, axis=2) if trace else None,
        motor_work=work.reshape(shape).astype(np.float32) if motor_work else None,
    )
