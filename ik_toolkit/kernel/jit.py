"""How the kernels are compiled: one set of numba options, and a cache on disk (see cache.py)."""

from collections.abc import Callable
from typing import Any

from numba import njit

from .cache import make_cache

# No nnan/ninf: a NaN has to fail every test instead of being assumed away.
OPTIONS: dict[str, Any] = {"fastmath": {"nsz", "arcp", "contract", "afn", "reassoc"}, "error_model": "numpy"}
jit = njit(**OPTIONS)  # for functions with flat arguments; compiled into their callers, never cached on their own
# For functions that take a NamedTuple of arrays (slow to pass by value), and for those whose last bit reaches a result: the
# process that compiles a kernel links `jit` functions to the copies of their own, which round otherwise than the cached ones.
inline = njit(forceinline=True, **OPTIONS)


def cached(function: Callable, *parts: Any) -> Any:
    """Compile with a cache on disk that an edit of any source makes void: kernel files, the function's, those of `parts`.

    parts: classes and functions compiled into it that cannot be found by its global names (a rule).
    """
    dispatcher = njit(nogil=True, **OPTIONS)(function)
    if hasattr(dispatcher, "_cache"):  # with NUMBA_DISABLE_JIT=1 it is the plain function
        dispatcher._cache = make_cache(function, parts)
    return dispatcher
