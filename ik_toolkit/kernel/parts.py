"""How parts of a kernel are compiled: their code is only kept, and optimised once, in the kernel that they end up in.

numba takes every compiled function for something to run: it optimises each as a library of its own, twice, with copies of all
it calls, and makes machine code of it. Parts are never run on their own.
"""

from typing import Any

from numba import _dynfunc
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler, Flags


class PartLibrary(JITCodeLibrary):
    """Code of a part as it was made; what it calls stays in libraries of its own."""

    def finalize(self) -> None:
        """Nothing is to be done before the kernel."""
        self._raise_if_finalized()
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        """No machine code."""
        self._ensure_finalized()
        return 0


class KernelLibrary(JITCodeLibrary):
    """Code of a kernel: takes the parts, those of parts as well, each once."""

    def add_linking_library(self, library: Any) -> None:
        """Link a library and all that it needs."""
        waiting, seen = [library], set(self._linking_libraries)
        while waiting:
            library = waiting.pop()
            if library not in seen:
                seen.add(library)
                super().add_linking_library(library)
                if isinstance(library, PartLibrary):
                    waiting += library._linking_libraries


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


class KernelPipeline(Compiler):
    """numba's pipeline into a KernelLibrary."""

    def compile_extra(self, func: Any) -> Any:
        """Compile a function."""
        self.state.flags = Quick(self.state.flags)
        self.state.library = KernelLibrary(self.state.targetctx.codegen(), func.__qualname__)
        self.state.library.enable_object_caching()
        return super().compile_extra(func)
