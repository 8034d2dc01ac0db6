"""What each analysis is: its identity, and the specification that decides its result."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from pipeline.stages.environments import Media, SimulationSpec
from pipeline.workflow.identity import Arm, TrialId
from tasks.analysis.tank import Tank
from tasks.world import EnvironmentName, Physics


@dataclass(frozen=True)
class AnalysisId:
    """An analysis, of the whole study or of one arm."""

    kind: str
    arm: Arm | None = None

    @property
    def label(self) -> str:
        """Name for display."""
        return f"{self.kind}/{self.arm.label}" if self.arm else self.kind


@dataclass(frozen=True)
class AnalysisSpec:
    """What all analyses have in common."""

    seed: int
    trials: tuple[TrialId, ...]  # trials whose champions are analysed
    n_rollouts: int
    environment: EnvironmentName  # where most of the rollouts are, for their cost


@dataclass(frozen=True)
class StatisticsSpec(AnalysisSpec):
    """Scores and predictions."""

    assessed_depth: float


@dataclass(frozen=True)
class MembersSpec(AnalysisSpec):
    """Networks and throws."""

    held_out: float
    physics: Physics
    media: Media


@dataclass(frozen=True)
class MatrixSpec(AnalysisSpec):
    """Champions at every depth."""

    depths: tuple[float, ...]
    simulation: SimulationSpec


@dataclass(frozen=True)
class ExploitersSpec(AnalysisSpec):
    """Champions and assessed designs under every member."""

    simulation: SimulationSpec
    disagreement_penalty: float


@dataclass(frozen=True)
class InstrumentsSpec(AnalysisSpec):
    """Champions of one arm under every instrument."""

    arm: Arm
    held_out: float
    simulation: SimulationSpec
    disagreement_penalty: float


@dataclass(frozen=True)
class TankSpec(AnalysisSpec):
    """Champions of one arm in the tank."""

    arm: Arm
    tank: Tank
    n_steps: int
    simulation: SimulationSpec


SpecT = TypeVar("SpecT", bound=AnalysisSpec, covariant=True)


@dataclass(frozen=True)
class AnalysisItemSpec(Generic[SpecT]):
    """An analysis, and why some of what it reads is missing."""

    analysis: SpecT
    failed: Mapping[str, str] = field(default_factory=dict)  # reasons of trials without scores, by label
    not_assessed: str = ""  # why there are no predictions; "" if there are
    no_networks: str = ""  # why there are no networks; "" if there are
