"""The manifold of two boxes: Box2D 2.3's Collision/b2CollidePolygon.cpp and b2Contact::Update, operation by operation.

Boxes have four corners and four edges, edge i going from corner i to corner i + 1.
"""

from numpy import float32

from tasks.compiled import inline
from tasks.simulation.box2d import TOTAL_RADIUS
from tasks.simulation.rigid_bodies.layout import GROUND, BodyRecord, ContactRecord, FixtureRecord, RobotRecord
from tasks.simulation.rigid_bodies.transform import rotate, rotate_back

_RELATIVE_TOLERANCE, _ABSOLUTE_TOLERANCE = float32(0.98), float32(0.001)
_ZERO, _HALF = float32(0), float32(0.5)

_TOP = 2  # the upper edge of the ground

# A b2ContactID as a whole number: the indices of A's and B's features, and whether they are faces.
INDEX_B, FACE_OF_A, FACE_OF_B = 4, 16, 32


@inline
def _edge_separation(box_1: FixtureRecord, edge: int, body_2: BodyRecord, box_2: FixtureRecord) -> float32:
    """b2EdgeSeparation: the distance of box 2 from an edge of box 1, along its normal."""
    normal_x, normal_y = box_1.normal_x[edge], box_1.normal_y[edge]
    local_x, local_y = rotate_back(body_2, (normal_x, normal_y))
    least = box_2.local_vertex_x[0] * local_x + box_2.local_vertex_y[0] * local_y
    support = 0
    for i in range(1, 4):
        dot = box_2.local_vertex_x[i] * local_x + box_2.local_vertex_y[i] * local_y
        if dot < least:
            least, support = dot, i
    d_x, d_y = box_2.vertex_x[support] - box_1.vertex_x[edge], box_2.vertex_y[support] - box_1.vertex_y[edge]
    return d_x * normal_x + d_y * normal_y


@inline
def _find_max_separation(
    body_1: BodyRecord, box_1: FixtureRecord, body_2: BodyRecord, box_2: FixtureRecord
) -> tuple[int, float32]:
    """b2FindMaxSeparation: the edge of box 1 that separates most, and its separation.

    Box2D climbs from the edge that faces box 2, from neighbour to neighbour. The separation only grows on the way, so
    the climb stops here once the boxes can't touch.
    """
    d_x, d_y = box_2.centroid_x - box_1.centroid_x, box_2.centroid_y - box_1.centroid_y
    local_x, local_y = rotate_back(body_1, (d_x, d_y))
    most = box_1.local_normal_x[0] * local_x + box_1.local_normal_y[0] * local_y
    edge = 0
    for i in range(1, 4):
        dot = box_1.local_normal_x[i] * local_x + box_1.local_normal_y[i] * local_y
        if dot > most:
            most, edge = dot, i

    s = _edge_separation(box_1, edge, body_2, box_2)
    if s > TOTAL_RADIUS:
        return edge, s
    previous, following = (edge + 3) & 3, (edge + 1) & 3
    s_previous = _edge_separation(box_1, previous, body_2, box_2)
    s_next = _edge_separation(box_1, following, body_2, box_2)
    if s_previous > s and s_previous > s_next:
        increment, best, best_separation = 3, previous, s_previous
    elif s_next > s:
        increment, best, best_separation = 1, following, s_next
    else:
        return edge, s
    while not best_separation > TOTAL_RADIUS:
        edge = (best + increment) & 3
        s = _edge_separation(box_1, edge, body_2, box_2)
        if not s > best_separation:
            break
        best, best_separation = edge, s
    return best, best_separation


@inline
def _find_incident_edge(box_1: FixtureRecord, edge: int, body_2: BodyRecord, box_2: FixtureRecord) -> int:
    """b2FindIncidentEdge: the edge of box 2 that faces an edge of box 1."""
    local_x, local_y = rotate_back(body_2, (box_1.normal_x[edge], box_1.normal_y[edge]))
    least = local_x * box_2.local_normal_x[0] + local_y * box_2.local_normal_y[0]
    incident = 0
    for i in range(1, 4):
        dot = local_x * box_2.local_normal_x[i] + local_y * box_2.local_normal_y[i]
        if dot < least:
            least, incident = dot, i
    return incident


ClipVertex = tuple[float32, float32, int]  # b2ClipVertex: x, y [m] and the contact's id


@inline
def _clip_segment_to_line(
    v0: ClipVertex, v1: ClipVertex, normal_x: float32, normal_y: float32, offset: float32, vertex: int
) -> tuple[bool, ClipVertex, ClipVertex]:
    """b2ClipSegmentToLine (b2Collision.cpp): clip a segment to the half-plane behind a line of a unit normal.

    ``vertex`` is the reference box's corner on the line. Returns whether a part with two ends is left, and its ends.
    """
    x0, y0, id0 = v0
    x1, y1, _ = v1
    distance_0 = normal_x * x0 + normal_y * y0 - offset
    distance_1 = normal_x * x1 + normal_y * y1 - offset
    behind_0, behind_1 = distance_0 <= 0.0, distance_1 <= 0.0
    if behind_0 and behind_1:
        return True, v0, v1
    if not distance_0 * distance_1 < 0.0:
        return False, v0, v1
    share = distance_0 / (distance_0 - distance_1)
    crossing = x0 + share * (x1 - x0), y0 + share * (y1 - y0), vertex + (id0 & (3 * INDEX_B)) + FACE_OF_B
    return True, v0 if behind_0 else v1, crossing


