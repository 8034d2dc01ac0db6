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
        about="The simulator without a medium: the same ground, surrounded by air.",
        order=2,
    )
)
