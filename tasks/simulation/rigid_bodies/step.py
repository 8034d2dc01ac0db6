"""A step of robots of rigid bodies: the motors, the slush, and Box2D 2.3's b2World::Step.

The relation of links to bodies is that of tasks/simulation/fused_links.py. Every bit equals the reference engine's.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tasks.compiled import inline
from tasks.simulation.rigid_bodies import broad_phase, island
from tasks.simulation.rigid_bodies.layout import (
    C_X,
    C_Y,
    CENTER_X,
    CENTER_Y,
    CHANGE_OMEGA,
    CHANGE_VX,
    CHANGE_VY,
    FIXTURE_BODY,
    INERTIA_SHARE,
    LEVER_X,
    LEVER_Y,
    LINK,
    MASS_OVER_INERTIA,
    MASS_SHARE,
    N_BODIES,
    N_JOINTS_HERE,
    N_ROWS,
    P_X,
    P_Y,
    PLACE_ANGLE,
    PLACE_COS,
    PLACE_SIN,
    PLACE_X,
    PLACE_Y,
    PUSH_OMEGA,
    PUSH_VX,
    PUSH_VY,
    Q_C,
    Q_S,
    V_X,
    V_Y,
    WORLD_LEVER_X,
    WORLD_LEVER_Y,
    A,
    W,
)
from tasks.simulation.rigid_bodies.records import body_at, fixture_at, joint_at, rotate, transform
from tasks.simulation.simd.lanes import any_lane, from_row, load_whole
from tasks.simulation.simd.rotation import sincos
from tasks.simulation.trees import layout
from tasks.simulation.trees import step as tree_step

TEAM = 4
"""Robots that are stepped at once: their blocks fit the L1 cache."""


@inline
def place_link(block: Any, link: int) -> None:
    """Place a link by its body; see place_links in tasks/simulation/fused_links.py."""
    body = body_at(block, load_whole(fixture_at(block, link), FIXTURE_BODY))
    c, s, omega = body[Q_C], body[Q_S], body[W]
    x, y = rotate(body, block[PLACE_X + link], block[PLACE_Y + link])
    lever_x, lever_y = rotate(body, block[LEVER_X + link], block[LEVER_Y + link])
    own_c, own_s = block[PLACE_COS + link], block[PLACE_SIN + link]
    block[layout.X + link], block[layout.Y + link] = body[P_X] + x, body[P_Y] + y
    block[layout.ANGLE + link] = body[A] + block[PLACE_ANGLE + link]
    block[layout.VX + link], block[layout.VY + link] = body[V_X] - omega * lever_y, body[V_Y] + omega * lever_x
    block[layout.OMEGA + link] = omega
    block[layout.COS + link], block[layout.SIN + link] = c * own_c - s * own_s, s * own_c + c * own_s
    block[WORLD_LEVER_X + link], block[WORLD_LEVER_Y + link] = lever_x, lever_y


@inline
def push(block: Any, world: Any) -> None:
    """Give the links' changes to their bodies, and forget them; see body_change in tasks/simulation/fused_links.py."""
    n_bodies = load_whole(block, N_BODIES)
    for b in range(n_bodies):
        body = body_at(block, b)
        body[PUSH_VX], body[PUSH_VY], body[PUSH_OMEGA] = 0.0, 0.0, 0.0
    for link in range(world.n_links):
        body = body_at(block, load_whole(fixture_at(block, link), FIXTURE_BODY))
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
    length, width = 2.0 * block[layout.HALF_HEIGHT + link], block[layout.SHORT_AXIS + link]
    y, cos, sin = block[layout.Y + link], block[layout.COS + link], block[layout.SIN + link]
    rise_short, rise_long, depth = tree_step.immersion(length, width, y, cos, sin)
    if any_lane(depth > 0.0):
        velocity = block[layout.VX + link], block[layout.VY + link], block[layout.OMEGA + link]
        mass, inertia = block[layout.MASS + link], block[layout.INERTIA + link]
        change = tree_step.slush_change(length, width, mass, inertia, velocity, rise_short, rise_long, depth, world)
        block[CHANGE_VX + link], block[CHANGE_VY + link], block[CHANGE_OMEGA + link] = change


