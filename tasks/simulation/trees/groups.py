"""Robots of the tree engine: their blocks, and the compiled kernels that step them."""

from functools import cached_property

import numpy as np

from tasks.arrays import Float32, Int64
from tasks.compiled import compiled
from tasks.design.genes import Designs
from tasks.simd.lanes import Block
from tasks.simulation.box2d import Scene
from tasks.simulation.fluids import Acting, Rows, push_of
from tasks.simulation.motors import Sensors, motors_of
from tasks.simulation.networks import coupled
from tasks.simulation.networks.coupled import Coupling
from tasks.simulation.networks.inference import PackedNetworks
from tasks.simulation.trees import layout, packing, step
from tasks.world.medium import LinkStates, Medium, MediumWithMemory
from tasks.world.physics import Physics

advance_kernel = compiled(step.advance, seconds=12)

_SENSORS = Sensors(
    layout.PARENT - 1,
    layout.ANGLE,
    layout.OMEGA,
    layout.LONG_AXIS,
    layout.Y,
    layout.COS,
    layout.SIN,
    layout.MOTOR_SPEED - 1,
    stride=1,
    later=-1,
)
_ROWS = Rows(
    read=tuple(layout.QUANTITIES.values()),
    add=(layout.VX, layout.VY, layout.OMEGA),
    unkicked=(layout.UNKICKED_VX, layout.UNKICKED_VY, layout.UNKICKED_OMEGA),
    stride=1,
)


def _advance_with_networks(
    block: Block,
    n_groups: int,
    scene: Scene,
    acting: Acting,
    first_step: int,
    n_steps: int,
    coupling: Coupling,
    trace: Block,
    traced: bool,
    one: int,
) -> None:
    """Step all robots in the media of their networks.

    ``one`` is 1 and ``traced`` False. As constants they would make numba compile the engine a second time.
    """
    for taken in range(n_steps):
        coupled.push(coupling)
        advance_kernel(block, n_groups, scene, acting, first_step + taken, one, trace, traced)


_advance_coupled = compiled(_advance_with_networks, seconds=5)


