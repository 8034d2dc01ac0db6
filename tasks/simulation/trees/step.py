"""A step of many robots at once, on lanes: the motors, the slush, and Box2D 2.3's b2World::Step.

The order of a step is Box2D's: collide, integrate velocities, warm-start contacts then joints, sweep joints then
contacts for velocities, integrate positions, sweep contacts then joints for positions. Contacts tie no two links, so
their order among themselves does not matter; that of the joints does. The motors and the slush are those of drive.py
and tasks/world/slush.py, in the same float32 operations. Everything equals the reference engine to the last bit.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from tasks.compiled import inline
from tasks.design.genes import N_JOINTS
from tasks.simulation.box2d import MAX_ROTATION, MAX_ROTATION_SQUARED, MAX_TRANSLATION
from tasks.simulation.controller import SINE_OF_TURNS
from tasks.simulation.simd.lanes import any_lane, count_parts, floor, from_row, part, select, sqrt
from tasks.simulation.simd.rotation import sincos
from tasks.simulation.trees import contact, joint
from tasks.simulation.trees.joint import of_parent
from tasks.simulation.trees.layout import (
    ANGLE,
    COS,
    DIVERGENCE,
    FREQUENCY,
    HALF_HEIGHT,
    INERTIA,
    MASS,
    MOTION_RANGE,
    MOTOR_SPEED,
    N_ROWS,
    N_TRACED,
    OMEGA,
    PARENT,
    PHASE,
    REST_ANGLE,
    SHORT_AXIS,
    SIN,
    VX,
    VY,
    X,
    Y,
)
from tasks.world.slush import TINY

# float32, because motor_speed and slush_change serve lanes and the numbers of tasks/simulation/rigid_bodies.
_C1, _C3, _C5, _C7, _C9 = (np.float32(c) for c in SINE_OF_TURNS)
_ZERO, _QUARTER, _HALF, _ONE, _TWO, _FOUR, _TWENTY_FOUR = (np.float32(x) for x in (0, 0.25, 0.5, 1, 2, 4, 24))
_TINY = np.float32(TINY)
MAX_GROUPS_AT_ONCE = 2
"""Groups that take a step together; what the velocity solver touches of two still fits a core's L1 cache."""


class Scene(NamedTuple):
    """What all robots of a call share, rounded once to float32."""

    dt: np.float32
    """[s]"""
    dt_ratio: np.float32
    """Box2D's dtRatio of a steady time step: 1, give or take a rounding."""
    fall: np.float32
    """Gain of vy by gravity in a step [m/s]."""
    ground: np.float32
    """Height of the ground's top [m]."""
    friction: np.float32
    restitution: np.float32
    motor_gain: np.float32
    """[1/s]"""
    velocity_iterations: int
    position_iterations: int
    n_links: int
    """Always 6, but told at run time: the compiler would unroll loops, and outgrow the cache of instructions."""
    slush: bool
    """Whether the built-in slush fills the world below y = 0; its factors follow."""
    drag: np.float32
    """½ ρ C_dl dt"""
    angular_drag: np.float32
    """ρ C_dr dt"""
    lift: np.float32
    """ρ g dt"""


@inline
def motor_speed(turns: Any, rest_angle: Any, motion_range: Any, joint_angle: Any, gain: Any) -> Any:
    """Motor speed gain · (θ* - θ) of lanes or numbers, at a phase in turns; see tasks/simulation/controller.py."""
    r = turns - floor(turns + _HALF)
    folded = _QUARTER - abs(abs(r) - _QUARTER)
    square = folded * folded
    sine = folded * (_C1 + square * (_C3 + square * (_C5 + square * (_C7 + square * _C9))))
    target = rest_angle + motion_range * select(r < 0.0, -sine, sine)
    return gain * (target - joint_angle)


@inline
def command_motor(block: Any, j: int, time: Any, gain: Any) -> None:
    """Set a joint's motor speed."""
    parent = block[PARENT + j]
    joint_angle = block[ANGLE + j + 1] - of_parent(from_row(block, ANGLE), parent, j)
    turns = block[FREQUENCY] * time + block[PHASE + j]
    block[MOTOR_SPEED + j] = motor_speed(turns, block[REST_ANGLE + j], block[MOTION_RANGE + j], joint_angle, gain)


