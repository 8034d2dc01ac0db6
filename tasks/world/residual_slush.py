"""Residual Slush: Dry Land plus the velocity changes that residual networks predict. Paper, "Residual Physics".

The arms of the paper and of throws that are designed for robots are registered, so that they have names of their own
for readers. A study's own learners are called by their names.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

from tasks.discovery import FAILURES
from tasks.world.environment import Environment, Pool
from tasks.world.medium import EnsembleMedium, Medium, Networks
from tasks.world.registry import ENVIRONMENTS, EnvironmentKind, register

_PAPERS_DEPTH = 9.0  # of the ground below the surface, where the paper compares environments [m]


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


@dataclass(frozen=True)
class TankModel(Environment):
    """Dry Land and the mean of residual networks that learned from tracked throws."""

    ensemble: Networks

    @cached_property
    def medium(self) -> Medium:
        """Mean of the ensemble."""
        return self.ensemble.mean()


register(
    EnvironmentKind(
        name="residual_slush",
        build=ResidualSlush,
        learned=True,
        label="Residual Slush",
        symbol="Ê",
        evolved="in Residual Slush",
        about="Dry Land with an ensemble of small neural networks. They learned the residual, which is the difference "
        "between the target and Dry Land, from links thrown into the target. Fitness is the mean over the members "
        "minus their disagreement, so that a robot has to do well under all of them.",
        order=3,
    )
)
register(
    EnvironmentKind(
        name="single_member",
        build=ResidualSlush,
        learned=True,
        label="Single member",
        symbol="Ê₁",
        evolved="with a single member",
        about="Dry Land with a single network. Robots can exploit its errors: they evolve to use hallucinated "
        "dynamics.",
        order=4,
    )
)
register(
    EnvironmentKind(
        name="designed_throws",
        build=ResidualSlush,
        learned=True,
        label="Designed throws",
        symbol="Ê*",
        evolved="in Residual Slush learned from designed throws",
        about="Residual Slush whose networks learned from throws that are designed for robots: they cover the speeds, "
        "lengths and heights of robots' links evenly, with as many transitions.",
        order=5,
    )
)
register(
    EnvironmentKind(
        name="designed_single_member",
        build=ResidualSlush,
        learned=True,
        label="Designed, single",
        symbol="Ê*₁",
        evolved="with a single member learned from designed throws",
        about="Dry Land with a single network that learned from designed throws.",
        order=6,
    )
)


TANK_MODEL = EnvironmentKind(
    name="tank_model",
    build=TankModel,
    learned=True,
    label="the model of your tank",
    symbol="T",
    evolved="in the model of your tank",
    order=0,
)
"""The target of a study that learned from tracked throws and has no other: the mean of the networks. No arm is it."""


def environment_kind(name: str) -> EnvironmentKind:
    """Return a registered environment or the model of a tank; any other name is that of a study's own learner."""
    return {**ENVIRONMENTS, TANK_MODEL.name: TANK_MODEL}.get(name) or EnvironmentKind(
        name=name,
        build=ResidualSlush,
        learned=True,
        label=name.replace("_", " ").capitalize(),
        symbol="Ê",
        evolved=f"with the networks of {name.replace('_', ' ')}",
        about="Residual Slush as this learner of the study knows it; the settings say what it learned from.",
        order=6,
    )


def as_environment(given: Environment | Medium | str, depth: float | None = None) -> Environment:
    """Return an environment: itself, the one of a name with default settings, or a pool of a medium.

    Args:
        given: an environment, a medium such as one that is written in a notebook, or a name such as ``flowing_slush``.
        depth: depth of the ground below the surface [m], by default the paper's 9; an environment has its own.

    Raises:
        ValueError: the name is unknown or needs trained networks, or an environment has another depth.
        TypeError: it is none of these.
    """
    if isinstance(given, Environment):
        if depth not in (None, given.depth):
            raise ValueError(f"depth is {depth!r}, but the environment has its own: expected None or {given.depth:g}")
        return given
    depth = _PAPERS_DEPTH if depth is None else depth
    if isinstance(given, str):
        media = {name: kind for name, kind in ENVIRONMENTS.items() if not kind.learned}
        if given not in media:
            said = f"expected one of {', '.join(media)}, or ResidualSlush(depth, ensemble) for networks, got {given!r}"
            raise ValueError("; ".join([f"environment: {said}", *FAILURES]))
        kind = media[given]
        settings = kind.for_study(kind.settings(), 1) if kind.settings else None
        return kind.environment(depth, {str(kind.settings_group): settings})
    if isinstance(given, type) or not hasattr(given, "velocity_change"):
        raise TypeError(f"environment: expected one, such as TrueSlush(depth=9.0), a medium or a name, got {given!r}")
    return ResidualSlush(depth, given) if hasattr(given, "n_members") else Pool(depth, given)  # type: ignore[arg-type]


def in_order(environments: Iterable[str], first: str = "") -> list[str]:
    """Return names of environments in the order of listings, each once; the target comes first if it is given."""
    return sorted(set(environments), key=lambda name: (name != first, environment_kind(name).order, name))
