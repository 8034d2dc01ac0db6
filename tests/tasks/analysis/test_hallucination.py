import numpy as np
import pytest

from tasks.analysis.hallucination import disagreement_along
from tasks.design import random_designs
from tasks.simulation import simulate
from tasks.world import Physics, ResidualSlush, Slush, VelocityChange

PHYSICS = Physics()


def test_a_planted_hallucination_is_located(study):
    """Right links and steps: one of four says 3 m/s², the others 0, a deviation of 3 √(3/16), along x alone."""
    found = disagreement_along(study.designs, study.trace, study.planted, PHYSICS)
    length_scale = np.broadcast_to(study.designs.length_scale[:, None], found.shape)
    false = (length_scale > 2.5) & (study.trace[..., 1] < 0)
    rounding = 60 * 2**-22  # float32's, of a velocity over a step
    assert 100 < false.sum() < 0.2 * false.size
    assert found[false] == pytest.approx(study.planted.thrust * np.sqrt(3) / 4, abs=rounding)
    assert not found[~false].any()


class Witness:
    """A medium that remembers what it is asked."""

    n_members = 1

    def __init__(self):
        self.asked = []

    def velocity_change(self, links, physics):
        self.asked.append(links)
        return Slush().velocity_change(links, physics)


def test_states_of_a_trace_are_those_that_the_engine_shows_a_medium():
    """Entry i of the trace is what a medium is asked in step i + 1."""
    designs, engine, analysis = random_designs(2, np.random.default_rng(1)), Witness(), Witness()
    environment = ResidualSlush(depth=2.0, ensemble=engine)
    trace = simulate(designs, environment, n_settle=0, n_measure=30, engine="reference", trace=True).trace
    disagreement_along(designs, trace[0], analysis, PHYSICS)
    (links,) = analysis.asked
    assert links.y.shape == (1, 2, 30, 6)
    for name in set(vars(links)) - {"parent", "kick_vx", "kick_vy", "kick_omega"}:
        seen = np.stack([getattr(state, name)[0] for state in engine.asked[2:]], axis=1)  # it is asked twice in step 1
        assert getattr(links, name)[0, :, :-1] == pytest.approx(seen, abs=2e-6), name  # Box2D has its own cosine


class Opposed:
    """Two members that accelerate links by ± (3, 4) m/s² and ± 2 rad/s²."""

    n_members = 2

    def velocity_change(self, links, physics):
        sign = np.array([-1.0, 1.0]).reshape(2, 1, 1, 1) * np.ones(links.y.shape)
        return VelocityChange(*(sign * size * physics.time_step for size in (3.0, 4.0, 2.0)))


def test_disagreement_is_the_root_mean_square_of_a_links_points():
    """Point by point over a link of length a, of a = (3, 4) and α = 2."""
    designs = random_designs(1, np.random.default_rng(1))
    length = designs.length_scale[0, 0]
    x, y = np.meshgrid((np.arange(400) + 0.5) / 400 - 0.5, (np.arange(400) + 0.5) / 400 - 0.5)
    mean_square = np.mean((3 - 2 * y * length) ** 2 + (4 + 2 * x / length) ** 2)
    found = disagreement_along(designs, np.zeros((1, 1, 6, 6), np.float32), Opposed(), PHYSICS)
    assert found[0, 0, 0] == pytest.approx(np.sqrt(mean_square), rel=1e-5)
