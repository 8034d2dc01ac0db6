"""Robots of rigid bodies in the batch engine: their blocks, and the compiled kernel that steps them."""

from __future__ import annotations

from typing import Any

import numpy as np

from tasks.arrays import Float32
from tasks.compiled import compiled
from tasks.design import genes
from tasks.design.body import kinematic_trees, rigid_bodies
from tasks.design.genes import N_LINKS, Designs
from tasks.simulation import controller
from tasks.simulation.fused_links import body_change
from tasks.simulation.networks import coupled, inference
from tasks.simulation.networks.inference import PackedNetworks
from tasks.simulation.rigid_bodies import broad_phase, contact_solver, island, polygons, records, revolute_joint, step
from tasks.simulation.rigid_bodies import layout as body_rows
from tasks.simulation.rigid_bodies.packing import body_number, pack
from tasks.simulation.simd import lanes, rotation, vectors
from tasks.simulation.simd.lanes import Block
from tasks.simulation.trees import contact, joint, layout
from tasks.simulation.trees import step as tree_step
from tasks.simulation.trees.step import Scene
from tasks.world import LinkStates, Medium, Physics
from tasks.world import slush as slush_source

_SOURCES = [
    genes,
    slush_source,
    controller,
    lanes,
    vectors,
    layout,
    rotation,
    joint,
    contact,
    tree_step,
    body_rows,
    records,
    polygons,
    broad_phase,
    contact_solver,
    revolute_joint,
    island,
    step,
]
_advance = compiled(step.advance_bodies, _SOURCES, seconds=30)


def advance_bodies_among_networks(
    block: Any,
    n_robots: int,
    world: Any,
    first_step: int,
    n_steps: int,
    coupling: Any,
    trace: Any,
    traced: bool,
    one: int,
) -> None:
    """Take steps with all robots, each in its member's medium, as tasks.simulation.batch does on lanes."""
    for taken in range(n_steps):
        coupled.push(coupling, body_rows.CHANGE_VX, body_rows.CHANGE_VY, body_rows.CHANGE_OMEGA)
        _advance(block, n_robots, world, first_step + taken, one, trace, traced)


_advance_among_networks = compiled(advance_bodies_among_networks, [*_SOURCES, inference, coupled], seconds=30)


class Robots:
    """Robots in blocks of one lane: robot number member · n_designs + design."""

    def __init__(self, designs: Designs, depth: float, physics: Physics, *, n_members: int) -> None:
        """Spawn n_members robots of each of n_designs designs over ground at a depth [m]."""
        self.n_robots = n_members * len(designs)
        self._n_members = n_members
        self._physics = physics
        self._block = Block(self.n_robots * body_rows.N_ROWS, 1)
        self._no_trace = Block(1, 1)
        self.blocks = self._block.rows.reshape(self.n_robots, body_rows.N_ROWS, 1)
        self._designs = designs
        trees = kinematic_trees(designs, density=physics.link_density)
        self._rigid = rigid_bodies(designs, passive_joints=physics.passive_joints)
        records = pack(designs, trees, self._rigid, depth, physics)
        self.blocks[..., 0] = np.tile(records, (n_members, 1))

    def _columns(self, *root_rows: int) -> Float32:
        """Read (n_robots, n_links, n_columns) quantities of the links."""
        return np.stack([self.blocks[:, row : row + N_LINKS, 0] for row in root_rows], axis=-1)

    def poses(self) -> Float32:
        """Read (n_robots, n_links, 6) states; NaN where diverged."""
        state = self._columns(layout.X, layout.Y, layout.ANGLE, layout.VX, layout.VY, layout.OMEGA)
        state[np.isnan(self.blocks[:, layout.DIVERGENCE, 0])] = np.nan
        return state

    def advance(self, world: Scene, first_step: int, n_steps: int, kept: Float32 | None) -> None:
        """Take steps, and keep the states after each in (n_robots, at least n_steps, n_links, 6) if that is given."""
        each = max(1, self.n_robots) if kept is None else step.TEAM
        for first in range(0, self.n_robots, each):
            n_robots = min(each, self.n_robots - first)
            trace = self._no_trace if kept is None else Block(n_robots * n_steps * layout.N_TRACED, 1)
            block = lanes.from_row(self._block, first * body_rows.N_ROWS)
            with np.errstate(all="ignore"):  # without the compiler the lanes are NumPy's, and it would warn
                _advance(block, n_robots, world, first_step, n_steps, trace, kept is not None)
            if kept is not None:
                states = trace.rows.reshape(n_robots, n_steps, 6, N_LINKS)
                kept[first : first + n_robots] = states.transpose(0, 1, 3, 2)

    def advance_among(self, learned_medium: PackedNetworks, world: Scene, first_step: int, n_steps: int) -> None:
        """Take steps in a medium that is one network for each member: all of it in one kernel, and without a trace."""
        coupling = coupled.couple(learned_medium, self.blocks, self.n_robots)
        with np.errstate(all="ignore"):
            _advance_among_networks(
                self._block, self.n_robots, world, first_step, n_steps, coupling, self._no_trace, False, 1
            )

    def push(self, medium: Medium) -> None:
        """Let a medium act on every link, and the links on their bodies, as the reference engine does."""
        shape = (self._n_members, len(self._designs), N_LINKS)
        columns = self._columns(*layout.QUANTITIES.values()).reshape(*shape, len(layout.QUANTITIES))
        links = LinkStates(**dict(zip(layout.QUANTITIES, np.moveaxis(columns, -1, 0), strict=True)))
        change = medium.velocity_change(links, self._physics)
        levers = self._columns(body_rows.WORLD_LEVER_X, body_rows.WORLD_LEVER_Y).reshape(*shape, 2)
        of_body = body_change(self._rigid, levers[..., 0], levers[..., 1], change)
        numbers = self.blocks[..., 0].reshape(self._n_members, len(self._designs), body_rows.N_ROWS)
        design, link = np.nonzero(self._rigid.is_first)
        body = body_number(self._rigid)[design, link]
        for row, added in ((body_rows.V_X, of_body.vx), (body_rows.V_Y, of_body.vy), (body_rows.W, of_body.omega)):
            where = (slice(None), design, body_rows.BODIES + body * body_rows.N_BODY + row)
            with np.errstate(invalid="ignore"):  # of robots that have diverged
                numbers[where] = (numbers[where] + added[:, design, link]).astype(np.float32)
