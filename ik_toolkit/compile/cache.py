"""A cache of compiled functions (kernels) on disk that is never stale or half written, and tolerates a full or damaged disk.

numba's own cache has three faults. It watches only the file of the cached function; it keeps all versions of a function in one
index, which two processes may overwrite for each other; and a damaged file makes it raise an error. Here each kernel is one file,
which is named by its key and holds the key and a checksum. If these do not match, the kernel is compiled again. Loading a file runs
code in it, so only files that no other user can have written are loaded.
"""

import functools
import grp
import hashlib
import inspect
import logging
import os
import pickle
import pwd
import stat
import threading
import types
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import llvmlite
import numba
from numba.core.caching import FunctionCache, NullCache
from numba.core.dispatcher import Dispatcher
from numba.core.runtime.nrt import rtsys
from numba.core.serialize import dumps

# Every kernel is compiled again after an edit of any Python file in or below these folders.
STAMPED = Path(__file__).parent, Path(__file__).parent.parent / "kernel"
HEAD = b"ik_toolkit kernel 1\n"  # A cache file consists of these bytes, the SHA-256 hash of its body (32 bytes), and the body.
PREFIX, SUFFIX = "ik-", ".nbc"
LOG = logging.getLogger("ik_toolkit.cache")
COMPILING = logging.getLogger("ik_toolkit.compile")
saying: dict[str, Any] = {"timer": None, "said": False}


class MemoryCache(NullCache):
    """Replaces the disk cache of a function whose machine code cannot be stored on disk: logs each compilation, stores nothing."""

    def __init__(self, what: str, why: str) -> None:
        """Take two texts for the log: the name of what is compiled, and why it cannot be kept."""
        self.what, self.why = what, why

    def load_overload(self, sig: Any, target_context: Any) -> None:
        """Return None, which tells numba that no compiled version is stored; log that the function is compiled now, and why."""
        compiling(self.what, f"in every process: {self.why}")


class DiskCache(FunctionCache):
    """Stores the machine code of one function on disk, in a folder that numba chooses: a file for each set of argument types."""

    def __init__(self, function: Any, what: str, stamp: str) -> None:
        """Take a function, its name for the log, and a hash of all its sources, which becomes a part of the key.

        Raises RuntimeError if numba finds no folder to write to.
        """
        super().__init__(function)
        self.what, self.stamp = what, stamp

    def _index_key(self, sig: Any, codegen: Any) -> tuple:
        return (*super()._index_key(sig, codegen), self.stamp, numba.__version__, llvmlite.__version__)

    def path(self, key: tuple) -> Path:
        """Return the cache file for a key of numba (argument types, source hash, versions).

        Its name also has a hash of the files in STAMPED, so that it changes with any of them.
        """
        name = f"{PREFIX}{self._impl.filename_base}.{stamp_of(*STAMPED)[:12]}.{_hash(repr(key).encode())[:16]}{SUFFIX}"
        return Path(self._cache_path) / name

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Load the machine code for argument types `sig` from disk; if no intact file exists, return None, so that numba compiles.

        The method in numba also calls `target_context.refresh`, which takes 0.3 s and is needed only to compile; the compiler
        calls it by itself.
        """
        rtsys.initialize(target_context)
        key = self._index_key(sig, target_context.codegen())
        path = self.path(key)
        if why := open_to_others(path.parent):
            not_kept(str(path.parent), why)
            compiling(self.what, f"in every process: {why}")
            return None
        try:
            stored, payload = pickle.loads(content(path))  # noqa: S301  our own file, and whole
            if stored == key:
                return self._impl.rebuild(target_context, payload)
        except FileNotFoundError:
            pass
        except Exception as error:  # A damaged file may raise any error; the kernel is then compiled instead.
            LOG.warning("%s cannot be used and is made anew: %s", path, error)
        compiling(self.what, "first use on this machine, up to half a minute", Path(self._cache_path))
        return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Write the machine code for argument types `sig` to the disk; if that is impossible, log a warning and continue."""
        if not self._impl.check_cachable(data) or open_to_others(Path(self._cache_path)):
            return
        key = self._index_key(sig, data.codegen)
        try:
            self._impl.locator.ensure_cache_path()
            write_body(self.path(key), dumps((key, self._impl.reduce(data))))
        except OSError as error:
            not_kept(str(self._cache_path), error.strerror or str(error))


