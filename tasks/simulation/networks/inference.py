"""Inference of many small multilayer perceptrons on a CPU, near the core's peak.

Samples are in lanes, N_LANES per vector, like the robots of the engine. A tile of the product of samples and weights
stays in the vector registers: TILE_VECTORS vectors of samples by TILE_UNITS outputs, or half as many at the end of a
layer. It is summed over the inputs in their order by fused multiply-adds. So the result of a sample depends neither on
the other samples, nor on their number, nor on the machine. The samples of a tile pass through all layers before those
of the next, and stay in the cache.
"""

# mypy: disallow-untyped-decorators=False, warn-return-any=False
# ruff: noqa: ARG001 (numba gives every intrinsic its context)

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from tasks.arrays import Float32, Int64
from tasks.compiled import compiled
from tasks.simulation.simd.lanes import aligned, widest

Pointer = int  # address of float32 numbers in memory

N_LANES = widest() // 2  # lanes of a vector register
TILE_VECTORS = 2
TILE_UNITS = 8 if N_LANES == 16 else 4
"""Outputs of a tile: the most that leave registers for samples and weights. Layers are padded to half as many."""
TILE_ROWS = TILE_VECTORS * N_LANES
_NUMBER = 4  # size of a float32 [bytes]


def _tile(builder: ir.IRBuilder, pointers: Sequence[Any], sizes: Sequence[Any], relu: Any, n_units: int) -> None:
    """Emit the instructions of out = relu(weightᵀ x + bias) for a tile of n_units outputs."""
    x, weight, bias, out = pointers
    n_in, n_out = sizes
    vector, size = ir.VectorType(ir.FloatType(), N_LANES), n_in.type
    units, vectors = range(n_units), range(TILE_VECTORS)
    undefined = ir.Constant(vector, ir.Undefined)
    to_all = ir.Constant(ir.VectorType(ir.IntType(32), N_LANES), [0] * N_LANES)

    def number(n: int) -> ir.Value:
        return ir.Constant(size, n)

    def lanes_at(pointer: ir.Value, row: ir.Value) -> ir.Value:
        where = builder.gep(pointer, [builder.mul(row, number(N_LANES))])
        return builder.bitcast(where, vector.as_pointer())

    def in_all_lanes(pointer: ir.Value, index: ir.Value) -> ir.Value:
        one = builder.load(builder.gep(pointer, [index]), align=4)
        first = builder.insert_element(undefined, one, ir.Constant(ir.IntType(32), 0))
        return builder.shuffle_vector(first, undefined, to_all)

    fma = cgutils.get_or_insert_function(
        builder.module, ir.FunctionType(vector, [vector] * 3), f"llvm.fma.v{N_LANES}f32"
    )
    biases = [in_all_lanes(bias, number(unit)) for unit in units]
    before = builder.block
    loop, after = builder.append_basic_block("inputs"), builder.append_basic_block("tile")
    builder.branch(loop)

    builder.position_at_end(loop)
    k = builder.phi(size)
    k.add_incoming(number(0), before)
    sums = [[builder.phi(vector) for _ in units] for _ in vectors]
    rows = [builder.load(lanes_at(x, builder.add(builder.mul(number(v), n_in), k)), align=4 * N_LANES) for v in vectors]
    first_weight = builder.mul(k, number(n_units))
    weights = [in_all_lanes(weight, builder.add(first_weight, number(unit))) for unit in units]
    totals = [[builder.call(fma, [rows[v], weights[unit], sums[v][unit]]) for unit in units] for v in vectors]
    following = builder.add(k, number(1))
    k.add_incoming(following, loop)
    for v in vectors:
        for unit in units:
            sums[v][unit].add_incoming(biases[unit], before)
            sums[v][unit].add_incoming(totals[v][unit], loop)
    again = builder.cbranch(builder.icmp_signed("<", following, n_in), loop, after)
    again.set_metadata("llvm.loop", _not_unrolled(builder.module))

    builder.position_at_end(after)
    # One bound for both cases: a choice per vector would become a jump per vector.
    least = builder.select(relu, *(ir.Constant(vector, [bound] * N_LANES) for bound in (0.0, -math.inf)))
    for v in vectors:
        for unit in units:
            total = totals[v][unit]
            value = builder.select(builder.fcmp_ordered("<", total, least), least, total)  # keeps NaN
            where = builder.add(builder.mul(number(v), n_out), number(unit))
            builder.store(value, lanes_at(out, where), align=4 * N_LANES)


def _not_unrolled(module: ir.Module) -> ir.MDValue:
    """Forbid LLVM to unroll a loop: it would run out of registers, spill the sums and take three times as long."""
    disable = module.add_metadata([ir.MetaDataString(module, "llvm.loop.unroll.disable")])
    loop = ir.MDValue(module, [disable], name=str(len(module.metadata)))
    loop.operands = (loop, disable)  # metadata of a loop begin with themselves
    return loop


def _tile_of(n_units: int) -> Any:
    """Make a function that computes a tile of n_units outputs."""

    @intrinsic
    def multiply_tile(typing: Any, x: Any, weight: Any, bias: Any, out: Any, n_in: Any, n_out: Any, relu: Any) -> Any:
        def emit(context: Any, builder: ir.IRBuilder, signature: Any, args: Any) -> ir.Value:
            pointer = ir.FloatType().as_pointer()
            addresses = [builder.inttoptr(address, pointer) for address in args[:4]]
            _tile(builder, addresses, args[4:6], args[6], n_units)
            return context.get_dummy_value()

        return types.void(*[types.intp] * 6, types.boolean), emit

    return multiply_tile


