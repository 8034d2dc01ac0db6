"""Lanes under the compiler: numba's types for them, and the instructions that their operators and functions become.

Importing this module teaches numba the functions of lanes.py. Each operator has a typing rule and a lowering to LLVM's
vectors, which LLVM splits or widens to the registers of the machine.
"""

# mypy: disallow-untyped-decorators=False, disallow-subclassing-any=False, warn-return-any=False
# ruff: noqa: ARG001 (numba calls every rule and lowering with the same arguments)

from __future__ import annotations

import functools
import math
import operator
from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.core.imputils import lower_builtin, lower_cast
from numba.extending import NativeValue, intrinsic, models, overload, register_model, type_callable, typeof_impl, unbox

from tasks.simd import lanes as simd
from tasks.simd.lanes import ALIGNMENT, Block

_FLOAT, _INT = ir.FloatType(), ir.IntType(32)
_ELEMENTS = {"float32": _FLOAT, "float64": ir.DoubleType(), "int32": _INT, "bool": ir.IntType(1)}
_SCALARS = {"float32": types.float32, "float64": types.float64, "int32": types.int32}


class _LanesType(types.Type):
    """numba's type of a vector."""

    def __init__(self, element: str, count: int) -> None:
        self.element, self.count = element, count
        super().__init__(name=f"Lanes({element}, {count})")

    def of(self, element: str) -> _LanesType:  # as many lanes of another element
        return _LanesType(element, self.count)


class _BlockType(types.Type):
    """numba's type of a :class:`Block` with a given number of lanes."""

    def __init__(self, count: int) -> None:
        self.count = count
        super().__init__(name=f"Block({count})")


def _vector(lanes: _LanesType) -> ir.VectorType:
    return ir.VectorType(_ELEMENTS[lanes.element], lanes.count)


@register_model(_LanesType)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, dmm: Any, fe_type: _LanesType) -> None:
        super().__init__(dmm, fe_type, _vector(fe_type))


@register_model(_BlockType)
class _BlockModel(models.PrimitiveModel):
    def __init__(self, dmm: Any, fe_type: _BlockType) -> None:
        super().__init__(dmm, fe_type, ir.VectorType(_FLOAT, fe_type.count).as_pointer())


@typeof_impl.register(Block)
def _typeof_block(block: Block, context: Any) -> _BlockType:
    return _BlockType(block.n_lanes)


@unbox(_BlockType)
def _unbox_block(block_type: _BlockType, block: Any, c: Any) -> NativeValue:
    address = c.pyapi.object_getattr_string(block, "address")
    pointer = c.pyapi.long_as_voidptr(address)
    c.pyapi.decref(address)
    pointer_type = c.context.get_value_type(block_type)
    return NativeValue(c.builder.bitcast(pointer, pointer_type), is_error=c.pyapi.c_api_error())


def _splat(builder: ir.IRBuilder, number: ir.Value, vector: ir.VectorType) -> ir.Value:
    if isinstance(number, ir.Constant):
        return ir.Constant(vector, [number.constant] * vector.count)
    undefined, of_first = ir.Constant(vector, ir.Undefined), ir.Constant(ir.VectorType(_INT, vector.count), None)
    first = builder.insert_element(undefined, number, ir.Constant(_INT, 0))
    return builder.shuffle_vector(first, undefined, of_first)


def _as_lanes(
    context: Any, builder: ir.IRBuilder, value: ir.Value, value_type: types.Type, lanes: _LanesType
) -> ir.Value:
    """Convert a number, or lanes, to the type of some lanes."""
    if isinstance(value_type, _LanesType):
        return value
    scalar = _SCALARS[lanes.element]
    return _splat(builder, context.cast(builder, value, value_type, scalar), _vector(lanes))


def _is_number(operand: Any) -> bool:
    return isinstance(operand, types.Number | types.Boolean)


def _common(a: Any, b: Any) -> _LanesType | None:
    """Return the type of lanes that two operands have in common, None if they are of other types."""
    if isinstance(a, _LanesType) and (a == b or _is_number(b)):
        return a
    if isinstance(b, _LanesType) and _is_number(a):
        return b
    return None


