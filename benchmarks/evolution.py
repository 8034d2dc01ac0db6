"""What evolution itself takes of a generation, the rest of which is simulation; and trials side by side."""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import partial
from typing import Any
from unittest import mock

from benchmarks.engines import N_DESIGNS, N_ROUNDS
from benchmarks.measure import Figure
from pipeline.store.encoding import encode_arrays, encode_table
from tasks.design import Designs
from tasks.evolution import Afpo, Evaluation, Trial, evaluate, evolve
from tasks.seeding import generator
from tasks.simulation import batch, simulate
from tasks.world import DryLand, Environment, TrueSlush

N_GENERATIONS = 100
N_OF_LAPTOP = 16
"""Designs of a trial of the laptop's preset."""


def own_work() -> list[Figure]:
    """Ask, tell, packing and the record of 64 designs, over whole generations in a world without networks.

    And with the tables that the pipeline makes of the record, for a piece of so many generations.
    """
    worlds = DryLand(9.0), TrueSlush(1.0), TrueSlush(9.0)
    _shares(worlds[0], 0)  # compiles
    figures = []
    for world in worlds:
        own, kept = zip(*(_shares(world, trial) for trial in range(N_ROUNDS)), strict=True)
        where, unit = f"{type(world).__name__}, d = {world.depth:g}", "% of a generation"
        figures.append(Figure(f"AFPO's own work, {where}", own, unit, 5.0))
        figures.append(Figure(f"AFPO's own work and its tables, {where}", kept, unit))
    return figures


def _shares(world: Environment, trial: int) -> tuple[float, float]:
    """Of a trial's piece: what ask, tell, packing and the record take; and that with the tables that keep it."""
    evaluating = packing = 0.0

    class TimedGroups(batch.Groups):
        def __init__(self, *arguments: Any, **options: Any) -> None:
            nonlocal packing
            start = time.perf_counter()
            super().__init__(*arguments, **options)
            packing += time.perf_counter() - start

    def score(designs: Designs) -> Evaluation:
        nonlocal evaluating
        start = time.perf_counter()
        evaluation = evaluate(simulate(designs, world), disagreement_penalty=0.0)
        evaluating += time.perf_counter() - start
        return evaluation

    start = time.perf_counter()
    with mock.patch.object(batch, "Groups", TimedGroups):
        ((population, history),) = evolve(
            [Trial(partial(generator, trial))],
            score,
            first_generation=0,
            n_generations=N_GENERATIONS,
            afpo=Afpo(population_size=N_DESIGNS),
        )
    evolved = time.perf_counter() - start
    start = time.perf_counter()
    encode_arrays(population.arrays(), schema="population", version=1, producer="bench")
    encode_table(history, schema="history", version=1, producer="bench")
    keeping = time.perf_counter() - start
    own = evolved - (evaluating - packing)
    return 100 * own / evolved, 100 * (own + keeping) / (evolved + keeping)


def side_by_side() -> list[Figure]:
    """Evolve four trials of 16 designs side by side, and one after the other."""
    figures = []
    for world in (TrueSlush(0.0), TrueSlush(1.0), TrueSlush(9.0)):
        _seconds(world, range(4))  # compiles
        shares = []
        for trials in (range(first, first + 4) for first in range(0, 4 * N_ROUNDS, 4)):
            apart = sum(_seconds(world, [trial]) for trial in trials)
            shares.append(100 * _seconds(world, trials) / apart)
        figures.append(Figure(f"four trials side by side over one by one, d = {world.depth:g}", shares, "%"))
    return figures


def _seconds(world: Environment, trials: Sequence[int]) -> float:
    """Evolve trials side by side for a few generations."""

    def score(designs: Designs) -> Evaluation:
        return evaluate(simulate(designs, world), disagreement_penalty=0.0)

    start = time.perf_counter()
    evolve(
        [Trial(partial(generator, trial)) for trial in trials],
        score,
        first_generation=0,
        n_generations=N_GENERATIONS // 4,
        afpo=Afpo(population_size=N_OF_LAPTOP),
    )
    return time.perf_counter() - start
