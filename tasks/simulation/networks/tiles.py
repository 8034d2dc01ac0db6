"""Tiles of products of matrices in vector registers: the instructions behind inference and training of networks.

A matrix of samples has N_LANES samples in a vector. A tile of sums stays in the vector registers while it runs over the
terms in their order, by fused multiply-adds. So its bits depend neither on other tiles nor on the width of a register.
"""

# mypy: disallow-untyped-decorators=False
# ruff: noqa: ARG001 (numba gives every intrinsic its context)

import math
from collections.abc import Callable, Sequence
from itertools import chain
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from tasks.simd.lanes import widest

Pointer = int  # address of float32 numbers in memory

N_LANES = widest() // 2  # lanes of a vector register
TILE_VECTORS = 2
TILE_UNITS = 8 if N_LANES == 16 else 4
"""Outputs of a tile: the most that leave registers for samples and weights. Layers are padded to half as many."""
TILE_ROWS = TILE_VECTORS * N_LANES
TILE_INPUTS = 2
"""Inputs of a tile of :data:`add_products`."""
NUMBER = 4  # size of a float32 [bytes]


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
        one = builder.load(builder.gep(pointer, [index]), align=NUMBER)
        first = builder.insert_element(undefined, one, ir.Constant(ir.IntType(32), 0))
        return builder.shuffle_vector(first, undefined, to_all)

    def factors(k: ir.Value) -> tuple[list[ir.Value], list[ir.Value]]:
        rows = [
            builder.load(lanes_at(x, builder.add(builder.mul(number(v), n_in), k)), align=NUMBER * N_LANES)
            for v in vectors
        ]
        first_weight = builder.mul(k, number(n_units))
        return rows, [in_all_lanes(weight, builder.add(first_weight, number(unit))) for unit in units]

    biases = [in_all_lanes(bias, number(unit)) for unit in units]
    totals = _accumulate(builder, n_in, [biases for _ in vectors], factors)
    # One bound for both cases: a choice per vector would become a jump per vector.
    least = builder.select(relu, *(ir.Constant(vector, [bound] * N_LANES) for bound in (0.0, -math.inf)))
    for v in vectors:
        for unit in units:
            total = totals[v][unit]
            value = builder.select(builder.fcmp_ordered("<", total, least), least, total)  # keeps NaN
            where = builder.add(builder.mul(number(v), n_out), number(unit))
            builder.store(value, lanes_at(out, where), align=NUMBER * N_LANES)


def _accumulate(
    builder: ir.IRBuilder,
    n: ir.Value,
    starts: Sequence[Sequence[ir.Value]],
    factors: Callable[[ir.Value], tuple[list[ir.Value], list[ir.Value]]],
) -> list[list[ir.Value]]:
    """Emit a loop of n rounds that adds products to sums, and return the totals: sums[i][j] += rows[i] · columns[j].

    ``factors`` emits the rows and columns of a round.
    """
    vector = ir.VectorType(ir.FloatType(), N_LANES)
    fma_type = ir.FunctionType(vector, [vector] * 3)
    fma = cgutils.get_or_insert_function(builder.module, fma_type, f"llvm.fma.v{N_LANES}f32")
    before, loop, after = builder.block, builder.append_basic_block("round"), builder.append_basic_block("sums")
    builder.branch(loop)
    builder.position_at_end(loop)
    k = builder.phi(n.type)
    k.add_incoming(ir.Constant(n.type, 0), before)
    sums = [[builder.phi(vector) for _ in row] for row in starts]
    rows, columns = factors(k)
    totals = [
        [builder.call(fma, [row, column, one]) for column, one in zip(columns, of_row, strict=True)]
        for row, of_row in zip(rows, sums, strict=True)
    ]
    following = builder.add(k, ir.Constant(n.type, 1))
    k.add_incoming(following, loop)
    for one, start, total in zip(chain(*sums), chain(*starts), chain(*totals), strict=True):
        one.add_incoming(start, before)
        one.add_incoming(total, loop)
    again = builder.cbranch(builder.icmp_signed("<", following, n), loop, after)
    again.set_metadata("llvm.loop", _not_unrolled(builder.module))
    builder.position_at_end(after)
    return totals


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


multiply_tile, multiply_half_tile = _tile_of(TILE_UNITS), _tile_of(TILE_UNITS // 2)


def _products(
    builder: ir.IRBuilder, pointers: Sequence[Any], sizes: Sequence[Any], n_inputs: int, n_units: int
) -> None:
    """Emit the instructions of sums[k, u] += Σ_v x[v, k] error[v, u] for n_inputs inputs k and n_units units u."""
    x, error, sums = pointers
    n_vectors, x_step, error_step, sums_step = sizes
    vector, size = ir.VectorType(ir.FloatType(), N_LANES), n_vectors.type
    inputs, units = range(n_inputs), range(n_units)

    def at(pointer: ir.Value, index: ir.Value) -> ir.Value:
        return builder.bitcast(builder.gep(pointer, [index]), vector.as_pointer())

    def rows(pointer: ir.Value, first: ir.Value, n: int) -> list[ir.Value]:
        lanes = (ir.Constant(size, k * N_LANES) for k in range(n))
        return [builder.load(at(pointer, builder.add(first, k)), align=NUMBER * N_LANES) for k in lanes]

    def factors(v: ir.Value) -> tuple[list[ir.Value], list[ir.Value]]:
        of_inputs = rows(x, builder.mul(v, x_step), n_inputs)
        return of_inputs, rows(error, builder.mul(v, error_step), n_units)

    places = [[at(sums, builder.mul(sums_step, ir.Constant(size, k * n_units + u))) for u in units] for k in inputs]
    starts = [[builder.load(place, align=NUMBER * N_LANES) for place in row] for row in places]
    totals = _accumulate(builder, n_vectors, starts, factors)
    for total, place in zip(chain(*totals), chain(*places), strict=True):
        builder.store(total, place, align=NUMBER * N_LANES)


def _products_of(n_inputs: int, n_units: int) -> Any:
    """Make a function that adds the products of n_inputs inputs and n_units units."""

    @intrinsic
    def add_products(
        typing: Any, x: Any, error: Any, sums: Any, n_vectors: Any, x_step: Any, error_step: Any, sums_step: Any
    ) -> Any:
        def emit(context: Any, builder: ir.IRBuilder, signature: Any, args: Any) -> ir.Value:
            pointer = ir.FloatType().as_pointer()
            addresses = [builder.inttoptr(address, pointer) for address in args[:3]]
            _products(builder, addresses, args[3:], n_inputs, n_units)
            return context.get_dummy_value()

        return types.void(*[types.intp] * 7), emit

    return add_products


add_products, add_products_of_half = _products_of(TILE_INPUTS, TILE_UNITS), _products_of(TILE_INPUTS, TILE_UNITS // 2)
add_products_of_one, add_products_of_one_and_half = _products_of(1, TILE_UNITS), _products_of(1, TILE_UNITS // 2)
