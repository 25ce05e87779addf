"""How parts of a kernel are compiled: numba makes machine code of every function, but parts are never run separately.

This uses undocumented interfaces of numba, so jit.py imports it only for the releases with which it was tried.
"""

from functools import partial
from typing import Any, ClassVar

from llvmlite.binding import Linkage, parse_assembly
from numba import _dynfunc  # pyright: ignore[reportAttributeAccessIssue]
from numba.core.cgutils import normalize_ir_text
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler, Flags

from .quick import Passes, remembering, size_of

# LLVM's first level of optimising: the third makes kernels no faster (scripts/benchmarks/against.py) and code that takes thrice the
# time to turn into machine code: of a tracker's 45 s of compiling, 16, and 5 to 7 at the first.
LEVEL = 1


class PartLibrary(JITCodeLibrary):
    """Code of a part, simplified, but without machine code, and without optimising again what it calls.

    All of a kernel is optimised once, when everything is in it. Simplifying each function beforehand pays off: it is short then.
    """

    def add_ir_module(self, ir_module: Any) -> None:
        """Take the code as it is: the kernel is verified, with all its parts."""
        self._raise_if_finalized()
        made = parse_assembly(normalize_ir_text(str(ir_module)))
        made.name = ir_module.name
        self._optimize_functions(made)
        if any(not function.is_declaration for function in self._final_module.functions):
            self._final_module.link_in(made)
        else:  # the first, and mostly the only one
            self._final_module = made

    def _optimize_functions(self, ll_module: Any) -> None:
        """Simplify what the module defines; numba makes new passes for each function, and for those only declared, too."""
        ll_module.data_layout = self._codegen._data_layout
        passes, builder = self._codegen._function_pass_manager(opt=LEVEL)
        for function in ll_module.functions:
            if not function.is_declaration:
                passes.run(function, builder)

    def finalize(self) -> None:
        """Keep to its own code: what it calls is linked once, into the kernel (numba links it into every caller again)."""
        self._raise_if_finalized()
        for library in self._linking_libraries:
            self._reload_init.update(library._reload_init)
        for function in self._final_module.functions:
            if not function.is_declaration and function.linkage == Linkage.external:
                function.linkage = "linkonce_odr"
        self._finalized = True

    def _get_module_for_linking(self) -> Any:
        """With all that it calls: for a library of numba's own, which links what it calls directly."""
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
        """Once cheaply, which inlines, so that more counting of references can be left out (numba's first step); then well."""
        first = self._codegen._module_pass_manager(loop_vectorize=False, slp_vectorize=False, opt=0, cost="cheap")
        for passes, builder in (first, self._codegen._module_pass_manager(opt=LEVEL)):
            passes.run(self._final_module, builder)


def link(module: Any, libraries: list) -> None:
    """Link libraries and all that they call into a module: each after its callers, or LLVM would find it unused and drop it."""
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
    """The same of a part that stays one copy: LLVM would inline what is called at one place, however long and seldom."""

    def _optimize_functions(self, ll_module: Any) -> None:
        for function in ll_module.functions:
            if not function.is_declaration:
                function.add_function_attribute("noinline")
        super()._optimize_functions(ll_module)


# Options of a part that the functions it calls set for themselves; numba derives the second from the first.
OWN = {"forceinline", "dbg_optnone"}


class Quick(Flags):
    """Options of a compilation, compared by those that were set.

    numba looks its overloads up by them for every operator of every function; Flags compares all fifty, by name. Whether the
    caller itself is inlined is left out: it would make two copies of each method that parts of both kinds call.
    """

    def values(self) -> dict:
        return self._values

    def __hash__(self) -> int:
        return hash(Quick)  # next to the types of a call, which tell calls apart

    def __eq__(self, other: Any) -> bool:
        return isinstance(other, Quick) and self._shared() == other._shared()

    def _shared(self) -> dict:
        return {name: value for name, value in self._values.items() if name not in OWN}


# Passes that have nothing to do in a part: `with`, comprehensions, functions made in functions, exceptions, numba's own inlining,
# expressions of arrays. Each visits the whole function, and so does the work that follows a pass.
UNNEEDED = {
    "WithLifting", "InlineClosureLikes", "MakeFunctionToJitFunction", "RewriteSemanticConstants", "RewriteDynamicRaises",
    "FindLiterallyCalls", "LiteralUnroll", "LiteralPropagationSubPipelinePass", "InlineOverloads", "NopythonRewrites",
    "IRLegalization", "DumpParforDiagnostics",
}  # fmt: skip


class PartPipeline(Compiler):
    """numba's pipeline into a PartLibrary."""

    library = PartLibrary
    passes: ClassVar[list] = []  # the same for every part, made once

    def define_pipelines(self) -> list:
        """numba's, without the passes that find nothing in a kernel."""
        if not PartPipeline.passes:
            (manager,) = super().define_pipelines()
            quick = Passes("part")
            quick.passes = [(step, why) for step, why in manager.passes if step.__name__ not in UNNEEDED]
            quick.finalize()
            PartPipeline.passes.append(quick)
        return PartPipeline.passes

    def compile_extra(self, func: Any) -> Any:
        """Compile a function; what would call it from Python is empty."""
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
    """The same into a CalledLibrary."""

    library = CalledLibrary


class KernelPipeline(Compiler):
    """numba's pipeline into a KernelLibrary."""

    def compile_extra(self, func: Any) -> Any:
        self.state.library = KernelLibrary(self.state.targetctx.codegen(), func.__qualname__)
        self.state.library.enable_object_caching()
        with remembering(self.state.typingctx):
            return super().compile_extra(func)
