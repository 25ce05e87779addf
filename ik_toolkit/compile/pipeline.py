"""Compile kernels faster. A kernel is a compiled function that Python calls.

Its parts, the functions that only compiled code calls, need no machine code of their own. Results of type inference, which numba
computes again for every function call, are cached. That does not change the outcome: the same functions are found for the same
types, and the same code is made.

This module uses undocumented interfaces of numba, so jit.py imports it only for releases with which it was tried.
"""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, partial
from typing import Any, ClassVar

from llvmlite.binding import Linkage, create_pass_builder, create_pipeline_tuning_options, ffi, parse_assembly
from numba import _dynfunc  # pyright: ignore[reportAttributeAccessIssue]
from numba.core import types
from numba.core.cgutils import normalize_ir_text
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler, Flags
from numba.core.compiler_machinery import PassManager, _pass_registry
from numba.core.postproc import PostProcessor
from numba.core.transforms import canonicalize_cfg
from numba.core.typed_passes import NativeLowering

from .lowering import PartContext, PartLowering

everything = PostProcessor.run  # numba's own method, which `in_order` replaces while parts of kernels are compiled
# numba's timers, one for each part that is being compiled. numba notifies all of them of every call of LLVM, some 20,000 per
# kernel.
listeners: list = getattr(getattr(ffi.lib, "_lock", None), "_cblist", [])


