"""What two boxes touch at: Box2D 2.3's Collision/b2CollidePolygon.cpp and b2Contact::Update, operation by operation.

Boxes have four vertices and four normals, edge i going from vertex i to vertex i + 1. Blocks have one lane, and a
condition is whether it holds in any lane.
"""

from __future__ import annotations

from typing import Any

from tasks.compiled import inline
from tasks.simulation.rigid_bodies.layout import (
    FACE_B,
    ID,
    LOCAL_NORMAL_X,
    LOCAL_NORMAL_Y,
    LOCAL_POINT_X,
    LOCAL_POINT_Y,
    NORMAL_IMPULSE,
    NORMAL_X,
    NORMAL_Y,
    P_X,
    P_Y,
    POINT_COUNT,
    POINT_X,
    POINT_Y,
    TANGENT_IMPULSE,
    TANGENT_X,
    TANGENT_Y,
    VERTEX_X,
    VERTEX_Y,
    WORLD_CENTROID_X,
    WORLD_CENTROID_Y,
    WORLD_NORMAL_X,
    WORLD_NORMAL_Y,
    WORLD_VERTEX_X,
    WORLD_VERTEX_Y,
)
from tasks.simulation.rigid_bodies.records import point_at, rotate, rotate_back
from tasks.simulation.simd.lanes import any_lane, load_whole, select, store_whole
from tasks.simulation.trees.contact import TOTAL_RADIUS

RELATIVE_TOLERANCE = 0.98
ABSOLUTE_TOLERANCE = 0.001

GROUND_TOP = 2
"""The upper edge of a box."""

# A contact point's b2ContactID as a number: the indices of the features of A and B, and whether they are faces.
INDEX_B, FACE_OF_A, FACE_OF_B = 4, 16, 32


@inline
def edge_separation(box_1: Any, edge: Any, body_2: Any, box_2: Any) -> Any:
    """b2EdgeSeparation: how far box 2 lies outside of an edge of box 1."""
    normal_x, normal_y = box_1[WORLD_NORMAL_X + edge], box_1[WORLD_NORMAL_Y + edge]
    local_x, local_y = rotate_back(body_2, normal_x, normal_y)
    support_x, support_y = box_2[WORLD_VERTEX_X], box_2[WORLD_VERTEX_Y]
    least = box_2[VERTEX_X] * local_x + box_2[VERTEX_Y] * local_y
    for i in range(1, 4):
        dot = box_2[VERTEX_X + i] * local_x + box_2[VERTEX_Y + i] * local_y
        lower = dot < least
        least = select(lower, dot, least)
        support_x = select(lower, box_2[WORLD_VERTEX_X + i], support_x)
        support_y = select(lower, box_2[WORLD_VERTEX_Y + i], support_y)
    v1_x, v1_y = box_1[WORLD_VERTEX_X + edge], box_1[WORLD_VERTEX_Y + edge]
    return (support_x - v1_x) * normal_x + (support_y - v1_y) * normal_y


@inline
def find_max_separation(body_1: Any, box_1: Any, body_2: Any, box_2: Any) -> Any:
    """b2FindMaxSeparation: the edge of box 1 that separates most, by a climb from the one that faces box 2.

    The climb only goes up. So once it is past what two boxes that touch may have between them, it need not go on.
    """
    d_x = box_2[WORLD_CENTROID_X] - box_1[WORLD_CENTROID_X]
    d_y = box_2[WORLD_CENTROID_Y] - box_1[WORLD_CENTROID_Y]
    local_x, local_y = rotate_back(body_1, d_x, d_y)
    most = box_1[NORMAL_X] * local_x + box_1[NORMAL_Y] * local_y
    edge = 0
    for i in range(1, 4):
        dot = box_1[NORMAL_X + i] * local_x + box_1[NORMAL_Y + i] * local_y
        if any_lane(dot > most):
            most, edge = dot, i

    s = edge_separation(box_1, edge, body_2, box_2)
    if any_lane(s > TOTAL_RADIUS):
        return edge, s
    previous, following = (edge + 3) % 4, (edge + 1) % 4
    s_previous = edge_separation(box_1, previous, body_2, box_2)
    s_next = edge_separation(box_1, following, body_2, box_2)
    if any_lane((s_previous > s) & (s_previous > s_next)):
        increment, best, best_separation = 3, previous, s_previous
    elif any_lane(s_next > s):
        increment, best, best_separation = 1, following, s_next
    else:
        return edge, s
    while not any_lane(best_separation > TOTAL_RADIUS):
        edge = (best + increment) % 4
        s = edge_separation(box_1, edge, body_2, box_2)
        if not any_lane(s > best_separation):
            break
        best, best_separation = edge, s
    return best, best_separation


