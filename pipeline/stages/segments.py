"""Segments: a work item of some generations of one trial. Evolution and adaptation both consist of them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from pipeline.config.settings import Settings
from pipeline.stages import environments
from pipeline.stages.cost import batch_size, seconds_of_generation
from pipeline.stages.data_sets import NetworkId
from pipeline.stages.environments import FitnessSpec, SimulationSpec, networks_among
from pipeline.stages.files import CURVE, HISTORY, POPULATION
from pipeline.store.encoding import decode_arrays, encode_arrays
from pipeline.store.manifest import Manifest
from pipeline.workflow.identity import Arm, InputName, TrialId
from pipeline.workflow.stage import Chain, Files, Input, Inputs, Item, Sources
from tasks.design import Designs, Morphology
from tasks.design.genes import table_of
from tasks.evolution import (
    OBJECTIVES,
    Optimiser,
    Population,
    SearchName,
    Trial,
    empty_population,
    evolve,
    history_units,
)
from tasks.seeding import generator
from tasks.simulation import Conditions
from tasks.world import Environment, EnvironmentName

BEFORE = InputName("before")  # the segment before
CHAMPION_OF = InputName("champion-of")  # the last segment of the trial whose champion's body is frozen


@dataclass(frozen=True)
class TrialSpec:
    """What the segments of a trial have in common."""

    identity: TrialId
    seed: int
    environment: EnvironmentName  # where designs are simulated: its own, or the target for an adaptation
    simulation: SimulationSpec
    search: SearchName
    optimiser: Optimiser  # the search, with its settings
    morphology: Morphology
    controller: str  # of its designs
    fitness: FitnessSpec  # what its designs are selected for

    def at_home(self, networks: Mapping[NetworkId, Files]) -> Environment:
        """Build the environment where designs are simulated."""
        return environments.build_environment(self.simulation.media, self.environment, self.identity.depth, networks)


@dataclass(frozen=True)
class SegmentSpec:
    """Some generations of a trial."""

    trial: TrialSpec
    first_generation: int
    n_generations: int


def trial_spec(settings: Settings, trial: TrialId, environment: EnvironmentName) -> TrialSpec:
    """Return the specification that the segments of a trial share, whose designs are simulated in an environment."""
    return TrialSpec(
        trial,
        settings.seed,
        environment,
        environments.simulation_spec(settings, environment),
        settings.evolution.search,
        settings.evolution.optimiser,
        settings.morphology,
        settings.evolution.controller,
        environments.fitness_spec(settings, environment),
    )


def segment_lengths(settings: Settings, n_generations: int) -> tuple[int, ...]:
    """Divide a trial's generations into segments."""
    size = settings.work.generations_per_item
    return tuple(min(size, n_generations - first) for first in range(0, n_generations, size))


def trial_chain(settings: Settings, spec: TrialSpec, units: tuple[float, ...]) -> Chain[TrialSpec]:
    """Return a trial as a chain of items of some generations; trials in one environment at one depth may be batched."""
    depth = spec.identity.depth
    n_rollouts = sum(one.n_substeps for one in {Conditions(depth), *spec.fitness.at(depth)})
    return Chain(
        spec.identity,
        units,
        spec,
        weight=seconds_of_generation(settings, spec.environment, depth) * n_rollouts,
        batch_key=Arm(spec.environment, depth),
        batch_size=batch_size(settings, spec.environment),
    )


def segment_of(chain: Chain[TrialSpec], index: int) -> SegmentSpec:
    """Specify a segment of a trial."""
    return SegmentSpec(chain.spec, round(sum(chain.units[:index])), round(chain.units[index]))


def before_input(previous: Manifest | None) -> Sources:
    """Return the segment before as an input, if there is one."""
    return {} if previous is None else {BEFORE: Input(previous, (POPULATION,))}


def compute_segment(item: Item[SegmentSpec], inputs: Inputs) -> Files:
    """Advance a trial by a segment's generations."""
    return compute_segments([item], [inputs])[0]