@inline
def _share(share: Any) -> Any:
    """Clamp to [0, 1]."""
    positive = select(share > 0.0, share, _ZERO)
    return select(positive < 1.0, positive, _ONE)


@inline
def immersion(length: Any, width: Any, y: Any, cos: Any, sin: Any) -> Any:
    """Half the rises of a link's edges, and the depth of its lowest corner; see tasks/world/slush.py."""
    rise_short, rise_long = abs(sin) * width / _TWO, abs(cos) * length / _TWO
    return rise_short, rise_long, rise_short + rise_long - y


@inline
def slush_change(
    length: Any,
    width: Any,
    mass: Any,
    inertia: Any,
    velocity: Any,
    rise_short: Any,
    rise_long: Any,
    depth: Any,
    world: Any,
) -> Any:
    """Change of a link's velocities by drag and buoyancy of the slush over one step; see tasks/world/slush.py.

    Args:
        length: long axis of the link [m].
        width: short axis [m].
        mass: [kg].
        inertia: [kg·m²].
        velocity: vx, vy [m/s] and omega [rad/s].
        rise_short: from :func:`immersion`.
        rise_long: from :func:`immersion`.
        depth: from :func:`immersion`; above 0.
        world: a :class:`Scene`.

    Returns:
        Changes of vx, vy [m/s] and omega [rad/s].
    """
    per_short = _HALF / select(rise_short > _TINY, rise_short, _TINY)
    per_long = _HALF / select(rise_long > _TINY, rise_long, _TINY)
    t1, t2 = _share(depth * per_short), _share(depth * per_long)
    t3, t4 = _share((depth - _TWO * rise_short) * per_long), _share((depth - _TWO * rise_long) * per_short)
    area = (t1 * (t2 + t3) + t4 * (t2 - t3)) / _TWO
    p1, p4 = _TWO * t1 - _ONE, _TWO * t4 - _ONE
    q3, q2 = _TWO * t3 - _ONE, _TWO * t2 - _ONE
    across = width * width * ((t2 + t3) + (t2 - t3) * ((p1 * p1 + p4 * p4) * (p1 + p4)) / _FOUR)
    along = length * length * ((t1 + t4) + (t1 - t4) * ((q2 * q2 + q3 * q3) * (q2 + q3)) / _FOUR)
    second_moment = (across + along) / _TWENTY_FOUR
    second_moment = select(second_moment > 0.0, second_moment, _ZERO)

    vx, vy, omega = velocity
    k_dt = world.drag * area / mass
    k_r_dt = world.angular_drag * second_moment / inertia
    slowed = _ONE + k_dt * sqrt(vx * vx + vy * vy)
    lift = world.lift * area / mass
    return vx / slowed - vx, (vy / slowed + lift) - vy, omega / (_ONE + k_r_dt * abs(omega)) - omega


@inline
def submerge(block: Any, link: int, world: Any) -> None:
    """Add the change by the slush to a link's velocities, if it touches the slush in any lane."""
    length, width = _TWO * block[HALF_HEIGHT + link], block[SHORT_AXIS + link]  # halving was exact
    rise_short, rise_long, depth = immersion(length, width, block[Y + link], block[COS + link], block[SIN + link])
    if any_lane(depth > 0.0):
        velocity = block[VX + link], block[VY + link], block[OMEGA + link]
        mass, inertia = block[MASS + link], block[INERTIA + link]
        change = slush_change(length, width, mass, inertia, velocity, rise_short, rise_long, depth, world)
        block[VX + link], block[VY + link] = velocity[0] + change[0], velocity[1] + change[1]
        block[OMEGA + link] = velocity[2] + change[2]


