"""A step of robots of rigid bodies: the motors, the slush, and Box2D 2.3's b2World::Step.

The order of a step is Box2D's: collide; search the island; integrate velocities; warm-start contacts, then joints; sweep
joints then contacts for velocities; integrate positions; sweep contacts then joints for positions; look for new
contacts. Contacts tie bodies to each other, so their order counts, and with it what the island search meets first.
Links are to their bodies as tasks/simulation/rigid.py says. Everything equals the reference engine to the last bit.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tasks.simulation import kernels, rows
from tasks.simulation.bodies import broad_phase, contact_solver, revolute_joint
from tasks.simulation.bodies.records import (
    body_at,
    contact_at,
    fixture_at,
    joint_at,
    place,
    rotate,
    synchronize_transform,
    transform,
    whole,
)
from tasks.simulation.bodies.rows import (
    BODY_A,
    BODY_B,
    C_X,
    C_Y,
    CENTER_X,
    CENTER_Y,
    CHANGE_OMEGA,
    CHANGE_VX,
    CHANGE_VY,
    CONTACT_LIST,
    FIXTURE_A,
    FIXTURE_B,
    FIXTURE_BODY,
    GROUND,
    IN_ISLAND,
    IN_ISLAND_CONTACT,
    IN_ISLAND_JOINT,
    INERTIA_SHARE,
    ISLAND_CONTACTS,
    ISLAND_JOINTS,
    LEVER_X,
    LEVER_Y,
    LINK,
    MASS_OVER_INERTIA,
    MASS_SHARE,
    N_BODIES,
    N_CONTACTS,
    N_ISLAND_CONTACTS,
    N_ISLAND_JOINTS,
    N_JOINTS_HERE,
    N_ROWS,
    P_X,
    P_Y,
    PLACE_ANGLE,
    PLACE_COS,
    PLACE_SIN,
    PLACE_X,
    PLACE_Y,
    POINT_COUNT,
    PUSH_OMEGA,
    PUSH_VX,
    PUSH_VY,
    Q_C,
    Q_S,
    STACK,
    START_P_X,
    START_P_Y,
    START_Q_C,
    START_Q_S,
    V_X,
    V_Y,
    WORLD_LEVER_X,
    WORLD_LEVER_Y,
    A,
    W,
)
from tasks.simulation.contact import DEEPEST
from tasks.simulation.kernels import MAX_ROTATION, MAX_ROTATION_SQUARED, MAX_TRANSLATION
from tasks.simulation.lanes import any_lane, from_row, inline, select, sqrt
from tasks.simulation.rotation import sincos


@inline
def bodies_of_contact(block: Any, contact: Any) -> Any:
    """Find the two bodies of a contact, by their numbers."""
    box_a, box_b = fixture_at(block, whole(contact[FIXTURE_A])), fixture_at(block, whole(contact[FIXTURE_B]))
    return whole(box_a[FIXTURE_BODY]), whole(box_b[FIXTURE_BODY])


@inline
def place_link(block: Any, link: int) -> None:
    """Place a link by its body; see place_links in tasks/simulation/rigid.py."""
    body = body_at(block, whole(fixture_at(block, link)[FIXTURE_BODY]))
    c, s, omega = body[Q_C], body[Q_S], body[W]
    x, y = rotate(body, block[PLACE_X + link], block[PLACE_Y + link])
    lever_x, lever_y = rotate(body, block[LEVER_X + link], block[LEVER_Y + link])
    own_c, own_s = block[PLACE_COS + link], block[PLACE_SIN + link]
    block[rows.X + link], block[rows.Y + link] = body[P_X] + x, body[P_Y] + y
    block[rows.ANGLE + link] = body[A] + block[PLACE_ANGLE + link]
    block[rows.VX + link], block[rows.VY + link] = body[V_X] - omega * lever_y, body[V_Y] + omega * lever_x
    block[rows.OMEGA + link] = omega
    block[rows.COS + link], block[rows.SIN + link] = c * own_c - s * own_s, s * own_c + c * own_s
    block[WORLD_LEVER_X + link], block[WORLD_LEVER_Y + link] = lever_x, lever_y


@inline
def push(block: Any, world: Any) -> None:
    """Give the links' changes to their bodies, and forget them; see body_change in tasks/simulation/rigid.py."""
    n_bodies = whole(block[N_BODIES])
    for b in range(n_bodies):
        body = body_at(block, b)
        body[PUSH_VX], body[PUSH_VY], body[PUSH_OMEGA] = 0.0, 0.0, 0.0
    for link in range(world.n_links):
        body = body_at(block, whole(fixture_at(block, link)[FIXTURE_BODY]))
        dvx, dvy, domega = block[CHANGE_VX + link], block[CHANGE_VY + link], block[CHANGE_OMEGA + link]
        block[CHANGE_VX + link], block[CHANGE_VY + link], block[CHANGE_OMEGA + link] = 0.0, 0.0, 0.0
        moment = block[WORLD_LEVER_X + link] * dvy - block[WORLD_LEVER_Y + link] * dvx
        body[PUSH_VX] = body[PUSH_VX] + block[MASS_SHARE + link] * dvx
        body[PUSH_VY] = body[PUSH_VY] + block[MASS_SHARE + link] * dvy
        turn = block[MASS_OVER_INERTIA + link] * moment + block[INERTIA_SHARE + link] * domega
        body[PUSH_OMEGA] = body[PUSH_OMEGA] + turn
    for b in range(n_bodies):
        body = body_at(block, b)
        body[V_X], body[V_Y] = body[V_X] + body[PUSH_VX], body[V_Y] + body[PUSH_VY]
        body[W] = body[W] + body[PUSH_OMEGA]


