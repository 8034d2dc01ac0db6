"""A step of many robots at once, on lanes: the motors, the slush, and Box2D 2.3's b2World::Step.

The order of a step is Box2D's: collide, integrate velocities, warm-start contacts then joints, sweep joints then
contacts for velocities, integrate positions, sweep contacts then joints for positions. The order of contacts among
themselves does not matter, because no contact connects two links; that of joints does. The motors and the slush are
those of tasks/simulation/controller.py and tasks/world/slush.py, in the same float32 operations. Everything equals the
reference engine to the last bit.
"""

from typing import NamedTuple

import numpy as np

from tasks.compiled import inline
from tasks.design.gait import N_NUMBERS
from tasks.design.genes import N_JOINTS
from tasks.simulation.box2d import MAX_ROTATION, MAX_ROTATION_SQUARED, MAX_TRANSLATION
from tasks.simulation.controller import target_angle
from tasks.simulation.simd.lanes import Block, Numeric, any_lane, from_row, select, sqrt
from tasks.simulation.simd.rotation import sincos
from tasks.simulation.trees import contact, joint
from tasks.simulation.trees import layout as at
from tasks.simulation.trees.joint import of_parent
from tasks.world.slush import TINY

# float32, because motor_speed and slush_change serve lanes and the numbers of tasks/simulation/rigid_bodies.
_ZERO, _HALF, _ONE, _TWO, _FOUR, _TWENTY_FOUR = (np.float32(x) for x in (0, 0.5, 1, 2, 4, 24))
_TINY = np.float32(TINY)

MAX_GROUPS_AT_ONCE = 2  # of two, what the velocity solver uses still fits a core's L1 cache


class Scene(NamedTuple):
    """Constants that all robots of a call share, rounded once to float32."""

    dt: np.float32  # [s]
    dt_ratio: np.float32  # box2D's dtRatio of a constant time step: 1, up to rounding
    fall: np.float32  # gain of vy by gravity in a step [m/s]
    ground: np.float32  # height of the ground's top [m]
    friction: np.float32
    restitution: np.float32
    motor_gain: np.float32  # [1/s]
    max_motor_speed: np.float32  # [rad/s]; infinite without a limit
    velocity_iterations: int
    position_iterations: int
    n_links: int  # always 6, but known at run time only: otherwise loops are unrolled and outgrow the instruction cache
    slush: bool  # whether the built-in slush fills the region below y = 0; its factors follow
    drag: np.float32  # ½ ρ C_dl dt
    angular_drag: np.float32  # ρ C_dr dt
    lift: np.float32  # ρ g dt
    by_component: bool  # whether drag acts on each component of the velocity by itself
    motor_work: bool = False  # whether to add up the work of the motors


@inline
def motor_speed(target: Numeric, joint_angle: Numeric, scene: Scene) -> Numeric:
    """Return the motor speed gain · (θ* - θ), within its limit, of lanes or numbers [rad/s]; as in controller.py."""
    wanted, limit = scene.motor_gain * (target - joint_angle), scene.max_motor_speed
    below = select(wanted > limit, limit, wanted)
    return select(below < -limit, -limit, below)


@inline
def _command_motor(block: Block, j: int, time: np.float32, scene: Scene) -> None:
    parent = block[at.PARENT + j]
    joint_angle = block[at.ANGLE + j + 1] - of_parent(from_row(block, at.ANGLE), parent, j)
    gait, periods = from_row(block, at.GAIT + j * N_NUMBERS), block[at.FREQUENCY] * time
    target = target_angle(gait, block[at.REST_ANGLE + j], periods)
    block[at.MOTOR_SPEED + j] = motor_speed(target, joint_angle, scene)


@inline
def _share(share: Numeric) -> Numeric:
    """Clamp to [0, 1]."""
    positive = select(share > 0.0, share, _ZERO)
    return select(positive < 1.0, positive, _ONE)


@inline
def immersion(length: Numeric, width: Numeric, y: Numeric, cos: Numeric, sin: Numeric) -> tuple[Numeric, ...]:
    """Return half the rises of a link's short and long edge, and the depth of its lowest corner [m]; as in slush.py.

    ``y`` is the height of the centre over the surface [m].
    """
    rise_short, rise_long = abs(sin) * width / _TWO, abs(cos) * length / _TWO
    return rise_short, rise_long, rise_short + rise_long - y


@inline
def submerged_part(length: Numeric, width: Numeric, immersed: tuple[Numeric, ...]) -> tuple[Numeric, Numeric]:
    """Return the submerged area [m²] and its second moment [m⁴] by a link's :func:`immersion`; as in slush.py."""
    rise_short, rise_long, depth = immersed
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
    return area, select(second_moment > 0.0, second_moment, _ZERO)


