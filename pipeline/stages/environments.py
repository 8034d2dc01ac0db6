"""Environments of a study: built from settings and trained networks, and what it takes to simulate designs in them."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, cast

import numpy as np

from pipeline.cluster import Spread, connect
from pipeline.config.settings import RolloutSettings, Settings
from pipeline.errors import PuddleError
from pipeline.stages.data_sets import NetworkId
from pipeline.stages.files import WEIGHTS
from pipeline.store.encoding import decode_arrays
from pipeline.store.store import Store
from pipeline.workflow.identity import InputName
from pipeline.workflow.stage import Execution, Files, Input, Inputs, Sources, Upstream
from tasks.design import DesignError, Designs, Morphology, random_designs
from tasks.evolution import OBJECTIVES, Evaluation, ObjectiveName, evaluate
from tasks.parameters import Parameters
from tasks.residual.ensemble import Ensemble
from tasks.residual.learner import NetworkUse
from tasks.residual.served_ensemble import TOLERANCE, ServedEnsemble
from tasks.seeding import generator
from tasks.simulation import Conditions, Rollouts, simulate
from tasks.simulation.engine import links_in
from tasks.simulation.mujoco import EngineError
from tasks.world import (
    ENVIRONMENTS,
    DryLand,
    EnsembleMedium,
    Environment,
    EnvironmentName,
    MeanResidual,
    Physics,
    ResidualSlush,
)
from tasks.world.medium import MediumError, Networks

MEMBER_SCHEMA, MEMBER_VERSION = "member", 1
MEMBER, OF_TARGET = "member", "target-member"  # roles of the inputs that are networks, and those of a learned target


@dataclass(frozen=True)
class Served:
    """Networks that the inference service evaluates."""

    use: NetworkUse
    tolerance: float = TOLERANCE  # greatest error of an output by rounding, relative to the largest output


Media = Mapping[EnvironmentName, Parameters | NetworkUse | Served | None]
"""What environments consist of: the settings of a medium, how networks are used, or nothing for dry land."""


@dataclass(frozen=True)
class SimulationSpec:
    """Settings that decide what a simulation shows."""

    physics: Physics
    rollout: RolloutSettings
    media: Media


def media_of(settings: Settings, *environments: EnvironmentName) -> Media:
    """Select what some environments consist of; random media get the study's seed."""
    media: dict[EnvironmentName, Parameters | NetworkUse | Served | None] = {}
    for name in environments:
        kind, learner = ENVIRONMENTS.get(name), settings.learner(name)
        media[name] = learner.use if learner else None
        if learner and learner.is_ensemble and settings.work.networks == "gpu":
            media[name] = Served(learner.use)
        if kind and kind.settings_group:
            media[name] = kind.for_study(getattr(settings, kind.settings_group), settings.seed)
    return media


def simulation_spec(settings: Settings, *environments: EnvironmentName) -> SimulationSpec:
    """Select the settings that decide what simulations in some environments show."""
    return SimulationSpec(settings.physics, settings.rollout, media_of(settings, *environments))


def build_environment(
    media: Media, name: EnvironmentName, depth: float, networks: Mapping[NetworkId, Files]
) -> Environment:
    """Return an environment at a depth [m], of its medium or of its networks; see :func:`environment_of`."""
    made_of = media[name]
    if isinstance(made_of, Served):
        local = cast(Ensemble, ensemble_of(networks))
        return ResidualSlush(
            depth, ServedEnsemble(local.weights, local.biases, local.form, connect, time_step=local.time_step)
        )
    return environment_of(media, name, depth, ensemble_of(networks) if isinstance(made_of, str) else None)


def environment_of(
    media: Mapping[EnvironmentName, Any], name: EnvironmentName, depth: float, ensemble: EnsembleMedium | None = None
) -> Environment:
    """Return an environment over ground at a depth [m], with its networks if it is a learner's."""
    if ensemble is not None and media[name] == "mean":
        return MeanResidual(depth, cast(Networks, ensemble))
    if ensemble is not None and isinstance(media[name], str | Served):
        return ResidualSlush(depth, ensemble)
    if name not in ENVIRONMENTS:
        raise PuddleError(f"{name}: expected the code of the medium, found none")
    return ENVIRONMENTS[name].environment(depth, media[name])


def ensemble_of(networks: Mapping[NetworkId, Files]) -> EnsembleMedium:
    """Decode networks as the members of an ensemble."""
    members = [
        decode_arrays(files[WEIGHTS], schema=MEMBER_SCHEMA, version=MEMBER_VERSION, source=network.label)
        for network, files in networks.items()
    ]
    return Ensemble.from_members(members)


def network_inputs(networks: Iterable[NetworkId], upstream: Upstream, role: str = MEMBER) -> Sources:
    """Return networks as inputs; raise MissingInputs if one is not trained."""
    return {InputName(role, one): Input(upstream["train"].chain(one)[-1], (WEIGHTS,)) for one in networks}


def networks_among(inputs: Inputs, role: str = MEMBER) -> dict[NetworkId, Files]:
    """Select the networks among an item's inputs."""
    named = ((name.chain, files) for name, files in inputs.items() if name.role == role)
    return {network: files for network, files in named if isinstance(network, NetworkId)}


def read_networks(networks: Iterable[NetworkId], upstream: Upstream, store: Store) -> dict[NetworkId, Files]:
    """Read networks from a store; raise MissingInputs if one is not trained."""
    inputs = network_inputs(networks, upstream)
    return networks_among({name: source.read(store) for name, source in inputs.items()})