def compute_segments(items: Sequence[Item[SegmentSpec]], inputs: Sequence[Inputs]) -> list[Files]:
    """Advance trials that differ in their identities alone by the same generations, as one batch."""
    spec, execution = items[0].spec, items[0].execution
    trials = [_trial(item.spec.trial, item_inputs) for item, item_inputs in zip(items, inputs, strict=True)]
    environment = spec.trial.at_home(networks_among(inputs[0]))
    search, objective = spec.trial.optimiser, spec.trial.fitness.objective
    of_history = history_units(search, objective) | units_of_genes(spec.trial.controller)
    of_curve = curve_units(search, OBJECTIVES[objective].unit)
    advanced = evolve(
        trials,
        environments.scorer(spec.trial.simulation, execution, environment, spec.trial.fitness),
        first_generation=spec.first_generation,
        n_generations=spec.n_generations,
        search=search,
        morphology=spec.trial.morphology,
    )
    return [
        {
            POPULATION: encode_arrays(after.arrays(), schema="population", version=1),
            HISTORY.name: HISTORY.encode(history, of_history),
            CURVE.name: CURVE.encode(_curve(search, trial.population, history), of_curve),
        }
        for item, trial, (after, history) in zip(items, trials, advanced, strict=True)
    ]


def _trial(spec: TrialSpec, inputs: Inputs) -> Trial:
    """Return a trial as the segment before left it."""
    return Trial(
        partial(generator, spec.seed, *spec.identity.seed_identity),
        population_of(inputs[BEFORE]) if BEFORE in inputs else empty_population(spec.controller),
        champion_of(population_of(inputs[CHAMPION_OF])) if CHAMPION_OF in inputs else None,
    )


def units_of_genes(controller: str) -> dict[str, str]:
    """Return the units of the genes of designs with a controller, by their names."""
    return {gene.name: gene.unit for gene in table_of(controller).genes}


def population_of(files: Files) -> Population:
    """Decode a segment's survivors."""
    arrays = decode_arrays(files[POPULATION], schema="population", version=1, source=POPULATION)
    return Population.from_arrays(arrays)


def champion_of(population: Population) -> Designs | None:
    """Return the fittest design, or None if all diverged."""
    return population.designs[population.champion()].compact() if len(population.designs) else None


DRAWN, REJECTED = "n_drawn_", "n_rejected_"
"""Prefixes of a curve's columns that count an operator's draws, and those that the morphology rejected."""


def curve_units(search: Optimiser, fitness: str) -> dict[str, str]:
    """Return the columns of a search's curve, and their units."""
    return {
        "generation": "",
        "best_fitness": fitness,
        "median_fitness": fitness,
        "n_diverged": "designs",
        **{prefix + operator: "designs" for operator in search.operators for prefix in (DRAWN, REJECTED)},
    }


def _curve(
    search: Optimiser, before: Population, history: Mapping[str, npt.NDArray[Any]]
) -> dict[str, npt.NDArray[Any]]:
    """Tabulate a segment by generation: best fitness so far, median fitness of the children, draws of each operator."""
    generations = np.unique(history["generation"])
    n_draws, operator = (history[name].reshape(len(generations), -1) for name in ("n_draws", "operator"))
    draws = {}
    for code, name in enumerate(search.operators):
        draws[DRAWN + name] = np.where(operator == code, n_draws, 0).sum(axis=1)
        draws[REJECTED + name] = np.where(operator == code, n_draws - 1, 0).sum(axis=1)
    fitness = history["fitness"].reshape(len(generations), -1)
    best_before = before.fitness.max(initial=-np.inf)
    return {
        "generation": generations,
        "best_fitness": np.maximum(np.maximum.accumulate(fitness.max(axis=1)), best_before),
        "median_fitness": np.median(fitness, axis=1),
        "n_diverged": np.isneginf(fitness).sum(axis=1),
        **draws,
    }


def draws_of(curves: Sequence[Mapping[str, npt.NDArray[Any]]]) -> dict[str, tuple[int, ...]]:
    """Count the draws of each operator over some trials, and those that the morphology rejected."""
    operators = [name.removeprefix(DRAWN) for name in (curves[0] if curves else ()) if name.startswith(DRAWN)]
    return {
        name: tuple(sum(int(curve[prefix + name].sum()) for curve in curves) for prefix in (DRAWN, REJECTED))
        for name in operators
    }


def mean_and_deviation(values: Sequence[float]) -> str:
    """Format the mean ± sample standard deviation; one value has no deviation, and none is a dash."""
    if not values:
        return "-"
    return f"{np.mean(values):z6.2f}" + (f" ± {np.std(values, ddof=1):5.2f}" if len(values) > 1 else "")
