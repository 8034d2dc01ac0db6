"""The settings of a study: everything that a user may choose, typed, bounded, with its unit and its reason.

The defaults are the paper's study. A file in configs/ states what it changes. Each group of scientific parameters is
declared beside the equation that uses it (see tasks/); what is declared here is the study around them.

Settings name the things in the pipeline's order: data, networks, environments, evolution, transfer,
assessment, and how the work is cut. How it is cut never changes a result.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self, TypeVar

from pydantic import Field, create_model, model_validator

from tasks.analysis.tank import Tank
from tasks.design import Morphology
from tasks.evolution import Afpo
from tasks.parameters import Parameters
from tasks.residual import Architecture, Throws, Training
from tasks.world import ENVIRONMENTS, EnvironmentName, Physics, Slush
from tasks.world.registry import settings_groups

RESIDUAL_ENVIRONMENTS = tuple(name for name, kind in ENVIRONMENTS.items() if kind.networks != "none")
"""Environments that need trained networks."""

DEEPEST = 1000.0
"""The deepest ground that there may be [m]."""

Depth = Annotated[float, Field(ge=0.0, le=DEEPEST)]


class EnsembleSettings(Parameters):
    """The residual networks together."""

    n_members: int = Field(default=8, ge=1, le=64)
    """Independently initialised networks. [P]"""
    disagreement_penalty: float = Field(default=1.0, ge=0.0, le=100.0)
    """k of the fitness μ - k σ over members. [P]"""


class GridSettings(Parameters):
    """Which trials there are."""

    depths: tuple[Depth, ...] = Field(default=(0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 9.0), min_length=1)
    """Of the ground below the surface [m]. [P]"""
    environments: tuple[EnvironmentName, ...] = Field(
        default=("true_slush", "dry_land", "residual_slush"), min_length=1
    )
    """Where designs evolve, at every depth. [P]"""
    single_member_depths: tuple[Depth, ...] = (9.0,)
    """Those of the depths at which designs also evolve in one member: trial k in member k, counted around. [P]"""
    n_trials: int = Field(default=10, ge=1, le=10_000)
    """Independent trials of each depth and environment. [P]"""

    @model_validator(mode="after")
    def _no_repeats(self) -> Self:
        for name in ("depths", "environments", "single_member_depths"):
            values = getattr(self, name)
            if len(set(values)) != len(values):
                raise ValueError(f"{name} repeats a value, expected each once")
        return self

    @model_validator(mode="after")
    def _a_name_for_each_depth(self) -> Self:
        for name in ("depths", "single_member_depths"):
            called: dict[str, float] = {}
            for depth in getattr(self, name):
                other = called.setdefault(f"{depth:g}", depth)  # as labels have it
                if other != depth:
                    raise ValueError(
                        f"{name} holds {other!r} and {depth!r}, and both are called {depth:g} m: expected depths that "
                        f"differ in their first six digits"
                    )
        return self

    def trials(self) -> list[tuple[EnvironmentName, float, int]]:
        """List environment, depth and number of every trial."""
        arms = [(environment, depth) for depth in self.depths for environment in self.environments]
        if "single_member" not in self.environments:
            arms += [("single_member", depth) for depth in self.single_member_depths if depth in self.depths]
        return [(environment, depth, trial) for environment, depth in arms for trial in range(self.n_trials)]


class RolloutSettings(Parameters):
    """How long a design is watched."""

    n_settle: int = Field(default=200, ge=0, le=1_000_000)
    """Steps of settling before displacement counts. [P]"""
    n_measure: int = Field(default=1200, ge=1, le=1_000_000)
    """Steps over which displacement counts. [P]"""

    @model_validator(mode="after")
    def _something_moves_in_a_film(self) -> Self:
        # Two frames, two steps from each other; where nothing settles, the first is the state after the first step.
        n_least = 2 if self.n_settle else 3
        if self.n_measure < n_least:
            raise ValueError(
                f"n_measure is {self.n_measure} where n_settle is {self.n_settle}, too few steps to show on the page: "
                f"expected {n_least} or more"
            )
        return self


class EvolutionSettings(Parameters):
    """The evolution of bodies and controllers."""

    n_generations: int = Field(default=1000, ge=1, le=1_000_000)
    """Of each trial. [P]"""
    afpo: Afpo = Afpo()
    """The algorithm."""
    morphology: Morphology = Morphology()
    """What every body keeps to."""


class TransferSettings(Parameters):
    """What champions go through in True Slush."""

    adapted_environments: tuple[EnvironmentName, ...] = tuple(ENVIRONMENTS)
    """Whose champions' controllers are evolved again from scratch in True Slush, bodies frozen."""
    n_generations: int = Field(default=1000, ge=1, le=1_000_000)
    """Of each adaptation. [P]"""