@inline
def _flip_id(feature: int) -> int:
    """Swap A and B in a contact's id."""
    index_a, index_b = feature & 3, (feature >> 2) & 3
    face_of_a, face_of_b = (feature >> 4) & 1, (feature >> 5) & 1
    return index_b + INDEX_B * index_a + FACE_OF_A * face_of_b + FACE_OF_B * face_of_a


@inline
def collide_polygons(robot: RobotRecord, contact: ContactRecord) -> None:
    """b2CollidePolygons: find where two boxes touch, and write it to the contact's manifold.

    The ground is so wide and thick that its top is always the edge that separates most.
    """
    body_a, body_b = robot.bodies[contact.body_a], robot.bodies[contact.body_b]
    box_a, box_b = robot.fixtures[contact.fixture_a], robot.fixtures[contact.fixture_b]
    contact.point_count = 0
    flip, edge_a, edge_b = False, _TOP, 0
    if contact.body_a == GROUND:
        if _edge_separation(box_a, _TOP, body_b, box_b) > TOTAL_RADIUS:
            return
    else:
        edge_a, separation_a = _find_max_separation(body_a, box_a, body_b, box_b)
        if separation_a > TOTAL_RADIUS:
            return
        edge_b, separation_b = _find_max_separation(body_b, box_b, body_a, box_a)
        if separation_b > TOTAL_RADIUS:
            return
        flip = bool(separation_b > _RELATIVE_TOLERANCE * separation_a + _ABSOLUTE_TOLERANCE)
    contact.flipped = 1 if flip else 0
    if flip:
        body_1, box_1, body_2, box_2, edge_1 = body_b, box_b, body_a, box_a, edge_b
    else:
        body_1, box_1, body_2, box_2, edge_1 = body_a, box_a, body_b, box_b, edge_a
    _clip_to_manifold(contact, body_1, box_1, edge_1, body_2, box_2, flip)


@inline
def _clip_to_manifold(
    contact: ContactRecord,
    body_1: BodyRecord,
    box_1: FixtureRecord,
    edge_1: int,
    body_2: BodyRecord,
    box_2: FixtureRecord,
    flip: bool,
) -> None:
    """Clip the edge of box 2 that faces the reference edge of box 1 to the sides of that edge."""
    first = _find_incident_edge(box_1, edge_1, body_2, box_2)
    second = (first + 1) & 3
    v0 = box_2.vertex_x[first], box_2.vertex_y[first], edge_1 + INDEX_B * first + FACE_OF_A
    v1 = box_2.vertex_x[second], box_2.vertex_y[second], edge_1 + INDEX_B * second + FACE_OF_A

    edge_2 = (edge_1 + 1) & 3
    v11_x, v11_y = box_1.vertex_x[edge_1], box_1.vertex_y[edge_1]
    v12_x, v12_y = box_1.vertex_x[edge_2], box_1.vertex_y[edge_2]
    local_tangent_x, local_tangent_y = box_1.local_tangent_x[edge_1], box_1.local_tangent_y[edge_1]
    tangent_x, tangent_y = rotate(body_1, (local_tangent_x, local_tangent_y))
    normal_x, normal_y = tangent_y, -tangent_x

    front_offset = normal_x * v11_x + normal_y * v11_y
    side_offset_1 = -(tangent_x * v11_x + tangent_y * v11_y) + TOTAL_RADIUS
    side_offset_2 = tangent_x * v12_x + tangent_y * v12_y + TOTAL_RADIUS
    two_ends, v0, v1 = _clip_segment_to_line(v0, v1, -tangent_x, -tangent_y, side_offset_1, edge_1)
    if not two_ends:
        return
    two_ends, v0, v1 = _clip_segment_to_line(v0, v1, tangent_x, tangent_y, side_offset_2, edge_2)
    if not two_ends:
        return

    contact.local_normal_x, contact.local_normal_y = local_tangent_y, -local_tangent_x
    contact.local_point_x = _HALF * (box_1.local_vertex_x[edge_1] + box_1.local_vertex_x[edge_2])
    contact.local_point_y = _HALF * (box_1.local_vertex_y[edge_1] + box_1.local_vertex_y[edge_2])
    count = 0
    for i in range(2):
        x, y, feature = v0 if i == 0 else v1
        if normal_x * x + normal_y * y - front_offset <= TOTAL_RADIUS:
            point = contact.points[count]
            point.local_x, point.local_y = rotate_back(body_2, (x - body_2.p_x, y - body_2.p_y))
            point.id = _flip_id(feature) if flip else feature
            count += 1
    contact.point_count = count


@inline
def update(robot: RobotRecord, contact: ContactRecord) -> None:
    """b2Contact::Update: collide, and give a point the impulses of the old point with its id."""
    point_1, point_2 = contact.points[0], contact.points[1]
    old_count, old_id_1, old_id_2 = contact.point_count, point_1.id, point_2.id
    normal_1, tangent_1 = point_1.normal_impulse, point_1.tangent_impulse
    normal_2, tangent_2 = point_2.normal_impulse, point_2.tangent_impulse
    collide_polygons(robot, contact)
    for i in range(contact.point_count):
        point = contact.points[i]
        point.normal_impulse, point.tangent_impulse = _ZERO, _ZERO
        if old_count > 0 and point.id == old_id_1:
            point.normal_impulse, point.tangent_impulse = normal_1, tangent_1
        elif old_count > 1 and point.id == old_id_2:
            point.normal_impulse, point.tangent_impulse = normal_2, tangent_2
