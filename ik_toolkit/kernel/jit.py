"""How the kernels are compiled: one set of numba options, classes whose methods compile, and a cache on disk (see cache.py)."""

# numba's own types know neither options in a dict nor that overloads and intrinsics are called by numba.
# pyright: reportCallIssue=false, reportArgumentType=false, reportGeneralTypeIssues=false
import functools
import gc
import inspect
import operator
from collections.abc import Callable
from typing import Any

import numba
from numba import njit, types
from numba.extending import overload, overload_method, register_jitable

from .cache import make_cache

# Releases of numba whose private interfaces parts.py and quick.py were tried with; scripts/try_numba.py tries another. Without
# the two a release raises at best, and at worst LLVM ends the process, so any other compiles in its usual, slower way.
TRIED = ("0.66", "0.67", "0.68")
OWN_WAY = ".".join(numba.__version__.split(".")[:2]) in TRIED
PARTS: dict[str, Any] = {}
CALLED: dict[str, Any] = {}
KERNEL: dict[str, Any] = {}
if OWN_WAY:
    from .parts import CalledPipeline, KernelPipeline, PartPipeline

    PARTS, CALLED = {"pipeline_class": PartPipeline}, {"pipeline_class": CalledPipeline}
    KERNEL = {"pipeline_class": KernelPipeline}

# No nnan/ninf: a NaN has to fail every test instead of being assumed away.
OPTIONS: dict[str, Any] = {"fastmath": {"nsz", "arcp", "contract", "afn", "reassoc"}, "error_model": "numpy"}
jit = njit(**OPTIONS)  # also callable from Python; compiled into its callers, never cached separately
# What follows is for the kernel alone (see parts.py); a call from Python would crash. Only what makes arrays counts references
# (`build`); all the rest borrows them, so a record of arrays costs nothing to pass, and must not return an array, or a record
# of arrays, to a function that counts.
# What makes arrays is compiled by plain numba: as a part, its references are counted in full, 5 microseconds a call.
BUILD: dict[str, Any] = dict(OPTIONS, no_cpython_wrapper=True, no_cfunc_wrapper=True, forceinline=True)
INLINE: dict[str, Any] = dict(BUILD, _nrt=False, **PARTS)
# numba passes the request to inline on to everything that is called, unless it is refused.
BARE: dict[str, Any] = dict(INLINE, forceinline=False)
inner = njit(**{**BARE, **CALLED})  # one copy, called: for code that is rarely run, or large and used in several places
inline = njit(**INLINE)  # into every caller; also for code that takes or returns records, which are expensive to pass
build = njit(**BUILD)
spliced = njit(inline="always", **BARE)  # for a large part called once: no second copy is optimised
shared = register_jitable(**INLINE)  # inline in the kernel, and from Python as it is written


def dual(function: Callable) -> Any:
    """Compile as `jit` for calls from Python, and for kernels as a part, without code that Python calls. Makes no arrays."""
    dispatcher = jit(function)
    if hasattr(dispatcher, "get_overload"):  # with NUMBA_DISABLE_JIT=1 it is the plain function
        part = njit(**BARE)(function)
        dispatcher.get_call_template, dispatcher.get_overload = part.get_call_template, part.get_overload
    return dispatcher


# ------------------------------------------------------------------------------------------------- classes in the kernel
OPERATORS = {
    "__add__": operator.add, "__sub__": operator.sub, "__mul__": operator.mul, "__neg__": operator.neg,
}  # fmt: skip
METHODS: dict[str, dict[type, Callable]] = {}  # name -> class -> function
FIELDS: set[str] = set()


def compiled(cls: type) -> type:
    """Class decorator: let kernels call the methods of a NamedTuple class, each inlined where it is called.

    A method is chosen by the class of the record it is called on, at compile time: this is how the one search loop gets its
    rule and its problem. Without compilation (NUMBA_DISABLE_JIT=1) they are the plain methods they look like. Methods of one
    name have the same names of arguments in all classes; numba looks up methods before fields, so no field may have the name
    of a method, of whatever class. Class methods, and methods no kernel calls, stay Python.
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
    """Register a method name with numba; its classes are looked up when a call is compiled."""

    def resolve(self: Any, *_: Any) -> Callable | None:
        return METHODS[name].get(getattr(self, "instance_class", None))  # type: ignore[arg-type]

    resolve.__signature__ = inspect.signature(example)  # type: ignore[attr-defined]  numba compares the names of arguments
    if name in OPERATORS:
        overload(OPERATORS[name], jit_options=INLINE)(resolve)
    else:
        overload_method(types.BaseNamedTuple, name, jit_options=INLINE)(resolve)


# ----------------------------------------------------------------------------------------------------------- the boundary
def cached(function: Callable, *parts: Any) -> Any:
    """Compile with a cache on disk that an edit of any source makes void: kernel files, the function's, those of `parts`.

    parts: classes and functions compiled into it that cannot be found by its global names (a rule).
    """
    dispatcher = njit(nogil=True, no_cfunc_wrapper=True, **OPTIONS, **KERNEL)(function)
    if hasattr(dispatcher, "_cache"):  # with NUMBA_DISABLE_JIT=1 it is the plain function
        dispatcher._cache = make_cache(function, parts)
        dispatcher._compile_for_args = without_collector(dispatcher._compile_for_args)
    return dispatcher


def without_collector(compile_for: Callable) -> Callable:
    """Compile with the garbage collector paused: searching millions of objects, most of them kept, takes a tenth of the time."""

    @functools.wraps(compile_for)
    def call(*arguments: Any, **keywords: Any) -> Any:
        was_on = gc.isenabled()
        gc.disable()
        try:
            return compile_for(*arguments, **keywords)
        finally:
            if was_on:
                gc.enable()

    return call
