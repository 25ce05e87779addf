"""How functions are compiled: numba's options, records whose methods compile, and a cache on disk (see cache.py).

A kernel is a compiled function that Python calls; its parts are functions that only compiled code calls.
"""

# Numba's type hints lack options given in a dict, and functions that only numba calls, so pyright must not report these.
# pyright: reportCallIssue=false, reportArgumentType=false, reportGeneralTypeIssues=false
import functools
import gc
import inspect
import operator
import threading
from collections import deque
from collections.abc import Callable
from time import perf_counter
from typing import Any

import numba
import numpy.ma  # noqa: F401  numba imports it when it sees an array for the first time, which would count as time of a solve.
from numba import njit, types
from numba.extending import overload, overload_method, register_jitable

from .cache import made, make_cache

# Releases of numba with which pipeline.py works; scripts/try_numba.py tries one.
# pipeline.py uses private interfaces of numba, so other releases compile kernels in numba's own, slower way.
TRIED = ("0.66", "0.67", "0.68")
OWN_WAY = ".".join(numba.__version__.split(".")[:2]) in TRIED


def made_by(pipeline: str) -> dict[str, Any]:
    """Return the option that makes numba use a class of pipeline.py; empty for a release of numba with which that was not tried."""
    if not OWN_WAY:
        return {}
    from . import pipeline as own

    return {"pipeline_class": getattr(own, pipeline)}


# The flags nnan and ninf are left out, because a NaN must fail every test and must not be assumed away.
OPTIONS: dict[str, Any] = {"fastmath": {"nsz", "arcp", "contract", "afn", "reassoc"}, "error_model": "numpy"}
# `jit` is for functions that both Python and compiled code may call; their machine code is not cached on disk.
jit = njit(**OPTIONS)
# The options below are for functions that only compiled code calls (see pipeline.py); a call from Python would crash.
BUILD: dict[str, Any] = dict(OPTIONS, no_cpython_wrapper=True, no_cfunc_wrapper=True, forceinline=True)
# INLINE is for functions that make no arrays, compiled without reference counting.
INLINE: dict[str, Any] = dict(BUILD, _nrt=False, **made_by("PartPipeline"))
# BARE turns off forced inlining, which numba would otherwise pass on from the caller to every function that it calls.
BARE: dict[str, Any] = dict(INLINE, forceinline=False)
# `inner` compiles one copy, which callers call. It is for code that rarely runs, or that is large and used in several places.
inner = njit(**{**BARE, **made_by("CalledPipeline")})
# `inline` copies the function into every caller; for small code and for code with large NamedTuples
inline = njit(**INLINE)
build = njit(**BUILD)  # `build` copies the function into every caller, too; for code that makes arrays
# `spliced` is for large code with a single caller, so that LLVM optimises only one copy
spliced = njit(inline="always", **BARE)
# for functions that are inlined in compiled code, and that Python runs as plain Python
shared = register_jitable(**INLINE)


# ------------------------------------------------------------------------------------------------- classes in the kernel
OPERATORS = {
    "__add__": operator.add, "__sub__": operator.sub, "__mul__": operator.mul, "__neg__": operator.neg,
}  # fmt: skip
METHODS: dict[str, dict[type, Callable]] = {}  # compiled methods by method name and class
FIELDS: set[str] = set()  # field names of all classes marked by `compiled`


def compiled(cls: type) -> type:
    """Class decorator: let compiled code call the methods of a NamedTuple class, each inlined where it is called.

    Which method is called is decided at compile time by the class of the NamedTuple; this is how the one search loop gets its
    solver rule and its problem. Without compilation (NUMBA_DISABLE_JIT=1) the methods are normal methods. Methods of the same name
    must have the same argument names in all classes. As numba looks up methods before fields, no field of any class may have the
    name of a method of any class.

    Raises:
        TypeError: A field and a method share a name.
    """
    FIELDS.update(cls._fields)  # type: ignore[attr-defined]
    for name, method in vars(cls).items():
        if inspect.isfunction(method) and (name in OPERATORS or not name.startswith("_")):
            METHODS.setdefault(name, {})[cls] = method
            if len(METHODS[name]) == 1:
                _let_numba_know(name, method)
    if clash := FIELDS & METHODS.keys():
        raise TypeError(f"{cls.__name__}: a field and a method of kernel records share the name {', '.join(clash)}")
    return cls


