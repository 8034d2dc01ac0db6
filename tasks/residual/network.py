"""One residual network: a multilayer perceptron from standardised observations to standardised residuals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.random import Generator

from tasks.arrays import Float32

# No warnings for data that are not finite: training reports that it diverged.
_quietly = np.errstate(invalid="ignore", over="ignore")


@dataclass(frozen=True, eq=False)
class Standardisation:
    """Means and deviations of the training set's observations (n_inputs,) and outputs (n_outputs,) in their units."""

    observation_mean: Float32
    observation_deviation: Float32
    residual_mean: Float32
    residual_deviation: Float32

    @staticmethod
    def of(observation: Float32, residual: Float32, *, standardise_targets: bool) -> Standardisation:
        """Return the standardisation of a training set.

        Args:
            observation: (n_rows, n_inputs) observations.
            residual: (n_rows, n_outputs) what the outputs are measured by.
            standardise_targets: whether to standardise residuals; they keep SI units otherwise.
        """
        observation_mean, observation_deviation = _moments(observation)
        residual_mean, residual_deviation = np.zeros_like(residual[0]), np.ones_like(residual[0])
        if standardise_targets:
            residual_mean, residual_deviation = _moments(residual)
        return Standardisation(observation_mean, observation_deviation, residual_mean, residual_deviation)

    @_quietly
    def standard_observation(self, observation: Float32) -> Float32:
        """Standardise (n_rows, n_inputs) observations."""
        return (observation - self.observation_mean) / self.observation_deviation

    @_quietly
    def standard_residual(self, residual: Float32) -> Float32:
        """Standardise (n_rows, n_outputs) residuals."""
        return (residual - self.residual_mean) / self.residual_deviation

    def residual(self, standard: Float32) -> Float32:
        """Convert (n_rows, n_outputs) standardised outputs to SI units."""
        return standard * self.residual_deviation + self.residual_mean


@_quietly
def _moments(rows: Float32) -> tuple[Float32, Float32]:
    mean, deviation = rows.mean(axis=0, dtype=np.float64), rows.std(axis=0, dtype=np.float64)
    # A constant column, such as a single length scale, has no deviation except by rounding.
    deviation[np.ptp(rows, axis=0) == 0] = 1.0
    return mean.astype(np.float32), deviation.astype(np.float32)


def initial_weights(sizes: Sequence[int], rng: Generator) -> dict[str, Float32]:
    """Draw weight_i (n_in, n_out) and bias_i (n_out,) of each layer i, for rows @ weight + bias.

    They are uniform within ±1 / √n_in, as in torch.nn.Linear; ``sizes`` are those of Architecture.
    """
    weights: dict[str, Float32] = {}
    for i, (n_in, n_out) in enumerate(pairwise(sizes)):
        bound = max(n_in, 1) ** -0.5
        weights[f"weight_{i}"] = rng.uniform(-bound, bound, (n_in, n_out)).astype(np.float32)
        weights[f"bias_{i}"] = rng.uniform(-bound, bound, n_out).astype(np.float32)
    return weights
