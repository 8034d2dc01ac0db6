"""Learners: the arms of a study whose robots evolve in networks, and what these networks learn from.

A study names its learners in the settings group ``learners``, those of the paper among them.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, Literal, TypeVar

from pydantic import Field, model_serializer

from tasks.parameters import Parameters
from tasks.residual.hyperparameters import Architecture, Training
from tasks.residual.throws import DESIGNED_THROWS, Throws
from tasks.world.registry import ENVIRONMENTS, ArmKind

GroupT = TypeVar("GroupT", bound=Parameters)
NetworkUse = Literal["ensemble", "single", "mean"]


def stated(group: Parameters) -> dict[str, Any]:
    """Return the settings of a group that were given, even where they are the defaults."""
    return {name: value for name, value in group if name in group.model_fields_set}


def _completed(group: GroupT, given: GroupT) -> GroupT:
    """Return a settings group, with the settings that were given of another in place of its own."""
    return type(group).model_validate(dict(group) | stated(given))


class LearnerSettings(Parameters):
    """A learner: networks that robots evolve in. What it does not state is as in the study's groups."""

    throws: Throws = Throws()
    """Its throws, where they differ from the group throws; those of a design that it states are simulated, and differ
    from the group's defaults."""
    network: Architecture = Architecture()
    """Its networks, where they differ from the group network."""
    training: Training = Training()
    """Their training, where it differs from the group training."""
    n_members: int | None = Field(default=None, gt=0, le=64)
    """Number of networks; null for ensemble.n_members."""
    single: str | None = None
    """Another learner, of whose networks each trial uses one by itself; null for networks of its own."""
    mean: str | None = None
    """Another learner, the mean of whose networks is one medium; null for networks of its own."""

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


TANK_MODEL = "tank_model"  # the target of a study that learned from tracked throws and names no other

LEARNERS: Mapping[str, LearnerSettings] = {
    "residual_slush": LearnerSettings(),
    "single_member": LearnerSettings(single="residual_slush"),
    "designed_throws": LearnerSettings(throws=DESIGNED_THROWS),
    "designed_single_member": LearnerSettings(single="designed_throws"),
    "law": LearnerSettings(network=Architecture(form="law")),
    "law_and_network": LearnerSettings(network=Architecture(form="law_and_network")),
    TANK_MODEL: LearnerSettings(mean="residual_slush"),
}
"""The learners of every study. Single ones evolve at grid.single_member_depths."""


@dataclass(frozen=True)
class Learner:
    """A learner of a study, in full."""

    name: str
    data_set: str  # the learner whose throws and networks it uses: itself, or another
    use: NetworkUse  # of the networks: all, in each trial one by itself, or their mean as one medium
    throws: Throws
    network: Architecture
    training: Training
    n_members: int  # of the ensemble

    @property
    def is_single(self) -> bool:
        """Whether each trial uses one network by itself."""
        return self.use == "single"

    @property
    def is_ensemble(self) -> bool:
        """Whether rollouts have an axis of members."""
        return self.use != "mean"


def learner_of(
    name: str, learners: Mapping[str, LearnerSettings], base: LearnerSettings, n_members: int
) -> Learner | None:
    """Return a learner in full, completed by the study's groups ``base``; None if a study has none of that name."""
    given = learners.get(name)
    if given is None:
        return None
    if source := given.single or given.mean:
        whole = learner_of(source, learners, base, n_members)
        return whole and replace(whole, name=name, use="single" if given.single else "mean")
    throws = Throws() if "design" in stated(given.throws) else base.throws
    return Learner(
        name,
        name,
        "ensemble",
        _completed(throws, given.throws),
        _completed(base.network, given.network),
        _completed(base.training, given.training),
        given.n_members or n_members,
    )


NO_LEARNERS: Mapping[str, Learner] = MappingProxyType({})

_DESIGNS = {"paper": "", "robots": "designed ", "struck": "struck "}  # of throws, as a label has them
_KINDS: Mapping[str, ArmKind] = {
    kind.name: kind
    for kind in (
        ArmKind(
            name="residual_slush",
            label="Residual Slush",
            symbol="Ê",
            evolved="in Residual Slush",
            about="Dry Land with an ensemble of small neural networks. They learned the residual, which is the "
            "difference between the target and Dry Land, from links thrown into the target. Fitness is the mean over "
            "the members minus their disagreement, so that a robot has to do well under all of them.",
            order=3,
            learned=True,
        ),
        ArmKind(
            name="single_member",
            label="Single member",
            symbol="Ê₁",
            evolved="with a single member",
            about="Dry Land with a single network. Robots can exploit its errors: they evolve to use hallucinated "
            "dynamics.",
            order=4,
            learned=True,
        ),
        ArmKind(
            name="designed_throws",
            label="Designed throws",
            symbol="Ê*",
            evolved="in Residual Slush learned from designed throws",
            about="Residual Slush whose networks learned from throws that are designed for robots: they cover the "
            "speeds, lengths and heights of robots' links evenly, with as many transitions.",
            order=5,
            learned=True,
        ),
        ArmKind(
            name="designed_single_member",
            label="Designed, single",
            symbol="Ê*₁",
            evolved="with a single member learned from designed throws",
            about="Dry Land with a single network that learned from designed throws.",
            order=6,
            learned=True,
        ),
        ArmKind(
            name="law",
            label="Fitted law",
            symbol="L",
            evolved="in a law that was fitted to throws",
            about="Dry Land with the law of a fluid whose constants were fitted to the throws: system identification. "
            "It knows the kind of fluid, as plain networks do not.",
            order=6,
            learned=True,
        ),
        ArmKind(
            name="law_and_network",
            label="Fitted law and networks",
            symbol="L + Ê",
            evolved="in a fitted law and networks",
            about="Dry Land with a law that was fitted to the throws, and networks that learned what it leaves over.",
            order=6,
            learned=True,
        ),
        ArmKind(
            name=TANK_MODEL,
            label="the model of your tank",
            symbol="T",
            evolved="in the model of your tank",
            order=0,
            learned=True,
        ),
    )
}


def arm_kind(name: str, learners: Mapping[str, Learner] = NO_LEARNERS) -> ArmKind:
    """Return an arm as readers of a study know it; its own learners are known by what they learned from."""
    words = name.replace("_", " ")
    kind = {**ENVIRONMENTS, **_KINDS}.get(name) or ArmKind(
        name=name,
        label=words.capitalize(),
        symbol="Ê",
        evolved=f"with the networks of {words}",
        about="Residual Slush as this learner of the study knows it; the settings say what it learned from.",
        order=6,
        learned=True,
    )
    learner = learners.get(name)
    tracked = learner is not None and learner.throws.source == "tracks"
    if learner is None or learner.use == "mean" or (name in _KINDS and not tracked):
        return kind
    throws, networks = learner.throws, "one network" if learner.is_single else "networks"
    what = "your tank" if tracked else f"{throws.n_throws:,} {_DESIGNS[throws.design]}throws"
    about = f"Dry Land with {networks} ({learner.network.form}) that learned from {'throws in ' * tracked}{what}."
    if name not in _KINDS:
        return replace(kind, about=about)
    evolved = kind.evolved if learner.is_single else "with the networks of your tank"
    return replace(kind, label=f"{networks.capitalize()} of your tank", evolved=evolved, about=about)


def in_order(environments: Iterable[str], first: str = "") -> list[str]:
    """Return names of environments in the order of listings, each once; the target comes first if it is given."""
    return sorted(set(environments), key=lambda name: (name != first, arm_kind(name).order, name))
