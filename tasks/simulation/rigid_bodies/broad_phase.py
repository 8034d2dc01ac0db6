"""Which boxes may touch: Box2D 2.3's b2BroadPhase, b2DynamicTree and b2ContactManager, operation by operation.

The tree only saves time: what it finds is every pair of fat AABBs that overlap, sorted by the proxies' numbers. Here
all pairs that may collide at all are listed in that order beforehand (b2ContactFilter::ShouldCollide and b2Body's have
no more to say). The world's list of contacts has the newest first, as have the lists of the bodies, which are parts of
it; here it runs from the oldest to the newest, and is read backwards.
"""

from __future__ import annotations

from typing import Any

from tasks.compiled import inline
from tasks.simulation.rigid_bodies.layout import (
    CENTROID_X,
    CENTROID_Y,
    CONTACT_BODY_A,
    CONTACT_LIST,
    EXISTS,
    FAT_LOWER_X,
    FAT_LOWER_Y,
    FAT_UPPER_X,
    FAT_UPPER_Y,
    GROUND,
    LOWER_X,
    LOWER_Y,
    N_CONTACTS,
    N_PAIRS,
    NORMAL_X,
    NORMAL_Y,
    P_X,
    P_Y,
    POINT_COUNT,
    START_P_X,
    START_P_Y,
    UPPER_X,
    UPPER_Y,
    VERTEX_X,
    VERTEX_Y,
    WORLD_CENTROID_X,
    WORLD_CENTROID_Y,
    WORLD_NORMAL_X,
    WORLD_NORMAL_Y,
    WORLD_VERTEX_X,
    WORLD_VERTEX_Y,
)
from tasks.simulation.rigid_bodies.polygons import update
from tasks.simulation.rigid_bodies.records import bodies_of, contact_at, fixtures_of, rotate, transform
from tasks.simulation.simd.lanes import any_lane, load_whole, select, store_whole
from tasks.simulation.trees.contact import POLYGON_RADIUS

AABB_EXTENSION = 0.1
"""b2_aabbExtension [m]."""
AABB_MULTIPLIER = 2.0
"""b2_aabbMultiplier: how many steps ahead an AABB reaches."""


@inline
def orient(body: Any, box: Any) -> None:
    """Find a box's corners, normals and AABB in the world: b2Mul, and b2PolygonShape::ComputeAABB."""
    box[WORLD_CENTROID_X], box[WORLD_CENTROID_Y] = transform(body, box[CENTROID_X], box[CENTROID_Y])
    for i in range(4):
        x, y = transform(body, box[VERTEX_X + i], box[VERTEX_Y + i])
        box[WORLD_VERTEX_X + i], box[WORLD_VERTEX_Y + i] = x, y
        x, y = rotate(body, box[NORMAL_X + i], box[NORMAL_Y + i])
        box[WORLD_NORMAL_X + i], box[WORLD_NORMAL_Y + i] = x, y
    lower_x, lower_y = box[WORLD_VERTEX_X], box[WORLD_VERTEX_Y]
    upper_x, upper_y = lower_x, lower_y
    for i in range(1, 4):
        x, y = box[WORLD_VERTEX_X + i], box[WORLD_VERTEX_Y + i]
        lower_x, lower_y = select(lower_x < x, lower_x, x), select(lower_y < y, lower_y, y)
        upper_x, upper_y = select(upper_x > x, upper_x, x), select(upper_y > y, upper_y, y)
    box[LOWER_X], box[LOWER_Y] = lower_x - POLYGON_RADIUS, lower_y - POLYGON_RADIUS
    box[UPPER_X], box[UPPER_Y] = upper_x + POLYGON_RADIUS, upper_y + POLYGON_RADIUS


@inline
def create_proxy(box: Any) -> None:
    """b2DynamicTree::CreateProxy: a fat AABB around a box at its body's spawn."""
    box[FAT_LOWER_X], box[FAT_LOWER_Y] = box[LOWER_X] - AABB_EXTENSION, box[LOWER_Y] - AABB_EXTENSION
    box[FAT_UPPER_X], box[FAT_UPPER_Y] = box[UPPER_X] + AABB_EXTENSION, box[UPPER_Y] + AABB_EXTENSION


