"""Networks and an engine in one kernel: the same bits as asking the networks between two steps, however robots lie."""

import numba
import numpy as np
import pytest
from both_engines import networks
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tasks.design import random_designs
from tasks.residual.observation import INPUTS, OBSERVATION
from tasks.residual.wetted import WETTED
from tasks.simulation.batch import scene_of
from tasks.simulation.networks.tiles import N_LANES
from tasks.simulation.simd.lanes import widest
from tasks.simulation.trees.groups import Groups
from tasks.world import Physics, ResidualSlush

pytestmark = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="the ensemble uses torch then")

PHYSICS = Physics()


@settings(deadline=None, max_examples=25)
@given(
    n_designs=st.integers(1, 3 * N_LANES),
    n_lanes=st.sampled_from([widest(), widest() // 2, 1]),
    inputs=st.sampled_from([OBSERVATION, tuple(INPUTS), WETTED]),
    seed=st.integers(0, 2**32 - 1),
)
@example(n_designs=N_LANES, n_lanes=widest(), inputs=OBSERVATION, seed=0)  # all vectors move whole
@example(n_designs=N_LANES + N_LANES // 2, n_lanes=widest(), inputs=tuple(INPUTS), seed=0)  # some do
@example(n_designs=N_LANES + 1, n_lanes=widest(), inputs=WETTED, seed=0)
@example(n_designs=1, n_lanes=widest() // 2, inputs=OBSERVATION, seed=0)  # none does, and lanes are left over
def test_one_kernel_gives_the_bits_of_asking_between_steps(n_designs, n_lanes, inputs, seed):
    rng = np.random.default_rng(seed)
    environment = ResidualSlush(1.0, networks(rng, inputs))
    designs, scene = random_designs(n_designs, rng), scene_of(environment, PHYSICS)
    together, apart = (Groups(designs, PHYSICS, n_members=3, n_lanes=n_lanes) for _ in range(2))
    together.advance(scene, 0, 0, None)
    together.advance_with_networks(environment.ensemble.networks, scene, 0, 12)
    apart.advance(scene, 0, 0, None)
    for step in range(12):
        apart.push(environment.ensemble)
        apart.advance(scene, step, 1, None)
    np.testing.assert_array_equal(together.poses(), apart.poses())
