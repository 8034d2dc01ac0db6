"""Segments: some generations of one trial as a piece of work. Evolution and adaptation both consist of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from pipeline.cluster import spread
from pipeline.config.settings import RESIDUAL_ENVIRONMENTS, EnvironmentName, Settings
from pipeline.store.encoding import decode_arrays, decode_table, encode_arrays, encode_table
from pipeline.store.manifest import Manifest
from pipeline.store.store import Store
from pipeline.workflow.stage import Chain, Files, Input, Job, Spec, Upstream
from tasks.design import Designs, Morphology
from tasks.design.genes import GENES
from tasks.evolution import (
    EMPTY_POPULATION,
    HISTORY_UNITS,
    OPERATORS,
    Afpo,
    Evaluation,
    Population,
    Trial,
    evaluate,
    evolve,
)
from tasks.seeding import generator
from tasks.simulation import Rollouts, simulate
from tasks.simulation.batch import n_that_fill_lanes
from tasks.world import DryLand, Environment, Medium, Physics, ResidualSlush, Slush, TrueSlush

POPULATION, HISTORY, CURVE = "population.safetensors", "history.parquet", "curve.parquet"
WEIGHTS, MEMBER_SCHEMA, MEMBER_VERSION = "weights.safetensors", "member", 1

BEFORE, CHAMPION_OF = "before", "champion-of"
"""Names of inputs: the segment before; the trial whose champion's body is frozen."""

FLOPS_OF_PHYSICS = 8e3
"""About what Box2D's step of one link costs, to weigh networks against it."""


SETTINGS_OF: Mapping[EnvironmentName, tuple[str, ...]] = {
    "true_slush": ("slush",),
    "dry_land": (),
    "residual_slush": (),
    "single_member": (),
}
"""Groups of settings that each world is made of, beside the physics; :func:`world_of` finds them in its ``spec``."""


def groups_of(settings: Settings, *worlds: EnvironmentName) -> dict[str, Any]:
    """Give the groups of settings that worlds are made of, beside the physics, as a specification holds them."""
    names = dict.fromkeys(group for world in worlds for group in SETTINGS_OF[world])
    return {name: getattr(settings, name).model_dump(mode="json") for name in names}


def member_label(member: int) -> str:
    """Name a member of the ensemble."""
    return f"member-{member:02d}"


def trial_label(environment: str, depth: float, trial: int) -> str:
    """Name a trial."""
    return f"{environment}/{depth:g}m/trial-{trial}"


def mean_and_deviation(values: Sequence[float]) -> str:
    """Give trials' mean ± sample deviation, as the page does; of one trial the mean alone, of none a dash."""
    if not values:
        return "-"
    return f"{np.mean(values):z6.2f}" + (f" ± {np.std(values, ddof=1):5.2f}" if len(values) > 1 else "")


def segment_spec(
    settings: Settings, *, stage: str, environment: EnvironmentName, world: EnvironmentName, depth: float, trial: int
) -> dict[str, Any]:
    """Say what a trial's segments have in common.

    Args:
        settings: the study's.
        stage: which stage the trial belongs to.
        environment: the arm of the study.
        world: where designs are simulated: the environment itself, or True Slush for an adaptation.
        depth: [m]
        trial: its number.
    """
    spec: dict[str, Any] = {
        "identity": [stage, depth, environment, trial],
        "seed": settings.seed,
        "world": world,
        "depth": depth,
        "afpo": settings.evolution.afpo.model_dump(mode="json"),
        "morphology": settings.evolution.morphology.model_dump(mode="json"),
        "rollout": settings.rollout.model_dump(mode="json"),
        "physics": settings.physics.model_dump(mode="json"),
        **groups_of(settings, world),
    }
    if world in RESIDUAL_ENVIRONMENTS:
        spec["disagreement_penalty"] = settings.ensemble.disagreement_penalty
    return spec


def segment_lengths(settings: Settings, n_generations: int) -> tuple[int, ...]:
    """Cut a trial's generations into segments."""
    size = settings.work.generations_per_item
    return tuple(min(size, n_generations - first) for first in range(0, n_generations, size))


def generations_of(settings: Settings, n_generations: int, index: int) -> dict[str, int]:
    """Say which generations a segment runs."""
    lengths = segment_lengths(settings, n_generations)
    return {"first_generation": sum(lengths[:index]), "n_generations": lengths[index]}


def execution(settings: Settings, world: EnvironmentName) -> Spec:
    """Say how rollouts in a world are computed, which does not change what they are.

    Only what is slow is split into batches: without networks the batch engine takes milliseconds for a generation,
    which is less than handing out its parts would take.
    """
    slow = world in RESIDUAL_ENVIRONMENTS or settings.work.engine == "reference"
    return {"engine": settings.work.engine, "designs_per_batch": settings.work.designs_per_batch if slow else None}