@inline
def integrate_position(block: Any, link: int, dt: Any) -> None:
    """b2Island::Solve: limit the velocities, then move."""
    vx, vy, w = block[VX + link], block[VY + link], block[OMEGA + link]
    translation_x, translation_y, rotation = dt * vx, dt * vy, dt * w
    squared = translation_x * translation_x + translation_y * translation_y
    too_far = squared > MAX_TRANSLATION * MAX_TRANSLATION
    too_much = rotation * rotation > MAX_ROTATION_SQUARED
    if any_lane(too_far | too_much):
        ratio = MAX_TRANSLATION / sqrt(squared)
        vx, vy = select(too_far, vx * ratio, vx), select(too_far, vy * ratio, vy)
        w = select(too_much, w * (MAX_ROTATION / abs(rotation)), w)
        block[VX + link], block[VY + link], block[OMEGA + link] = vx, vy, w
    angle = block[ANGLE + link] + dt * w
    block[X + link], block[Y + link] = block[X + link] + dt * vx, block[Y + link] + dt * vy
    block[ANGLE + link] = angle
    block[SIN + link], block[COS + link] = sincos(angle)


if N_JOINTS != 5:
    raise NotImplementedError(f"a design has {N_JOINTS} joints, expected 5: each is named in the sweeps below")


