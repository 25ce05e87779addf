"""How parts of a kernel are compiled: their code is only kept, and optimised once, in the kernel that they end up in.

numba takes every compiled function for something to run: it optimises each as a library of its own, twice, with copies of all
it calls, and makes machine code of it. Parts are never run on their own.
"""

from typing import Any

from llvmlite.binding import Linkage
from numba import _dynfunc
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler, Flags


class PartLibrary(JITCodeLibrary):
    """Code of a part as it was made; what it calls stays in libraries of its own."""

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


class PartPipeline(Compiler):
    """numba's pipeline into a PartLibrary."""

    def compile_extra(self, func: Any) -> Any:
        """Compile a function; what would call it from Python is empty."""
        state = self.state
        state.library = PartLibrary(state.targetctx.codegen(), func.__qualname__)
        state.flags = Quick(state.flags)
        state.flags.no_compile = True
        result = super().compile_extra(func)
        description, library = result.fndesc, result.library
        entry = _dynfunc.make_function(
            description.lookup_module(), func.__name__, "", 0, result.environment, (library,)
        )  # fmt: skip
        state.targetctx.insert_user_function(entry, description, [library])
        return result._replace(entry_point=entry)
