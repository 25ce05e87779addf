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

everything = PostProcessor.run  # numba's original method, which `in_order` replaces while a kernel is compiled
# Timers that llvmlite notifies of every call of LLVM. numba adds one for each function being compiled, and one kernel takes some
# 20,000 calls, so the list is emptied while a kernel is compiled.
listeners: list = getattr(getattr(ffi.lib, "_lock", None), "_cblist", [])


class Passes(PassManager):
    """Runs the compiler passes of numba for one function faster: without the events, timers and checks that numba adds to each."""

    def run(self, state: Any) -> None:
        """Run all passes on `state`, the function being compiled.

        Its basic blocks are sorted after each pass that has changed the control flow.
        """
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
    """Replacement for numba's PostProcessor.run that leaves out liveness analysis where it is not needed, to compile faster.

    It is needed only for generators and reference counts; otherwise the basic blocks are only sorted.
    """
    if emit_dels or self.func_ir.is_generator:
        everything(self, emit_dels, extend_lifetimes)
    else:
        self.func_ir.blocks = canonicalize_cfg(self.func_ir.blocks)


@cache
def size_of(target: Any, kind: Any) -> int:
    """Return the size of an LLVM type [bytes], cached, because numba parses a whole LLVM module for each answer."""
    return kind.get_abi_size(target)


def remembered(function: Callable) -> Callable:
    """Return `function` with a cache of its results (except None), looked up by the identity of the arguments.

    The arguments are types of numba, each of which is a single object. Comparing types of nested NamedTuples by value would take
    long.
    """
    known: dict[tuple, tuple] = {}

    def call(*arguments: Any) -> Any:
        key = tuple(map(id, arguments))
        found = known.get(key)
        if found is None:
            # The arguments are kept alive, so that no other object gets the same identity in their place.
            found = function(*arguments), arguments
            if found[0] is not None:
                known[key] = found
        return found[0]

    return call


@contextmanager
def remembering(typing: Any) -> Iterator[None]:
    """Context manager: let numba's type inference cache its results while one kernel is compiled, which is faster.

    The results are overloads of functions and attributes of NamedTuples. `typing` is the typing context of numba. The caller holds
    the compiler lock of numba, so nothing else is compiled meanwhile. The cache is emptied afterwards, because functions may be
    redefined before the next kernel is compiled.
    """
    # A kernel whose compilation begins during that of another one uses the same cache.
    if "resolve_function_type" in vars(typing):
        yield
        return
    told, resolve, find = listeners[:], typing.resolve_function_type, typing.find_matching_getattr_template
    call = remembered(lambda function, *kinds: resolve(function, kinds, {}))
    field = remembered(find)

    def resolve_function_type(function: Any, kinds: Any, names: Any) -> Any:
        if names or not isinstance(function, types.Callable):
            return resolve(function, kinds, names)
        # The type of a constant, such as Literal[3], becomes the general type, so one compiled function serves all constants.
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


# LLVM's level of optimisation (0 to 3). Level 3 takes three times as long and makes kernels no faster
# (scripts/benchmarks/against.py).
LEVEL = 1


class PartLibrary(JITCodeLibrary):
    """Holds the LLVM code of one function that only compiled code calls, without the code of the functions it calls.

    The code is simplified, which is fast while it is short, but not yet optimised: that is done once, for the whole kernel (the
    compiled function that Python calls), when all its functions are linked.
    """

    def add_ir_module(self, ir_module: Any) -> None:
        """Add an llvmlite module to the code, simplified but not verified: the linked kernel is verified as a whole."""
        self._raise_if_finalized()
        made = parse_assembly(normalize_ir_text(str(ir_module)))
        made.name = ir_module.name
        self._optimize_functions(made)
        if any(not function.is_declaration for function in self._final_module.functions):
            self._final_module.link_in(made)
        else:  # The first module, usually the only one, replaces the empty module.
            self._final_module = made

    def _optimize_functions(self, ll_module: Any) -> None:
        """Simplify all functions of a module with one pass manager, where numba would make one for each function."""
        ll_module.data_layout = self._codegen._data_layout
        passes, builder = self._codegen._function_pass_manager(opt=LEVEL)
        for function in ll_module.functions:
            if not function.is_declaration:
                passes.run(function, builder)

    def finalize(self) -> None:
        """Close the library, without linking the functions that it calls: each of them is linked once into the whole kernel."""
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
    """Holds the code of a kernel, a function that Python calls.

    Every compiled function that the kernel needs is linked into it once, and the whole is then optimised.
    """

    # Leaving out these LLVM optimisations makes no solver slower, and all solvers but the first compile in two thirds of the time.
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
    """Holds the code of a long kernel (a function that Python calls) whose loops are neither unrolled nor vectorised.

    Unrolling and vectorising would double the code of a tracker or a path search without making it faster. The solvers become a
    fifth faster by them, so their code is a KernelLibrary.
    """

    left_out = (*KernelLibrary.left_out, "loop_unrolling", "loop_vectorization")


