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

# pipeline.py uses private interfaces of numba, and was tested with these releases of it (by scripts/try_numba.py). With any other
# release the standard compiler of numba is used, which is slower.
TRIED = ("0.66", "0.67", "0.68")
OWN_WAY = ".".join(numba.__version__.split(".")[:2]) in TRIED


def made_by(pipeline: str) -> dict[str, Any]:
    """Return the option of `njit` that selects a compiler class of pipeline.py by name; {} for releases of numba not in TRIED."""
    if not OWN_WAY:
        return {}
    from . import pipeline as own

    return {"pipeline_class": getattr(own, pipeline)}


# The fast-math flags nnan and ninf are left out: with them LLVM assumes that no NaN occurs, and tests that refuse NaN fail.
OPTIONS: dict[str, Any] = {"fastmath": {"nsz", "arcp", "contract", "afn", "reassoc"}, "error_model": "numpy"}
# Functions with `jit` may be called by Python and by compiled code; their machine code is not cached on disk.
jit = njit(**OPTIONS)
# All options and decorators from here to `spliced` are for functions that only compiled code calls; Python would crash calling
# them.
BUILD: dict[str, Any] = dict(OPTIONS, no_cpython_wrapper=True, no_cfunc_wrapper=True, forceinline=True)
# INLINE turns off reference counting (_nrt), so functions compiled with it must not allocate arrays.
INLINE: dict[str, Any] = dict(BUILD, _nrt=False, **made_by("PartPipeline"))
# BARE turns off forced inlining explicitly, because a function otherwise takes this option over from its caller.
BARE: dict[str, Any] = dict(INLINE, forceinline=False)
# Functions with `inner` are never inlined, which is best for code that rarely runs, or is large and has several callers.
inner = njit(**{**BARE, **made_by("CalledPipeline")})
# Functions with `inline` are copied into every caller, which is best for small code and for arguments that are large records.
inline = njit(**INLINE)
build = njit(**BUILD)  # `build` is like `inline`, for functions that allocate arrays
# `spliced` is for large functions with a single caller: numba inserts them into it before LLVM, which then optimises them only
# once.
spliced = njit(inline="always", **BARE)
# Functions with `shared` are inlined into compiled code, and run uncompiled when Python calls them.
shared = register_jitable(**INLINE)


# ------------------------------------------------------------------------------------------------- classes in the kernel
OPERATORS = {
    "__add__": operator.add, "__sub__": operator.sub, "__mul__": operator.mul, "__neg__": operator.neg,
}  # fmt: skip
METHODS: dict[str, dict[type, Callable]] = {}  # the methods that compiled code may call, by method name and class
FIELDS: set[str] = set()  # field names of all classes marked by the decorator `compiled`


def compiled(cls: type) -> type:
    """Class decorator: let compiled code call the methods of a NamedTuple class, each inlined where it is called.

    The class of the NamedTuple decides at compile time which method is called: one search loop thus serves all solvers, each a
    class with the same methods. Without compilation (NUMBA_DISABLE_JIT=1) the methods are normal methods. Methods of the same name
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
    """Decorator: compile a function that Python calls, and cache the machine code on disk.

    `parts` are classes and functions that are compiled into it as arguments, such as the class of a solver rule, so that its
    global names do not lead to them. The function is compiled again after an edit of its own file, of a file of `parts`, or of any
    file in the folders `kernel` and `compile`. `pipeline` names a compiler class of pipeline.py.
    """
    dispatcher = njit(nogil=True, no_cfunc_wrapper=True, **OPTIONS, **made_by(pipeline))(function)
    if hasattr(dispatcher, "_cache"):  # With NUMBA_DISABLE_JIT=1 numba returns the plain Python function.
        dispatcher._cache = make_cache(function, parts)
        dispatcher._compile_for_args = noting_time(dispatcher._compile_for_args)
    return dispatcher


def cached_small(function: Callable, *parts: Any) -> Any:
    """Decorator like `cached` that neither unrolls nor vectorises loops: for long functions whose loops run over a few joints."""
    return cached(function, *parts, pipeline="SmallPipeline")


def dual(function: Callable) -> Any:
    """Decorator: compile a function that allocates no arrays by `cached` for Python, and again for callers in compiled code."""
    dispatcher = cached(function)
    if hasattr(dispatcher, "get_overload"):  # With NUMBA_DISABLE_JIT=1 numba returns the plain Python function.
        part = njit(**BARE)(function)
        dispatcher.get_call_template, dispatcher.get_overload = part.get_call_template, part.get_overload
    return dispatcher


# (thread, begin, end) of the last periods [s of perf_counter] in which a thread waited for machine code to be compiled or loaded
waits: deque[tuple[int, float, float]] = deque(maxlen=64)


def compile_time(since: float, everywhere: bool = False) -> float:
    """Return how long [s] this thread (or any, if `everywhere`) has waited for compilation since the perf_counter time `since`."""
    if not waits or waits[-1][2] < since:
        return 0.0
    me, total, last = threading.get_ident(), 0.0, since
    for begin, end in sorted((begin, end) for thread, begin, end in tuple(waits) if everywhere or thread == me):
        if end > last:  # Several threads may wait at once; that time counts only once.
            total += end - max(begin, last)
            last = end
    return total


def noting_time(compile_for: Callable) -> Callable:
    """Wrap numba's method to compile, so that its times are noted in `waits` and the garbage collector pauses (saves 10 %)."""

    @functools.wraps(compile_for)
    def call(*arguments: Any, **keywords: Any) -> Any:
        was_on, began = gc.isenabled(), perf_counter()
        gc.disable()
        try:
            return compile_for(*arguments, **keywords)
        finally:
            if was_on:
                gc.enable()
                # Without this call the garbage collector would run at the next allocation and prolong the measured solve.
                gc.collect(0)
            made()
            waits.append((threading.get_ident(), began, perf_counter()))

    return call
