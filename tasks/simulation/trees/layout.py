"""Memory layout of a group of robots: rows of a block, one robot per lane. Kernels import this module as ``at``.

Links are numbered in the order in which Box2D's island search finds them, which is the order in which it solves joints:
the root is link 0, and joint j connects link j + 1 to its parent, one of links 0 to j. ``block[at.VX + link]`` holds
vx of a link in all lanes. There is room for the largest robot, so that a kernel serves all: rows of links that a robot
lacks are never touched. The rows that a step uses of 32 robots of six links just fit a core's L1 cache: one quantity
more costs time.
"""

from tasks.design.genes import MOST_LINKS

ROOM = MOST_LINKS + 1  # rows from a quantity to the next; an odd number, so that those in use fill a cache evenly

# State, passed from one step to the next. The first six are the columns of a trace.
X, Y, ANGLE, VX, VY, OMEGA, COS, SIN = range(0, 8 * ROOM, ROOM)
N_TRACED = 6
# Two contact points of a link with the ground: vertex of the link (-1: none), and impulses that warm-start the point.
# The rows of the links' second points follow those of their first: NORMAL + link, NORMAL + ROOM + link.
VERTEX, NORMAL, TANGENT = range(8 * ROOM, 14 * ROOM, 2 * ROOM)
# Impulses that warm-start a joint. One row: 0, or NaN once a robot has diverged.
IMPULSE_X, IMPULSE_Y, MOTOR_IMPULSE, DIVERGENCE = range(14 * ROOM, 18 * ROOM, ROOM)

# Links as Box2D stores them: half sizes [m], inverse mass [1/kg] and inertia [1/(kg·m²)].
HALF_WIDTH, HALF_HEIGHT, INVERSE_MASS, INVERSE_INERTIA = range(18 * ROOM, 22 * ROOM, ROOM)
# Links as a medium sees them: long axis [m], mass [kg], inertia [kg·m²].
LONG_AXIS, MASS, INERTIA = range(22 * ROOM, 25 * ROOM, ROOM)
# Joints: the parent's number, inverse mass and inertia; anchors along both y axes [m]; the motor's limit [N·m·s].
PARENT, PARENT_INVERSE_MASS, PARENT_INVERSE_INERTIA, PARENT_ANCHOR, CHILD_ANCHOR, MAX_MOTOR_IMPULSE = range(
    25 * ROOM, 31 * ROOM, ROOM
)
N_PACKED = 31 * ROOM  # what a robot brings along; the rest is scratch

# Scratch, rewritten in every step. Joints: r_A, r_B and K of b2RevoluteJoint, 1/det K, and the motor.
RA_X, RA_Y, RB_X, RB_Y, K_XX, K_XY, K_YY, K_INVERSE_DET, MOTOR_MASS, MOTOR_SPEED = range(31 * ROOM, 41 * ROOM, ROOM)
# Contact points: position on the link, r, effective masses and bias of b2ContactSolver.
LOCAL_X, LOCAL_Y, R_X, R_Y, NORMAL_MASS, TANGENT_MASS, BIAS = range(41 * ROOM, 55 * ROOM, 2 * ROOM)
# K of the block of both points, and 1/det K. The second point's effective masses are 0 where there is no block.
K_11, K_12, K_22, K_INVERSE_DETERMINANT = range(55 * ROOM, 59 * ROOM, ROOM)
# Work of a joint's motor since it began to be counted [J]; a step does not touch it otherwise.
MOTOR_WORK = 59 * ROOM
# Velocities now, had only the fluid and gravity acted since it was asked; of fluids that read kicks.
UNKICKED_VX, UNKICKED_VY, UNKICKED_OMEGA = range(60 * ROOM, 63 * ROOM, ROOM)
N_ROWS = 63 * ROOM

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