@inline
def slush_change(
    sizes: tuple[Numeric, ...], velocity: tuple[Numeric, ...], immersed: tuple[Numeric, ...], scene: Scene
) -> tuple[Numeric, ...]:
    """Return the changes of vx, vy [m/s] and omega [rad/s] by the slush in one step; see tasks/world/slush.py.

    ``sizes`` are a link's length, width, mass and inertia, ``immersed`` its :func:`immersion`, with a depth above 0.
    """
    length, width, mass, inertia = sizes
    area, second_moment = submerged_part(length, width, immersed)
    vx, vy, omega = velocity
    k_dt = scene.drag * area / mass
    k_r_dt = scene.angular_drag * second_moment / inertia
    speed_x = speed_y = sqrt(vx * vx + vy * vy)
    if scene.by_component:
        speed_x, speed_y = abs(vx), abs(vy)
    lift = scene.lift * area / mass
    after_x, after_y = vx / (_ONE + k_dt * speed_x), vy / (_ONE + k_dt * speed_y)
    return after_x - vx, (after_y + lift) - vy, omega / (_ONE + k_r_dt * abs(omega)) - omega


@inline
def _submerge(block: Block, link: int, scene: Scene) -> None:
    """Add the slush's velocity change to a link, unless it is dry in all lanes."""
    length, width = _TWO * block[at.HALF_HEIGHT + link], block[at.SHORT_AXIS + link]  # halving was exact
    immersed = immersion(length, width, block[at.Y + link], block[at.COS + link], block[at.SIN + link])
    if any_lane(immersed[2] > 0.0):
        velocity = block[at.VX + link], block[at.VY + link], block[at.OMEGA + link]
        sizes = length, width, block[at.MASS + link], block[at.INERTIA + link]
        change = slush_change(sizes, velocity, immersed, scene)
        block[at.VX + link], block[at.VY + link] = velocity[0] + change[0], velocity[1] + change[1]
        block[at.OMEGA + link] = velocity[2] + change[2]


@inline
def _integrate_position(block: Block, link: int, dt: np.float32) -> None:
    """b2Island::Solve: limit the velocities, then move."""
    vx, vy, w = block[at.VX + link], block[at.VY + link], block[at.OMEGA + link]
    translation_x, translation_y, rotation = dt * vx, dt * vy, dt * w
    squared = translation_x * translation_x + translation_y * translation_y
    too_far = squared > MAX_TRANSLATION * MAX_TRANSLATION
    too_much = rotation * rotation > MAX_ROTATION_SQUARED
    if any_lane(too_far | too_much):
        ratio = MAX_TRANSLATION / sqrt(squared)
        vx, vy = select(too_far, vx * ratio, vx), select(too_far, vy * ratio, vy)
        w = select(too_much, w * (MAX_ROTATION / abs(rotation)), w)
        block[at.VX + link], block[at.VY + link], block[at.OMEGA + link] = vx, vy, w
    angle = block[at.ANGLE + link] + dt * w
    block[at.X + link], block[at.Y + link] = block[at.X + link] + dt * vx, block[at.Y + link] + dt * vy
    block[at.ANGLE + link] = angle
    block[at.SIN + link], block[at.COS + link] = sincos(angle)


if N_JOINTS != 5:
    raise NotImplementedError(f"a design has {N_JOINTS} joints, expected 5: each is named in the sweeps below")


@inline
def _start_joint(groups: Block, n_groups: int, j: int, scene: Scene) -> None:
    for k in range(n_groups):
        joint.init_velocity_constraint(from_row(groups, k * at.N_ROWS), j, scene.dt_ratio)


@inline
def _sweep_joint(groups: Block, n_groups: int, j: int) -> None:
    for k in range(n_groups):
        joint.solve_velocity_constraint(from_row(groups, k * at.N_ROWS), j)


