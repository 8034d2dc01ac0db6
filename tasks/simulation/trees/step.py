"""A step of many robots at once, on lanes: the motors, a fluid, and Box2D 2.3's b2World::Step.

The order of a step is Box2D's: collide, integrate velocities, warm-start contacts then joints, sweep joints then
contacts for velocities, integrate positions, sweep contacts then joints for positions. The order of contacts among
themselves does not matter, because no contact connects two links; that of joints does. The motors are those of
tasks/simulation/motors.py, in the same float32 operations. Everything equals the reference engine to the last bit.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from tasks.compiled import inline
from tasks.design.genes import MOST_LINKS
from tasks.simd.lanes import Block, Mask, any_lane, call, from_row
from tasks.simd.rotation import sincos
from tasks.simulation.box2d import Scene, limited
from tasks.simulation.fluids import Acting, of_group
from tasks.simulation.trees import contact, joint
from tasks.simulation.trees import layout as at

MAX_GROUPS_AT_ONCE = 2  # of two, what the velocity solver uses still fits a core's L1 cache


@inline
def _integrate_position(block: Block, link: int, dt: np.float32) -> None:
    """b2Island::Solve: limit the velocities, then move."""
    vx, vy, w = limited(block[at.VX + link], block[at.VY + link], block[at.OMEGA + link], dt)
    block[at.VX + link], block[at.VY + link], block[at.OMEGA + link] = vx, vy, w
    angle = block[at.ANGLE + link] + dt * w
    block[at.X + link], block[at.Y + link] = block[at.X + link] + dt * vx, block[at.Y + link] + dt * vy
    block[at.ANGLE + link] = angle
    block[at.SIN + link], block[at.COS + link] = sincos(angle)


Carried = Any  # what goes through all joints


def _in_order(act: Callable[..., Carried], j: int = 0) -> Callable[..., Carried]:
    """Return a function that lets ``act`` change a value joint by joint, from the jth on.

    Each joint is a constant there: its parent is one of the links before it, among which a loop would have to search.
    """
    if j == MOST_LINKS - 1:
        return inline(_unchanged)
    others = _in_order(act, j + 1)

    @inline
    def in_order(carried: Carried, scene: Scene, given: Any) -> Carried:
        if j >= scene.n_links - 1:
            return carried
        return others(act(carried, j, scene, given), scene, given)

    return in_order


def _unchanged(carried: Carried, scene: Scene, given: Any) -> Carried:  # noqa: ARG001 (ends what _in_order begins)
    return carried


@_in_order
@inline
def _start_joints(n_groups: int, j: int, scene: Scene, groups: Block) -> int:
    for k in range(n_groups):
        joint.init_velocity_constraint(from_row(groups, k * at.N_ROWS), j, scene)
    return n_groups


@_in_order
@inline
def _sweep_joints(n_groups: int, j: int, scene: Scene, groups: Block) -> int:  # noqa: ARG001
    for k in range(n_groups):
        joint.solve_velocity_constraint(from_row(groups, k * at.N_ROWS), j)
    return n_groups


@_in_order
@inline
def _correct_joints(solved: Mask, j: int, scene: Scene, given: tuple[Block, Mask]) -> Mask:  # noqa: ARG001
    block, unsolved = given
    return solved & joint.solve_position_constraint(block, j, unsolved)


@inline
def _solve_velocities(groups: Block, n_groups: int, scene: Scene, touching: int, on_two_points: int) -> None:
    """Warm-start the joints and sweep the velocity solver.

    Each joint waits for the result of the one before it; meanwhile the processor works on the other group.
    """
    _start_joints(n_groups, scene, groups)
    for _ in range(scene.velocity_iterations):
        _sweep_joints(n_groups, scene, groups)
        if touching == 0:  # afloat, or in the air
            continue
        for k in range(n_groups):
            block = from_row(groups, k * at.N_ROWS)
            for link in range(scene.n_links):
                bit = k * scene.n_links + link
                if on_two_points >> bit & 1:
                    contact.solve_both_points(block, link, scene)
                elif touching >> bit & 1:
                    contact.solve_point(block, link, scene)


@inline
def _solve_positions(block: Block, scene: Scene, touching: int) -> None:
    """Sweep the position solver; a lane stops once all its errors were small in one sweep."""
    unsolved = block[at.DIVERGENCE] == 0.0
    for _ in range(scene.position_iterations):
        solved = unsolved
        for link in range(scene.n_links):
            if touching >> link & 1:
                solved = solved & contact.solve_position_constraint(block, link, scene, unsolved)
        solved = _correct_joints(solved, scene, (block, unsolved))
        unsolved = unsolved & ~solved
        if not any_lane(unsolved):
            break


@inline
def _push_links(block: Block, scene: Scene, acting: Acting, step: int) -> None:
    """Command the motors, and change the links' velocities by the fluid and gravity."""
    call(acting.motors.address, block, acting.motors.factors, step)
    if acting.fluid.address != 0:
        call(acting.fluid.address, block, acting.fluid.factors, scene.n_links)
    for link in range(scene.n_links):
        block[at.VY + link] = block[at.VY + link] + scene.fall