@inline
def orient_fixtures(block: Any, world: Any) -> None:
    """Find the corners, normals and AABBs of all fixtures."""
    for i in range(world.n_links + 1):
        box = fixture_at(block, i)
        broad_phase.orient(body_at(block, load_whole(box, FIXTURE_BODY)), box)


@inline
def synchronize_fixtures(block: Any, world: Any) -> None:
    """b2World::Solve: move the fixtures' AABBs after them; where one has left its own, look for new contacts."""
    moved = False
    for link in range(world.n_links):
        box = fixture_at(block, link)
        moved = broad_phase.synchronize(body_at(block, load_whole(box, FIXTURE_BODY)), box) or moved
    if moved:
        broad_phase.find_new_contacts(block)


@inline
def begin_step(block: Any, world: Any, step: int) -> None:
    """Run the motors and the slush, collide, and prepare the island."""
    time = np.float32(step) * world.dt
    for j in range(load_whole(block, N_JOINTS_HERE)):
        tree_step.command_motor(block, load_whole(joint_at(block, j), LINK) - 1, time, world.motor_gain)
    if world.slush:
        for link in range(world.n_links):
            submerge(block, link, world)
    push(block, world)
    broad_phase.collide(block)
    island.search(block)
    island.begin(block, world)
    if step == 0:
        orient_fixtures(block, world)


@inline
def end_step(block: Any, world: Any) -> None:
    """Look for new contacts, place the links, and notice a divergence."""
    synchronize_fixtures(block, world)
    for link in range(world.n_links):
        place_link(block, link)
    divergence = block[layout.DIVERGENCE]
    for row in range(layout.N_TRACED):
        divergence = divergence + 0.0 * block[row]
    block[layout.DIVERGENCE] = divergence


@inline
def take_step(team: Any, n_robots: int, world: Any, step: int) -> None:
    """Run the motors, the slush, and b2World::Step of a team; a robot that has diverged is left alone."""
    for robot in range(n_robots):
        block = from_row(team, robot * N_ROWS)
        if any_lane(block[layout.DIVERGENCE] == 0.0):
            begin_step(block, world, step)
        else:
            island.dissolve(block)
    island.sweep_velocities(team, n_robots, world)
    for robot in range(n_robots):
        island.integrate_positions(from_row(team, robot * N_ROWS), world.dt)
    island.sweep_positions(team, n_robots, world)
    for robot in range(n_robots):
        end_step(from_row(team, robot * N_ROWS), world)


@inline
def spawn(block: Any, world: Any) -> None:
    """Orient the bodies, place the links on them, and look for the first contacts."""
    for b in range(load_whole(block, N_BODIES)):
        body = body_at(block, b)
        body[Q_S], body[Q_C] = sincos(body[A])
        body[C_X], body[C_Y] = transform(body, body[CENTER_X], body[CENTER_Y])
    for link in range(world.n_links):
        place_link(block, link)
    orient_fixtures(block, world)
    for i in range(world.n_links + 1):
        broad_phase.create_proxy(fixture_at(block, i))
    broad_phase.find_new_contacts(block)


def advance_bodies(
    blocks: Any, n_robots: int, world: Any, first_step: int, n_steps: int, trace: Any, traced: bool
) -> None:
    """Take steps with robots, team after team.

    Args:
        blocks: n_robots blocks of one lane and N_ROWS rows, one after the other.
        n_robots: how many there are.
        world: as in tasks/simulation/trees/step.py.
        first_step: number of the first step since the spawn; 0 spawns the robots first.
        n_steps: how many to take, 0 or more.
        trace: a block of n_robots · n_steps · N_TRACED rows to fill with the states after each step.
        traced: whether to.
    """
    for first in range(0, n_robots, TEAM):
        team = from_row(blocks, first * N_ROWS)
        n_team = min(TEAM, n_robots - first)
        if first_step == 0:
            for robot in range(n_team):
                spawn(from_row(team, robot * N_ROWS), world)
        for step in range(n_steps):
            take_step(team, n_team, world, first_step + step)
            if traced:
                for robot in range(n_team):
                    block = from_row(team, robot * N_ROWS)
                    kept = from_row(trace, ((first + robot) * n_steps + step) * layout.N_TRACED)
                    for row in range(layout.N_TRACED):
                        kept[row] = block[row] + block[layout.DIVERGENCE]
