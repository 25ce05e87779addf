"""Views: light arrays inside compiled functions that consist of a pointer and a shape.

numba passes an array as seven to eleven numbers and counts references to it, so passing a record of two dozen arrays takes much
code. A view owns no memory and must not outlive the array it was made of: functions that Python calls keep the arrays, and pass on
views of them. A view is contiguous. Its indices must be non-negative integers. In a two-dimensional view A[i] is a row, and A[i:k]
are rows. Without compilation a view is the array itself.
"""

# pyright: reportOptionalCall=false

# Pyright reports every call of an @intrinsic function, because numba itself passes the first argument.
# pyright: reportCallIssue=false, reportArgumentType=false, reportGeneralTypeIssues=false
import functools
import math
import operator
from collections.abc import Sequence
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.imputils import impl_ret_borrowed
from numba.core.typing.templates import AbstractTemplate, AttributeTemplate, infer_getattr, infer_global, signature
from numba.extending import intrinsic, lower_builtin, lower_getattr, models, overload, register_model
from numba.np.arrayobj import populate_array

from .jit import BUILD, INLINE, inline

# number of float64 in a cache line, and in the widest SIMD register; arrays in scratch memory begin at multiples of it
LINE = 8
WORD = ir.IntType(64)  # the LLVM type of lengths and indices


class View(types.Type):
    """The numba type of a view, which compiled code uses in place of an array because it needs no reference counting.

    It is a pointer to numbers of one type without gaps between them, and one to four lengths.
    """

    def __init__(self, dtype: Any, ndim: int) -> None:
        self.dtype, self.ndim = dtype, ndim
        super().__init__(name=f"view{ndim}({dtype})")


@register_model(View)
class _ViewModel(models.StructModel):
    def __init__(self, dmm, fe_type) -> None:
        members = [("data", types.CPointer(fe_type.dtype)), ("shape", types.UniTuple(types.intp, fe_type.ndim))]
        super().__init__(dmm, fe_type, members)


def parts_of(context: Any, builder: Any, kind: Any, value: Any) -> tuple[Any, list]:
    """Write LLVM code that reads the data pointer and the lengths of a view or an array; return the LLVM values of both."""
    if isinstance(kind, View):
        return builder.extract_value(value, 0), cgutils.unpack_tuple(builder, builder.extract_value(value, 1))
    array = context.make_array(kind)(context, builder, value)
    return array.data, cgutils.unpack_tuple(builder, array.shape)


def _made(context: Any, builder: Any, kind: Any, data: Any, dims: Sequence) -> Any:
    """Make a view of type `kind` from a pointer and lengths."""
    shape = cgutils.pack_array(builder, dims)
    empty = ir.Constant(context.get_value_type(kind), ir.Undefined)
    return builder.insert_value(builder.insert_value(empty, data, 0), shape, 1)


def _place(builder: Any, dims: Sequence, index: Sequence) -> Any:
    """Return the offset in memory [elements] that an index selects; the index may have fewer entries than there are dimensions."""
    place = index[0]
    for k in range(1, len(dims)):
        place = builder.mul(place, dims[k])
        if k < len(index):
            place = builder.add(place, index[k])
    return place


# ------------------------------------------------------------------------------------------------------ A[i], A[i, k], A[i:k]
def _index(kind: View, index: Any) -> tuple[Any, Any]:
    """Return the numba type of an index, and the type of what it selects (None if the index is not allowed)."""
    if isinstance(index, types.SliceType):
        return types.slice2_type, kind
    if isinstance(index, types.Integer):
        count, how = 1, types.intp
    elif isinstance(index, types.BaseTuple) and all(isinstance(one, types.Integer) for one in index):
        count, how = len(index), types.UniTuple(types.intp, len(index))
    else:
        return None, None
    return how, kind.dtype if count == kind.ndim else View(kind.dtype, kind.ndim - count) if count < kind.ndim else None


@infer_global(operator.getitem)
class _Get(AbstractTemplate):
    def generic(self, args, kws):
        if isinstance(args[0], View):
            how, found = _index(*args)
            return None if found is None else signature(found, args[0], how)


@infer_global(operator.setitem)
class _Set(AbstractTemplate):
    def generic(self, args, kws):
        if isinstance(args[0], View):
            how, found = _index(*args[:2])
            return signature(types.none, args[0], how, found) if found == args[0].dtype else None


def _element(context: Any, builder: Any, kind: Any, value: Any, how: Any, index: Any) -> tuple[Any, list]:
    """Return the pointer to the element or rows that an index selects, and their shape."""
    data, dims = parts_of(context, builder, kind, value)
    index = cgutils.unpack_tuple(builder, index) if isinstance(how, types.BaseTuple) else [index]
    return builder.gep(data, [_place(builder, dims, index)], inbounds=True), dims[len(index) :]