def compiling(what: str, why: str, folder: Path | None = None) -> None:
    """Log that function `what` is compiled now, and `why`; if it takes over 1 s, warn the user, once in a process."""
    COMPILING.info("compiling %s (%s)", what, why, extra={"folder": folder})
    made()
    if not saying["said"]:
        # A user who sees nothing for longer than this [s] may think that the program hangs.
        saying["timer"] = timer = threading.Timer(1.0, _say, (what.partition(" ")[0], why))
        timer.daemon = True
        timer.start()


def _say(what: str, why: str) -> None:
    if not saying["said"]:
        saying["said"] = True
        COMPILING.warning("ik_toolkit is compiling %s (%s) ...", what, why)


def made() -> None:
    """Cancel the warning about a long compilation that `compiling` prepared, because the compilation has ended."""
    if saying["timer"] is not None:
        saying["timer"].cancel()
        saying["timer"] = None


@functools.cache  # `functools.cache` lets the warning appear only once in a process for each folder and reason.
def not_kept(folder: str, why: str) -> None:
    """Log a warning that compiled functions cannot be stored in a folder, and why, so that each process compiles them again."""
    LOG.warning(
        "compiled kernels cannot be kept in %s (%s): every process compiles again; see `ik doctor`", folder, why
    )


def folder() -> Path | None:
    """Return the folder where compiled functions of this package are kept, or None if none can be kept."""
    try:
        place = Path(DiskCache(stamp_of, "", "").cache_path)
    except (RuntimeError, OSError):
        return None
    return None if open_to_others(place) else place


def open_to_others(path: Path) -> str:
    """Return the reason if users other than this one and root could write the file or into the folder `path`, else ''."""
    try:
        return _open_to_others(os.stat(path))
    except OSError:
        return ""


def _open_to_others(found: os.stat_result) -> str:
    if found.st_uid not in (os.geteuid(), 0):
        return "it belongs to another user"
    # In a folder with the sticky bit, such as /tmp, other users may add files but not replace any.
    kept = stat.S_ISDIR(found.st_mode) and found.st_mode & stat.S_ISVTX
    if found.st_mode & stat.S_IWOTH and not kept:
        return "every user may write to it"
    if found.st_mode & stat.S_IWGRP and not kept and not _is_own_group(found.st_gid):
        return "other users of its group may write to it"
    return ""


def _is_own_group(group: int) -> bool:
    """Return whether a group has only this user, as many systems make a group for each user; root's group may be shared."""
    try:
        user, own = pwd.getpwuid(os.geteuid()), grp.getgrgid(group)
    except KeyError:
        return False
    alone = user.pw_gid == group and own.gr_name == user.pw_name and set(own.gr_mem) <= {user.pw_name}
    return alone and user.pw_uid != 0


def content(path: Path) -> bytes:
    """Return the body of a cache file, without header and hash. Raises ValueError if it is damaged or others could write it."""
    with path.open("rb") as file:
        if why := _open_to_others(os.fstat(file.fileno())):
            raise ValueError(why)
        data = file.read()
    body = data[len(HEAD) + 32 :]
    if data[: len(HEAD)] != HEAD or data[len(HEAD) : len(HEAD) + 32] != hashlib.sha256(body).digest():
        raise ValueError("the file is damaged")
    return body


def damaged(function: Any) -> tuple[Path | None, list[Path]]:
    """Return the folder below which all compiled functions are stored, and the damaged files in it.

    `function` is any function of the package with a disk cache; if it has none, the result is (None, []).
    """
    cache = getattr(function, "_cache", None)
    if not isinstance(cache, DiskCache):
        return None, []
    folder = Path(cache.cache_path)
    top = STAMPED[0].parent if folder.name == "__pycache__" else folder.parent
    return top, [path for path in sorted(top.rglob(f"{PREFIX}*")) if not _whole(path)]


