"""Contacts of links with the ground, on lanes: Box2D 2.3's b2CollidePolygons and b2ContactSolver, step by step.

The ground is one static box, so wide and thick that its top is always the reference face. So the normal is (0, 1), the
tangent (1, 0), a link has at most one contact of at most two points, and what Box2D multiplies by 0 or 1 is left out.
Body A of a contact is the ground, body B the link; points are its vertices. m and i are the link's inverse mass and
inertia, r the vector from its centre to a point, h the height of the ground. A lane without a point has a mass of 0.

Normal constraint of a point (one equation, an inequality):

    C    = p_y - h - both skins ≥ 0
    Cdot = v_y + ω r_x                  J = (0, 1, r_x)        K = J M⁻¹ Jᵀ = m + i r_x²
    λ    = -(Cdot - bias) / K           accumulated λ ≥ 0      bias = -restitution · Cdot at the start of the step

Friction of a point:

    Cdot = v_x - ω r_y                  J = (1, 0, -r_y)       K = m + i r_y²
    λ    = -Cdot / K                    accumulated |λ| ≤ friction · λ of the normal

Block of both points' normals, which solved one after the other would never agree. With a the accumulated impulses of
points 1 and 2, x their new values and b the velocities that x leaves behind:

    K_jk = m + i r_jx r_kx              b = K x + (Cdot - bias - K a)         x ≥ 0,  b ≥ 0,  x · b = 0

    a linear complementarity problem of four cases (which points push); the first whose inequalities hold is taken.

Position correction of a point, by β of the error and as a Newton step with the present angle:

    C    = clamp(β (separation + slop), -most, 0)              λ = -C / K     y += m λ,  angle += i r_x λ
"""

import tasks.simulation.box2d as box2d
from tasks.compiled import inline
from tasks.simd.lanes import Block, Lanes, Mask, Uniform, any_lane, select
from tasks.simd.rotation import sincos
from tasks.simulation.box2d import Scene
from tasks.simulation.trees import layout as at
from tasks.simulation.trees.joint import clamp

Vector = tuple[Lanes, Lanes]

NO_VERTEX = -1.0
_CLEARLY_APART = 0.1  # estimated gap [m] beyond which there is no contact; far more than the estimate's rounding


@inline
def collide(block: Block, link: int, scene: Scene) -> bool:
    """Return whether a link touches the ground in any lane: b2CollidePolygons and b2Contact::Update."""
    x, y, c, s = block[at.X + link], block[at.Y + link], block[at.COS + link], block[at.SIN + link]
    hx, hy = block[at.HALF_WIDTH + link], block[at.HALF_HEIGHT + link]
    first, second, ground = link, link + at.ROOM, scene.ground
    old_vertex_1, old_vertex_2 = block[at.VERTEX + first], block[at.VERTEX + second]
    if not any_lane(y - abs(s) * hx - abs(c) * hy - ground < _CLEARLY_APART):
        if any_lane(old_vertex_1 != NO_VERTEX):
            for point in (first, second):
                block[at.VERTEX + point], block[at.NORMAL + point], block[at.TANGENT + point] = NO_VERTEX, 0.0, 0.0
        return False

    # b2FindIncidentEdge: the first of the normals (0, -1), (1, 0), (0, 1), (-1, 0) that points down most.
    least: Lanes = -c
    right = s < least
    least = select(right, s, least)
    top = c < least
    least = select(top, c, least)
    left = -s < least
    ends_right = (right | top) & ~left  # the edge's first vertex is right of the link's axis; its second is above
    above = top | left
    vertex_1 = select(left, 3.0, select(top, 2.0, select(right, 1.0, 0.0)))
    vertex_2 = select(left, 0.0, vertex_1 + 1.0)
    v1_x, v1_y = select(ends_right, hx, -hx), select(above, hy, -hy)
    v2_x, v2_y = select(above, -hx, hx), select(ends_right, hy, -hy)
    p1_x, p1_y = (c * v1_x - s * v1_y) + x, (s * v1_x + c * v1_y) + y
    p2_x, p2_y = (c * v2_x - s * v2_y) + x, (s * v2_x + c * v2_y) + y

    # b2EdgeSeparation at the support vertex, which is on that edge; of equals the one with the lower index.
    dot_1, dot_2 = v1_x * s + v1_y * c, v2_x * s + v2_y * c
    second_supports = (dot_2 < dot_1) | ((dot_2 == dot_1) & left)
    near = ~(select(second_supports, p2_y, p1_y) - ground > box2d.TOTAL_RADIUS)
    touches_1 = near & (p1_y - ground <= box2d.TOTAL_RADIUS)
    touches_2 = near & (p2_y - ground <= box2d.TOTAL_RADIUS)
    both = touches_1 & touches_2

    # b2MulT(xf, p): back to the link's frame, with its rounding. A second point that touches alone becomes the first.
    p1_x, p1_y = select(touches_1, p1_x, p2_x) - x, select(touches_1, p1_y, p2_y) - y
    p2_x, p2_y = p2_x - x, p2_y - y
    block[at.LOCAL_X + first], block[at.LOCAL_Y + first] = c * p1_x + s * p1_y, -s * p1_x + c * p1_y
    block[at.LOCAL_X + second], block[at.LOCAL_Y + second] = c * p2_x + s * p2_y, -s * p2_x + c * p2_y

    # b2Contact::Update: a vertex that touched before keeps its impulses. Without a point they are zero.
    vertex_1 = select(touches_1, vertex_1, select(touches_2, vertex_2, NO_VERTEX))
    vertex_2 = select(both, vertex_2, NO_VERTEX)
    for impulse in (at.NORMAL, at.TANGENT):
        old_1, old_2 = block[impulse + first], block[impulse + second]
        for point, vertex in ((first, vertex_1), (second, vertex_2)):
            old = select(vertex == old_vertex_1, old_1, select(vertex == old_vertex_2, old_2, 0.0))
            block[impulse + point] = old
    block[at.VERTEX + first], block[at.VERTEX + second] = vertex_1, vertex_2
    return any_lane(vertex_1 != NO_VERTEX)


