"""Dry Land: the rigid-body simulator without a medium."""

from tasks.world.environment import Environment
from tasks.world.registry import EnvironmentKind, register


class DryLand(Environment):
    """E': rigid links over hard ground."""


register(
    EnvironmentKind(
        name="dry_land",
        build=DryLand,
        label="Dry Land",
        symbol="E′",
        evolved="on Dry Land",
        about="The simulator without slush: the same ground, surrounded by air.",
        marker="s",
        color="#1d6b3c",
        adapted_color="#9ed3a9",
        dark_color="#4fae73",
        dark_adapted_color="#26583a",
        order=2,
    )
)
