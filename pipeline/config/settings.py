"""The settings of a study: everything that a user may choose, with type, bounds, unit and reason.

The defaults are the paper's study ([P] marks its values). A file in configs/ states what it changes. Groups of
scientific parameters are declared beside the equations that use them, in tasks/.
"""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Annotated, Any, Literal, Self, TypeVar

from pydantic import Field, create_model, field_validator, model_validator

from pipeline.config.agreement import check
from tasks.analysis.tank import Tank
from tasks.bench.tracks.conventions import Tracks
from tasks.design import CONTROLLERS, OPEN_LOOP, LinkLimits, Morphology, MorphologyRules
from tasks.evolution import (
    OBJECTIVES,
    PAPERS_OBJECTIVE,
    PAPERS_SEARCH,
    SEARCHES,
    Afpo,
    Objective,
    ObjectiveName,
    Optimiser,
    SearchName,
)
from tasks.parameters import Parameters
from tasks.residual import LEARNERS, Architecture, Learner, LearnerSettings, Throws, Training, arm_kind, in_order
from tasks.residual.forms import form_here
from tasks.residual.learner import learner_of
from tasks.simulation import Conditions
from tasks.simulation.engine import BOX2D, EngineName
from tasks.world import ENVIRONMENTS, EnvironmentName, Medium, MediumWithMemory, Physics, Slush
from tasks.world.registry import settings_groups
from tasks.world.slush import PAPERS_TARGET

LearnerName = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,31}$")]
DEEPEST = 1000.0  # greatest depth of the ground [m]

Depth = Annotated[float, Field(ge=0.0, le=DEEPEST)]


def _check_values_differ(name: str, values: Sequence[object]) -> None:
    if len(set(values)) != len(values):
        raise ValueError(f"{name} repeats a value: expected each value once")


class EnsembleSettings(Parameters):
    """The ensemble of residual networks."""

    n_members: int = Field(default=8, ge=1, le=64)
    """Number of independently initialised networks. [P]"""
    disagreement_penalty: float = Field(default=1.0, ge=0.0, le=100.0)
    """Weight k of disagreement in the fitness μ - k σ over members. [P]"""


class GridSettings(Parameters):
    """The trials of a study."""

    depths: tuple[Depth, ...] = Field(default=(0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 9.0), min_length=1)
    """Depths of the ground below the surface [m]. [P]"""
    environments: tuple[EnvironmentName, ...] = Field(
        default=("true_slush", "dry_land", "residual_slush"), min_length=1
    )
    """Environments in which designs evolve, at every depth: media, and learners, the study's own among them. By default
    the first is the target. [P]"""
    single_member_depths: tuple[Depth, ...] = (9.0,)
    """Depths at which designs also evolve in a single network, every trial in its own, beside those that evolve in the
    ensemble. Where there are more trials than members, more networks are trained. [P]"""
    n_trials: int = Field(default=10, ge=1, le=10_000)
    """Number of independent trials of each depth and environment. [P]"""

    @model_validator(mode="after")
    def _values_differ(self) -> Self:
        _check_values_differ("environments", self.environments)
        for name in ("depths", "single_member_depths"):
            _check_values_differ(
                f"{name} (to six digits)", [f"{depth:g}" for depth in getattr(self, name)]
            )  # as in labels
        return self


class DesignSettings(Parameters):
    """What a design is made of."""

    n_links: LinkLimits = LinkLimits()
    """Numbers of links that designs may have."""


class RolloutSettings(Parameters):
    """Duration of a simulation."""

    n_settle: int = Field(default=200, ge=0, le=1_000_000)
    """Steps of settling before displacement is measured. [P]"""
    n_measure: int = Field(default=1200, ge=3, le=1_000_000)
    """Steps over which displacement is measured; a film takes three. [P]"""


_SettingsT = TypeVar("_SettingsT", bound=Parameters)


def _with_groups(declared: type[_SettingsT], registered: Mapping[str, type[Parameters]]) -> type[_SettingsT]:
    """Add registered groups that have no field of their own."""
    groups: dict[str, Any] = {
        name: (group, Field(default=group(), description=group.__doc__))
        for name, group in registered.items()
        if name not in declared.model_fields
    }
    return create_model(declared.__name__, __base__=declared, __module__=declared.__module__, **groups)


