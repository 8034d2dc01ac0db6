"""Robots of rigid bodies in the batch engine: their records, and the compiled kernel that steps them."""

import numpy as np

from tasks.arrays import Float32
from tasks.compiled import compiled
from tasks.design.body import kinematic_trees, rigid_bodies
from tasks.design.genes import Designs
from tasks.simd.lanes import Block, as_block
from tasks.simulation.box2d import Scene
from tasks.simulation.fluids import Acting, Rows, push_of
from tasks.simulation.fused_links import body_change
from tasks.simulation.motors import Sensors, motors_of
from tasks.simulation.networks import coupled
from tasks.simulation.networks.coupled import Coupling
from tasks.simulation.networks.inference import PackedNetworks
from tasks.simulation.rigid_bodies import step
from tasks.simulation.rigid_bodies.layout import ROBOT, Records
from tasks.simulation.rigid_bodies.packing import body_index, pack
from tasks.simulation.trees.layout import QUANTITIES
from tasks.world.medium import LinkStates, Medium, MediumWithMemory
from tasks.world.physics import Physics

_advance = compiled(step.advance_robots, seconds=12)

# The first link's record as rows of float32, for the networks.
_LINKS, _FIRST_LINK = (ROBOT.fields["links"][0].base, ROBOT.fields["links"][1]) if ROBOT.fields else (ROBOT, 0)
_ROWS = {name: (_FIRST_LINK + offset) // 4 for name, (_, offset, *_) in (_LINKS.fields or {}).items()}
_OF_LINKS = Rows(
    read=tuple(_ROWS[name] for name in QUANTITIES),
    add=tuple(_ROWS[f"change_{name}"] for name in ("vx", "vy", "omega")),
    unkicked=tuple(_ROWS[f"unkicked_{name}"] for name in ("vx", "vy", "omega")),
    stride=_LINKS.itemsize // 4,
)
_SENSORS = Sensors(**{name: _ROWS[name] for name in Sensors._fields[:-2]}, stride=_OF_LINKS.stride, later=1)


def _advance_robots_with_networks(
    robots: Records,
    numbers: Block,
    scene: Scene,
    acting: Acting,
    first_step: int,
    end_step: int,
    coupling: Coupling,
    trace: Float32,
) -> None:
    """Take steps with robots, each in its member's medium; ``trace`` is empty."""
    for number in range(first_step, end_step):
        coupled.push(coupling)
        _advance(robots, numbers, scene, acting, number, number + 1, trace)


_advance_with_networks = compiled(_advance_robots_with_networks, seconds=5)


class Robots:
    """Robots as records: robot number member · n_designs + design."""

    def __init__(
        self,
        designs: Designs,
        depth: float,
        physics: Physics,
        medium: Medium | MediumWithMemory | None,
        *,
        n_members: int,
    ) -> None:
        """Spawn n_members robots of each of n_designs designs over ground at a depth [m].

        A medium with a law acts in every step; any other is up to the caller.
        """
        self._shape = (n_members, len(designs), designs.room)
        self._physics, self._parent = physics, designs.parent
        self._rigid = rigid_bodies(designs, passive_joints=physics.passive_joints)
        trees = kinematic_trees(designs, density=physics.link_density)
        self.records = np.tile(pack(designs, trees, self._rigid, depth, physics), n_members)
        self.n_robots = len(self.records)
        self._numbers = as_block(self.records.view(np.float32).reshape(-1, 1))
        member = np.repeat(np.arange(n_members), len(designs))[:, None]
        fluid = push_of(medium, physics, _OF_LINKS, self._numbers, member)
        number = np.tile(np.arange(designs.room), (len(designs), 1))
        design = np.arange(self.n_robots)[:, None] % max(len(designs), 1)
        motors = motors_of(designs, depth, physics, number, design, _SENSORS, self._numbers)
        self._acting = Acting(motors, fluid)

    def poses(self) -> Float32:
        """Read (n_robots, n_links, 6) states; NaN where diverged."""
        links = self.records["links"][:, : self._shape[2]]
        states: Float32 = np.stack([links[name] for name in ("x", "y", "angle", "vx", "vy", "omega")], axis=-1)
        states[np.isnan(self.records["divergence"])] = np.nan
        return states

    def motor_work(self) -> Float32:
        """Read (n_robots, n_links) work of the joints' motors since it began to be counted [J]."""
        work = np.zeros((self.n_robots, self._shape[2]), np.float32)
        robot, joint = np.nonzero(np.arange(self._shape[2]) < self.records["n_joints"][:, None])
        joints = self.records["joints"][robot, joint]
        work[robot, joints["child"]] = joints["motor_work"]
        return work

    def advance(self, scene: Scene, first_step: int, n_steps: int, trace: Float32 | None) -> None:
        """Take steps; step 0 spawns the robots first.

        The states after each step fill ``trace``, (n_robots, n_steps, n_links, 6).
        """
        states = np.empty((0 if trace is None else self.n_robots, n_steps, self._shape[2], 6), np.float32)
        end = first_step + n_steps
        with np.errstate(all="ignore"):  # without the compiler NumPy would warn
            _advance(self.records, self._numbers, scene, self._acting, first_step, end, states)
        if trace is not None:
            trace[:] = states

    def advance_with_networks(self, networks: PackedNetworks, scene: Scene, first_step: int, n_steps: int) -> None:
        """Take steps without a trace in a medium that is a network for each member, all in one kernel."""
        rows = self._numbers.rows.reshape(self.n_robots, -1, 1)
        coupling = coupled.couple(networks, rows, self.n_robots, self._shape[2], _OF_LINKS, scene.fall)
        no_trace = np.empty((0, 0, self._shape[2], 6), np.float32)
        with np.errstate(all="ignore"):
            _advance_with_networks(
                self.records, self._numbers, scene, self._acting, first_step, first_step + n_steps, coupling, no_trace
            )

    def push(self, medium: Medium) -> None:
        """Let a medium act on every link, and the links on their bodies, as the reference engine does."""
        links = self.records["links"][:, : self._shape[2]].reshape(self._shape)
        of_links = {name: np.ascontiguousarray(links[name]) for name in QUANTITIES}
        change = medium.velocity_change(LinkStates(**of_links, parent=self._parent), self._physics)
        of_body = body_change(self._rigid, links["lever_x"], links["lever_y"], change)
        bodies = self.records["bodies"].reshape(*self._shape[:2], self.records["bodies"].shape[1])
        design, link = np.nonzero(self._rigid.is_first)
        where = (slice(None), design, body_index(self._rigid)[design, link])
        for name, added in (("v_x", of_body.vx), ("v_y", of_body.vy), ("w", of_body.omega)):
            with np.errstate(invalid="ignore"):  # of robots that have diverged
                bodies[name][where] = (bodies[name][where] + added[:, design, link]).astype(np.float32)
