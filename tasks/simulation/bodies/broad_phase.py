"""Which boxes may touch: Box2D 2.3's b2BroadPhase, b2DynamicTree and b2ContactManager, operation by operation.

The tree only saves time: what it finds is every pair of fat AABBs that overlap, sorted by the proxies' numbers. Here all
pairs that may collide at all are listed in that order beforehand. The world's list of contacts has the newest first, as
have the lists of the bodies, which are parts of it; here it runs from the oldest to the newest, and is read backwards.
"""

from __future__ import annotations

from typing import Any

from tasks.simulation.bodies.polygons import update
from tasks.simulation.bodies.records import body_at, contact_at, fixture_at, whole
from tasks.simulation.bodies.rows import (
    CONTACT_LIST,
    EXISTS,
    FIXTURE_A,
    FIXTURE_B,
    FIXTURE_BODY,
    LOWER_X,
    LOWER_Y,
    N_CONTACTS,
    N_PAIRS,
    P_X,
    P_Y,
    POINT_COUNT,
    Q_C,
    Q_S,
    START_P_X,
    START_P_Y,
    START_Q_C,
    START_Q_S,
    UPPER_X,
    UPPER_Y,
    VERTEX_X,
    VERTEX_Y,
)
from tasks.simulation.contact import POLYGON_RADIUS
from tasks.simulation.lanes import any_lane, inline, select

AABB_EXTENSION = 0.1
"""b2_aabbExtension [m]."""
AABB_MULTIPLIER = 2.0
"""b2_aabbMultiplier: how many steps ahead an AABB reaches."""


@inline
def compute_aabb(box: Any, p_x: Any, p_y: Any, c: Any, s: Any) -> Any:
    """b2PolygonShape::ComputeAABB."""
    x, y = (c * box[VERTEX_X] - s * box[VERTEX_Y]) + p_x, (s * box[VERTEX_X] + c * box[VERTEX_Y]) + p_y
    lower_x, lower_y, upper_x, upper_y = x, y, x, y
    for i in (1, 2, 3):
        v_x, v_y = box[VERTEX_X + i], box[VERTEX_Y + i]
        x, y = (c * v_x - s * v_y) + p_x, (s * v_x + c * v_y) + p_y
        lower_x, lower_y = select(lower_x < x, lower_x, x), select(lower_y < y, lower_y, y)
        upper_x, upper_y = select(upper_x > x, upper_x, x), select(upper_y > y, upper_y, y)
    return lower_x - POLYGON_RADIUS, lower_y - POLYGON_RADIUS, upper_x + POLYGON_RADIUS, upper_y + POLYGON_RADIUS


@inline
def create_proxy(body: Any, box: Any) -> None:
    """b2DynamicTree::CreateProxy: a fat AABB around a box at its body's spawn."""
    lower_x, lower_y, upper_x, upper_y = compute_aabb(box, body[P_X], body[P_Y], body[Q_C], body[Q_S])
    box[LOWER_X], box[LOWER_Y] = lower_x - AABB_EXTENSION, lower_y - AABB_EXTENSION
    box[UPPER_X], box[UPPER_Y] = upper_x + AABB_EXTENSION, upper_y + AABB_EXTENSION


@inline
def synchronize(body: Any, box: Any) -> bool:
    """b2Fixture::Synchronize and b2DynamicTree::MoveProxy: whether a box has left its fat AABB and got another one."""
    ax, ay, bx, by = compute_aabb(box, body[START_P_X], body[START_P_Y], body[START_Q_C], body[START_Q_S])
    cx, cy, dx, dy = compute_aabb(box, body[P_X], body[P_Y], body[Q_C], body[Q_S])
    lower_x, lower_y = select(ax < cx, ax, cx), select(ay < cy, ay, cy)
    upper_x, upper_y = select(bx > dx, bx, dx), select(by > dy, by, dy)
    if any_lane(
        (box[LOWER_X] <= lower_x) & (box[LOWER_Y] <= lower_y) & (upper_x <= box[UPPER_X]) & (upper_y <= box[UPPER_Y])
    ):
        return False
    ahead_x = AABB_MULTIPLIER * (body[P_X] - body[START_P_X])
    ahead_y = AABB_MULTIPLIER * (body[P_Y] - body[START_P_Y])
    lower_x, lower_y = lower_x - AABB_EXTENSION, lower_y - AABB_EXTENSION
    upper_x, upper_y = upper_x + AABB_EXTENSION, upper_y + AABB_EXTENSION
    box[LOWER_X] = select(ahead_x < 0.0, lower_x + ahead_x, lower_x)
    box[UPPER_X] = select(ahead_x < 0.0, upper_x, upper_x + ahead_x)
    box[LOWER_Y] = select(ahead_y < 0.0, lower_y + ahead_y, lower_y)
    box[UPPER_Y] = select(ahead_y < 0.0, upper_y, upper_y + ahead_y)
    return True


@inline
def test_overlap(a: Any, b: Any) -> bool:
    """b2TestOverlap of fat AABBs (b2Collision.h)."""
    return not any_lane(
        (b[LOWER_X] - a[UPPER_X] > 0.0)
        | (b[LOWER_Y] - a[UPPER_Y] > 0.0)
        | (a[LOWER_X] - b[UPPER_X] > 0.0)
        | (a[LOWER_Y] - b[UPPER_Y] > 0.0)
    )


@inline
def find_new_contacts(block: Any) -> None:
    """b2ContactManager::FindNewContacts and AddPair."""
    n_contacts = whole(block[N_CONTACTS])
    for k in range(whole(block[N_PAIRS])):
        contact = contact_at(block, k)
        if any_lane(contact[EXISTS] == 0.0):
            box_a, box_b = fixture_at(block, whole(contact[FIXTURE_A])), fixture_at(block, whole(contact[FIXTURE_B]))
            if test_overlap(box_a, box_b):
                contact[EXISTS], contact[POINT_COUNT] = 1.0, 0.0
                block[CONTACT_LIST + n_contacts] = k
                n_contacts += 1
    block[N_CONTACTS] = n_contacts


@inline
def collide(block: Any) -> None:
    """b2ContactManager::Collide: update contacts, destroy those whose fat AABBs no longer overlap."""
    kept = 0
    for i in range(whole(block[N_CONTACTS])):
        k = whole(block[CONTACT_LIST + i])
        contact = contact_at(block, k)
        box_a, box_b = fixture_at(block, whole(contact[FIXTURE_A])), fixture_at(block, whole(contact[FIXTURE_B]))
        if test_overlap(box_a, box_b):
            body_a, body_b = body_at(block, whole(box_a[FIXTURE_BODY])), body_at(block, whole(box_b[FIXTURE_BODY]))
            update(contact, body_a, box_a, body_b, box_b)
            block[CONTACT_LIST + kept] = k
            kept += 1
        else:
            contact[EXISTS], contact[POINT_COUNT] = 0.0, 0.0
    block[N_CONTACTS] = kept
