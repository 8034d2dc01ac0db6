"""Lanes: vectors of numbers inside numba, one robot per lane, in explicit SIMD instructions.

A kernel written on lanes reads like the scalar code that it follows: ``block[row]`` loads the lanes of a row of float32
and ``block[row] = lanes`` stores them; the operators work lane by lane; :func:`select` takes the place of a branch. A
kernel is compiled for as many lanes as its block has, and gives the same bits for any number: every operation is rounded
on its own, nothing is contracted or reassociated. A Python number that meets lanes takes their precision, as in NumPy. There
are no in-place operators, which would change an array under every name that it has.

Without the compiler (NUMBA_DISABLE_JIT=1) the same kernels run in plain Python, their lanes being NumPy arrays, and the
functions below are what they call. Under the compiler each of these is a typing rule and a few instructions instead.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from fractions import Fraction
from typing import Any

import llvmlite.binding as llvm
import numba
import numpy as np
import numpy.typing as npt
from llvmlite import ir
from numba.core import cgutils, types
from numba.core.imputils import lower_builtin, lower_cast
from numba.extending import NativeValue, models, register_model, type_callable, typeof_impl, unbox

ALIGNMENT = 64
"""Bytes: a whole AVX-512 register, a whole cache line."""

inline = numba.njit(forceinline=True, error_model="numpy")
"""Marks a piece of a kernel: compiled into whatever calls it."""

# ------------------------------------------------------------------------------------------------- in plain Python


class Block:
    """Rows of lanes in aligned memory: what kernels load from and store to."""

    def __init__(self, n_rows: int, n_lanes: int) -> None:
        self.rows = aligned((n_rows, n_lanes))
        self.address: int = self.rows.ctypes.data
        self.n_lanes = n_lanes

    def __getitem__(self, row: int) -> npt.NDArray[np.float32]:
        return self.rows[row].copy()

    def __setitem__(self, row: int, lanes: npt.ArrayLike) -> None:
        self.rows[row] = lanes


def aligned(shape: tuple[int, ...]) -> npt.NDArray[np.float32]:
    """Zeros in float32 that begin on a boundary of a cache line."""
    n_bytes = int(np.prod(shape)) * 4
    memory = np.zeros(n_bytes + ALIGNMENT, np.uint8)
    start = -memory.ctypes.data % ALIGNMENT
    return memory[start : start + n_bytes].view(np.float32).reshape(shape)


def from_row(block: Any, row: int) -> Any:
    """View of a block that begins at a row."""
    view = Block.__new__(Block)
    view.rows, view.n_lanes = block.rows[row:], block.n_lanes
    view.address = view.rows.ctypes.data
    return view


def select(mask: Any, yes: Any, no: Any) -> Any:
    """``yes`` in the lanes where the mask holds, ``no`` in the others; two Python numbers make lanes of float32."""
    if isinstance(yes, float) and isinstance(no, float):
        return np.where(mask, np.float32(yes), np.float32(no))
    return np.where(mask, yes, no)


def any_lane(mask: Any) -> bool:
    """Whether the mask holds in any lane."""
    return bool(np.any(mask))


def sqrt(lanes: Any) -> Any:
    """Square root, correctly rounded."""
    return np.sqrt(lanes)


def floor(lanes: Any) -> Any:
    """Round down to a whole number."""
    return np.floor(lanes)


def to_double(lanes: Any) -> Any:
    """Widen float32 or int32 lanes to float64."""
    return lanes.astype(np.float64)


def to_single(lanes: Any) -> Any:
    """Round float64 lanes to float32."""
    return lanes.astype(np.float32)


def truncate(lanes: Any) -> Any:
    """Round float64 lanes towards zero, to int32; they must fit."""
    return lanes.astype(np.int32)


def fma(a: Any, b: Any, c: Any) -> Any:
    """a · b + c of float64 lanes, rounded once."""

    def one(a: float, b: float, c: float) -> float:
        return float(Fraction(a) * Fraction(b) + Fraction(c)) if np.isfinite(a + b + c) else a * b + c

    return np.array([one(*abc) for abc in zip(*np.broadcast_arrays(a, b, c), strict=True)])


def lane(lanes: Any, index: int) -> Any:
    """One lane's number."""
    return lanes[index]


def with_lane(lanes: Any, index: int, number: Any) -> Any:
    """The same lanes, one of them replaced."""
    replaced = lanes.copy()
    replaced[index] = number
    return replaced


def count_lanes(lanes: Any) -> int:
    """How many lanes there are."""
    return len(lanes)