@inline
def synchronize(body: Any, box: Any) -> bool:
    """b2Fixture::Synchronize and b2DynamicTree::MoveProxy: whether a box has left its fat AABB and got another one."""
    lower_x, lower_y, upper_x, upper_y = box[LOWER_X], box[LOWER_Y], box[UPPER_X], box[UPPER_Y]
    orient(body, box)
    lower_x = select(lower_x < box[LOWER_X], lower_x, box[LOWER_X])
    lower_y = select(lower_y < box[LOWER_Y], lower_y, box[LOWER_Y])
    upper_x = select(upper_x > box[UPPER_X], upper_x, box[UPPER_X])
    upper_y = select(upper_y > box[UPPER_Y], upper_y, box[UPPER_Y])
    if any_lane(
        (box[FAT_LOWER_X] <= lower_x)
        & (box[FAT_LOWER_Y] <= lower_y)
        & (upper_x <= box[FAT_UPPER_X])
        & (upper_y <= box[FAT_UPPER_Y])
    ):
        return False
    ahead_x = AABB_MULTIPLIER * (body[P_X] - body[START_P_X])
    ahead_y = AABB_MULTIPLIER * (body[P_Y] - body[START_P_Y])
    lower_x, lower_y = lower_x - AABB_EXTENSION, lower_y - AABB_EXTENSION
    upper_x, upper_y = upper_x + AABB_EXTENSION, upper_y + AABB_EXTENSION
    box[FAT_LOWER_X] = select(ahead_x < 0.0, lower_x + ahead_x, lower_x)
    box[FAT_UPPER_X] = select(ahead_x < 0.0, upper_x, upper_x + ahead_x)
    box[FAT_LOWER_Y] = select(ahead_y < 0.0, lower_y + ahead_y, lower_y)
    box[FAT_UPPER_Y] = select(ahead_y < 0.0, upper_y, upper_y + ahead_y)
    return True


@inline
def test_overlap(a: Any, b: Any) -> bool:
    """b2TestOverlap of fat AABBs (b2Collision.h)."""
    return not any_lane(
        (b[FAT_LOWER_X] - a[FAT_UPPER_X] > 0.0)
        | (b[FAT_LOWER_Y] - a[FAT_UPPER_Y] > 0.0)
        | (a[FAT_LOWER_X] - b[FAT_UPPER_X] > 0.0)
        | (a[FAT_LOWER_Y] - b[FAT_UPPER_Y] > 0.0)
    )


@inline
def find_new_contacts(block: Any) -> None:
    """b2ContactManager::FindNewContacts and AddPair."""
    n_contacts = load_whole(block, N_CONTACTS)
    for k in range(load_whole(block, N_PAIRS)):
        contact = contact_at(block, k)
        if load_whole(contact, EXISTS) == 0:
            box_a, box_b = fixtures_of(block, contact)
            if test_overlap(box_a, box_b):
                store_whole(contact, EXISTS, 1)
                store_whole(contact, POINT_COUNT, 0)
                store_whole(block, CONTACT_LIST + n_contacts, k)
                n_contacts += 1
    store_whole(block, N_CONTACTS, n_contacts)


@inline
def collide(block: Any) -> None:
    """b2ContactManager::Collide: update contacts, destroy those whose fat AABBs no longer overlap."""
    kept = 0
    for i in range(load_whole(block, N_CONTACTS)):
        k = load_whole(block, CONTACT_LIST + i)
        contact = contact_at(block, k)
        box_a, box_b = fixtures_of(block, contact)
        if test_overlap(box_a, box_b):
            body_a, body_b = bodies_of(block, contact)
            update(contact, body_a, box_a, body_b, box_b, load_whole(contact, CONTACT_BODY_A) == GROUND)
            store_whole(block, CONTACT_LIST + kept, k)
            kept += 1
        else:
            store_whole(contact, EXISTS, 0)
            store_whole(contact, POINT_COUNT, 0)
    store_whole(block, N_CONTACTS, kept)