@inline
def _lever(block: Block, link: int, point: int, ground: Uniform) -> Vector:
    """b2WorldManifold::Initialize: r of a point midway between the surfaces of both skins."""
    x, y, c, s = block[at.X + link], block[at.Y + link], block[at.COS + link], block[at.SIN + link]
    local_x, local_y = block[at.LOCAL_X + point], block[at.LOCAL_Y + point]
    clip_x, clip_y = (c * local_x - s * local_y) + x, (s * local_x + c * local_y) + y
    on_ground = clip_y + (box2d.POLYGON_RADIUS - (clip_y - ground))
    on_link = clip_y - box2d.POLYGON_RADIUS
    return clip_x - x, 0.5 * (on_ground + on_link) - y


@inline
def init_velocity_constraint(block: Block, link: int, scene: Scene) -> bool:
    """b2ContactSolver's InitializeVelocityConstraints and WarmStart.

    Most links that touch stand on one point: the second costs time only where a lane has it.

    Returns:
        Whether any lane has a block of two points.
    """
    first, second = link, link + at.ROOM
    mB, iB = block[at.INVERSE_MASS + link], block[at.INVERSE_INERTIA + link]
    vy, w = block[at.VY + link], block[at.OMEGA + link]
    r1_x, r1_y = _lever(block, link, first, scene.ground)
    _start_point(block, link, first, (r1_x, r1_y), block[at.VERTEX + first] != NO_VERTEX, (vy, w), scene)
    both = block[at.VERTEX + second] != NO_VERTEX
    if not any_lane(both):
        return False

    r2_x, r2_y = _lever(block, link, second, scene.ground)
    k11, k12, k22 = mB + iB * r1_x * r1_x, mB + iB * r1_x * r2_x, mB + iB * r2_x * r2_x
    det = k11 * k22 - k12 * k12
    block[at.K_11 + link], block[at.K_12 + link], block[at.K_22 + link] = k11, k12, k22
    block[at.K_INVERSE_DETERMINANT + link] = select(det != 0.0, 1.0 / det, det)
    in_block = both & (k11 * k11 < box2d.MAX_CONDITION_NUMBER * det)
    _start_point(block, link, second, (r2_x, r2_y), in_block, (vy, w), scene)
    return any_lane(in_block)