@lower_builtin(operator.getitem, View, types.Integer)
@lower_builtin(operator.getitem, View, types.BaseTuple)
def _get(context, builder, sig, args):
    pointer, dims = _element(context, builder, sig.args[0], args[0], sig.args[1], args[1])
    if dims:
        return _made(context, builder, sig.return_type, pointer, dims)
    return context.unpack_value(builder, sig.return_type, pointer)


@lower_builtin(operator.setitem, View, types.Integer, types.Any)
@lower_builtin(operator.setitem, View, types.BaseTuple, types.Any)
def _set(context, builder, sig, args):
    pointer, _ = _element(context, builder, sig.args[0], args[0], sig.args[1], args[1])
    context.pack_value(builder, sig.args[2], args[2], pointer)
    return context.get_dummy_value()


@lower_builtin(operator.getitem, View, types.SliceType)
def _rows(context, builder, sig, args):
    kind, (value, index) = sig.args[0], args
    data, dims = parts_of(context, builder, kind, value)
    # In a slice without an end, such as A[i:], numba sets the end to the largest integer, so it is reduced to the length here.
    part = context.make_helper(builder, types.slice2_type, index)
    stop = builder.select(builder.icmp_signed("<", part.stop, dims[0]), part.stop, dims[0])
    pointer = builder.gep(data, [_place(builder, dims, [part.start])], inbounds=True)
    return _made(context, builder, kind, pointer, [builder.sub(stop, part.start), *dims[1:]])


@infer_getattr
class _Attributes(AttributeTemplate):
    key = View

    def resolve_shape(self, kind):
        return types.UniTuple(types.intp, kind.ndim)


@lower_getattr(View, "shape")
def _shape(context, builder, kind, value):
    return builder.extract_value(value, 1)


# ------------------------------------------------------------------------------------------------------------ making views
def view(A):
    """Return a view of a C-contiguous array: its pointer and shape, without reference counting. A view is returned as it is."""
    return A


@overload(view, jit_options=INLINE)
def _view(A):
    if isinstance(A, View):
        return lambda A: A
    return lambda A: _as_view(A)


@intrinsic
def _as_view(typing, A):
    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return _made(context, builder, sig.return_type, *parts_of(context, builder, sig.args[0], args[0]))

    return (View(A.dtype, A.ndim)(A), generate) if A.layout == "C" else None


def keep(A):
    """Keep array A alive until this call. A view of A is not a counted reference, so numba could otherwise free A earlier."""


@overload(keep, jit_options=INLINE)
def _keep(A):
    return lambda A: _used(A)


@intrinsic
def _used(typing, A):
    return types.void(A), lambda context, builder, sig, args: context.get_dummy_value()


def flat(A):
    """Return the numbers of a view A of any shape as a one-dimensional view of the same memory."""
    return A.reshape(-1)


@overload(flat, jit_options=INLINE)
def _flat(A):
    return lambda A: _as_flat(A)


@intrinsic
def _as_flat(typing, A):
    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        data, dims = parts_of(context, builder, sig.args[0], args[0])
        return _made(context, builder, sig.return_type, data, [functools.reduce(builder.mul, dims)])

    return View(A.dtype, 1)(A), generate


def fold(A, kind, n, m):
    """Return a view (n, m) of the first n * m numbers in the memory of a view A (K,), read as numbers of type `kind`."""
    return A.view(kind)[: n * m].reshape(n, m)


@overload(fold, jit_options=INLINE)
def _fold(A, kind, n, m):
    return lambda A, kind, n, m: _as_table(A, kind, n, m)


@intrinsic
def _as_table(typing, A, kind, n, m):
    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        data, _ = parts_of(context, builder, sig.args[0], args[0])
        data = builder.bitcast(data, context.get_data_type(kind.dtype).as_pointer())
        return _made(context, builder, sig.return_type, data, args[2:])

    return View(kind.dtype, 2)(A, kind, types.intp, types.intp), generate


# ---------------------------------------------------------------------------------------------------------------- scratch
@inline
def space(n, m, L, N):
    """Return how many float64 of scratch memory a search needs for all its temporary arrays.

    The search has n coordinates, m rows in its error vector, L joints on all chains together and N precomputed start
    configurations. 8 max(n, m, 11)^2 numbers are for square matrices, (n + m + LINE)^2 for all other matrices and vectors over n
    and m, 16 m for the arrays of the tips, and 64 LINE for the gaps before arrays, which begin at multiples of LINE.
    """
    return 8 * max(n, m, 11) * max(n, m, 11) + (n + m + LINE) * (n + m + LINE) + 16 * m + 16 * L + N + 64 * LINE


