"""Islands of bodies: Box2D 2.3's search for them in b2World::Solve, and b2Island::Solve, operation by operation.

The order is Box2D's: integrate velocities; warm-start contacts, then joints; sweep joints then contacts for velocities;
integrate positions; sweep contacts then joints for positions. Contacts tie bodies to each other, so their own order
counts too, which is that in which the search meets them.

A constraint waits for the one before it, and the processor with it. So the sweeps go over a team of a few robots at
once, constraint by constraint, whose blocks lie one after the other: while one waits, others do not.
"""

from __future__ import annotations

from typing import Any

from tasks.compiled import inline
from tasks.simulation.rigid_bodies import contact_solver, revolute_joint
from tasks.simulation.rigid_bodies.layout import (
    BODY_A,
    BODY_B,
    C_X,
    C_Y,
    CONTACT_BODY_A,
    CONTACT_BODY_B,
    CONTACT_LIST,
    GROUND,
    ISLAND_CONTACTS,
    ISLAND_JOINTS,
    LINK,
    N_BODIES,
    N_CONTACTS,
    N_ISLAND_CONTACTS,
    N_ISLAND_JOINTS,
    N_JOINTS_HERE,
    N_ROWS,
    P_X,
    P_Y,
    POINT_COUNT,
    STACK,
    START_P_X,
    START_P_Y,
    TOUCHING,
    V_X,
    V_Y,
    A,
    W,
)
from tasks.simulation.rigid_bodies.records import bodies_of, body_at, contact_at, joint_at, place, synchronize_transform
from tasks.simulation.simd.lanes import any_lane, from_row, load_whole, sqrt, store_whole
from tasks.simulation.trees import layout
from tasks.simulation.trees.contact import LEAST_SEPARATION
from tasks.simulation.trees.step import MAX_ROTATION, MAX_ROTATION_SQUARED, MAX_TRANSLATION


@inline
def reach(block: Any, bodies: Any, n_stack: Any, body: Any) -> Any:
    """Put a body on the stack, unless it is among those that were met; give what was met, and the stack's height."""
    if bodies & (1 << body):
        return bodies, n_stack
    store_whole(block, STACK + n_stack, body)
    return bodies | (1 << body), n_stack + 1


@inline
def search(block: Any) -> None:
    """b2World::Solve's search, with a stack, from the root's body: contacts and joints in the order it meets them.

    Sets of bodies, contacts and joints are the bits of numbers.
    """
    n_contacts, n_joints = 0, load_whole(block, N_JOINTS_HERE)
    for i in range(load_whole(block, N_CONTACTS)):
        k = load_whole(block, CONTACT_LIST + i)
        if load_whole(contact_at(block, k), POINT_COUNT) > 0:
            store_whole(block, TOUCHING + n_contacts, k)
            n_contacts += 1
    n_found_contacts, n_found_joints, n_stack = 0, 0, 1
    bodies, contacts, joints = 1, 0, 0
    store_whole(block, STACK, 0)
    while n_stack > 0:
        n_stack -= 1
        b = load_whole(block, STACK + n_stack)
        if b == GROUND:
            continue  # a static body does not tie what it touches
        for i in range(n_contacts - 1, -1, -1):
            k = load_whole(block, TOUCHING + i)
            contact = contact_at(block, k)
            body_a, body_b = load_whole(contact, CONTACT_BODY_A), load_whole(contact, CONTACT_BODY_B)
            if (body_a == b or body_b == b) and not contacts & (1 << i):
                contacts |= 1 << i
                store_whole(block, ISLAND_CONTACTS + n_found_contacts, k)
                n_found_contacts += 1
                bodies, n_stack = reach(block, bodies, n_stack, body_b if body_a == b else body_a)
        for j in range(n_joints - 1, -1, -1):
            joint = joint_at(block, j)
            body_a, body_b = load_whole(joint, BODY_A), load_whole(joint, BODY_B)
            if (body_a == b or body_b == b) and not joints & (1 << j):
                joints |= 1 << j
                store_whole(block, ISLAND_JOINTS + n_found_joints, j)
                n_found_joints += 1
                bodies, n_stack = reach(block, bodies, n_stack, body_b if body_a == b else body_a)
    store_whole(block, N_ISLAND_CONTACTS, n_found_contacts)
    store_whole(block, N_ISLAND_JOINTS, n_found_joints)


@inline
def dissolve(block: Any) -> None:
    """Leave nothing to solve of a robot that has diverged."""
    store_whole(block, N_ISLAND_CONTACTS, 0)
    store_whole(block, N_ISLAND_JOINTS, 0)


@inline
def island_contact(block: Any, i: int) -> Any:
    """Find a contact of the island and its two bodies."""
    contact = contact_at(block, load_whole(block, ISLAND_CONTACTS + i))
    body_a, body_b = bodies_of(block, contact)
    return contact, body_a, body_b


@inline
def island_joint(block: Any, i: int) -> Any:
    """Find a joint of the island and its two bodies."""
    joint = joint_at(block, load_whole(block, ISLAND_JOINTS + i))
    return joint, body_at(block, load_whole(joint, BODY_A)), body_at(block, load_whole(joint, BODY_B))


