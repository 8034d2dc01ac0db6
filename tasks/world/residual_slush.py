"""Residual Slush: Dry Land plus the velocity changes that residual networks predict. Paper, "Residual Physics"."""

from dataclasses import dataclass
from typing import ClassVar

from tasks.world.environment import Environment
from tasks.world.medium import EnsembleMedium
from tasks.world.registry import EnvironmentKind, register


@dataclass(frozen=True)
class ResidualSlush(Environment):
    """Ê: Dry Land and an ensemble of residual networks; each member is a medium of its own."""

    is_ensemble: ClassVar[bool] = True

    ensemble: EnsembleMedium

    @property
    def medium(self) -> EnsembleMedium:
        """Ensemble."""
        return self.ensemble

    @property
    def n_members(self) -> int:
        """Number of ensemble members."""
        return self.ensemble.n_members


register(
    EnvironmentKind(
        name="residual_slush",
        build=ResidualSlush,
        networks="all",
        label="Residual Slush",
        symbol="Ê",
        evolved="in Residual Slush",
        marker="^",
        color="#dd7700",
        adapted_color="#fbcb8f",
        dark_color="#f39a37",
        dark_adapted_color="#7c4a12",
        order=3,
    )
)
register(
    EnvironmentKind(
        name="single_member",
        build=ResidualSlush,
        networks="one",
        label="Single member",
        symbol="Ê₁",
        evolved="with a single member",
        marker="D",
        color="#7d4aa5",
        adapted_color="#cfb6e2",
        dark_color="#b58bdb",
        dark_adapted_color="#573577",
        order=4,
    )
)
