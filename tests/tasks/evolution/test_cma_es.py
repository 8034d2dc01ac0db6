"""CMA-ES: on a landscape of known optimum it converges there, on angles and reflected bounds."""

import numpy as np
from trials import run

from tasks.design import GENES, Designs, Morphology
from tasks.design.morphology import LinkLimits
from tasks.evolution import Evaluation
from tasks.evolution.cma_es import CmaEs, x_of

X, IS_ANGLE = x_of("open_loop", 6)


def test_it_converges_on_an_optimum_around_the_corner() -> None:
    """An ill-conditioned bowl around angles of 0.99 and other genes of 0.95, coupled in pairs."""
    optimum = np.where(IS_ANGLE, 0.99, 0.95)
    scales = np.logspace(0, 1, len(X))

    def bowl(designs: Designs) -> Evaluation:
        away = designs.to_vector()[:, X] - optimum
        away = np.where(IS_ANGLE, (away + 0.5) % 1 - 0.5, away)
        away = away + 0.3 * np.roll(away, 1, axis=1)
        fitness = -((away * scales) ** 2).sum(axis=1)
        return Evaluation(fitness, *[fitness[:, None]] * 3)

    population, history = run([170], CmaEs(population_size=16), score=bowl)
    assert population.fitness[0] > -1e-8
    np.testing.assert_allclose(population.designs.to_vector()[0, X], optimum, atol=1e-4)
    first = history["generation"] == 0
    for name in ("parent", "motor_on", *(gene.name for gene in GENES if gene.part == "body")):
        fixed = history[name][~first]
        assert (fixed == fixed[0]).all() and (history[name][first] == fixed[0]).all(axis=1).sum() == 1, name


def test_it_keeps_the_number_of_links_of_its_body() -> None:
    """Of 2 to 9; the first generation has designs of all numbers."""
    morphology = Morphology(n_links=LinkLimits(least=2, most=9))
    population, history = run([4], CmaEs(population_size=16), morphology=morphology)
    n_links = 1 + (history["parent"] >= 0).sum(axis=1)
    first = history["generation"] == 0
    assert len(set(n_links[first])) > 4 and set(n_links[~first]) == set(population.designs.n_links)
