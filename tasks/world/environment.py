"""Environments: a depth and a medium over one base simulator. Paper, "Simulation Environments".

They differ in the medium alone. To add one: write its file beside slush.py, and give it an environment here; the README
says where the pipeline has to know its name. Lanes in tasks/simulation/trees/step.py make it faster, and are not needed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from numbers import Real
from typing import Literal

from tasks.world.medium import EnsembleMedium, Medium
from tasks.world.slush import Slush

EnvironmentName = Literal["true_slush", "dry_land", "residual_slush", "single_member"]
"""Where a trial evolves: E, E', Ê with the whole ensemble, Ê with one member of it."""


def _check_depth(depth: float) -> None:
    if isinstance(depth, bool) or not isinstance(depth, Real) or not math.isfinite(depth) or depth < 0:
        raise ValueError(f"depth is {depth!r}, expected a finite number of metres, 0 or more")


@dataclass(frozen=True)
class DryLand:
    """E': rigid links over hard ground at y = -depth [m], and nothing else."""

    depth: float

    def __post_init__(self) -> None:
        _check_depth(self.depth)

    @property
    def medium(self) -> None:
        """Nothing surrounds the links."""
        return None


@dataclass(frozen=True)
class TrueSlush:
    """E: dry land whose region below y = 0 is filled with slush; the world that designs are made for."""

    depth: float
    slush: Slush = field(default_factory=Slush)

    def __post_init__(self) -> None:
        _check_depth(self.depth)

    @property
    def medium(self) -> Medium:
        """The slush."""
        return self.slush


@dataclass(frozen=True)
class ResidualSlush:
    """Ê: dry land and what an ensemble of residual networks learned of the slush, one world per member."""

    depth: float
    ensemble: EnsembleMedium

    def __post_init__(self) -> None:
        _check_depth(self.depth)

    @property
    def medium(self) -> EnsembleMedium:
        """The ensemble."""
        return self.ensemble


Environment = DryLand | TrueSlush | ResidualSlush
