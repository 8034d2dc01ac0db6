"""Revolute joints with motors, on lanes: Box2D 2.3's b2RevoluteJoint, operation by operation.

Each lane is a robot with a tree of its own, so a joint's parent is another row in each lane. Its state is gathered from
the rows of the links that may be the parent, and scattered back to them.

Body A is the parent, body B the child; m and i are inverse mass and inertia, r the vector from a centre to the joint.

Point-to-point constraint (two equations). With ω × r = (-ω r_y, ω r_x) and s(r) = (-r_y, r_x):

    C    = x_B + r_B - x_A - r_A
    Cdot = v_B + ω_B × r_B - v_A - ω_A × r_A
    J    = (-1, -s(r_A), 1, s(r_B))                                  so that Cdot = J (v_A, ω_A, v_B, ω_B)
    K    = J M⁻¹ Jᵀ = (m_A + m_B) 1 + i_A s(r_A) s(r_A)ᵀ + i_B s(r_B) s(r_B)ᵀ

         = ( m_A + m_B + i_A r_Ay² + i_B r_By²      -i_A r_Ax r_Ay - i_B r_Bx r_By      )
           ( -i_A r_Ax r_Ay - i_B r_Bx r_By         m_A + m_B + i_A r_Ax² + i_B r_Bx²   )

    Velocity: P = -K⁻¹ Cdot       v_A -= m_A P,  ω_A -= i_A (r_A × P),  v_B += m_B P,  ω_B += i_B (r_B × P)
    Position: P = -K⁻¹ C          the same of positions and angles: a Newton step, with r and K of the present angles

Motor constraint (one equation), with the commanded speed s:

    Cdot = ω_B - ω_A - s      J = (0, -1, 0, 1)      K = i_A + i_B      λ = -Cdot / K

    The accumulated impulse is clamped to the most that the motor's torque gives in a step. A motor that is off gives 0.
"""

from tasks.compiled import inline
from tasks.simd.lanes import Block, Lanes, Mask, Numeric, from_row, select
from tasks.simd.rotation import sincos
from tasks.simulation.box2d import LINEAR_SLOP_SQUARED, Scene
from tasks.simulation.trees import layout as at


@inline
def clamp(a: Numeric, low: Numeric, high: Numeric) -> Numeric:
    """Return values within their bounds, as b2Clamp does."""
    least = select(a < high, a, high)
    return select(low > least, low, least)


@inline
def of_parent(links: Block, parent: Lanes, joint: int) -> Lanes:
    """Return a quantity of each lane's parent, one of links 0 to ``joint``, from the quantity's row of link 0 on."""
    gathered = links[0]
    for link in range(1, joint + 1):
        gathered = select(parent == link, links[link], gathered)
    return gathered


@inline
def to_parent(links: Block, parent: Lanes, joint: int, value: Lanes) -> None:
    """Scatter a quantity to each lane's parent, the reverse of :func:`of_parent`."""
    for link in range(joint + 1):
        links[link] = select(parent == link, value, links[link])


