"""Iterations of AdamW on a multilayer perceptron, compiled: forward, backward, update.

The samples of a minibatch are in lanes, as in tasks/simulation/networks/inference.py, and pass through the network and
back in chunks that stay in the cache.

A network's bits do not depend on the width of the machine's vectors: a sum over samples has N_SUMS partial sums, of
every N_SUMS-th sample in order, which are added in their order at the end. All other sums run over units in their
order. Matrices are multiplied by fused multiply-adds, rounded once; everything else is rounded operation by operation.
"""

# mypy: warn-return-any=False

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tasks.arrays import Float32, Float64, Int64
from tasks.compiled import compiled, inline
from tasks.simd.lanes import aligned
from tasks.simulation.networks.panels import padded
from tasks.simulation.networks.tiles import (
    N_LANES,
    NUMBER,
    TILE_INPUTS,
    TILE_UNITS,
    TILE_VECTORS,
    add_products,
    add_products_of_half,
    add_products_of_one,
    add_products_of_one_and_half,
    multiply_half_tile,
    multiply_tile,
)

BETA_1, BETA_2, EPSILON = 0.9, 0.999, 1e-8  # AdamW's decay of the moments, and torch's ε
N_SUMS = 16  # partial sums of a gradient: the lanes of the widest registers
CHUNK = 256  # samples that pass through the network together, a multiple of N_SUMS and of a tile's
_N_VECTORS = CHUNK // N_LANES
_N_PARTS = N_SUMS // N_LANES  # vectors in a row whose products go to different partial sums


class NetworkMemory(NamedTuple):
    """Parameters and scratch memory of a network in training, each array with all layers one after the other."""

    sizes: Int64  # (n_layers + 1,) inputs of each layer and outputs of the last, padded
    first_weight: Int64  # (n_layers,) where a layer's panels begin, see panels.py
    first_bias: Int64  # (n_layers,) where its biases begin
    first_value: Int64  # (n_layers + 1,) where its inputs begin in ``values``; the outputs of the last layer follow
    parameters: Float32  # (n_parameters,)
    mean: Float32  # (n_parameters,) moving mean of the gradient
    mean_square: Float32  # (n_parameters,) moving mean of its square
    sums: Float32  # (n_parameters, N_SUMS) partial sums of the gradient
    transposed: Float32  # (n_parameters,) panels of the transposed weights, where those of the weights are
    values: Float32  # inputs and outputs of the layers, (_N_VECTORS, n_units, N_LANES) each
    errors: Float32  # (2, _N_VECTORS * widest layer * N_LANES) derivatives of the loss by outputs of a layer
    targets: Float32  # (_N_VECTORS, n_targets, N_LANES) the columns of forms.Targets side by side
    zeros: Float32  # (widest layer,) biases of the transposed layers
    ones: Float32  # (N_LANES,) the input whose weights are biases


class LossParameters(NamedTuple):
    """The loss and its parameters; see mean_loss in training.py."""

    n_errors: int  # of the first outputs; further ones enter these by their shares
    focal: bool
    alpha: float
    s: float
    gamma: float


@inline
def _transpose(memory: NetworkMemory) -> None:
    """Write the panels of the transposed weights of all layers but the first."""
    for layer in range(1, len(memory.sizes) - 1):
        n_in, n_out, first = memory.sizes[layer], memory.sizes[layer + 1], memory.first_weight[layer]
        for unit in range(n_out):
            panel = unit // TILE_UNITS * TILE_UNITS
            width = min(TILE_UNITS, n_out - panel)
            for k in range(n_in):
                across = k // TILE_UNITS * TILE_UNITS
                to = first + across * n_out + unit * min(TILE_UNITS, n_in - across) + (k - across)
                memory.transposed[to] = memory.parameters[first + panel * n_in + k * width + (unit - panel)]


