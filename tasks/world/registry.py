"""The registry of environments: names, media, settings groups and how each is drawn.

To add a medium, write one file in ``tasks/world``, as docs/extending.md shows; the package imports every module that it
contains. Learners are not registered: each study has its own (:mod:`tasks.residual.learner`).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, TypeAlias

from tasks import discovery
from tasks.parameters import Parameters
from tasks.world.environment import Environment, Pool


@dataclass(frozen=True, kw_only=True)
class ArmKind:
    """What designs of an arm evolve in, as readers see it: an environment with a medium, or a learner."""

    name: str  # name in settings, tables and files, such as ``true_slush``
    label: str
    symbol: str  # symbol in the paper
    evolved: str  # phrase that completes "evolved ..."
    about: str = ""  # what it is, in a few sentences, for a page; empty if its label says it
    order: int = 100  # place in every listing; ties are listed by name
    learned: bool = False  # whether it consists of trained networks


@dataclass(frozen=True, kw_only=True)
class EnvironmentKind(ArmKind):
    """An environment that is registered: dry land, or a medium with its settings."""

    build: type[Environment]  # called with the depth [m] and the medium, if it has one
    settings_group: str | None = None  # group of settings that states the medium's parameters
    settings: type[Parameters] | None = None  # class of these settings, which is also the medium
    for_study: Callable[[Any, int], Any] = lambda settings, seed: settings  # these settings in a study with a seed

    @property
    def is_ensemble(self) -> bool:
        """Whether rollouts have an axis of members."""
        return self.build.is_ensemble

    @property
    def has_one_medium(self) -> bool:
        """Whether it has a medium that networks can learn and champions can be transferred to."""
        return not self.is_ensemble and self.build.medium is not Environment.medium

    @property
    def engine(self) -> str:
        """Name of the engine that its fluid is a part of, "" if any engine simulates it."""
        return getattr(self.settings, "engine", "")

    def environment(self, depth: float, settings: Any = None) -> Environment:
        """Return the environment at a depth of the ground below the surface [m].

        Args:
            depth: of the ground below the surface [m].
            settings: its medium's, as a model or a dictionary; by default those of the class.
        """
        build: Callable[..., Environment] = self.build
        if self.settings is None:
            return build(depth)
        return build(depth, self.settings.model_validate({} if settings is None else settings))


_registered: dict[str, EnvironmentKind] = {}

ENVIRONMENTS: Mapping[str, EnvironmentKind] = MappingProxyType(_registered)
"""Every environment by name, in the order of listings. Complete once ``tasks.world`` is imported."""


def register(kind: EnvironmentKind) -> None:
    """Add an environment; raise ValueError if the name is taken."""
    discovery.register(_registered, "environment", kind.name, kind)
    kinds = sorted(_registered.values(), key=lambda kind: (kind.order, kind.name))
    _registered.clear()
    _registered.update({kind.name: kind for kind in kinds})


def register_medium(name: str, medium: type[Parameters], label: str, *, symbol: str = "", about: str = "") -> None:
    """Add the environment of one medium, whose settings are a group with its name.

    Args:
        name: name in settings, tables and files.
        medium: class of the medium, whose fields are its settings.
        label: name for readers.
        symbol: symbol in tables; by default the first letter of the label.
        about: what it is, in a sentence, for a page.

    Raises:
        ValueError: the name is taken, or a field of the medium has no default or one that it refuses.
    """
    medium()
    register(
        EnvironmentKind(
            name=name,
            build=Pool,
            settings_group=name,
            settings=medium,
            label=label,
            symbol=symbol or label[0],
            evolved=f"in {label}",
            about=about,
        )
    )


def settings_groups() -> dict[str, type[Parameters]]:
    """List the settings groups of all media: name to class."""
    return {
        kind.settings_group: kind.settings for kind in ENVIRONMENTS.values() if kind.settings_group and kind.settings
    }


EnvironmentName: TypeAlias = str  # name of a registered environment, or of a learner of the study