def widest() -> int:
    """Number of lanes that this machine's vector registers favour; the bits do not depend on it."""
    features = llvm.get_host_cpu_features()
    if features.get("avx512f"):
        return 32
    if features.get("avx"):
        return 16
    return 8


# ---------------------------------------------------------------------------------------------- under the compiler

FLOAT, DOUBLE, INT, BIT = ir.FloatType(), ir.DoubleType(), ir.IntType(32), ir.IntType(1)
_ELEMENTS = {"float32": FLOAT, "float64": DOUBLE, "int32": INT, "bool": BIT}
_SCALARS = {"float32": types.float32, "float64": types.float64, "int32": types.int32}


class Lanes(types.Type):
    """numba's type of a vector."""

    def __init__(self, element: str, count: int) -> None:
        self.element, self.count = element, count
        super().__init__(name=f"Lanes({element}, {count})")

    def of(self, element: str) -> Lanes:
        """Return as many lanes of another element."""
        return Lanes(element, self.count)


class BlockType(types.Type):
    """numba's type of a :class:`Block` with a given number of lanes."""

    def __init__(self, count: int) -> None:
        self.count = count
        super().__init__(name=f"Block({count})")


def _vector(lanes: Lanes) -> ir.VectorType:
    return ir.VectorType(_ELEMENTS[lanes.element], lanes.count)


@register_model(Lanes)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, dmm: Any, fe_type: Lanes) -> None:
        super().__init__(dmm, fe_type, _vector(fe_type))


@register_model(BlockType)
class _BlockModel(models.PrimitiveModel):
    def __init__(self, dmm: Any, fe_type: BlockType) -> None:
        super().__init__(dmm, fe_type, ir.VectorType(FLOAT, fe_type.count).as_pointer())


@typeof_impl.register(Block)
def _typeof_block(block: Block, context: Any) -> BlockType:
    return BlockType(block.n_lanes)


@unbox(BlockType)
def _unbox_block(block_type: BlockType, block: Any, c: Any) -> NativeValue:
    address = c.pyapi.object_getattr_string(block, "address")
    pointer = c.pyapi.long_as_voidptr(address)
    c.pyapi.decref(address)
    pointer_type = c.context.get_value_type(block_type)
    return NativeValue(c.builder.bitcast(pointer, pointer_type), is_error=c.pyapi.c_api_error())


def _splat(builder: ir.IRBuilder, number: ir.Value, vector: ir.VectorType) -> ir.Value:
    if isinstance(number, ir.Constant):
        return ir.Constant(vector, [number.constant] * vector.count)
    first = builder.insert_element(ir.Constant(vector, ir.Undefined), number, ir.Constant(INT, 0))
    return builder.shuffle_vector(
        first, ir.Constant(vector, ir.Undefined), ir.Constant(ir.VectorType(INT, vector.count), [0] * vector.count)
    )


def _as_lanes(context: Any, builder: ir.IRBuilder, value: ir.Value, of: types.Type, lanes: Lanes) -> ir.Value:
    """Bring a number, or lanes, to the type of some lanes."""
    if isinstance(of, Lanes):
        return value
    scalar = _SCALARS[lanes.element]
    return _splat(builder, context.cast(builder, value, of, scalar), _vector(lanes))


def _is_number(of: Any) -> bool:
    return isinstance(of, types.Number | types.Boolean)


def _common(a: Any, b: Any) -> Lanes | None:
    """Type of the lanes that two operands have in common; None if that is not for us."""
    if isinstance(a, Lanes) and (a == b or _is_number(b)):
        return a
    if isinstance(b, Lanes) and _is_number(a):
        return b
    return None


_Emit = Callable[[ir.IRBuilder, ir.Value, ir.Value], ir.Value]


def _binary(function: Any, emit: dict[str, _Emit], *, compares: bool = False) -> None:
    """Teach numba an operator of two operands, for each kind of element."""

    @type_callable(function)
    def _type(context: Any) -> Any:
        def typer(a: Any, b: Any) -> Any:
            lanes = _common(a, b)
            if lanes is None or lanes.element not in emit:
                return None
            return lanes.of("bool") if compares else lanes

        return typer

    def lower(context: Any, builder: ir.IRBuilder, signature: Any, args: Any) -> ir.Value:
        lanes = _common(*signature.args)
        assert lanes is not None
        left, right = (_as_lanes(context, builder, x, of, lanes) for x, of in zip(args, signature.args, strict=True))
        return emit[lanes.element](builder, left, right)

    for operands in ((Lanes, Lanes), (Lanes, types.Number), (types.Number, Lanes)):
        lower_builtin(function, *operands)(lower)


