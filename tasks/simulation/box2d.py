"""What both engines share: the ground, the columns of a state, and what an engine reports."""

from __future__ import annotations

from dataclasses import dataclass

from tasks.arrays import Float32

GROUND_HALF_WIDTH = 10_000.0
"""[m]. Far wider than any robot gets in a rollout."""
GROUND_HALF_HEIGHT = 10.0
"""[m]. Far thicker than any link moves in a step (Box2D allows 2 m), so nothing tunnels."""


class Column:
    """Columns of a link's state: x, y [m], angle [rad], vx, vy [m/s], omega [rad/s]."""

    X, Y, ANGLE, VX, VY, OMEGA = range(6)


@dataclass(frozen=True, eq=False)
class Motion:
    """Where the links were, as an engine reports it; NaN from where a rollout diverged."""

    settled: Float32
    """(n_members, n_designs, n_links, 6) states at the end of settling."""
    final: Float32
    """(n_members, n_designs, n_links, 6) states at the end."""
    trace: Float32 | None
    """(n_members, n_designs, n_steps, n_links, 6) states after each step, if asked for."""
    motor_torque: Float32 | None = None
    """(n_members, n_designs, n_steps, n_links) what each joint's motor gave in each step, on the child link [N·m], 0
    where there is no motor. Of the reference engine alone, with the trace."""
