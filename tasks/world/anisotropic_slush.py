"""Anisotropic slush: a fluid that resists a link's motion across its long axis more than along it.

Resistive force theory (Gray & Hancock 1955, "The Propulsion of Sea-Urchin Spermatozoa") has such drag, here quadratic
as in the slush. A tilted plate that sinks is pushed sideways, to a side that depends on the sign of its angle, so
networks must observe sin θ to learn it, as the form ``signed_angle`` does. A fluid to test the learner with, which
knows nothing of it.
"""

from pydantic import Field

from tasks.simd.lanes import Numeric
from tasks.world.medium import Fluid, LinkStates
from tasks.world.physics import Physics
from tasks.world.registry import register_medium
from tasks.world.slush import after_drag, submerged_part


class AnisotropicSlush(Fluid):
    """A slush with two coefficients of linear drag."""

    density: float = Field(default=1.25, ge=0.0, le=1e4)
    """ρ [kg/m²]; the slush's."""
    drag_along: float = Field(default=4.0, ge=0.0, le=1e4)
    """Coefficient of drag along the long axis."""
    drag_across: float = Field(default=16.0, ge=0.0, le=1e4)
    """Coefficient of drag across the long axis; with the other one, the mean is the slush's."""
    angular_drag: float = Field(default=20.0, ge=0.0, le=1e4)
    """C_dr; the slush's."""

    def factors(self, physics: Physics) -> tuple[float, ...]:
        """Return ½ ρ C_l dt, ½ ρ C_w dt, ρ C_dr dt and ρ g dt."""
        dt, density = physics.time_step, self.density
        along, across = 0.5 * density * self.drag_along * dt, 0.5 * density * self.drag_across * dt
        return along, across, density * self.angular_drag * dt, density * physics.gravity * dt

    @staticmethod
    def law(factors: Numeric, links: LinkStates) -> tuple[Numeric, Numeric, Numeric]:
        """Return the changes by drag and then buoyancy.

        Drag acts on the velocity v_l along the long axis (-sin θ, cos θ) and v_w across it, each by itself:
        dv_l/dt = -½ ρ C_l A_s / m |v_l| v_l, and v_w alike.
        """
        cos, sin, mass, omega = links.cos, links.sin, links.mass, links.omega
        area, second_moment = submerged_part(links.length_scale, links.y, cos, sin)
        along, across = cos * links.vy - sin * links.vx, cos * links.vx + sin * links.vy
        lost_along = after_drag(along, factors[0] * area / mass * abs(along)) - along
        lost_across = after_drag(across, factors[1] * area / mass * abs(across)) - across
        turned = after_drag(omega, factors[2] * second_moment / links.inertia * abs(omega))
        lift = factors[3] * area / mass
        return cos * lost_across - sin * lost_along, sin * lost_across + cos * lost_along + lift, turned - omega


register_medium(
    "anisotropic_slush",
    AnisotropicSlush,
    "Anisotropic Slush",
    symbol="Eₐ",
    about="Slush with different drag along and across a link.",
)