_multiply_tile, _multiply_half_tile = _tile_of(TILE_UNITS), _tile_of(TILE_UNITS // 2)


def _forward(layers: Int64, sizes: Int64, n_vectors: int, x: Pointer, out: Pointer, between: Pointer) -> None:
    """Evaluate the networks of all members.

    Args:
        layers: (n_members, n_layers, 2) addresses of panels and biases.
        sizes: (n_layers + 1,) inputs of each layer and outputs of the last, padded.
        n_vectors: vectors of samples per member, a multiple of TILE_VECTORS.
        x: (n_members, n_vectors, sizes[0], N_LANES) inputs.
        out: (n_members, n_vectors, sizes[-1], N_LANES) outputs.
        between: (2, TILE_VECTORS, widest layer, N_LANES) scratch for the values between two layers.
    """
    n_members, n_layers, _ = layers.shape
    vector = _NUMBER * N_LANES
    widest = sizes[1:].max()
    for member in range(n_members):
        for first in range(member * n_vectors, (member + 1) * n_vectors, TILE_VECTORS):
            rows = x + vector * first * sizes[0]
            for layer in range(n_layers):
                n_in, n_out = sizes[layer], sizes[layer + 1]
                last = layer == n_layers - 1
                inner = between + vector * (layer % 2) * TILE_VECTORS * widest
                result = out + vector * first * n_out if last else inner
                for unit in range(0, n_out, TILE_UNITS):
                    weight = layers[member, layer, 0] + _NUMBER * unit * n_in
                    bias = layers[member, layer, 1] + _NUMBER * unit
                    if n_out - unit >= TILE_UNITS:
                        _multiply_tile(rows, weight, bias, result + vector * unit, n_in, n_out, not last)
                    else:
                        _multiply_half_tile(rows, weight, bias, result + vector * unit, n_in, n_out, not last)
                rows = result


run_networks = compiled(_forward, seconds=2)


def _padded(n: int) -> int:
    """Round a number of outputs up to whole tiles, the last of which may be half a tile."""
    half = TILE_UNITS // 2
    return -(-n // half) * half


class PackedNetworks:
    """Networks of one shape, with their weights in the kernel's memory layout."""

    def __init__(
        self, weights: Sequence[Float32], biases: Sequence[Float32], inputs: tuple[tuple[bool, tuple[str, ...]], ...]
    ) -> None:
        """Pack the weights of networks with ReLU after every layer but the last.

        Args:
            weights: (n_members, n_in, n_out) of each layer.
            biases: (n_members, n_out) of each layer.
            inputs: what the first layer reads, in order: whether it is a magnitude, and of which one or two fields of
                :class:`tasks.world.LinkStates`.
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
        self._biases = [np.zeros((self.n_members, n_out), np.float32) for n_out in sizes[1:]]
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
        self.between = aligned((2, TILE_VECTORS, max(sizes[1:]), N_LANES))

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the weights alone: addresses and alignment hold in one process only."""
        return PackedNetworks, self._source

    def forward(self, rows: Float32) -> Float32:
        """Evaluate the networks: (n_members, n_rows, n_in) to (n_members, n_rows, n_out)."""
        n_rows = rows.shape[1]
        x, out = self.allocate(n_rows)
        filled = np.zeros((self.n_members, x.shape[1] * N_LANES, self._n_in), np.float32)
        filled[:, :n_rows] = rows
        x[:] = filled.reshape(self.n_members, -1, N_LANES, self._n_in).swapaxes(2, 3)
        run_networks(self.layers, self.sizes, x.shape[1], x.ctypes.data, out.ctypes.data, self.between.ctypes.data)
        return out.swapaxes(2, 3).reshape(self.n_members, -1, out.shape[2])[:, :n_rows, : self._n_out]

    def allocate(self, n_rows: int) -> tuple[Float32, Float32]:
        """Allocate inputs (n_members, n_vectors, n_in, N_LANES) and padded outputs for n_rows samples per member."""
        n_vectors = -(-n_rows // TILE_ROWS) * TILE_VECTORS
        shape = self.n_members, n_vectors
        return aligned((*shape, self._n_in, N_LANES)), aligned((*shape, int(self.sizes[-1]), N_LANES))


def _panels(weight: Float32, n_in: int, n_out: int) -> Float32:
    """Cut weights, padded with zeros, into panels that follow one another in memory: (n_members, n_in · n_out).

    A panel has (n_in, TILE_UNITS) numbers, the last one perhaps half as many.
    """
    n_members = len(weight)
    filled = np.zeros((n_members, n_in, n_out), np.float32)
    filled[:, : weight.shape[1], : weight.shape[2]] = weight
    panels = np.zeros((n_members, n_in * n_out), np.float32)
    for unit in range(0, n_out, TILE_UNITS):
        panel = filled[:, :, unit : unit + TILE_UNITS].reshape(n_members, -1)
        panels[:, unit * n_in : unit * n_in + panel.shape[1]] = panel
    return panels
