"""Residual Slush: Dry Land plus the velocity changes that residual networks predict. Paper, "Residual Physics"."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

from tasks.discovery import with_failures
from tasks.world.environment import Environment, Pool
from tasks.world.medium import EnsembleMedium, Medium, Networks
from tasks.world.registry import ENVIRONMENTS

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


@dataclass(frozen=True)
class MeanResidual(Environment):
    """Dry Land and the mean of residual networks, one medium."""

    ensemble: Networks

    @cached_property
    def medium(self) -> Medium:
        """Mean of the ensemble."""
        return self.ensemble.mean()


def at_time_step(environment: Environment, time_step: float) -> Environment:
    """Return an environment for time steps of a length [s]: itself, unless its networks learned of another length."""
    if not isinstance(environment, ResidualSlush | MeanResidual):
        return environment
    follow = getattr(environment.ensemble, "at_time_step", None)  # a user's own ensemble has none
    ensemble: Any = follow(time_step) if follow else environment.ensemble
    return environment if ensemble is environment.ensemble else replace(environment, ensemble=ensemble)


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
        if given not in ENVIRONMENTS:
            known = f"{', '.join(ENVIRONMENTS)}, or ResidualSlush(depth, ensemble) for networks"
            raise ValueError(with_failures(f"environment: expected one of {known}, got {given!r}"))
        kind = ENVIRONMENTS[given]
        return kind.environment(depth, kind.for_study(kind.settings(), 1) if kind.settings else None)
    if isinstance(given, type) or not (hasattr(given, "velocity_change") or hasattr(given, "start")):
        raise TypeError(f"environment: expected one, such as TrueSlush(depth=9.0), a medium or a name, got {given!r}")
    return ResidualSlush(depth, given) if hasattr(given, "n_members") else Pool(depth, given)  # type: ignore[arg-type]
