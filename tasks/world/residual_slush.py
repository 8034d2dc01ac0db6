"""Residual Slush: Dry Land plus the velocity changes that residual networks predict. Paper, "Residual Physics".

Each arm names the throws that its networks learn from: the paper's, or throws that are designed for robots.
"""

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
        about="Dry Land with an ensemble of small neural networks. They learned the residual, which is the difference "
        "between True Slush and Dry Land, from links thrown into True Slush. Fitness is the mean over the members "
        "minus their disagreement, so that a robot has to do well under all of them.",
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
        about="Dry Land with a single network. Robots can exploit its errors: they evolve to use hallucinated "
        "dynamics.",
        marker="D",
        color="#7d4aa5",
        adapted_color="#cfb6e2",
        dark_color="#b58bdb",
        dark_adapted_color="#573577",
        order=4,
    )
)
register(
    EnvironmentKind(
        name="designed_throws",
        build=ResidualSlush,
        networks="all",
        learns_from="designed_throws",
        label="Designed throws",
        symbol="Ê*",
        evolved="in Residual Slush learned from designed throws",
        about="Residual Slush whose networks learned from throws that are designed for robots: they cover the speeds, "
        "lengths and heights of robots' links evenly, with as many transitions.",
        marker="v",
        color="#b8860b",
        adapted_color="#ead9a0",
        dark_color="#d9b13b",
        dark_adapted_color="#5f4a12",
        order=5,
    )
)
register(
    EnvironmentKind(
        name="designed_single_member",
        build=ResidualSlush,
        networks="one",
        learns_from="designed_throws",
        label="Designed, single",
        symbol="Ê*₁",
        evolved="with a single member learned from designed throws",
        about="Dry Land with a single network that learned from designed throws.",
        marker="d",
        color="#5b6ea8",
        adapted_color="#c3cbe6",
        dark_color="#93a5de",
        dark_adapted_color="#3a4672",
        order=6,
    )
)
