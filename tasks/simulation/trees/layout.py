"""Where the numbers of a group of robots lie: the rows of its block, one robot per lane.

Links are numbered in the order in which Box2D's island discovers them, which is the order in which it solves joints:
the root is link 0, and joint j ties link j + 1 to its parent, one of links 0 to j. ``VX + link`` is the row of a link's
vx. What a step touches of 32 robots just fits a core's L1 cache: a quantity more costs time.
"""

from __future__ import annotations

from tasks.design.genes import N_JOINTS, N_LINKS

# State: what one step hands to the next. The first six are a trace's columns.
X, Y, ANGLE, VX, VY, OMEGA, COS, SIN = range(0, 8 * N_LINKS, N_LINKS)
N_TRACED = 6 * N_LINKS
# Contact points of a link with the ground: the link's vertex (-1: none), and the impulses that warm-start it.
VERTEX_1, VERTEX_2, NORMAL_1, NORMAL_2, TANGENT_1, TANGENT_2 = range(SIN + N_LINKS, SIN + 7 * N_LINKS, N_LINKS)
# Impulses that warm-start a joint.
IMPULSE_X, IMPULSE_Y, MOTOR_IMPULSE = range(TANGENT_2 + N_LINKS, TANGENT_2 + N_LINKS + 3 * N_JOINTS, N_JOINTS)
# NaN from where a robot diverged; 0 before.
DIVERGENCE = MOTOR_IMPULSE + N_JOINTS
N_STATE = DIVERGENCE + 1

# Parameters of the links, as Box2D has them: half sizes [m], inverse mass and inertia.
HALF_WIDTH, HALF_HEIGHT, INVERSE_MASS, INVERSE_INERTIA = range(N_STATE, N_STATE + 4 * N_LINKS, N_LINKS)
# And as a medium sees them: long and short axis [m], mass [kg], inertia [kg·m²].
LONG_AXIS, SHORT_AXIS, MASS, INERTIA = range(INVERSE_INERTIA + N_LINKS, INVERSE_INERTIA + 5 * N_LINKS, N_LINKS)
# Parameters of the joints: the parent's number, inverse mass and inertia; anchors along both links' y axes [m].
PARENT, PARENT_INVERSE_MASS, PARENT_INVERSE_INERTIA, PARENT_ANCHOR, CHILD_ANCHOR, MAX_MOTOR_IMPULSE = range(
    INERTIA + N_LINKS, INERTIA + N_LINKS + 6 * N_JOINTS, N_JOINTS
)
# Their controllers: phase [turns], amplitude and rest angle [rad]; one frequency for all [Hz].
PHASE, MOTION_RANGE, REST_ANGLE = range(MAX_MOTOR_IMPULSE + N_JOINTS, MAX_MOTOR_IMPULSE + 4 * N_JOINTS, N_JOINTS)
FREQUENCY = REST_ANGLE + N_JOINTS

# Scratch, rewritten in every step. Joints: b2RevoluteJoint's rA, rB, the matrix K of a point, and the motor.
_JOINT = FREQUENCY + 1
RA_X, RA_Y, RB_X, RB_Y, K_XX, K_XY, K_YY, K_INVERSE_DET, MOTOR_MASS, MOTOR_SPEED = range(
    _JOINT, _JOINT + 10 * N_JOINTS, N_JOINTS
)
# Contacts: b2ContactSolver's two points j = 1, 2: place on the link, r_j, masses and bias; and of the block of both the
# matrix K. The mass of point 2 is 0 where there is no block.
_CONTACT = MOTOR_SPEED + N_JOINTS
(
    LOCAL_X_1,
    LOCAL_Y_1,
    LOCAL_X_2,
    LOCAL_Y_2,
    R_X_1,
    R_Y_1,
    R_X_2,
    R_Y_2,
    TANGENT_MASS_1,
    TANGENT_MASS_2,
    NORMAL_MASS_1,
    NORMAL_MASS_2,
    BIAS_1,
    BIAS_2,
    K_11,
    K_12,
    K_22,
    K_INVERSE_DETERMINANT,
) = range(_CONTACT, _CONTACT + 18 * N_LINKS, N_LINKS)
N_ROWS = K_INVERSE_DETERMINANT + N_LINKS

QUANTITIES = {
    "length_scale": LONG_AXIS,
    "mass": MASS,
    "inertia": INERTIA,
    "y": Y,
    "cos": COS,
    "sin": SIN,
    "vx": VX,
    "vy": VY,
    "omega": OMEGA,
}
"""First row of each quantity of :class:`tasks.world.LinkStates`."""
