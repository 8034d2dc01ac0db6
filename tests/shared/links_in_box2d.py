"""Thrown links in pybox2d, which those of tasks.simulation.free_links must equal."""

from typing import Any

import numpy as np

from tasks.simulation.reference import empty_world
from tasks.world import LinkStates, Medium, Physics


def add_link(box2d: Any, half_width: float, half_height: float, physics: Physics) -> Any:
    """Create a link that is a body by itself and passes through all others; return the body."""
    body = box2d.CreateDynamicBody(allowSleep=False)
    body.CreatePolygonFixture(
        box=(half_width, half_height),
        density=physics.link_density,
        friction=physics.friction,
        restitution=physics.restitution,
        groupIndex=-1,  # fixtures of one negative group never collide
    )
    return body


class ReferenceFreeLinks:
    """Links as :class:`tasks.simulation.free_links.FreeLinks` has them, all bodies of one simulation in pybox2d."""

    def __init__(self, length_scale: np.ndarray, physics: Physics) -> None:
        """Create (n_links,) links with the given long axes [m]."""
        self._physics, self._box2d = physics, empty_world(physics)
        width = 1.0 / length_scale
        mass = physics.link_density * width * length_scale
        inertia = mass * (width**2 + length_scale**2) / 12
        self._constants = [of.astype(np.float32) for of in (length_scale, mass, inertia)]
        self._bodies = [add_link(self._box2d, w / 2, a / 2, physics) for w, a in zip(width, length_scale, strict=True)]

    def step(self, state: np.ndarray, medium: Medium | None) -> np.ndarray:
        """Take one step from the given (n_links, 6) states."""
        physics, bodies = self._physics, self._bodies
        for body, (x, y, angle, vx, vy, omega) in zip(bodies, state.tolist(), strict=True):
            body.transform = ((x, y), angle)
            body.linearVelocity, body.angularVelocity = (vx, vy), omega
        if medium is not None:
            rotation = np.array([(body.transform.q.c, body.transform.q.s) for body in bodies], np.float32)
            links = LinkStates(*self._constants, state[:, 1], *rotation.T, *state[:, 3:].T)
            change = medium.velocity_change(links, physics)
            for body, old, *new in zip(bodies, state[:, 3:], change.vx, change.vy, change.omega, strict=True):
                vx, vy, omega = (old + np.array(new)).astype(np.float32).tolist()
                body.linearVelocity, body.angularVelocity = (vx, vy), omega
        self._box2d.Step(physics.time_step, physics.velocity_iterations, physics.position_iterations)
        self._box2d.ClearForces()
        return np.array(
            [(*body.position, body.angle, *body.linearVelocity, body.angularVelocity) for body in bodies], np.float32
        )