@inline
def find_incident_edge(box_1: Any, edge: Any, body_2: Any, box_2: Any) -> Any:
    """b2FindIncidentEdge: the edge of box 2 that faces an edge of box 1."""
    local_x, local_y = rotate_back(body_2, box_1[WORLD_NORMAL_X + edge], box_1[WORLD_NORMAL_Y + edge])
    least = local_x * box_2[NORMAL_X] + local_y * box_2[NORMAL_Y]
    incident = 0
    for i in range(1, 4):
        dot = local_x * box_2[NORMAL_X + i] + local_y * box_2[NORMAL_Y + i]
        if any_lane(dot < least):
            least, incident = dot, i
    return incident


@inline
def clip_segment_to_line(
    x0: Any, y0: Any, id0: Any, x1: Any, y1: Any, id1: Any, normal_x: Any, normal_y: Any, offset: Any, vertex: Any
) -> Any:
    """b2ClipSegmentToLine (b2Collision.cpp): whether a part of a segment is behind a line, and that part's ends."""
    distance_0 = normal_x * x0 + normal_y * y0 - offset
    distance_1 = normal_x * x1 + normal_y * y1 - offset
    behind_0, behind_1 = any_lane(distance_0 <= 0.0), any_lane(distance_1 <= 0.0)
    if behind_0 and behind_1:
        return True, x0, y0, id0, x1, y1, id1
    if not any_lane(distance_0 * distance_1 < 0.0):
        return False, x0, y0, id0, x1, y1, id1
    share = distance_0 / (distance_0 - distance_1)
    x, y = x0 + share * (x1 - x0), y0 + share * (y1 - y0)
    crossing = vertex + (id0 & (3 * INDEX_B)) + FACE_OF_B  # the line's vertex, on the same edge
    if behind_0:
        return True, x0, y0, id0, x, y, crossing
    return True, x1, y1, id1, x, y, crossing


@inline
def _flipped(feature: Any) -> Any:
    """Swap A and B in a contact's id."""
    index_a, index_b = feature & 3, (feature >> 2) & 3
    face_of_a, face_of_b = (feature >> 4) & 1, (feature >> 5) & 1
    return index_b + INDEX_B * index_a + FACE_OF_A * face_of_b + FACE_OF_B * face_of_a


@inline
def collide_polygons(contact: Any, body_a: Any, box_a: Any, body_b: Any, box_b: Any, on_ground: bool) -> None:
    """b2CollidePolygons: find where the boxes touch, and write it to the contact's manifold.

    The ground is so wide and thick that its top is always the edge that separates most.
    """
    store_whole(contact, POINT_COUNT, 0)
    flip, edge_a, edge_b = False, GROUND_TOP, 0
    if on_ground:
        if any_lane(edge_separation(box_a, GROUND_TOP, body_b, box_b) > TOTAL_RADIUS):
            return
    else:
        edge_a, separation_a = find_max_separation(body_a, box_a, body_b, box_b)
        if any_lane(separation_a > TOTAL_RADIUS):
            return
        edge_b, separation_b = find_max_separation(body_b, box_b, body_a, box_a)
        if any_lane(separation_b > TOTAL_RADIUS):
            return
        flip = any_lane(separation_b > RELATIVE_TOLERANCE * separation_a + ABSOLUTE_TOLERANCE)
    store_whole(contact, FACE_B, 1 if flip else 0)
    if flip:
        body_1, box_1, body_2, box_2, edge_1 = body_b, box_b, body_a, box_a, edge_b
    else:
        body_1, box_1, body_2, box_2, edge_1 = body_a, box_a, body_b, box_b, edge_a
    _clip_to_manifold(contact, body_1, box_1, edge_1, body_2, box_2, flip)


