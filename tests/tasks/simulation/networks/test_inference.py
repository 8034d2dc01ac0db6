"""Networks on a CPU: their sums' order and rounding, torch's results, and what is not finite. See test_ensemble.py."""

from fractions import Fraction
from itertools import pairwise

import numba
import numpy as np
import pytest
import torch

from tasks.simulation.networks.inference import PackedNetworks
from tasks.simulation.networks.tiles import TILE_UNITS

pytestmark = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="the ensemble uses NumPy then")


def networks(hidden_layers, width, n_members=3):
    rng = np.random.default_rng(0)
    sizes = [6, *[width] * hidden_layers, 3]
    weights = [(rng.normal(size=(n_members, a, b)) / np.sqrt(a)).astype(np.float32) for a, b in pairwise(sizes)]
    biases = [(0.2 * rng.normal(size=(n_members, b))).astype(np.float32) for b in sizes[1:]]
    return weights, biases


def rows(n_rows, n_members=3):
    return np.random.default_rng(1).normal(size=(n_members, n_rows, 6)).astype(np.float32)


def by_torch(weights, biases, x):
    h = torch.from_numpy(x)
    for i, (weight, bias) in enumerate(zip(weights, biases, strict=True)):
        h = torch.baddbmm(torch.from_numpy(bias)[:, None], h, torch.from_numpy(weight))
        h = h.relu() if i < len(weights) - 1 else h
    return h.numpy()


@pytest.mark.parametrize(("hidden_layers", "width"), [(1, 5), (2, 32), (2, 48), (2, 64), (3, 100), (3, 128), (4, 256)])
def test_equals_torch(hidden_layers, width):
    weights, biases = networks(hidden_layers, width)
    x = rows(217)
    expected = by_torch(weights, biases, x)
    got = PackedNetworks(weights, biases).forward(x)
    assert got.shape == (3, 217, 3) and got.dtype == np.float32
    assert abs(got - expected).max() < 1e-5 * abs(expected).max()


def rounded(exact):
    """The float32 nearest to a fraction; ties go to the even one."""
    near = np.float32(float(exact))
    candidates = [near, np.nextafter(near, np.float32(np.inf)), np.nextafter(near, np.float32(-np.inf))]
    return min(candidates, key=lambda c: (abs(Fraction(float(c)) - exact), int(c.view(np.int32)) & 1))


@pytest.mark.parametrize("width", [1, TILE_UNITS + 1])  # of half a tile, and of one and a half
def test_sums_run_over_the_inputs_in_their_order_rounded_once_per_input(width):
    # So the bits are those of any machine with fused multiply-adds, whatever its vectors.
    weights, biases = networks(2, width, n_members=1)
    x = rows(3, n_members=1)
    got = PackedNetworks(weights, biases).forward(x)[0]
    for row in range(3):
        h = list(x[0, row])
        for i, (weight, bias) in enumerate(zip(weights, biases, strict=True)):
            sums = list(bias[0])
            for k, value in enumerate(h):
                sums = [
                    rounded(Fraction(float(value)) * Fraction(float(w)) + Fraction(float(s)))
                    for w, s in zip(weight[0, k], sums, strict=True)
                ]
            h = [max(s, np.float32(0)) for s in sums] if i < len(weights) - 1 else sums
        assert (got[row] == h).all()


@pytest.mark.parametrize("poison", [np.nan, np.inf])
def test_what_is_not_finite_stays_in_its_row(poison):
    network, x = PackedNetworks(*networks(2, 64)), rows(100)
    clean = network.forward(x)
    x[1, 37, 2] = poison
    got = network.forward(x)
    hit = np.zeros((3, 100), bool)
    hit[1, 37] = True
    assert not np.isfinite(got[hit]).any()
    assert (got[~hit] == clean[~hit]).all()