def link(module: Any, libraries: list) -> None:
    """Link libraries and all functions that they call into an LLVM module.

    Callers come first, because LLVM drops a function that nothing in the module calls so far.
    """
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
    """Holds the LLVM code of a function marked as never inlined; LLVM would inline even a long one that has a single caller."""

    def _optimize_functions(self, ll_module: Any) -> None:
        for function in ll_module.functions:
            if not function.is_declaration:
                function.add_function_attribute("noinline")
        super()._optimize_functions(ll_module)


# Compiler options that a function does not take over from its caller; numba derives dbg_optnone from forceinline.
OWN = {"forceinline", "dbg_optnone"}


class FastFlags(Flags):
    """numba's compiler options of a function, compared faster: only options that were set are compared, not all fifty.

    numba compares options whenever it looks for an overload, which is for every operator of every function. The options in OWN are
    not compared, so that inlined functions and called functions share one compiled copy of a method that both use.
    """

    def values(self) -> dict:
        return self._values

    def __hash__(self) -> int:
        # The hash may be the same for all options, because numba's keys also have the types of the call, which differ.
        return hash(FastFlags)

    def __eq__(self, other: Any) -> bool:
        return isinstance(other, FastFlags) and self._shared() == other._shared()

    def _shared(self) -> dict:
        return {name: value for name, value in self._values.items() if name not in OWN}


# Compiler passes of numba for `with`, comprehensions, closures and `try`, which functions that only compiled code calls do not use.
UNNEEDED = {
    "WithLifting", "InlineClosureLikes", "MakeFunctionToJitFunction", "RewriteSemanticConstants", "RewriteDynamicRaises",
    "FindLiterallyCalls", "LiteralUnroll", "LiteralPropagationSubPipelinePass", "InlineOverloads", "NopythonRewrites",
    "IRLegalization", "DumpParforDiagnostics",
}  # fmt: skip


class PartPipeline(Compiler):
    """numba compiler for a function that only compiled code calls; the LLVM code goes into a PartLibrary."""

    library = PartLibrary
    passes: ClassVar[list] = []  # the list of compiler passes, made once and used for all functions

    def define_pipelines(self) -> list:
        """Return a list with one pass manager: that of numba without the passes in UNNEEDED, and with PartLowering."""
        if not PartPipeline.passes:
            (manager,) = super().define_pipelines()
            quick = Passes("part")
            kept = [(step, why) for step, why in manager.passes if step.__name__ not in UNNEEDED]
            quick.passes = [(PartLowering if step is NativeLowering else step, why) for step, why in kept]
            quick.finalize()
            PartPipeline.passes.append(quick)
        return PartPipeline.passes

    def compile_extra(self, func: Any) -> Any:
        """Compile a Python function without the wrapper by which Python would call it; return what numba's own method returns."""
        state = self.state
        state.library = self.library(state.targetctx.codegen(), func.__qualname__)
        state.flags = FastFlags(state.flags)
        state.flags.no_compile = True  # pyright: ignore[reportAttributeAccessIssue]
        # numba copies the target context for each function, so its class may be changed.
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
    """numba compiler for a function that only compiled code calls and is never inlined; the code goes into a CalledLibrary."""

    library = CalledLibrary


class KernelPipeline(Compiler):
    """numba compiler for a kernel, a function that Python calls; the code goes into a KernelLibrary."""

    library = KernelLibrary

    def compile_extra(self, func: Any) -> Any:
        self.state.library = self.library(self.state.targetctx.codegen(), func.__qualname__)
        self.state.library.enable_object_caching()
        with remembering(self.state.typingctx):
            return super().compile_extra(func)


class SmallPipeline(KernelPipeline):
    """numba compiler for a function that Python calls, without unrolling or vectorising loops (see `SmallLibrary`)."""

    library = SmallLibrary
