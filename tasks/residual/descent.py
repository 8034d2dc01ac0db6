"""Training of a multilayer perceptron on a core, by AdamW on minibatches.

torch takes three times as long for 2 × 48 units, also where it trains four networks in one batch.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.random import Generator

from tasks.arrays import Float32, Float64, Int64
from tasks.residual.descent_kernel import BETA_1, BETA_2, LossParameters, allocate, descend
from tasks.residual.forms import Targets
from tasks.residual.hyperparameters import Training, learning_rate
from tasks.simulation.networks.inference import PackedNetworks
from tasks.simulation.networks.panels import from_panels, to_panels

Weights = Mapping[str, Float32]  # weight_i (n_in, n_out) and bias_i (n_out,) of each layer i

_MAX_DRAWS = 2**23  # units of all layers for which a call draws whether to drop them


def step_factors(training: Training, first: int, n: int) -> Float32:
    """Return the (n, 3) factors of AdamW for n iterations after the first ones.

    They are those of a parameter, by weight decay, of its moving mean, and of the root of its moving mean square. The
    last two correct the moments' bias towards zero.
    """
    factors = np.empty((n, 3))
    for i in range(n):
        rate, t = learning_rate(training, first + i), first + i + 1
        factors[i] = 1 - rate * training.weight_decay, rate / (1 - BETA_1**t), (1 - BETA_2**t) ** -0.5
    return factors.astype(np.float32)


class Descent:
    """A network that is trained on a core: the compiled counterpart of :class:`TorchDescent`, for one network."""

    def __init__(
        self, weights: Weights, inputs: Float32, targets: Targets, dropout: float, training: Training, rng: Generator
    ) -> None:
        """Begin at a network's weights.

        Args:
            weights: weight_i (n_in, n_out) and bias_i (n_out,) of each layer i.
            inputs: (n_rows, n_inputs) standardised inputs.
            targets: what the outputs learn.
            dropout: probability to drop a hidden unit from a sample.
            training: settings of the training.
            rng: generator of minibatches and dropped units.
        """
        n_layers = len(weights) // 2
        self._shapes = [weights[f"weight_{i}"].shape for i in range(n_layers)]
        self._rows = np.concatenate((inputs, *targets), axis=1)
        self._n_errors, self._dropout, self._training, self._rng = targets.values.shape[1], dropout, training, rng
        self._n_done = 0
        sizes = [self._shapes[0][0], *(n_out for _, n_out in self._shapes)]
        self._memory = memory = allocate(sizes, self._rows.shape[1])
        padded = memory.sizes.tolist()
        starts = memory.first_weight.tolist(), memory.first_bias.tolist()
        self._layers = list(zip(*starts, padded[:-1], padded[1:], strict=True))
        for i, (first_weight, first_bias, n_in, n_out) in enumerate(self._layers):
            panels, bias = to_panels(weights[f"weight_{i}"][None], n_in, n_out)[0], weights[f"bias_{i}"]
            memory.parameters[first_weight : first_weight + len(panels)] = panels
            memory.parameters[first_bias : first_bias + len(bias)] = bias

    def advance(self, n_iterations: int) -> Float64:
        """Take iterations and return the (1, n_iterations) mean loss of each minibatch."""
        batch_size, width = self._training.batch_size, self._shapes[0][1]
        n_units = batch_size * (len(self._shapes) - 1) * width
        at_once = max(1, _MAX_DRAWS // n_units)
        losses = np.empty(n_iterations)
        for first in range(0, n_iterations, at_once):
            n = min(at_once, n_iterations - first)
            drawn = self._rng.integers(len(self._rows), size=(n, batch_size))
            dropped, first_dropped = _drops(self._rng, self._dropout, n, n_units)
            descend(
                self._memory,
                self._rows,
                drawn,
                dropped,
                first_dropped,
                width,
                np.float32(1 / (1 - self._dropout)),
                LossParameters(
                    self._n_errors,
                    self._training.loss == "focal",
                    self._training.focal_alpha,
                    self._training.focal_s,
                    self._training.focal_gamma,
                ),
                step_factors(self._training, self._n_done, n),
                losses[first : first + n],
            )
            self._n_done += n
        return losses[None]

    def weights(self) -> list[dict[str, Float32]]:
        """Return copies of weight_i and bias_i of each layer i."""
        weights = {}
        for i, (first_weight, first_bias, n_in, n_out) in enumerate(self._layers):
            panels = self._memory.parameters[None, first_weight : first_weight + n_in * n_out]
            rows, columns = self._shapes[i]
            weights[f"weight_{i}"] = from_panels(panels, n_in, n_out)[0, :rows, :columns].copy()
            weights[f"bias_{i}"] = self._memory.parameters[first_bias : first_bias + columns].copy()
        return [weights]

    def predict(self, inputs: Sequence[Float32]) -> list[Float32]:
        """Map its (n_rows, n_inputs) standardised observations to (n_rows, n_outputs) outputs, without dropout."""
        (weights,), (rows,) = self.weights(), inputs
        layers = range(len(self._shapes))
        matrices, biases = ([weights[f"{kind}_{i}"][None] for i in layers] for kind in ("weight", "bias"))
        return [PackedNetworks(matrices, biases).forward(rows[None])[0]]


def _drops(rng: Generator, dropout: float, n_iterations: int, n_units: int) -> tuple[Int64, Int64]:
    """Draw which of n_units units are dropped in each iteration.

    Gaps between dropped units are geometric, so only the few gaps are drawn.

    Returns:
        The dropped units of all iterations, numbered within their iteration, and where those of each begin.
    """
    n = n_iterations * n_units
    dropped = np.zeros(0, np.int64)
    if dropout > 0:
        # Enough gaps to pass the end: the mean plus ten deviations falls short with a probability below 1e-20.
        n_gaps = int(n * dropout + 10 * (n * dropout) ** 0.5 + 20)
        dropped = rng.geometric(dropout, n_gaps).cumsum() - 1
        dropped = dropped[dropped < n]
    return dropped % n_units, np.searchsorted(dropped, np.arange(n_iterations + 1) * n_units)
