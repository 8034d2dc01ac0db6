"""The descent of descent.py by torch, of many networks at once: on CUDA devices, and on a CPU without the compiler."""

import math
import os
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
import torch
from numpy.random import Generator
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence

from tasks.arrays import Float32, Float64
from tasks.residual.descent import Weights, step_factors
from tasks.residual.descent_kernel import BETA_1, BETA_2, EPSILON
from tasks.residual.forms import Targets
from tasks.residual.hyperparameters import Training

_N_EAGER = 3  # iterations before one is recorded as a CUDA graph: libraries set themselves up in the first
_SCALED = 256.0  # sum of the scaled gradients at a network's outputs, 256 times less than the largest float16


class NoDevice(RuntimeError):  # noqa: N818 (what is the case)
    """torch finds no CUDA device."""


class OutOfDeviceMemory(RuntimeError):  # noqa: N818
    """The device has too little memory for a minibatch."""


class TorchDescent:
    """Networks of one shape that are trained at once, with the interface of :class:`tasks.residual.descent.Descent`.

    Each draws its own minibatches and dropped units, so it is trained as it would be alone, but for the last bits of
    matrix products. The random numbers are not those of the compiled descent, so the networks are others, too. The data
    stay on the device, which the processor waits for only at the end of :meth:`advance`.

    A minibatch that is larger than the data set repeats rows. Each row is computed once, and weighs as often as it was
    drawn: the same gradient, but for dropout, which its repetitions share.
    """

    def __init__(
        self,
        weights: Sequence[Weights],
        examples: Sequence[tuple[Float32, Targets]],
        dropout: float,
        training: Training,
        rngs: Sequence[Generator],
    ) -> None:
        """Begin at networks' weights; what each has is as in :class:`tasks.residual.descent.Descent`."""
        self._training, self._device = training, torch.device(training.device)
        if self._device.type == "cuda":
            os.environ.setdefault("CUBLAS_WORKSPACE_CONFIG", ":4096:8")  # so that a second run gives the same
        self._half = torch.float16 if training.products == "half" else torch.float32
        self._keep = 1 / (1 - dropout)
        tables = [torch.from_numpy(np.concatenate((inputs, *targets), axis=1)) for inputs, targets in examples]
        self._widths = [columns.shape[1] for columns in (examples[0][0], *examples[0][1])]
        self._n_rows = [len(table) for table in tables]
        self._rows = pad_sequence(tables, batch_first=True).to(self._device)
        self._counted = training.batch_size > max(self._n_rows)

        self._shapes = {name: array.shape for name, array in weights[0].items()}
        flat = [np.concatenate([network[name].reshape(-1) for name in self._shapes]) for network in weights]
        self._numbers = torch.from_numpy(np.stack(flat)).to(self._device).requires_grad_()  # of weights and biases
        self._mean, self._mean_square = torch.zeros_like(self._numbers), torch.zeros_like(self._numbers)
        self._n_layers = len(self._shapes) // 2

        self._random = [torch.Generator(self._device).manual_seed(int(rng.integers(2**63))) for rng in rngs]
        (width,) = self._shapes["bias_0"]
        most = max(self._n_rows) if self._counted else training.batch_size
        self._n_units = [width * (n if self._counted else most) for n in self._n_rows]
        # Drawn with replacement, as many as leave a unit with probability 1 - p. A network with fewer rows drops fewer
        # units; the others of its list are units of a row of padding.
        self._n_dropped = [round(-n * math.log1p(-dropout)) for n in self._n_units]
        shape = len(tables), self._n_layers - 1, max(self._n_dropped)
        self._dropped = torch.full(shape, width * most - 1, device=self._device)
        self._drawn = torch.zeros(len(tables), training.batch_size, dtype=torch.int64, device=self._device)
        self._factors, self._losses = torch.zeros(3, device=self._device), torch.zeros(len(tables), device=self._device)
        self._n_done = 0
        self._graph: Any = None

    def advance(self, n_iterations: int) -> Float64:
        """Take iterations and return the (n_networks, n_iterations) mean loss of each minibatch."""
        losses = torch.empty(n_iterations, len(self._n_rows), device=self._device)
        factors = torch.from_numpy(step_factors(self._training, self._n_done, n_iterations)).to(self._device)
        try:
            with one_thread(), _products(self._training.products):
                for i in range(n_iterations):
                    self._draw()
                    self._factors.copy_(factors[i])
                    self._iterate()
                    losses[i].copy_(self._losses)
        except torch.OutOfMemoryError:
            raise OutOfDeviceMemory(self._what_fits()) from None
        return losses.T.double().cpu().numpy()

    def _draw(self) -> None:
        """Draw each network's minibatch and dropped units."""
        for member, random in enumerate(self._random):
            self._drawn[member].random_(self._n_rows[member], generator=random)
            dropped = self._dropped[member, :, : self._n_dropped[member]]
            dropped.random_(self._n_units[member], generator=random)

    def _iterate(self) -> None:
        """Take one iteration; on a CUDA device by one call, after the first few."""
        if self._device.type == "cuda" and self._n_done == _N_EAGER:
            self._graph = torch.cuda.CUDAGraph()
            with torch.cuda.graph(self._graph):
                self.step(*self._minibatch())
        if self._graph is None:
            self.step(*self._minibatch())
        else:
            self._graph.replay()
        self._n_done += 1

    def _minibatch(self) -> tuple[Tensor, Tensor]:
        """Return (n_networks, n_rows, n_columns) rows, and the share that each has in its minibatch."""
        each = torch.full_like(self._drawn, 1 / self._drawn.shape[1], dtype=torch.float32)
        if self._counted:
            none = torch.zeros(self._rows.shape[:2], device=self._device)
            return self._rows, none.scatter_add_(1, self._drawn, each)
        networks = torch.arange(len(self._rows), device=self._device)[:, None]
        return self._rows[networks, self._drawn], each

    def step(self, rows: Tensor, shares: Tensor) -> None:
        """Take one iteration of AdamW on (n_networks, n_rows, n_columns) rows with (n_networks, n_rows) shares."""
        losses, gradient = self.gradient(rows, shares)
        self._losses.copy_(losses)
        decay, rate, root = self._factors
        with torch.no_grad():
            self._mean.lerp_(gradient, 1 - BETA_1)
            self._mean_square.mul_(BETA_2).addcmul_(gradient, gradient, value=1 - BETA_2)
            self._numbers.mul_(decay).sub_(rate * self._mean / (self._mean_square.sqrt() * root + EPSILON))

    def gradient(self, rows: Tensor, shares: Tensor) -> tuple[Tensor, Tensor]:
        """Return the loss of each network, and the gradient of its weights and biases.

        Where units are in float16, gradients are scaled by a power of two, because many are smaller than its least.
        """
        columns: Any = torch.split(rows, self._widths, dim=2)
        outputs = self._outputs(columns[0])
        losses = (shares * row_losses(self._training, outputs, Targets(*columns[1:]))).sum(dim=1)
        (of_outputs,) = torch.autograd.grad(losses.sum(), outputs)
        size = of_outputs.abs().sum(dim=(1, 2), keepdim=True).clamp(min=1e-30)
        scale = torch.exp2(torch.floor(torch.log2(_SCALED / size)))
        (gradient,) = torch.autograd.grad(outputs, self._numbers, of_outputs * scale)
        return losses.detach(), gradient / scale[:, 0]

    def _outputs(self, inputs: Tensor) -> Tensor:
        """Return outputs. Only products between hidden layers may be in half precision."""
        layers, units, last = self.arrays(self._numbers), inputs, self._n_layers - 1
        for i in range(self._n_layers):
            precision = self._half if 0 < i < last else torch.float32
            weight, bias = layers[f"weight_{i}"], layers[f"bias_{i}"].to(precision)
            kept = (weight * self._keep if i else weight).to(precision)
            units = torch.baddbmm(bias[:, None], units.to(precision), kept)
            if i < last:
                units = units.to(self._half)
                units.detach().flatten(1).scatter_(1, self._dropped[:, i], 0.0)  # ReLU passes them no gradient
                units = units.relu_()
        return units

    def arrays(self, numbers: Tensor) -> dict[str, Tensor]:
        """Divide (n_networks, n_numbers) numbers into weight_i and bias_i of each layer i."""
        parts = torch.split(numbers, [math.prod(shape) for shape in self._shapes.values()], dim=1)
        named = zip(self._shapes.items(), parts, strict=True)
        return {name: part.view(-1, *shape) for (name, shape), part in named}

    def weights(self) -> list[dict[str, Float32]]:
        """Return copies of weight_i and bias_i of each layer i, of each network."""
        arrays = self.arrays(self._numbers.detach().cpu())
        return [{name: array[k].numpy().copy() for name, array in arrays.items()} for k in range(len(self._n_rows))]

    @torch.no_grad()
    def predict(self, inputs: Sequence[Float32]) -> list[Float32]:
        """Map each network's (n_rows, n_inputs) inputs to (n_rows, n_outputs) outputs, in float32, without dropout."""
        predicted, layers = [], self.arrays(self._numbers)
        with one_thread(), _products("float32"):
            for member, own in enumerate(inputs):
                units = torch.from_numpy(own).to(self._device)
                for i in range(self._n_layers):
                    weight, bias = layers[f"weight_{i}"][member], layers[f"bias_{i}"][member]
                    units = torch.addmm(bias, units.relu() if i else units, weight)
                predicted.append(units.cpu().numpy())
        return predicted

    def _what_fits(self) -> str:
        """Say about how many rows of a minibatch fit into the device's memory."""
        n_networks, n_rows = len(self._n_rows), self._rows.shape[1] if self._counted else self._training.batch_size
        # Units of all hidden layers and gradients of two; of one, beside those in half precision, also in float32.
        per_unit = self._half.itemsize * (self._n_layers + 1) + (4 if self._half is torch.float16 else 0)
        n_bytes = self._shapes["bias_0"][0] * per_unit + 4 * (3 * sum(self._widths) + 1)
        needed = n_networks * n_rows * n_bytes
        free = torch.cuda.mem_get_info(self._device)[0] + torch.cuda.memory_reserved(self._device)
        fitting = min(int(0.8 * n_rows * free / needed), n_rows - 1)
        return (
            f"a minibatch of {n_rows:,} rows for {n_networks} network{'s' * (n_networks > 1)} takes about "
            f"{needed / 1e9:.1f} GB on a GPU, and {free / 1e9:.1f} GB are free: expected training.batch_size to be at "
            f"most {fitting:,}"
        )


