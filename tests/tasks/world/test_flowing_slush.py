"""Flowing slush: the slush for velocities relative to the flow."""

import numpy as np

from tasks.simulation.free_links import FreeLinks
from tasks.world import Physics, Slush
from tasks.world.flowing_slush import FlowingSlush


def drifted(medium: Slush, n_steps: int) -> np.ndarray:
    links = FreeLinks(np.array([2.0]), Physics())
    state = np.array([[0, -0.6, 0, 0, 0, 0]], dtype=np.float32)  # at its floating depth
    for _ in range(n_steps):
        state = links.step(state, medium)
    return state[0]


def test_it_carries_a_link_at_rest() -> None:
    # Drag on four fifths of the link: u' = -k u² for the velocity u relative to the flow, so u = u0 / (1 + k u0 t).
    k, flow, seconds = 0.8 * 0.625 * 10, 1.5, 2.0
    state = drifted(FlowingSlush(current=flow), 120)
    np.testing.assert_allclose(state[3], flow - flow / (1 + k * flow * seconds), rtol=1e-3)


def test_without_a_current_it_is_the_slush() -> None:
    np.testing.assert_array_equal(drifted(FlowingSlush(current=0.0), 20), drifted(Slush(), 20))
