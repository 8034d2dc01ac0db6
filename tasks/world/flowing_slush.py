"""Flowing slush: the slush with a steady current along x, so that drag acts on the velocity relative to the flow.

A fluid to test the learner with, which knows nothing of currents. It carries along what does not swim.
"""

from pydantic import Field

from tasks.simd.lanes import Numeric
from tasks.world.medium import LinkStates
from tasks.world.physics import Physics
from tasks.world.registry import register_medium
from tasks.world.slush import Slush, slush_change


class FlowingSlush(Slush):
    """The slush in a current."""

    current: float = Field(default=0.5, ge=-10.0, le=10.0)
    """Velocity of the flow along x [m/s]."""

    def factors(self, physics: Physics) -> tuple[float, ...]:
        """Return the slush's factors, and the current."""
        return *super().factors(physics), self.current

    @staticmethod
    def law(factors: Numeric, links: LinkStates) -> tuple[Numeric, Numeric, Numeric]:
        """Return the slush's changes for velocities relative to the flow; adding the flow back changes none."""
        return slush_change(factors, links, links.vx - factors[4])


register_medium("flowing_slush", FlowingSlush, "Flowing Slush", symbol="E⃗", about="Slush that flows steadily along x.")
