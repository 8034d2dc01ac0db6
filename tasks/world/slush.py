"""Slush: a dense fluid with high drag below y = 0. Paper, "The Fluid Model".

The submerged part of a link is exact: a rectangle cut by a horizontal line. All forces act at the centre of mass; there
is no buoyant torque, so nothing depends on the sign of a link's angle. The paper leaves open whether drag acts on the
velocity or on its components: see :class:`DragLaw`.

The formulas compute in the precision of their arguments: float64 for the comparison with a polygon clipper, float32 in
the engines.
"""

from dataclasses import dataclass, field
from typing import Literal

from pydantic import Field

from tasks.compiled import formula
from tasks.simd.lanes import Numeric, any_lane, select, sqrt
from tasks.world.environment import Environment
from tasks.world.medium import Fluid, LinkStates, Medium
from tasks.world.physics import Physics
from tasks.world.registry import EnvironmentKind, register

PAPERS_TARGET = "true_slush"  # the environment that champions are transferred to, unless the settings say otherwise
TINY = 1e-30  # replaces the rise of a level edge, whose submerged share is a step function of depth


@formula
def _share(share: Numeric) -> Numeric:
    """Clamp to [0, 1]."""
    positive = select(share > 0.0, share, 0.0)
    return select(positive < 1.0, positive, 1.0)


@formula
def lowest_corner(length_scale: Numeric, y: Numeric, cos: Numeric, sin: Numeric) -> Numeric:
    """Return the height of rectangles' lowest corners over the surface [m]; see :func:`submerged_part`."""
    return y - (abs(sin) * (1 / length_scale) / 2 + abs(cos) * length_scale / 2)


@formula
def submerged_part(length_scale: Numeric, y: Numeric, cos: Numeric, sin: Numeric) -> tuple[Numeric, Numeric]:
    """Compute the parts of rectangles, upright at angle 0, below the water line y = 0.

    A rectangle of height a and width 1/a is the unit square in coordinates along its edges from the lowest corner. One
    of these edges rises by 2u, the other by 2v. With D the depth of the lowest corner, the water line cuts the four
    edges at shares t1 to t4, each clamped to [0, 1]:

        t1  from the lowest corner along the short edge        t3  along the long edge that follows t1's
        t2  from the lowest corner along the long edge         t4  along the short edge that follows t2's

    In all cases the submerged part is the polygon (0, 0), (t1, 0), (t1, t3), (t4, t2), (0, t2) in these coordinates.
    Its area follows from the shoelace formula, its second moment from Green's theorem.

    Args:
        length_scale: (...) long axis a [m].
        y: (...) height of the centre over the surface [m].
        cos: (...) cosine of the angle of the long axis with the vertical.
        sin: (...) sine of the same angle.

    Returns:
        (...) submerged area A_s [m²] and its second moment I_s about the rectangle's centre [m⁴].
    """
    width = 1 / length_scale
    half_rise_short = abs(sin) * width / 2  # u
    half_rise_long = abs(cos) * length_scale / 2  # v
    per_short = 0.5 / select(half_rise_short > TINY, half_rise_short, TINY)
    per_long = 0.5 / select(half_rise_long > TINY, half_rise_long, TINY)
    depth = half_rise_short + half_rise_long - y  # D
    t1, t2 = _share(depth * per_short), _share(depth * per_long)
    t3, t4 = _share((depth - 2 * half_rise_short) * per_long), _share((depth - 2 * half_rise_long) * per_short)
    area = (t1 * (t2 + t3) + t4 * (t2 - t3)) / 2

    # ∫P² dA = ∮ P³/3 dQ with P along the short axis and Q along the long one, both from the centre; and the reverse.
    p1, p4 = 2 * t1 - 1, 2 * t4 - 1
    q3, q2 = 2 * t3 - 1, 2 * t2 - 1
    across = width * width * ((t2 + t3) + (t2 - t3) * ((p1 * p1 + p4 * p4) * (p1 + p4)) / 4)
    along = length_scale * length_scale * ((t1 + t4) + (t1 - t4) * ((q2 * q2 + q3 * q3) * (q2 + q3)) / 4)
    second_moment = (across + along) / 24
    return area, select(second_moment > 0.0, second_moment, 0.0)


