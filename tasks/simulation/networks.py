"""Networks on a CPU: many small multilayer perceptrons, row by row, near the peak of the core.

A tile of the product of rows and weights is held in the vector registers: TILE_ROWS rows by two vectors of outputs, or
one at the end of a layer, summed over the inputs in their order by fused multiply-adds. So a row's result is the same
whatever rows are beside it, however many there are, and on any machine. A block of rows goes through all layers before
the next, and stays in the L1 cache.
"""

# mypy: disallow-untyped-decorators=False, warn-return-any=False
# ruff: noqa: ARG001 (numba gives every intrinsic its context)

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from typing import Any

import llvmlite.binding as llvm
import numpy as np
import numpy.typing as npt
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from tasks.compiled import compiled
from tasks.simulation.lanes import aligned

Float32 = npt.NDArray[np.float32]

_FEATURES = llvm.get_host_cpu_features()
N_LANES = 16 if _FEATURES.get("avx512f") else 8 if _FEATURES.get("avx") else 4
TILE_ROWS = 12 if N_LANES == 16 else 6
"""As many as leave two registers for weights and some for inputs, of 32 and of 16."""
PANEL = 2 * N_LANES
"""Outputs of a tile. Layers are padded to whole vectors: their last tile may be half as wide."""
NUMBER = 4
"""Bytes of a float32."""


def _tile(builder: ir.IRBuilder, pointers: Sequence[Any], sizes: Sequence[Any], relu: Any, n_vectors: int) -> None:
    """Emit the instructions of out = relu(x @ weight + bias) for a tile as wide as some vectors."""
    x, weight, bias, out = pointers
    n_in, x_stride, out_stride = sizes
    vector, size = ir.VectorType(ir.FloatType(), N_LANES), n_in.type

    def at(pointer: ir.Value, index: ir.Value) -> ir.Value:
        return builder.gep(pointer, [index])

    def vector_at(pointer: ir.Value, index: ir.Value) -> ir.Value:
        return builder.bitcast(at(pointer, index), vector.as_pointer())

    def number(n: int) -> ir.Value:
        return ir.Constant(size, n)

    fma = cgutils.get_or_insert_function(
        builder.module, ir.FunctionType(vector, [vector] * 3), f"llvm.fma.v{N_LANES}f32"
    )
    biases = [builder.load(vector_at(bias, number(v * N_LANES)), align=4 * N_LANES) for v in range(n_vectors)]
    starts = [builder.mul(number(row), x_stride) for row in range(TILE_ROWS)]
    before = builder.block
    loop, after = builder.append_basic_block("inputs"), builder.append_basic_block("tile")
    builder.branch(loop)

    builder.position_at_end(loop)
    k = builder.phi(size)
    k.add_incoming(number(0), before)
    sums = [[builder.phi(vector) for _ in range(n_vectors)] for _ in range(TILE_ROWS)]
    panel_row = builder.mul(k, number(n_vectors * N_LANES))
    weights = [
        builder.load(vector_at(weight, builder.add(panel_row, number(v * N_LANES))), align=4 * N_LANES)
        for v in range(n_vectors)
    ]
    undefined = ir.Constant(vector, ir.Undefined)
    to_all = ir.Constant(ir.VectorType(ir.IntType(32), N_LANES), [0] * N_LANES)
    totals = []
    for row in range(TILE_ROWS):
        one = builder.load(at(x, builder.add(starts[row], k)), align=4)
        first = builder.insert_element(undefined, one, ir.Constant(ir.IntType(32), 0))
        spread = builder.shuffle_vector(first, undefined, to_all)
        totals.append([builder.call(fma, [spread, w, s]) for w, s in zip(weights, sums[row], strict=True)])
    following = builder.add(k, number(1))
    k.add_incoming(following, loop)
    for row in range(TILE_ROWS):
        for v in range(n_vectors):
            sums[row][v].add_incoming(biases[v], before)
            sums[row][v].add_incoming(totals[row][v], loop)
    again = builder.cbranch(builder.icmp_signed("<", following, n_in), loop, after)
    again.set_metadata("llvm.loop", _not_unrolled(builder.module))

    builder.position_at_end(after)
    # One bound for either case: a choice for each vector would become as many jumps.
    least = builder.select(relu, *(ir.Constant(vector, [bound] * N_LANES) for bound in (0.0, -math.inf)))
    for row in range(TILE_ROWS):
        for v in range(n_vectors):
            total = totals[row][v]
            value = builder.select(builder.fcmp_ordered("<", total, least), least, total)  # so that NaN stays
            where = builder.add(builder.mul(number(row), out_stride), number(v * N_LANES))
            builder.store(value, vector_at(out, where), align=4 * N_LANES)


def _not_unrolled(module: ir.Module) -> ir.MDValue:
    """Forbid LLVM to unroll a loop, for want of registers: it spills the sums, and takes three times as long."""
    disable = module.add_metadata([ir.MetaDataString(module, "llvm.loop.unroll.disable")])
    loop = ir.MDValue(module, [disable], name=str(len(module.metadata)))
    loop.operands = (loop, disable)  # a loop is named by metadata that begin with themselves
    return loop


def _tile_of(n_vectors: int) -> Any:
    """Make a function that computes a tile as wide as some vectors."""

    @intrinsic
    def multiply_tile(
        typing: Any, x: Any, weight: Any, bias: Any, out: Any, n_in: Any, x_stride: Any, out_stride: Any, relu: Any
    ) -> Any:
        """Compute a tile; x, weight, bias and out are addresses, strides are in numbers."""

        def emit(context: Any, builder: ir.IRBuilder, signature: Any, args: Any) -> ir.Value:
            pointer = ir.FloatType().as_pointer()
            addresses = [builder.inttoptr(address, pointer) for address in args[:4]]
            _tile(builder, addresses, args[4:7], args[7], n_vectors)
            return context.get_dummy_value()

        return types.void(*[types.intp] * 7, types.boolean), emit

    return multiply_tile


