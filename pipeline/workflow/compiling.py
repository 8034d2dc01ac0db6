"""Compilation of the kernels before the workers start, so that they find them instead of compiling their own."""

from functools import partial

import numpy as np

from tasks.evolution import Afpo, Trial, evaluate, evolve
from tasks.residual.ensemble import Ensemble
from tasks.residual.forms.plain import PLAIN
from tasks.seeding import generator
from tasks.simulation import simulate
from tasks.world import Physics, ResidualSlush


def compile_kernels(physics: Physics) -> None:
    """Compile the kernels that are not in the cache: evolve two robots for two generations in a network."""
    weight = np.zeros((1, len(PLAIN.inputs), len(PLAIN.outputs)), np.float32)
    network = Ensemble((weight,), (weight[:, 0],), PLAIN)
    home = ResidualSlush(1.0, network)
    evolve(
        [Trial(partial(generator, 0, "kernels"))],
        lambda designs: evaluate(
            simulate(designs, home, n_settle=1, n_measure=2, physics=physics), disagreement_penalty=1.0
        ),
        first_generation=0,
        n_generations=2,
        search=Afpo(population_size=2),
    )
