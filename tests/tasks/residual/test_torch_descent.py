"""Training by torch: gradients by hand, AdamW, dropout, and torch left as it was."""

import numpy as np
import pytest
import torch

from tasks.residual import Architecture, Training
from tasks.residual.forms import Targets
from tasks.residual.network import initial_weights
from tasks.residual.torch_descent import TorchDescent, mean_loss, n_cuda_devices

ARCHITECTURE = Architecture(hidden_layers=2, width=16)


def rows_of(n_rows, n_inputs=6, weighted=False, seed=3):
    """Random inputs, and targets that are a function of them, with weights."""
    rng = np.random.default_rng(seed)
    inputs = rng.normal(size=(n_rows, n_inputs))
    targets = np.sin(inputs @ rng.normal(0, n_inputs**-0.5, (n_inputs, 6))) + 0.1 * rng.normal(size=(n_rows, 6))
    weights = rng.uniform(size=(n_rows, 6 if weighted else 0))
    return inputs.astype(np.float32), Targets(*(x.astype(np.float32) for x in (targets, weights, targets[:, :0])))


def gradient_by_torch(weights, inputs, targets, training, kept=None):
    """The mean loss of a minibatch and its gradient in float64; units have factors (n_rows, hidden_layers, width)."""
    arrays = {name: torch.tensor(array, dtype=torch.float64, requires_grad=True) for name, array in weights.items()}
    n_layers = len(weights) // 2
    h = torch.from_numpy(inputs).double()
    for i in range(n_layers):
        h = h @ arrays[f"weight_{i}"] + arrays[f"bias_{i}"]
        if i < n_layers - 1:
            h = h.relu() * (1.0 if kept is None else torch.from_numpy(kept[:, i]))
    loss = mean_loss(training, h, Targets(*(torch.from_numpy(columns).double() for columns in targets)))
    loss.backward()
    return loss.item(), {name: array.grad.numpy() for name, array in arrays.items()}


def new(training, dropout=0.0, seed=1, weighted=False):
    weights = initial_weights(ARCHITECTURE.sizes, np.random.default_rng(seed))
    return TorchDescent(
        weights, *rows_of(300, weighted=weighted), dropout, training, np.random.default_rng(seed)
    ), weights


def test_focal_loss_by_hand():
    predicted = torch.tensor([[0.0] * 6, [0.3, 0, 0, 0, 0, 0], [1, 1, 1, 1, 1, 2.0]])
    true = torch.zeros(3, 6)
    # ‖·‖² / 6: 0, 0.09 / 6 = 0.015, 9 / 6 = 1.5
    focal = [0.0, 2 * (1 - np.exp(-10 * 0.015)) ** 3 * 0.015, 2 * (1 - np.exp(-10 * 1.5)) ** 3 * 1.5]
    focal_training, mse = Training(focal_alpha=2.0, focal_s=10.0, focal_gamma=3.0), Training(loss="mse")
    none, halves = true[:, :0], torch.full((3, 6), 0.5)
    for training, targets, expected in (
        (focal_training, Targets(true, none, none), sum(focal) / 3),
        (mse, Targets(true, none, none), (0.015 + 1.5) / 3),
        (mse, Targets(true, halves, none), (0.015 + 1.5) / 6),
    ):
        assert float(mean_loss(training, predicted, targets)) == pytest.approx(expected, rel=1e-6)
        ours = mean_loss(training, predicted.numpy(), Targets(*(columns.numpy() for columns in targets)))
        assert ours == pytest.approx(expected, rel=1e-6)


def test_it_learns_and_a_second_run_gives_the_same_bytes_and_leaves_torch_as_it_was():
    training = Training(loss="mse", batch_size=64, n_iterations=300, learning_rate=1e-2)
    runs = []
    for n_threads in (1, 2):
        torch.set_num_threads(n_threads)
        torch.manual_seed(n_threads)
        before = torch.get_rng_state()
        descent, _ = new(training, dropout=0.001)
        losses = descent.advance(300)
        assert losses[-50:].mean() < 0.5 * losses[:10].mean()
        runs.append(descent.weights())
        assert torch.get_num_threads() == n_threads
        assert (torch.get_rng_state() == before).all()
        assert not torch.are_deterministic_algorithms_enabled()
    torch.set_num_threads(1)
    for name, array in runs[0].items():
        assert array.tobytes() == runs[1][name].tobytes(), name


@pytest.mark.skipif(n_cuda_devices() == 0, reason="there is no CUDA device")
def test_a_gpu_gives_the_same_bytes_twice():
    training = Training(loss="mse", batch_size=64, device="cuda")
    once, again = (new(training, dropout=0.001)[0] for _ in range(2))
    once.advance(20), again.advance(20)
    for name, array in once.weights().items():
        assert np.isfinite(array).all() and array.tobytes() == again.weights()[name].tobytes()