_Emit = Callable[[ir.IRBuilder, ir.Value, ir.Value], ir.Value]


def _binary(function: Any, emit: dict[str, _Emit], *, compares: bool = False) -> None:
    """Teach numba an operator of two operands, for each kind of element."""

    def typer(a: Any, b: Any) -> Any:
        lanes = _common(a, b)
        if lanes is None or lanes.element not in emit:
            return None
        return lanes.of("bool") if compares else lanes

    def lower(context: Any, builder: ir.IRBuilder, signature: Any, args: Any) -> ir.Value:
        lanes = _common(*signature.args)
        assert lanes is not None
        left, right = (
            _as_lanes(context, builder, x, value_type, lanes)
            for x, value_type in zip(args, signature.args, strict=True)
        )
        return emit[lanes.element](builder, left, right)

    type_callable(function)(lambda context: typer)
    for operands in ((_LanesType, _LanesType), (_LanesType, types.Number), (types.Number, _LanesType)):
        lower_builtin(function, *operands)(lower)


def _floats(method: str) -> dict[str, _Emit]:
    def emit(builder: ir.IRBuilder, a: ir.Value, b: ir.Value) -> ir.Value:
        return getattr(builder, method)(a, b)

    return {"float32": emit, "float64": emit}


def _integers(method: str, element: str = "int32") -> dict[str, _Emit]:
    return {element: lambda builder, a, b: getattr(builder, method)(a, b)}


def _comparison(sign: str) -> dict[str, _Emit]:
    def floats(builder: ir.IRBuilder, a: ir.Value, b: ir.Value) -> ir.Value:
        # Comparisons with NaN are false, except !=, as in C.
        return builder.fcmp_unordered(sign, a, b) if sign == "!=" else builder.fcmp_ordered(sign, a, b)

    return {"float32": floats, "float64": floats, "int32": lambda builder, a, b: builder.icmp_signed(sign, a, b)}


_binary(operator.add, _floats("fadd") | _integers("add"))
_binary(operator.sub, _floats("fsub") | _integers("sub"))
_binary(operator.mul, _floats("fmul") | _integers("mul"))
_binary(operator.truediv, _floats("fdiv"))
_binary(operator.and_, _integers("and_") | _integers("and_", "bool"))
_binary(operator.or_, _integers("or_") | _integers("or_", "bool"))
_binary(operator.rshift, _integers("ashr"))
for _name, _sign in {"lt": "<", "le": "<=", "gt": ">", "ge": ">=", "eq": "==", "ne": "!="}.items():
    _binary(getattr(operator, _name), _comparison(_sign), compares=True)


_EmitUnary = Callable[[ir.IRBuilder, ir.Value, _LanesType], ir.Value]


def _unary(function: Any, emit: _EmitUnary, gives: dict[str, str]) -> None:
    """Teach numba a function of one operand; ``gives`` maps elements of the operand to elements of the result."""

    def typer(a: Any) -> Any:
        return a.of(gives[a.element]) if isinstance(a, _LanesType) and a.element in gives else None

    type_callable(function)(lambda context: typer)

    @lower_builtin(function, _LanesType)
    def _lower(context: Any, builder: ir.IRBuilder, signature: Any, args: Any) -> ir.Value:
        return emit(builder, args[0], signature.return_type)


def _call_intrinsic(builder: ir.IRBuilder, name: str, lanes: _LanesType, values: list[ir.Value]) -> ir.Value:
    vector = _vector(lanes)
    full_name = f"llvm.{name}.v{lanes.count}{_ELEMENTS[lanes.element].intrinsic_name}"
    function_type = ir.FunctionType(vector, [vector] * len(values))
    return builder.call(cgutils.get_or_insert_function(builder.module, function_type, full_name), values)


def _intrinsic(name: str) -> _EmitUnary:
    return lambda builder, value, gives: _call_intrinsic(builder, name, gives, [value])


