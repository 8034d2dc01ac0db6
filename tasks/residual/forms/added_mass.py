"""Wetted networks that also predict added mass: which shares of a kick the fluid takes back.

A kick is what joints, motors and contacts changed of a link's velocities. Water takes back most of it, because it is
accelerated with the link. Thrown bars are never kicked, so networks learn it from struck ones alone (the setting
``throws.design``). In a link's axes, with shares c of a kick k,

    Δv = A_s ((f_t - c_t k_t) t + (f_n - c_n k_n) n + b ŷ),    Δω = J (f_ω - c_ω k_ω)

The outputs do not depend on the kick, so kicks that are larger than those of struck bars teach nothing wrong.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from tasks.arrays import Float32
from tasks.compiled import formula
from tasks.residual.forms import wetted
from tasks.residual.forms.form import Targets, register_form
from tasks.simd.lanes import from_row, select

if TYPE_CHECKING:
    from tasks.residual.throws import Transitions


_KICK, _N_SEEN = ("kick_along", "kick_across", "kick_omega"), len(wetted.WETTED.inputs)
_SHARES = ("along", "across", "omega")
(half_turn,) = wetted.WETTED.symmetries


@formula
def read(links: Any) -> tuple[Any, ...]:
    """Return the inputs of wetted networks, and the kick along a link, across it and of ω."""
    cos, sin, x, y = links.cos, links.sin, links.kick_vx, links.kick_vy
    return (*wetted.read(links), cos * y - sin * x, cos * x + sin * y, links.kick_omega)


@formula
def _share(c: Any) -> Any:
    least = select(c > 0.0, c, 0.0)
    return select(least < 1.0, least, 1.0)


@formula
def act(outputs: Any, read: Any) -> tuple[Any, Any, Any]:
    """Return the changes of vx, vy and ω by outputs and what is read."""
    kick = from_row(read, _N_SEEN)
    along = outputs[0] - _share(outputs[4]) * kick[0]
    across = outputs[1] - _share(outputs[5]) * kick[1]
    return wetted.act((along, across, outputs[2] - _share(outputs[6]) * kick[2], outputs[3]), read)


def _measured(read: Float32, change: Float32) -> Float32:
    """Return the same as of wetted networks, and in the unit of c, changes per root mean square of a kick."""
    measured, kick = wetted.WETTED.measured(read, change), read[:, _N_SEEN : _N_SEEN + 3]
    scale = np.sqrt(np.square(kick).mean(axis=0))
    return np.concatenate((measured, measured[:, :3] / np.where(scale > 0, scale, 1)), axis=1)


def _targets(read: Float32, change: Float32, weights: Float32, deviation: Float32) -> Targets:
    targets, kick = wetted.WETTED.targets(read, change, weights, deviation), read[:, _N_SEEN : _N_SEEN + 3]
    of_each = [-kick * np.eye(3, dtype=np.float32)[i] * (deviation[4 + i] / deviation[i]) for i in range(3)]
    return targets._replace(shares=np.concatenate((targets.shares, *of_each), axis=1))


def _unstruck(transitions: Transitions) -> str:
    """Say that no throw shows added mass, or that there is a current."""
    said = "no bar was struck, so networks do not learn which share of kicks the fluid takes back: use struck throws"
    return wetted.WETTED.warning(transitions) if transitions.kick.any() else said


WETTED_MASS = register_form(
    replace(
        wetted.WETTED,
        name="wetted_mass",
        about=f"{wetted.WETTED.about} They also predict its added mass: what share of a kick by joints and motors the "
        "fluid takes back.",
        read=read,
        unseen=_KICK,
        reads_kicks=True,
        outputs=(*wetted.WETTED.outputs, *_SHARES),
        shares=_SHARES,
        act=act,
        measured=_measured,
        targets=_targets,
        symmetries=((*half_turn, *_KICK[:2]),),
        mirror=(*wetted.WETTED.mirror, *_KICK[1:]),
        warning=_unstruck,
    )
)
