"""Environments of a robot: a depth, and a medium that pushes on its links.

Each medium is one file, which registers its environment; see :mod:`tasks.world.registry`.
"""

from tasks.discovery import import_extensions
from tasks.world.dry_land import DryLand
from tasks.world.environment import Environment, Pool
from tasks.world.medium import EnsembleMedium, Fluid, LinkStates, Medium, MediumWithMemory, VelocityChange
from tasks.world.physics import Physics, froude_time
from tasks.world.randomised_slush import RandomisedSlush, RandomisedSlushes
from tasks.world.registry import ENVIRONMENTS, EnvironmentName
from tasks.world.residual_slush import MeanResidual, ResidualSlush, as_environment
from tasks.world.slush import Slush, TrueSlush

import_extensions(__name__, __path__)
