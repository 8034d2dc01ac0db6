"""A study as analyses read it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from numpy.random import Generator

from tasks.analysis.scores import Champion, ScoredTrial
from tasks.analysis.tank import Tank
from tasks.arrays import Float64, Int64
from tasks.design import Designs
from tasks.evolution import Population
from tasks.residual.learner import Learner
from tasks.simulation import Conditions, Rollouts
from tasks.simulation.engine import EngineName
from tasks.world import EnsembleMedium, Environment, EnvironmentName, Physics


@dataclass(frozen=True, eq=False)
class Assessed:
    """Designs drawn from whole runs, simulated in the target and under every member of an ensemble."""

    predicted: Float64  # (n_members, n_designs) [m]; NaN where diverged
    true: Float64  # (n_designs,) [m]; NaN where diverged
    trial: Sequence[str]  # (n_designs,) the trial of each, which are samples
    replicate: Int64  # (n_designs,)


@dataclass(frozen=True)
class AnalysisSettings:
    """Settings of a study that analyses use."""

    assessed_depth: float  # depth at which designs are assessed [m]
    learners: Mapping[EnvironmentName, Learner]  # of the arms, those of the main ensemble first
    tank: Tank | None  # the virtual tank, if the study has one
    physics: Physics  # constants of the base simulator
    n_settle: int  # steps of a rollout before displacement is measured

    @property
    def data_sets(self) -> tuple[str, ...]:
        """Names of the data sets that ensembles learned from, the main one first."""
        return tuple(dict.fromkeys(learner.data_set for learner in self.learners.values()))


class StudyData(Protocol):
    """What an analysis may use: settings, and what it declares that it reads, for the trials of its item."""

    @property
    def settings(self) -> AnalysisSettings:
        """Settings of the study."""

    @property
    def trials(self) -> Sequence[ScoredTrial]:
        """Every trial, with what is known of it."""

    @property
    def in_engines(self) -> Mapping[EngineName, Sequence[ScoredTrial]]:
        """Every trial with what each engine says of it in the target, Box2D first."""

    @property
    def champions(self) -> Sequence[Champion]:
        """The champions that there are, in the order of the trials."""

    @property
    def populations(self) -> Mapping[tuple[EnvironmentName, float, int], Population]:
        """What the search of each trial knows at its end, by environment, depth [m] and number of the trial."""

    def assessed(self, data_set: str) -> Assessed | None:
        """Return the designs that the ensemble of a data set was assessed with, if any."""

    @property
    def target(self) -> EnvironmentName:
        """The environment that champions are transferred to."""

    @property
    def has_papers_target(self) -> bool:
        """Whether scores are comparable with the paper's."""

    def at_target(self, depth: float) -> Environment:
        """Return the target at a depth [m]."""

    def ensemble(self, champion: Champion | None = None) -> EnsembleMedium:
        """Return the ensemble that serves a champion, by default the main one; the same object for all it serves."""

    def simulate(
        self,
        environment: Environment,
        designs: Designs,
        *,
        trace: bool = False,
        physics: Physics | None = None,
        n_measure: int | None = None,
    ) -> Rollouts:
        """Simulate designs as the study does, unless physics or the number of steps are given."""

    def score(self, environment: Environment, designs: Designs) -> Float64:
        """Return (n_designs, n_members) scores of designs, in the unit of the study's objective."""

    def score_under(self, conditions: Conditions, environment: Environment, designs: Designs) -> Float64:
        """Return (n_designs,) scores of one rollout each in some conditions, in an environment without an ensemble."""

    def rng(self, *identity: str | float) -> Generator:
        """Return a generator that the study's seed and what it is for decide."""
