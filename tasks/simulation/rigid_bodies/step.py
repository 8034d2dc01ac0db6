"""A step of robots of rigid bodies: the motors, a fluid, and Box2D 2.3's b2World::Step.

The relation of links to bodies is that of tasks/simulation/fused_links.py. Every bit equals the reference engine's.
"""

from collections.abc import Sequence

from numpy import float32

from tasks.arrays import Float32
from tasks.compiled import inline
from tasks.simd.lanes import Block, call, from_row
from tasks.simd.rotation import scalar_sincos
from tasks.simulation.box2d import Scene
from tasks.simulation.fluids import Acting, Push, of_group
from tasks.simulation.fused_links import placed, turned
from tasks.simulation.rigid_bodies import broad_phase, island, revolute_joint
from tasks.simulation.rigid_bodies.layout import GROUND, ROBOT, RobotRecord
from tasks.simulation.rigid_bodies.transform import transform

N_ROWS = ROBOT.itemsize // 4  # numbers of a record, of four bytes each
TEAM = 4  # robots that take a step together (see island.py): their records fit the L1 cache

_ZERO = float32(0)


@inline
def _place_link(robot: RobotRecord, index: int) -> None:
    """Place a link by its body."""
    link = robot.links[index]
    body = robot.bodies[link.body]
    state, direction, lever = placed(
        (body.p_x, body.p_y, body.a, body.v_x, body.v_y, body.w),
        body.cos,
        body.sin,
        (link.local_x, link.local_y, link.local_angle, link.local_cos, link.local_sin),
        (link.local_lever_x, link.local_lever_y),
    )
    link.x, link.y, link.angle, link.vx, link.vy, link.omega = state
    link.cos, link.sin = direction
    link.lever_x, link.lever_y = lever


@inline
def _push(robot: RobotRecord, scene: Scene) -> None:
    """Change the velocities of the bodies by those of their links (:func:`fused_links.body_change`)."""
    for b in range(robot.n_bodies):
        vx, vy, omega = _ZERO, _ZERO, _ZERO
        for index in range(scene.n_links):
            link = robot.links[index]
            if link.body == b:
                vx, vy = vx + link.mass_share * link.change_vx, vy + link.mass_share * link.change_vy
                lever = link.lever_x, link.lever_y
                omega = omega + turned(link, lever, link.change_vx, link.change_vy, link.change_omega)
                link.change_vx, link.change_vy, link.change_omega = _ZERO, _ZERO, _ZERO
        body = robot.bodies[b]
        body.v_x, body.v_y, body.w = body.v_x + vx, body.v_y + vy, body.w + omega


@inline
def _command_motors(robot: RobotRecord, numbers: Block, motors: Push, step: int) -> None:
    """Set the motors' speeds by the controller."""
    call(motors.address, numbers, motors.factors, step)
    for j in range(robot.n_joints):
        joint = robot.joints[j]
        joint.motor_speed = robot.links[joint.child].motor_speed


@inline
def _orient_fixtures(robot: RobotRecord, scene: Scene) -> None:
    """Compute the corners, normals and AABBs of all fixtures."""
    for i in range(scene.n_links + 1):
        box = robot.fixtures[i if i < scene.n_links else GROUND]
        broad_phase.orient(robot.bodies[box.body], box)


@inline
def _synchronize_fixtures(robot: RobotRecord, scene: Scene) -> None:
    """Finish b2World::Solve: update the AABBs, and look for new contacts where one has left its fat AABB."""
    moved = False
    for i in range(scene.n_links):
        box = robot.fixtures[i]
        moved = broad_phase.synchronize(robot.bodies[box.body], box) or moved
    if moved:
        broad_phase.find_new_contacts(robot)


@inline
def _begin_step(robot: RobotRecord, numbers: Block, scene: Scene, acting: Acting, step: int) -> None:
    """Run the motors and the fluid, collide, and prepare the island; ``numbers`` are the robot's record as rows."""
    _command_motors(robot, numbers, acting.motors, step)
    if acting.fluid.address != 0:
        call(acting.fluid.address, numbers, acting.fluid.factors, scene.n_links)
    _push(robot, scene)
    broad_phase.collide(robot)
    island.search(robot)
    island.begin(robot, scene)
    if step == 0:
        _orient_fixtures(robot, scene)


@inline
def _finish_step(robot: RobotRecord, scene: Scene) -> None:
    """Look for new contacts, place the links, notice a divergence, and count the motors' work if wanted."""
    _synchronize_fixtures(robot, scene)
    for index in range(scene.n_links):
        _place_link(robot, index)
        link = robot.links[index]
        pose = _ZERO * link.x + _ZERO * link.y + _ZERO * link.angle
        velocity = _ZERO * link.vx + _ZERO * link.vy + _ZERO * link.omega
        robot.divergence = robot.divergence + (pose + velocity)
    if scene.motor_work:
        for j in range(robot.n_joints):
            revolute_joint.add_motor_work(robot, robot.joints[j])


@inline
def _take_step(team: Sequence[RobotRecord], numbers: Block, scene: Scene, acting: Acting, step: int) -> None:
    """Run the motors, the fluid, and b2World::Step for a team; a robot that has diverged only drifts."""
    for r in range(len(team)):
        robot = team[r]
        if robot.divergence == 0.0:
            _begin_step(robot, from_row(numbers, r * N_ROWS), scene, of_group(acting, r), step)
        else:
            robot.n_island_contacts, robot.n_island_joints = 0, 0
    island.sweep_velocities(team, scene)
    for r in range(len(team)):
        island.integrate_positions(team[r], scene.dt)
    island.sweep_positions(team, scene)
    for r in range(len(team)):
        _finish_step(team[r], scene)


@inline
def _spawn(robot: RobotRecord, scene: Scene) -> None:
    """Orient the bodies, place the links, and look for the first contacts."""
    for b in range(robot.n_bodies):
        body = robot.bodies[b]
        body.sin, body.cos = scalar_sincos(body.a)
        body.c_x, body.c_y = transform(body, (body.local_center_x, body.local_center_y))
    for index in range(scene.n_links):
        _place_link(robot, index)
    _orient_fixtures(robot, scene)
    for i in range(scene.n_links + 1):
        broad_phase.create_proxy(robot.fixtures[i if i < scene.n_links else GROUND])
    broad_phase.find_new_contacts(robot)


@inline
def _record_states(robot: RobotRecord, states: Float32) -> None:
    """Write (n_links, 6) states, NaN where the robot has diverged."""
    for index in range(len(states)):
        link, state, divergence = robot.links[index], states[index], robot.divergence
        state[0], state[1], state[2] = link.x + divergence, link.y + divergence, link.angle + divergence
        state[3], state[4], state[5] = link.vx + divergence, link.vy + divergence, link.omega + divergence


def advance_robots(
    robots: Sequence[RobotRecord],
    numbers: Block,
    scene: Scene,
    acting: Acting,
    first_step: int,
    end_step: int,
    trace: Float32,
) -> None:
    """Take steps with robots, team after team.

    Step 0 spawns the robots first. ``numbers`` are their records as rows of one number. ``trace`` is (n_robots,
    n_steps, n_links, 6) for the states after each step; empty if they are not wanted.
    """
    for first in range(0, len(robots), TEAM):
        team = robots[first : first + TEAM]
        if first_step == 0:
            for r in range(len(team)):
                _spawn(team[r], scene)
        for step in range(first_step, end_step):
            _take_step(team, from_row(numbers, first * N_ROWS), scene, of_group(acting, first), step)
            if trace.size > 0:
                for r in range(len(team)):
                    _record_states(team[r], trace[first + r, step - first_step])
