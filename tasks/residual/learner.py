"""Learners: the arms of a study whose robots evolve in networks, and what these networks learn from.

A study names its learners in the settings group ``learners``. Those of the paper, and of throws that are designed for
robots, are built in.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, TypeVar

from pydantic import Field, model_serializer

from tasks.parameters import Parameters
from tasks.residual.hyperparameters import Architecture, Training
from tasks.residual.throws import Throws
from tasks.world.registry import EnvironmentKind
from tasks.world.residual_slush import TANK_MODEL, environment_kind

GroupT = TypeVar("GroupT", bound=Parameters)


def stated(group: Parameters) -> dict[str, Any]:
    """Return the settings of a group that were given, even where they are the defaults."""
    return {name: value for name, value in group if name in group.model_fields_set}


def completed(group: GroupT, given: Parameters) -> GroupT:
    """Return a settings group, with the settings that were given of another in place of its own."""
    changes = stated(given)
    return type(group).model_validate(dict(group) | changes) if changes else group


class LearnerSettings(Parameters):
    """A learner: an arm of the study with its own networks. What it does not state is as in the study's groups."""

    throws: Throws = Throws()
    """Its throws, where they differ from the group throws."""
    network: Architecture = Architecture()
    """Its networks, where they differ from the group network."""
    training: Training = Training()
    """Their training, where it differs from the group training."""
    n_members: int | None = Field(default=None, gt=0, le=64)
    """Number of networks; null for ensemble.n_members."""
    single: str | None = None
    """Another learner, of whose networks each trial uses one by itself; null for an ensemble of its own."""

    def __repr_args__(self) -> Iterator[tuple[str | None, Any]]:
        """Show what is stated, even where it is a default."""
        yield from self.model_dump().items()

    @model_serializer
    def _stated(self) -> dict[str, Any]:
        """Write what is stated alone."""
        return {
            name: value.model_dump(mode="json", exclude_unset=True) if isinstance(value, Parameters) else value
            for name, value in stated(self).items()
        }


BUILT_IN: Mapping[str, LearnerSettings] = {
    "residual_slush": LearnerSettings(),
    "single_member": LearnerSettings(single="residual_slush"),
    "designed_throws": LearnerSettings(),
    "designed_single_member": LearnerSettings(single="designed_throws"),
    TANK_MODEL.name: LearnerSettings(),
}
"""The learners of every study; single ones evolve at grid.single_member_depths."""

PAPERS_SINGLE = "single_member"  # which every study has at these depths

THROWS_GROUPS: Mapping[str, str] = {
    "residual_slush": "throws",
    "designed_throws": "designed_throws",
    TANK_MODEL.name: "throws",
}
"""Settings groups of the throws of built-in learners, by which their data sets are called."""


def ensemble_of_data_set(data_set: str) -> str:
    """Return the name of the learner whose ensemble learns from a data set."""
    return next((name for name, group in THROWS_GROUPS.items() if group == data_set), data_set)


@dataclass(frozen=True)
class Learner:
    """A learner of a study, in full."""

    name: str
    data_set: str  # name of its throws and of the ensemble that learns from them
    is_single: bool  # whether each trial uses one network by itself, instead of the ensemble
    throws: Throws
    network: Architecture
    training: Training
    n_members: int  # of the ensemble


NO_LEARNERS: Mapping[str, Learner] = MappingProxyType({})


def arm_kind(name: str, learners: Mapping[str, Learner] = NO_LEARNERS) -> EnvironmentKind:
    """Return an environment as readers of a study know it, whose learners are known by what they learned from."""
    kind, learner = environment_kind(name), learners.get(name)
    tracked = learner is not None and learner.throws.source == "tracks"
    if learner is None or kind is TANK_MODEL or (name in BUILT_IN and not tracked):
        return kind
    throws, networks = learner.throws, "one network" if learner.is_single else "networks"
    what = "your tank" if tracked else f"{throws.n_throws:,} {'designed ' * (throws.design == 'robots')}throws"
    label = f"{networks} of your tank" if name in BUILT_IN else f"{kind.label} ({what})"
    about = f"Dry Land with {networks} ({learner.network.form}) that learned from {'throws in ' * tracked}{what}."
    evolved = f"with the {label}" if tracked and not learner.is_single else kind.evolved
    return replace(kind, label=label[0].upper() + label[1:], evolved=evolved, about=about)