def row_losses(training: Training, predicted: Any, targets: Targets) -> Any:
    """Return the loss of each row, of arrays of NumPy or as a node of torch's graph.

    L_mse = ‖φ(o) - e‖² / n_errors, and the focal loss is α (1 - exp(-s L_mse))^γ L_mse.

    Args:
        training: the loss and its parameters.
        predicted: (..., n_rows, n_outputs) outputs φ(o).
        targets: what they learn, of which e are the values.
    """
    values, weights, shares = targets
    n = values.shape[-1]
    errors = predicted[..., :n]
    for further in range(predicted.shape[-1] - n):
        factor = predicted[..., n + further, None]
        errors = errors + factor * shares[..., n * further : n * (further + 1)]
    squared = (errors - values) ** 2
    L_mse = (weights * squared if weights.shape[-1] else squared).mean(axis=-1)
    if training.loss == "mse":
        return L_mse
    expm1 = torch.expm1 if isinstance(L_mse, Tensor) else np.expm1
    return training.focal_alpha * (-expm1(-training.focal_s * L_mse)) ** training.focal_gamma * L_mse


def n_cuda_devices() -> int:
    """Count the CUDA devices that torch can use here."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of a driver that is missing or too old, which no_device says
        return torch.cuda.device_count() if torch.cuda.is_available() else 0


def no_device() -> str:
    """Say why torch can use no CUDA device here, and what to do; nothing if it can."""
    if n_cuda_devices():
        return ""
    if not torch.version.cuda:
        return f"torch {torch.__version__} was built without CUDA (make setup TORCH=cuda)"
    try:
        torch.cuda.init()  # type: ignore[no-untyped-call]
        why = "finds no device"
    except RuntimeError as error:  # such as that the driver is too old
        why = str(error).partition(". ")[0].splitlines()[0]
    return f"torch {torch.__version__}, which was built for CUDA {torch.version.cuda}: {why}"


def require_device(training: Training) -> None:
    """Raise NoDevice, with the reason, if a training needs a CUDA device and torch can use none."""
    if training.device == "cuda" and (why := no_device()):
        raise NoDevice(f"training.device is cuda, and there is no CUDA device: {why}")


@contextmanager
def _products(precision: str) -> Iterator[None]:
    """Let factors of products in float32 be rounded to TF32 or not, and sums never; restore torch's state."""
    before, matmul = torch.get_float32_matmul_precision(), torch.backends.cuda.matmul
    in_half = matmul.allow_fp16_reduced_precision_reduction
    try:
        torch.set_float32_matmul_precision("high" if precision == "tf32" else "highest")
        matmul.allow_fp16_reduced_precision_reduction = False
        yield
    finally:
        torch.set_float32_matmul_precision(before)
        matmul.allow_fp16_reduced_precision_reduction = in_half


@contextmanager
def one_thread() -> Iterator[None]:
    """Restrict torch to one thread of the processor, on which its results depend; restore its state afterwards."""
    n_threads = torch.get_num_threads()
    try:
        torch.set_num_threads(1)
        yield
    finally:
        torch.set_num_threads(n_threads)