def _let_numba_know(name: str, example: Callable) -> None:
    """Tell numba that records have a method of this name; the method of a class is looked up when a call is compiled."""

    def resolve(self: Any, *_: Any) -> Callable | None:
        return METHODS[name].get(getattr(self, "instance_class", None))  # type: ignore[arg-type]

    resolve.__signature__ = inspect.signature(example)  # type: ignore[attr-defined]  # numba compares the names of arguments
    if name in OPERATORS:
        overload(OPERATORS[name], jit_options=INLINE)(resolve)
    else:
        overload_method(types.BaseNamedTuple, name, jit_options=INLINE)(resolve)


# ----------------------------------------------------------------------------------------------------------- the boundary
def cached(function: Callable, *parts: Any, pipeline: str = "KernelPipeline") -> Any:
    """Decorator: compile a function that Python calls, with a cache on disk.

    The cache is invalid after an edit of any file directly in the folders `kernel` and `compile`, of the function's file, or of the
    files of `parts`. These are classes and functions, such as a solver rule, that are compiled into the function but are not found
    through its global names.
    """
    dispatcher = njit(nogil=True, no_cfunc_wrapper=True, **OPTIONS, **made_by(pipeline))(function)
    if hasattr(dispatcher, "_cache"):  # With NUMBA_DISABLE_JIT=1 the result is the plain Python function.
        dispatcher._cache = make_cache(function, parts)
        dispatcher._compile_for_args = noting_time(dispatcher._compile_for_args)
    return dispatcher


def cached_small(function: Callable, *parts: Any) -> Any:
    """Decorator: like `cached`, for a long function whose loops are short, see `SmallLibrary`."""
    return cached(function, *parts, pipeline="SmallPipeline")


def dual(function: Callable) -> Any:
    """Decorator for functions that make no arrays: compile them twice, by `cached` for Python and inlinable for compiled code."""
    dispatcher = cached(function)
    if hasattr(dispatcher, "get_overload"):  # With NUMBA_DISABLE_JIT=1 the result is the plain Python function.
        part = njit(**BARE)(function)
        dispatcher.get_call_template, dispatcher.get_overload = part.get_call_template, part.get_overload
    return dispatcher


# The last times [s, by perf_counter] at which kernels (compiled functions) were compiled or loaded, with the thread that waited.
waits: deque[tuple[int, float, float]] = deque(maxlen=64)


def compile_time(since: float, everywhere: bool = False) -> float:
    """Return how long [s] this thread, or any, has waited for code to be compiled or loaded, since a time of `perf_counter`."""
    if not waits or waits[-1][2] < since:
        return 0.0
    me, total, last = threading.get_ident(), 0.0, since
    for begin, end in sorted((begin, end) for thread, begin, end in tuple(waits) if everywhere or thread == me):
        if end > last:  # waits of several threads overlap, so each period is counted once
            total += end - max(begin, last)
            last = end
    return total


def noting_time(compile_for: Callable) -> Callable:
    """Wrap numba's compile function: note how long it takes, and pause the garbage collector, which saves a tenth of the time."""

    @functools.wraps(compile_for)
    def call(*arguments: Any, **keywords: Any) -> Any:
        was_on, began = gc.isenabled(), perf_counter()
        gc.disable()
        try:
            return compile_for(*arguments, **keywords)
        finally:
            if was_on:
                gc.enable()
                # otherwise the garbage collector would run at the next allocation and count as time of the solve
                gc.collect(0)
            made()
            waits.append((threading.get_ident(), began, perf_counter()))

    return call
