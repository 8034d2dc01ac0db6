"""The compiled training: torch's gradients, AdamW's updates, and bits that no width of vectors changes."""

import hashlib
import subprocess
import sys

import numba
import numpy as np
import pytest

from tasks.residual import Architecture, Training
from tasks.residual.descent import Descent
from tasks.residual.descent_kernel import CHUNK
from tasks.residual.forms import Targets
from tasks.residual.hyperparameters import learning_rate
from tasks.residual.network import initial_weights
from tasks.simulation.networks.tiles import N_LANES
from tests.tasks.residual.test_torch_descent import gradient_by_torch, rows_of

pytestmark = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="torch trains then")

MSE = Training(loss="mse", batch_size=200, n_iterations=100)


def descent(training=MSE, n_inputs=6, weighted=False, dropout=0.0, seed=1, **size):
    _, *hidden, n_out = Architecture(**{"hidden_layers": 2, "width": 32, **size}).sizes
    weights = initial_weights([n_inputs, *hidden, n_out], np.random.default_rng(seed))
    rows = rows_of(500, n_inputs, weighted)
    return Descent(weights, *rows, dropout, training, np.random.default_rng(seed + 1)), weights, rows


def drawn_from(rows, numbers):
    """The inputs and targets of a minibatch."""
    inputs, targets = rows
    return inputs[numbers], Targets(*(columns[numbers] for columns in targets))


def gradient(network):
    """The gradient of the first iteration, from the moving mean of AdamW, in the shapes of the weights."""
    network._memory.parameters[:] = network._memory.mean / np.float32(0.1)
    return network.weights()[0]


@pytest.mark.parametrize(
    ("case", "training"),
    [
        ({}, MSE),
        ({}, Training(batch_size=200)),
        ({}, Training(batch_size=200, focal_alpha=2.0, focal_s=3.0, focal_gamma=1.0)),
        ({"weighted": True}, MSE),
        ({"weighted": True}, Training(batch_size=200)),
        ({"n_inputs": 9}, MSE),
        ({"hidden_layers": 1, "width": 5}, MSE),
        ({"hidden_layers": 3, "width": 23}, MSE),
        ({"hidden_layers": 4, "width": 64}, MSE),
        ({"hidden_layers": 1, "width": 1, "n_inputs": 1}, MSE),
        *(({}, MSE.model_copy(update={"batch_size": n})) for n in (1, CHUNK, CHUNK + 1, 3 * CHUNK - 1)),
    ],
)
def test_an_iteration_has_the_loss_and_the_gradient_of_torch(case, training):
    network, weights, rows = descent(training, **case)
    batch = drawn_from(rows, np.random.default_rng(2).integers(500, size=training.batch_size))
    loss, expected = gradient_by_torch(weights, *batch, training)
    assert network.advance(1)[0, 0] == pytest.approx(loss, rel=1e-5)
    got = gradient(network)
    largest = max(abs(array).max() for array in expected.values())
    for name, array in expected.items():
        assert abs(got[name] - array).max() < 1e-5 * largest, name


@pytest.mark.parametrize("dropout", [0.01, 0.5])
def test_dropped_units_neither_act_nor_learn(dropout):
    training = MSE.model_copy(update={"batch_size": 2 * CHUNK + 40})
    network, weights, rows = descent(training, dropout=dropout, hidden_layers=3, width=20)
    rng = np.random.default_rng(2)
    batch = drawn_from(rows, rng.integers(500, size=training.batch_size))
    n_units = training.batch_size * 3 * 20
    # the gaps between dropped units are geometric: a unit is dropped with the same probability wherever it is
    dropped = rng.geometric(dropout, int(n_units * dropout + 10 * (n_units * dropout) ** 0.5 + 20)).cumsum() - 1
    kept = np.ones(n_units)
    kept[dropped[dropped < n_units]] = 0
    kept = kept.reshape(-1, 3, 20) / (1 - dropout)
    loss, expected = gradient_by_torch(weights, *batch, training, kept)
    assert network.advance(1)[0, 0] == pytest.approx(loss, rel=1e-5)
    got = gradient(network)
    for name, array in expected.items():
        assert abs(got[name] - array).max() < 1e-5 * abs(array).max(), name


def test_updates_are_those_of_adamw():
    """Loshchilov and Hutter, Decoupled Weight Decay Regularization, algorithm 2, with each iteration's gradient."""
    training = Training(loss="mse", batch_size=64, n_iterations=10, weight_decay=0.1, learning_rate=0.1)
    network, _, _ = descent(training)
    memory = network._memory
    expected = memory.parameters.astype(float)
    m, v = np.zeros_like(expected), np.zeros_like(expected)
    for t in range(1, 11):
        network.advance(1)
        gradient = memory.sums.sum(axis=1, dtype=float)
        m = 0.9 * m + 0.1 * gradient
        v = 0.999 * v + 0.001 * gradient**2
        step = m / (1 - 0.9**t) / (np.sqrt(v / (1 - 0.999**t)) + 1e-8)
        expected -= learning_rate(training, t - 1) * (0.1 * expected + step)
        # some roundings of numbers below 1 in each of t updates, of at most 0.1 each
        np.testing.assert_allclose(memory.parameters, expected, atol=t * 2e-6)


def digest():
    network, _, _ = descent(MSE, dropout=0.001, weighted=True, n_inputs=9)
    network.advance(60)
    arrays = network.weights()[0].values()
    return hashlib.sha256(b"".join(array.tobytes() for array in arrays)).hexdigest()


DIGEST = "e07a1e1b2ca8c754b8257e5858ec13fc9d771a7e084786117058f24729e80d37"


def test_the_bytes_are_those_of_every_processor():
    assert digest() == DIGEST


WIDTHS = {4: set(), 8: {"avx"}, 16: {"avx", "avx512f"}}


@pytest.mark.parametrize("n_lanes", sorted(WIDTHS.keys() - {N_LANES}))
def test_the_width_of_the_vectors_changes_no_byte(n_lanes, torture):
    """The compiler splits vectors that are wider than the registers, so a machine can try all widths."""
    if not torture.large and n_lanes != min(WIDTHS.keys() - {N_LANES}):
        pytest.skip("with --torture: the kernel is compiled for another width")
    program = (
        "import llvmlite.binding as llvm\n"
        "features = llvm.get_host_cpu_features()\n"
        "class Pretended(type(features)):\n"  # the compiler reads the real ones by flatten()
        f"    get = lambda self, name: name in {WIDTHS[n_lanes]}\n"
        "llvm.get_host_cpu_features = lambda: Pretended(features)\n"
        "from tasks.simulation.networks.tiles import N_LANES\n"
        "from tests.tasks.residual.test_descent import digest\n"
        "print(N_LANES, digest())"
    )
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert run.stdout.split() == [str(n_lanes), DIGEST]
