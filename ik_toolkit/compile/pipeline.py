"""A faster way to compile parts of a kernel, which are never called from outside it and need no machine code of their own.

It uses undocumented interfaces of numba, so jit.py imports it only for releases with which it was tried.
"""

from functools import partial
from typing import Any, ClassVar

from llvmlite.binding import Linkage, parse_assembly
from numba import _dynfunc  # pyright: ignore[reportAttributeAccessIssue]
from numba.core.cgutils import normalize_ir_text
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler, Flags

from .typing_cache import Passes, remembering, size_of

# LLVM's level of optimisation; the third takes three times as long and makes kernels no faster (scripts/benchmarks/against.py).
LEVEL = 1


class PartLibrary(JITCodeLibrary):
    """Code of a part, simplified but not turned into machine code, and without the functions it calls.

    A kernel is optimised once, when all parts are in it. To simplify each function before saves time, because it is short then.
    """

    def add_ir_module(self, ir_module: Any) -> None:
        """Add code without verifying it, because the kernel is verified with all its parts."""
        self._raise_if_finalized()
        made = parse_assembly(normalize_ir_text(str(ir_module)))
        made.name = ir_module.name
        self._optimize_functions(made)
        if any(not function.is_declaration for function in self._final_module.functions):
            self._final_module.link_in(made)
        else:  # the first module is taken as it is; mostly it is the only one
            self._final_module = made

    def _optimize_functions(self, ll_module: Any) -> None:
        """Simplify the functions that a module defines, with one set of passes; numba would make one for each function."""
        ll_module.data_layout = self._codegen._data_layout
        passes, builder = self._codegen._function_pass_manager(opt=LEVEL)
        for function in ll_module.functions:
            if not function.is_declaration:
                passes.run(function, builder)

    def finalize(self) -> None:
        """Finish without linking what the part calls: the kernel links it once, where numba would link it into every caller."""
        self._raise_if_finalized()
        for library in self._linking_libraries:
            self._reload_init.update(library._reload_init)
        for function in self._final_module.functions:
            if not function.is_declaration and function.linkage == Linkage.external:
                function.linkage = "linkonce_odr"
        self._finalized = True

    def _get_module_for_linking(self) -> Any:
        """Return the code with all that it calls, for a library of numba's own, which links only what it calls directly."""
        module = self._final_module.clone()
        link(module, self._linking_libraries)
        return module


class KernelLibrary(JITCodeLibrary):
    """Code of a kernel, into which every part that it needs is linked once."""

    def finalize(self) -> None:
        self._raise_if_finalized()
        link(self._final_module, self._linking_libraries)
        self._linking_libraries = []
        super().finalize()

    def _optimize_final_module(self) -> None:
        """Optimise cheaply to inline functions, so that numba can leave out more counting of references; then optimise well."""
        first = self._codegen._module_pass_manager(loop_vectorize=False, slp_vectorize=False, opt=0, cost="cheap")
        for passes, builder in (first, self._codegen._module_pass_manager(opt=LEVEL)):
            passes.run(self._final_module, builder)


def link(module: Any, libraries: list) -> None:
    """Link libraries and all that they call into a module, each after its callers, as LLVM drops what nothing calls yet."""
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
    """Code of a part that stays one copy; LLVM would inline a function with one caller, however long it is."""

    def _optimize_functions(self, ll_module: Any) -> None:
        for function in ll_module.functions:
            if not function.is_declaration:
                function.add_function_attribute("noinline")
        super()._optimize_functions(ll_module)


# Options that every part sets for itself, whatever its caller has; numba derives the second from the first.
OWN = {"forceinline", "dbg_optnone"}


class Quick(Flags):
    """Options of a compilation that are compared fast, by those that were set.

    numba compares options to find an overload for every operator of every function, and `Flags` compares all fifty. The options
    OWN are not compared, as there would be two copies of each method that inlined and called parts use.
    """

    def values(self) -> dict:
        return self._values

    def __hash__(self) -> int:
        return hash(Quick)  # all options share one hash, because numba looks up the types of a call first

    def __eq__(self, other: Any) -> bool:
        return isinstance(other, Quick) and self._shared() == other._shared()

    def _shared(self) -> dict:
        return {name: value for name, value in self._values.items() if name not in OWN}


# Passes that a part does not need: for `with`, comprehensions, closures, exceptions, inlining by numba, expressions of arrays.
UNNEEDED = {
    "WithLifting", "InlineClosureLikes", "MakeFunctionToJitFunction", "RewriteSemanticConstants", "RewriteDynamicRaises",
    "FindLiterallyCalls", "LiteralUnroll", "LiteralPropagationSubPipelinePass", "InlineOverloads", "NopythonRewrites",
    "IRLegalization", "DumpParforDiagnostics",
}  # fmt: skip


class PartPipeline(Compiler):
    """numba's pipeline, which compiles into a PartLibrary."""

    library = PartLibrary
    passes: ClassVar[list] = []  # numba's passes for a part, made once

    def define_pipelines(self) -> list:
        """Return numba's passes without those that a part does not need."""
        if not PartPipeline.passes:
            (manager,) = super().define_pipelines()
            quick = Passes("part")
            quick.passes = [(step, why) for step, why in manager.passes if step.__name__ not in UNNEEDED]
            quick.finalize()
            PartPipeline.passes.append(quick)
        return PartPipeline.passes

    def compile_extra(self, func: Any) -> Any:
        """Compile a function without the code by which Python would call it."""
        state = self.state
        state.library = self.library(state.targetctx.codegen(), func.__qualname__)
        state.flags = Quick(state.flags)
        state.flags.no_compile = True  # pyright: ignore[reportAttributeAccessIssue]
        state.targetctx.get_abi_sizeof = partial(size_of, state.targetctx.target_data)
        result = super().compile_extra(func)
        description, library = result.fndesc, result.library
        entry = _dynfunc.make_function(
            description.lookup_module(), func.__name__, "", 0, result.environment, (library,)
        )  # fmt: skip
        state.targetctx.insert_user_function(entry, description, [library])
        return result._replace(entry_point=entry)


class CalledPipeline(PartPipeline):
    """The pipeline of a part that is called, which compiles into a CalledLibrary."""

    library = CalledLibrary


class KernelPipeline(Compiler):
    """numba's pipeline, which compiles into a KernelLibrary."""

    def compile_extra(self, func: Any) -> Any:
        self.state.library = KernelLibrary(self.state.targetctx.codegen(), func.__qualname__)
        self.state.library.enable_object_caching()
        with remembering(self.state.typingctx):
            return super().compile_extra(func)
