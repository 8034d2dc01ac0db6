"""Single links against closed forms: free fall, sinking and floating in slush. No ground, no joints."""

import numpy as np
import pytest
from links_in_box2d import ReferenceFreeLinks

from tasks.world import Medium, Physics, Slush
from tasks.world.slush import submerged_part

DT, G = 1 / 60, 9.8
EPS32 = 2.0**-24
"""Relative rounding of float32."""

X, Y, ANGLE, VX, VY, OMEGA = range(6)


def run(links: ReferenceFreeLinks, state: np.ndarray, medium: Medium | None, n_steps: int) -> np.ndarray:
    """States after each step, (n_steps, n_links, 6)."""
    states = []
    for _ in range(n_steps):
        state = links.step(state.astype(np.float32), medium)
        states.append(state)
    return np.array(states, dtype=np.float64)


def at_rest(n: int, *, y: float, angle: np.ndarray | float = 0.0) -> np.ndarray:
    state = np.zeros((n, 6), dtype=np.float32)
    state[:, Y], state[:, ANGLE] = y, angle
    return state


def test_free_fall() -> None:
    n_steps = 120
    start = at_rest(3, y=2.0)
    start[:, VX], start[:, OMEGA] = 3.0, 2.0
    states = run(ReferenceFreeLinks(np.array([1.0, 2.0, 3.0]), Physics()), start, None, n_steps)
    n = np.arange(1, n_steps + 1)[:, None]
    # Semi-implicit Euler: v takes its change first, then x moves by the new v. So v_n = -g n dt and
    # y_n = y_0 - g dt² (1 + 2 + … + n). Each step rounds v and the product g dt, and then y and the product v dt.
    v_error = 2 * n * EPS32 * G * n * DT
    y_error = np.cumsum(v_error, axis=0) * DT + 2 * n * EPS32 * 20
    assert (np.abs(states[..., VY] + G * n * DT) <= v_error).all()
    assert (np.abs(states[..., Y] - (2.0 - G * DT**2 * n * (n + 1) / 2)) <= y_error).all()
    assert (np.abs(states[..., X] - 3.0 * n * DT) <= 2 * n * EPS32 * 6).all()
    assert (np.abs(states[..., ANGLE] - 2.0 * n * DT) <= 2 * n * EPS32 * 4).all()
    assert (states[..., VX] == 3.0).all()
    assert (states[..., OMEGA] == 2.0).all()


@pytest.mark.parametrize("density", [2.0, 5.0])
@pytest.mark.parametrize("v0", [0.0, -25.0])
def test_terminal_velocity_of_a_link_that_sinks(density: float, v0: float) -> None:
    start = at_rest(3, y=-20.0, angle=np.array([0.0, 0.7, np.pi / 2], dtype=np.float32))
    start[:, VY] = v0
    links = ReferenceFreeLinks(np.array([1.0, 2.0, 3.0]), Physics(link_density=density))
    speed = -run(links, start, Slush(), 300)[-1, :, VY]
    # Wholly submerged, A_s = 1 m² and m = density. In steps, a speed s (downward) becomes s / (1 + k s dt) + b with
    # k = ½ ρ C_dl / m and b = (g - ρ g / m) dt. Its fixed point solves k dt s² - b k dt s - b = 0.
    k, b = 0.5 * 1.25 * 10.0 / density, (G - 1.25 * G / density) * DT
    terminal = (b + np.sqrt(b * b + 4 * b / (k * DT))) / 2
    # Near it an error shrinks in each step by 1 / (1 + k s dt)², so of some six roundings a step at most their sum
    # over the steps that it takes to forget them, 1 / (1 - that), is left.
    forgets = 1 / (1 - (1 + k * terminal * DT) ** -2)
    np.testing.assert_allclose(speed, terminal, rtol=0, atol=6 * EPS32 * terminal * forgets)
    # The differential equation's own, √((g - ρ g / m) / k), lies within b of it.
    assert abs(terminal - np.sqrt(b / DT / k)) < b


def test_a_link_floats_with_four_fifths_submerged() -> None:
    lengths = np.array([1.0, 2.0, 3.0, 2.0, 2.0])
    angle = np.array([0.0, 0.0, 0.0, np.pi / 2, 0.8], dtype=np.float32)
    seconds = 60
    states = run(ReferenceFreeLinks(lengths, Physics()), at_rest(5, y=0.0, angle=angle), Slush(), seconds * 60)[-1]
    area, _ = submerged_part(lengths, states[:, Y], np.cos(states[:, ANGLE]), np.sin(states[:, ANGLE]))
    # Archimedes: ρ A_s = m, so A_s = 1 / 1.25. A link bobs about it with ω² = ρ g w / m, w its length at the water
    # line, and quadratic drag of k = ½ ρ C_dl A_s / m = 5 /m takes the amplitude A down by dA/dt = -(4 / 3π) k ω A²
    # (the loss of energy averaged over a period), so that A = 1 / ((4 / 3π) k ω t) however it began. The area is off
    # by w A at most. An amplitude half as large again covers what averaging leaves out.
    at_line = np.array([1 / 1.0, 1 / 2.0, 1 / 3.0, 2.0, (1 / 2.0) / np.cos(0.8)])
    omega = np.sqrt(1.25 * G * at_line)
    amplitude = 1 / (4 / (3 * np.pi) * 5.0 * omega * seconds)
    assert (np.abs(area - 0.8) <= 1.5 * at_line * amplitude).all()
    np.testing.assert_array_equal(states[:, ANGLE].astype(np.float32), angle)  # there is no buoyant torque
