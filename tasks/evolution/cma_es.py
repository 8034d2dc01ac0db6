"""CMA-ES on the controller of a fixed body. Hansen (2016), "The CMA Evolution Strategy: A Tutorial", arXiv:1604.00772.

The first generation is random: its fittest design's body and motors are kept, and its controller is where the search
begins. The other genes of the controller are n numbers x in [0, 1], as :meth:`tasks.design.Designs.to_vector` has them;
samples beyond are reflected, angles go around. Numbers of equations are the tutorial's.
"""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from numpy.random import Generator
from pydantic import Field

from tasks.arrays import Bools, Float64, Int64
from tasks.design import ANY_BODY, Designs, Morphology
from tasks.design.genes import DesignTable, table_of
from tasks.design.morphology import sample_allowed
from tasks.design.variation import MAX_RECOMBINATIONS, draw_random
from tasks.evolution.objectives import Evaluation
from tasks.evolution.search import Arrays, Children, Population, Search, register_search, without_parents
from tasks.parameters import Parameters


def x_of(controller: str, n_links: int) -> tuple[Int64, Bools]:
    """Return where the vector of a design has x, the numbers of its controller, and which of them are angles."""
    of = table_of(controller, n_links)
    varies = [gene is not None and gene.part == "control" and gene.kind != "flag" for gene in of.gene_of_column]
    x = np.flatnonzero(np.array(varies)[of.reals])
    return x, of.columns.is_angle[of.reals[x]]


