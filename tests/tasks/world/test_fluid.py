"""The medium that is a fluid: each robot and each thrown bar is alone in its flume, wherever it is computed."""

import numpy as np
import pytest

import puddle
from tasks.design import random_designs
from tasks.residual.throws import Throws, initial_states, simulate_throws
from tasks.simulation.scenes import scenes_along
from tasks.world import Physics, Pool, TrueSlush
from tasks.world.fluid import FluidFlume

DESIGNS = random_designs(3, np.random.default_rng(7))
SMALL = FluidFlume(length=8.0, bar_length=6.0, bar_depth=3.0)
DURATION = {"n_settle": 5, "n_measure": 60, "trace": True}


def test_a_robot_moves_the_same_alone_and_among_others():
    together = puddle.simulate(DESIGNS, Pool(1.0, SMALL), **DURATION)
    assert (together.status == "ok").all()
    for k in (2, 0):
        alone = puddle.simulate(DESIGNS[k : k + 1], Pool(1.0, SMALL), **DURATION)
        np.testing.assert_array_equal(alone.trace[0], together.trace[k])


def test_both_engines_agree():
    batch, reference = (
        puddle.simulate(DESIGNS, Pool(1.0, SMALL), engine=engine, **DURATION).trace for engine in ("batch", "reference")
    )
    np.testing.assert_array_equal(batch, reference)


def test_there_is_no_water_over_ground_at_the_surface():
    wet, dry = (puddle.simulate(DESIGNS, at, **DURATION).trace for at in (Pool(0.0, SMALL), puddle.DryLand(0.0)))
    np.testing.assert_array_equal(wet, dry)


def test_thrown_bars_lose_speed_under_water_and_end_afloat():
    starts = initial_states(Throws(n_throws=4, n_steps=200), np.random.default_rng(0), Physics())
    thrown = simulate_throws(starts, 200, SMALL, Physics())
    speed = np.hypot(*thrown.state[:, 3:5].T).reshape(4, 200)
    assert np.isfinite(thrown.state).all()
    assert (speed[:, -1] < 0.5 * speed[:, 0].max()).all()


def test_films_show_the_water_of_the_rollout():
    """The water begins a step later, after which links have hardly moved."""
    kept = []

    class Kept(FluidFlume):
        def start(self, links, physics, depth):
            kept.append(super().start(links, physics, depth))
            return kept[-1]

    medium = Kept(length=8.0)
    trace = puddle.simulate(DESIGNS[:1], Pool(1.0, medium), **DURATION).trace[0]
    flume = next(iter(kept[0].flumes.values()))
    scenes = scenes_along(DESIGNS[:1], trace, Pool(1.0, medium), Physics())
    assert len(scenes) == len(trace) - 1
    surface, particles, period = scenes[-1]
    assert np.ptp(flume.water.rise) > 0.1 and period == 8.0
    np.testing.assert_allclose(surface[:, 1], flume.water.rise, atol=0.02)
    assert (particles[:, 1] >= -1.0).all()
    assert (particles[:, 1] <= np.interp(particles[:, 0], *surface.T, period=period) + 1e-9).all()
    assert np.abs(particles - flume.places(0.5)).max() > 0.1
    assert not scenes_along(DESIGNS[:1], trace, TrueSlush(1.0), Physics())


def test_links_are_wide_enough_for_the_cells():
    with pytest.raises(ValueError, match="spacing"):
        FluidFlume(spacing=0.26)
    with pytest.raises(ValueError, match=r"fluid.spacing: expected links at least 0.31 m wide, got 0.25 m"):
        puddle.throw(FluidFlume(spacing=0.25), Throws(length_scales=(4.0,), n_throws=2, n_steps=2))