@inline
def part_of_groups(blocks: Any, index: int) -> Any:
    """View a part of a group; those of groups abreast are counted through.

    Contacts go by parts, since a second point costs time in all lanes where one has it: few links lie on two points,
    but among 32 lanes mostly one does.
    """
    n_parts = count_parts(blocks)
    return part(from_row(blocks, index // n_parts * N_ROWS), index % n_parts)


@inline
def start_joint(blocks: Any, batch_size: int, j: int, dt_ratio: Any) -> None:
    """Initialise a joint's velocity constraint, and warm-start it, in groups abreast."""
    for k in range(batch_size):
        joint.init_velocity_constraint(from_row(blocks, k * N_ROWS), j, dt_ratio)


@inline
def sweep_joint(blocks: Any, batch_size: int, j: int) -> None:
    """Solve a joint's velocity constraint in groups abreast."""
    for k in range(batch_size):
        joint.solve_velocity_constraint(from_row(blocks, k * N_ROWS), j)


@inline
def start_joints_and_sweep(blocks: Any, batch_size: int, world: Any, touching: int, on_two_points: int) -> None:
    """Start the joints, and sweep the velocity solver, in groups abreast.

    Every joint waits for the one before it. So the processor has the other group's to do meanwhile.
    """
    start_joint(blocks, batch_size, 0, world.dt_ratio)
    start_joint(blocks, batch_size, 1, world.dt_ratio)
    start_joint(blocks, batch_size, 2, world.dt_ratio)
    start_joint(blocks, batch_size, 3, world.dt_ratio)
    start_joint(blocks, batch_size, 4, world.dt_ratio)
    for _ in range(world.velocity_iterations):
        sweep_joint(blocks, batch_size, 0)
        sweep_joint(blocks, batch_size, 1)
        sweep_joint(blocks, batch_size, 2)
        sweep_joint(blocks, batch_size, 3)
        sweep_joint(blocks, batch_size, 4)
        if touching == 0:  # afloat, or in the air
            continue
        for index in range(batch_size * count_parts(blocks)):
            block = part_of_groups(blocks, index)
            for link in range(world.n_links):
                bit = index * world.n_links + link
                if on_two_points >> bit & 1:
                    contact.solve_both_points(block, link, world.friction)
                elif touching >> bit & 1:
                    contact.solve_point(block, link, world.friction)


@inline
def solve_positions(block: Any, world: Any, touching: int) -> None:
    """Sweeps of the position solver; a lane is left alone once all its errors were small in one sweep."""
    unsolved = block[DIVERGENCE] == 0.0
    for _ in range(world.position_iterations):
        solved = unsolved
        for link in range(world.n_links):
            if touching >> link & 1:
                solved = solved & contact.solve_position_constraint(block, link, world.ground, unsolved)
        solved = solved & joint.solve_position_constraint(block, 0, unsolved)
        solved = solved & joint.solve_position_constraint(block, 1, unsolved)
        solved = solved & joint.solve_position_constraint(block, 2, unsolved)
        solved = solved & joint.solve_position_constraint(block, 3, unsolved)
        solved = solved & joint.solve_position_constraint(block, 4, unsolved)
        unsolved = unsolved & ~solved
        if not any_lane(unsolved):
            break


@inline
def push_links(block: Any, world: Any, step: int) -> None:
    """Set the motors' speeds, and change the links' velocities by the slush and by gravity."""
    time = np.float32(step) * world.dt
    command_motor(block, 0, time, world.motor_gain)
    command_motor(block, 1, time, world.motor_gain)
    command_motor(block, 2, time, world.motor_gain)
    command_motor(block, 3, time, world.motor_gain)
    command_motor(block, 4, time, world.motor_gain)
    for link in range(world.n_links):
        if world.slush:
            submerge(block, link, world)
        block[VY + link] = block[VY + link] + world.fall


@inline
def start_contacts(block: Any, world: Any) -> Any:
    """Find the contacts with the ground, and initialise and warm-start them.

    Returns:
        The links that touch the ground in any lane, and those that lie on two points, each as the bits of a number.
    """
    touching, on_two_points = 0, 0
    for link in range(world.n_links):
        if contact.collide(block, link, world.ground):
            touching |= 1 << link
            if contact.init_velocity_constraint(block, link, world.ground, world.restitution, world.dt_ratio):
                on_two_points |= 1 << link
    return touching, on_two_points


@inline
def end_step(block: Any, world: Any, touching: int) -> None:
    """Run b2World::Step from the velocity solver on."""
    for link in range(world.n_links):
        integrate_position(block, link, world.dt)
    solve_positions(block, world, touching)
    divergence = block[DIVERGENCE]
    for row in range(N_TRACED):
        divergence = divergence + 0.0 * block[row]
    block[DIVERGENCE] = divergence


@inline
def take_step(blocks: Any, batch_size: int, world: Any, step: int) -> None:
    """Take a step with groups abreast."""
    n_parts = count_parts(blocks)
    for k in range(batch_size):
        push_links(from_row(blocks, k * N_ROWS), world, step)
    touching, on_two_points = 0, 0  # of the first part in the lowest bits
    for index in range(batch_size * n_parts):
        links, links_on_two = start_contacts(part_of_groups(blocks, index), world)
        touching |= links << (index * world.n_links)
        on_two_points |= links_on_two << (index * world.n_links)
    start_joints_and_sweep(blocks, batch_size, world, touching, on_two_points)
    for k in range(batch_size):
        links = 0
        for index in range(k * n_parts, (k + 1) * n_parts):
            links |= touching >> (index * world.n_links)
        end_step(from_row(blocks, k * N_ROWS), world, links)


@inline
def orient(block: Any, world: Any) -> None:
    """Sine and cosine of the angles at the spawn; from then on they follow the angles."""
    for link in range(world.n_links):
        block[SIN + link], block[COS + link] = sincos(block[ANGLE + link])


def advance(blocks: Any, n_groups: int, world: Any, first_step: int, n_steps: int, trace: Any, traced: bool) -> None:
    """Take steps with groups of robots.

    Args:
        blocks: n_groups blocks of N_ROWS rows, one after the other.
        n_groups: how many there are.
        world: a :class:`Scene`.
        first_step: number of the first step since the spawn; 0 orients the links first.
        n_steps: how many to take, 0 or more.
        trace: a block of n_groups · n_steps · N_TRACED rows to fill with the states after each step.
        traced: whether to.
    """
    for group in range(0, n_groups, MAX_GROUPS_AT_ONCE):
        abreast = from_row(blocks, group * N_ROWS)
        batch_size = min(MAX_GROUPS_AT_ONCE, n_groups - group)
        if first_step == 0:
            for k in range(batch_size):
                orient(from_row(abreast, k * N_ROWS), world)
        for step in range(n_steps):
            take_step(abreast, batch_size, world, first_step + step)
            if traced:
                for k in range(batch_size):
                    block = from_row(abreast, k * N_ROWS)
                    kept = from_row(trace, ((group + k) * n_steps + step) * N_TRACED)
                    for row in range(N_TRACED):
                        kept[row] = block[row] + block[DIVERGENCE]
