"""Caches for work of type inference that numba repeats for every function call while it compiles a kernel.

They do not change the result: the same functions are found for the same types, and the same code is made.
"""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

from llvmlite.binding import ffi
from numba.core import types
from numba.core.compiler_machinery import PassManager, _pass_registry
from numba.core.postproc import PostProcessor
from numba.core.transforms import canonicalize_cfg

everything = PostProcessor.run  # numba's own method; `in_order` replaces it for parts, which need less
# numba's timers, one for each part that is compiled; it notifies them of every call of LLVM, some 20,000 for a kernel.
listeners: list = getattr(getattr(ffi.lib, "_lock", None), "_cblist", [])


class Passes(PassManager):
    """numba's pass manager for a part of a kernel, without numba's events, timers and checks around each pass."""

    def run(self, state: Any) -> None:
        """Run all passes, and sort the blocks of the code after each pass that changed their order."""
        for kind, _ in self.passes:
            known = _pass_registry.get(kind)
            step = known.pass_inst
            step.analysis = self._analysis
            changed = step.run_initialization(state)
            changed |= step.run_pass(state)
            changed |= step.run_finalizer(state)
            if changed and known.mutates_CFG:
                state.func_ir.blocks = canonicalize_cfg(state.func_ir.blocks)


def in_order(self: Any, emit_dels: bool = False, extend_lifetimes: bool = False) -> None:
    """Replace PostProcessor.run: without liveness analysis, which only generators and reference counts need."""
    if emit_dels or self.func_ir.is_generator:
        everything(self, emit_dels, extend_lifetimes)
    else:
        self.func_ir.blocks = canonicalize_cfg(self.func_ir.blocks)


@cache
def size_of(target: Any, kind: Any) -> int:
    """Return the size of an LLVM type [bytes], cached, because numba parses a whole LLVM module for each answer."""
    return kind.get_abi_size(target)


def remembered(function: Callable) -> Callable:
    """Cache the results of a function by the identity of its arguments.

    numba has one object for equal types, so it is enough to compare objects; to compare types of nested records takes long.
    """
    known: dict[tuple, tuple] = {}

    def call(*arguments: Any) -> Any:
        key = tuple(map(id, arguments))
        found = known.get(key)
        if found is None:
            # The arguments are kept, so that no other object gets the same identity.
            found = function(*arguments), arguments
            if found[0] is not None:
                known[key] = found
        return found[0]

    return call


@contextmanager
def remembering(typing: Any) -> Iterator[None]:
    """Cache what numba finds out about types while a kernel is compiled: overloads, fields and methods of records.

    typing: numba's typing context. The caller holds numba's lock, so nothing else is compiled meanwhile. The cache is
    emptied after the kernel, because functions may be redefined before the next one.
    """
    if "resolve_function_type" in vars(typing):  # A kernel that is compiled inside another uses the other's cache.
        yield
        return
    told, resolve, find = listeners[:], typing.resolve_function_type, typing.find_matching_getattr_template
    call = remembered(lambda function, *kinds: resolve(function, kinds, {}))
    field = remembered(find)

    def resolve_function_type(function: Any, kinds: Any, names: Any) -> Any:
        if names or not isinstance(function, types.Callable):
            return resolve(function, kinds, names)
        # Types of constants are replaced by general types, so that one copy serves all of them.
        if isinstance(function, types.Dispatcher):
            kinds = map(types.unliteral, kinds)
        return call(function, *kinds)

    def find_matching_getattr_template(kind: Any, name: str) -> Any:
        return (field if isinstance(kind, types.BaseNamedTuple) else find)(kind, sys.intern(name))

    typing.resolve_function_type = resolve_function_type
    typing.find_matching_getattr_template = find_matching_getattr_template
    PostProcessor.run = in_order
    listeners.clear()
    try:
        yield
    finally:
        listeners[:] = told
        PostProcessor.run = everything
        del typing.resolve_function_type, typing.find_matching_getattr_template
