"""The wetted form: networks know what is under water.

A link is a rectangle, the waterline is y = 0, and a fluid acts on what is below it. So a network of this form observes
how much of the link that is, and its outputs f act along the link's own axes on that much,

    Δv = A_s (f_t t + f_n n + b ŷ),    Δω = J f_ω,    t = (-sin θ, cos θ),    n = (cos θ, sin θ)

with A_s the submerged area [of 1 m²] and J the submerged share of the second moment of area. A dry link feels nothing,
whatever the weights. Training minimises the squared error of Δv and Δω in the link's axes,

    A_s² (f_t + b cos θ - Δv_t / A_s)² + A_s² (f_n + b sin θ - Δv_n / A_s)² + J² (f_ω - Δω / J)²

Half a turn makes the same rectangle, and the mirror image of a motion is a motion unless the fluid flows, which throws
show.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from tasks.arrays import Float32
from tasks.compiled import formula
from tasks.residual.current import current, is_current
from tasks.residual.forms.form import Form, Targets, register_form
from tasks.simd.lanes import sqrt
from tasks.simulation.engine import links_in
from tasks.simulation.free_links import FreeLinks
from tasks.world.medium import Medium, MediumWithMemory
from tasks.world.physics import Physics
from tasks.world.slush import submerged_part

if TYPE_CHECKING:
    from tasks.residual.throws import Transitions

_DRY = 1e-6  # A_s and J below which a link counts as dry in training


@formula
def read(links: Any) -> tuple[Any, ...]:
    """Return the inputs of links."""
    a, cos, sin, vx, vy, omega = links.length_scale, links.cos, links.sin, links.vx, links.vy, links.omega
    area, second_moment = submerged_part(a, links.y, cos, sin)
    width = 1 / a
    share = second_moment * 12 / (width * width + a * a)
    along, across = cos * vy - sin * vx, cos * vx + sin * vy
    speed = sqrt(along * along + across * across)
    squares = abs(along) * along, abs(across) * across
    return area, share, cos, sin, along, across, omega, links.y, a, speed, abs(omega), squares[0], squares[1]


@formula
def act(outputs: Any, inputs: Any) -> tuple[Any, Any, Any]:
    """Return the changes of vx, vy and ω by outputs and inputs."""
    area, share, cos, sin = inputs[0], inputs[1], inputs[2], inputs[3]
    along, across, lift = area * outputs[0], area * outputs[1], area * outputs[3]
    return cos * across - sin * along, (sin * across + cos * along) + lift, share * outputs[2]


def _measured(inputs: Float32, change: Float32) -> Float32:
    """Return changes along the link, across it and of ω, and once more along it, the unit of b."""
    cos, sin = inputs[:, 2], inputs[:, 3]
    vx, vy, omega = change.T
    along = cos * vy - sin * vx
    return np.stack((along, cos * vx + sin * vy, omega, along), axis=-1)


def _targets(inputs: Float32, change: Float32, weights: Float32, deviation: Float32) -> Targets:
    """Return targets Δv / A_s and Δω / J, their weights A_s² and J², and shares cos θ and sin θ of b."""
    part = inputs[:, [0, 0, 1]]
    wet = part > _DRY
    values = np.divide(change[:, :3], part, out=np.zeros_like(part), where=wet)
    shares = np.pad(inputs[:, 2:4] * (deviation[3] / deviation[:2]), ((0, 0), (0, 1)))
    return Targets(values, wet * weights * part * part, shares)


def _acts_above_water(medium: Medium | MediumWithMemory, physics: Physics) -> str:
    """Object to a medium that changes the motion of dry links."""
    lengths = np.linspace(1.0, 3.0, 9)
    dry = np.tile(np.array([0.0, 2.0, 0.0, 3.0, -2.0, 4.0], np.float32), (9, 1))
    dry[:, 2] = np.linspace(0.0, 6.0, 9)
    after, falling = links_in(medium, lengths, physics)(dry), FreeLinks(lengths, physics).step(dry, None)
    acts = abs(after - falling)[:, 3:].max() > 1e-5  # [m/s]; engines round differently
    return "acts above y = 0, where such networks see nothing: expected plain" if acts else ""


def _flows(transitions: Transitions) -> str:
    """Say that there is a current."""
    flow, sd = current(transitions)
    if not is_current(flow, sd):
        return ""
    return f"the fluid flows at {flow:.2f} ± {sd:.2f} m/s, so networks do not learn from mirror images: use more throws"


WETTED = register_form(
    Form(
        name="wetted",
        about="Networks are wetted: they are told how much of a link is under water, and predict forces on that part "
        "alone, so that a dry link feels nothing.",
        inputs=(
            *("submerged_area", "submerged_share", "cos_angle", "sin_angle", "along", "across", "omega", "y", "a"),
            *("speed", "abs_omega", "along_squared", "across_squared"),
        ),
        read=read,
        outputs=("along", "across", "omega", "along"),
        act=act,
        measured=_measured,
        targets=_targets,
        symmetries=(
            ("cos_angle", "sin_angle", "along", "across", "along_squared", "across_squared"),  # half a turn
        ),
        mirror=("sin_angle", "across", "omega", "across_squared"),
        objection=_acts_above_water,
        warning=_flows,
    )
)
