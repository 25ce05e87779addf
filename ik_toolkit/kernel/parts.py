"""How parts of a kernel are compiled: their code is only kept, and optimised once, in the kernel that they end up in.

numba takes every compiled function for something to run: it optimises each as a library of its own, twice, with copies of all
it calls, and makes machine code of it. Parts are never run on their own.
"""

from typing import Any

from llvmlite.binding import Linkage
from numba import _dynfunc, types  # pyright: ignore[reportAttributeAccessIssue]
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler, Flags


class PartLibrary(JITCodeLibrary):
    """Code of a part as it was made; what it calls stays in libraries of its own."""

    def _optimize_functions(self, ll_module: Any) -> None:
        """Simplify what the module defines; numba makes new passes for each function, and for those only declared, too."""
        ll_module.data_layout = self._codegen._data_layout
        passes, builder = self._codegen._function_pass_manager()
        for function in ll_module.functions:
            if not function.is_declaration:
                passes.run(function, builder)

    def finalize(self) -> None:
        """Nothing is to be done before the kernel."""
        self._raise_if_finalized()
        self._finalized = True

    def _get_module_for_linking(self) -> Any:
        if self._shared_module is None:
            module = _for_linking(self)
            waiting, seen = list(self._linking_libraries), {self}
            while waiting:
                library = waiting.pop()
                if library in seen:
                    continue
                seen.add(library)
                if isinstance(library, PartLibrary):
                    waiting += library._linking_libraries
                    module.link_in(_for_linking(library))
                else:
                    module.link_in(library._get_module_for_linking(), preserve=True)
            self._shared_module = module
        return self._shared_module


def _for_linking(part: PartLibrary) -> Any:
    """Copy of the own code of a part, whose names may occur again in others."""
    module = part._final_module.clone()
    for function in module.functions:
        if not function.is_declaration and function.linkage == Linkage.external:
            function.linkage = "linkonce_odr"
    return module


class Quick(Flags):
    """Options of a compilation, compared by those that were set.

    numba looks its overloads up by them for every operator of every function; Flags compares all fifty, by name.
    """

    def values(self) -> dict:
        return self._values

    def __hash__(self) -> int:
        return hash(tuple(self._values))

    def __eq__(self, other: Any) -> bool:
        return isinstance(other, Quick) and self._values == other._values


# Passes that find nothing to do in a part: `with`, comprehensions, functions made in functions, exceptions, numba's own inlining,
# expressions of arrays. Each walks through the whole function, and so does what follows a pass.
UNNEEDED = {
    "WithLifting", "InlineClosureLikes", "MakeFunctionToJitFunction", "RewriteSemanticConstants", "RewriteDynamicRaises",
    "FindLiterallyCalls", "LiteralUnroll", "LiteralPropagationSubPipelinePass", "InlineOverloads", "NopythonRewrites",
    "IRLegalization", "DumpParforDiagnostics",
}  # fmt: skip


class PartPipeline(Compiler):
    """numba's pipeline into a PartLibrary."""

    def define_pipelines(self) -> list:
        """numba's, without the passes that find nothing in a kernel."""
        (manager,) = super().define_pipelines()
        manager.passes = [(step, why) for step, why in manager.passes if step.__name__ not in UNNEEDED]
        manager.finalize()
        return [manager]

    def compile_extra(self, func: Any) -> Any:
        """Compile a function; what would call it from Python is empty."""
        state = self.state
        state.library = PartLibrary(state.targetctx.codegen(), func.__qualname__)
        state.flags = Quick(state.flags)
        state.flags.no_compile = True  # pyright: ignore[reportAttributeAccessIssue]
        result = super().compile_extra(func)
        description, library = result.fndesc, result.library
        entry = _dynfunc.make_function(
            description.lookup_module(), func.__name__, "", 0, result.environment, (library,)
        )  # fmt: skip
        state.targetctx.insert_user_function(entry, description, [library])
        return result._replace(entry_point=entry)


def any_integer(dispatcher: Any) -> Any:
    """Compile a part once for all integers: numba compiles it for each constant that it is called with."""
    if hasattr(dispatcher, "get_call_template"):  # with NUMBA_DISABLE_JIT=1 it is the plain function
        plain = dispatcher.get_call_template
        dispatcher.get_call_template = lambda args, kws: plain(
            tuple(types.unliteral(a) for a in args), {k: types.unliteral(a) for k, a in kws.items()}
        )
    return dispatcher
