"""What a robot lives in: a depth, and a medium that pushes on its links."""

from tasks.world.environment import DryLand, Environment, ResidualSlush, TrueSlush
from tasks.world.medium import EnsembleMedium, LinkStates, Medium, VelocityChange
from tasks.world.physics import Physics, froude_time
from tasks.world.slush import Slush

__all__ = [
    "DryLand",
    "EnsembleMedium",
    "Environment",
    "LinkStates",
    "Medium",
    "Physics",
    "ResidualSlush",
    "Slush",
    "TrueSlush",
    "VelocityChange",
    "froude_time",
]
