"""MAP-Elites: an archive of the fittest design of each cell."""

import numpy as np
from trials import run

from tasks.design import Designs, random_designs
from tasks.evolution.map_elites import MEASURES, MapElites, measure_bodies


def test_each_cell_holds_its_fittest_design() -> None:
    search = MapElites(population_size=20, cells=(4, 3))
    population, history = run([30], search)
    measures = np.stack([history[name] for name in MEASURES], axis=1)
    np.testing.assert_array_equal(measures, measure_bodies(Designs.from_arrays(history)))
    low, high = np.array([*MEASURES.values()]).T
    cell = np.clip((measures - low) / (high - low) * search.cells, 0, np.array(search.cells) - 1).astype(int)
    fittest = {}
    for row in np.flatnonzero(np.isfinite(history["fitness"])):
        best = fittest.setdefault(tuple(cell[row]), row)
        if history["fitness"][row] > history["fitness"][best]:
            fittest[tuple(cell[row])] = row
    held = zip(map(tuple, population.extra["cell"].tolist()), population.identity.tolist(), strict=True)
    assert dict(held) == fittest and len(fittest) > 6


def test_measures_of_a_body() -> None:
    """Six upright links of 1 m by 1 m on one point are 1 m long and 6 m in size; a link of 2 m by 0.5 m that lies
    across, joined at its end to the root's centre, reaches 2 m from there."""
    zeros = {name: np.zeros_like(array) for name, array in random_designs(1, np.random.default_rng(0)).arrays()}
    parent = np.array([[-1, 0, 0, 0, 0, 0]])
    compact = Designs(**{**zeros, "parent": parent, "length_scale": np.ones((1, 6))})
    np.testing.assert_allclose(measure_bodies(compact), [[1.0, 6.0]])
    last = np.eye(6)[5:]
    across = {"length_scale": 1 + last, "rest_angle": np.pi / 2 * last, "child_attachment": last}
    long = Designs(**{**zeros, "parent": parent, **across})
    np.testing.assert_allclose(measure_bodies(long), [[2.5, 7.0]])