@inline
def _solve_velocities(groups: Block, n_groups: int, scene: Scene, touching: int, on_two_points: int) -> None:
    """Warm-start the joints and sweep the velocity solver.

    Each joint waits for the result of the one before it; meanwhile the processor works on the other group.
    """
    _start_joint(groups, n_groups, 0, scene)
    _start_joint(groups, n_groups, 1, scene)
    _start_joint(groups, n_groups, 2, scene)
    _start_joint(groups, n_groups, 3, scene)
    _start_joint(groups, n_groups, 4, scene)
    for _ in range(scene.velocity_iterations):
        _sweep_joint(groups, n_groups, 0)
        _sweep_joint(groups, n_groups, 1)
        _sweep_joint(groups, n_groups, 2)
        _sweep_joint(groups, n_groups, 3)
        _sweep_joint(groups, n_groups, 4)
        if touching == 0:  # afloat, or in the air
            continue
        for k in range(n_groups):
            block = from_row(groups, k * at.N_ROWS)
            for link in range(scene.n_links):
                bit = k * scene.n_links + link
                if on_two_points >> bit & 1:
                    contact.solve_both_points(block, link, scene.friction)
                elif touching >> bit & 1:
                    contact.solve_point(block, link, scene.friction)


@inline
def _solve_positions(block: Block, scene: Scene, touching: int) -> None:
    """Sweep the position solver; a lane stops once all its errors were small in one sweep."""
    unsolved = block[at.DIVERGENCE] == 0.0
    for _ in range(scene.position_iterations):
        solved = unsolved
        for link in range(scene.n_links):
            if touching >> link & 1:
                solved = solved & contact.solve_position_constraint(block, link, scene.ground, unsolved)
        solved = solved & joint.solve_position_constraint(block, 0, unsolved)
        solved = solved & joint.solve_position_constraint(block, 1, unsolved)
        solved = solved & joint.solve_position_constraint(block, 2, unsolved)
        solved = solved & joint.solve_position_constraint(block, 3, unsolved)
        solved = solved & joint.solve_position_constraint(block, 4, unsolved)
        unsolved = unsolved & ~solved
        if not any_lane(unsolved):
            break


@inline
def _push_links(block: Block, scene: Scene, step: int) -> None:
    """Command the motors, and change the links' velocities by slush and gravity."""
    time = np.float32(step) * scene.dt
    _command_motor(block, 0, time, scene)
    _command_motor(block, 1, time, scene)
    _command_motor(block, 2, time, scene)
    _command_motor(block, 3, time, scene)
    _command_motor(block, 4, time, scene)
    for link in range(scene.n_links):
        if scene.slush:
            _submerge(block, link, scene)
        block[at.VY + link] = block[at.VY + link] + scene.fall


@inline
def _start_contacts(block: Block, scene: Scene) -> tuple[int, int]:
    """Find, initialize and warm-start the contacts with the ground.

    Returns the links that touch the ground in any lane, and those that touch it with two points, as bits of integers.
    """
    touching, on_two_points = 0, 0
    for link in range(scene.n_links):
        if contact.collide(block, link, scene.ground):
            touching |= 1 << link
            if contact.init_velocity_constraint(block, link, scene.ground, scene.restitution, scene.dt_ratio):
                on_two_points |= 1 << link
    return touching, on_two_points


@inline
def _end_step(block: Block, scene: Scene, touching: int) -> None:
    """Integrate positions, correct them, note divergence, and count the motors' work if wanted."""
    for link in range(scene.n_links):
        _integrate_position(block, link, scene.dt)
    _solve_positions(block, scene, touching)
    divergence = block[at.DIVERGENCE]
    for row in range(at.N_TRACED):
        divergence = divergence + 0.0 * block[row]
    block[at.DIVERGENCE] = divergence
    if scene.motor_work:
        for j in range(scene.n_links - 1):
            joint.add_motor_work(block, j)


@inline
def _take_step(groups: Block, n_groups: int, scene: Scene, step: int) -> None:
    for k in range(n_groups):
        _push_links(from_row(groups, k * at.N_ROWS), scene, step)
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
    blocks: Block, n_groups: int, scene: Scene, first_step: int, n_steps: int, trace: Block, traced: bool
) -> None:
    """Step groups of robots.

    ``blocks`` holds n_groups groups of N_ROWS rows, one after the other. Step 0 orients the links first. If
    ``traced``, the states after each step fill the n_groups · n_steps · N_TRACED rows of ``trace``.
    """
    for group in range(0, n_groups, MAX_GROUPS_AT_ONCE):
        together = from_row(blocks, group * at.N_ROWS)
        n_together = min(MAX_GROUPS_AT_ONCE, n_groups - group)
        if first_step == 0:
            for k in range(n_together):
                _orient(from_row(together, k * at.N_ROWS), scene)
        for step in range(n_steps):
            _take_step(together, n_together, scene, first_step + step)
            if traced:
                for k in range(n_together):
                    block = from_row(together, k * at.N_ROWS)
                    states = from_row(trace, ((group + k) * n_steps + step) * at.N_TRACED)
                    for row in range(at.N_TRACED):
                        states[row] = block[row] + block[at.DIVERGENCE]
