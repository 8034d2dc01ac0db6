"""The batch engine: all robots of a call in compiled kernels, with the bits of the reference engine.

Ordinary robots are packed into SIMD lanes (tasks/simulation/trees). Robots whose passive joints are locked or whose
links collide are stepped one by one (tasks/simulation/rigid_bodies). It uses one thread: a study runs one process per
core.
"""

import numpy as np

from tasks.design.genes import N_LINKS, Designs
from tasks.simd.lanes import widest
from tasks.simulation.box2d import Motion, Scene, top_of_ground
from tasks.simulation.controller import fastest
from tasks.simulation.fluids import is_compiled
from tasks.simulation.networks.inference import PackedNetworks
from tasks.simulation.rigid_bodies.engine import Robots
from tasks.simulation.trees.groups import Groups
from tasks.simulation.trees.step import MAX_GROUPS_AT_ONCE
from tasks.world import Environment, Physics
from tasks.world.medium import MediumInRollout


def scene_of(environment: Environment, physics: Physics, n_links: int = N_LINKS) -> Scene:
    """Round the constants that all robots share to float32, as Box2D and NumPy do with their arguments."""
    single = np.float32
    dt = single(physics.time_step)
    friction = single(physics.friction)
    return Scene(
        dt=dt,
        dt_ratio=(single(1) / dt) * dt,
        fall=dt * single(-physics.gravity),
        ground=top_of_ground(environment.depth),
        friction=np.sqrt(friction * friction),
        restitution=single(physics.restitution),
        motor_gain=single(physics.motor_gain),
        max_motor_speed=fastest(physics),
        velocity_iterations=physics.velocity_iterations,
        position_iterations=physics.position_iterations,
        n_links=n_links,
    )


def _needs_rigid_bodies(physics: Physics) -> bool:
    return physics.passive_joints == "locked" or physics.link_collisions


def n_that_fill_lanes(n_robots: int, physics: Physics) -> int:
    """Return how many populations of n_robots fill the lanes of the groups that are stepped together."""
    return 1 if _needs_rigid_bodies(physics) else max(1, MAX_GROUPS_AT_ONCE * widest() // n_robots)


def roll_out(
    designs: Designs,
    environment: Environment,
    physics: Physics,
    *,
    n_settle: int,
    n_measure: int,
    trace: bool,
    motor_work: bool = False,
    n_lanes: int | None = None,
) -> Motion:
    """Return the motion of designs in an environment.

    Kernels compute a fluid by its law, and networks that a medium offers as its attribute ``networks``; they take all
    steps in one call. Any other medium is called in each step, for all links of all robots together. The arguments are
    those of :func:`tasks.simulation.rollout.simulate`, and the lanes of a group, on which results do not depend.
    """
    medium = environment.medium
    around = MediumInRollout(medium, environment.depth) if medium else None
    n_members, n_links = environment.n_members, designs.room
    networks: PackedNetworks | None = getattr(medium, "networks", None)
    robots: Groups | Robots
    if _needs_rigid_bodies(physics):
        robots = Robots(designs, environment.depth, physics, medium, n_members=n_members)
    else:
        n_lanes = n_lanes or widest()
        robots = Groups(designs, environment.depth, physics, medium, n_members=n_members, n_lanes=n_lanes)
    scene = scene_of(environment, physics, n_links)
    n_steps = n_settle + n_measure
    shape = (n_members, len(designs))
    states = np.empty((robots.n_robots, n_steps, n_links, 6), np.float32) if trace else None
    robots.advance(scene, 0, 0, None)
    settled = halfway = robots.poses()
    n_half = n_settle + n_measure // 2
    for first, last in ((0, n_settle), (n_settle, n_half), (n_half, n_steps)):
        if first == n_settle:
            scene = scene._replace(motor_work=motor_work)
        if networks is not None and not trace:
            robots.advance_with_networks(networks, scene, first, last - first)
        elif around is not None and not is_compiled(medium):
            for step in range(first, last):
                robots.push(around)
                robots.advance(scene, step, 1, None if states is None else states[:, step : step + 1])
        else:
            robots.advance(scene, first, last - first, None if states is None else states[:, first:last])
        if last == n_settle:
            settled = robots.poses()
        if last == n_half:
            halfway = robots.poses()
    return Motion(
        settled=settled.reshape(*shape, n_links, 6),
        halfway=halfway.reshape(*shape, n_links, 6),
        final=robots.poses().reshape(*shape, n_links, 6),
        trace=None if states is None else states.reshape(*shape, n_steps, n_links, 6),
        motor_work=robots.motor_work().reshape(*shape, n_links) if motor_work else None,
    )