class Groups:
    """Robots packed into lanes: robot i is lane i mod n_lanes of group i // n_lanes."""

    def __init__(
        self,
        designs: Designs,
        depth: float,
        physics: Physics,
        medium: Medium | MediumWithMemory | None,
        *,
        n_members: int,
        n_lanes: int,
    ) -> None:
        """Spawn n_members robots of each of n_designs designs: robot number member · n_designs + design.

        The ground is at a depth [m]. A medium with a law acts in every step; any other is up to the caller.
        """
        self.n_robots = n_members * len(designs)
        self._n_members = n_members
        self._physics, self._parent = physics, designs.parent
        self._n_links = designs.room
        self.n_lanes = n_lanes
        self.n_groups = -(-self.n_robots // n_lanes)
        self._block = Block(self.n_groups * layout.N_ROWS, n_lanes)
        self._no_trace = Block(1, n_lanes)
        member = self._robot_of_lane.reshape(self.n_groups, n_lanes) // max(len(designs), 1)
        fluid = push_of(medium, physics, _ROWS, self._block, member)
        self.blocks = self._block.rows.reshape(self.n_groups, layout.N_ROWS, n_lanes)
        self._number = packing.pack(designs, physics, n_members, self.blocks)  # the engine's numbers of the links
        design = self._robot_of_lane.reshape(self.n_groups, n_lanes) % max(len(designs), 1)
        motors = motors_of(designs, depth, physics, self._number, design, _SENSORS, self._block)
        self._acting = Acting(motors, fluid)

    @cached_property
    def _robot_of_lane(self) -> Int64:
        """(n_groups · n_lanes,) numbers; lanes left over at the end hold copies of the last robot."""
        return np.minimum(np.arange(self.n_groups * self.n_lanes), self.n_robots - 1)

    @cached_property
    def _places(self) -> Int64:
        """(n_groups · n_lanes, n_links) places of the first quantity in the blocks, links in the designs' order."""
        group, lane = np.divmod(np.arange(self.n_groups * self.n_lanes), self.n_lanes)
        number = self._number_of_link()[self._robot_of_lane]
        return (group[:, None] * layout.N_ROWS + number) * self.n_lanes + lane[:, None]

    def _states(self, *rows: int) -> Float32:
        """Read (n_quantities, n_robots, n_links) quantities by their first rows, links in the designs' order."""
        first = self.n_lanes * np.array(rows)[:, None, None]
        states: Float32 = self.blocks.reshape(-1)[first + self._places[: self.n_robots]]
        return states

    def poses(self) -> Float32:
        """Read (n_robots, n_links, 6) states, links in the designs' order; NaN where diverged."""
        states = self._states(layout.X, layout.Y, layout.ANGLE, layout.VX, layout.VY, layout.OMEGA)
        state = np.ascontiguousarray(np.moveaxis(states, 0, -1))
        state[np.isnan(self.blocks[:, layout.DIVERGENCE].reshape(-1)[: self.n_robots])] = np.nan
        return state

    def motor_work(self) -> Float32:
        """Read (n_robots, n_links) work of the joints' motors since it began to be counted [J]."""
        n_joints = self._n_links - 1
        joints = self.blocks[:, layout.MOTOR_WORK : layout.MOTOR_WORK + n_joints].transpose(0, 2, 1)
        of_links = np.pad(joints.reshape(-1, n_joints)[: self.n_robots], ((0, 0), (1, 0)))  # the root has no joint
        return np.take_along_axis(of_links, self._number_of_link(), axis=1)

    def _number_of_link(self) -> Int64:
        return np.tile(self._number, (self._n_members, 1))

    def advance(self, scene: Scene, first_step: int, n_steps: int, trace: Float32 | None) -> None:
        """Take steps; step 0 orients the links first.

        The states after each step fill ``trace``, (n_robots, n_steps, n_links, 6).
        """
        n_rows = 0 if trace is None else self.n_groups * n_steps * layout.N_TRACED * self._n_links
        states = Block(n_rows, self.n_lanes) if n_rows else self._no_trace
        with np.errstate(all="ignore"):  # without the compiler, lanes are NumPy arrays and would warn
            advance_kernel(
                self._block, self.n_groups, scene, self._acting, first_step, n_steps, states, trace is not None
            )
        if trace is not None and n_rows:
            by_group = states.rows.reshape(self.n_groups, n_steps, 6, self._n_links, self.n_lanes)
            by_robot = by_group.transpose(0, 4, 1, 3, 2).reshape(-1, n_steps, self._n_links, 6)[: self.n_robots]
            trace[:] = np.take_along_axis(by_robot, self._number_of_link()[:, None, :, None], axis=2)

    def advance_with_networks(self, networks: PackedNetworks, scene: Scene, first_step: int, n_steps: int) -> None:
        """Take steps in a medium of one network per member, in a single kernel."""
        coupling = coupled.couple(networks, self.blocks, self.n_robots, self._n_links, _ROWS, scene.fall)
        with np.errstate(all="ignore"):
            _advance_coupled(
                self._block, self.n_groups, scene, self._acting, first_step, n_steps, coupling, self._no_trace, False, 1
            )

    def push(self, medium: Medium) -> None:
        """Add a medium's velocity change to every link, as the reference engine does."""
        states = self._states(*layout.QUANTITIES.values())
        states = states.reshape(len(layout.QUANTITIES), self._n_members, -1, self._n_links)
        links = LinkStates(**dict(zip(layout.QUANTITIES, states, strict=True)), parent=self._parent)
        change = medium.velocity_change(links, self._physics)
        velocities = (links.vx + change.vx, links.vy + change.vy, links.omega + change.omega)
        for row, velocity in zip((layout.VX, layout.VY, layout.OMEGA), velocities, strict=True):
            of_robot = velocity.astype(np.float32).reshape(self.n_robots, self._n_links)
            self.blocks.reshape(-1)[self._places + self.n_lanes * row] = of_robot[self._robot_of_lane]
