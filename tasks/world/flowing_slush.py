"""Flowing slush: the slush with a steady current along x, so that drag acts on the velocity relative to the flow.

A fluid to test the learner with, which knows nothing of currents. It carries along what does not swim.
"""

from dataclasses import replace

from pydantic import Field

from tasks.world.medium import LinkStates, VelocityChange
from tasks.world.physics import Physics
from tasks.world.registry import register_medium
from tasks.world.slush import Slush


class FlowingSlush(Slush):
    """The slush in a current."""

    current: float = Field(default=0.5, ge=-10.0, le=10.0)
    """Velocity of the flow along x [m/s]."""

    def velocity_change(self, links: LinkStates, physics: Physics) -> VelocityChange:
        """Return the slush's change for velocities relative to the flow; adding the flow back changes none."""
        return super().velocity_change(replace(links, vx=links.vx - self.current), physics)


register_medium("flowing_slush", FlowingSlush, "Flowing Slush", symbol="E⃗", about="Slush that flows steadily along x.")
