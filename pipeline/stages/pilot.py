"""pilot: what robots do before any trial evolves, and whether the throws cover it.

Where robots pass through states unlike those of all throws, networks extrapolate, and members may agree and be wrong.
So random designs move in the base simulator, and a short evolution in each ensemble shows what designs it leads to. No
true slush is involved.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from pipeline.config.settings import Settings
from pipeline.stages import environments
from pipeline.stages.collect import read_transitions, throws_among, throws_inputs
from pipeline.stages.data_sets import DataSetId, data_sets, ensemble_ids
from pipeline.stages.environments import FitnessSpec, SimulationSpec
from pipeline.store.encoding import decode_table, encode_table
from pipeline.store.manifest import Manifest
from pipeline.store.store import Store
from pipeline.store.tables import columns_of, rows_of
from pipeline.workflow.stage import Chain, Execution, Files, Inputs, Item, Results, Stage, Summary, Upstream
from tasks.analysis.coverage import EVERYTHING, CoverageRow, coverage, deviations, observed_states
from tasks.arrays import Float32
from tasks.design import Designs, Morphology, random_designs
from tasks.evolution import EMPTY_POPULATION, Afpo, Trial, evolve
from tasks.seeding import generator, replicate_seed
from tasks.world import DryLand, Environment, EnvironmentName, ResidualSlush

COVERAGE, STATES = "coverage.parquet", "states.parquet"
_SEEN_IN: tuple[EnvironmentName, ...] = ("dry_land", "residual_slush")
_WORDS = {"dry_land": "random robots", "residual_slush": "evolved robots"}
_N_RANDOM = 64  # random designs in the base simulator
_UNITS = {"observation": "a, y, cos θ, vx, vy, ω of a link [m, m, 1, m/s, m/s, rad/s]"}


@dataclass(frozen=True)
class PilotSpec:
    """A short evolution in one ensemble."""

    seed: int
    simulation: SimulationSpec
    depth: float
    n_generations: int
    afpo: Afpo
    morphology: Morphology
    fitness: FitnessSpec


def _plan(settings: Settings) -> Sequence[Chain[PilotSpec]]:
    """Plan one item for each data set."""
    evolution = settings.evolution
    specs = {
        data_set: PilotSpec(
            replicate_seed(settings.seed, data_set.replicate),
            environments.simulation_spec(settings),
            settings.assessed_depth,
            min(settings.pilot.n_generations, evolution.n_generations),
            evolution.afpo,
            evolution.morphology,
            environments.fitness_spec(settings, "residual_slush"),
        )
        for data_set in data_sets(settings)
    }
    weight = environments.relative_cost(settings, "residual_slush")
    return [Chain(data_set, (1,), spec, weight=weight) for data_set, spec in specs.items()]


def _item(
    settings: Settings, chain: Chain[PilotSpec], index: int, previous: Manifest | None, upstream: Upstream
) -> Item[PilotSpec]:
    assert isinstance(chain.identity, DataSetId)
    inputs = environments.network_inputs(ensemble_ids(settings, chain.identity), upstream)
    inputs |= throws_inputs(upstream["collect"], chain.identity)
    execution = environments.execution_options(settings, "residual_slush")
    return Item(PILOT.name, PILOT.version, chain.label, chain.spec, inputs, execution)


def _compute(item: Item[PilotSpec], inputs: Inputs) -> Files:
    """Tabulate how far pilots are from the throws, and keep some of their states."""
    spec = item.spec
    ensemble = environments.ensemble_of(environments.networks_among(inputs))
    thrown = read_transitions(throws_among(inputs)).observation
    rng = generator(spec.seed, "pilot", "random")
    # At the surface, where a fall adds little speed: a robot in a medium does not fall.
    random, ground = random_designs(_N_RANDOM, rng, morphology=spec.morphology), DryLand(depth=0.0)
    home = ResidualSlush(depth=spec.depth, ensemble=ensemble)
    pilots = {
        "dry_land": _states(spec, item.execution, random, ground),
        "residual_slush": _states(spec, item.execution, _evolved(spec, item.execution, home), home),
    }
    scale = deviations(np.concatenate(list(pilots.values())))
    rows = {name: coverage(states, thrown, scale) if len(states) else () for name, states in pilots.items()}
    table = {
        "seen_in": np.repeat(list(rows), [len(part) for part in rows.values()]),
        **columns_of(CoverageRow, [row for part in rows.values() for row in part]),
    }
    compared = {
        "seen_in": np.repeat(list(pilots), [len(states) for states in pilots.values()]),
        "observation": np.concatenate(list(pilots.values())),
    }
    return {
        COVERAGE: encode_table(table, schema="coverage", version=1, producer=item.key),
        STATES: encode_table(compared, schema="states", version=1, producer=item.key, units=_UNITS),
    }


def _evolved(spec: PilotSpec, execution: Execution, home: Environment) -> Designs:
    """Return the survivors of a short evolution in an ensemble."""
    score = environments.scorer(spec.simulation, execution, home, spec.fitness)
    trial = Trial(partial(generator, spec.seed, "pilot", "evolved"), EMPTY_POPULATION)
    ((population, _),) = evolve(
        [trial], score, first_generation=0, n_generations=spec.n_generations, afpo=spec.afpo, morphology=spec.morphology
    )
    return population.designs


def _states(spec: PilotSpec, execution: Execution, designs: Designs, environment: Environment) -> Float32:
    rollouts = environments.roll_out(spec.simulation, execution, environment, designs, trace=True)
    rng = generator(spec.seed, "pilot", "states")
    return observed_states(designs, rollouts, n_settle=spec.simulation.rollout.n_settle, rng=rng)


def read_coverage(files: Files) -> dict[EnvironmentName, list[CoverageRow]]:
    """Decode how far pilots are from the throws, by the environment where they were seen."""
    table = decode_table(files[COVERAGE], schema="coverage", version=1, source=COVERAGE)
    rows = {name: {key: column[table["seen_in"] == name] for key, column in table.items()} for name in _SEEN_IN}
    return {name: rows_of(CoverageRow, part) for name, part in rows.items() if len(part["seen_in"])}


def _summarise(settings: Settings, results: Results, store: Store) -> Summary:
    """Say how much of what pilots do is outside the throws, and warn where it is too much."""
    lines, metrics = list[str](), dict[str, float]()
    for pilot, (part,) in results.done.items():
        for seen_in, rows in read_coverage({COVERAGE: store.read(part, COVERAGE)}).items():
            whole = next(row for row in rows if row.component == EVERYTHING)
            worst = max((row for row in rows if row.component != EVERYTHING), key=lambda row: row.share_outside)
            # Random robots lie on a ground at the surface, higher than robots in a medium: no reason to warn.
            warned = seen_in == "residual_slush" and whole.share_outside > settings.pilot.most_outside
            prefix = "warning: " if warned else ""
            lines.append(
                f"{prefix}{pilot.label}: {whole.share_outside:.0%} of the states of {_WORDS[seen_in]} are outside"
            )
            lines.append(f"    the throws, most by {worst.component} of {worst.low:z.1f} to {worst.high:z.1f}")
            if warned:
                lines[-1] += ": predictions are extrapolated there"
            metrics[f"share_outside.{pilot.label.replace('/', '.')}.{seen_in}"] = whole.share_outside
    return Summary(lines=lines or ["no trial needs residual networks"], metrics=metrics)


PILOT = Stage(
    name="pilot",
    version=1,
    unit="pilots",
    reads=lambda settings: ("collect", "train"),
    plan=_plan,
    item=_item,
    compute=_compute,
    summarise=_summarise,
)