@inline
def submerge(block: Any, link: int, world: Any) -> None:
    """Change of a link's velocities by the slush."""
    rise_short, rise_long, depth = kernels.immersion(block, link)
    if any_lane(depth > 0.0):
        dvx, dvy, domega = kernels.slush_change(block, link, world, rise_short, rise_long, depth)
        block[CHANGE_VX + link], block[CHANGE_VY + link], block[CHANGE_OMEGA + link] = dvx, dvy, domega


@inline
def search_island(block: Any) -> None:
    """b2World::Solve's search, with a stack, from the root's body: contacts and joints in the order it meets them."""
    for b in range(whole(block[N_BODIES])):
        body_at(block, b)[IN_ISLAND] = 0.0
    body_at(block, GROUND)[IN_ISLAND] = 0.0
    n_contacts, n_joints = whole(block[N_CONTACTS]), whole(block[N_JOINTS_HERE])
    for i in range(n_contacts):
        contact_at(block, whole(block[CONTACT_LIST + i]))[IN_ISLAND_CONTACT] = 0.0
    for j in range(n_joints):
        joint_at(block, j)[IN_ISLAND_JOINT] = 0.0
    n_found_contacts, n_found_joints, n_stack = 0, 0, 1
    block[STACK] = 0.0
    body_at(block, 0)[IN_ISLAND] = 1.0
    while n_stack > 0:
        n_stack -= 1
        b = whole(block[STACK + n_stack])
        if b == GROUND:
            continue  # a static body does not tie what it touches
        for i in range(n_contacts - 1, -1, -1):
            k = whole(block[CONTACT_LIST + i])
            contact = contact_at(block, k)
            body_a, body_b = bodies_of_contact(block, contact)
            if (body_a == b or body_b == b) and any_lane(
                (contact[IN_ISLAND_CONTACT] == 0.0) & (contact[POINT_COUNT] != 0.0)
            ):
                contact[IN_ISLAND_CONTACT] = 1.0
                block[ISLAND_CONTACTS + n_found_contacts] = k
                n_found_contacts += 1
                other = body_b if body_a == b else body_a
                if any_lane(body_at(block, other)[IN_ISLAND] == 0.0):
                    body_at(block, other)[IN_ISLAND] = 1.0
                    block[STACK + n_stack] = other
                    n_stack += 1
        for j in range(n_joints - 1, -1, -1):
            joint = joint_at(block, j)
            body_a, body_b = whole(joint[BODY_A]), whole(joint[BODY_B])
            if (body_a == b or body_b == b) and any_lane(joint[IN_ISLAND_JOINT] == 0.0):
                joint[IN_ISLAND_JOINT] = 1.0
                block[ISLAND_JOINTS + n_found_joints] = j
                n_found_joints += 1
                other = body_b if body_a == b else body_a
                if any_lane(body_at(block, other)[IN_ISLAND] == 0.0):
                    body_at(block, other)[IN_ISLAND] = 1.0
                    block[STACK + n_stack] = other
                    n_stack += 1
    block[N_ISLAND_CONTACTS], block[N_ISLAND_JOINTS] = n_found_contacts, n_found_joints


@inline
def island_contact(block: Any, i: int) -> Any:
    """Find a contact of the island and its two bodies."""
    contact = contact_at(block, whole(block[ISLAND_CONTACTS + i]))
    a, b = bodies_of_contact(block, contact)
    return contact, body_at(block, a), body_at(block, b)


@inline
def island_joint(block: Any, i: int) -> Any:
    """Find a joint of the island and its two bodies."""
    joint = joint_at(block, whole(block[ISLAND_JOINTS + i]))
    return joint, body_at(block, whole(joint[BODY_A])), body_at(block, whole(joint[BODY_B]))


@inline
def begin(body: Any, fall: Any) -> None:
    """b2Island::Solve: remember where a body was, integrate its velocity. At the spawn its frame is not rounded yet."""
    synchronize_transform(body)
    body[START_P_X], body[START_P_Y], body[START_Q_C], body[START_Q_S] = body[P_X], body[P_Y], body[Q_C], body[Q_S]
    body[V_Y] = body[V_Y] + fall