@inline
def _start_point(block: Block, link: int, point: int, r: Vector, solved: Mask, before: Vector, scene: Scene) -> None:
    """Initialize and warm-start a point in the lanes ``solved``; ``before`` are vy and ω before any warm start.

    An ill-conditioned block leaves out the second point, whose impulses stay for the next step.
    """
    mB, iB = block[at.INVERSE_MASS + link], block[at.INVERSE_INERTIA + link]
    (r_x, r_y), (vy, w), dt_ratio = r, before, scene.dt_ratio
    block[at.R_X + point], block[at.R_Y + point] = r_x, r_y
    block[at.NORMAL_MASS + point] = select(solved, 1.0 / (mB + iB * r_x * r_x), 0.0)
    block[at.TANGENT_MASS + point] = select(solved, 1.0 / (mB + iB * r_y * r_y), 0.0)
    v_rel = vy + w * r_x
    block[at.BIAS + point] = select(v_rel < -box2d.VELOCITY_THRESHOLD, -(scene.restitution * v_rel), 0.0)

    normal, tangent = block[at.NORMAL + point], block[at.TANGENT + point]
    block[at.NORMAL + point] = select(solved, dt_ratio * normal, normal)
    block[at.TANGENT + point] = select(solved, dt_ratio * tangent, tangent)
    normal, tangent = select(solved, dt_ratio * normal, 0.0), select(solved, dt_ratio * tangent, 0.0)
    block[at.VX + link] = block[at.VX + link] + mB * tangent
    block[at.VY + link] = block[at.VY + link] + mB * normal
    block[at.OMEGA + link] = block[at.OMEGA + link] + iB * (r_x * normal - r_y * tangent)


@inline
def _friction(block: Block, point: int, vx: Lanes, w: Lanes, friction: Uniform) -> tuple[Lanes, Lanes]:
    """Return a point's accumulated tangential impulse before and after it resists sliding."""
    old, most = block[at.TANGENT + point], friction * block[at.NORMAL + point]
    new = clamp(old - block[at.TANGENT_MASS + point] * (vx - w * block[at.R_Y + point]), -most, most)
    return old, new


@inline
def solve_point(block: Block, link: int, scene: Scene) -> None:
    """b2ContactSolver::SolveVelocityConstraints of single points: friction, then the normal.

    The impulses stay in the block until the next step, which makes StoreImpulses superfluous.
    """
    mB, iB = block[at.INVERSE_MASS + link], block[at.INVERSE_INERTIA + link]
    vx, vy, w = block[at.VX + link], block[at.VY + link], block[at.OMEGA + link]
    r_x, r_y = block[at.R_X + link], block[at.R_Y + link]

    old, new = _friction(block, link, vx, w, scene.friction)
    block[at.TANGENT + link] = new
    block[at.VX + link] = vx + mB * (new - old)
    w = w - iB * (r_y * (new - old))

    old = block[at.NORMAL + link]
    new = old - block[at.NORMAL_MASS + link] * (vy + w * r_x - block[at.BIAS + link])
    new = select(new > 0.0, new, 0.0)
    block[at.NORMAL + link] = new
    block[at.VY + link] = vy + mB * (new - old)
    block[at.OMEGA + link] = w + iB * (r_x * (new - old))


