"""The descent of descent.py by torch: for CUDA devices, and on a CPU for comparison with the compiled kernel."""

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
import torch
from numpy.random import Generator
from torch import Tensor
from torch.optim.adamw import adamw

from tasks.arrays import Float32, Float64
from tasks.residual.descent_kernel import BETA_1, BETA_2, EPSILON
from tasks.residual.forms import Targets
from tasks.residual.hyperparameters import Training, learning_rate


class TorchDescent:
    """A network that is trained by torch, with the interface of :class:`tasks.residual.descent.Descent`.

    The random numbers are others, so the networks are, too. The data stay on the device.
    """

    def __init__(
        self,
        weights: Mapping[str, Float32],
        inputs: Float32,
        targets: Targets,
        dropout: float,
        training: Training,
        rng: Generator,
    ) -> None:
        """Begin at a network's weights; see :class:`tasks.residual.descent.Descent`."""
        self._training, self._dropout = training, dropout
        self._device = torch.device(training.device)
        self._widths = [columns.shape[1] for columns in (inputs, *targets)]
        self._rows = torch.from_numpy(np.concatenate((inputs, *targets), axis=1)).to(self._device)
        self._parameters = {
            name: torch.tensor(array, device=self._device, requires_grad=True) for name, array in weights.items()
        }
        self._random = torch.Generator(self._device)
        self._random.manual_seed(int(rng.integers(2**63)))
        self._update = weight_updates(list(self._parameters.values()), training.weight_decay)
        self._n_done = 0

    def advance(self, n_iterations: int) -> Float64:
        """Take iterations and return the (n_iterations,) mean loss of each minibatch."""
        n_rows, batch_size = len(self._rows), self._training.batch_size
        losses = np.empty(n_iterations)
        with deterministic(self._device):
            for i in range(n_iterations):
                drawn = torch.randint(n_rows, (batch_size,), device=self._device, generator=self._random)
                losses[i] = self.step(self._rows.index_select(0, drawn))
        return losses

    def step(self, batch: Tensor) -> float:
        """Take one iteration on the given (n_rows, n_columns) rows; return their mean loss."""
        columns: Any = torch.split(batch, self._widths, dim=1)
        predicted = self._forward(columns[0], self._dropout)
        loss: Tensor = mean_loss(self._training, predicted, Targets(*columns[1:]))
        for parameter in self._parameters.values():
            parameter.grad = None
        loss.backward()  # type: ignore[no-untyped-call]
        self._update(learning_rate(self._training, self._n_done))
        self._n_done += 1
        return loss.item()

    def weights(self) -> dict[str, Float32]:
        """Return copies of weight_i and bias_i of each layer i."""
        return {name: parameter.detach().cpu().numpy().copy() for name, parameter in self._parameters.items()}

    def predict(self, inputs: Float32) -> Float32:
        """Map (n_rows, n_inputs) standardised observations to (n_rows, n_outputs) outputs, without dropout."""
        with torch.inference_mode(), deterministic(self._device):
            return self._forward(torch.from_numpy(inputs).to(self._device), 0.0).cpu().numpy()

    def _forward(self, rows: Tensor, dropout: float) -> Tensor:
        n_layers = len(self._parameters) // 2
        for i in range(n_layers):
            rows = torch.addmm(self._parameters[f"bias_{i}"], rows, self._parameters[f"weight_{i}"])
            if i < n_layers - 1:
                rows = torch.relu(rows)
                if dropout > 0:
                    rows = rows * dropout_mask(rows.shape, dropout, self._random)
        return rows


def mean_loss(training: Training, predicted: Any, targets: Targets) -> Any:
    """Return the mean loss over rows, of arrays of NumPy or as a node of torch's graph.

    L_mse = ‖φ(o) - e‖² / n_errors, and the focal loss is α (1 - exp(-s L_mse))^γ L_mse.

    Args:
        training: the loss and its parameters.
        predicted: (n_rows, n_outputs) outputs φ(o).
        targets: what they learn, of which e are the values.
    """
    values, weights, shares = targets
    n = values.shape[1]
    errors = predicted[:, :n]
    for further in range(predicted.shape[1] - n):
        errors = errors + predicted[:, n + further, None] * shares[:, n * further : n * (further + 1)]
    squared = (errors - values) ** 2
    L_mse = (weights * squared if weights.shape[1] else squared).mean(axis=1)
    if training.loss == "mse":
        return L_mse.mean()
    expm1 = torch.expm1 if isinstance(L_mse, Tensor) else np.expm1
    return training.focal_alpha * ((-expm1(-training.focal_s * L_mse)) ** training.focal_gamma * L_mse).mean()


def weight_updates(parameters: Sequence[Tensor], weight_decay: float) -> Callable[[float], None]:
    """Return the update of AdamW, which takes a learning rate and changes parameters in place by their gradients.

    It is the function behind torch.optim.AdamW. The class would import torch's compiler, which takes each process that
    trains 2 to 6 s.
    """
    mean, mean_square = ([torch.zeros_like(parameter) for parameter in parameters] for _ in range(2))
    n_updates = [torch.zeros((), device=parameter.device) for parameter in parameters]

    @torch.no_grad()
    def update(rate: float) -> None:
        gradients = [parameter.grad for parameter in parameters if parameter.grad is not None]
        adamw(
            list(parameters),
            gradients,
            mean,
            mean_square,
            [],
            n_updates,
            fused=True,
            amsgrad=False,
            beta1=BETA_1,
            beta2=BETA_2,
            lr=rate,
            weight_decay=weight_decay,
            eps=EPSILON,
            maximize=False,
        )

    return update


def dropout_mask(shape: torch.Size, p: float, random: torch.Generator) -> Tensor:
    """Return factors that are 0 with probability p and 1 / (1 - p) otherwise, independently.

    Gaps between dropped units are geometric, so only the few gaps are drawn. torch's dropout draws a number for every
    unit, which took half the training time of a small network at the paper's p.
    """
    n = shape.numel()
    # Enough gaps to pass the end: the mean plus ten deviations falls short with a probability below 1e-20.
    n_gaps = int(n * p + 10 * (n * p) ** 0.5 + 20)
    gaps = torch.empty(n_gaps, dtype=torch.int64, device=random.device).geometric_(p, generator=random)
    mask = torch.full((n + 1,), 1 / (1 - p), device=random.device)  # position n stands for all past the end
    return mask.index_fill_(0, gaps.cumsum(0).sub_(1).clamp_(max=n), 0.0)[:n].view(shape)


def n_cuda_devices() -> int:
    """Count the CUDA devices that torch can use here."""
    return torch.cuda.device_count() if torch.cuda.is_available() else 0


@contextmanager
def deterministic(device: torch.device) -> Iterator[None]:
    """Restrict torch to one thread and deterministic algorithms; restore its state afterwards."""
    n_threads, mode = torch.get_num_threads(), torch.get_deterministic_debug_mode()
    if device.type == "cuda":
        os.environ.setdefault("CUBLAS_WORKSPACE_CONFIG", ":4096:8")  # without it cuBLAS refuses to be deterministic
    try:
        torch.set_num_threads(1)
        torch.set_deterministic_debug_mode("error")  # use_deterministic_algorithms would import torch's compiler
        yield
    finally:
        torch.set_num_threads(n_threads)
        torch.set_deterministic_debug_mode(mode)