@inline
def most(team: Any, n_robots: int, row: int) -> Any:
    """Find the largest of a number that each robot has."""
    largest = load_whole(team, row)
    for robot in range(1, n_robots):
        largest = max(largest, load_whole(team, robot * N_ROWS + row))
    return largest


@inline
def begin(block: Any, world: Any) -> None:
    """Integrate velocities, prepare the constraints, start them warm. At the spawn frames are not rounded yet."""
    for b in range(load_whole(block, N_BODIES)):
        body = body_at(block, b)
        synchronize_transform(body)
        body[START_P_X], body[START_P_Y] = body[P_X], body[P_Y]
        body[V_Y] = body[V_Y] + world.fall
    n_contacts = load_whole(block, N_ISLAND_CONTACTS)
    for i in range(n_contacts):
        contact, body_a, body_b = island_contact(block, i)
        contact_solver.initialize_velocity_constraint(contact, body_a, body_b, world.restitution)
    for i in range(n_contacts):
        contact, body_a, body_b = island_contact(block, i)
        contact_solver.warm_start(contact, body_a, body_b, world.dt_ratio)
    for i in range(load_whole(block, N_ISLAND_JOINTS)):
        joint, body_a, body_b = island_joint(block, i)
        revolute_joint.init_velocity_constraints(joint, body_a, body_b, world.dt_ratio)


@inline
def sweep_velocities(team: Any, n_robots: int, world: Any) -> None:
    """Sweeps of the velocity solver."""
    n_contacts, n_joints = most(team, n_robots, N_ISLAND_CONTACTS), most(team, n_robots, N_ISLAND_JOINTS)
    for _ in range(world.velocity_iterations):
        for i in range(n_joints):
            for robot in range(n_robots):
                block = from_row(team, robot * N_ROWS)
                if i < load_whole(block, N_ISLAND_JOINTS):
                    joint, body_a, body_b = island_joint(block, i)
                    motor_speed = block[layout.MOTOR_SPEED - 1 + load_whole(joint, LINK)]
                    revolute_joint.solve_velocity_constraints(joint, body_a, body_b, motor_speed)
        for i in range(n_contacts):
            for robot in range(n_robots):
                block = from_row(team, robot * N_ROWS)
                if i < load_whole(block, N_ISLAND_CONTACTS):
                    contact, body_a, body_b = island_contact(block, i)
                    if load_whole(contact, CONTACT_BODY_A) == GROUND:
                        contact_solver.solve_velocity_constraint_on_ground(contact, body_b, world.friction)
                    else:
                        contact_solver.solve_velocity_constraint(contact, body_a, body_b, world.friction)


@inline
def integrate_positions(block: Any, dt: Any) -> None:
    """Limit the velocities, then move."""
    for b in range(load_whole(block, N_BODIES)):
        body = body_at(block, b)
        vx, vy, w = body[V_X], body[V_Y], body[W]
        translation_x, translation_y, rotation = dt * vx, dt * vy, dt * w
        squared = translation_x * translation_x + translation_y * translation_y
        if any_lane(squared > MAX_TRANSLATION * MAX_TRANSLATION):
            ratio = MAX_TRANSLATION / sqrt(squared)
            vx, vy = vx * ratio, vy * ratio
        if any_lane(rotation * rotation > MAX_ROTATION_SQUARED):
            w = w * (MAX_ROTATION / abs(rotation))
        body[V_X], body[V_Y], body[W] = vx, vy, w
        place(body, body[C_X] + dt * vx, body[C_Y] + dt * vy, body[A] + dt * w)


@inline
def sweep_positions(team: Any, n_robots: int, world: Any) -> None:
    """Sweeps of the position solver; a robot is left alone once all its errors were small in one sweep."""
    n_contacts, n_joints = most(team, n_robots, N_ISLAND_CONTACTS), most(team, n_robots, N_ISLAND_JOINTS)
    unsolved = (1 << n_robots) - 1  # a set of robots: the bits of a number
    for _ in range(world.position_iterations):
        failed = 0
        for i in range(n_contacts):
            for robot in range(n_robots):
                block = from_row(team, robot * N_ROWS)
                if unsolved & (1 << robot) and i < load_whole(block, N_ISLAND_CONTACTS):
                    contact, body_a, body_b = island_contact(block, i)
                    least = contact_solver.solve_position_constraint(contact, body_a, body_b)
                    if not any_lane(least >= LEAST_SEPARATION):
                        failed |= 1 << robot
        for i in range(n_joints):
            for robot in range(n_robots):
                block = from_row(team, robot * N_ROWS)
                if unsolved & (1 << robot) and i < load_whole(block, N_ISLAND_JOINTS):
                    joint, body_a, body_b = island_joint(block, i)
                    if not revolute_joint.solve_position_constraints(joint, body_a, body_b):
                        failed |= 1 << robot
        unsolved = failed
        if unsolved == 0:
            break