@partial(_with_groups, registered={name: search.settings for name, search in SEARCHES.items()})
class EvolutionSettings(Parameters):
    """The evolution of bodies and controllers."""

    n_generations: int = Field(default=1000, ge=1, le=1_000_000)
    """Generations of each trial. [P]"""
    objective: ObjectiveName = PAPERS_OBJECTIVE
    """What designs and adapted controllers are selected for, and champions compared by. [P]: displacement of the
    root."""
    objective_depths: tuple[Depth, ...] | None = None
    """Depths of the ground [m] over which the objective mean_over_depths is the mean; null for those of the grid. Each
    adds a rollout of every design."""
    afpo: Afpo = Afpo()
    """The algorithm."""
    morphology: MorphologyRules = MorphologyRules()
    """Constraints on bodies and motors."""
    controller: str = OPEN_LOOP
    """What turns the joints: open_loop, the paper's oscillators, or another registered controller. [P]: open_loop."""
    search: SearchName = PAPERS_SEARCH
    """What improves designs and adapted controllers: afpo, the paper's age-fitness Pareto optimisation, or another
    search, whose settings are the group of its name. [P]: afpo."""

    @property
    def optimiser(self) -> Optimiser:
        """The search, with its settings."""
        unknown: Any = {}  # in a record of code that is not here
        chosen: Optimiser = getattr(self, self.search, unknown)
        return chosen

    @property
    def population_size(self) -> int | None:
        """Designs that a generation evaluates; None of a search that does not say, or is not here."""
        return getattr(self.optimiser, "population_size", None)

    @property
    def maximised(self) -> Objective:
        """The objective; its name alone where a study recorded one whose code is not here."""
        unknown: Any = None
        named = Objective(self.objective, self.objective, "", unknown, over_depths=self.objective_depths is not None)
        return OBJECTIVES.get(self.objective, named)

    @model_validator(mode="after")
    def _depths_belong_to_the_objective(self) -> Self:
        if self.objective_depths is None:
            return self
        if not self.maximised.over_depths:
            over = " or ".join(name for name, objective in OBJECTIVES.items() if objective.over_depths)
            raise ValueError(
                f"objective_depths are given, but objective is {self.objective}, which is measured at the depth of the "
                f"trial: expected objective {over}, or objective_depths to be null"
            )
        _check_values_differ("objective_depths", self.objective_depths)
        return self


class TransferSettings(Parameters):
    """Tests of champions in the target."""

    adapted_environments: tuple[EnvironmentName, ...] | None = None
    """Environments whose champions' controllers are evolved again from scratch in the target, with frozen bodies; null
    for all."""
    n_generations: int = Field(default=1000, ge=1, le=1_000_000)
    """Generations of each adaptation. [P]"""

    engines: tuple[EngineName, ...] = Field(default=("batch",), min_length=1)
    """Engines in which champions are scored in the target, before and after their adaptation: batch, which is Box2D and
    always one, and others such as mujoco (docs/extending.md)."""

    @property
    def other_engines(self) -> tuple[EngineName, ...]:
        """Those that are not Box2D."""
        return tuple(name for name in dict.fromkeys(self.engines) if name not in BOX2D)


class AssessSettings(Parameters):
    """Designs for prediction accuracy, from trials in the target and on Dry Land at one depth."""

    depth: Depth = 9.0
    """Depth of the ground below the surface [m]; if the grid lacks it, the deepest of the grid is used. [P]"""
    n_designs: int = Field(default=2376, ge=1, le=1_000_000)
    """Number of designs, drawn uniformly over the generations in equal parts from every trial. [P]"""


class WorkSettings(Parameters):
    """How the work is divided into work items. Another choice computes them anew; only networks changes a number."""

    engine: Literal["batch", "reference"] = "batch"
    """Simulation engine: "reference" is pybox2d; "batch" gives the same bits faster."""
    throws_per_item: int = Field(default=100, ge=1, le=1_000_000)
    """Throws of one work item."""
    generations_per_item: int = Field(default=50, ge=1, le=1_000_000)
    """Generations between two checkpoints of a trial. A work item should take a second or more."""
    designs_per_batch: int | None = Field(default=None, ge=1, le=1_000_000)
    """Designs per batch, if each generation is split into batches that different workers simulate. null keeps a trial
    on one worker, which is right unless a generation takes core-seconds or there are more cores than trials."""
    networks: Literal["local", "gpu"] = "local"
    """What evaluates networks while robots step on cores: "local" each core itself, or "gpu" one process for each GPU
    of a machine, for all its cores; where there is none, it computes on a core. The last bits of "gpu" differ, so this
    alone is part of an item's key. It splits no generation."""