_SAME_FLOAT = {"float32": "float32", "float64": "float64"}
_unary(abs, _intrinsic("fabs"), _SAME_FLOAT)
_unary(simd.sqrt, _intrinsic("sqrt"), _SAME_FLOAT)
_unary(simd.floor, _intrinsic("floor"), _SAME_FLOAT)
_unary(operator.neg, lambda builder, value, gives: builder.fneg(value), _SAME_FLOAT)
_unary(operator.invert, lambda builder, value, gives: builder.not_(value), {"bool": "bool"})
_unary(simd.to_single, lambda builder, value, gives: builder.fptrunc(value, _vector(gives)), {"float64": "float32"})
_unary(simd.truncate, lambda builder, value, gives: builder.fptosi(value, _vector(gives)), {"float64": "int32"})


def _widen(builder: ir.IRBuilder, value: ir.Value, gives: _LanesType) -> ir.Value:
    convert = builder.sitofp if value.type.element == _INT else builder.fpext
    return convert(value, _vector(gives))


_unary(simd.to_double, _widen, {"float32": "float64", "int32": "float64"})


def _teaches(function: Any, *operands: Any, gives: Callable[..., Any]) -> Callable[[Any], Any]:
    """Decorate the lowering of a function or operator: teach numba it for some types of operands.

    ``gives`` maps the operands' types to the type of the result, None if they do not fit.
    """

    @functools.wraps(gives)  # numba reads the names of the parameters
    def typer(*arguments: Any) -> Any:
        fits = all(kind is types.Any or isinstance(one, kind) for one, kind in zip(arguments, operands, strict=True))
        return gives(*arguments) if fits else None

    type_callable(function)(lambda context: typer)
    return lower_builtin(function, *operands)


def _type_select(mask: Any, yes: Any, no: Any) -> Any:
    if mask.element != "bool":
        return None
    return mask.of("float32") if _is_number(yes) and _is_number(no) else _common(yes, no)


@_teaches(simd.select, _LanesType, types.Any, types.Any, gives=_type_select)
def _lower_select(context: Any, builder: ir.IRBuilder, signature: Any, args: Any) -> ir.Value:
    yes, no = (
        _as_lanes(context, builder, value, value_type, signature.return_type)
        for value, value_type in zip(args[1:], signature.args[1:], strict=True)
    )
    return builder.select(args[0], yes, no)


@_teaches(simd.any_lane, _LanesType, gives=lambda mask: types.boolean if mask.element == "bool" else None)
def _lower_any(context: Any, builder: ir.IRBuilder, signature: Any, args: Any) -> ir.Value:
    bits = ir.IntType(signature.args[0].count)
    return builder.icmp_unsigned("!=", builder.bitcast(args[0], bits), ir.Constant(bits, 0))


def _type_fma(a: Any, b: Any, c: Any) -> Any:
    return a if all(x == a or _is_number(x) for x in (b, c)) else None


@_teaches(simd.fma, _LanesType, types.Any, types.Any, gives=_type_fma)
def _lower_fma(context: Any, builder: ir.IRBuilder, signature: Any, args: Any) -> ir.Value:
    lanes = signature.return_type
    values = [
        _as_lanes(context, builder, x, value_type, lanes) for x, value_type in zip(args, signature.args, strict=True)
    ]
    return _call_intrinsic(builder, "fma", lanes, values)


@_teaches(simd.lane, _LanesType, types.Integer, gives=lambda lanes, index: _SCALARS[lanes.element])
def _lower_lane(context: Any, builder: ir.IRBuilder, signature: Any, args: Any) -> ir.Value:
    return builder.extract_element(args[0], args[1])


@_teaches(simd.with_lane, _LanesType, types.Integer, types.Number, gives=lambda lanes, index, number: lanes)
def _lower_with_lane(context: Any, builder: ir.IRBuilder, signature: Any, args: Any) -> ir.Value:
    number = context.cast(builder, args[2], signature.args[2], _SCALARS[signature.args[0].element])
    return builder.insert_element(args[0], number, args[1])


