"""How the kernels are compiled: one set of numba options, and a disk cache that survives every kind of install."""

import functools
import hashlib
import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any

from numba import njit

# No nnan/ninf: a NaN has to fail every test instead of being assumed away.
OPTIONS: dict[str, Any] = {"fastmath": {"nsz", "arcp", "contract", "afn", "reassoc"}, "error_model": "numpy"}
jit = njit(**OPTIONS)  # for functions with flat arguments; compiled into their callers, never cached on their own
# For functions that take a NamedTuple of arrays (slow to pass by value), and for those whose last bit reaches a result: the
# process that compiles a kernel links `jit` functions to the copies of their own, which round otherwise than the cached ones.
inline = njit(forceinline=True, **OPTIONS)


def cached(function: Callable) -> Any:
    """Compile with a disk cache; where no cache folder can be written (numba then raises at decoration) do without."""
    try:
        return njit(cache=True, nogil=True, **OPTIONS)(function)
    except RuntimeError:
        return njit(nogil=True, **OPTIONS)(function)


@functools.cache
def kernel_stamp(*sources: Path) -> str:
    """Hash of the kernel files and `sources`: numba watches only the cached function's own file, so this goes in its key."""
    files = [*sorted(Path(__file__).parent.glob("*.py")), *sources]
    return hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()


def source_file(thing: Any) -> Path:
    """File in which a class or function was defined."""
    return Path(inspect.getsourcefile(thing) or __file__)
