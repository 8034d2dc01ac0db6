"""What evolution itself takes of a generation; the rest is simulation."""

from __future__ import annotations

import time
from functools import partial

from benchmarks.engines import N_DESIGNS, N_ROUNDS
from benchmarks.measure import Figure, seconds
from tasks.design import Designs
from tasks.evolution import NOBODY_YET, Afpo, Evaluation, evaluate, evolve
from tasks.seeding import generator
from tasks.simulation import simulate
from tasks.world import DryLand, Environment, TrueSlush

N_GENERATIONS = 100


def own_work() -> list[Figure]:
    """Ask, tell and record generations of 64 designs, over whole generations in a world without networks."""
    worlds = DryLand(9.0), TrueSlush(1.0), TrueSlush(9.0)
    _share(worlds[0], 0)  # compiles
    return [
        Figure(f"AFPO's own work, {type(world).__name__}, d = {world.depth:g}",
               [_share(world, trial) for trial in range(N_ROUNDS)], "% of a generation", 5.0)
        for world in worlds
    ]  # fmt: skip


def _share(world: Environment, trial: int) -> float:
    evaluating = 0.0

    def timed(designs: Designs) -> Evaluation:
        nonlocal evaluating
        start = time.perf_counter()
        evaluation = evaluate(simulate(designs, world), disagreement_penalty=0.0)
        evaluating += time.perf_counter() - start
        return evaluation

    advance = partial(
        evolve, NOBODY_YET, timed, partial(generator, trial),
        first_generation=0, n_generations=N_GENERATIONS, afpo=Afpo(population_size=N_DESIGNS),
    )  # fmt: skip
    whole = seconds(advance)
    return 100 * (whole - evaluating) / whole