def _floats(method: str) -> dict[str, _Emit]:
    def emit(builder: ir.IRBuilder, a: ir.Value, b: ir.Value) -> ir.Value:
        return getattr(builder, method)(a, b)

    return {"float32": emit, "float64": emit}


def _integers(method: str, element: str = "int32") -> dict[str, _Emit]:
    return {element: lambda builder, a, b: getattr(builder, method)(a, b)}


def _comparison(sign: str) -> dict[str, _Emit]:
    def floats(builder: ir.IRBuilder, a: ir.Value, b: ir.Value) -> ir.Value:
        # Against NaN all are false but "unlike", as in C.
        return builder.fcmp_unordered(sign, a, b) if sign == "!=" else builder.fcmp_ordered(sign, a, b)

    return {"float32": floats, "float64": floats, "int32": lambda builder, a, b: builder.icmp_signed(sign, a, b)}


_binary(operator.add, _floats("fadd") | _integers("add"))
_binary(operator.sub, _floats("fsub") | _integers("sub"))
_binary(operator.mul, _floats("fmul") | _integers("mul"))
_binary(operator.truediv, _floats("fdiv"))
_binary(operator.and_, _integers("and_") | _integers("and_", "bool"))
_binary(operator.or_, _integers("or_") | _integers("or_", "bool"))
_binary(operator.rshift, _integers("ashr"))
for _function, _sign in (
    (operator.lt, "<"),
    (operator.le, "<="),
    (operator.gt, ">"),
    (operator.ge, ">="),
    (operator.eq, "=="),
    (operator.ne, "!="),
):
    _binary(_function, _comparison(_sign), compares=True)


def _unary(function: Any, emit: Callable[[ir.IRBuilder, ir.Value, Lanes], ir.Value], gives: dict[str, str]) -> None:
    """Teach numba a function of one operand: the element it gives for each element that it takes."""

    @type_callable(function)
    def _type(context: Any) -> Any:
        def typer(a: Any) -> Any:
            return a.of(gives[a.element]) if isinstance(a, Lanes) and a.element in gives else None

        return typer

    @lower_builtin(function, Lanes)
    def _lower(context: Any, builder: ir.IRBuilder, signature: Any, args: Any) -> ir.Value:
        return emit(builder, args[0], signature.return_type)


def _call_intrinsic(builder: ir.IRBuilder, name: str, lanes: Lanes, values: list[ir.Value]) -> ir.Value:
    vector = _vector(lanes)
    full_name = f"llvm.{name}.v{lanes.count}{_ELEMENTS[lanes.element].intrinsic_name}"
    function_type = ir.FunctionType(vector, [vector] * len(values))
    return builder.call(cgutils.get_or_insert_function(builder.module, function_type, full_name), values)


def _intrinsic(name: str) -> Callable[[ir.IRBuilder, ir.Value, Lanes], ir.Value]:
    return lambda builder, value, gives: _call_intrinsic(builder, name, gives, [value])


_SAME_FLOAT = {"float32": "float32", "float64": "float64"}
_unary(abs, _intrinsic("fabs"), _SAME_FLOAT)
_unary(sqrt, _intrinsic("sqrt"), _SAME_FLOAT)
_unary(floor, _intrinsic("floor"), _SAME_FLOAT)
_unary(operator.neg, lambda builder, value, gives: builder.fneg(value), _SAME_FLOAT)
_unary(operator.invert, lambda builder, value, gives: builder.not_(value), {"bool": "bool"})
_unary(to_single, lambda builder, value, gives: builder.fptrunc(value, _vector(gives)), {"float64": "float32"})
_unary(truncate, lambda builder, value, gives: builder.fptosi(value, _vector(gives)), {"float64": "int32"})


def _widen(builder: ir.IRBuilder, value: ir.Value, gives: Lanes) -> ir.Value:
    convert = builder.sitofp if value.type.element == INT else builder.fpext
    return convert(value, _vector(gives))


_unary(to_double, _widen, {"float32": "float64", "int32": "float64"})


@type_callable(select)
def _type_select(context: Any) -> Any:
    def typer(mask: Any, yes: Any, no: Any) -> Any:
        if not isinstance(mask, Lanes) or mask.element != "bool":
            return None
        return mask.of("float32") if _is_number(yes) and _is_number(no) else _common(yes, no)

    return typer


@lower_builtin(select, Lanes, types.Any, types.Any)
def _lower_select(context: Any, builder: ir.IRBuilder, signature: Any, args: Any) -> ir.Value:
    yes, no = (
        _as_lanes(context, builder, value, of, signature.return_type)
        for value, of in zip(args[1:], signature.args[1:], strict=True)
    )
    return builder.select(args[0], yes, no)


