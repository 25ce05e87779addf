"""SIMD vectors of eight float64 for compiled functions; code that is written for numbers works on vectors, too.

Arithmetic operators, `abs`, `math.sqrt` and `np.rint` work as on numbers. `full` and `lane_load` make vectors, and `store` writes
them to arrays. Comparisons give masks, which `lane_select` and `bits` take.
"""

# Pyright reports every call of an @intrinsic function, because numba itself passes the first argument.
# pyright: reportCallIssue=false, reportOptionalCall=false
import math
import operator
from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, overload, register_model

from .array_view import parts_of

# Number of float64 in a SIMD vector, which fill two registers of AVX2 or one of AVX-512. With four, AVX2 would do less work at a
# time without being faster, because the processor mostly waits for the results of earlier operations.
WIDTH = 8
_DATA = ir.VectorType(ir.DoubleType(), WIDTH)
_BITS = ir.VectorType(ir.IntType(1), WIDTH)


class _Vector(types.Type):
    def __init__(self) -> None:
        super().__init__(name=f"float64x{WIDTH}")


class _Mask(types.Type):
    def __init__(self) -> None:
        super().__init__(name=f"mask{WIDTH}")


vector, mask = _Vector(), _Mask()


@register_model(_Vector)
class _VectorModel(models.PrimitiveModel):
    def __init__(self, dmm, fe_type) -> None:
        super().__init__(dmm, fe_type, _DATA)


@register_model(_Mask)
class _MaskModel(models.PrimitiveModel):
    def __init__(self, dmm, fe_type) -> None:
        super().__init__(dmm, fe_type, _BITS)


def _splat(builder: Any, number: Any) -> Any:
    undefined = ir.Constant(_DATA, ir.Undefined)
    first = builder.insert_element(undefined, number, ir.Constant(ir.IntType(32), 0))
    return builder.shuffle_vector(first, undefined, ir.Constant(ir.VectorType(ir.IntType(32), WIDTH), [0] * WIDTH))


def _binary(op: Callable, emit: Callable, result: types.Type) -> None:
    """Define an operator for two vectors, and for a vector and a number in either order."""

    @infer_global(op)
    class Template(AbstractTemplate):
        def generic(self, args, kws):
            if len(args) == 2 and vector in args and all(a is vector or isinstance(a, types.Number) for a in args):
                return signature(result, *(a if a is vector else types.float64 for a in args))

    for left, right in ((vector, vector), (vector, types.float64), (types.float64, vector)):

        @lower_builtin(op, left, right)
        def lower(context, builder, sig, args):
            return emit(
                builder, *(x if t is vector else _splat(builder, x) for x, t in zip(args, sig.args, strict=True))
            )


def _arithmetic(name: str) -> Callable:
    return lambda builder, x, y: getattr(builder, name)(x, y)


def _comparison(sign: str) -> Callable:
    return lambda builder, x, y: builder.fcmp_ordered(sign, x, y)


for _op, _name in (("add", "fadd"), ("sub", "fsub"), ("mul", "fmul"), ("truediv", "fdiv")):
    _binary(getattr(operator, _op), _arithmetic(_name), vector)
    _binary(getattr(operator, "i" + _op), _arithmetic(_name), vector)
for _op, _sign in (("lt", "<"), ("le", "<="), ("gt", ">"), ("ge", ">=")):
    _binary(getattr(operator, _op), _comparison(_sign), mask)


@infer_global(operator.neg)
class _Negative(AbstractTemplate):
    def generic(self, args, kws):
        return signature(vector, vector) if args == (vector,) else None


@lower_builtin(operator.neg, vector)
def _negative(context, builder, sig, args):
    return builder.fneg(args[0])


def _logic(op: Callable, name: str) -> None:
    @infer_global(op)
    class Template(AbstractTemplate):
        def generic(self, args, kws):
            return signature(mask, mask, mask) if args == (mask, mask) else None

    @lower_builtin(op, mask, mask)
    def lower(context, builder, sig, args):
        return getattr(builder, name)(*args)


_logic(operator.and_, "and_")
_logic(operator.or_, "or_")


def _function(plain: Callable, name: str) -> None:
    """Let the function `plain` take a vector too; for a vector the LLVM intrinsic `name` is compiled."""

    @intrinsic
    def call(typing, x):
        def generate(context, builder, sig, args):
            kind = ir.FunctionType(_DATA, [_DATA])
            return builder.call(cgutils.get_or_insert_function(builder.module, kind, f"{name}.v{WIDTH}f64"), args)

        return vector(vector), generate

    @overload(plain)
    def with_vector(x):
        return (lambda x: call(x)) if x is vector else None


_function(math.sqrt, "llvm.sqrt")
_function(np.rint, "llvm.rint")
_function(abs, "llvm.fabs")


def _pointer(context: Any, builder: Any, kind: Any, array: Any, start: Any) -> Any:
    data, _ = parts_of(context, builder, kind, array)
    return builder.bitcast(builder.gep(data, [start]), ir.PointerType(_DATA))


@intrinsic
def lane_load(typing, array, start):
    """Return a vector of WIDTH consecutive float64 of `array` (row-major, any shape), from flat index `start` on."""

    def generate(context, builder, sig, args):
        return builder.load(_pointer(context, builder, sig.args[0], *args), align=8)

    return vector(array, types.intp), generate


@intrinsic
def store(typing, array, start, value):
    """Write a vector to WIDTH consecutive float64 in the memory of `array` (row-major, any shape), from flat index `start` on."""

    def generate(context, builder, sig, args):
        builder.store(args[2], _pointer(context, builder, sig.args[0], args[0], args[1]), align=8)
        return context.get_dummy_value()

    return types.void(array, types.intp, vector), generate


@intrinsic
def full(typing, number):
    """Return a SIMD vector whose WIDTH lanes all hold `number`."""
    return vector(types.float64), lambda context, builder, sig, args: _splat(builder, args[0])


@intrinsic
def lane_select(typing, condition, yes, no):
    """Return a SIMD vector with the lanes of `yes` where the mask `condition` is true, and those of `no` elsewhere."""
    return vector(mask, vector, vector), lambda context, builder, sig, args: builder.select(*args)


@intrinsic
def bits(typing, condition):
    """Return an integer whose bit k is 1 where lane k of the mask `condition` is true."""

    def generate(context, builder, sig, args):
        return builder.zext(builder.bitcast(args[0], ir.IntType(WIDTH)), ir.IntType(64))

    return types.int64(mask), generate
