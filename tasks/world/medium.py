"""Media: the velocity change that a medium gives each link in one step.

The change is computed from the state at the start of a step and added before the rigid-body simulator's step. So the
residual of a step is an exact function of the state, and the joints are solved with the new velocities.

A medium with memory, such as a fluid that moves with the links, has a method ``start``, which makes one for a rollout.
"""

from abc import abstractmethod
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from tasks.arrays import ArrayData, Float64, Floats
from tasks.discovery import located
from tasks.parameters import Parameters
from tasks.world.physics import Physics

_ZERO = partial(np.zeros, (), np.float32)


@dataclass(frozen=True, eq=False, repr=False)
class LinkStates(ArrayData):
    """States of links at the start of a step; all arrays have the same shape.

    In a rollout that shape is (n_members, n_designs, n_links), with one member for an environment without an ensemble.
    Every design is alone in its world, and its links are in its own order. Thrown bars are designs of one link. Fields
    with a default may be given as a number for all links.
    """

    length_scale: Floats  # long axis [m]; the short axis is its reciprocal
    mass: Floats  # [kg]
    inertia: Floats  # moment of inertia about the centre of mass [kg·m²]
    y: Floats  # height of the centre of mass over the medium's surface [m]
    cos: Floats  # cosine of the angle between the long axis and the vertical
    sin: Floats  # sine of the same angle
    vx: Floats  # [m/s]
    vy: Floats  # [m/s]
    omega: Floats  # [rad/s]
    x: Floats = field(default_factory=_ZERO)  # horizontal position of the centre of mass [m]
    kick_vx: Floats = field(default_factory=_ZERO)
    """What the engine, other than gravity, changed of vx since the medium was last asked [m/s]: joints, motors and
    contacts. It is 0 in the first step, and wherever no rollout precedes."""
    kick_vy: Floats = field(default_factory=_ZERO)  # the same of vy [m/s]
    kick_omega: Floats = field(default_factory=_ZERO)  # the same of omega [rad/s]
    parent: npt.NDArray[Any] = field(default_factory=partial(np.full, (), -1))  # number of the parent; -1: none

    def __post_init__(self) -> None:
        for name in ("x", "kick_vx", "kick_vy", "kick_omega", "parent"):
            if np.shape(getattr(self, name)) != np.shape(self.y):
                object.__setattr__(self, name, np.broadcast_to(getattr(self, name), np.shape(self.y)))


@dataclass(frozen=True, eq=False, repr=False)
class VelocityChange(ArrayData):
    """Change of links' velocities in one step; arrays of the links' shape."""

    vx: Floats  # [m/s]
    vy: Floats  # [m/s]
    omega: Floats  # [rad/s]


class Medium(Protocol):
    """Anything that changes the velocities of links."""

    def velocity_change(self, links: LinkStates, physics: Physics) -> VelocityChange:
        """Return the change over one step of ``physics.time_step``, in the precision of the arrays."""


class MediumWithMemory(Protocol):
    """What makes media that remember, one for each rollout."""

    def start(self, links: LinkStates, physics: Physics, depth: float) -> Medium:
        """Return the medium of a rollout that begins with these links, over ground at a depth [m]; inf for throws.

        It is asked once in every step. What it remembers of a design must not depend on the others.
        """


class Scene(NamedTuple):
    """What films show of a medium at a time; it repeats itself along x."""

    surface: Float64  # (n_points, 2) x, y [m], along x
    particles: Float64  # (n_particles, 2) x, y of what goes with the medium [m]
    period: float  # [m]


class MediumError(ValueError):
    """A medium gave no velocity change; the message begins with its file and line."""


def change_in(medium: Medium, links: LinkStates, physics: Physics) -> VelocityChange:
    """Return a medium's velocity change, in arrays of the links' shape; raise MediumError if it gives none."""
    try:
        change = medium.velocity_change(links, physics)
        if not isinstance(change, VelocityChange):
            raise TypeError(f"velocity_change: expected a VelocityChange, got {type(change).__name__}")
        return VelocityChange(*(_of_links(name, part, links.y.shape) for name, part in vars(change).items()))
    except MediumError:
        raise
    except Exception as error:
        raise _failed(medium, getattr(medium, "law", getattr(medium, "velocity_change", None)), error) from error


def _of_links(name: str, part: Any, shape: tuple[int, ...]) -> Floats:
    part = np.asarray(part)
    if part.dtype.kind not in "fiub" or part.shape not in ((), shape):
        got = f"an array of {part.dtype} and shape {part.shape}"
        raise TypeError(f"{name}: expected a number, or an array of numbers of the links' shape {shape}, got {got}")
    return part if part.shape == shape else np.broadcast_to(part, shape)


def _failed(medium: Any, method: Any, error: Exception) -> MediumError:
    code = getattr(method, "__code__", None)
    place = f"{code.co_filename}:{code.co_firstlineno}" if code else type(medium).__name__
    return MediumError(located(error, type(medium).__module__, place))


