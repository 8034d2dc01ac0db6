"""Where the numbers of a robot of rigid bodies lie: a block of one lane, whose rows go on behind those of rows.py.

The rows of rows.py hold what is a link's own: its state, its sizes, its controller, in the design's own numbering.
Behind them are records of Box2D's things, one after the other: bodies (the ground is the last), fixtures (a link each,
and the ground's), contacts (one for each pair of fixtures that may touch), joints; and lists of their numbers. Numbers
of things and how many there are lie as int32, all else as float32.
"""

from __future__ import annotations

from tasks.design.genes import N_JOINTS, N_LINKS
from tasks.simulation.trees import layout

GROUND = N_LINKS
"""The ground's number among the bodies and among the fixtures."""
MAX_CONTACTS = N_LINKS + N_LINKS * (N_LINKS - 1) // 2 - N_JOINTS
"""Every link with the ground, and every two links but those that a joint ties."""

# Of the links: tasks/simulation/fused_links.py's place in the body, and what a medium adds to the velocities in a step.
(
    PLACE_X,
    PLACE_Y,
    PLACE_ANGLE,
    PLACE_COS,
    PLACE_SIN,
    LEVER_X,
    LEVER_Y,
    MASS_SHARE,
    INERTIA_SHARE,
    MASS_OVER_INERTIA,
    WORLD_LEVER_X,
    WORLD_LEVER_Y,
    CHANGE_VX,
    CHANGE_VY,
    CHANGE_OMEGA,
) = range(layout.N_ROWS, layout.N_ROWS + 15 * N_LINKS, N_LINKS)

# How many there are, and lists: contacts from the oldest to the newest, all and those that touch; what the search
# for the island met; its stack.
N_BODIES, N_JOINTS_HERE, N_PAIRS, N_CONTACTS, N_ISLAND_CONTACTS, N_ISLAND_JOINTS = range(
    CHANGE_OMEGA + N_LINKS, CHANGE_OMEGA + N_LINKS + 6
)
CONTACT_LIST = N_ISLAND_JOINTS + 1
TOUCHING = CONTACT_LIST + MAX_CONTACTS
ISLAND_CONTACTS = TOUCHING + MAX_CONTACTS
ISLAND_JOINTS = ISLAND_CONTACTS + MAX_CONTACTS
STACK = ISLAND_JOINTS + N_JOINTS
BODIES = STACK + N_LINKS + 1

# A body (b2Body): centre of mass and angle, velocities, transform of its frame; where the frame was at
# the start of the step; mass, centre of mass in the frame; what a medium adds to the velocities.
(
    C_X,
    C_Y,
    A,
    V_X,
    V_Y,
    W,
    P_X,
    P_Y,
    Q_C,
    Q_S,
    START_P_X,
    START_P_Y,
    INVERSE_MASS,
    INVERSE_INERTIA,
    CENTER_X,
    CENTER_Y,
    PUSH_VX,
    PUSH_VY,
    PUSH_OMEGA,
    N_BODY,
) = range(20)
FIXTURES = BODIES + (N_LINKS + 1) * N_BODY

# A fixture (b2Fixture, b2PolygonShape, b2FixtureProxy): its body; its fat AABB; its AABB now; its centroid in the
# body's frame and in the world; its corners and edges, each quantity of all four: in the body's frame and in the world.
(
    FIXTURE_BODY,
    FAT_LOWER_X,
    FAT_LOWER_Y,
    FAT_UPPER_X,
    FAT_UPPER_Y,
    LOWER_X,
    LOWER_Y,
    UPPER_X,
    UPPER_Y,
    CENTROID_X,
    CENTROID_Y,
    WORLD_CENTROID_X,
    WORLD_CENTROID_Y,
    VERTEX_X,
) = range(14)
(
    VERTEX_Y,
    NORMAL_X,
    NORMAL_Y,
    TANGENT_X,
    TANGENT_Y,
    WORLD_VERTEX_X,
    WORLD_VERTEX_Y,
    WORLD_NORMAL_X,
    WORLD_NORMAL_Y,
    N_FIXTURE,
) = range(VERTEX_X + 4, VERTEX_X + 44, 4)
CONTACTS = FIXTURES + (N_LINKS + 1) * N_FIXTURE

# A contact (b2Contact, b2Manifold, b2ContactVelocityConstraint) and each of its two points.
(
    FIXTURE_A,
    FIXTURE_B,
    CONTACT_BODY_A,
    CONTACT_BODY_B,
    EXISTS,
    POINT_COUNT,
    FACE_B,
    LOCAL_NORMAL_X,
    LOCAL_NORMAL_Y,
    LOCAL_POINT_X,
    LOCAL_POINT_Y,
    N_X,
    N_Y,
    CONSTRAINT_POINTS,
    K_11,
    K_12,
    K_22,
    M_11,
    M_12,
    M_22,
    POINTS,
) = range(21)
(
    POINT_X,
    POINT_Y,
    ID,
    NORMAL_IMPULSE,
    TANGENT_IMPULSE,
    RA_X,
    RA_Y,
    RB_X,
    RB_Y,
    NORMAL_MASS,
    TANGENT_MASS,
    BIAS,
    N_POINT,
) = range(13)
N_CONTACT = POINTS + 2 * N_POINT
JOINTS = CONTACTS + MAX_CONTACTS * N_CONTACT

# A joint (b2RevoluteJoint): bodies, the link that hangs from it, anchors from the centres of mass.
(
    BODY_A,
    BODY_B,
    LINK,
    ANCHOR_A_X,
    ANCHOR_A_Y,
    ANCHOR_B_X,
    ANCHOR_B_Y,
    MAX_MOTOR_IMPULSE,
    IMPULSE_X,
    IMPULSE_Y,
    MOTOR_IMPULSE,
    LEVER_A_X,
    LEVER_A_Y,
    LEVER_B_X,
    LEVER_B_Y,
    K_XX,
    K_XY,
    K_YY,
    K_INVERSE_DET,
    MOTOR_MASS,
    N_JOINT,
) = range(21)
N_ROWS = JOINTS + N_JOINTS * N_JOINT
