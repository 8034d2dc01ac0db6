"""The island of a robot: Box2D 2.3's search for it in b2World::Solve, and b2Island::Solve, operation by operation.

The order is Box2D's: integrate velocities; warm-start contacts, then joints; sweep joints then contacts for velocities;
integrate positions; sweep contacts then joints for positions. Contacts tie bodies to each other, so their own order
matters too: it is that in which the search finds them.

Each constraint depends on the result of the one before it, which leaves a processor's units idle. So the sweeps
interleave a team of a few robots, constraint by constraint.
"""

from collections.abc import Sequence

import numpy as np

from tasks.compiled import inline
from tasks.simulation.box2d import LEAST_SEPARATION, Scene, limited
from tasks.simulation.rigid_bodies import contact_solver, revolute_joint
from tasks.simulation.rigid_bodies.layout import GROUND, RobotRecord
from tasks.simulation.rigid_bodies.transform import place, synchronize_transform


@inline
def _push(robot: RobotRecord, visited: int, n_stack: int, body: int) -> tuple[int, int]:
    """Put a body on the stack unless it was visited; return the visited bodies and the stack's height."""
    if visited & (1 << body):
        return visited, n_stack
    robot.stack[n_stack] = body
    return visited | (1 << body), n_stack + 1


@inline
def search(robot: RobotRecord) -> None:
    """b2World::Solve's depth-first search from the root's body; sets are the bits of whole numbers."""
    n_contacts, n_joints, n_stack = 0, 0, 1
    bodies, joints = 1, 0
    robot.stack[0] = 0
    for i in range(robot.n_contacts):
        robot.contacts[robot.contact_list[i]].in_island = 0
    while n_stack > 0:
        n_stack -= 1
        b = robot.stack[n_stack]
        if b == GROUND:
            continue  # the search does not go through static bodies
        for i in range(robot.n_contacts - 1, -1, -1):
            k = robot.contact_list[i]
            contact = robot.contacts[k]
            ties = contact.point_count > 0 and (contact.body_a == b or contact.body_b == b)
            if ties and contact.in_island == 0:
                contact.in_island = 1
                robot.island_contacts[n_contacts] = k
                n_contacts += 1
                other = contact.body_b if contact.body_a == b else contact.body_a
                bodies, n_stack = _push(robot, bodies, n_stack, other)
        for j in range(robot.n_joints - 1, -1, -1):
            joint = robot.joints[j]
            if (joint.body_a == b or joint.body_b == b) and not joints & (1 << j):
                joints |= 1 << j
                robot.island_joints[n_joints] = j
                n_joints += 1
                other = joint.body_b if joint.body_a == b else joint.body_a
                bodies, n_stack = _push(robot, bodies, n_stack, other)
    robot.n_island_contacts, robot.n_island_joints = n_contacts, n_joints


@inline
def begin(robot: RobotRecord, scene: Scene) -> None:
    """Integrate velocities, initialize the constraints and warm-start them.

    Frames follow from the centres of mass, as Box2D has them after every step; at the spawn they still differ by a
    rounding.
    """
    for b in range(robot.n_bodies):
        body = robot.bodies[b]
        synchronize_transform(body)
        body.start_p_x, body.start_p_y = body.p_x, body.p_y
        body.v_y = body.v_y + scene.fall
    for i in range(robot.n_island_contacts):
        contact = robot.contacts[robot.island_contacts[i]]
        contact_solver.initialize_velocity_constraint(robot, contact, scene.restitution)
    for i in range(robot.n_island_contacts):
        contact = robot.contacts[robot.island_contacts[i]]
        contact_solver.warm_start(robot, contact, scene.dt_ratio)
    for i in range(robot.n_island_joints):
        joint = robot.joints[robot.island_joints[i]]
        revolute_joint.init_velocity_constraints(robot, joint, scene)


@inline
def _longest_lists(team: Sequence[RobotRecord]) -> tuple[int, int]:
    """Count the island contacts and joints of the robots that have most of them."""
    n_contacts, n_joints = 0, 0
    for r in range(len(team)):
        n_contacts = max(n_contacts, team[r].n_island_contacts)
        n_joints = max(n_joints, team[r].n_island_joints)
    return n_contacts, n_joints


@inline
def sweep_velocities(team: Sequence[RobotRecord], scene: Scene) -> None:
    """Run the velocity solver."""
    n_contacts, n_joints = _longest_lists(team)
    for _ in range(scene.velocity_iterations):
        for i in range(n_joints):
            for r in range(len(team)):
                robot = team[r]
                if i < robot.n_island_joints:
                    joint = robot.joints[robot.island_joints[i]]
                    revolute_joint.solve_velocity_constraints(robot, joint)
        for i in range(n_contacts):
            for r in range(len(team)):
                robot = team[r]
                if i < robot.n_island_contacts:
                    contact = robot.contacts[robot.island_contacts[i]]
                    contact_solver.solve_velocity_constraint(robot, contact, scene.friction)


@inline
def integrate_positions(robot: RobotRecord, dt: np.float32) -> None:
    """Limit the velocities, then move the bodies."""
    for b in range(robot.n_bodies):
        body = robot.bodies[b]
        v_x, v_y, w = limited(body.v_x, body.v_y, body.w, dt)
        body.v_x, body.v_y, body.w = v_x, v_y, w
        place(body, (body.c_x + dt * v_x, body.c_y + dt * v_y), body.a + dt * w)


@inline
def sweep_positions(team: Sequence[RobotRecord], scene: Scene) -> None:
    """Run the position solver; a robot is finished once all its errors were small in one sweep."""
    n_contacts, n_joints = _longest_lists(team)
    unsolved = (1 << len(team)) - 1  # a set of robots: the bits of a whole number
    for _ in range(scene.position_iterations):
        failed = 0
        for i in range(n_contacts):
            for r in range(len(team)):
                robot = team[r]
                if unsolved & (1 << r) and i < robot.n_island_contacts:
                    contact = robot.contacts[robot.island_contacts[i]]
                    least = contact_solver.solve_position_constraint(robot, contact)
                    if not least >= LEAST_SEPARATION:  # NaN counts as failed
                        failed |= 1 << r
        for i in range(n_joints):
            for r in range(len(team)):
                robot = team[r]
                if unsolved & (1 << r) and i < robot.n_island_joints:
                    joint = robot.joints[robot.island_joints[i]]
                    if not revolute_joint.solve_position_constraints(robot, joint):
                        failed |= 1 << r
        unsolved = failed
        if unsolved == 0:
            break
