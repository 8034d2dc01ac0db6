"""Links as plates that fall through a fluid: they lift, flutter and tumble, and carry fluid along.

The quasi-steady model of Andersen, Pesavento and Wang (2005, J. Fluid Mech. 541, 65-90 and 91-104), whose coefficients
come from plates of aluminium in water. With u and w the velocities along and across a plate of half axes a and b, and
its added masses m11 = πρb² and m22 = πρa² and inertia I_a = πρ(a² - b²)²/8, which are those of an ellipse:

    (m + m11) u' = -(m + m22) ω w + ρΓ w - D u + weight      Γ = 2 C_T a uw/|v| + 2 C_R a² ω
    (m + m22) w' =  (m + m11) ω u - ρΓ u - D w + weight      D = ρa |v| (A - B (u² - w²)/|v|²)
    (I + I_a) ω' = (m22 - m11) uw - πρa⁴ (μ1 V/a + μ2 |ω|) ω      V² = |net weight| / πρa

Of a link that is partly under water, ρ is reduced to the share of its area in the forces, and of its second moment in
the torques. Joints and contacts push on a link's own mass alone. The share of a kick that the fluid holds back is taken
back in the next step, and joints then push again: a link's inertia builds up within a few steps, about 1 + m22/m.
"""

import math
from typing import Any, Self

from pydantic import Field, model_validator

from tasks.compiled import formula
from tasks.simd.lanes import any_lane, select, sqrt
from tasks.world.medium import Fluid, LinkStates
from tasks.world.physics import Physics
from tasks.world.registry import register_medium
from tasks.world.slush import TINY, lowest_corner, submerged_part


@formula
def _turned(u: Any, w: Any, c_u: Any, c_w: Any) -> tuple[Any, Any]:
    """Return u and w after a step of u' = 2 c_u w, w' = -2 c_w u by the implicit midpoint rule."""
    product = c_u * c_w
    unlike = 1 / (1 + select(product > -0.5, product, -0.5))
    return ((1 - product) * u + 2 * c_u * w) * unlike, ((1 - product) * w - 2 * c_w * u) * unlike


class FallingPlate(Fluid):
    """A fluid at rest below y = 0, in which links are plates."""

    reads_kicks = True

    density: float = Field(default=1.25, gt=0.0, le=1e4)
    """ρ [kg/m²]."""
    translational_lift: float = Field(default=1.2, ge=0.0, le=100.0)
    """C_T. Andersen et al. 2005."""
    rotational_lift: float = Field(default=math.pi, ge=0.0, le=100.0)
    """C_R. Andersen et al. 2005."""
    mean_drag: float = Field(default=1.4, ge=0.0, le=100.0)
    """A, mean of the drag coefficients across and along a plate. Andersen et al. 2005."""
    drag_difference: float = Field(default=1.0, ge=0.0, le=100.0)
    """B, half of their difference; at most A. Andersen et al. 2005."""
    slow_rotational_drag: float = Field(default=0.2, ge=0.0, le=100.0)
    """μ1, of drag that is linear in the rotation. Andersen et al. 2005."""
    rotational_drag: float = Field(default=0.2, ge=0.0, le=100.0)
    """μ2, of drag that is quadratic in the rotation. Andersen et al. 2005."""

    @model_validator(mode="after")
    def _drag_brakes(self) -> Self:
        if self.drag_difference > self.mean_drag:
            raise ValueError(
                f"drag_difference is {self.drag_difference:g}: expected at most mean_drag, {self.mean_drag:g}"
            )
        return self

    def factors(self, physics: Physics) -> tuple[float, ...]:
        """Return the time step, ρ, g, and the coefficients."""
        lift = self.translational_lift, self.rotational_lift
        drag = self.mean_drag, self.drag_difference, self.slow_rotational_drag, self.rotational_drag
        return physics.time_step, self.density, physics.gravity, *lift, *drag

    @staticmethod
    def law(factors: Any, links: LinkStates) -> tuple[Any, Any, Any]:
        """Return the changes of vx, vy and ω in a step."""
        dt, density, gravity, C_T, C_R = factors[0], factors[1], factors[2], factors[3], factors[4]
        A, B, mu_1, mu_2 = factors[5], factors[6], factors[7], factors[8]
        cos, sin, omega, mass = links.cos, links.sin, links.omega, links.mass
        if not any_lane(lowest_corner(links.length_scale, links.y, cos, sin) < 0.0):
            still = 0.0 * omega
            return still, still, still
        a, b = links.length_scale / 2, 0.5 / links.length_scale
        area, second_moment = submerged_part(links.length_scale, links.y, cos, sin)
        rho, rho_turning = density * area, density * second_moment * 3 / (a * a + b * b)

        m_along, m_across = mass + math.pi * rho * b * b, mass + math.pi * rho * a * a
        slender = a * a - b * b
        inertia = links.inertia + math.pi / 8 * rho_turning * slender * slender
        carried = math.pi * rho * slender  # m22 - m11
        u, w = cos * links.vy - sin * links.vx, cos * links.vx + sin * links.vy
        squared = u * u + w * w + TINY
        speed = sqrt(squared)

        lift = 2 * rho * a * (C_T * u * w / speed + C_R * a * omega)  # ρΓ
        half = 0.5 * dt
        new_u, new_w = _turned(
            u, w, half * (lift - carried * omega) / m_along, half * (lift + carried * omega) / m_across
        )
        drag = dt * rho * a * (A - B * (u * u - w * w) / squared) * speed
        new_u, new_w = new_u / (1 + drag / m_along), new_w / (1 + drag / m_across)
        rate = sqrt(abs(mass - density) * gravity / (math.pi * density * a)) / a  # V / a
        damping = dt * math.pi * rho_turning * a * a * a * a * (mu_1 * rate + mu_2 * abs(omega)) / inertia
        new_omega = (omega + dt * carried * u * w / inertia) / (1 + damping)

        # A fluid at rest gives no energy, however long the step.
        before = m_along * u * u + m_across * w * w + inertia * omega * omega
        after = m_along * new_u * new_u + m_across * new_w * new_w + inertia * new_omega * new_omega
        kept = select(after > before, sqrt(before / (after + TINY)), 1.0)

        kick_u = cos * links.kick_vy - sin * links.kick_vx
        kick_w = cos * links.kick_vx + sin * links.kick_vy
        back_u, back_w = (m_along - mass) / m_along, (m_across - mass) / m_across  # shares that the fluid holds back
        lifted = dt * gravity * density * area
        along = kept * new_u - u - back_u * (kick_u - dt * gravity * cos) + lifted * cos / m_along
        across = kept * new_w - w - back_w * (kick_w - dt * gravity * sin) + lifted * sin / m_across
        turning = kept * new_omega - omega - (inertia - links.inertia) / inertia * links.kick_omega
        return cos * across - sin * along, sin * across + cos * along, turning


register_medium(
    "falling_plate",
    FallingPlate,
    "Falling plates",
    symbol="P",
    about="Water in which links are plates that lift, flutter and tumble (Andersen, Pesavento and Wang 2005).",
)
