"""How the kernels are compiled: one set of numba options, and a disk cache that is never stale and survives every install."""

import functools
import hashlib
import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any

from numba import njit
from numba.core.caching import FunctionCache

# No nnan/ninf: a NaN has to fail every test instead of being assumed away.
OPTIONS: dict[str, Any] = {"fastmath": {"nsz", "arcp", "contract", "afn", "reassoc"}, "error_model": "numpy"}
jit = njit(**OPTIONS)  # for functions with flat arguments; compiled into their callers, never cached on their own
# For functions that take a NamedTuple of arrays (slow to pass by value), and for those whose last bit reaches a result: the
# process that compiles a kernel links `jit` functions to the copies of their own, which round otherwise than the cached ones.
inline = njit(forceinline=True, **OPTIONS)


class _StampedCache(FunctionCache):
    """numba watches the file of the cached function only; its callees are in other files, so their hash joins the key."""

    stamp = ""

    def _index_key(self, sig: Any, codegen: Any) -> tuple:
        return (*super()._index_key(sig, codegen), self.stamp)


def cached(function: Callable, *sources: Path) -> Any:
    """Compile with a disk cache that an edit of any kernel file, of the function's folder or of `sources` makes void.

    Where no cache folder can be written (numba then raises) do without.
    """
    dispatcher = njit(nogil=True, **OPTIONS)(function)
    if not hasattr(dispatcher, "_cache"):  # NUMBA_DISABLE_JIT=1: the plain function
        return dispatcher
    try:
        cache = _StampedCache(function)
    except RuntimeError:
        return dispatcher
    cache.stamp = stamp_of(Path(__file__).parent, source_file(function).parent, *sources)
    dispatcher._cache = cache
    return dispatcher


def stamp_of(*sources: Path) -> str:
    """Hash of files, and of all Python files in folders."""
    return hashlib.sha256("".join(map(_hash, sources)).encode()).hexdigest()


@functools.cache
def _hash(source: Path) -> str:
    files = sorted(source.glob("*.py")) if source.is_dir() else [source]
    return hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()


def source_file(thing: Any) -> Path:
    """File in which a class or function was defined."""
    return Path(inspect.getsourcefile(thing) or __file__)