def world_inputs(settings: Settings, world: EnvironmentName, trial: int, upstream: Upstream) -> dict[str, Input]:
    """Give the trained networks that a world consists of."""
    if world not in RESIDUAL_ENVIRONMENTS:
        return {}
    n_members = settings.ensemble.n_members
    members = range(n_members) if world == "residual_slush" else [trial % n_members]
    labels = [member_label(member) for member in members]
    return {label: Input(upstream["train"].chain(label)[-1], (WEIGHTS,)) for label in labels}


def batch_size(settings: Settings, world: EnvironmentName) -> int:
    """Say how many trials of a world keep the engine's lanes busy together, where one leaves some of them empty."""
    if settings.work.engine != "batch":
        return 1
    if world in RESIDUAL_ENVIRONMENTS:  # an ensemble fills them; of single members each trial has its own
        return 1
    return n_that_fill_lanes(settings.evolution.afpo.population_size, settings.physics)


def relative_cost(settings: Settings, world: EnvironmentName) -> float:
    """Estimate what a generation costs, relative to one on dry land."""
    if world not in RESIDUAL_ENVIRONMENTS:
        return 1.0
    width, n_hidden = settings.network.width, settings.network.hidden_layers
    flops = 2 * (6 * width + (n_hidden - 1) * width**2 + width * 6)
    return (settings.ensemble.n_members if world == "residual_slush" else 1) * (1 + flops / FLOPS_OF_PHYSICS)


def world_of(spec: Spec, inputs: Mapping[str, Files]) -> Environment:
    """Build the environment that a specification names."""
    world, depth = spec["world"], spec["depth"]
    if world == "dry_land":
        return DryLand(depth=depth)
    if world == "true_slush":
        return TrueSlush(depth=depth, slush=Slush.model_validate(spec["slush"]))
    from tasks.residual.ensemble import Ensemble

    members = [
        decode_arrays(inputs[name][WEIGHTS], schema=MEMBER_SCHEMA, version=MEMBER_VERSION, source=name)[0]
        for name in sorted(inputs)
        if name.startswith("member-")
    ]
    return ResidualSlush(depth=depth, ensemble=Ensemble.from_members(members))


def true_slush(spec: Spec, depth: float) -> Environment:
    """Give the world that designs are made for, and champions put to the test in; ``spec`` holds what it is made of."""
    return world_of({**spec, "world": "true_slush", "depth": depth}, {})


def true_medium(spec: Spec) -> Medium:
    """Give what fills that world, which the base simulator lacks and the networks learn."""
    medium = true_slush(spec, 0.0).medium
    assert medium is not None
    return medium


def roll_out(
    spec: Spec, execution: Spec, environment: Environment, designs: Designs, *, trace: bool = False
) -> Rollouts:
    """Simulate designs as a specification says."""
    return simulate(
        designs,
        environment,
        **spec["rollout"],
        engine=execution["engine"],
        trace=trace,
        physics=Physics.model_validate(spec["physics"]),
    )


def _score_batch(designs: Designs, spec: Spec, execution: Spec, environment: Environment) -> Evaluation:
    penalty = spec.get("disagreement_penalty", 0.0)
    return evaluate(roll_out(spec, execution, environment, designs), disagreement_penalty=penalty)


def score(spec: Spec, execution: Spec, environment: Environment, designs: Designs) -> Evaluation:
    """Simulate and score designs, in batches on several workers where ``how`` says so."""
    size = execution["designs_per_batch"]
    if size is None or size >= len(designs):
        return _score_batch(designs, spec, execution, environment)
    batches = [designs[first : first + size] for first in range(0, len(designs), size)]
    scored: Sequence[Evaluation] = spread(_score_batch, batches, spec, execution, environment)
    return Evaluation(
        fitness=np.concatenate([part.fitness for part in scored]),
        displacement=np.concatenate([part.displacement for part in scored]),
        com_displacement=np.concatenate([part.com_displacement for part in scored]),
    )


def compute_segment(job: Job, inputs: Mapping[str, Files]) -> Files:
    """Advance a trial by the segment's generations."""
    return compute_segments([job], [inputs])[0]