@_teaches(simd.count_lanes, _LanesType, gives=lambda lanes: types.intp)
def _lower_count(context: Any, builder: ir.IRBuilder, signature: Any, args: Any) -> ir.Value:
    return context.get_constant(types.intp, signature.args[0].count)


def _align(n_lanes: int) -> int:
    """Return the alignment that every row of a block is sure to have [bytes]."""
    n_bytes = 4 * n_lanes
    return min(ALIGNMENT, n_bytes & -n_bytes)


@_teaches(operator.getitem, _BlockType, types.Integer, gives=lambda block, row: _LanesType("float32", block.count))
def _lower_load(context: Any, builder: ir.IRBuilder, signature: Any, args: Any) -> ir.Value:
    return builder.load(builder.gep(args[0], [args[1]]), align=_align(signature.args[0].count))


def _type_store(block: Any, row: Any, lanes: Any) -> Any:
    return types.none if _common(_LanesType("float32", block.count), lanes) else None


@_teaches(operator.setitem, _BlockType, types.Integer, types.Any, gives=_type_store)
def _lower_store(context: Any, builder: ir.IRBuilder, signature: Any, args: Any) -> ir.Value:
    block_type = signature.args[0]
    value = _as_lanes(context, builder, args[2], signature.args[2], _LanesType("float32", block_type.count))
    builder.store(value, builder.gep(args[0], [args[1]]), align=_align(block_type.count))
    return context.get_dummy_value()


@_teaches(simd.from_row, _BlockType, types.Integer, gives=lambda block, row: block)
def _lower_from_row(context: Any, builder: ir.IRBuilder, signature: Any, args: Any) -> ir.Value:
    return builder.gep(args[0], [args[1]])


@_teaches(
    simd.call,
    types.Integer,
    _BlockType,
    _BlockType,
    types.Integer,
    gives=lambda address, block, factors, number: types.none,
)
def _lower_call(context: Any, builder: ir.IRBuilder, signature: Any, args: Any) -> ir.Value:
    operands = (*signature.args[1:3], types.intp)
    number = context.cast(builder, args[3], signature.args[3], types.intp)
    function_type = context.call_conv.get_function_type(types.none, operands)
    function = builder.inttoptr(args[0], function_type.as_pointer())
    context.call_conv.call_function(builder, function, types.none, operands, [args[1], args[2], number])
    return context.get_dummy_value()


@lower_cast(_LanesType, _LanesType)
def _cast_lanes(context: Any, builder: ir.IRBuilder, from_type: Any, to_type: Any, value: ir.Value) -> ir.Value:
    return value


# The same functions of numbers, for formulas that scalar code shares with the lanes.


@overload(simd.select, strict=False)
def _select_number(mask: Any, yes: Any, no: Any) -> Any:
    return (lambda mask, yes, no: yes if mask else no) if isinstance(mask, types.Boolean) else None


def _of_number(function: Any, of_number: Callable[[Any], Any]) -> None:
    """Teach numba what a function of lanes returns for a number."""

    @overload(function, strict=False)
    def _overload(number: Any) -> Any:
        return of_number if _is_number(number) else None


_of_number(simd.any_lane, lambda mask: mask)
_of_number(simd.sqrt, lambda number: math.sqrt(number))
_of_number(simd.floor, lambda number: np.floor(number))
_of_number(simd.to_double, lambda number: np.float64(number))
_of_number(simd.to_single, lambda number: np.float32(number))
_of_number(simd.truncate, lambda number: np.int32(number))


@intrinsic
def _fused(context: Any, a: Any, b: Any, c: Any) -> Any:
    def lower(context: Any, builder: ir.IRBuilder, signature: Any, args: Any) -> ir.Value:
        return builder.fma(*args)

    return types.float64(types.float64, types.float64, types.float64), lower


@overload(simd.fma, strict=False)
def _fma_number(a: Any, b: Any, c: Any) -> Any:
    return (lambda a, b, c: _fused(a, b, c)) if _is_number(a) else None
