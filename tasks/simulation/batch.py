"""The batch engine: many robots at once, one per lane, with the bits of the reference engine.

Designs are packed into groups of as many robots as two of the machine's vectors hold (see lanes.widest), and a compiled
kernel steps the groups. Robots whose passive joints are locked or whose links collide have a kernel of their own,
without lanes: see tasks/simulation/bodies. One thread: a study runs one process per core.
"""

from __future__ import annotations

from functools import cache, cached_property
from typing import Any

import numpy as np

from tasks.arrays import Float32, Int64
from tasks.compiled import compiled, is_cached
from tasks.design import body, genes
from tasks.design.genes import N_LINKS, Designs
from tasks.simulation import box2d, controller
from tasks.simulation.box2d import GROUND_HALF_HEIGHT, Motion
from tasks.simulation.networks import coupled, inference
from tasks.simulation.networks.inference import PackedNetworks
from tasks.simulation.rigid_bodies.engine import Robots
from tasks.simulation.simd import lanes, rotation, vectors
from tasks.simulation.simd.lanes import Block, widest
from tasks.simulation.trees import contact, joint, layout, packing, step
from tasks.simulation.trees.step import MAX_GROUPS_AT_ONCE, Scene
from tasks.world import Environment, LinkStates, Medium, Physics, Slush
from tasks.world import slush as slush_source

_SOURCES = [genes, box2d, slush_source, controller, lanes, vectors, layout, rotation, joint, contact, step]
_advance = compiled(step.advance, _SOURCES, seconds=20)
_pack_robots = compiled(packing.pack_robots, [genes, body, layout, contact, controller, packing], seconds=2)


def advance_lanes_among_networks(
    block: Any,
    n_groups: int,
    world: Any,
    first_step: int,
    n_steps: int,
    coupling: Any,
    trace: Any,
    traced: bool,
    one: int,
) -> None:
    """Take steps with all robots, each in its member's medium; see learned.py and the engine's kernel.

    ``one`` is 1 and ``traced`` False. Were they constants here, numba would compile the engine once more for them.
    """
    for taken in range(n_steps):
        coupled.push(coupling, layout.VX, layout.VY, layout.OMEGA)
        _advance(block, n_groups, world, first_step + taken, one, trace, traced)


_advance_among_networks = compiled(advance_lanes_among_networks, [*_SOURCES, inference, coupled], seconds=15)


def is_compiled() -> bool:
    """Tell whether this machine has made the engine's kernel before, for some number of lanes."""
    return is_cached(_advance)


def _is_built_in(medium: Medium | None) -> bool:
    """Tell whether the kernels have the medium: a kind of slush that does otherwise than slush is another medium."""
    return type(medium) is Slush


def scene_of(environment: Environment, physics: Physics) -> Scene:
    """Round what all robots share to float32, as Box2D and NumPy do on the way in."""
    single = np.float32
    dt = single(physics.time_step)
    medium = environment.medium
    slush = medium if isinstance(medium, Slush) else Slush()
    top = single(GROUND_HALF_HEIGHT) + single(-environment.depth - GROUND_HALF_HEIGHT)
    friction = single(physics.friction)
    return Scene(
        dt=dt,
        dt_ratio=(single(1) / dt) * dt,
        fall=dt * single(-physics.gravity),
        ground=top,
        friction=np.sqrt(friction * friction),
        restitution=single(physics.restitution),
        motor_gain=single(physics.motor_gain),
        velocity_iterations=physics.velocity_iterations,
        position_iterations=physics.position_iterations,
        n_links=N_LINKS,
        slush=_is_built_in(medium),
        drag=single(0.5 * slush.density * slush.linear_drag * physics.time_step),
        angular_drag=single(slush.density * slush.angular_drag * physics.time_step),
        lift=single(slush.density * physics.gravity * physics.time_step),
    )


@cache
def _no_trace(n_lanes: int) -> Block:
    """Give what kernels get in place of a trace, and leave alone."""
    return Block(1, n_lanes)


