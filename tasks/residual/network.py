"""One residual network: a multilayer perceptron from standardised observations to standardised residuals."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch
from torch import Tensor, nn

from tasks.arrays import Float32
from tasks.residual.hyperparameters import Architecture
from tasks.residual.observation import STATE


@dataclass(frozen=True, eq=False)
class Standardisation:
    """Means and deviations of the training set's observations (n_inputs,) and residuals (6,) in their units."""

    observation_mean: Float32
    observation_deviation: Float32
    residual_mean: Float32
    residual_deviation: Float32

    @staticmethod
    def of(observation: Float32, residual: Float32, *, standardise_targets: bool) -> Standardisation:
        """Return the standardisation of a training set.

        Args:
            observation: (n_rows, n_inputs) observations.
            residual: (n_rows, 6) residuals in the order of STATE.
            standardise_targets: whether to standardise residuals; they keep SI units otherwise.
        """
        observation_mean, observation_deviation = _moments(observation)
        residual_mean, residual_deviation = np.zeros(len(STATE), np.float32), np.ones(len(STATE), np.float32)
        if standardise_targets:
            residual_mean, residual_deviation = _moments(residual)
        return Standardisation(observation_mean, observation_deviation, residual_mean, residual_deviation)

    def standard_observation(self, observation: Float32) -> Float32:
        """Standardise (n_rows, n_inputs) observations."""
        return _standard(observation, self.observation_mean, self.observation_deviation)

    def standard_residual(self, residual: Float32) -> Float32:
        """Standardise (n_rows, 6) residuals."""
        return _standard(residual, self.residual_mean, self.residual_deviation)

    def residual(self, standard: Float32) -> Float32:
        """Convert (n_rows, 6) standardised residuals to SI units."""
        return standard * self.residual_deviation + self.residual_mean


# No warnings for data that are not finite: training reports that it diverged.
_quietly = np.errstate(invalid="ignore", over="ignore")


@_quietly
def _standard(rows: Float32, mean: Float32, deviation: Float32) -> Float32:
    return (rows - mean) / deviation


@_quietly
def _moments(rows: Float32) -> tuple[Float32, Float32]:
    mean, deviation = rows.mean(axis=0, dtype=np.float64), rows.std(axis=0, dtype=np.float64)
    # A constant column, such as a single length scale, has no deviation except by rounding.
    deviation[np.ptp(rows, axis=0) == 0] = 1.0
    return mean.astype(np.float32), deviation.astype(np.float32)


class ResidualNetwork(nn.Module):
    """Network from (n_rows, n_inputs) standardised observations to (n_rows, 6) standardised residuals."""

    def __init__(self, architecture: Architecture) -> None:
        """Initialise from torch's current seed."""
        super().__init__()
        sizes = [len(architecture.observation), *[architecture.width] * architecture.hidden_layers, len(STATE)]
        self.layers = nn.ModuleList(nn.Linear(n_in, n_out) for n_in, n_out in pairwise(sizes))
        self.n_inputs = len(architecture.observation)
        self.dropout = architecture.dropout

    def forward(self, observation: Tensor) -> Tensor:
        """Predict residuals; dropout is active while training."""
        *hidden_layers, last = self.layers
        rows = observation
        for layer in hidden_layers:
            rows = torch.relu(layer(rows))
            if self.training and self.dropout > 0:
                rows = rows * dropout_mask(rows.shape, self.dropout, rows.device)
        out: Tensor = last(rows)
        return out

    def arrays(self) -> dict[str, Float32]:
        """Return copies of weight_i (n_in, n_out) and bias_i (n_out,) of each layer i, for rows @ weight + bias."""
        arrays: dict[str, Float32] = {}
        for i in range(len(self.layers)):
            arrays[f"weight_{i}"] = self.get_parameter(f"layers.{i}.weight").detach().cpu().numpy().T.copy()
            arrays[f"bias_{i}"] = self.get_parameter(f"layers.{i}.bias").detach().cpu().numpy().copy()
        return arrays


def dropout_mask(shape: torch.Size, p: float, device: torch.device) -> Tensor:
    """Return factors that are 0 with probability p and 1 / (1 - p) otherwise, independently.

    Gaps between dropped units are geometric, so only the few gaps are drawn. torch's dropout draws a number for every
    unit, which took half the training time of a small network at the paper's p.

    Args:
        shape: shape of the mask.
        p: probability of 0.
        device: device of the mask.
    """
    n = shape.numel()
    # Enough gaps to pass the end: the mean plus ten deviations falls short with a probability below 1e-20.
    n_gaps = int(n * p + 10 * (n * p) ** 0.5 + 20)
    dropped = torch.empty(n_gaps, dtype=torch.int64, device=device).geometric_(p).cumsum(0).sub_(1).clamp_(max=n)
    mask = torch.full((n + 1,), 1 / (1 - p), device=device)  # position n stands for all past the end
    return mask.index_fill_(0, dropped, 0.0)[:n].view(shape)
