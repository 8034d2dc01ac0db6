"""Sizes: what a study keeps on the disk, from small pieces of its own kind, made, encoded and weighed.

What can't be made in little is given by constants, which are those of a real study (`row`). MLflow's mirror is apart.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import numpy.typing as npt

from pipeline.commands.specimens import N_FEW_THROWS, few_throws, layers_of, short_film
from pipeline.config.settings import Settings
from pipeline.report import render_films
from pipeline.stages import STAGES
from pipeline.stages.analyses.specs import AnalysisSpec, ExploitersSpec, InstrumentsSpec
from pipeline.stages.report import PAGE
from pipeline.stages.segments import history_units, segment_lengths
from pipeline.store.encoding import encode_arrays, encode_table
from pipeline.workflow.stage import AnyStage, Chain, Results
from tasks.design import N_LINKS, Designs, random_designs
from tasks.evolution import Evaluation, Trial, evolve
from tasks.residual import Transitions
from tasks.world import ENVIRONMENTS, EnvironmentName

MANIFEST_BYTES = 2_500
"""Of an item; a report's is longer, and nothing beside its films."""
CURVE_BYTES = 2_500
"""Of a segment's curve."""
BYTES_OF_A_DESIGN = 130
"""What a history keeps of one, about."""
LEARNED_BYTES = 7_500
"""Of a member's learning curve and errors."""
TABLES_BYTES = 20_000
"""Of an analysis, long tables apart."""
LINK_BYTES = 4 * 0.93
"""Of a number in the table of links: a float32, which hardly compresses."""
PAGE_BYTES = 3_700_000
"""Of the page and its figures as SVG and PNG."""
N_CALIBRATION_DESIGNS = 100


@dataclass(frozen=True)
class Sizes:
    """What is kept of a unit of each stage's work [bytes]."""

    throw: float
    member: float
    generation: Mapping[EnvironmentName, float]
    """Of evolution, by the world in which designs are simulated: a history, and its share of a checkpoint."""
    adapted_generation: float
    assessed: float
    assessed_table: float
    """Of a trial's predictions, however few."""
    link: float
    """Of a step of one link's, in an arm's table of links."""
    picture: float
    """Of a film, as GIF and as MP4."""


def weigh(settings: Settings) -> Sizes:
    """Make, encode and weigh a small piece of each kind of work."""
    n_members = settings.ensemble.n_members if settings.needs_ensemble else 0
    n_evolved, n_adapted = settings.evolution.n_generations, settings.transfer.n_generations
    own = _bytes_of_a_generation(settings, n_evolved, 1, None)
    together = _bytes_of_a_generation(settings, n_evolved, n_members, None) if n_members else own
    one, many = (_bytes_of_predictions(n, n_members) for n in (1, N_CALIBRATION_DESIGNS))
    body = random_designs(1, np.random.default_rng(1))
    film = short_film(settings)
    return Sizes(
        throw=_bytes_of_a_throw(settings) if n_members else 0.0,
        member=_bytes_of_weights(settings) + LEARNED_BYTES if n_members else 0.0,
        generation=dict.fromkeys(ENVIRONMENTS, own) | {"residual_slush": together},
        adapted_generation=_bytes_of_a_generation(settings, n_adapted, 1, body),
        assessed=(many - one) / (N_CALIBRATION_DESIGNS - 1),
        assessed_table=one,
        link=LINK_BYTES * (3 + 2 * n_members) if n_members else 0.0,
        picture=sum(map(len, render_films([film]))) / len(film.frames),
    )


