"""Plain and wetted networks that see kicks: what joints, motors and contacts changed of a link's velocities.

Water takes back most of a kick, because it is accelerated with the link: its added mass. Thrown bars are never kicked,
so networks learn it from struck ones alone (the setting ``throws.design``).
"""

from dataclasses import replace
from typing import Any

from tasks.compiled import formula
from tasks.residual.forms import plain, wetted
from tasks.residual.forms.form import register_form


@formula
def _read_plain(links: Any) -> tuple[Any, ...]:
    return (*plain.read(links), links.sin, links.kick_vx, links.kick_vy, links.kick_omega)


@formula
def read_wetted(links: Any) -> tuple[Any, ...]:
    """Return the inputs of wetted networks, and the kick along a link, across it and of ω."""
    cos, sin, x, y = links.cos, links.sin, links.kick_vx, links.kick_vy
    return (*wetted.read(links), cos * y - sin * x, cos * x + sin * y, links.kick_omega)


register_form(
    replace(
        plain.PLAIN,
        name="plain_kicked",
        inputs=(*plain.PLAIN.inputs, "sin_angle", "kick_vx", "kick_vy", "kick_omega"),
        read=_read_plain,
        reads_kicks=True,
    )
)
(half_turn,) = wetted.WETTED.symmetries
WETTED = register_form(
    replace(
        wetted.WETTED,
        name="wetted_kicked",
        about=f"{wetted.WETTED.about} They also see what joints and motors changed of its velocity in the last step.",
        inputs=(*wetted.WETTED.inputs, "kick_along", "kick_across", "kick_omega"),
        read=read_wetted,
        reads_kicks=True,
        symmetries=((*half_turn, "kick_along", "kick_across"),),
        mirror=(*wetted.WETTED.mirror, "kick_across", "kick_omega"),
    )
)
