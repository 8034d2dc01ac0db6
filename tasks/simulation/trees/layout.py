"""Memory layout of a group of robots: rows of a block, one robot per lane. Kernels import this module as ``at``.

Links are numbered in the order in which Box2D's island search finds them, which is the order in which it solves joints:
the root is link 0, and joint j connects link j + 1 to its parent, one of links 0 to j. ``block[at.VX + link]`` holds
vx of a link in all lanes. The rows that a step uses of 32 robots just fit a core's L1 cache: one quantity more costs
time.
"""

from tasks.design.genes import N_JOINTS, N_LINKS

# State, passed from one step to the next. The first six are the columns of a trace.
X, Y, ANGLE, VX, VY, OMEGA, COS, SIN = range(0, 8 * N_LINKS, N_LINKS)
N_TRACED = 6 * N_LINKS
# Two contact points of a link with the ground: vertex of the link (-1: none), and impulses that warm-start the point.
# The rows of the links' second points follow those of their first: NORMAL + link, NORMAL + N_LINKS + link.
VERTEX, NORMAL, TANGENT = range(SIN + N_LINKS, SIN + 7 * N_LINKS, 2 * N_LINKS)
# Impulses that warm-start a joint.
IMPULSE_X, IMPULSE_Y, MOTOR_IMPULSE = range(TANGENT + 2 * N_LINKS, TANGENT + 2 * N_LINKS + 3 * N_JOINTS, N_JOINTS)
# 0, or NaN once a robot has diverged.
DIVERGENCE = MOTOR_IMPULSE + N_JOINTS
N_STATE = DIVERGENCE + 1

# Links as Box2D stores them: half sizes [m], inverse mass [1/kg] and inertia [1/(kg·m²)].
HALF_WIDTH, HALF_HEIGHT, INVERSE_MASS, INVERSE_INERTIA = range(N_STATE, N_STATE + 4 * N_LINKS, N_LINKS)
# Links as a medium sees them: long axis [m], mass [kg], inertia [kg·m²].
LONG_AXIS, MASS, INERTIA = range(INVERSE_INERTIA + N_LINKS, INVERSE_INERTIA + 4 * N_LINKS, N_LINKS)
# Joints: the parent's number, inverse mass and inertia; anchors along both y axes [m]; the motor's limit [N·m·s].
PARENT, PARENT_INVERSE_MASS, PARENT_INVERSE_INERTIA, PARENT_ANCHOR, CHILD_ANCHOR, MAX_MOTOR_IMPULSE = range(
    INERTIA + N_LINKS, INERTIA + N_LINKS + 6 * N_JOINTS, N_JOINTS
)
N_PACKED = MAX_MOTOR_IMPULSE + N_JOINTS  # what a robot brings along; the rest is scratch

# Scratch, rewritten in every step. Joints: r_A, r_B and K of b2RevoluteJoint, 1/det K, and the motor.
_JOINT = N_PACKED
RA_X, RA_Y, RB_X, RB_Y, K_XX, K_XY, K_YY, K_INVERSE_DET, MOTOR_MASS, MOTOR_SPEED = range(
    _JOINT, _JOINT + 10 * N_JOINTS, N_JOINTS
)
# Contact points: position on the link, r, effective masses and bias of b2ContactSolver.
_POINT = MOTOR_SPEED + N_JOINTS
LOCAL_X, LOCAL_Y, R_X, R_Y, NORMAL_MASS, TANGENT_MASS, BIAS = range(_POINT, _POINT + 14 * N_LINKS, 2 * N_LINKS)
# K of the block of both points, and 1/det K. The second point's effective masses are 0 where there is no block.
_BLOCK = BIAS + 2 * N_LINKS
K_11, K_12, K_22, K_INVERSE_DETERMINANT = range(_BLOCK, _BLOCK + 4 * N_LINKS, N_LINKS)
# Work of a joint's motor since it began to be counted [J]; a step does not touch it otherwise.
MOTOR_WORK = K_INVERSE_DETERMINANT + N_LINKS
# Velocities now, had only the fluid and gravity acted since it was asked; of fluids that read kicks.
UNKICKED_VX, UNKICKED_VY, UNKICKED_OMEGA = range(MOTOR_WORK + N_JOINTS, MOTOR_WORK + N_JOINTS + 3 * N_LINKS, N_LINKS)
N_ROWS = UNKICKED_OMEGA + N_LINKS

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
    "x": X,
}
"""First row of each quantity of :class:`tasks.world.LinkStates` but the kicks and the parents."""
