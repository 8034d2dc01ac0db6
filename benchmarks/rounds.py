"""Measure whether throws in rounds beat as many throws at once: `python -m benchmarks.rounds`.

In rounds, networks learn from some of the throws, pilots evolve in them, and `suggest_throws` places the next. Writes
docs/results/rounds.json, which docs/throws.md shows. Rows that the file has are not measured again. It takes half an
hour on one core.
"""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial
from itertools import product
from typing import Any

import numpy as np

from benchmarks.published import RESULTS
from benchmarks.throws import errors, robots
from benchmarks.tracks import displacements, learned
from pipeline.store.provenance import environment as provenance
from tasks.analysis.coverage import observed_states
from tasks.analysis.paper import DEPTH
from tasks.arrays import Float32
from tasks.design import random_designs
from tasks.evolution import EMPTY_POPULATION, PAPERS_OBJECTIVE, Afpo, Trial, evaluate, evolve
from tasks.residual import Throws, Transitions, initial_states, simulate_throws, suggest_throws
from tasks.residual.ensemble import Ensemble
from tasks.seeding import generator
from tasks.simulation import simulate
from tasks.world import DryLand, Environment, Physics, ResidualSlush, Slush, TrueSlush

_N_STEPS = 200  # of each throw
N_THROWS = (100,)
_N_ROUNDS = (1, 2, 4)
_N_REPLICATES = 3
_PILOT_GENERATIONS, _N_RANDOM, _N_TRIALS = 50, 64, 10
_N_SETTLE = 200  # steps
_AFPO = Afpo.model_validate({"population_size": 16, "mutation": {"step": 0.2}})
_PHYSICS = Physics()


def thrown_in_rounds(n_throws: int, n_rounds: int, replicate: int) -> Transitions:
    """Return the transitions of as many throws, the first round's evenly spread and the others suggested."""
    rng = generator(1, "rounds", n_rounds, replicate)
    first, *others = (len(part) for part in np.array_split(np.arange(n_throws), n_rounds))
    throws = Throws(design="robots", n_throws=first, n_steps=_N_STEPS)
    starts = initial_states(throws, generator(1, "throws", replicate), _PHYSICS)
    so_far = simulate_throws(starts, _N_STEPS, Slush(), _PHYSICS)
    for n in others:
        ensemble = learned(so_far)
        starts = suggest_throws(n, pilots(ensemble, rng), so_far.observation, ensemble, rng, physics=_PHYSICS)
        starts = replace(starts, throw=starts.throw + so_far.throw.max() + 1)
        so_far = Transitions.concatenate([so_far, simulate_throws(starts, _N_STEPS, Slush(), _PHYSICS)])
    return so_far


def pilots(ensemble: Ensemble, rng: np.random.Generator) -> Float32:
    """Return observations of random robots in the base simulator and of robots of a short evolution in the networks."""
    home = ResidualSlush(DEPTH, ensemble)
    ((population, _),) = evolve(
        [Trial(partial(generator, 7, "pilots"), EMPTY_POPULATION)],
        lambda designs: evaluate(simulate(designs, home), disagreement_penalty=1.0, objective=PAPERS_OBJECTIVE),
        first_generation=0,
        n_generations=_PILOT_GENERATIONS,
        afpo=_AFPO,
    )
    seen: list[tuple[Any, Environment]] = [
        (random_designs(_N_RANDOM, rng), DryLand(depth=0.0)),
        (population.designs, home),
    ]
    states = [
        observed_states(designs, simulate(designs, environment, trace=True), n_settle=_N_SETTLE, rng=rng)
        for designs, environment in seen
    ]
    return np.concatenate(states)


def main() -> None:
    """Measure the rows that the file lacks, and write it after each."""
    path, true = RESULTS / "rounds.json", TrueSlush(DEPTH)
    document = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {"rows": []}
    at = robots(DEPTH)
    if "in_true_slush" not in document:
        document["in_true_slush"] = displacements(true, true, n_trials=_N_TRIALS)
    for n_throws, replicate, n_rounds in product(N_THROWS, range(_N_REPLICATES), _N_ROUNDS):
        identity = {"n_throws": n_throws, "n_rounds": n_rounds, "replicate": replicate}
        if any(identity.items() <= row.items() for row in document["rows"]):
            continue
        ensemble = learned(thrown_in_rounds(n_throws, n_rounds, replicate))
        zero_shot = displacements(ResidualSlush(DEPTH, ensemble), true, n_trials=_N_TRIALS)
        document["rows"].append({**identity, "error": errors(ensemble, *at), "zero_shot": zero_shot})
        print(document["rows"][-1], flush=True)
        document |= {"schema": "puddle.rounds", "version": 1, "made_with": dict(provenance())}
        path.write_text(f"{json.dumps(document, indent=1, ensure_ascii=False)}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