def _whole(path: Path) -> bool:
    try:
        return path.suffix == SUFFIX and bool(content(path))
    except (OSError, ValueError):
        return False


def write_body(path: Path, body: bytes) -> None:
    """Write a cache file with the given body, whole or not at all; then remove cache files made from older sources beside it."""
    part = path.with_suffix(f".{uuid.uuid4().hex}.part")
    try:
        part.write_bytes(HEAD + hashlib.sha256(body).digest() + body)
        part.chmod(0o644)  # Only the user may write to the file, even if the umask lets a group write to new files.
        os.replace(part, path)
    except BaseException:
        part.unlink(missing_ok=True)
        raise
    _remove_old(path.parent)


@functools.cache  # `functools.cache` makes this run only once in a process for each folder.
def _remove_old(folder: Path) -> None:
    for path in folder.glob(f"{PREFIX}*{SUFFIX}"):
        if f".{stamp_of(*STAMPED)[:12]}." not in path.name:
            path.unlink(missing_ok=True)


def make_cache(function: Any, parts: tuple[Any, ...]) -> NullCache | DiskCache:
    """Return the disk cache for a function, or a MemoryCache if it cannot be stored.

    `parts` are the classes and functions that are compiled into it as arguments, such as the class of a solver rule.
    """
    what = " ".join([*(part.__name__ for part in parts[:1]), f"{function.__module__}.{function.__name__}"])
    for part in parts:
        if part.__module__ in ("__main__", "__mp_main__") or "<locals>" in part.__qualname__:
            where = "in a script or a session" if "<locals>" not in part.__qualname__ else "inside a function"
            return MemoryCache(what, f"{part.__name__} is defined {where}; a module of its own would be kept")
    try:
        sources = {source for thing in (function, *parts) for source in _sources(thing)}
        return DiskCache(function, what, stamp_of(*STAMPED, *sorted(sources)))
    # numba found no folder to write to (RuntimeError), or the function has no source file to hash (OSError).
    except (RuntimeError, OSError) as error:
        return MemoryCache(what, str(error))


# ------------------------------------------------------------------------------------------------------------ the stamp
def stamp_of(*sources: Path) -> str:
    """Return the SHA-256 hash, as text, of the contents of the given files and of all Python files in and below given folders."""
    return _hash("".join(map(_stamp, sources)).encode())


@functools.cache
def _stamp(source: Path) -> str:
    files = sorted(source.rglob("*.py")) if source.is_dir() else [source]
    return _hash(b"".join(path.read_bytes() for path in files))


def _hash(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def _sources(thing: Any, seen: set | None = None) -> Iterator[Path]:
    """Yield the source files of a class or function, and of the package's functions and records that it uses, if outside STAMPED.

    Functions that are not compiled count, too: numba compiles an overload in place of them, which calls what they call.
    """
    seen = set() if seen is None else seen
    thing = getattr(thing, "py_func", thing)
    path = Path(inspect.getsourcefile(thing) or __file__)
    if thing in seen or path.parent in STAMPED:
        return
    seen.add(thing)
    yield path
    for function in filter(inspect.isfunction, vars(thing).values() if isinstance(thing, type) else (thing,)):
        if function.__code__.co_filename != str(path):
            continue  # The methods that NamedTuple generates have no source file.
        found = inspect.getclosurevars(function)
        values = [*found.globals.values(), *found.nonlocals.values()]
        modules = [value for value in values if isinstance(value, types.ModuleType)]
        # In a call module.name(), Python lists the name as unbound, so every unbound name is looked up in all modules that are
        # used.
        values += [vars(module).get(name) for module in modules for name in found.unbound]
        for value in values:
            ours = inspect.isfunction(value) and value.__module__.startswith(__name__.partition(".")[0] + ".")
            if ours or isinstance(value, Dispatcher) or (isinstance(value, type) and hasattr(value, "_fields")):
                yield from _sources(value, seen)
