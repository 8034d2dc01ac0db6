"""Evolution's own share of a generation, the rest of which is simulation."""

from __future__ import annotations

import time
from functools import partial
from typing import Any
from unittest import mock

from benchmarks.engines import N_DESIGNS, N_ROUNDS
from benchmarks.measure import Benchmark
from pipeline.store.encoding import encode_arrays, encode_table
from tasks.design import Designs
from tasks.evolution import Afpo, Evaluation, Trial, evaluate, evolve
from tasks.seeding import generator
from tasks.simulation import batch, simulate
from tasks.world import DryLand, Environment, TrueSlush

N_GENERATIONS = 100


def own_work() -> list[Benchmark]:
    """Measure ask, tell, packing and the record of 64 designs, without networks, and then with the record's tables.

    All are shares of whole generations, over a segment of N_GENERATIONS.
    """
    environments = DryLand(9.0), TrueSlush(1.0), TrueSlush(9.0)
    _shares(environments[0], 0)  # compiles
    figures = []
    for environment in environments:
        search, with_tables = zip(*(_shares(environment, trial) for trial in range(N_ROUNDS)), strict=True)
        where, unit = f"{type(environment).__name__}, d = {environment.depth:g}", "% of a generation"
        figures.append(Benchmark(f"AFPO's own work, {where}", search, unit, 10.0))
        figures.append(Benchmark(f"AFPO's own work and its tables, {where}", with_tables, unit))
    return figures


def _shares(environment: Environment, trial: int) -> tuple[float, float]:
    """Return the shares [%] of ask, tell, packing and the record in a segment, without and with the record's tables."""
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
        evaluation = evaluate(simulate(designs, environment), disagreement_penalty=0.0)
        evaluating += time.perf_counter() - start
        return evaluation

    start = time.perf_counter()
    with mock.patch.object(batch, "Groups", TimedGroups):
        ((population, history),) = evolve(
            [Trial(partial(generator, trial))],
            score,
            first_generation=0,
            n_generations=N_GENERATIONS,
            search=Afpo(population_size=N_DESIGNS),
        )
    evolved = time.perf_counter() - start
    start = time.perf_counter()
    encode_arrays(population.arrays(), schema="population", version=1)
    encode_table(history, schema="history", version=1)
    encoding = time.perf_counter() - start
    search = evolved - (evaluating - packing)
    return 100 * search / evolved, 100 * (search + encoding) / (evolved + encoding)