class Passes(PassManager):
    """numba's pass manager for a part of a kernel, without events, timers and checks around each pass."""

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
    """Do what PostProcessor.run does, except for liveness analysis, which only generators and reference counts need."""
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

    numba has a single object for equal types, so it is enough to compare identities. Comparing types of nested NamedTuples would
    take long.
    """
    known: dict[tuple, tuple] = {}

    def call(*arguments: Any) -> Any:
        key = tuple(map(id, arguments))
        found = known.get(key)
        if found is None:
            # The arguments are kept alive, so that no other object gets the same identity.
            found = function(*arguments), arguments
            if found[0] is not None:
                known[key] = found
        return found[0]

    return call


@contextmanager
def remembering(typing: Any) -> Iterator[None]:
    """While a kernel is compiled, cache what numba finds out about types: overloads, fields and methods of NamedTuples.

    typing: numba's typing context. The caller holds numba's lock, so nothing else is compiled meanwhile. The cache is
    emptied after the kernel, because functions may be redefined before the next one.
    """
    if "resolve_function_type" in vars(typing):  # another kernel is being compiled, and the cache made for it is in use
        yield
        return
    told, resolve, find = listeners[:], typing.resolve_function_type, typing.find_matching_getattr_template
    call = remembered(lambda function, *kinds: resolve(function, kinds, {}))
    field = remembered(find)

    def resolve_function_type(function: Any, kinds: Any, names: Any) -> Any:
        if names or not isinstance(function, types.Callable):
            return resolve(function, kinds, names)
        # Types of constants are replaced by general types, so that one compiled function serves all constants.
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


# LLVM's level of optimisation. Level 3 takes three times as long and makes kernels no faster (scripts/benchmarks/against.py).
LEVEL = 1


class PartLibrary(JITCodeLibrary):
    """LLVM code of a part of a kernel: simplified, not yet machine code, and without the functions that it calls.

    A kernel is optimised once, when all its parts are linked. Simplifying each part first saves time, because its code is still
    short.
    """

    def add_ir_module(self, ir_module: Any) -> None:
        """Add code without verifying it, because the kernel is verified with all its parts."""
        self._raise_if_finalized()
        made = parse_assembly(normalize_ir_text(str(ir_module)))
        made.name = ir_module.name
        self._optimize_functions(made)
        if any(not function.is_declaration for function in self._final_module.functions):
            self._final_module.link_in(made)
        else:  # The first module, usually the only one, need not be linked to anything.
            self._final_module = made

    def _optimize_functions(self, ll_module: Any) -> None:
        """Simplify all functions of a module with one pass manager, where numba would make one for each function."""
        ll_module.data_layout = self._codegen._data_layout
        passes, builder = self._codegen._function_pass_manager(opt=LEVEL)
        for function in ll_module.functions:
            if not function.is_declaration:
                passes.run(function, builder)

    def finalize(self) -> None:
        """Finish a part without linking the functions that it calls, because each of them is linked once into the kernel."""
        self._raise_if_finalized()
        for library in self._linking_libraries:
            self._reload_init.update(library._reload_init)
        for function in self._final_module.functions:
            if not function.is_declaration and function.linkage == Linkage.external:
                function.linkage = "linkonce_odr"
        self._finalized = True

    def _get_module_for_linking(self) -> Any:
        """Return the part's code with all functions that it calls; numba's own method would link only direct callees."""
        module = self._final_module.clone()
        link(module, self._linking_libraries)
        return module


class KernelLibrary(JITCodeLibrary):
    """Code of a kernel, into which every part that it needs is linked once."""

    # LLVM's optimisations that are left out: without them the solvers are as fast, and each after the first compiles in two thirds
    # of the time.
    left_out: tuple[str, ...] = ("loop_interleaving", "slp_vectorization")

    def finalize(self) -> None:
        self._raise_if_finalized()
        link(self._final_module, self._linking_libraries)
        self._linking_libraries = []
        super().finalize()

    def _optimize_final_module(self) -> None:
        """Inline functions first, so that numba can remove reference counts, and then optimise fully."""
        first = self._codegen._module_pass_manager(loop_vectorize=False, slp_vectorize=False, opt=0, cost="cheap")
        for passes, builder in (first, self._last_passes()):
            passes.run(self._final_module, builder)

    def _last_passes(self) -> tuple[Any, Any]:
        """Return the passes that optimise fully, without those in `left_out`, and their builder."""
        options = create_pipeline_tuning_options(LEVEL)
        for name in self.left_out:
            setattr(options, name, False)
        builder = create_pass_builder(self._codegen._tm, options)
        return builder.getModulePassManager(), builder


class SmallLibrary(KernelLibrary):
    """Code of a long kernel whose loops, over a robot's joints, are neither unrolled nor vectorised.

    Unrolling and vectorising would double the code of a tracker or a path search without making it faster. (A solve becomes a fifth
    faster by them, so its kernel is a KernelLibrary.)
    """

    left_out = (*KernelLibrary.left_out, "loop_unrolling", "loop_vectorization")


def link(module: Any, libraries: list) -> None:
    """Link libraries and all that they call into a module, callers first, because LLVM drops a function that nothing calls yet."""
    order: dict[Any, None] = {}

    def visit(library: Any) -> None:
        if library not in order:
            for called in library._linking_libraries if isinstance(library, PartLibrary) else ():
                visit(called)
            order[library] = None

    for library in libraries:
        visit(library)
    for library in reversed(order):
        part = isinstance(library, PartLibrary)
        module.link_in(library._final_module if part else library._get_module_for_linking(), preserve=True)


class CalledLibrary(PartLibrary):
    """LLVM code of a part that is never inlined; LLVM itself would inline even a long function that has only one caller."""

    def _optimize_functions(self, ll_module: Any) -> None:
        for function in ll_module.functions:
            if not function.is_declaration:
                function.add_function_attribute("noinline")
        super()._optimize_functions(ll_module)


# Compiler options that every part sets for itself, whatever the options of its caller; numba derives dbg_optnone from forceinline.
OWN = {"forceinline", "dbg_optnone"}


class FastFlags(Flags):
    """numba's compiler options, compared faster because only the few options that were set are compared.

    numba compares options whenever it looks for an overload, which is for every operator of every function, and its own
    `Flags` compare all fifty. The options in OWN are not compared, so that inlined parts and called parts share one compiled
    copy of a method that both use.
    """

    def values(self) -> dict:
        return self._values

    def __hash__(self) -> int:
        return hash(FastFlags)  # One hash for all is enough, because numba looks up the types of a call first.

    def __eq__(self, other: Any) -> bool:
        return isinstance(other, FastFlags) and self._shared() == other._shared()

    def _shared(self) -> dict:
        return {name: value for name, value in self._values.items() if name not in OWN}


# Passes of numba that are left out because parts of kernels use no `with`, comprehensions, closures or exceptions.
UNNEEDED = {
    "WithLifting", "InlineClosureLikes", "MakeFunctionToJitFunction", "RewriteSemanticConstants", "RewriteDynamicRaises",
    "FindLiterallyCalls", "LiteralUnroll", "LiteralPropagationSubPipelinePass", "InlineOverloads", "NopythonRewrites",
    "IRLegalization", "DumpParforDiagnostics",
}  # fmt: skip


class PartPipeline(Compiler):
    """numba's compiler pipeline for a part of a kernel; the code goes into a PartLibrary."""

    library = PartLibrary
    passes: ClassVar[list] = []  # one pass manager, made for the first part and used for all parts

    def define_pipelines(self) -> list:
        """Return numba's passes without those that a part does not need."""
        if not PartPipeline.passes:
            (manager,) = super().define_pipelines()
            quick = Passes("part")
            kept = [(step, why) for step, why in manager.passes if step.__name__ not in UNNEEDED]
            quick.passes = [(PartLowering if step is NativeLowering else step, why) for step, why in kept]
            quick.finalize()
            PartPipeline.passes.append(quick)
        return PartPipeline.passes

    def compile_extra(self, func: Any) -> Any:
        """Compile a function without the code by which Python would call it."""
        state = self.state
        state.library = self.library(state.targetctx.codegen(), func.__qualname__)
        state.flags = FastFlags(state.flags)
        state.flags.no_compile = True  # pyright: ignore[reportAttributeAccessIssue]
        # the context is numba's copy for this function, so its class may be changed
        state.targetctx.__class__ = PartContext
        state.targetctx.get_abi_sizeof = partial(size_of, state.targetctx.target_data)
        result = super().compile_extra(func)
        description, library = result.fndesc, result.library
        entry = _dynfunc.make_function(
            description.lookup_module(), func.__name__, "", 0, result.environment, (library,)
        )  # fmt: skip
        state.targetctx.insert_user_function(entry, description, [library])
        return result._replace(entry_point=entry)


class CalledPipeline(PartPipeline):
    """numba's compiler pipeline for a part that is not inlined; the code goes into a CalledLibrary."""

    library = CalledLibrary


class KernelPipeline(Compiler):
    """numba's compiler pipeline for a kernel; the code goes into a KernelLibrary."""

    library = KernelLibrary

    def compile_extra(self, func: Any) -> Any:
        self.state.library = self.library(self.state.targetctx.codegen(), func.__qualname__)
        self.state.library.enable_object_caching()
        with remembering(self.state.typingctx):
            return super().compile_extra(func)


class SmallPipeline(KernelPipeline):
    """numba's compiler pipeline for a kernel whose code goes into a SmallLibrary."""

    library = SmallLibrary