class Groups:
    """Robots packed into lanes: robot i is lane i mod n_lanes of group i // n_lanes."""

    def __init__(self, designs: Designs, physics: Physics, *, n_members: int, n_lanes: int) -> None:
        """Spawn n_members robots of each of n_designs designs: robot number member · n_designs + design."""
        self.n_robots = n_members * len(designs)
        self._n_members = n_members
        self._physics = physics
        self.n_lanes = n_lanes
        self.n_groups = -(-self.n_robots // n_lanes)
        self._block = Block(self.n_groups * layout.N_ROWS, n_lanes)
        self._no_trace = _no_trace(n_lanes)
        self.blocks = self._block.rows.reshape(self.n_groups, layout.N_ROWS, n_lanes)
        self._place = np.empty((len(designs), N_LINKS), np.int64)
        _pack_robots(
            designs.table,
            n_members,
            n_lanes,
            physics.link_density,
            np.float32(physics.time_step) * np.float32(physics.max_motor_torque),
            self.blocks,
            self._place,
        )

    @cached_property
    def _robot_of_lane(self) -> Int64:
        """(n_groups · n_lanes,) numbers; lanes left over at the end hold copies of the last robot."""
        return np.minimum(np.arange(self.n_groups * self.n_lanes), self.n_robots - 1)

    def _scatter(self, row: int, numbers: Float32) -> None:
        """Write (n_groups · n_lanes, n) numbers to n rows from one on."""
        n = numbers.shape[1]
        self.blocks[:, row : row + n] = numbers.reshape(self.n_groups, self.n_lanes, n).transpose(0, 2, 1)

    def states(self, columns: tuple[int, ...]) -> Float32:
        """Read quantities of the links, numbered as the kernels do.

        Args:
            columns: first rows of the quantities.

        Returns:
            (n_columns, n_robots, n_links)
        """
        taken = np.stack([self.blocks[:, row : row + N_LINKS] for row in columns])
        return taken.transpose(0, 1, 3, 2).reshape(len(columns), -1, N_LINKS)[:, : self.n_robots]

    def set_velocities(self, vx: Float32, vy: Float32, omega: Float32) -> None:
        """Write (n_robots, n_links) velocities, links numbered as the kernels do."""
        for row, velocity in ((layout.VX, vx), (layout.VY, vy), (layout.OMEGA, omega)):
            self._scatter(row, velocity[self._robot_of_lane])

    def poses(self) -> Float32:
        """Read (n_robots, n_links, 6) states, links in the designs' own order; NaN where diverged."""
        state = np.moveaxis(self.states((layout.X, layout.Y, layout.ANGLE, layout.VX, layout.VY, layout.OMEGA)), 0, -1)
        state = np.take_along_axis(state, self._place_of_robot()[..., None], axis=1)
        diverged = np.isnan(self.blocks[:, layout.DIVERGENCE].reshape(-1)[: self.n_robots])
        state[diverged] = np.nan
        return state

    def _place_of_robot(self) -> Int64:
        """(n_robots, n_links) numbers that the kernels give to the designs' links."""
        return np.tile(self._place, (self._n_members, 1))

    def advance(self, world: Scene, first_step: int, n_steps: int, kept: Float32 | None) -> None:
        """Take steps, and keep the states after each in (n_robots, at least n_steps, n_links, 6) if that is given."""
        for group in range(self.n_groups if kept is not None else 1):
            n_groups = 1 if kept is not None else self.n_groups
            trace = self._no_trace if kept is None else Block(n_steps * layout.N_TRACED, self.n_lanes)
            block = lanes.from_row(self._block, group * layout.N_ROWS)
            with np.errstate(all="ignore"):  # without the compiler the lanes are NumPy's, and it would warn
                _advance(block, n_groups, world, first_step, n_steps, trace, kept is not None)
            if kept is not None:
                mine = slice(group * self.n_lanes, min((group + 1) * self.n_lanes, self.n_robots))
                states = trace.rows.reshape(n_steps, 6, N_LINKS, self.n_lanes).transpose(3, 0, 2, 1)
                place = self._place_of_robot()[mine, None, :, None]
                kept[mine] = np.take_along_axis(states[: mine.stop - mine.start], place, axis=2)

    def advance_among(self, learned_medium: PackedNetworks, world: Scene, first_step: int, n_steps: int) -> None:
        """Take steps in a medium that is one network for each member: all of it in one kernel, and without a trace."""
        coupling = coupled.couple(learned_medium, self.blocks, self.n_robots)
        with np.errstate(all="ignore"):
            _advance_among_networks(
                self._block, self.n_groups, world, first_step, n_steps, coupling, self._no_trace, False, 1
            )

    def push(self, medium: Medium) -> None:
        """Add a medium's velocity change to every link, as the reference engine does."""
        states = self.states(tuple(layout.QUANTITIES.values()))
        states = states.reshape(len(layout.QUANTITIES), self._n_members, -1, N_LINKS)
        links = LinkStates(**dict(zip(layout.QUANTITIES, states, strict=True)))
        change = medium.velocity_change(links, self._physics)
        velocities = (links.vx + change.vx, links.vy + change.vy, links.omega + change.omega)
        self.set_velocities(*(v.astype(np.float32).reshape(self.n_robots, N_LINKS) for v in velocities))


def _has_no_lanes(physics: Physics) -> bool:
    """Tell whether robots have the kernel without lanes."""
    return physics.passive_joints == "locked" or physics.link_collisions


def n_that_fill_lanes(n_robots: int, physics: Physics) -> int:
    """Count the populations of so many robots that fill this machine's lanes, in as many groups as go abreast."""
    return 1 if _has_no_lanes(physics) else max(1, MAX_GROUPS_AT_ONCE * widest() // n_robots)


def roll_out(
    designs: Designs, environment: Environment, physics: Physics, *, n_settle: int, n_measure: int, trace: bool
) -> Motion:
    """Simulate designs in an environment; see :func:`tasks.simulation.simulate`."""
    # Half as many would take 0.7 of the time where they suffice, and another twenty seconds to compile.
    return roll_out_on(
        designs, environment, physics, n_settle=n_settle, n_measure=n_measure, trace=trace, n_lanes=widest()
    )


def roll_out_on(
    designs: Designs,
    environment: Environment,
    physics: Physics,
    *,
    n_settle: int,
    n_measure: int,
    trace: bool,
    n_lanes: int,
) -> Motion:
    """Simulate designs on a given number of lanes, on which nothing depends but the time it takes.

    The kernel has the slush built in, and networks that a medium offers as its attribute ``networks``, and takes all
    steps at once. Any other medium is asked step by step, for all links of all robots together.
    """
    medium = environment.medium
    n_members = environment.n_members
    learned_medium: PackedNetworks | None = getattr(medium, "networks", None)
    groups: Groups | Robots
    if _has_no_lanes(physics):
        groups = Robots(designs, environment.depth, physics, n_members=n_members)
    else:
        groups = Groups(designs, physics, n_members=n_members, n_lanes=n_lanes)
    world = scene_of(environment, physics)
    n_steps = n_settle + n_measure
    shape = (n_members, len(designs))
    kept = np.empty((groups.n_robots, n_steps, N_LINKS, 6), np.float32) if trace else None
    groups.advance(world, 0, 0, None)
    settled = groups.poses()
    for first, last in ((0, n_settle), (n_settle, n_steps)):
        if learned_medium is not None and not trace:
            groups.advance_among(learned_medium, world, first, last - first)
        elif medium is not None and not _is_built_in(medium):
            for number in range(first, last):
                groups.push(medium)
                groups.advance(world, number, 1, None if kept is None else kept[:, number : number + 1])
        else:
            groups.advance(world, first, last - first, None if kept is None else kept[:, first:last])
        if last == n_settle:
            settled = groups.poses()
    return Motion(
        settled=settled.reshape(*shape, N_LINKS, 6),
        final=groups.poses().reshape(*shape, N_LINKS, 6),
        trace=None if kept is None else kept.reshape(*shape, n_steps, N_LINKS, 6),
    )