@inline
def integrate_position(body: Any, dt: Any) -> None:
    """b2Island::Solve: limit the velocities, then move."""
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
def solve_velocities(block: Any, world: Any) -> None:
    """b2Island::Solve: prepare the constraints, start them warm, sweep."""
    n_contacts, n_joints = whole(block[N_ISLAND_CONTACTS]), whole(block[N_ISLAND_JOINTS])
    for i in range(n_contacts):
        contact, body_a, body_b = island_contact(block, i)
        contact_solver.initialize_velocity_constraint(contact, body_a, body_b, world.restitution)
    for i in range(n_contacts):
        contact, body_a, body_b = island_contact(block, i)
        contact_solver.warm_start(contact, body_a, body_b, world.dt_ratio)
    for i in range(n_joints):
        joint, body_a, body_b = island_joint(block, i)
        revolute_joint.init_velocity_constraints(joint, body_a, body_b, world.dt_ratio)
    for _ in range(world.velocity_iterations):
        for i in range(n_joints):
            joint, body_a, body_b = island_joint(block, i)
            motor_speed = block[rows.MOTOR_SPEED - 1 + whole(joint[LINK])]
            revolute_joint.solve_velocity_constraints(joint, body_a, body_b, motor_speed)
        for i in range(n_contacts):
            contact, body_a, body_b = island_contact(block, i)
            contact_solver.solve_velocity_constraint(contact, body_a, body_b, world.friction)


@inline
def solve_positions(block: Any, world: Any) -> None:
    """b2Island::Solve: sweep until all errors were small in one sweep."""
    n_contacts, n_joints = whole(block[N_ISLAND_CONTACTS]), whole(block[N_ISLAND_JOINTS])
    for _ in range(world.position_iterations):
        solved = True
        for i in range(n_contacts):
            contact, body_a, body_b = island_contact(block, i)
            least = contact_solver.solve_position_constraint(contact, body_a, body_b)
            solved = solved and any_lane(least >= DEEPEST)
        for i in range(n_joints):
            joint, body_a, body_b = island_joint(block, i)
            solved = revolute_joint.solve_position_constraints(joint, body_a, body_b) and solved
        if solved:
            break


@inline
def synchronize_fixtures(block: Any, world: Any) -> None:
    """b2World::Solve: move the fixtures' AABBs after them; where one has left its own, look for new contacts."""
    moved = False
    for link in range(world.n_links):
        box = fixture_at(block, link)
        moved = broad_phase.synchronize(body_at(block, whole(box[FIXTURE_BODY])), box) or moved
    if moved:
        broad_phase.find_new_contacts(block)


@inline
def take_step(block: Any, world: Any, step: int) -> None:
    """Run the motors, the slush, and b2World::Step."""
    time = np.float32(step) * world.dt
    n_bodies = whole(block[N_BODIES])
    for j in range(whole(block[N_JOINTS_HERE])):
        kernels.command_motor(block, whole(joint_at(block, j)[LINK]) - 1, time, world.motor_gain)
    if world.slush:
        for link in range(world.n_links):
            submerge(block, link, world)
    push(block, world)
    broad_phase.collide(block)
    search_island(block)
    for b in range(n_bodies):
        begin(body_at(block, b), world.fall)
    solve_velocities(block, world)
    for b in range(n_bodies):
        integrate_position(body_at(block, b), world.dt)
    solve_positions(block, world)
    synchronize_fixtures(block, world)
    for link in range(world.n_links):
        place_link(block, link)
    divergence = block[rows.DIVERGENCE]
    for row in range(rows.N_TRACED):
        divergence = divergence + 0.0 * block[row]
    block[rows.DIVERGENCE] = divergence


@inline
def spawn(block: Any, world: Any) -> None:
    """Orient the bodies, place the links on them, and look for the first contacts."""
    for b in range(whole(block[N_BODIES])):
        body = body_at(block, b)
        body[Q_S], body[Q_C] = sincos(body[A])
        body[C_X], body[C_Y] = transform(body, body[CENTER_X], body[CENTER_Y])
    for link in range(world.n_links):
        box = fixture_at(block, link)
        broad_phase.create_proxy(body_at(block, whole(box[FIXTURE_BODY])), box)
        place_link(block, link)
    broad_phase.create_proxy(body_at(block, GROUND), fixture_at(block, GROUND))
    broad_phase.find_new_contacts(block)


def advance_bodies(
    blocks: Any, n_robots: int, world: Any, first_step: int, n_steps: int, trace: Any, traced: bool
) -> None:
    """Take steps with robots, one after the other; one that has diverged is left alone.

    Args:
        blocks: n_robots blocks of one lane and N_ROWS rows, one after the other.
        n_robots: how many there are.
        world: as in tasks/simulation/kernels.py.
        first_step: number of the first step since the spawn; 0 spawns the robots first.
        n_steps: how many to take, 0 or more.
        trace: a block of n_robots · n_steps · N_TRACED rows to fill with the states after each step.
        traced: whether to.
    """
    for robot in range(n_robots):
        block = from_row(blocks, robot * N_ROWS)
        if first_step == 0:
            spawn(block, world)
        for step in range(n_steps):
            if any_lane(block[rows.DIVERGENCE] == 0.0):
                take_step(block, world, first_step + step)
            if traced:
                kept = from_row(trace, (robot * n_steps + step) * rows.N_TRACED)
                for row in range(rows.N_TRACED):
                    kept[row] = block[row] + block[rows.DIVERGENCE]
