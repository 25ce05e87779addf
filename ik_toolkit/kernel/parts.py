"""How parts of a kernel are compiled: numba makes machine code of every function, but parts are never run on their own."""

import inspect
from typing import Any

from numba import _dynfunc  # pyright: ignore[reportAttributeAccessIssue]
from numba.core.codegen import CPUCodegen, JITCodeLibrary
from numba.core.compiler import Compiler, Flags

# What is used of numba beyond its documentation; where it is missing or takes other arguments, jit.py does without this module.
USED = ("_optimize_functions", "_optimize_final_module", "_finalize_final_module")
KNOWN = "no_compile" in Flags.options and all(hasattr(JITCodeLibrary, name) for name in USED)
_, *asked = inspect.signature(CPUCodegen._function_pass_manager).parameters.values()
if not KNOWN or any(one.kind == one.POSITIONAL_OR_KEYWORD and one.default is one.empty for one in asked):  # numba 0.61
    raise ImportError("this numba compiles otherwise")


class PartLibrary(JITCodeLibrary):
    """Code of a part, simplified, but no machine code of it, and none of what it calls is optimised once more.

    All of a kernel is optimised once, when everything is in it. To simplify each function before is worth it: it is short then.
    """

    def _optimize_functions(self, ll_module: Any) -> None:
        """Simplify what the module defines; numba makes new passes for each function, and for those only declared, too."""
        ll_module.data_layout = self._codegen._data_layout
        passes, builder = self._codegen._function_pass_manager()
        for function in ll_module.functions:
            if not function.is_declaration:
                passes.run(function, builder)

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalized = True


class CalledLibrary(PartLibrary):
    """The same of a part that stays one copy: LLVM would inline what is called at one place, however long and seldom."""

    def _optimize_functions(self, ll_module: Any) -> None:
        for function in ll_module.functions:
            if not function.is_declaration:
                function.add_function_attribute("noinline")
        super()._optimize_functions(ll_module)


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

    library = PartLibrary

    def define_pipelines(self) -> list:
        """numba's, without the passes that find nothing in a kernel."""
        (manager,) = super().define_pipelines()
        manager.passes = [(step, why) for step, why in manager.passes if step.__name__ not in UNNEEDED]
        manager.finalize()
        return [manager]

    def compile_extra(self, func: Any) -> Any:
        """Compile a function; what would call it from Python is empty."""
        state = self.state
        state.library = self.library(state.targetctx.codegen(), func.__qualname__)
        state.flags = Quick(state.flags)
        state.flags.no_compile = True  # pyright: ignore[reportAttributeAccessIssue]
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