@type_callable(any_lane)
def _type_any(context: Any) -> Any:
    return lambda mask: types.boolean if isinstance(mask, Lanes) and mask.element == "bool" else None


@lower_builtin(any_lane, Lanes)
def _lower_any(context: Any, builder: ir.IRBuilder, signature: Any, args: Any) -> ir.Value:
    bits = ir.IntType(signature.args[0].count)
    return builder.icmp_unsigned("!=", builder.bitcast(args[0], bits), ir.Constant(bits, 0))


@type_callable(fma)
def _type_fma(context: Any) -> Any:
    def typer(a: Any, b: Any, c: Any) -> Any:
        return a if isinstance(a, Lanes) and all(x == a or _is_number(x) for x in (b, c)) else None

    return typer


@lower_builtin(fma, Lanes, types.Any, types.Any)
def _lower_fma(context: Any, builder: ir.IRBuilder, signature: Any, args: Any) -> ir.Value:
    lanes = signature.return_type
    values = [_as_lanes(context, builder, x, of, lanes) for x, of in zip(args, signature.args, strict=True)]
    return _call_intrinsic(builder, "fma", lanes, values)


@type_callable(lane)
def _type_lane(context: Any) -> Any:
    return lambda lanes, index: _SCALARS[lanes.element] if isinstance(lanes, Lanes) else None


@lower_builtin(lane, Lanes, types.Integer)
def _lower_lane(context: Any, builder: ir.IRBuilder, signature: Any, args: Any) -> ir.Value:
    return builder.extract_element(args[0], args[1])


@type_callable(with_lane)
def _type_with_lane(context: Any) -> Any:
    return lambda lanes, index, number: lanes if isinstance(lanes, Lanes) else None


@lower_builtin(with_lane, Lanes, types.Integer, types.Number)
def _lower_with_lane(context: Any, builder: ir.IRBuilder, signature: Any, args: Any) -> ir.Value:
    number = context.cast(builder, args[2], signature.args[2], _SCALARS[signature.args[0].element])
    return builder.insert_element(args[0], number, args[1])


@type_callable(count_lanes)
def _type_count(context: Any) -> Any:
    return lambda lanes: types.intp if isinstance(lanes, Lanes) else None


@lower_builtin(count_lanes, Lanes)
def _lower_count(context: Any, builder: ir.IRBuilder, signature: Any, args: Any) -> ir.Value:
    return ir.Constant(ir.IntType(types.intp.bitwidth), signature.args[0].count)


@type_callable(operator.getitem)
def _type_load(context: Any) -> Any:
    def typer(block: Any, row: Any) -> Any:
        return Lanes("float32", block.count) if isinstance(block, BlockType) and isinstance(row, types.Integer) else None

    return typer


def _align(n_lanes: int) -> int:
    """Bytes at which every row of a block is sure to begin."""
    n_bytes = 4 * n_lanes
    return min(ALIGNMENT, n_bytes & -n_bytes)


@lower_builtin(operator.getitem, BlockType, types.Integer)
def _lower_load(context: Any, builder: ir.IRBuilder, signature: Any, args: Any) -> ir.Value:
    return builder.load(builder.gep(args[0], [args[1]]), align=_align(signature.args[0].count))


@type_callable(operator.setitem)
def _type_store(context: Any) -> Any:
    def typer(block: Any, row: Any, lanes: Any) -> Any:
        ours = isinstance(block, BlockType) and isinstance(row, types.Integer)
        return types.none if ours and _common(Lanes("float32", block.count), lanes) else None

    return typer


@lower_builtin(operator.setitem, BlockType, types.Integer, types.Any)
def _lower_store(context: Any, builder: ir.IRBuilder, signature: Any, args: Any) -> ir.Value:
    count = signature.args[0].count
    value = _as_lanes(context, builder, args[2], signature.args[2], Lanes("float32", count))
    builder.store(value, builder.gep(args[0], [args[1]]), align=_align(count))
    return context.get_dummy_value()


@type_callable(from_row)
def _type_from_row(context: Any) -> Any:
    return lambda block, row: block if isinstance(block, BlockType) else None


@lower_builtin(from_row, BlockType, types.Integer)
def _lower_from_row(context: Any, builder: ir.IRBuilder, signature: Any, args: Any) -> ir.Value:
    return builder.gep(args[0], [args[1]])


@lower_cast(Lanes, Lanes)
def _cast_lanes(context: Any, builder: ir.IRBuilder, from_type: Any, to_type: Any, value: ir.Value) -> ir.Value:
    return value
