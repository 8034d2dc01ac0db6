"""Training by torch: gradients, AdamW, dropout, and torch left as it was."""

import warnings

import numpy as np
import pytest
import torch

from tasks.residual import Architecture, Training
from tasks.residual.forms import Targets
from tasks.residual.hyperparameters import learning_rate
from tasks.residual.network import initial_weights
from tasks.residual.torch_descent import (
    NoDevice,
    OutOfDeviceMemory,
    TorchDescent,
    n_cuda_devices,
    require_device,
    row_losses,
)

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
    loss = row_losses(training, h, Targets(*(torch.from_numpy(columns).double() for columns in targets))).mean()
    loss.backward()
    return loss.item(), {name: array.grad.numpy() for name, array in arrays.items()}


def new(training, dropout=0.0, seeds=(1,), n_rows=(300,), weighted=False):
    rngs = [np.random.default_rng(seed) for seed in seeds]
    weights = [initial_weights(ARCHITECTURE.sizes, rng) for rng in rngs]
    examples = [rows_of(n, weighted=weighted) for n in n_rows]
    return TorchDescent(weights, examples * (len(seeds) // len(n_rows)), dropout, training, rngs), weights


def iterated(descent):
    """Take an iteration; return the losses, and the gradient by name."""
    computed = []
    with pytest.MonkeyPatch.context() as patched:
        compute = descent.gradient
        patched.setattr(descent, "gradient", lambda *minibatch: computed.append(compute(*minibatch)) or computed[-1])
        losses = descent.advance(1)[:, 0]
    ((_, gradient),) = computed
    return losses, {name: array.numpy() for name, array in descent.arrays(gradient).items()}


def minibatch(descent, member, inputs, targets):
    drawn = descent._drawn[member].numpy()
    return inputs[drawn], Targets(*(columns[drawn] for columns in targets))


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
        assert float(row_losses(training, predicted, targets).mean()) == pytest.approx(expected, rel=1e-6)
        ours = row_losses(training, predicted.numpy(), Targets(*(columns.numpy() for columns in targets)))
        assert ours.mean() == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("batch_size", [64, 4096])
@pytest.mark.parametrize("weighted", [False, True])
@pytest.mark.parametrize("products", ["float32", "half"])
def test_an_iteration_has_the_loss_and_the_gradient_of_autograd(batch_size, weighted, products):
    """A minibatch that is larger than the data set is that of its rows, each as often as it was drawn."""
    training = Training(batch_size=batch_size, device="cuda", products=products).model_copy(update={"device": "cpu"})
    descent, weights = new(training, seeds=(1, 2), weighted=weighted)
    losses, gradient = iterated(descent)
    for member, network in enumerate(weights):
        batch = minibatch(descent, member, *rows_of(300, weighted=weighted))
        loss, expected = gradient_by_torch(network, *batch, training)
        # sums of some hundred products, rounded to 24 bits; or factors that are rounded to 11 in each of three layers
        tolerance = 1e-5 if products == "float32" else 3 * 2**-11
        assert losses[member] == pytest.approx(loss, rel=tolerance)
        for name, array in expected.items():
            assert abs(gradient[name][member] - array).max() < tolerance * abs(array).max(), name


def test_gradients_that_float16_does_not_have_are_not_lost():
    """Where errors are small, the focal loss has gradients far below the least float16, 6e-8."""
    training = Training(batch_size=64, products="half", device="cuda").model_copy(update={"device": "cpu"})
    descent, (weights,) = new(training)
    inputs, _ = rows_of(300)
    values = descent.predict([inputs])[0] + np.float32(0.01)  # some roundings of the outputs above
    targets = Targets(values, values[:, :0], values[:, :0])
    descent = TorchDescent([weights], [(inputs, targets)], 0.0, training, [np.random.default_rng(1)])
    _, gradient = iterated(descent)
    _, expected = gradient_by_torch(weights, *minibatch(descent, 0, inputs, targets), training)
    for name in ("weight_1", "bias_1", "bias_2"):
        assert abs(expected[name]).max() / 64 < 6e-8
        assert abs(gradient[name][0] - expected[name]).max() < 0.1 * abs(expected[name]).max()


@pytest.mark.parametrize("dropout", [0.01, 0.5])
def test_units_are_dropped_at_random_and_neither_act_nor_learn(dropout):
    training = Training(loss="mse", batch_size=4096)
    descent, (weights,) = new(training, dropout=dropout)
    (loss,), gradient = iterated(descent)
    kept = np.ones((2, 300 * 16))
    for layer, dropped in enumerate(descent._dropped[0].numpy()):
        kept[layer, dropped] = 0
    assert abs(1 - kept.mean() - dropout) < 4 * (dropout * (1 - dropout) / kept.size) ** 0.5
    kept = np.moveaxis(kept.reshape(2, 300, 16), 0, 1) / (1 - dropout)
    drawn = descent._drawn[0].numpy()
    batch = minibatch(descent, 0, *rows_of(300))
    expected_loss, expected = gradient_by_torch(weights, *batch, training, kept[drawn])
    assert loss == pytest.approx(expected_loss, rel=1e-5)
    for name, array in expected.items():
        assert abs(gradient[name][0] - array).max() < 1e-5 * abs(array).max(), name


@pytest.mark.parametrize("batch_size", [64, 1024])
def test_members_are_trained_together_as_they_are_alone(batch_size):
    """Also where they have other numbers of rows, as of tracked throws."""
    training = Training(loss="mse", batch_size=batch_size, n_iterations=100)
    seeds, n_rows = (1, 2, 3, 4), (300, 250, 300, 280)
    together, _ = new(training, 0.01, seeds, n_rows)
    losses = together.advance(100)
    for member, seed in enumerate(seeds):
        alone, _ = new(training, 0.01, (seed,), (n_rows[member],))
        np.testing.assert_allclose(losses[member], alone.advance(100)[0], rtol=1e-4)
        for name, array in alone.weights()[0].items():
            np.testing.assert_allclose(together.weights()[member][name], array, atol=1e-4, err_msg=name)


def test_updates_are_those_of_torch_s_adamw():
    training = Training(loss="mse", batch_size=64, n_iterations=10, weight_decay=0.1, learning_rate=0.1)
    descent, (weights,) = new(training)
    theirs = [torch.tensor(array, dtype=torch.float64, requires_grad=True) for array in weights.values()]
    adamw = torch.optim.AdamW(theirs, weight_decay=0.1)
    for i in range(10):
        adamw.param_groups[0]["lr"] = learning_rate(training, i)
        _, gradient = iterated(descent)
        for parameter, name in zip(theirs, weights, strict=True):
            parameter.grad = torch.from_numpy(gradient[name][0]).double()
        adamw.step()
    for ours, parameter in zip(descent.weights()[0].values(), theirs, strict=True):
        np.testing.assert_allclose(ours, parameter.detach().numpy(), atol=1e-5)


def test_a_minibatch_that_does_not_fit_is_reported_with_one_that_does(monkeypatch):
    descent, _ = new(Training(batch_size=256))

    def no_memory(*_):
        raise torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 8.00 GiB")

    monkeypatch.setattr(descent, "gradient", no_memory)
    monkeypatch.setattr(torch.cuda, "mem_get_info", lambda device: (75_000, 10**9))
    monkeypatch.setattr(torch.cuda, "memory_reserved", lambda device: 0)
    expected = r"^a minibatch of 256 rows for 1 network takes .* to be at most \d+$"
    with pytest.raises(OutOfDeviceMemory, match=expected) as said:
        descent.advance(1)
    # a row takes 16 units of 4 bytes in two layers and two gradients, and three times its 12 columns
    n_bytes = 16 * 4 * 4 + 4 * (3 * 12 + 1)
    assert int(str(said.value).split()[-1]) == int(0.8 * 75_000 / n_bytes)


def test_it_learns_and_a_second_run_gives_the_same_bytes_and_leaves_torch_as_it_was():
    training = Training(loss="mse", batch_size=64, n_iterations=300, learning_rate=1e-2)
    runs = []
    for n_threads in (1, 2):
        torch.set_num_threads(n_threads)
        torch.manual_seed(n_threads)
        before = torch.get_rng_state()
        descent, _ = new(training, dropout=0.001)
        losses = descent.advance(300)[0]
        assert losses[-50:].mean() < 0.5 * losses[:10].mean()
        runs += descent.weights()
        assert torch.get_num_threads() == n_threads
        assert (torch.get_rng_state() == before).all()
        assert torch.get_float32_matmul_precision() == "highest"
    torch.set_num_threads(1)
    for name, array in runs[0].items():
        assert array.tobytes() == runs[1][name].tobytes(), name


@pytest.mark.parametrize(
    ("built_for", "error", "said"),
    [
        (None, None, r"torch \S+ was built without CUDA \(make setup TORCH=cuda\)$"),
        ("12.8", None, r"built for CUDA 12.8: finds no device$"),
        ("12.8", "The driver is too old (version 11040). Please update\nit", r"12.8: The driver .* \(version 11040\)$"),
    ],
)
def test_a_missing_device_is_a_line_that_says_why(built_for, error, said, monkeypatch, recwarn):
    def start():
        if error:
            raise RuntimeError(error)

    def not_available():
        warnings.warn("CUDA initialization: The NVIDIA driver on your system is too old", stacklevel=1)  # as torch does
        return False

    monkeypatch.setattr(torch.version, "cuda", built_for)
    monkeypatch.setattr(torch.cuda, "init", start)
    monkeypatch.setattr(torch.cuda, "is_available", not_available)
    with pytest.raises(NoDevice, match=f"^training.device is cuda, and there is no CUDA device: .*{said}"):
        require_device(Training(device="cuda"))
    assert not recwarn.list


@pytest.mark.skipif(n_cuda_devices() == 0, reason="there is no CUDA device")
def test_a_gpu_gives_the_same_bytes_twice():
    training = Training(loss="mse", batch_size=64, device="cuda")
    once, again = (new(training, dropout=0.001)[0] for _ in range(2))
    once.advance(20), again.advance(20)
    for name, array in once.weights()[0].items():
        assert np.isfinite(array).all() and array.tobytes() == again.weights()[0][name].tobytes()
