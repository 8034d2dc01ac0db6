"""Links fused to rigid bodies: states of links from the states of their bodies, and changes of bodies from their links.

A body's state is that of Box2D: position of its origin (its first link's centre), angle, velocity of its centre of
mass, angular velocity. All arithmetic is float32, in the order that is written here, for arrays and for the batch
engine; parentheses matter. A link that is a body by itself keeps every bit of its state.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from tasks.arrays import Float32, Floats
from tasks.compiled import formula
from tasks.design.body import RigidBodies
from tasks.simd.lanes import Numeric
from tasks.world.medium import VelocityChange


@dataclass(frozen=True, eq=False)
class PlacedLinks:
    """States of links; leading axes are (n_members, n_designs, n_links)."""

    state: Float32  # (..., 6) x, y [m], angle [rad], vx, vy [m/s] of the link's own centre, omega [rad/s]
    cos: Floats  # (...) cosine of the link's angle
    sin: Floats  # (...) sine of the link's angle
    lever_x: Floats  # (...) vector from the body's centre of mass to the link's centre, along x [m]
    lever_y: Floats  # (...) the same along y [m]


@formula
def _rotated(cos: Numeric, sin: Numeric, x: Numeric, y: Numeric) -> tuple[Numeric, Numeric]:
    return cos * x - sin * y, sin * x + cos * y


@formula
def placed(
    body: tuple[Numeric, ...], cos: Numeric, sin: Numeric, local: tuple[Numeric, ...], lever: tuple[Numeric, Numeric]
) -> tuple[tuple[Numeric, ...], ...]:
    """Return a link's state, the cosine and sine of its angle, and its lever; see :func:`place_links`.

    ``local`` is the link's x, y, angle, and the angle's cosine and sine, in the body's frame; so is ``lever``.
    """
    x, y, angle, vx, vy, omega = body
    local_x, local_y, local_angle, local_cos, local_sin = local
    lever_x, lever_y = _rotated(cos, sin, lever[0], lever[1])
    from_origin_x, from_origin_y = _rotated(cos, sin, local_x, local_y)
    pose = x + from_origin_x, y + from_origin_y, angle + local_angle
    velocity = vx - omega * lever_y, vy + omega * lever_x, omega
    return pose + velocity, _rotated(cos, sin, local_cos, local_sin), (lever_x, lever_y)


@formula
def turned(link: Any, lever: tuple[Numeric, Numeric], vx: Numeric, vy: Numeric, omega: Numeric) -> Numeric:
    """Return the change of a body's angular velocity by the velocity changes of a link; see :func:`body_change`."""
    return link.mass_over_inertia * (lever[0] * vy - lever[1] * vx) + link.inertia_share * omega


def place_links(rigid: RigidBodies, body: Float32, cos: Floats, sin: Floats) -> PlacedLinks:
    """Return the states of links by those of their bodies.

    With (c, s) the rotation of the body, R = (c, -s; s, c), p the link's centre and d its lever in the body's frame:

        centre = origin + R p      angle = body's + own      r = R d      v = v_body + ω × r = (vx - ω r_y, vy + ω r_x)

    ``body`` is the (n_members, n_designs, n_links, 6) state of each link's body, ``cos`` and ``sin`` those of its angle
    with Box2D's bits.
    """
    local = rigid.x, rigid.y, rigid.angle, rigid.cos, rigid.sin
    state, direction, lever = placed(tuple(np.moveaxis(body, -1, 0)), cos, sin, local, (rigid.lever_x, rigid.lever_y))
    return PlacedLinks(np.stack(state, axis=-1, dtype=np.float32), *direction, *lever)


def body_change(rigid: RigidBodies, lever_x: Floats, lever_y: Floats, change: VelocityChange) -> VelocityChange:
    """Return the velocity changes of bodies by those of their links: each at its first link, 0 at all others.

    A link i of mass m_i and inertia I_i whose velocities change by dv_i and dω_i, at r_i from the body's centre of
    mass, changes the body of mass M and inertia I by

        dv += (m_i / M) dv_i      dω += (m_i / I) (r_x dv_y - r_y dv_x) + (I_i / I) dω_i

    summed from 0 over the body's links in the order of their indices. All are (n_members, n_designs, n_links).
    """
    turn = turned(rigid, (lever_x, lever_y), change.vx, change.vy, change.omega)
    return VelocityChange(
        vx=_summed(rigid, rigid.mass_share * change.vx),
        vy=_summed(rigid, rigid.mass_share * change.vy),
        omega=_summed(rigid, turn),
    )


def _summed(rigid: RigidBodies, quantity: Floats) -> Floats:
    total = np.zeros_like(quantity)
    design = np.arange(len(rigid.first_link))
    for link in range(rigid.first_link.shape[1]):
        total[:, design, rigid.first_link[:, link]] += quantity[:, :, link]
    return total