_multiply_tile, _multiply_half_tile = _tile_of(2), _tile_of(1)


def _forward(
    layers: npt.NDArray[np.int64], sizes: npt.NDArray[np.int64], n_rows: int, x: int, out: int, between: int
) -> None:
    """Send the rows of each member through its layers; arrays are given by their addresses.

    Args:
        layers: (n_members, n_layers, 2) addresses of panels and biases.
        sizes: (n_layers + 1,) inputs of each layer and outputs of the last, padded.
        n_rows: of each member, a multiple of TILE_ROWS.
        x: (n_members, n_rows, sizes[0]) inputs.
        out: (n_members, n_rows, sizes[-1]) outputs.
        between: (2, TILE_ROWS, widest layer) for what goes from one layer to the next.
    """
    n_members, n_layers, _ = layers.shape
    widest = sizes[1:].max()
    for member in range(n_members):
        for first in range(0, n_rows, TILE_ROWS):
            rows = x + NUMBER * (member * n_rows + first) * sizes[0]
            for layer in range(n_layers):
                n_in, n_out = sizes[layer], sizes[layer + 1]
                last = layer == n_layers - 1
                if last:
                    result = out + NUMBER * (member * n_rows + first) * n_out
                else:
                    result = between + NUMBER * (layer % 2) * TILE_ROWS * widest
                for unit in range(0, n_out, PANEL):
                    weight = layers[member, layer, 0] + NUMBER * unit * n_in
                    bias = layers[member, layer, 1] + NUMBER * unit
                    if n_out - unit >= PANEL:
                        _multiply_tile(rows, weight, bias, result + NUMBER * unit, n_in, n_in, n_out, not last)
                    else:
                        _multiply_half_tile(rows, weight, bias, result + NUMBER * unit, n_in, n_in, n_out, not last)
                rows = result


run_networks = compiled(_forward, [sys.modules[__name__]], seconds=2)


def _padded(n: int) -> int:
    """Round a number of outputs up to whole vectors."""
    return -(-n // N_LANES) * N_LANES


class PackedNetworks:
    """Networks of one shape, their weights laid out as the kernel reads them."""

    def __init__(self, weights: Sequence[Float32], biases: Sequence[Float32], inputs: tuple[str, ...]) -> None:
        """Pack the weights of networks whose layers, all but the last, end in ReLU.

        Args:
            weights: of each layer, (n_members, n_in, n_out).
            biases: of each layer, (n_members, n_out).
            inputs: what the first layer reads, in order, by the names of :class:`tasks.world.LinkStates`.
        """
        self._source = tuple(weights), tuple(biases), inputs
        self.inputs = inputs
        self.n_members, self._n_in, _ = weights[0].shape
        self._n_out = weights[-1].shape[2]
        sizes = [self._n_in, *(_padded(weight.shape[2]) for weight in weights)]
        self.sizes = np.array(sizes, np.int64)
        self._panels = [
            _panels(weight, n_in, n_out) for weight, n_in, n_out in zip(weights, sizes, sizes[1:], strict=False)
        ]
        self._biases = [aligned((self.n_members, n_out)) for n_out in sizes[1:]]
        for packed, bias in zip(self._biases, biases, strict=True):
            packed[:, : bias.shape[1]] = bias
        self.layers = np.array(
            [
                [
                    (panels[member].ctypes.data, bias[member].ctypes.data)
                    for panels, bias in zip(self._panels, self._biases, strict=True)
                ]
                for member in range(self.n_members)
            ],
            np.int64,
        )
        self.between = aligned((2, TILE_ROWS, max(sizes[1:])))

    def __reduce__(self) -> tuple[Any, ...]:
        """Pack anew in another process: addresses and alignment do not travel."""
        return PackedNetworks, self._source

    def forward(self, rows: Float32) -> Float32:
        """Map (n_members, n_rows, n_in) to (n_members, n_rows, n_out)."""
        x, out = self.room(rows.shape[1])
        x[:, : rows.shape[1]] = rows
        run_networks(self.layers, self.sizes, x.shape[1], x.ctypes.data, out.ctypes.data, self.between.ctypes.data)
        return out[:, : rows.shape[1], : self._n_out]

    def room(self, n_rows: int) -> tuple[Float32, Float32]:
        """Make arrays for (n_members, at least n_rows, inputs) and (n_members, as many, padded outputs)."""
        n_filled = -(-n_rows // TILE_ROWS) * TILE_ROWS
        return aligned((self.n_members, n_filled, self._n_in)), aligned((self.n_members, n_filled, int(self.sizes[-1])))


def _panels(weight: Float32, n_in: int, n_out: int) -> Float32:
    """Cut (n_members, n_in, n_out) weights, filled with zeros, into panels, one after the other in memory.

    Returns:
        (n_members, n_in · n_out): of each panel (n_in, PANEL) numbers, or half as many of the last.
    """
    n_members = len(weight)
    filled = np.zeros((n_members, n_in, n_out), np.float32)
    filled[:, : weight.shape[1], : weight.shape[2]] = weight
    panels = aligned((n_members, n_in * n_out))
    for unit in range(0, n_out, PANEL):
        panel = filled[:, :, unit : unit + PANEL].reshape(n_members, -1)
        panels[:, unit * n_in : unit * n_in + panel.shape[1]] = panel
    return panels