class AssessSettings(Parameters):
    """Which designs prediction accuracy is judged by: of trials in True Slush and on Dry Land, at one depth."""

    depth: Depth = 9.0
    """Of the ground below the surface [m]; where the grid lacks it, the deepest that it has. [P]"""
    n_designs: int = Field(default=2376, ge=1, le=1_000_000)
    """Drawn uniformly over the generations, in equal parts from every trial. [P]"""


class WorkSettings(Parameters):
    """How the work is cut into pieces. None of it changes a number; but other pieces are computed anew."""

    engine: Literal["batch", "reference"] = "batch"
    """What simulates: "reference" is pybox2d; "batch" gives the same bits sooner."""
    throws_per_item: int = Field(default=100, ge=1, le=1_000_000)
    """Throws that one worker makes at a time."""
    generations_per_item: int = Field(default=50, ge=1, le=1_000_000)
    """Generations between two checkpoints of a trial. A piece should take a second or more."""
    designs_per_batch: int | None = Field(default=None, ge=1, le=1_000_000)
    """Split each generation into batches of so many designs, simulated by different workers; null keeps a trial on one
    worker, which is right unless a generation costs core-seconds or there are more cores than trials."""


_SettingsT = TypeVar("_SettingsT", bound=Parameters)


def _with_registered_media(declared: type[_SettingsT]) -> type[_SettingsT]:
    """Add the settings groups of registered media that have no field of their own."""
    groups: dict[str, Any] = {
        name: (group, Field(default=group(), description=group.__doc__))
        for name, group in settings_groups().items()
        if name not in declared.model_fields
    }
    if not groups:
        return declared
    return create_model(declared.__name__, __base__=declared, __module__=declared.__module__, **groups)


@_with_registered_media
class Settings(Parameters):
    """A study."""

    name: str = Field(default="paper", pattern=r"^[a-z0-9][a-z0-9_-]{0,63}$")
    """Under which the store keeps this study; lower-case letters, digits, - and _."""
    seed: int = Field(default=1, ge=0, lt=2**63)
    """All randomness follows from it and from what each piece of work is."""
    physics: Physics = Physics()
    """The base simulator."""
    slush: Slush = Slush()
    """The medium of True Slush, which the base simulator lacks."""
    throws: Throws = Throws()
    """The data set."""
    network: Architecture = Architecture()
    """One residual network."""
    training: Training = Training()
    """How it learns."""
    ensemble: EnsembleSettings = EnsembleSettings()
    """The networks together."""
    grid: GridSettings = GridSettings()
    """The trials."""
    rollout: RolloutSettings = RolloutSettings()
    """How long a design is watched."""
    evolution: EvolutionSettings = EvolutionSettings()
    """How designs evolve."""
    transfer: TransferSettings = TransferSettings()
    """How champions are put to the test."""
    assess: AssessSettings = AssessSettings()
    """How predictions are put to the test."""
    tank: Tank | None = None
    """The tank that champions are tried in, virtually, and one of them proposed for building; null for none. [P]: of
    the robot that was built."""
    work: WorkSettings = WorkSettings()
    """How the work is cut."""

    @model_validator(mode="after")
    def _motors_belong_to_locked_bodies(self) -> Self:
        if self.physics.passive_joints == "locked" and self.evolution.morphology.n_actuated is None:
            raise ValueError(
                "physics.passive_joints is locked, so that motors decide which links are one body: "
                "expected evolution.morphology.n_actuated to say how many there are"
            )
        return self

    @model_validator(mode="after")
    def _a_tank_holds_settled_robots(self) -> Self:
        if self.tank is not None and self.rollout.n_settle < 1:
            raise ValueError(
                "rollout.n_settle is 0, while a robot in the tank is measured from where it settled: "
                "expected 1 or more, or tank to be null"
            )
        return self

    @property
    def assessed_depth(self) -> float:
        """Depth at which prediction accuracy is judged [m]."""
        depths = self.grid.depths
        return self.assess.depth if self.assess.depth in depths else max(depths)

    @property
    def needs_ensemble(self) -> bool:
        """Whether any trial evolves under residual networks."""
        return any(environment in RESIDUAL_ENVIRONMENTS for environment, _, _ in self.grid.trials())
