"""Controllers in the engines: the sine, θ*(t) = rest + range · sin(2π f t + phase), and what joints sense."""

from dataclasses import replace

import numpy as np
import pytest

from tasks.design import random_designs
from tasks.design.controllers import Joint
from tasks.simulation import simulate
from tasks.simulation.controller import Controllers, sensing, sine_of_turns
from tasks.world import DryLand, Physics, TrueSlush

DT = 1 / 60
EPS32 = 2.0**-24
"""Relative rounding of float32."""


def test_the_sine_is_as_good_as_stated() -> None:
    turns = np.concatenate([np.linspace(-2, 2, 400_001), np.random.default_rng(41).uniform(-100, 100, 200_000)])
    turns = turns.astype(np.float32)
    sine = sine_of_turns(turns)
    assert sine.dtype == np.float32
    # Whole turns come off exactly, so that the error is the polynomial's at any number of turns.
    assert np.abs(sine - np.sin(2 * np.pi * turns.astype(np.float64))).max() < 3e-7


def test_the_target_angle() -> None:
    designs = random_designs(50, np.random.default_rng(42))
    controllers, still = Controllers(designs, Physics(), 9.0), np.zeros((1, 50, 6, 6), np.float32)
    for step in (0, 1, 199, 1399, 5999):
        expected = designs.rest_angle + designs.motion_range * np.sin(
            2 * np.pi * designs.frequency[:, None] * step * DT + designs.phase
        )
        # Turns are counted up to f t + 1, rounded in f, in dt, in their products and in the sum: five times. The rest
        # is the sine's own error and the rounding of two numbers up to 5 rad.
        turns = designs.frequency[:, None] * step * DT + 1
        tolerance = np.pi / 2 * (2 * np.pi * 5 * EPS32 * turns + 3e-7) + 3 * EPS32 * 5
        assert (np.abs(controllers.target_angle(step, still, still, still) - expected)[:, :, 1:] <= tolerance).all()


@pytest.mark.parametrize("environment", [DryLand(0.0), TrueSlush(2.0)], ids=["dry", "slush"])
@pytest.mark.parametrize("controller", ["reflex", "phase"])
def test_without_gains_they_are_the_paper_s(controller, environment) -> None:
    designs = random_designs(5, np.random.default_rng(3))
    same = simulate(designs, environment, n_measure=100, trace=True)
    blind = simulate(replace(designs, controller=controller), environment, n_measure=100, trace=True)
    np.testing.assert_array_equal(blind.trace, same.trace)


def test_what_a_link_senses() -> None:
    """Upright and lying links, half under water or on the ground: 2 m long, so its half sizes are 1 and 1/4 m."""
    y, lies = np.array([0.0, 0.5, -3.0, -2.78, -3.75, -3.72], np.float32), np.array([0, 0, 0, 0, 1, 1], np.float32)
    knows, zero = Joint(*[np.float32(0)] * 7), np.float32(0)
    joint = sensing(knows, zero, zero, np.float32(2), y, 1 - lies, lies, zero, np.float32(-4))
    np.testing.assert_allclose(joint.wet, [0.5, 0.25, 1, 1, 1, 1], atol=1e-6)
    assert joint.contact.tolist() == [0, 0, 1, 0, 1, 0]  # 0, 0.22, 0 and 0.03 m above the ground; the skins are 0.02 m


def test_loads_hold_an_oscillator_back_and_its_neighbours_pull_it() -> None:
    """dlead/dt = load · (target - angle) + coupling · Σ sin(2π (a neighbour's - lead)), the children's a step old."""
    designs = random_designs(20, np.random.default_rng(8), controller="phase")
    controllers = Controllers(designs, Physics(), 9.0)
    state = np.random.default_rng(9).normal(size=(1, 20, 6, 6)).astype(np.float32)
    of_children = np.zeros((1, 20, 6))
    for step in range(3):
        before = np.broadcast_to(controllers._joint.memory, (1, 20, 6)).astype(float)
        target = controllers.target_angle(step, state, np.zeros(()), np.zeros(()))
        parent = np.maximum(designs.parent, 0)[None]
        turned = controllers.less_parent(state[..., 2])
        pull = np.sin(2 * np.pi * (np.take_along_axis(before, parent, 2) - before))
        rate = designs.gains[:, 0] * (target - turned) + designs.gains[:, 1] * (pull + of_children)
        of_children = np.stack([-(pull * (designs.parent == link)).sum(axis=2) for link in range(6)], axis=2)
        expected = before + rate * DT * (np.arange(6) > 0)
        np.testing.assert_allclose(controllers._joint.memory, expected, rtol=1e-5, atol=1e-6)
    assert (of_children[..., 1:] != 0).any()
