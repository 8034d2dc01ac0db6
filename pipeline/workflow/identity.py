"""Identities: what tells the chains, items and inputs of a study from one another. Their labels are never parsed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

from pipeline.config.settings import Settings
from tasks.world import EnvironmentName


class ChainId(Protocol):
    """The identity of a chain within its stage: a frozen dataclass with a label."""

    @property
    def label(self) -> str:
        """Name for display, unique within the stage."""


@dataclass(frozen=True)
class Arm:
    """An environment at one depth: all its trials are samples of one distribution."""

    environment: EnvironmentName
    depth: float  # [m]

    @property
    def label(self) -> str:
        """Name for display."""
        return f"{self.environment}/{self.depth:g}m"


@dataclass(frozen=True)
class TrialId:
    """A trial of a stage."""

    stage: str
    environment: EnvironmentName  # where its designs evolved
    depth: float  # [m]
    index: int
    n_replicates: int = field(default=1, compare=False)  # of the study's data sets

    @property
    def replicate(self) -> int:
        """The replicate of the data set and the ensemble that it uses."""
        return self.index % self.n_replicates

    @property
    def arm(self) -> Arm:
        """The arm that it is a sample of."""
        return Arm(self.environment, self.depth)

    @property
    def label(self) -> str:
        """Name for display."""
        return f"{self.arm.label}/trial-{self.index}"

    @property
    def seed_identity(self) -> tuple[str, float, str, int]:
        """What seeds its random numbers, beside the study's seed."""
        return self.stage, self.depth, self.environment, self.index

    def in_stage(self, stage: str) -> TrialId:
        """Return the same trial as another stage's chain."""
        return replace(self, stage=stage)


@dataclass(frozen=True)
class OutputId:
    """What a stage makes of a whole study, or of one arm: the table of an analysis, the page, the film."""

    name: str
    arm: Arm | None = None

    @property
    def label(self) -> str:
        """Name for display."""
        return f"{self.name}/{self.arm.label}" if self.arm else self.name


def trials_of(settings: Settings, stage: str) -> list[TrialId]:
    """List the study's trials as chains of a stage."""
    return [TrialId(stage, *row, settings.replicates) for row in settings.trials()]


def arms_of(trials: Sequence[TrialId]) -> dict[Arm, list[TrialId]]:
    """Group trials by arm, in the order of their first trials."""
    arms: dict[Arm, list[TrialId]] = {}
    for trial in trials:
        arms.setdefault(trial.arm, []).append(trial)
    return arms


@dataclass(frozen=True)
class InputName:
    """The part that an input plays for its item."""

    role: str  # such as "member" or "before"
    chain: ChainId | None = None  # the chain that it comes from, where several play the role
    index: int = 0  # number of the item in that chain, where several play the role

    @property
    def label(self) -> str:
        """Name for display, unique within the item."""
        return f"{self.role}/{self.chain.label}/{self.index}" if self.chain else self.role
