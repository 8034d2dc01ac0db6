"""Anisotropic slush: a fluid that resists a link's motion across its long axis more than along it.

Resistive force theory (Gray & Hancock 1955, "The Propulsion of Sea-Urchin Spermatozoa") has such drag, here quadratic
as in the slush. A tilted plate that sinks is pushed sideways, to a side that depends on the sign of its angle, so
networks must observe sin θ to learn it (``network.observation``). A fluid to test the learner with, which knows nothing
of it.
"""

from pydantic import Field

from tasks.parameters import Parameters
from tasks.world.medium import LinkStates, VelocityChange
from tasks.world.physics import Physics
from tasks.world.registry import register_medium
from tasks.world.slush import after_drag, submerged_part


class AnisotropicSlush(Parameters):
    """A slush with two coefficients of linear drag."""

    density: float = Field(default=1.25, ge=0.0, le=1e4)
    """ρ [kg/m²]; the slush's."""
    drag_along: float = Field(default=4.0, ge=0.0, le=1e4)
    """Coefficient of drag along the long axis."""
    drag_across: float = Field(default=16.0, ge=0.0, le=1e4)
    """Coefficient of drag across the long axis; with the other one, the mean is the slush's."""
    angular_drag: float = Field(default=20.0, ge=0.0, le=1e4)
    """C_dr; the slush's."""

    def velocity_change(self, links: LinkStates, physics: Physics) -> VelocityChange:
        """Compute the change by drag and then buoyancy over one step.

        Drag acts on the velocity v_l along the long axis (-sin θ, cos θ) and v_w across it, each by itself:
        dv_l/dt = -½ ρ C_l A_s / m |v_l| v_l, and v_w alike.
        """
        dt = physics.time_step
        area, second_moment = submerged_part(links.length_scale, links.y, links.cos, links.sin)
        along = links.cos * links.vy - links.sin * links.vx
        across = links.cos * links.vx + links.sin * links.vy
        k_along = (0.5 * self.density * self.drag_along * dt) * area / links.mass
        k_across = (0.5 * self.density * self.drag_across * dt) * area / links.mass
        k_r_dt = (self.density * self.angular_drag * dt) * second_moment / links.inertia
        lost_along = after_drag(along, k_along * abs(along)) - along
        lost_across = after_drag(across, k_across * abs(across)) - across
        lift = (self.density * physics.gravity * dt) * area / links.mass
        return VelocityChange(
            vx=links.cos * lost_across - links.sin * lost_along,
            vy=links.sin * lost_across + links.cos * lost_along + lift,
            omega=after_drag(links.omega, k_r_dt * abs(links.omega)) - links.omega,
        )


register_medium(
    "anisotropic_slush",
    AnisotropicSlush,
    "Anisotropic Slush",
    symbol="Eₐ",
    about="Slush with different drag along and across a link.",
)