@formula
def after_drag(velocity: Numeric, lost: Numeric) -> Numeric:
    """Return a velocity after a step of quadratic drag, which loses the share ``lost``, k |v| dt, at its first rate.

    This is the exact solution of dv/dt = -k |v| v. Explicit Euler would overshoot above 10 m/s and diverge above 19
    m/s, and throws begin at up to 28 m/s.
    """
    return velocity / (1 + lost)


@formula
def slush_change(factors: Numeric, links: LinkStates, vx: Numeric) -> tuple[Numeric, Numeric, Numeric]:
    """Return the changes of vx, vy and ω by drag and then buoyancy.

    ``factors`` are those of :class:`Slush`, ``vx`` the velocity of the links relative to the slush [m/s].
    """
    drag, angular_drag, lift, by_component = factors[0], factors[1], factors[2], factors[3]
    vy, omega = links.vy, links.omega
    if not any_lane(lowest_corner(links.length_scale, links.y, links.cos, links.sin) < 0.0):
        still = 0.0 * vx
        return still, still, still
    area, second_moment = submerged_part(links.length_scale, links.y, links.cos, links.sin)
    k_dt, k_r_dt = drag * area / links.mass, angular_drag * second_moment / links.inertia
    speed = sqrt(vx * vx + vy * vy)
    speed_x, speed_y = select(by_component > 0.0, abs(vx), speed), select(by_component > 0.0, abs(vy), speed)
    after_y = after_drag(vy, k_dt * speed_y) + lift * area / links.mass
    return after_drag(vx, k_dt * speed_x) - vx, after_y - vy, after_drag(omega, k_r_dt * abs(omega)) - omega


class DragLaw(Fluid):
    """How the paper's slush acts, whatever its coefficients."""

    drag: Literal["vector", "by_component"] = "vector"
    """Drag opposes the velocity, quadratic in the speed, or each component by itself, quadratic in that component. The
    paper's k |v| v reads as the first, which does not depend on the choice of the axes."""

    @staticmethod
    def law(factors: Numeric, links: LinkStates) -> tuple[Numeric, Numeric, Numeric]:
        """Return the changes of vx, vy and ω in a step."""
        return slush_change(factors, links, links.vx)


class Slush(DragLaw):
    """The paper's slush.

    Drag is dv/dt = -k |v| v with k = ½ ρ C_dl A_s / m, and dω/dt = -k_r |ω| ω with k_r = ρ C_dr I_s / I.
    """

    density: float = Field(default=1.25, ge=0.0, le=1e4)
    """ρ [kg/m²]. [P]"""
    linear_drag: float = Field(default=10.0, ge=0.0, le=1e4)
    """C_dl. [P]"""
    angular_drag: float = Field(default=20.0, ge=0.0, le=1e4)
    """C_dr. [P]"""

    @property
    def is_papers(self) -> bool:
        """Whether the parameters are the paper's, however its drag law is read."""
        return self == Slush(drag=self.drag)

    def factors(self, physics: Physics) -> tuple[float, ...]:
        """Return ½ ρ C_dl dt, ρ C_dr dt, ρ g dt, and 1 where drag acts by component."""
        dt, density = physics.time_step, self.density
        return (
            0.5 * density * self.linear_drag * dt,
            density * self.angular_drag * dt,
            density * physics.gravity * dt,
            float(self.drag == "by_component"),
        )


@dataclass(frozen=True)
class TrueSlush(Environment):
    """E: Dry Land filled with slush below y = 0."""

    slush: Slush = field(default_factory=Slush)

    @property
    def medium(self) -> Medium:
        """True medium."""
        return self.slush


register(
    EnvironmentKind(
        name=PAPERS_TARGET,
        build=TrueSlush,
        settings_group="slush",
        settings=Slush,
        label="True Slush",
        symbol="E",
        evolved="in True Slush",
        about="Hard ground under slush of some depth.",
        order=1,
    )
)
