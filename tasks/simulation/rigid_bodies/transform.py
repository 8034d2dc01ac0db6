"""Rotations and transforms of bodies: Box2D 2.3's Common/b2Math.h."""

from numpy import float32

from tasks.compiled import inline
from tasks.simd.rotation import scalar_sincos
from tasks.simulation.rigid_bodies.layout import BodyRecord

Vector = tuple[float32, float32]  # b2Vec2


@inline
def rotate(body: BodyRecord, v: Vector) -> Vector:
    """b2Mul(xf.q, v): from the body's frame to the world's."""
    x, y = v
    return body.cos * x - body.sin * y, body.sin * x + body.cos * y


@inline
def rotate_back(body: BodyRecord, v: Vector) -> Vector:
    """b2MulT(xf.q, v): from the world's frame to the body's."""
    x, y = v
    return body.cos * x + body.sin * y, -body.sin * x + body.cos * y


@inline
def transform(body: BodyRecord, v: Vector) -> Vector:
    """b2Mul(xf, v): a point of the body's frame in the world."""
    x, y = rotate(body, v)
    return x + body.p_x, y + body.p_y


@inline
def synchronize_transform(body: BodyRecord) -> None:
    """b2Body::SynchronizeTransform, where cos and sin are up to date."""
    x, y = rotate(body, (body.local_center_x, body.local_center_y))
    body.p_x, body.p_y = body.c_x - x, body.c_y - y


@inline
def place(body: BodyRecord, c: Vector, a: float32) -> None:
    """Set a body's centre of mass and angle, and its frame accordingly."""
    body.c_x, body.c_y = c
    body.a = a
    body.sin, body.cos = scalar_sincos(a)
    synchronize_transform(body)