@inline
def _clip_to_manifold(contact: Any, body_1: Any, box_1: Any, edge_1: Any, body_2: Any, box_2: Any, flip: bool) -> None:
    """b2CollidePolygons goes on: clip the edge of box 2 that faces the reference edge of box 1 to that edge's sides."""
    first = find_incident_edge(box_1, edge_1, body_2, box_2)
    second = (first + 1) % 4
    x0, y0 = box_2[WORLD_VERTEX_X + first], box_2[WORLD_VERTEX_Y + first]
    x1, y1 = box_2[WORLD_VERTEX_X + second], box_2[WORLD_VERTEX_Y + second]
    id0, id1 = edge_1 + INDEX_B * first + FACE_OF_A, edge_1 + INDEX_B * second + FACE_OF_A

    edge_2 = (edge_1 + 1) % 4
    v11_x, v11_y = box_1[WORLD_VERTEX_X + edge_1], box_1[WORLD_VERTEX_Y + edge_1]
    v12_x, v12_y = box_1[WORLD_VERTEX_X + edge_2], box_1[WORLD_VERTEX_Y + edge_2]
    local_tangent_x, local_tangent_y = box_1[TANGENT_X + edge_1], box_1[TANGENT_Y + edge_1]
    tangent_x, tangent_y = rotate(body_1, local_tangent_x, local_tangent_y)
    normal_x, normal_y = tangent_y, -tangent_x

    front_offset = normal_x * v11_x + normal_y * v11_y
    side_offset_1 = -(tangent_x * v11_x + tangent_y * v11_y) + TOTAL_RADIUS
    side_offset_2 = tangent_x * v12_x + tangent_y * v12_y + TOTAL_RADIUS
    whole_segment, x0, y0, id0, x1, y1, id1 = clip_segment_to_line(
        x0, y0, id0, x1, y1, id1, -tangent_x, -tangent_y, side_offset_1, edge_1
    )
    if not whole_segment:
        return
    whole_segment, x0, y0, id0, x1, y1, id1 = clip_segment_to_line(
        x0, y0, id0, x1, y1, id1, tangent_x, tangent_y, side_offset_2, edge_2
    )
    if not whole_segment:
        return

    contact[LOCAL_NORMAL_X], contact[LOCAL_NORMAL_Y] = local_tangent_y, -local_tangent_x
    contact[LOCAL_POINT_X] = 0.5 * (box_1[VERTEX_X + edge_1] + box_1[VERTEX_X + edge_2])
    contact[LOCAL_POINT_Y] = 0.5 * (box_1[VERTEX_Y + edge_1] + box_1[VERTEX_Y + edge_2])
    count = 0
    for i in range(2):
        x, y = (x0, y0) if i == 0 else (x1, y1)
        feature = id0 if i == 0 else id1
        if any_lane(normal_x * x + normal_y * y - front_offset <= TOTAL_RADIUS):
            point = point_at(contact, count)
            point[POINT_X], point[POINT_Y] = rotate_back(body_2, x - body_2[P_X], y - body_2[P_Y])
            store_whole(point, ID, _flipped(feature) if flip else feature)
            count += 1
    store_whole(contact, POINT_COUNT, count)


@inline
def update(contact: Any, body_a: Any, box_a: Any, body_b: Any, box_b: Any, on_ground: bool) -> None:
    """b2Contact::Update: collide; a point that has an old one's id takes over its impulses."""
    point_1, point_2 = point_at(contact, 0), point_at(contact, 1)
    old_count = load_whole(contact, POINT_COUNT)
    old_id_1, old_id_2 = load_whole(point_1, ID), load_whole(point_2, ID)
    normal_1, tangent_1 = point_1[NORMAL_IMPULSE], point_1[TANGENT_IMPULSE]
    normal_2, tangent_2 = point_2[NORMAL_IMPULSE], point_2[TANGENT_IMPULSE]
    collide_polygons(contact, body_a, box_a, body_b, box_b, on_ground)
    for i in range(load_whole(contact, POINT_COUNT)):
        point = point_at(contact, i)
        new_id = load_whole(point, ID)
        point[NORMAL_IMPULSE], point[TANGENT_IMPULSE] = 0.0, 0.0
        if old_count > 0 and new_id == old_id_1:
            point[NORMAL_IMPULSE], point[TANGENT_IMPULSE] = normal_1, tangent_1
        elif old_count > 1 and new_id == old_id_2:
            point[NORMAL_IMPULSE], point[TANGENT_IMPULSE] = normal_2, tangent_2