@inline
def _gather(memory: NetworkMemory, rows: Float32, drawn: Int64, n_targets: int) -> None:
    """Copy the drawn rows into the first layer's inputs and the targets; fill up with zeros."""
    n_in = memory.sizes[0]
    for sample in range(CHUNK):
        vector, lane = sample // N_LANES, sample % N_LANES
        for k in range(n_in):
            value = rows[drawn[sample], k] if sample < len(drawn) else np.float32(0)
            memory.values[(vector * n_in + k) * N_LANES + lane] = value
        for k in range(n_targets):
            target = rows[drawn[sample], n_in + k] if sample < len(drawn) else np.float32(0)
            memory.targets[(vector * n_targets + k) * N_LANES + lane] = target


@inline
def _multiply(x: int, weight: int, bias: int, out: int, n_in: int, n_out: int, relu: bool) -> None:
    """Compute out = relu(weightᵀ x + bias) for a chunk; the first four are addresses."""
    vector = NUMBER * N_LANES
    for v in range(0, _N_VECTORS, TILE_VECTORS):
        rows, results = x + vector * v * n_in, out + vector * v * n_out
        for unit in range(0, n_out, TILE_UNITS):
            panel, first = weight + NUMBER * unit * n_in, bias + NUMBER * unit
            if n_out - unit >= TILE_UNITS:
                multiply_tile(rows, panel, first, results + vector * unit, n_in, n_out, relu)
            else:
                multiply_half_tile(rows, panel, first, results + vector * unit, n_in, n_out, relu)


@inline
def _go_forward(memory: NetworkMemory, layer: int, last: bool) -> None:
    parameters, values = memory.parameters.ctypes.data, memory.values.ctypes.data
    _multiply(
        values + NUMBER * memory.first_value[layer],
        parameters + NUMBER * memory.first_weight[layer],
        parameters + NUMBER * memory.first_bias[layer],
        values + NUMBER * memory.first_value[layer + 1],
        memory.sizes[layer],
        memory.sizes[layer + 1],
        not last,
    )


@inline
def _drop(memory: NetworkMemory, layer: int, dropped: Int64, first_sample: int, width: int, kept: np.float32) -> None:
    """Divide the outputs of a hidden layer by the share that is kept, and set those of dropped units to zero.

    The arguments are those of _descend; the dropped units are those of the chunk's samples.
    """
    n_hidden, n_units = len(memory.sizes) - 2, memory.sizes[layer + 1]
    value = memory.values[memory.first_value[layer + 1] :]
    for i in range(CHUNK * n_units):
        value[i] *= kept
    for number in dropped:
        sample = number // (n_hidden * width) - first_sample
        if number // width % n_hidden == layer:
            row = sample // N_LANES * n_units + number % width
            value[row * N_LANES + sample % N_LANES] = np.float32(0)


