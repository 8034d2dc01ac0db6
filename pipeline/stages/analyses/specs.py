"""The specification of each analysis: what decides its result."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from pipeline.stages.environments import FitnessSpec, SimulationSpec
from pipeline.workflow.identity import OMIT_DEFAULT, Arm, TrialId
from tasks.analysis.tank import Tank
from tasks.evolution import PAPERS_OBJECTIVE, Deviation, ObjectiveName

STATISTICS, MEMBERS, MATRIX, EXPLOITERS = "statistics", "members", "transfer-matrix", "exploiters"
INSTRUMENTS, TANK = "instruments", "tank"  # kinds of analyses


@dataclass(frozen=True)
class AnalysisSpec:
    """What all analyses have in common."""

    seed: int
    trials: tuple[TrialId, ...]  # trials whose champions are analysed
    simulation: SimulationSpec
    no_networks: str = field(default="", kw_only=True)  # why there are no networks; "" if there are
    deviation: Deviation = field(default="population", metadata=OMIT_DEFAULT, kw_only=True)  # what σ over members is


@dataclass(frozen=True)
class StatisticsSpec(AnalysisSpec):
    """Scores and predictions."""

    assessed_depth: float
    throw_groups: tuple[str, ...] = ()  # throws that ensembles learned from, the main one first
    failed: Mapping[str, str] = field(default_factory=dict)  # reasons of trials without scores, by label
    not_assessed: str = ""  # why there are no predictions; "" if there are


@dataclass(frozen=True)
class MembersSpec(AnalysisSpec):
    """Networks and throws of the main ensemble."""

    held_out: float


@dataclass(frozen=True)
class MatrixSpec(AnalysisSpec):
    """Champions at every depth."""

    depths: tuple[float, ...]


@dataclass(frozen=True)
class ExploitersSpec(AnalysisSpec):
    """Champions and assessed designs under every member."""


@dataclass(frozen=True)
class InstrumentsSpec(AnalysisSpec):
    """Champions of one arm under every instrument."""

    arm: Arm
    held_out: float
    disagreement_penalty: float
    objective: ObjectiveName = field(default=PAPERS_OBJECTIVE, metadata=OMIT_DEFAULT, kw_only=True)
    objective_depths: tuple[float, ...] = field(default=(), metadata=OMIT_DEFAULT, kw_only=True)  # [m]

    @property
    def fitness(self) -> FitnessSpec:
        """What the champions were selected for."""
        return FitnessSpec(self.disagreement_penalty, self.objective, self.objective_depths, self.deviation)


@dataclass(frozen=True)
class TankSpec(AnalysisSpec):
    """Champions of one arm in the tank."""

    arm: Arm
    tank: Tank
    n_steps: int
