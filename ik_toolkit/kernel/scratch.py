"""Scratch of a compiled call: one block of memory, from which its arrays are cut.

Two dozen small arrays of their own would cost a call half a microsecond, and each kind of them code to compile.
"""

# numba itself gives an intrinsic its first argument, which type checkers cannot know.
# pyright: reportCallIssue=false, reportArgumentType=false, reportGeneralTypeIssues=false
import math
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.imputils import impl_ret_borrowed
from numba.extending import intrinsic, overload
from numba.np.arrayobj import populate_array

from .jit import INLINE, inline

LINE = 8  # an array begins at a multiple of so many numbers of eight bytes: a cache line, and the widest register


@inline
def space(n, m, L, N):
    """Length of a block that has room for a search: n coordinates, m errors, L joints on the paths, N known configurations.

    (n + m + LINE)^2 is more than the matrices and vectors over n and m, 16 m more than what is kept of the tips; the rest is
    what lies between arrays. `cut` refuses to pass the end.
    """
    return (n + m + LINE) * (n + m + LINE) + 16 * m + 16 * L + N + 64 * LINE


def cut(block, kind, shapes):
    """Arrays of these shapes (whole numbers or tuples), one after the other, from what is left of `block`.

    block (K,) float64: its first number says how much is taken, 0 at the start; kind: type of the numbers. What the arrays
    hold is whatever was there. Raises MemoryError when the block is too short.
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
def _cut(block, kind, shapes):
    return lambda block, kind, shapes: _pieces(block, kind, shapes)


@intrinsic
def _pieces(typing, block, kind, shapes):
    dtype = kind.dtype
    arrays = [types.Array(dtype, getattr(shape, "count", 1), "C") for shape in shapes]

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        word, place = ir.IntType(64), ir.DoubleType()
        whole = context.make_array(sig.args[0])(context, builder, args[0])
        length = builder.extract_value(whole.shape, 0)
        size = context.get_abi_sizeof(context.get_data_type(dtype))
        start = builder.add(builder.fptosi(builder.load(whole.data), word), word(LINE))
        made = []
        for array, shape, value in zip(arrays, shapes, cgutils.unpack_tuple(builder, args[2]), strict=True):
            dims = cgutils.unpack_tuple(builder, value) if array.ndim > 1 else [value]
            strides, step = [], word(size)
            for dim in reversed(dims):
                strides.insert(0, step)
                step = builder.mul(step, dim)
            view = context.make_array(array)(context, builder)
            data = builder.bitcast(builder.gep(whole.data, [start]), context.get_data_type(dtype).as_pointer())
            populate_array(view, data, dims, strides, word(size), whole.meminfo, whole.parent)
            made.append(view._getvalue())
            lines = builder.udiv(builder.add(step, word(8 * LINE - 1)), word(8 * LINE))
            start = builder.add(start, builder.mul(lines, word(LINE)))
        with builder.if_then(builder.icmp_signed(">", start, length), likely=False):
            context.call_conv.return_user_exc(builder, MemoryError, ("a block of scratch is too short",))
        builder.store(builder.sitofp(builder.sub(start, word(LINE)), place), whole.data)
        return impl_ret_borrowed(context, builder, sig.return_type, context.make_tuple(builder, sig.return_type, made))

    return types.BaseTuple.from_types(arrays)(block, kind, shapes), generate
