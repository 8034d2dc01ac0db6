"""Which boxes may touch: Box2D 2.3's b2BroadPhase, b2DynamicTree and b2ContactManager, operation by operation.

The tree only saves time: it finds every pair of fat AABBs that overlap, ordered by proxy. Here all pairs that may
collide (b2ContactFilter::ShouldCollide, b2Body::ShouldCollide) are listed in that order beforehand. Box2D's lists of
contacts begin with the newest; ``contact_list`` begins with the oldest and is read backwards.
"""

from numpy import float32

from tasks.compiled import inline
from tasks.simulation.box2d import POLYGON_RADIUS
from tasks.simulation.rigid_bodies.layout import BodyRecord, FixtureRecord, RobotRecord
from tasks.simulation.rigid_bodies.polygons import update
from tasks.simulation.rigid_bodies.transform import rotate, transform

_AABB_EXTENSION = float32(0.1)  # b2_aabbExtension [m]
_AABB_MULTIPLIER = float32(2.0)  # b2_aabbMultiplier: steps that a fat AABB looks ahead


@inline
def orient(body: BodyRecord, box: FixtureRecord) -> None:
    """Compute a box's corners, normals and AABB in the world: b2Mul and b2PolygonShape::ComputeAABB."""
    box.centroid_x, box.centroid_y = transform(body, (box.local_centroid_x, box.local_centroid_y))
    for i in range(4):
        box.vertex_x[i], box.vertex_y[i] = transform(body, (box.local_vertex_x[i], box.local_vertex_y[i]))
        box.normal_x[i], box.normal_y[i] = rotate(body, (box.local_normal_x[i], box.local_normal_y[i]))
    lower_x, lower_y = box.vertex_x[0], box.vertex_y[0]
    upper_x, upper_y = lower_x, lower_y
    for i in range(1, 4):
        x, y = box.vertex_x[i], box.vertex_y[i]
        lower_x, lower_y = lower_x if lower_x < x else x, lower_y if lower_y < y else y
        upper_x, upper_y = upper_x if upper_x > x else x, upper_y if upper_y > y else y
    box.lower_x, box.lower_y = lower_x - POLYGON_RADIUS, lower_y - POLYGON_RADIUS
    box.upper_x, box.upper_y = upper_x + POLYGON_RADIUS, upper_y + POLYGON_RADIUS


@inline
def create_proxy(box: FixtureRecord) -> None:
    """b2DynamicTree::CreateProxy: the fat AABB of a box at the spawn."""
    box.fat_lower_x, box.fat_lower_y = box.lower_x - _AABB_EXTENSION, box.lower_y - _AABB_EXTENSION
    box.fat_upper_x, box.fat_upper_y = box.upper_x + _AABB_EXTENSION, box.upper_y + _AABB_EXTENSION


@inline
def synchronize(body: BodyRecord, box: FixtureRecord) -> bool:
    """b2Fixture::Synchronize and b2DynamicTree::MoveProxy; return whether the box has a new fat AABB."""
    lower_x, lower_y, upper_x, upper_y = box.lower_x, box.lower_y, box.upper_x, box.upper_y
    orient(body, box)
    lower_x = lower_x if lower_x < box.lower_x else box.lower_x
    lower_y = lower_y if lower_y < box.lower_y else box.lower_y
    upper_x = upper_x if upper_x > box.upper_x else box.upper_x
    upper_y = upper_y if upper_y > box.upper_y else box.upper_y
    inside_x = box.fat_lower_x <= lower_x and upper_x <= box.fat_upper_x
    if inside_x and box.fat_lower_y <= lower_y and upper_y <= box.fat_upper_y:
        return False
    ahead_x = _AABB_MULTIPLIER * (body.p_x - body.start_p_x)
    ahead_y = _AABB_MULTIPLIER * (body.p_y - body.start_p_y)
    lower_x, lower_y = lower_x - _AABB_EXTENSION, lower_y - _AABB_EXTENSION
    upper_x, upper_y = upper_x + _AABB_EXTENSION, upper_y + _AABB_EXTENSION
    box.fat_lower_x = lower_x + ahead_x if ahead_x < 0.0 else lower_x
    box.fat_upper_x = upper_x if ahead_x < 0.0 else upper_x + ahead_x
    box.fat_lower_y = lower_y + ahead_y if ahead_y < 0.0 else lower_y
    box.fat_upper_y = upper_y if ahead_y < 0.0 else upper_y + ahead_y
    return True


@inline
def test_overlap(a: FixtureRecord, b: FixtureRecord) -> bool:
    """b2TestOverlap of fat AABBs (b2Collision.h)."""
    apart_x = b.fat_lower_x - a.fat_upper_x > 0.0 or a.fat_lower_x - b.fat_upper_x > 0.0
    return not (apart_x or b.fat_lower_y - a.fat_upper_y > 0.0 or a.fat_lower_y - b.fat_upper_y > 0.0)


@inline
def find_new_contacts(robot: RobotRecord) -> None:
    """b2ContactManager::FindNewContacts and AddPair."""
    for k in range(robot.n_pairs):
        contact = robot.contacts[k]
        box_a, box_b = robot.fixtures[contact.fixture_a], robot.fixtures[contact.fixture_b]
        if contact.exists == 0 and test_overlap(box_a, box_b):
            contact.exists, contact.point_count = 1, 0
            robot.contact_list[robot.n_contacts] = k
            robot.n_contacts = robot.n_contacts + 1


@inline
def collide(robot: RobotRecord) -> None:
    """b2ContactManager::Collide: update contacts, and destroy those whose fat AABBs no longer overlap."""
    n_left = 0
    for i in range(robot.n_contacts):
        k = robot.contact_list[i]
        contact = robot.contacts[k]
        if test_overlap(robot.fixtures[contact.fixture_a], robot.fixtures[contact.fixture_b]):
            update(robot, contact)
            robot.contact_list[n_left] = k
            n_left += 1
        else:
            contact.exists, contact.point_count = 0, 0
    robot.n_contacts = n_left