@partial(_with_groups, registered=settings_groups())
class Settings(Parameters):
    """A study."""

    name: str = Field(default="paper", pattern=r"^[a-z0-9][a-z0-9_-]{0,63}$")
    """Name of the study in the store: lower-case letters, digits, - and _."""
    seed: int = Field(default=1, ge=0, lt=2**63)
    """Seed of all randomness, together with the identity of each work item."""
    physics: Physics = Physics()
    """The base simulator."""
    target: EnvironmentName = PAPERS_TARGET
    """The environment that robots are made for: throws are made in its medium, which the base simulator lacks, and
    champions are transferred to it. [P]"""
    slush: Slush = Slush()
    """The medium of True Slush."""
    replicates: int = Field(default=1, ge=1, le=1000)
    """Number of independent data sets and ensembles, of which trial k uses number k mod replicates. With one, the
    spread over trials shows the chance in evolution alone; with more, also that in throws and training."""
    throws: Throws = Throws()
    """The data set that networks learn from, unless their learner states other throws."""
    tracks: Tracks | None = None
    """Tracked throws of real bars, where throws.source is tracks; null for none."""
    network: Architecture = Architecture()
    """One residual network."""
    training: Training = Training()
    """Training of the networks."""
    ensemble: EnsembleSettings = EnsembleSettings()
    """The ensemble of networks."""
    learners: Mapping[LearnerName, LearnerSettings] = LEARNERS
    """Learners by name, for grid.environments: each states what differs from the groups above. Those of the paper, and
    of throws that are designed for robots, are always there; what is given of them is in addition."""
    grid: GridSettings = GridSettings()
    """The trials."""
    rollout: RolloutSettings = RolloutSettings()
    """Duration of a simulation."""
    design: DesignSettings = DesignSettings()
    """Designs."""
    evolution: EvolutionSettings = EvolutionSettings()
    """Evolution of designs."""
    transfer: TransferSettings = TransferSettings()
    """Tests of champions in the target."""
    assess: AssessSettings = AssessSettings()
    """Designs that predictions are tested on."""
    tank: Tank | None = None
    """Virtual tank in which champions are tested, to propose one of them for building; null for none. [P]: the tank of
    the robot that was built."""
    work: WorkSettings = WorkSettings()
    """How the work is divided."""

    def __repr__(self) -> str:
        return "\n".join(["Settings(", *(f"    {name}={value!r}," for name, value in self.__repr_args__()), ")"])

    @field_validator("learners", mode="before")
    @classmethod
    def _with_those_of_every_study(cls, given: Any) -> Any:
        return _merged(LEARNERS, given)

    @model_validator(mode="after")
    def _target_is_an_arm(self) -> Self:
        if self.target != PAPERS_TARGET and "environments" not in self.grid.model_fields_set:
            arms = (*(() if self.target in self.learners else (self.target,)), *self.grid.environments[1:])
            object.__setattr__(self, "grid", self.grid.model_copy(update={"environments": arms}))
        return self

    @model_validator(mode="after")
    def _groups_agree(self) -> Self:
        if not isinstance(self, RecordedSettings):  # whose groups agreed when they were recorded
            check(self)
        return self

    @property
    def morphology(self) -> Morphology:
        """All constraints on designs."""
        return Morphology(**dict(self.evolution.morphology), n_links=self.design.n_links)

    @property
    def objective_depths(self) -> tuple[float, ...]:
        """Depths over which the objective is the mean [m]; none if it is measured at the depth of the trial alone."""
        if not self.evolution.maximised.over_depths:
            return ()
        depths = self.evolution.objective_depths
        return self.grid.depths if depths is None else depths

    @property
    def objective_conditions(self) -> tuple[Conditions, ...]:
        """Conditions of the rollouts that the objective is the mean over; none if it is that of one rollout."""
        return tuple(map(Conditions, self.objective_depths)) or self.evolution.maximised.conditions

    @property
    def selected_for(self) -> str:
        """What designs and adapted controllers are selected for, in words."""
        return self.evolution.maximised.in_words(self.objective_depths)

    @property
    def assessed_depth(self) -> float:
        """Depth at which prediction accuracy is assessed [m]."""
        depths = self.grid.depths
        return self.assess.depth if self.assess.depth in depths else max(depths)

    def is_adapted(self, environment: EnvironmentName) -> bool:
        """Return whether the controllers of champions of an environment adapt to the target."""
        adapted = self.transfer.adapted_environments
        return adapted is None or environment in adapted

    @property
    def simulated_environments(self) -> tuple[EnvironmentName, ...]:
        """Environments of simulations: media and learners."""
        return *ENVIRONMENTS, *self.learners

    @property
    def target_label(self) -> str:
        """The target as readers know it."""
        return arm_kind(self.target).label

    @property
    def target_medium(self) -> Medium | MediumWithMemory | None:
        """The target's medium, with its settings; None if it is learned."""
        kind = ENVIRONMENTS.get(self.target)
        return None if kind is None else kind.environment(0.0, getattr(self, kind.settings_group or "", None)).medium

    @property
    def has_papers_target(self) -> bool:
        """Whether displacements are comparable with the paper's."""
        return self.target == PAPERS_TARGET and self.slush.is_papers

    @property
    def needs_ensemble(self) -> bool:
        """Whether any trial evolves under residual networks."""
        return bool(self.arm_learners)

    def learner(self, environment: EnvironmentName) -> Learner | None:
        """Return the learner of an environment; None if it is a medium."""
        groups = LearnerSettings(throws=self.throws, network=self.network, training=self.training)
        return learner_of(environment, self.learners, groups, self.ensemble.n_members)

    def trials(self) -> list[tuple[EnvironmentName, float, int]]:
        """List the environment, depth [m] and number of every trial; single networks come beside their ensembles."""
        grid = self.grid
        arms = [(environment, depth) for depth in grid.depths for environment in grid.environments]
        for name, learner in self.learners.items():
            if learner.single in grid.environments and name not in grid.environments:
                arms += [(name, depth) for depth in grid.single_member_depths if depth in grid.depths]
        return [(environment, depth, trial) for environment, depth in arms for trial in range(grid.n_trials)]

    @property
    def arm_learners(self) -> dict[EnvironmentName, Learner]:
        """The learners that are arms or the target, in the order of listings."""
        names = in_order([self.target, *(environment for environment, _, _ in self.trials())])
        return {name: learner for name in names if (learner := self.learner(name))}

    @property
    def ensembles(self) -> dict[EnvironmentName, Learner]:
        """The learners whose networks the arms use; the first ensemble is the main one."""
        arms = sorted(self.arm_learners.values(), key=lambda one: one.is_single)
        return {one.data_set: whole for one in arms if (whole := self.learner(one.data_set))}