@inline
def _start_contacts(block: Block, scene: Scene) -> tuple[int, int]:
    """Find, initialize and warm-start the contacts with the ground.

    Returns the links that touch the ground in any lane, and those that touch it with two points, as bits of integers.
    """
    touching, on_two_points = 0, 0
    for link in range(scene.n_links):
        if contact.collide(block, link, scene):
            touching |= 1 << link
            if contact.init_velocity_constraint(block, link, scene):
                on_two_points |= 1 << link
    return touching, on_two_points


@inline
def _end_step(block: Block, scene: Scene, touching: int) -> None:
    """Integrate positions, correct them, note divergence, and count the motors' work if wanted."""
    for link in range(scene.n_links):
        _integrate_position(block, link, scene.dt)
    _solve_positions(block, scene, touching)
    divergence = block[at.DIVERGENCE]
    for first in range(0, at.N_TRACED * at.ROOM, at.ROOM):
        for row in range(first, first + scene.n_links):
            divergence = divergence + 0.0 * block[row]
    block[at.DIVERGENCE] = divergence
    if scene.motor_work:
        for j in range(scene.n_links - 1):
            joint.add_motor_work(block, j)


@inline
def _take_step(groups: Block, n_groups: int, scene: Scene, acting: Acting, step: int) -> None:
    for k in range(n_groups):
        _push_links(from_row(groups, k * at.N_ROWS), scene, of_group(acting, k), step)
    touching, on_two_points = 0, 0  # the first group's links are the lowest bits
    for k in range(n_groups):
        links, links_on_two = _start_contacts(from_row(groups, k * at.N_ROWS), scene)
        touching |= links << (k * scene.n_links)
        on_two_points |= links_on_two << (k * scene.n_links)
    _solve_velocities(groups, n_groups, scene, touching, on_two_points)
    for k in range(n_groups):
        _end_step(from_row(groups, k * at.N_ROWS), scene, touching >> (k * scene.n_links))


@inline
def _orient(block: Block, scene: Scene) -> None:
    """Compute sine and cosine of the angles at the spawn; from then on they follow the angles."""
    for link in range(scene.n_links):
        block[at.SIN + link], block[at.COS + link] = sincos(block[at.ANGLE + link])


def advance(
    blocks: Block,
    n_groups: int,
    scene: Scene,
    acting: Acting,
    first_step: int,
    n_steps: int,
    trace: Block,
    traced: bool,
) -> None:
    """Step groups of robots.

    ``blocks`` holds n_groups groups of N_ROWS rows, one after the other. Step 0 orients the links first. If
    ``traced``, the states after each step fill the n_groups · n_steps · N_TRACED · n_links rows of ``trace``.
    """
    for group in range(0, n_groups, MAX_GROUPS_AT_ONCE):
        together = from_row(blocks, group * at.N_ROWS)
        n_together = min(MAX_GROUPS_AT_ONCE, n_groups - group)
        if first_step == 0:
            for k in range(n_together):
                _orient(from_row(together, k * at.N_ROWS), scene)
        for step in range(n_steps):
            _take_step(together, n_together, scene, of_group(acting, group), first_step + step)
            if traced:
                for k in range(n_together):
                    block = from_row(together, k * at.N_ROWS)
                    states = from_row(trace, ((group + k) * n_steps + step) * at.N_TRACED * scene.n_links)
                    for quantity in range(at.N_TRACED):
                        for link in range(scene.n_links):
                            state = block[quantity * at.ROOM + link] + block[at.DIVERGENCE]
                            states[quantity * scene.n_links + link] = state