def cut(block, kind, shapes):
    """Allocate arrays from a block of scratch memory, without setting their numbers; return them as a tuple.

    The arrays are views if the block is a view. block (K,) is of float64. Its first number counts the numbers already allocated;
    the caller sets it to 0 once. Each of `shapes` is a length or a tuple of lengths, and `kind` is the type of the numbers. Raises
    MemoryError if the block is too short.
    """
    made = []
    for shape in shapes:
        count = math.prod(shape) if isinstance(shape, tuple) else shape
        words = -(-count * np.dtype(kind).itemsize // (8 * LINE)) * LINE
        start = LINE + int(block[0])
        if start + words > block.shape[0]:
            raise MemoryError("a block of scratch is too short")
        block[0] += words
        made.append(block[start : start + words].view(kind)[:count].reshape(shape))
    return tuple(made)


@overload(cut, jit_options=INLINE)
def _cut_views(block, kind, shapes):
    return (lambda block, kind, shapes: _pieces(block, kind, shapes)) if isinstance(block, View) else None


# Arrays that are cut from an array count references to its memory, which functions compiled with INLINE cannot do.
@overload(cut, jit_options=BUILD)
def _cut_arrays(block, kind, shapes):
    return None if isinstance(block, View) else lambda block, kind, shapes: _pieces(block, kind, shapes)


@intrinsic
def _pieces(typing, block, kind, shapes):
    dtype, counted = kind.dtype, not isinstance(block, View)
    ndims = [getattr(shape, "count", 1) for shape in shapes]
    pieces = [types.Array(dtype, ndim, "C") if counted else View(dtype, ndim) for ndim in ndims]

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        memory, (length,) = parts_of(context, builder, sig.args[0], args[0])
        size = context.get_abi_sizeof(context.get_data_type(dtype))
        start = builder.add(builder.fptosi(builder.load(memory), WORD), WORD(LINE))
        made = []
        for piece, value in zip(pieces, cgutils.unpack_tuple(builder, args[2]), strict=True):
            dims = cgutils.unpack_tuple(builder, value) if piece.ndim > 1 else [value]
            data = builder.bitcast(builder.gep(memory, [start]), context.get_data_type(dtype).as_pointer())
            strides, step = [], WORD(size)
            for dim in reversed(dims):
                strides.insert(0, step)
                step = builder.mul(step, dim)
            if counted:
                whole = context.make_array(sig.args[0])(context, builder, args[0])
                array = context.make_array(piece)(context, builder)
                populate_array(array, data, dims, strides, WORD(size), whole.meminfo, whole.parent)
                made.append(array._getvalue())
            else:
                made.append(_made(context, builder, piece, data, dims))
            lines = builder.udiv(builder.add(step, WORD(8 * LINE - 1)), WORD(8 * LINE))
            start = builder.add(start, builder.mul(lines, WORD(LINE)))
        with builder.if_then(builder.icmp_signed(">", start, length), likely=False):
            context.call_conv.return_user_exc(builder, MemoryError, ("a block of scratch is too short",))
        builder.store(builder.sitofp(builder.sub(start, WORD(LINE)), ir.DoubleType()), memory)
        return impl_ret_borrowed(context, builder, sig.return_type, context.make_tuple(builder, sig.return_type, made))

    return types.BaseTuple.from_types(pieces)(block, kind, shapes), generate


# --------------------------------------------------------------------------------------------------------- numbers in a row
@intrinsic
def counted_part(typing, A, start, count):
    """Return A[start : start + count] of a one-dimensional A as a tuple; `count` must be a constant at compile time."""
    if not isinstance(count, types.IntegerLiteral):
        return None

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        data, _ = parts_of(context, builder, sig.args[0], args[0])
        places = [builder.gep(data, [builder.add(args[1], WORD(k))], inbounds=True) for k in range(count.literal_value)]
        return cgutils.pack_array(builder, [builder.load(place) for place in places])

    return types.UniTuple(A.dtype, count.literal_value)(A, types.intp, count), generate


@intrinsic
def put_numbers(typing, A, start, record):
    """Write the fields of `record`, a NamedTuple of numbers, to consecutive elements of A (K,), the first to A[start]."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        data, _ = parts_of(context, builder, sig.args[0], args[0])
        for k, value in enumerate(cgutils.unpack_tuple(builder, args[2])):
            value = context.cast(builder, value, record[k], A.dtype)
            builder.store(value, builder.gep(data, [builder.add(args[1], WORD(k))], inbounds=True))
        return context.get_dummy_value()

    return types.void(A, types.intp, record), generate