@inline
def _compare(memory: NetworkMemory, n: int, n_targets: int, loss: LossParameters, batch_size: int) -> float:
    """Write the derivatives of the mean loss by the network's outputs; return the sum of n samples' losses."""
    n_out, first = memory.sizes[-1], memory.first_value[-1]
    n_errors, end, n_further = loss.n_errors, loss.n_errors * N_LANES, max(n_targets // loss.n_errors - 2, 0)
    error = memory.errors[(len(memory.sizes) - 2) % 2]
    total = 0.0
    for vector in range(_N_VECTORS):
        out, target = first + vector * n_out * N_LANES, vector * n_targets * N_LANES
        at = vector * n_out * N_LANES
        for i in range(n_out * N_LANES):
            error[at + i] = memory.values[out + i] - memory.targets[target + i] if i < end else 0.0
        for further in range(n_further):
            share, output = target + (2 + further) * end, out + end + further * N_LANES
            for i in range(end):
                error[at + i] += memory.targets[share + i] * memory.values[output + i % N_LANES]
        for lane in range(N_LANES):
            squared = np.float32(0)
            for i in range(lane, end, N_LANES):
                difference = error[at + i]
                if n_targets > n_errors:
                    error[at + i] *= memory.targets[target + end + i]
                squared += error[at + i] * difference
            mean_square = squared / np.float32(n_errors)
            value, slope = float(mean_square), 1.0
            if loss.focal:
                fade = math.exp(-loss.s * value)
                weight = (-math.expm1(-loss.s * value)) ** (loss.gamma - 1)
                slope = loss.alpha * weight * (-math.expm1(-loss.s * value) + loss.gamma * loss.s * value * fade)
                value *= loss.alpha * weight * -math.expm1(-loss.s * value)
            if vector * N_LANES + lane < n:
                total += value
            else:
                slope = 0.0
            by_error = np.float32(slope * 2 / (n_errors * batch_size))
            for i in range(lane, end, N_LANES):
                error[at + i] *= by_error
        for further in range(n_further):
            share, by_value = target + (2 + further) * end, at + end + further * N_LANES
            for i in range(end):
                error[by_value + i % N_LANES] += memory.targets[share + i] * error[at + i]
    return total


@inline
def _add_gradient(memory: NetworkMemory, layer: int) -> None:
    """Add a chunk's products of inputs and errors to the partial sums of a layer's gradient."""
    n_in, n_out = memory.sizes[layer], memory.sizes[layer + 1]
    x, error = memory.values.ctypes.data + NUMBER * memory.first_value[layer], memory.errors[layer % 2].ctypes.data
    sums = memory.sums.ctypes.data
    vector = NUMBER * N_LANES
    n, x_step, error_step = _N_VECTORS // _N_PARTS, n_in * N_LANES * _N_PARTS, n_out * N_LANES * _N_PARTS
    for unit in range(0, n_out, TILE_UNITS):
        width = min(TILE_UNITS, n_out - unit)
        for part in range(_N_PARTS):
            of_units = error + vector * (part * n_out + unit)
            to = sums + NUMBER * ((memory.first_bias[layer] + unit) * N_SUMS + part * N_LANES)
            if width == TILE_UNITS:
                add_products_of_one(memory.ones.ctypes.data, of_units, to, n, 0, error_step, N_SUMS)
            else:
                add_products_of_one_and_half(memory.ones.ctypes.data, of_units, to, n, 0, error_step, N_SUMS)
            for k in range(0, n_in, TILE_INPUTS):
                of_inputs = x + vector * (part * n_in + k)
                first = memory.first_weight[layer] + unit * n_in + k * width
                to = sums + NUMBER * (first * N_SUMS + part * N_LANES)
                if n_in - k >= TILE_INPUTS:
                    if width == TILE_UNITS:
                        add_products(of_inputs, of_units, to, n, x_step, error_step, N_SUMS)
                    else:
                        add_products_of_half(of_inputs, of_units, to, n, x_step, error_step, N_SUMS)
                elif width == TILE_UNITS:
                    add_products_of_one(of_inputs, of_units, to, n, x_step, error_step, N_SUMS)
                else:
                    add_products_of_one_and_half(of_inputs, of_units, to, n, x_step, error_step, N_SUMS)


@inline
def _go_back(memory: NetworkMemory, layer: int, kept: np.float32) -> None:
    """Turn the derivatives by a layer's outputs into those by the outputs of the layer below, before their ReLU."""
    n_in, n_out = memory.sizes[layer], memory.sizes[layer + 1]
    below = memory.errors[(layer - 1) % 2]
    transposed = memory.transposed.ctypes.data + NUMBER * memory.first_weight[layer]
    error = memory.errors[layer % 2].ctypes.data
    _multiply(error, transposed, memory.zeros.ctypes.data, below.ctypes.data, n_out, n_in, False)
    value = memory.values[memory.first_value[layer] :]
    for i in range(CHUNK * n_in):
        below[i] = below[i] * kept if value[i] > 0.0 else np.float32(0)


@inline
def _update(memory: NetworkMemory, step: Float32) -> None:
    """Change the parameters by AdamW, with the factors of step_factors in descent.py."""
    decay, size, by_square = step
    for i in range(len(memory.parameters)):
        gradient = np.float32(0)
        for k in range(N_SUMS):
            gradient += memory.sums[i, k]
        mean = memory.mean[i] + (gradient - memory.mean[i]) * np.float32(1 - BETA_1)
        square = memory.mean_square[i] * np.float32(BETA_2) + np.float32(1 - BETA_2) * (gradient * gradient)
        memory.mean[i], memory.mean_square[i] = mean, square
        change = size * mean / (np.sqrt(square) * by_square + np.float32(EPSILON))
        memory.parameters[i] = memory.parameters[i] * decay - change


def _descend(
    memory: NetworkMemory,
    rows: Float32,
    drawn: Int64,
    dropped: Int64,
    first_dropped: Int64,
    width: int,
    kept: np.float32,
    loss: LossParameters,
    steps: Float32,
    losses: Float64,
) -> None:
    """Take iterations.

    Args:
        memory: the network; it changes.
        rows: (n_rows, n_inputs + n_targets) inputs, and the columns of forms.Targets side by side.
        drawn: (n_iterations, batch_size) rows of the minibatches.
        dropped: dropped units of all iterations, each numbered within its iteration by sample, layer and unit.
        first_dropped: (n_iterations + 1,) where an iteration's dropped units begin.
        width: units in each hidden layer, without padding.
        kept: 1 over the share of units that are kept.
        loss: the loss.
        steps: (n_iterations, 3) factors of the update.
        losses: (n_iterations,) mean losses to fill.
    """
    n_iterations, batch_size = drawn.shape
    n_layers = len(memory.sizes) - 1
    n_targets = rows.shape[1] - memory.sizes[0]
    units_per_sample = (n_layers - 1) * width
    for i in range(n_iterations):
        _transpose(memory)
        memory.sums[:] = 0.0
        total = 0.0
        next_dropped = first_dropped[i]
        for first in range(0, batch_size, CHUNK):
            n = min(CHUNK, batch_size - first)
            begin = next_dropped
            while next_dropped < first_dropped[i + 1] and dropped[next_dropped] < (first + n) * units_per_sample:
                next_dropped += 1
            _gather(memory, rows, drawn[i, first : first + n], n_targets)
            for layer in range(n_layers):
                _go_forward(memory, layer, layer == n_layers - 1)
                if kept != 1.0 and layer < n_layers - 1:
                    _drop(memory, layer, dropped[begin:next_dropped], first, width, kept)
            total += _compare(memory, n, n_targets, loss, batch_size)
            for layer in range(n_layers - 1, -1, -1):
                _add_gradient(memory, layer)
                if layer > 0:
                    _go_back(memory, layer, kept)
        _update(memory, steps[i])
        losses[i] = total / batch_size


def allocate(sizes: Sequence[int], n_columns: int) -> NetworkMemory:
    """Allocate a network with the given inputs of each layer and outputs of the last, for rows of n_columns numbers."""
    layers = np.array([sizes[0], *map(padded, sizes[1:])], np.int64)
    n_weights, n_biases = layers[:-1] * layers[1:], layers[1:]
    ends = np.cumsum(np.stack([n_weights, n_biases], axis=1).reshape(-1))
    starts = np.concatenate([[0], ends[:-1]]).reshape(-1, 2)
    n_values = CHUNK * layers
    parameters, mean, mean_square, transposed = (aligned((int(ends[-1]),)) for _ in range(4))
    widest = int(layers.max())
    ones = aligned((N_LANES,))
    ones[:] = 1.0
    return NetworkMemory(
        sizes=layers,
        first_weight=starts[:, 0].copy(),
        first_bias=starts[:, 1].copy(),
        first_value=np.concatenate([[0], np.cumsum(n_values)[:-1]]),
        parameters=parameters,
        mean=mean,
        mean_square=mean_square,
        sums=aligned((int(ends[-1]), N_SUMS)),
        transposed=transposed,
        values=aligned((int(n_values.sum()),)),
        errors=aligned((2, CHUNK * widest)),
        targets=aligned((CHUNK * (n_columns - sizes[0]),)),
        zeros=aligned((widest,)),
        ones=ones,
    )


descend = compiled(_descend, seconds=5)