class MediumInRollout:
    """A medium in one rollout: its memory, if it has one, and what the links' kicks are measured from."""

    def __init__(self, medium: Medium | MediumWithMemory, depth: float) -> None:
        """Prepare a rollout over ground at a depth [m]."""
        self.medium, self._depth = medium, depth
        self._unkicked: tuple[Floats, ...] | None = None  # velocities now, had only the medium and gravity acted

    def velocity_change(self, links: LinkStates, physics: Physics) -> VelocityChange:
        """Return the change of links without kicks, which it measures, over one step.

        Raises:
            MediumError: the medium gives no change or, in the first step, one that is not finite or not the same twice.
        """
        with np.errstate(invalid="ignore", over="ignore"):  # of rollouts that have diverged
            if self._unkicked is None:
                change = self._first(links, physics)
            else:
                vx, vy, omega = self._unkicked
                kick_vx, kick_vy, kick_omega = links.vx - vx, links.vy - vy, links.omega - omega
                kicked = replace(links, kick_vx=kick_vx, kick_vy=kick_vy, kick_omega=kick_omega)
                change = change_in(self._started, kicked, physics)
            fall = np.float32(physics.time_step) * np.float32(-physics.gravity)
            vx, vy, omega = (
                (velocity + changed).astype(velocity.dtype)
                for velocity, changed in ((links.vx, change.vx), (links.vy, change.vy), (links.omega, change.omega))
            )
            self._unkicked = vx, vy + fall, omega
        return change

    def _first(self, links: LinkStates, physics: Physics) -> VelocityChange:
        self._started, twin = self._start(links, physics), self._start(links, physics)
        change, again = change_in(self._started, links, physics), change_in(twin, links, physics)
        moving = np.isfinite(links.y + links.vx + links.vy + links.omega)
        said = ""
        for name, part in vars(change).items():
            if not np.isfinite(part[moving]).all():
                said = f"{name}: expected finite numbers in the first step, got nan or inf"
            elif not np.array_equal(part, getattr(again, name), equal_nan=True):
                said = f"{name}: expected the same change when asked twice; what a medium remembers is made by start"
        if said:
            raise _failed(twin, getattr(twin, "law", twin.velocity_change), ValueError(said))
        return change

    def _start(self, links: LinkStates, physics: Physics) -> Medium:
        start = getattr(self.medium, "start", None)
        if start is None:
            return self.medium  # type: ignore[return-value]
        try:
            started: Medium = start(links, physics, self._depth)
            if not hasattr(started, "velocity_change"):
                raise TypeError(f"start: expected a medium with velocity_change, got {type(started).__name__}")
            return started
        except Exception as error:
            raise _failed(self.medium, start, error) from error


class Fluid(Parameters):
    """A medium given by a law, which the batch engine compiles into its kernels; its fields are its settings.

    The law is one text for arrays and for the engine's lanes: operators, ``abs``, the functions of ``tasks.simd.lanes``
    such as ``select`` in place of a branch, and formulas such as ``submerged_part``. It can't read a link's parent.
    """

    reads_kicks: ClassVar[bool] = False  # whether the law reads kicks, which the engine then measures

    @staticmethod
    @abstractmethod
    def law(factors: Any, links: LinkStates) -> tuple[Any, Any, Any]:
        """Return the changes of vx, vy [m/s] and ω [rad/s] in a step, by the factors and links."""

    @abstractmethod
    def factors(self, physics: Physics) -> tuple[float | Float64, ...]:
        """Return what the law needs of the fields and the physics: numbers, or (n_members,) arrays of an ensemble."""

    def velocity_change(self, links: LinkStates, physics: Physics) -> VelocityChange:
        """Return the change over one step by the law."""
        factors = (np.asarray(factor, links.y.dtype) for factor in self.factors(physics))
        return VelocityChange(*self.law([of[:, None, None] if of.ndim else of for of in factors], links))


class NativeFluid(Parameters):
    """A fluid that an engine has in its own solver, so that no other engine simulates it; its fields are settings."""

    engine: ClassVar[str]  # name of the engine

    def velocity_change(self, links: LinkStates, physics: Physics) -> VelocityChange:  # noqa: ARG002
        """Refuse: what it changes in a step is not a function of links one by one."""
        raise TypeError(f"{type(self).__name__} acts in the engine {self.engine} alone: expected that engine")


class EnsembleMedium(Medium, Protocol):
    """A medium with several members; entry k of the links' first axis is in member k."""

    @property
    def n_members(self) -> int:
        """Number of members, the length of the links' first axis."""


class Networks(EnsembleMedium, Protocol):
    """An ensemble whose members' mean is a medium."""

    def mean(self) -> Medium:
        """Return the medium whose changes are the mean of the members'."""
