"""A fluid: incompressible, two-dimensional, with a free surface, around all links of a robot together.

It is solved on a grid (:mod:`tasks.fluid`), and remembers: a link meets the wakes and waves of the others and its own.
Nobody wrote it as a function of a link's state, so it is a target that networks can't contain.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
from pydantic import Field

from tasks.fluid import Flume
from tasks.parameters import Parameters
from tasks.world.medium import LinkStates, Scene, VelocityChange
from tasks.world.physics import Physics
from tasks.world.registry import register_medium

_LEAST_CELLS = 1.25  # that a link is wide, or the fluid leaks through it
_PARTICLES = 0.5  # distance of the particles that films show [m]


class FluidFlume(Parameters):
    """A fluid in a flume that closes upon itself along x: each robot, and each thrown bar, has one of its own."""

    density: float = Field(default=1.25, gt=0.0, le=1e4)
    """ρ [kg/m²]; the slush's."""
    spacing: float = Field(default=0.125, ge=0.02, le=0.25)
    """Edge of a cell of the grid [m]; a link, at least 0.33 m wide, must be 1.25 cells wide, or water leaks through
    it. Half of it takes five times as long."""
    length: float = Field(default=24.0, ge=4.0, le=1000.0)
    """Length of a robot's flume [m]. A robot that goes further than that meets its own wake."""
    bar_length: float = Field(default=12.0, ge=4.0, le=1000.0)
    """Length of a thrown bar's flume [m]."""
    bar_depth: float = Field(default=9.0, ge=1.0, le=100.0)
    """Depth of a thrown bar's flume [m]; the bar falls through its floor."""

    def seconds_per_step(self, depth: float) -> float:
        """Approximate time that a core takes for a step, for forecasts [s]."""
        area = self.bar_length * self.bar_depth if math.isinf(depth) else self.length * depth
        return 3e-3 * math.pow(0.125 / self.spacing, 2.5) * area / 96

    def start(self, links: LinkStates, physics: Physics, depth: float) -> Flumes:
        """Return still water around designs."""
        return Flumes(self, links, physics, depth)

    def scenes(self, states: Sequence[LinkStates], physics: Physics, depth: float) -> Iterator[Scene]:
        """Return the surface and particles of the water after each step around the links of one design."""
        water = self.start(states[0], physics, depth)
        for flume in water.flumes.values():  # none on dry land
            particles = flume.places(every=_PARTICLES)
            for links in states:
                water.velocity_change(links, physics)
                particles = flume.carried(particles)
                yield Scene(flume.surface, particles, flume.length)


class Flumes:
    """A flume for each member and design."""

    def __init__(self, fluid: FluidFlume, links: LinkStates, physics: Physics, depth: float) -> None:
        thrown = math.isinf(depth)
        is_dry = depth < fluid.spacing / 2
        width, least = float(np.min([links.length_scale, 1 / links.length_scale])), _LEAST_CELLS * fluid.spacing
        if width < least and not is_dry:
            raise ValueError(f"fluid.spacing: expected links at least {least:.2f} m wide, got {width:.2f} m")
        self.flumes = (
            {}
            if is_dry
            else {
                world: Flume(
                    *(of[world].astype(np.float64) for of in (links.length_scale, links.mass, links.inertia)),
                    length=fluid.bar_length if thrown else fluid.length,
                    depth=fluid.bar_depth if thrown else depth,
                    spacing=fluid.spacing,
                    density=fluid.density,
                    gravity=physics.gravity,
                    time_step=physics.time_step,
                )
                for world in np.ndindex(links.y.shape[:-1])
            }
        )

    def velocity_change(self, links: LinkStates, physics: Physics) -> VelocityChange:  # noqa: ARG002 (that of the start)
        """Take a step in every flume but those of diverged robots; where the water has diverged, changes are NaN."""
        angle = np.arctan2(links.sin, links.cos)
        states = np.stack((links.x, links.y, angle, links.vx, links.vy, links.omega), axis=-2).astype(np.float64)
        changes = np.zeros((3, *links.y.shape), links.y.dtype)
        for world, flume in self.flumes.items():
            if np.isfinite(states[world]).all():
                change = flume.step(*states[world])
                changes[(slice(None), *world)] = change if np.isfinite(flume.water.rise).all() else np.nan
        return VelocityChange(*changes)


register_medium(
    "fluid", FluidFlume, "Fluid", symbol="E_f", about="A fluid with waves and wakes, solved on a grid around all links."
)
