"""A medium: what surrounds the links, as the velocity change that it gives each of them in one step.

The change is computed from the state at the start of a step and added before the base simulator's own step. So the
residual of a step is an exact function of the state, and the joints are solved with the new velocities.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from tasks.arrays import Floats
from tasks.world.physics import Physics


@dataclass(frozen=True, eq=False)
class LinkStates:
    """Links and their state at the start of a step; every array has the same shape.

    In a rollout that shape is (n_members, n_designs, n_links), where worlds without an ensemble have one member.
    The horizontal position is left out: a medium is the same everywhere along x.
    """

    length_scale: Floats
    """Long axis [m]; the short axis is its reciprocal."""
    mass: Floats
    """[kg]"""
    inertia: Floats
    """About the centre of mass [kg·m²]."""
    y: Floats
    """Height of the centre of mass over the medium's surface [m]."""
    cos: Floats
    """Cosine of the angle between the long axis and the vertical."""
    sin: Floats
    """Sine of the same angle."""
    vx: Floats
    """[m/s]"""
    vy: Floats
    """[m/s]"""
    omega: Floats
    """[rad/s]"""


@dataclass(frozen=True, eq=False)
class VelocityChange:
    """What a medium adds to a link's velocities in one step; arrays of the links' shape."""

    vx: Floats
    """[m/s]"""
    vy: Floats
    """[m/s]"""
    omega: Floats
    """[rad/s]"""


class Medium(Protocol):
    """Anything that changes the velocities of links."""

    def velocity_change(self, links: LinkStates, physics: Physics) -> VelocityChange:
        """Return the change over one step of ``physics.time_step``, in the arrays' own precision."""
        ...


class EnsembleMedium(Medium, Protocol):
    """A medium with several versions of itself: entry k of the links' first axis lives in version k."""

    @property
    def n_members(self) -> int:
        """How many versions there are: the length of the links' first axis."""
        ...