class CmaEs(Parameters):
    """CMA-ES's parameters; its others follow from n and λ."""

    operators: ClassVar[tuple[str, ...]] = ("random", "sample")
    columns: ClassVar[Mapping[str, str]] = {}

    population_size: int = Field(default=64, ge=4, le=1_000_000)
    """Designs of a generation, λ. The better half recombine."""
    step: float = Field(default=0.2, gt=0.0, le=1.0)
    """First standard deviation σ of a gene, as a share of its range."""

    def ask(
        self, population: Population, rng: Generator, *, body: Designs | None = None, morphology: Morphology = ANY_BODY
    ) -> Children:
        """Return random designs first, then samples of the distribution around its mean (5)."""
        state, n_children = population.extra, self.population_size
        if not state:
            drawn = draw_random(n_children, rng, body=body, morphology=morphology, controller=population.controller)
            return without_parents(population, drawn)
        D, B = _principal_axes(state["C"])

        def draw(which: Int64) -> DesignTable:
            x = state["m"] + state["sigma"] * (rng.standard_normal((len(which), len(D))) * D) @ B.T
            return _with_controllers(population.designs, x)

        first, otherwise = draw(np.arange(n_children)), np.repeat(population.table, n_children, axis=0)
        constraints = morphology.of_controllers()
        drawn = sample_allowed(
            first,
            draw,
            constraints,
            max_draws=MAX_RECOMBINATIONS,
            otherwise=otherwise,
            controller=population.controller,
        )
        return without_parents(population, drawn, operator=1)

    def tell(self, population: Population, children: Children, evaluation: Evaluation, rng: Generator) -> Population:
        """Return the best design so far, and the distribution moved towards the better half of the children."""
        fitness = evaluation.fitness
        best = [int(fitness.argmax())]
        after = population._replace(n_evaluated=population.n_evaluated + self.population_size)
        if population.extra:
            x, is_angle = _controllers(children.designs)
            after = after._replace(extra=self._moved(after, x[np.argsort(-fitness, kind="stable")], is_angle))
        elif np.isfinite(fitness[best]):
            (m,), _ = _controllers(children.designs[best])
            first = {"m": m, "sigma": np.array([self.step]), "C": np.eye(len(m))}
            after = after._replace(extra={**first, "p_sigma": np.zeros(len(m)), "p_c": np.zeros(len(m))})
        if fitness[best] > population.fitness.max(initial=-np.inf):
            after = after._replace(table=children.table[best], fitness=fitness[best], identity=children.identity[best])
        return after

    def _moved(self, population: Population, ranked: Float64, is_angle: Bools) -> Arrays:
        """Return the distribution after a generation, whose (λ, n) samples are ranked, the fittest first."""
        m, sigma, C, p_sigma, p_c = (population.extra[name] for name in ("m", "sigma", "C", "p_sigma", "p_c"))
        n, mu = len(m), self.population_size // 2
        w = np.log((self.population_size + 1) / 2) - np.log(np.arange(1, mu + 1))  # (49)
        w /= w.sum()
        mu_eff = 1 / (w**2).sum()  # (8)
        c_sigma = (mu_eff + 2) / (n + mu_eff + 5)  # (55)
        d_sigma = 1 + 2 * max(0.0, np.sqrt((mu_eff - 1) / (n + 1)) - 1) + c_sigma
        c_c = (4 + mu_eff / n) / (n + 4 + 2 * mu_eff / n)  # (56)
        c_1 = 2 / ((n + 1.3) ** 2 + mu_eff)  # (57)
        c_mu = min(1 - c_1, 2 * (mu_eff - 2 + 1 / mu_eff) / ((n + 2) ** 2 + mu_eff))  # (58)
        norm = np.sqrt(n) * (1 - 1 / (4 * n) + 1 / (21 * n**2))  # E‖N(0, I)‖
        D, B = _principal_axes(C)

        y = ranked[:mu] - m
        y = np.where(is_angle, (y + 0.5) % 1 - 0.5, y) / sigma  # the short way around
        y_w = w @ y  # (41)
        p_sigma = (1 - c_sigma) * p_sigma + np.sqrt(c_sigma * (2 - c_sigma) * mu_eff) * B @ (B.T @ y_w / D)  # (43)
        length, generation = np.sqrt((p_sigma**2).sum()), population.n_evaluated // self.population_size - 1
        h = length / np.sqrt(1 - (1 - c_sigma) ** (2 * generation)) < (1.4 + 2 / (n + 1)) * norm  # the step is short
        p_c = (1 - c_c) * p_c + h * np.sqrt(c_c * (2 - c_c) * mu_eff) * y_w  # (45)
        C = (1 - c_1 - c_mu + (1 - h) * c_1 * c_c * (2 - c_c)) * C + c_1 * np.outer(p_c, p_c) + c_mu * (y.T * w) @ y
        m, sigma = (
            _folded(m + sigma * y_w, is_angle),
            sigma * np.exp(c_sigma / d_sigma * (length / norm - 1)),
        )  # (42), (44)
        return {"m": m, "sigma": sigma, "C": C, "p_sigma": p_sigma, "p_c": p_c}


register_search(Search("cma_es", CmaEs))


def _principal_axes(C: Float64) -> tuple[Float64, Float64]:
    """Return the standard deviations along the principal axes of a covariance matrix, and these axes as columns."""
    variances, B = np.linalg.eigh(C)
    return np.sqrt(np.maximum(variances, 1e-20)), B


def _folded(x: Float64, is_angle: Bools) -> Float64:
    return np.where(is_angle, x % 1, 1 - np.abs(1 - x % 2))


def _controllers(designs: Designs) -> tuple[Float64, Bools]:
    """Return the (n_designs, n) x of designs with equally many links, and which of the numbers are angles."""
    compact = designs.compact()
    places, is_angle = x_of(designs.controller, compact.room)
    return compact.to_vector()[:, places], is_angle


def _with_controllers(body: Designs, x: Float64) -> DesignTable:
    """Return (n_designs, n_columns) designs with the body and motors of one and the controllers (n_designs, n) x."""
    own = body.compact()
    (places, is_angle), reals = x_of(own.controller, own.room), table_of(own.controller, own.room).reals
    vector, table = (np.repeat(each, len(x), axis=0) for each in (own.to_vector(), own.table))
    vector[:, places] = _folded(x, is_angle)
    table[:, reals[places]] = Designs.from_vector(vector, own.controller).table[:, reals[places]]
    return Designs.from_table(table, own.controller).with_room(body.room).table
