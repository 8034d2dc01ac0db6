"""Three fluids that wetted networks were not made for, of which docs/throws.md tells, and two that step otherwise.

``--with docs/results/other_fluids.py`` registers them, and ``--set target=point_drag`` throws links into one.
"""

from dataclasses import replace
from typing import Any

import numpy as np
from pydantic import Field

from tasks.parameters import Parameters
from tasks.simd.lanes import select, sqrt
from tasks.world.medium import LinkStates, VelocityChange
from tasks.world.physics import Physics
from tasks.world.registry import register_medium
from tasks.world.slush import Slush, after_drag, submerged_part

CELLS = np.array([(u, v) for u in (np.arange(9) - 4) / 9 for v in (-1 / 3, 0, 1 / 3)]).T[..., None]
"""(2, 27, 1) centres of the cells of a link, along and across it, as shares of its axes."""


class PointDrag(Parameters):
    """Drag and buoyancy act on 27 cells of a link, drag by the cell's own velocity, and so they turn it, too."""

    density: float = Field(default=1.25, ge=0.0, le=1e4)
    """ρ [kg/m²]; the slush's."""
    drag: float = Field(default=10.0, ge=0.0, le=1e4)
    """Coefficient of drag; the slush's."""

    def velocity_change(self, links: LinkStates, physics: Physics) -> VelocityChange:
        """Sum the forces on the cells; a cell is wet over 0.12 m of height."""
        dt, n_cells, shape = physics.time_step, CELLS.shape[1], np.shape(links.y)
        a, mass, inertia, y, cos, sin, vx, vy, omega, *_ = (
            np.broadcast_to(np.asarray(value), shape).reshape(-1) for value in vars(links).values()
        )
        along, across = CELLS.astype(y.dtype)
        rx = -sin * a * along + cos / a * across
        ry = cos * a * along + sin / a * across
        area = np.clip(0.5 - (y + ry) / 0.12, 0, 1) / n_cells
        ux, uy = vx - omega * ry, vy + omega * rx
        speed = np.sqrt(ux * ux + uy * uy)
        k = 0.5 * self.density * self.drag * area
        k = k / (1 + k * n_cells * speed * dt / mass)  # an explicit step would turn fast cells back
        fx = -k * speed * ux
        fy = -k * speed * uy + self.density * physics.gravity * area
        spin = (rx * fy - ry * fx).sum(axis=0) * dt / inertia
        limit = abs(omega) + 2
        changes = (fx.sum(axis=0) * dt / mass, fy.sum(axis=0) * dt / mass, np.clip(spin, -limit, limit))
        return VelocityChange(*(change.reshape(shape) for change in changes))


class MassCarriedAlong(Slush):
    """The slush, of which a link carries some along: gravity, buoyancy and drag move both, joints the link alone."""

    carried: float = Field(default=0.5, ge=0.0, le=100.0)
    """Mass of the fluid that is carried, as a share of the mass displaced."""

    def velocity_change(self, links: LinkStates, physics: Physics) -> VelocityChange:
        """Share the slush's change, and gravity's, which the simulator adds, between link and fluid."""
        area, second_moment = submerged_part(links.length_scale, links.y, links.cos, links.sin)
        alone = super().velocity_change(links, physics)
        share = links.mass / (links.mass + self.carried * self.density * area)
        turned = links.inertia / (links.inertia + self.carried * self.density * second_moment)
        fall = physics.gravity * physics.time_step
        return VelocityChange(vx=alone.vx * share, vy=(alone.vy - fall) * share + fall, omega=alone.omega * turned)


class LayeredSlush(Slush):
    """The slush, whose density grows with the depth of a link's centre."""

    growth: float = Field(default=0.3, ge=0.0, le=10.0)
    """Share by which the density grows [1/m]."""

    def velocity_change(self, links: LinkStates, physics: Physics) -> VelocityChange:
        """Apply the slush's drag and buoyancy at the density of the depth."""
        denser = 1 + self.growth * (-links.y).clip(0, None)
        dt = physics.time_step
        area, second_moment = submerged_part(links.length_scale, links.y, links.cos, links.sin)
        k = (0.5 * self.density * self.linear_drag * dt) * area * denser / links.mass
        k_r = (self.density * self.angular_drag * dt) * second_moment * denser / links.inertia
        speed = np.sqrt(links.vx * links.vx + links.vy * links.vy)
        lift = (self.density * physics.gravity * dt) * area * denser / links.mass
        return VelocityChange(
            vx=after_drag(links.vx, k * speed) - links.vx,
            vy=after_drag(links.vy, k * speed) + lift - links.vy,
            omega=after_drag(links.omega, k_r * abs(links.omega)) - links.omega,
        )


class EulerSlush(Slush):
    """The slush, whose drag is integrated by explicit steps; one that would reverse a velocity stops it."""

    @staticmethod
    def law(factors: Any, links: LinkStates) -> tuple[Any, Any, Any]:
        """Return the changes of vx, vy and ω in a step."""
        area, second_moment = submerged_part(links.length_scale, links.y, links.cos, links.sin)
        lost = factors[0] * area / links.mass * sqrt(links.vx * links.vx + links.vy * links.vy)
        lost_spin = factors[1] * second_moment / links.inertia * abs(links.omega)
        lost, lost_spin = select(lost < 1, lost, 1), select(lost_spin < 1, lost_spin, 1)
        return -lost * links.vx, factors[2] * area / links.mass - lost * links.vy, -lost_spin * links.omega


class LateSlush(Slush):
    """The slush, whose change by the state before a step is added after the solver, as E′(x) + φ(x) may be read."""

    def start(self, links: LinkStates, physics: Physics, depth: float) -> "Late":  # noqa: ARG002
        """Return the slush of a rollout."""
        return Late(self)


class Late:
    """What the next step begins with."""

    def __init__(self, slush: Slush) -> None:
        self.slush = slush
        self.change = VelocityChange(np.float32(0), np.float32(0), np.float32(0))

    def velocity_change(self, links: LinkStates, physics: Physics) -> VelocityChange:
        """Return the change by the last step's state, which ended with the change before it."""
        last = self.change
        state = replace(links, vx=links.vx + last.vx, vy=links.vy + last.vy, omega=links.omega + last.omega)
        self.change = self.slush.velocity_change(state, physics)
        return last


register_medium("point_drag", PointDrag, "Point Drag")
register_medium("mass_carried_along", MassCarriedAlong, "Mass Carried Along")
register_medium("layered_slush", LayeredSlush, "Layered Slush")
register_medium("euler_slush", EulerSlush, "Slush by Euler's Steps")
register_medium("late_slush", LateSlush, "Slush after the Solver")
