"""Environments: a depth and a medium around the same rigid-body simulator. Paper, "Simulation Environments"."""

from __future__ import annotations

import math
from dataclasses import dataclass
from numbers import Real
from typing import ClassVar

from tasks.world.medium import Medium, MediumWithMemory


@dataclass(frozen=True)
class Environment:
    """Rigid links over hard ground, in a medium."""

    is_ensemble: ClassVar[bool] = False  # whether rollouts have an axis of ensemble members, even of a single one

    depth: float  # depth of the ground: it lies at y = -depth [m]

    def __post_init__(self) -> None:
        depth = self.depth
        if isinstance(depth, bool) or not isinstance(depth, Real) or not math.isfinite(depth) or depth < 0:
            raise ValueError(f"depth is {depth!r}, expected a finite number of metres, at least 0")

    @property
    def medium(self) -> Medium | MediumWithMemory | None:
        """Medium around the links, or None."""
        return None

    @property
    def n_members(self) -> int:
        """Number of ensemble members, 1 without an ensemble."""
        return getattr(self.medium, "n_members", 1) if self.is_ensemble else 1


@dataclass(frozen=True)
class Pool(Environment):
    """Rigid links over hard ground, in a given medium: one that a study registers, or one of your own."""

    fluid: Medium | MediumWithMemory

    @property
    def medium(self) -> Medium | MediumWithMemory:
        """The fluid."""
        return self.fluid