def execution_options(settings: Settings, environment: EnvironmentName) -> Execution:
    """Return how rollouts in an environment are computed.

    Only slow rollouts are split: without networks the batch engine takes milliseconds for a generation, less than it
    takes to hand out its parts; and the inference service takes as long for a part as for the whole.
    """
    slow = environment in settings.learners and settings.work.networks == "local"
    slow |= settings.work.engine == "reference" or bool(getattr(ENVIRONMENTS.get(environment), "engine", ""))
    return Execution(settings.work.engine, settings.work.designs_per_batch if slow else None)


def roll_out(
    simulation: SimulationSpec,
    execution: Execution,
    environment: Environment,
    designs: Designs,
    conditions: Conditions | None = None,
    *,
    trace: bool = False,
    motor_work: bool = False,
) -> Rollouts:
    """Simulate designs, with a trace of every step and the work of the motors where they are asked for.

    Raises PuddleError if the medium, perhaps a user's own, gives no velocity change, or the engine is not here.
    """
    conditions = conditions or Conditions()
    try:
        return simulate(
            conditions.of_designs(designs),
            conditions.of_environment(environment),
            n_settle=simulation.rollout.n_settle * conditions.n_substeps,
            n_measure=simulation.rollout.n_measure * conditions.n_substeps,
            engine=execution.engine,
            trace=trace,
            motor_work=motor_work,
            physics=conditions.of_physics(simulation.physics),
        )
    except (MediumError, EngineError, DesignError) as error:
        raise PuddleError(str(error)) from error


_UNDER_WATER = np.array([[0.0, -1.0, 0.5, 1.0, 1.0, 1.0]], np.float32)  # a link, as tasks.residual.STATE has it


def check_media(settings: Settings) -> None:
    """Take a few steps with a robot in every engine and medium of a study, and one with a link under water.

    Raises PuddleError if an engine is not here, or a medium gives no velocity change.
    """
    morphology, controller = Morphology(n_links=settings.design.n_links), settings.evolution.controller
    design = random_designs(1, generator(0, "check"), morphology=morphology, controller=controller)
    for engine in settings.transfer.other_engines:
        alone = SimulationSpec(settings.physics, RolloutSettings(n_settle=0, n_measure=3), {})
        roll_out(alone, Execution(engine), DryLand(0.0), design)
    for name in (settings.target, *settings.grid.environments):
        if settings.learner(name) is None:
            simulation = replace(simulation_spec(settings, name), rollout=RolloutSettings(n_settle=0, n_measure=3))
            environment = build_environment(simulation.media, name, 0.0, {})
            roll_out(simulation, Execution("reference"), environment, design)
            if environment.medium is not None and not environment.is_ensemble:  # the robot begins above the water
                try:
                    links_in(environment.medium, np.ones(1), settings.physics)(_UNDER_WATER)
                except MediumError as error:
                    raise PuddleError(str(error)) from error


@dataclass(frozen=True)
class FitnessSpec:
    """What designs are selected for."""

    disagreement_penalty: float  # weight of the members' disagreement; 0 without an ensemble
    objective: ObjectiveName
    conditions: tuple[Conditions, ...]  # of the rollouts that the objective is the mean over; none if of one

    def at(self, depth: float) -> list[Conditions]:
        """Return these conditions in an environment of a depth [m]."""
        return [replace(one, depth=depth) if one.depth is None else one for one in self.conditions]


def fitness_spec(settings: Settings, environment: EnvironmentName) -> FitnessSpec:
    """Return what designs are selected for in an environment."""
    objective, conditions = settings.evolution.objective, settings.objective_conditions
    kind = settings.learner(environment) or ENVIRONMENTS.get(environment)
    if kind is None or not kind.is_ensemble:
        return FitnessSpec(0.0, objective, conditions)
    return FitnessSpec(settings.ensemble.disagreement_penalty, objective, conditions)


def evaluate_designs(
    designs: Designs, simulation: SimulationSpec, execution: Execution, environment: Environment, fitness: FitnessSpec
) -> Evaluation:
    """Return the scores of designs; displacement is that of the study's own rollout."""
    objective = OBJECTIVES[fitness.objective]
    needed = {"trace": objective.trace, "motor_work": objective.motor_work}
    own, varied = Conditions(environment.depth), fitness.at(environment.depth)
    rollouts = {
        each: roll_out(simulation, execution, environment, designs, each, **needed)
        for each in dict.fromkeys((own, *varied))
    }
    return evaluate(
        rollouts[own],
        disagreement_penalty=fitness.disagreement_penalty,
        objective=fitness.objective,
        varied=[rollouts[each] for each in varied],
    )


def scorer(
    simulation: SimulationSpec, execution: Execution, environment: Environment, fitness: FitnessSpec
) -> Callable[[Designs], Evaluation]:
    """Return a function that evaluates designs, over several workers where the execution options say so."""
    spread = Spread(evaluate_designs, simulation, execution, environment, fitness)

    def score(designs: Designs) -> Evaluation:
        size = execution.designs_per_batch or len(designs)
        parts: Sequence[Evaluation]
        if size >= len(designs):
            return evaluate_designs(designs, simulation, execution, environment, fitness)
        parts = spread([designs[first : first + size] for first in range(0, len(designs), size)])
        names = [field.name for field in fields(Evaluation)]
        return Evaluation(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))

    return score
