import numpy as np
import pytest

from tasks.analysis.hallucination import disagreement, link_states, size
from tasks.design import random_designs
from tasks.simulation import simulate
from tasks.world import LinkStates, Physics, ResidualSlush, Slush

PHYSICS = Physics()


def test_a_planted_hallucination_is_located(study):
    """Right links and steps: one of four says 3 m/s², the others 0, a deviation of 3 √(3/16), along x alone."""
    found = disagreement(study.designs, study.trace, study.planted, PHYSICS)
    false = study.planted.lies(link_states(study.designs, study.trace, PHYSICS))
    rounding = 60 * 2**-22  # float32's, of a velocity over a step
    assert 100 < false.sum() < 0.2 * false.size
    assert found[false] == pytest.approx(study.planted.thrust * np.sqrt(3) / 4, abs=rounding)
    assert not found[~false].any()


def test_states_of_a_trace_are_those_that_the_engine_shows_a_medium():
    """A medium that remembers what it is asked: entry i of the trace is what it is asked in step i + 1."""
    asked = []

    class Witness:
        n_members = 1

        def velocity_change(self, links, physics):
            asked.append(links)
            return Slush().velocity_change(links, physics)

    designs = random_designs(2, np.random.default_rng(1))
    environment = ResidualSlush(depth=2.0, ensemble=Witness())
    trace = simulate(designs, environment, n_settle=0, n_measure=30, engine="reference", trace=True).trace
    links = link_states(designs, trace, PHYSICS)
    assert links.y.shape == (1, 2, 30, 6)
    for name in vars(links):
        seen = np.stack([getattr(state, name)[0] for state in asked[1:]], axis=1)
        assert getattr(links, name)[0, :, :-1] == pytest.approx(seen, abs=2e-6), name  # Box2D has its own cosine


def test_the_size_of_an_acceleration_is_that_of_the_links_points():
    """The mean square over a 2 m × 0.5 m link of 3 kg, of a = (3, 4) and α = 2, point by point."""
    links = LinkStates(*np.array([[2.0], [3.0], [3 * (4 + 0.25) / 12], *[[0.0]] * 6]))
    x, y = np.meshgrid((np.arange(400) + 0.5) / 800 - 0.25, (np.arange(400) + 0.5) / 200 - 1)
    mean_square = np.mean((3 - 2 * y) ** 2 + (4 + 2 * x) ** 2)
    assert size(np.array([[3.0, 4.0, 2.0]]), links)[0] == pytest.approx(np.sqrt(mean_square), rel=1e-5)
