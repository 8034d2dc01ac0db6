"""Finding records in a robot's block, and Box2D's small things (Common/b2Math.h) on numbers of one lane."""

from __future__ import annotations

from typing import Any

from tasks.compiled import inline
from tasks.simulation.rigid_bodies.layout import (
    BODIES,
    C_X,
    C_Y,
    CENTER_X,
    CENTER_Y,
    CONTACT_BODY_A,
    CONTACT_BODY_B,
    CONTACTS,
    FIXTURE_A,
    FIXTURE_B,
    FIXTURES,
    JOINTS,
    N_BODY,
    N_CONTACT,
    N_FIXTURE,
    N_JOINT,
    N_POINT,
    P_X,
    P_Y,
    POINTS,
    Q_C,
    Q_S,
    A,
)
from tasks.simulation.simd.lanes import from_row, load_whole
from tasks.simulation.simd.rotation import sincos


@inline
def body_at(block: Any, index: Any) -> Any:
    """Find a body."""
    return from_row(block, BODIES + index * N_BODY)


@inline
def fixture_at(block: Any, index: Any) -> Any:
    """Find a fixture."""
    return from_row(block, FIXTURES + index * N_FIXTURE)


@inline
def contact_at(block: Any, index: Any) -> Any:
    """Find a contact."""
    return from_row(block, CONTACTS + index * N_CONTACT)


@inline
def fixtures_of(block: Any, contact: Any) -> Any:
    """Find the two fixtures of a contact."""
    return fixture_at(block, load_whole(contact, FIXTURE_A)), fixture_at(block, load_whole(contact, FIXTURE_B))


@inline
def bodies_of(block: Any, contact: Any) -> Any:
    """Find the two bodies of a contact."""
    return body_at(block, load_whole(contact, CONTACT_BODY_A)), body_at(block, load_whole(contact, CONTACT_BODY_B))


@inline
def point_at(contact: Any, index: Any) -> Any:
    """Find a contact's point."""
    return from_row(contact, POINTS + index * N_POINT)


@inline
def joint_at(block: Any, index: Any) -> Any:
    """Find a joint."""
    return from_row(block, JOINTS + index * N_JOINT)


@inline
def rotate(body: Any, x: Any, y: Any) -> Any:
    """b2Mul(xf.q, v): a vector of the body's frame in the world."""
    c, s = body[Q_C], body[Q_S]
    return c * x - s * y, s * x + c * y


@inline
def rotate_back(body: Any, x: Any, y: Any) -> Any:
    """b2MulT(xf.q, v): a vector of the world in the body's frame."""
    c, s = body[Q_C], body[Q_S]
    return c * x + s * y, -s * x + c * y


@inline
def transform(body: Any, x: Any, y: Any) -> Any:
    """b2Mul(xf, v): a point of the body's frame in the world."""
    turned_x, turned_y = rotate(body, x, y)
    return turned_x + body[P_X], turned_y + body[P_Y]


@inline
def synchronize_transform(body: Any) -> None:
    """b2Body::SynchronizeTransform, the rotation being up to date."""
    x, y = rotate(body, body[CENTER_X], body[CENTER_Y])
    body[P_X], body[P_Y] = body[C_X] - x, body[C_Y] - y


@inline
def place(body: Any, x: Any, y: Any, angle: Any) -> None:
    """Put a body's centre of mass and angle somewhere, and its frame with them."""
    body[C_X], body[C_Y], body[A] = x, y, angle
    body[Q_S], body[Q_C] = sincos(angle)
    synchronize_transform(body)