@inline
def solve_both_points(block: Block, link: int, scene: Scene) -> None:
    """b2ContactSolver::SolveVelocityConstraints where a lane has two points: friction, then the block of normals."""
    first, second = link, link + at.ROOM
    mB, iB = block[at.INVERSE_MASS + link], block[at.INVERSE_INERTIA + link]
    vx, vy, w = block[at.VX + link], block[at.VY + link], block[at.OMEGA + link]
    r1_x, r2_x = block[at.R_X + first], block[at.R_X + second]
    a1, a2 = block[at.NORMAL + first], block[at.NORMAL + second]
    m1, m2 = block[at.NORMAL_MASS + first], block[at.NORMAL_MASS + second]
    in_block = m2 != 0.0

    old, new = _friction(block, first, vx, w, scene.friction)
    block[at.TANGENT + first] = new
    vx = vx + mB * (new - old)
    w = w - iB * (block[at.R_Y + first] * (new - old))

    old, new = _friction(block, second, vx, w, scene.friction)
    new = select(in_block, new, old)
    block[at.TANGENT + second] = new
    vx = vx + mB * (new - old)
    w = w - iB * (block[at.R_Y + second] * (new - old))

    b1 = vy + w * r1_x - block[at.BIAS + first]
    b2 = vy + w * r2_x - block[at.BIAS + second]
    alone = a1 - m1 * b1
    alone = select(alone > 0.0, alone, 0.0)

    # The cases: both points push (x1, x2), only one (case_2, case_3), none (case_4).
    k11, k12, k22 = block[at.K_11 + link], block[at.K_12 + link], block[at.K_22 + link]
    inverse_det = block[at.K_INVERSE_DETERMINANT + link]
    b1 = b1 - (k11 * a1 + k12 * a2)
    b2 = b2 - (k12 * a1 + k22 * a2)
    x1 = -(inverse_det * k22 * b1 - inverse_det * k12 * b2)
    x2 = -(inverse_det * k11 * b2 - inverse_det * k12 * b1)
    solved = (x1 >= 0.0) & (x2 >= 0.0)
    if any_lane(in_block & ~solved):
        only_1, only_2 = -(m1 * b1), -(m2 * b2)
        case_2 = (only_1 >= 0.0) & (k12 * only_1 + b2 >= 0.0)
        case_3 = (only_2 >= 0.0) & (k12 * only_2 + b1 >= 0.0)
        case_4 = (b1 >= 0.0) & (b2 >= 0.0)
        x1 = select(solved, x1, select(case_2, only_1, select(case_3 | case_4, 0.0, a1)))
        x2 = select(solved, x2, select(case_2, 0.0, select(case_3, only_2, select(case_4, 0.0, a2))))

    x1 = select(in_block, x1, alone)
    x2 = select(in_block, x2, a2)
    block[at.NORMAL + first], block[at.NORMAL + second] = x1, x2
    d1, d2 = x1 - a1, x2 - a2
    block[at.VX + link] = vx
    block[at.VY + link] = vy + mB * (d1 + d2)
    block[at.OMEGA + link] = w + iB * (r1_x * d1 + r2_x * d2)


@inline
def _push_out(block: Block, link: int, point: int, ground: Uniform, pushed: Mask) -> Lanes:
    """Correct one point in the lanes ``pushed``; return its separation before."""
    mB, iB = block[at.INVERSE_MASS + link], block[at.INVERSE_INERTIA + link]
    x, y, c, s = block[at.X + link], block[at.Y + link], block[at.COS + link], block[at.SIN + link]
    local_x, local_y = block[at.LOCAL_X + point], block[at.LOCAL_Y + point]
    clip_x, clip_y = (c * local_x - s * local_y) + x, (s * local_x + c * local_y) + y
    separation: Lanes = clip_y - ground - box2d.POLYGON_RADIUS - box2d.POLYGON_RADIUS
    C = clamp(box2d.BAUMGARTE * (separation + box2d.LINEAR_SLOP), -box2d.MAX_LINEAR_CORRECTION, 0.0)
    pushed = pushed & (C != 0.0)
    if any_lane(pushed):
        r_x = clip_x - x
        impulse = select(pushed, -C / (mB + iB * r_x * r_x), 0.0)
        angle = block[at.ANGLE + link] + iB * (r_x * impulse)
        block[at.Y + link] = y + mB * impulse
        block[at.ANGLE + link] = angle
        block[at.SIN + link], block[at.COS + link] = sincos(angle)
    return separation


@inline
def solve_position_constraint(block: Block, link: int, scene: Scene, unsolved: Mask) -> Mask:
    """Return the lanes in which a link was not too deep before b2ContactSolver::SolvePositionConstraints.

    The lanes ``unsolved`` are corrected; the others stay as they are.
    """
    touches = block[at.VERTEX + link] != NO_VERTEX
    both = block[at.VERTEX + at.ROOM + link] != NO_VERTEX
    separation = _push_out(block, link, link, scene.ground, unsolved & touches)
    shallow: Mask = ~touches | (separation >= box2d.LEAST_SEPARATION)
    if any_lane(both):
        separation = _push_out(block, link, link + at.ROOM, scene.ground, unsolved & both)
        shallow = shallow & (~both | (separation >= box2d.LEAST_SEPARATION))
    return shallow