def bytes_left(stage: AnyStage, chain: Chain[Any], n_done: int, settings: Settings, sizes: Sizes) -> float:
    """Say what the rest of a chain will keep [bytes]."""
    units = chain.units[n_done:]
    n_left = sum(units)
    match stage.name:
        case "collect":
            kept = n_left * sizes.throw
        case "train":
            kept = len(units) * sizes.member
        case "evolve":
            kept = n_left * sizes.generation[chain.spec.environment]
        case "transfer":
            kept = n_left * sizes.adapted_generation
        case "assess":
            kept = n_left * sizes.assessed + len(units) * sizes.assessed_table
        case "analyse":
            kept = len(units) * _bytes_of_an_analysis(chain, settings, sizes)
        case "report":  # twice: the report that people look at is a copy
            kept = 2 * (PAGE_BYTES * len(units) if chain.label == PAGE else n_left * sizes.picture)
        case other:
            raise ValueError(f"stage {other}: what it keeps has no size")
    return kept + len(units) * MANIFEST_BYTES


def bytes_left_of_study(settings: Settings, upstream: Mapping[str, Results]) -> float:
    """Say what the rest of a study will keep [bytes].

    Args:
        settings: the study's.
        upstream: what the store holds already, by stage; of a stage that it lacks, nothing.
    """
    sizes = weigh(settings)
    n_done = {name: results.n_done for name, results in upstream.items()}
    return sum(
        bytes_left(stage, chain, n_done.get(stage.name, {}).get(chain.identity, 0), settings, sizes)
        for stage in STAGES
        for chain in stage.plan(settings)
    )


def _bytes_of_an_analysis(chain: Chain[AnalysisSpec], settings: Settings, sizes: Sizes) -> float:
    n_steps = settings.rollout.n_settle + settings.rollout.n_measure
    links = n_worlds_looked_at(chain.spec) * n_steps * N_LINKS * sizes.link
    exploiters = settings.assess.n_designs * sizes.assessed / 4 if isinstance(chain.spec, ExploitersSpec) else 0.0
    return TABLES_BYTES + links + exploiters


def n_worlds_looked_at(spec: AnalysisSpec) -> int:
    """Count the rollouts of an analysis whose every step and link is looked at: its best, in slush and at home."""
    if not isinstance(spec, InstrumentsSpec):
        return 0
    return 1 if spec.arm.environment == "true_slush" else 2


def _bytes_of_a_throw(settings: Settings) -> float:
    thrown = few_throws(settings)
    return _weight({field.name: getattr(thrown, field.name) for field in fields(Transitions)}) / N_FEW_THROWS


def _bytes_of_weights(settings: Settings) -> float:
    """Count the numbers of a member's network, float32 each."""
    return 4.0 * sum((n_in + 1) * n_out for n_in, n_out in layers_of(settings.network))


def _bytes_of_a_generation(settings: Settings, n_of_trial: int, n_members: int, body: Designs | None) -> float:
    """Evolve one segment by random scores; its history, its survivors and its curve, by generation."""
    rng, n_generations = np.random.default_rng(0), segment_lengths(settings, n_of_trial)[0]

    def random_scores(designs: Designs) -> Evaluation:
        displacement = rng.normal(size=(len(designs), n_members))
        return Evaluation(fitness=displacement.mean(axis=1), displacement=displacement, com_displacement=displacement)

    ((after, history),) = evolve(
        [Trial(lambda generation: rng, body=body)],
        random_scores,
        first_generation=0,
        n_generations=n_generations,
        afpo=settings.evolution.afpo,
    )
    population = encode_arrays(after.arrays(), schema="population", version=1, producer="")
    return (_weight(history, units=history_units()) + len(population) + CURVE_BYTES) / n_generations


def _bytes_of_predictions(n: int, n_members: int) -> float:
    rng = np.random.default_rng(0)
    scores = {name: rng.normal(size=n) for name in ("true", "true_com")}
    predictions = {name: rng.normal(size=(n, max(1, n_members))) for name in ("predicted", "predicted_com")}
    return _weight({**scores, **predictions, **dict(random_designs(n, rng).arrays())})


def _weight(columns: Mapping[str, npt.NDArray[np.generic]], units: Mapping[str, str] | None = None) -> float:
    return float(len(encode_table(columns, schema="sample", version=1, producer="", units=units)))
