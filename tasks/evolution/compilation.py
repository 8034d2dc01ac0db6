"""Compilation of the kernels that an evolution needs.

`python -m tasks.evolution.compilation PHYSICS` compiles them for physics whose settings are given as JSON. A study runs
it beside its first stages, so that no worker waits long for a kernel that its machine has never compiled.
"""

import sys
from functools import partial

import numpy as np

from tasks.evolution.afpo import EMPTY_POPULATION, Afpo
from tasks.evolution.objectives import evaluate
from tasks.evolution.trial import Trial, evolve
from tasks.residual.ensemble import N_OUT, Ensemble
from tasks.residual.observation import OBSERVATION
from tasks.seeding import generator
from tasks.simulation import simulate
from tasks.world import Physics, ResidualSlush


def compile_kernels(physics: Physics) -> None:
    """Compile the kernels that are not in the cache: evolve two robots for two generations in a network."""
    network = Ensemble((np.zeros((1, len(OBSERVATION), N_OUT), np.float32),), (np.zeros((1, N_OUT), np.float32),))
    home = ResidualSlush(1.0, network)
    evolve(
        [Trial(partial(generator, 0, "kernels"), EMPTY_POPULATION)],
        lambda designs: evaluate(
            simulate(designs, home, n_settle=1, n_measure=2, physics=physics), disagreement_penalty=1.0
        ),
        first_generation=0,
        n_generations=2,
        afpo=Afpo(population_size=2),
    )


if __name__ == "__main__":
    compile_kernels(Physics.model_validate_json(sys.argv[1]))
