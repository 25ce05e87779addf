"""Work that numba repeats for every call of a part: cached, or left out, while a kernel is compiled.

None of this changes the result: the same functions are found for the same types, and the same code comes out.
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

everything = PostProcessor.run
# numba's timers, one for each part being compiled, which it notifies of every call of LLVM, some 20,000 a kernel.
listeners: list = getattr(getattr(ffi.lib, "_lock", None), "_cblist", [])


class Passes(PassManager):
    """Passes over a part, without what numba does around each: events, clocks, and checks of what the pass has made."""

    def run(self, state: Any) -> None:
        """Run all passes; the blocks are put in order after one that moved them."""
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
    """In place of PostProcessor.run: how long variables live matters where references are counted, or a generator waits."""
    if emit_dels or self.func_ir.is_generator:
        everything(self, emit_dels, extend_lifetimes)
    else:
        self.func_ir.blocks = canonicalize_cfg(self.func_ir.blocks)


@cache
def size_of(target: Any, kind: Any) -> int:
    """Bytes of a type of LLVM: numba writes a module with a variable of that type and has it parsed."""
    return kind.get_abi_size(target)


def remembered(function: Callable) -> Callable:
    """The same function, with its results cached by the identity of its arguments.

    numba has one object for equal types, so objects are compared: a record of records takes long to compare.
    """
    known: dict[tuple, tuple] = {}

    def call(*arguments: Any) -> Any:
        key = tuple(map(id, arguments))
        found = known.get(key)
        if found is None:
            found = function(*arguments), arguments  # kept, so that no other object gets the same address
            if found[0] is not None:
                known[key] = found
        return found[0]

    return call


@contextmanager
def remembering(typing: Any) -> Iterator[None]:
    """Look up what is called with which types, and each field and method of a record, once for a whole kernel.

    typing: numba's typing context. The caller holds numba's lock, so nothing else is compiled meanwhile. What is remembered ends
    with the kernel: functions may be defined anew before the next.
    """
    if "resolve_function_type" in vars(typing):  # a kernel that calls a kernel
        yield
        return
    told, resolve, find = listeners[:], typing.resolve_function_type, typing.find_matching_getattr_template
    call = remembered(lambda function, *kinds: resolve(function, kinds, {}))
    field = remembered(find)

    def resolve_function_type(function: Any, kinds: Any, names: Any) -> Any:
        if names or not isinstance(function, types.Callable):
            return resolve(function, kinds, names)
        if isinstance(function, types.Dispatcher):  # one copy for all numbers; what is inlined meets them again in LLVM
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