def compute_segments(jobs: Sequence[Job], inputs: Sequence[Mapping[str, Files]]) -> list[Files]:
    """Advance trials of one world by the same generations, side by side.

    Raises:
        ValueError: they differ in more than which trial they are.
    """
    spec, execution = jobs[0].spec, jobs[0].execution
    common, *others = (_all_but_identity(job, of) for job, of in zip(jobs, inputs, strict=True))
    if any(other != common for other in others):
        raise ValueError(f"trials side by side, from {spec['identity']} on, differ in more than their identities")
    trials = [_trial(job.spec, of) for job, of in zip(jobs, inputs, strict=True)]
    advanced = evolve(
        trials,
        partial(score, spec, execution, world_of(spec, inputs[0])),
        first_generation=spec["first_generation"],
        n_generations=spec["n_generations"],
        afpo=Afpo.model_validate(spec["afpo"]),
        morphology=Morphology.model_validate(spec["morphology"]),
    )
    return [
        {
            POPULATION: encode_arrays(after.arrays(), schema="population", version=1, producer=job.key),
            HISTORY: encode_table(history, schema="history", version=1, producer=job.key, units=history_units()),
            CURVE: encode_table(
                _curve(trial.population, history), schema="curve", version=1, producer=job.key, units=CURVE_UNITS
            ),
        }
        for job, trial, (after, history) in zip(jobs, trials, advanced, strict=True)
    ]


def _all_but_identity(job: Job, inputs: Mapping[str, Files]) -> tuple[Spec, Mapping[str, Files]]:
    """Give what trials that go side by side have in common: the specification, and the networks of their world."""
    networks = {name: files for name, files in inputs.items() if name not in (BEFORE, CHAMPION_OF)}
    return {**job.spec, "identity": None}, networks


def _trial(spec: Spec, inputs: Mapping[str, Files]) -> Trial:
    """Give a trial as the segment before left it."""
    return Trial(
        partial(generator, spec["seed"], *spec["identity"]),
        population_of(inputs[BEFORE]) if BEFORE in inputs else EMPTY_POPULATION,
        champion_of(population_of(inputs[CHAMPION_OF])) if CHAMPION_OF in inputs else None,
    )


def population_of(files: Files) -> Population:
    """Decode a segment's survivors."""
    arrays, _ = decode_arrays(files[POPULATION], schema="population", version=1, source=POPULATION)
    return Population.from_arrays(arrays)


def champion_of(population: Population) -> Designs | None:
    """Give the fittest design, or None if all diverged."""
    return population.designs[population.champion()] if len(population.designs) else None


def history_units() -> dict[str, str]:
    """Give the units of a history's columns."""
    return {**HISTORY_UNITS, **{gene.name: gene.unit for gene in GENES}}


def drawn_column(operator: str) -> str:
    """Name the column of a curve that counts an operator's draws."""
    return f"n_drawn_{operator}"


def rejected_column(operator: str) -> str:
    """Name the column of a curve that counts how many of them the morphology refused."""
    return f"n_rejected_{operator}"


CURVE_UNITS = {
    "generation": "",
    "best_fitness": "m",
    "median_fitness": "m",
    "n_diverged": "designs",
    **{column(operator): "designs" for operator in OPERATORS for column in (drawn_column, rejected_column)},
}


def _curve(before: Population, history: Mapping[str, npt.NDArray[Any]]) -> dict[str, npt.NDArray[Any]]:
    """Follow a segment by generation: the best fitness ever, the median of the children, and each operator's draws."""
    generations = np.unique(history["generation"])
    n_draws, operator = (history[name].reshape(len(generations), -1) for name in ("n_draws", "operator"))
    draws = {}
    for code, name in enumerate(OPERATORS):
        draws[drawn_column(name)] = np.where(operator == code, n_draws, 0).sum(axis=1)
        draws[rejected_column(name)] = np.where(operator == code, n_draws - 1, 0).sum(axis=1)
    fitness = history["fitness"].reshape(len(generations), -1)
    best_before = before.fitness.max(initial=-np.inf)
    return {
        "generation": generations,
        "best_fitness": np.maximum(np.maximum.accumulate(fitness.max(axis=1)), best_before),
        "median_fitness": np.median(fitness, axis=1),
        "n_diverged": np.isneginf(fitness).sum(axis=1),
        **draws,
    }


def read_curve(store: Store, segments: Sequence[Manifest]) -> dict[str, npt.NDArray[Any]]:
    """Join the curves of a trial's segments."""
    return join_curves({manifest.key: store.read(manifest, CURVE) for manifest in segments})


def join_curves(parts: Mapping[str, bytes]) -> dict[str, npt.NDArray[Any]]:
    """Join the curves of a trial's segments, in their order; names say where each is from."""
    tables = [decode_table(data, schema="curve", version=1, source=name) for name, data in parts.items()]
    return {name: np.concatenate([table[name] for table in tables]) for name in CURVE_UNITS}


def chain_of(settings: Settings, label: str, spec: Spec, units: tuple[float, ...]) -> Chain:
    """Lay out a trial as a chain of segments, and of what else there is to do for it."""
    return Chain(
        label=label,
        units=units,
        spec=spec,
        weight=relative_cost(settings, spec["world"]),
        world=f"{spec['world']} at {spec['depth']!r} m",
        batch_size=batch_size(settings, spec["world"]),
    )
