"""Compilation of the kernels while the cluster starts."""

import contextlib
import subprocess
import sys
from collections.abc import Iterator
from functools import partial

import numpy as np

from tasks.evolution import EMPTY_POPULATION, Afpo, Trial, evaluate, evolve
from tasks.residual.ensemble import N_OUT, Ensemble
from tasks.residual.observation import OBSERVATION
from tasks.seeding import generator
from tasks.simulation import simulate
from tasks.world import Physics, ResidualSlush


@contextlib.contextmanager
def compiling(physics: Physics) -> Iterator[None]:
    """Compile the kernels that this machine lacks in another process; the end of the block waits for it.

    So the workers find them, where each would compile its own. Those of another machine of a cluster do.

    Args:
        physics: constants of the base simulator, which decide on the kernels.
    """
    process = subprocess.Popen(
        [sys.executable, "-P", "-m", "pipeline.workflow.compiling", physics.model_dump_json()],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,  # so that Ctrl-C reaches the study alone, which ends this process
    )
    try:
        yield
        process.wait()
    finally:
        process.terminate()
        process.wait()


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