@inline
def init_velocity_constraint(block: Block, joint: int, scene: Scene) -> None:
    """b2RevoluteJoint::InitVelocityConstraints: r, K, and a warm start by the impulses of the last step."""
    child, dt_ratio = joint + 1, scene.dt_ratio
    parent = block[at.PARENT + joint]
    mA, iA = block[at.PARENT_INVERSE_MASS + joint], block[at.PARENT_INVERSE_INERTIA + joint]
    mB, iB = block[at.INVERSE_MASS + child], block[at.INVERSE_INERTIA + child]

    rA_x = -(of_parent(from_row(block, at.SIN), parent, joint) * block[at.PARENT_ANCHOR + joint])
    rA_y = of_parent(from_row(block, at.COS), parent, joint) * block[at.PARENT_ANCHOR + joint]
    rB_x = -(block[at.SIN + child] * block[at.CHILD_ANCHOR + joint])
    rB_y = block[at.COS + child] * block[at.CHILD_ANCHOR + joint]
    block[at.RA_X + joint], block[at.RA_Y + joint] = rA_x, rA_y
    block[at.RB_X + joint], block[at.RB_Y + joint] = rB_x, rB_y

    k_xx = mA + mB + rA_y * rA_y * iA + rB_y * rB_y * iB
    k_xy = -rA_y * rA_x * iA - rB_y * rB_x * iB
    k_yy = mA + mB + rA_x * rA_x * iA + rB_x * rB_x * iB
    det = k_xx * k_yy - k_xy * k_xy
    block[at.K_XX + joint], block[at.K_XY + joint], block[at.K_YY + joint] = k_xx, k_xy, k_yy
    block[at.K_INVERSE_DET + joint] = select(det != 0.0, 1.0 / det, det)
    block[at.MOTOR_MASS + joint] = 1.0 / (iA + iB)

    P_x, P_y = block[at.IMPULSE_X + joint] * dt_ratio, block[at.IMPULSE_Y + joint] * dt_ratio
    motor_impulse = block[at.MOTOR_IMPULSE + joint] * dt_ratio
    block[at.IMPULSE_X + joint], block[at.IMPULSE_Y + joint], block[at.MOTOR_IMPULSE + joint] = P_x, P_y, motor_impulse

    turn_A, turn_B = (rA_x * P_y - rA_y * P_x) + motor_impulse, (rB_x * P_y - rB_y * P_x) + motor_impulse

    to_parent(from_row(block, at.VX), parent, joint, of_parent(from_row(block, at.VX), parent, joint) - mA * P_x)
    to_parent(from_row(block, at.VY), parent, joint, of_parent(from_row(block, at.VY), parent, joint) - mA * P_y)
    wA = of_parent(from_row(block, at.OMEGA), parent, joint)
    to_parent(from_row(block, at.OMEGA), parent, joint, wA - iA * turn_A)
    block[at.VX + child] = block[at.VX + child] + mB * P_x
    block[at.VY + child] = block[at.VY + child] + mB * P_y
    block[at.OMEGA + child] = block[at.OMEGA + child] + iB * turn_B


@inline
def solve_velocity_constraint(block: Block, joint: int) -> None:
    """b2RevoluteJoint::SolveVelocityConstraints: the motor, then the point."""
    child = joint + 1
    parent = block[at.PARENT + joint]
    mA, iA = block[at.PARENT_INVERSE_MASS + joint], block[at.PARENT_INVERSE_INERTIA + joint]
    mB, iB = block[at.INVERSE_MASS + child], block[at.INVERSE_INERTIA + child]
    rA_x, rA_y = block[at.RA_X + joint], block[at.RA_Y + joint]
    rB_x, rB_y = block[at.RB_X + joint], block[at.RB_Y + joint]
    vA_x = of_parent(from_row(block, at.VX), parent, joint)
    vA_y = of_parent(from_row(block, at.VY), parent, joint)
    wA = of_parent(from_row(block, at.OMEGA), parent, joint)
    vB_x, vB_y, wB = block[at.VX + child], block[at.VY + child], block[at.OMEGA + child]

    Cdot = wB - wA - block[at.MOTOR_SPEED + joint]
    old_impulse = block[at.MOTOR_IMPULSE + joint]
    max_impulse = block[at.MAX_MOTOR_IMPULSE + joint]
    new_impulse = clamp(old_impulse - block[at.MOTOR_MASS + joint] * Cdot, -max_impulse, max_impulse)
    block[at.MOTOR_IMPULSE + joint] = new_impulse
    impulse = new_impulse - old_impulse
    wA = wA - iA * impulse
    wB = wB + iB * impulse

    Cdot_x = vB_x - wB * rB_y - vA_x + wA * rA_y
    Cdot_y = vB_y + wB * rB_x - vA_y - wA * rA_x
    k_xy, inverse_det = block[at.K_XY + joint], block[at.K_INVERSE_DET + joint]
    impulse_x = inverse_det * (k_xy * Cdot_y - block[at.K_YY + joint] * Cdot_x)
    impulse_y = inverse_det * (k_xy * Cdot_x - block[at.K_XX + joint] * Cdot_y)
    turn_A, turn_B = rA_x * impulse_y - rA_y * impulse_x, rB_x * impulse_y - rB_y * impulse_x
    block[at.IMPULSE_X + joint] = block[at.IMPULSE_X + joint] + impulse_x
    block[at.IMPULSE_Y + joint] = block[at.IMPULSE_Y + joint] + impulse_y

    to_parent(from_row(block, at.VX), parent, joint, vA_x - mA * impulse_x)
    to_parent(from_row(block, at.VY), parent, joint, vA_y - mA * impulse_y)
    to_parent(from_row(block, at.OMEGA), parent, joint, wA - iA * turn_A)
    block[at.VX + child] = vB_x + mB * impulse_x
    block[at.VY + child] = vB_y + mB * impulse_y
    block[at.OMEGA + child] = wB + iB * turn_B


