"""Packing: designs as the lanes of the tree engine."""

import numba
import numpy as np
import pytest

from tasks.design import concatenate, random_designs
from tasks.simulation.trees import contact, packing
from tasks.simulation.trees.groups import Groups
from tasks.simulation.trees.layout import N_ROWS, VERTEX_1
from tasks.world import Physics

PHYSICS = Physics()


def test_the_joints_order_is_a_search_with_a_stack():
    # A star: the root's joints, latest first. A chain: one after the other.
    assert packing.discovery_order([-1, 0, 0, 0, 0, 0]) == [0, 5, 4, 3, 2, 1]
    assert packing.discovery_order([-1, 0, 1, 2, 3, 4]) == [0, 1, 2, 3, 4, 5]
    # Joints of the root: 3, 1. Then off the stack: link 1 (pushed last) with joint 2, link 2 with 5 and 4; link 3.
    assert packing.discovery_order([-1, 0, 1, 0, 2, 2]) == [0, 3, 1, 2, 5, 4]
    for parents in packing.TREES:
        order = packing.discovery_order(parents)
        assert sorted(order) == list(range(6))
        assert all(order.index(parents[link]) < order.index(link) for link in range(1, 6))


def test_mass_and_inertia_of_a_box():
    half_height = np.linspace(0.5, 1.5, 9, dtype=np.float32)[None]
    inverse_mass, inverse_inertia = packing.inverse_mass_and_inertia(np.float32(0.25) / half_height, half_height, 2.0)
    a = 2 * half_height.astype(float)
    np.testing.assert_allclose(1 / inverse_mass, 2.0, rtol=1e-6)  # a few roundings of 6e-8
    np.testing.assert_allclose(1 / inverse_inertia, 2.0 * (a**2 + a**-2) / 12, rtol=1e-6)


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="too slow in plain Python")
def test_packing_keeps_what_was_put_in():
    designs = random_designs(45, np.random.default_rng(8))
    groups = Groups(designs, PHYSICS, n_members=2, n_lanes=16)
    assert groups.blocks.shape == (6, N_ROWS, 16)  # 90 robots
    again = Groups(concatenate([designs, designs]), PHYSICS, n_members=1, n_lanes=16)
    np.testing.assert_array_equal(groups.blocks, again.blocks)
    assert (groups.blocks[:, VERTEX_1] == contact.NO_VERTEX).all()
