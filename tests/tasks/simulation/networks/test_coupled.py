"""Networks and an engine in one kernel: the same bits as asking the networks between two steps, however robots lie."""

import numba
import numpy as np
import pytest
from both_engines import networks
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tasks.design import random_designs
from tasks.residual.observation import INPUTS, OBSERVATION
from tasks.simulation.batch import scene_of
from tasks.simulation.networks import coupled
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
    inputs=st.sampled_from([OBSERVATION, tuple(INPUTS)]),
    seed=st.integers(0, 2**32 - 1),
)
@example(n_designs=N_LANES, n_lanes=widest(), inputs=OBSERVATION, seed=0)  # all vectors move whole
@example(n_designs=N_LANES + N_LANES // 2, n_lanes=widest(), inputs=tuple(INPUTS), seed=0)  # some do
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


@settings(deadline=None)
@example(n_designs=2 * N_LANES, n_members=3, n_lanes=2 * N_LANES)
@example(n_designs=N_LANES, n_members=4, n_lanes=2 * N_LANES)
@given(n_designs=st.integers(1, 40), n_members=st.integers(1, 4), n_lanes=st.sampled_from([1, 4, 16, 32]))
def test_every_link_is_tied_to_a_row_of_its_own_member(n_designs, n_members, n_lanes):
    """One of its own; lanes that are left over, to the last robot's. And vectors move whole wherever they can."""
    n_robots = n_members * n_designs
    blocks = np.zeros((-(-n_robots // n_lanes), 7, n_lanes), np.float32)
    nets = coupled.PackedNetworks(
        [np.zeros((n_members, 6, 3), np.float32)], [np.zeros((n_members, 3), np.float32)], ((False, ("y",)),) * 6
    )
    coupling = coupled.couple(nets, blocks, n_robots)
    wide = coupling.whole.rows[:, None] * N_LANES + np.arange(N_LANES)[:, None]
    places = np.concatenate([wide.reshape(-1, 3), coupling.single.rows])
    group, link, lane = np.unravel_index(places[:, 0], blocks.shape)
    place = group * n_lanes + lane
    assert sorted(zip(place, link, strict=True)) == [(i, k) for i in range(len(blocks) * n_lanes) for k in range(6)]
    robot = np.minimum(place, n_robots - 1)
    for column, array in ((1, coupling.x), (2, coupling.out)):
        member, _, number, _ = np.unravel_index(places[:, column], array.shape)
        assert (member == robot // n_designs).all() and (number == 0).all()
        rows_of = dict(zip(zip(robot, link, strict=True), places[:, column], strict=True))
        assert len(set(rows_of.values())) == len(rows_of) == 6 * n_robots
        assert [rows_of[key] for key in zip(robot, link, strict=True)] == places[:, column].tolist()
    if n_designs % N_LANES == 0 and n_lanes % N_LANES == 0 and n_robots % n_lanes == 0:
        assert len(coupling.single.rows) == 0
    if n_lanes < N_LANES:
        assert len(coupling.whole.rows) == 0
