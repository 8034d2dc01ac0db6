"""Media: the velocity change that a medium gives each link in one step.

The change is computed from the state at the start of a step and added before the rigid-body simulator's step. So the
residual of a step is an exact function of the state, and the joints are solved with the new velocities.
"""

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from tasks.arrays import ArrayData, Float64, Floats
from tasks.discovery import located
from tasks.parameters import Parameters
from tasks.world.physics import Physics


@dataclass(frozen=True, eq=False, repr=False)
class LinkStates(ArrayData):
    """States of links at the start of a step; all arrays have the same shape.

    In a rollout that shape is (n_members, n_designs, n_links), with one member for an environment without an ensemble.
    There is no horizontal position: a medium is uniform along x.
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
        ...


class MediumError(ValueError):
    """A medium gave no velocity change; the message begins with its file and line."""


def change_in(medium: Medium, links: LinkStates, physics: Physics) -> VelocityChange:
    """Return a medium's velocity change, in arrays of the links' shape; raise MediumError if it gives none."""
    try:
        change = medium.velocity_change(links, physics)
        if not isinstance(change, VelocityChange):
            raise TypeError(f"velocity_change: expected a VelocityChange, got {type(change).__name__}")
        shape = links.y.shape
        parts = (change.vx, change.vy, change.omega)
        return VelocityChange(*(part if np.shape(part) == shape else np.broadcast_to(part, shape) for part in parts))
    except Exception as error:
        code = getattr(getattr(medium, "law", medium.velocity_change), "__code__", None)
        place = f"{code.co_filename}:{code.co_firstlineno}" if code else type(medium).__name__
        raise MediumError(located(error, type(medium).__module__, place)) from error


class Fluid(Parameters):
    """A medium given by a law, which the batch engine compiles into its kernels; its fields are its settings.

    The law is one text for arrays and for the engine's lanes: operators, ``abs``, the functions of ``tasks.simd.lanes``
    such as ``select`` in place of a branch, and formulas such as ``submerged_part``.
    """

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


class EnsembleMedium(Medium, Protocol):
    """A medium with several members; entry k of the links' first axis is in member k."""

    @property
    def n_members(self) -> int:
        """Number of members, the length of the links' first axis."""
        ...


class Networks(EnsembleMedium, Protocol):
    """An ensemble whose members' mean is a medium."""

    def mean(self) -> Medium:
        """Return the medium whose changes are the mean of the members'."""
        ...