def _merged(group: Any, changes: Any) -> Any:
    """Return nested settings, with changes in place of what they name."""
    group, changes = (one.model_dump() if isinstance(one, LearnerSettings) else one for one in (group, changes))
    if not isinstance(group, Mapping) or not isinstance(changes, Mapping):
        return changes
    return {**group, **{name: _merged(group.get(name), value) for name, value in changes.items()}}


class RecordedEvolution(EvolutionSettings, extra="allow"):
    """An evolution, by a search that may not be here any more."""

    __pydantic_extra__: dict[str, dict[str, Any]] = Field(init=False)


class RecordedSettings(Settings, extra="allow"):
    """Settings as a study recorded them, also those of code that is not here: it can be shown, but not computed."""

    __pydantic_extra__: dict[str, dict[str, Any]] = Field(init=False)
    evolution: RecordedEvolution = RecordedEvolution()

    @property
    def missing(self) -> list[str]:
        """Names of what is used or listed and has no code."""
        used = {self.target, *self.grid.environments} - {*ENVIRONMENTS, *self.learners}
        forms = {self.network.form, *(given.network.form for given in self.learners.values())}
        used |= {form for form in forms if not form_here(form)}
        evolution = self.evolution
        of_evolution = {evolution.search, evolution.objective, evolution.controller}
        return sorted(used | of_evolution - {*SEARCHES, *OBJECTIVES, *CONTROLLERS})