@inline
def add_motor_work(block: Block, joint: int) -> None:
    """Add |J ω| of a step to the motor's work; see :class:`tasks.simulation.box2d.Motion`."""
    speed = block[at.OMEGA + joint + 1] - of_parent(from_row(block, at.OMEGA), block[at.PARENT + joint], joint)
    block[at.MOTOR_WORK + joint] = block[at.MOTOR_WORK + joint] + abs(block[at.MOTOR_IMPULSE + joint] * speed)


@inline
def solve_position_constraint(block: Block, joint: int, unsolved: Mask) -> Mask:
    """Return the lanes in which a joint was within the tolerance before b2RevoluteJoint::SolvePositionConstraints.

    The lanes ``unsolved`` are corrected; the others stay as they are.
    """
    child = joint + 1
    parent = block[at.PARENT + joint]
    mA, iA = block[at.PARENT_INVERSE_MASS + joint], block[at.PARENT_INVERSE_INERTIA + joint]
    mB, iB = block[at.INVERSE_MASS + child], block[at.INVERSE_INERTIA + child]
    cA_x, cA_y = of_parent(from_row(block, at.X), parent, joint), of_parent(from_row(block, at.Y), parent, joint)
    cB_x, cB_y = block[at.X + child], block[at.Y + child]

    rA_x = -(of_parent(from_row(block, at.SIN), parent, joint) * block[at.PARENT_ANCHOR + joint])
    rA_y = of_parent(from_row(block, at.COS), parent, joint) * block[at.PARENT_ANCHOR + joint]
    rB_x = -(block[at.SIN + child] * block[at.CHILD_ANCHOR + joint])
    rB_y = block[at.COS + child] * block[at.CHILD_ANCHOR + joint]

    C_x = cB_x + rB_x - cA_x - rA_x
    C_y = cB_y + rB_y - cA_y - rA_y
    good_enough: Mask = C_x * C_x + C_y * C_y <= LINEAR_SLOP_SQUARED

    # Box2D associates these products otherwise than in the velocity constraint, which rounds otherwise.
    k_xx = mA + mB + iA * rA_y * rA_y + iB * rB_y * rB_y
    k_xy = -iA * rA_x * rA_y - iB * rB_x * rB_y
    k_yy = mA + mB + iA * rA_x * rA_x + iB * rB_x * rB_x
    det = k_xx * k_yy - k_xy * k_xy
    inverse_det = select(det != 0.0, 1.0 / det, det)
    impulse_x = select(unsolved, inverse_det * (k_xy * C_y - k_yy * C_x), 0.0)
    impulse_y = select(unsolved, inverse_det * (k_xy * C_x - k_xx * C_y), 0.0)

    aA = of_parent(from_row(block, at.ANGLE), parent, joint) - iA * (rA_x * impulse_y - rA_y * impulse_x)
    sin_A, cos_A = sincos(aA)
    to_parent(from_row(block, at.X), parent, joint, cA_x - mA * impulse_x)
    to_parent(from_row(block, at.Y), parent, joint, cA_y - mA * impulse_y)
    to_parent(from_row(block, at.ANGLE), parent, joint, aA)
    to_parent(from_row(block, at.SIN), parent, joint, sin_A)
    to_parent(from_row(block, at.COS), parent, joint, cos_A)
    aB = block[at.ANGLE + child] + iB * (rB_x * impulse_y - rB_y * impulse_x)
    sin_B, cos_B = sincos(aB)
    block[at.X + child], block[at.Y + child] = cB_x + mB * impulse_x, cB_y + mB * impulse_y
    block[at.ANGLE + child], block[at.SIN + child], block[at.COS + child] = aB, sin_B, cos_B
    return good_enough
