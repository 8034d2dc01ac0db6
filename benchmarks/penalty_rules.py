"""Measure rules for the members' disagreement other than the paper's μ - σ: `python -m benchmarks.penalty_rules`.

Every rule turns the members' predictions of a design into its fitness. Trials at 9 m and laptop scale evolve with each
rule, in ensembles of the paper's throws and of throws designed for robots, and their champions are tested in the true
slush. Writes docs/results/penalty-rules.json, which docs/throws.md shows. Rows that the file has are not measured
again. It takes a quarter of an hour on one core.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import product
from typing import Any

import numpy as np

from benchmarks.published import RESULTS
from benchmarks.tracks import learned
from pipeline.store.provenance import environment as provenance
from tasks.analysis.paper import DEPTH
from tasks.arrays import Bools, Float64
from tasks.design import Designs
from tasks.design.genes import concatenate
from tasks.evolution import EMPTY_POPULATION, Afpo, Population, Trial, evaluate, evolve
from tasks.evolution.objectives.evaluation import Evaluation
from tasks.residual import Throws, initial_states, simulate_throws
from tasks.residual.ensemble import Ensemble
from tasks.seeding import generator
from tasks.simulation import simulate
from tasks.world import Environment, Physics, ResidualSlush, Slush, TrueSlush

_THROWS = {
    "residual_slush": Throws(n_throws=500, n_steps=200),
    "designed_throws": Throws(design="robots", n_throws=3400, n_steps=29),
}
_N_DATA_SETS, _N_TRIALS, _N_GENERATIONS, _PILOT_GENERATIONS = 3, 4, 300, 50
_AFPO = Afpo.model_validate({"population_size": 16, "mutation": {"step": 0.2}})

Rule = Callable[[Float64], Float64]  # (n_designs, n_members) scores to (n_designs,) fitness


def penalised(k: float) -> Rule:
    """Return the rule μ - k σ."""
    return lambda scores: scores.mean(axis=1) - k * scores.std(axis=1)


RULES: dict[str, Rule] = {
    "μ": penalised(0.0),
    "μ − σ": penalised(1.0),
    "lower quartile": lambda scores: np.quantile(scores, 0.25, axis=1),
    "minimum": lambda scores: scores.min(axis=1),
}
CALIBRATED = "μ − k σ, k calibrated"


def evolved(home: Environment, rule: Rule, *, n_trials: int, n_generations: int, first_trial: int) -> list[Population]:
    """Return the survivors of trials in an ensemble, with a rule for the fitness."""

    def score(designs: Designs) -> Evaluation:
        evaluation = evaluate(simulate(designs, home), disagreement_penalty=0.0)
        scores = evaluation.displacement
        finite = np.asarray(np.isfinite(scores).all(axis=1))
        fitness = np.where(finite, rule(np.where(finite[:, None], scores, 0.0)), -np.inf)
        return replace(evaluation, fitness=fitness)

    trials = [Trial(partial(generator, 7, "penalty rules", first_trial + k), EMPTY_POPULATION) for k in range(n_trials)]
    found = evolve(trials, score, first_generation=0, n_generations=n_generations, afpo=_AFPO)
    return [population for population, _ in found]


def calibrated_k(ensemble: Ensemble, first_trial: int) -> float:
    """Return the k with which μ - k σ of some members is, on average, what a member that they exclude predicts.

    Each member is held out in turn. The designs are the survivors of a short evolution in the others, which exploit
    them, and σ is over the others. Nothing of this needs the true slush.
    """
    excess, deviation = 0.0, 0.0
    for held_out in range(ensemble.n_members):
        is_held_out = np.arange(ensemble.n_members) == held_out
        others = ResidualSlush(DEPTH, _members(ensemble, ~is_held_out))
        (pilots,) = evolved(
            others, penalised(1.0), n_trials=1, n_generations=_PILOT_GENERATIONS, first_trial=first_trial
        )
        scores = np.asarray(simulate(pilots.designs, others).displacement)
        judged = np.ravel(simulate(pilots.designs, ResidualSlush(DEPTH, _members(ensemble, is_held_out))).displacement)
        known = np.isfinite(judged)
        excess += float((scores.mean(axis=0) - judged)[known].sum())
        deviation += float(scores.std(axis=0)[known].sum())
    return max(0.0, excess / deviation)


def _members(ensemble: Ensemble, chosen: Bools) -> Ensemble:
    weights = tuple(weight[chosen] for weight in ensemble.weights)
    return replace(ensemble, weights=weights, biases=tuple(bias[chosen] for bias in ensemble.biases))


def champions_of(populations: Sequence[Population]) -> Designs:
    """Return the champion of each trial."""
    return concatenate([population.designs[population.champion()] for population in populations])


def main() -> None:
    """Measure the rows that the file lacks, and write it after each."""
    path, true = RESULTS / "penalty-rules.json", TrueSlush(DEPTH)
    document: dict[str, Any] = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {"rows": []}
    at_scale = partial(evolved, n_trials=_N_TRIALS, n_generations=_N_GENERATIONS)
    if "in_true_slush" not in document:
        found = [at_scale(true, penalised(0.0), first_trial=_N_TRIALS * k) for k in range(_N_DATA_SETS)]
        document["in_true_slush"] = [round(float(one.fitness.max()), 2) for trials in found for one in trials]
    for data_set, (arm, throws) in product(range(_N_DATA_SETS), _THROWS.items()):
        done = {row["rule"] for row in document["rows"] if (row["arm"], row["data_set"]) == (arm, data_set)}
        if done == {*RULES, CALIBRATED}:
            continue
        starts = initial_states(throws, generator(1, "throws", data_set))
        assert throws.n_steps is not None
        ensemble = learned(simulate_throws(starts, throws.n_steps, Slush(), Physics()), seed=data_set)
        home, first_trial = ResidualSlush(DEPTH, ensemble), _N_TRIALS * data_set
        k = calibrated_k(ensemble, first_trial)
        for name, rule in (RULES | {CALIBRATED: penalised(k)}).items():
            if name in done:
                continue
            champions = champions_of(at_scale(home, rule, first_trial=first_trial))
            scores = np.asarray(simulate(champions, home).displacement)
            row = {"arm": arm, "data_set": data_set, "rule": name, "k": round(k, 2) if name == CALIBRATED else None}
            row |= {"predicted": [round(float(score), 2) for score in scores.mean(axis=0)]}
            row |= {"fitness": [round(float(score), 2) for score in rule(scores.T)]}
            row |= {"zero_shot": [round(float(score), 2) for score in np.ravel(simulate(champions, true).displacement)]}
            document["rows"].append(row)
            print(row, flush=True)
            document |= {"schema": "puddle.penalty_rules", "version": 1, "made_with": dict(provenance())}
            path.write_text(f"{json.dumps(document, indent=1, ensure_ascii=False)}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
