"""The first solve on a machine: computed by uncompiled code, while a background process compiles.

A command that finds no compiled code on disk stops where it would begin to compile, and is run again without compilation: as plain
Python, which is slow but starts at once. If this run uses up its budget without a solution, the command is run once more, compiled.
"""

import logging
import os
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ..errors import clean
from .output import notice

# The first command of a new installation is answered by interpreted code while the code is compiled in the background. Users set
# the environment variable WAIT to wait for compilation instead. INTERPRETED is set for the run without compilation.
WAIT, INTERPRETED = "IK_TOOLKIT_WAIT", "IK_TOOLKIT_INTERPRETED"
AGAIN = "IK_TOOLKIT_AGAIN"  # This environment variable is set if a command is run again, without or after compilation.
BUDGET = 2000  # Limit on the evaluations of a run without compilation, which take about 1 s.
NOT_ANSWERED = 75  # Exit code of a run that has used up this budget without an answer (EX_TEMPFAIL of sysexits.h).
LOCK, LOG = "compiling.lock", "compiling.log"  # Files of background compilation, in the folder of compiled code.
# A file of this name exists while a background process compiles, and remains if that process dies.
BEGUN = "compiling.begun"
_here = {"allowed": False, "past": False}


class CompileNeeded(Exception):
    """Raised instead of compiling code, so that a command can run without compiled code. `folder` is the cache folder or None."""

    def __init__(self, folder: Path | None) -> None:
        """Store the folder of the cache."""
        super().__init__()
        self.folder = folder


class _Stop(logging.Handler):
    def emit(self, record: logging.LogRecord) -> None:
        raise CompileNeeded(getattr(record, "folder", None))


def allow() -> None:
    """Allow this process to answer a command without compiled code, by the context manager `instead_of_compiling`.

    This does nothing if environment variables ask to wait for compilation (IK_TOOLKIT_WAIT) or mark a build server (CI).
    """
    _here["allowed"] = not any(os.environ.get(name) for name in (WAIT, INTERPRETED, "CI", "NUMBA_DISABLE_JIT"))


def budget() -> int | None:
    """Return how many evaluations a solve may take: a limit if this process runs uncompiled code, which is slow, else None."""
    return BUDGET if os.environ.get(INTERPRETED) else None


def kernel() -> str:
    """Return whether this process uses compiled or interpreted code: "compiled" or "interpreted"."""
    from numba import config

    return "interpreted" if config.DISABLE_JIT else "compiled"  # type: ignore[attr-defined]


@contextmanager
def instead_of_compiling() -> Iterator[None]:
    """Context manager in which code that has to be compiled raises CompileNeeded, if `allow` was called before."""
    _here["past"] = True
    if not _here["allowed"]:
        yield
        return
    log, stop = logging.getLogger("ik_toolkit.compile"), _Stop()
    log.addHandler(stop)
    try:
        yield
    finally:
        log.removeHandler(stop)


def said_before() -> bool:
    """Return whether an earlier run of this command has already shown the messages that are logged now.

    If code has to be compiled, a command stops and is run again. Up to the point where it stopped, the new run logs the same
    messages.
    """
    return bool(os.environ.get(AGAIN)) and not _here["past"]


def again(arguments: Sequence[str], folder: Path | None, came: Sequence[int]) -> int:
    """Run a command again with uncompiled code, then start to compile in the background; return the command's exit code.

    arguments: words of the command line. folder: where compiled code is cached, or None. came: numbers of the signals that have
    raised KeyboardInterrupt.
    """
    # The new process imports from the same folders as this one. With `python -m` it would also import from the current folder.
    start = f"import sys; sys.path[:] = {sys.path!r}; from ik_toolkit.cli import main; sys.exit(main())"
    command = [sys.executable, "-c", start]
    waiting = {**os.environ, WAIT: "1"}
    without = {**os.environ, AGAIN: "1", INTERPRETED: "1", "NUMBA_DISABLE_JIT": "1"}
    code = _run([*command, *arguments], without, came)
    if code == NOT_ANSWERED:
        return _run([*command, *arguments], {**waiting, AGAIN: "1"}, came)
    if code not in (0, 1):  # The run without compilation has failed and said why.
        return code
    if folder is None:
        notice(f"solved without compiled code, which cannot be kept here (see ik doctor); {WAIT}=1 compiles")
        return code
    from ..compile.cache import folder as common

    folder = common() or folder  # The log is always in the common cache folder, although some code is cached elsewhere.
    if why := died(folder):
        notice(f"solved without compiled code: {why}")
        return code
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with open(folder / LOG, "ab") as log:
            subprocess.Popen(
                [*command, "doctor", "--prepare", "--background"],
                env=waiting, stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True,
            )  # fmt: skip
    except OSError as error:
        notice(f"solved without compiled code; compiling in the background cannot start: {error.strerror}: {folder}")
        return code
    notice(f"first use: solved without compiled code; compiling continues in the background ({folder / LOG})")
    return code


def _run(command: Sequence[str], environment: dict[str, str], came: Sequence[int]) -> int:
    """Run a command in place of this one and return its exit code; Ctrl-C and SIGTERM are passed on, and it reports them."""
    with subprocess.Popen(command, env=environment) as process:
        try:
            return process.wait()
        except KeyboardInterrupt:
            try:
                process.wait(1.0)  # Ctrl-C in a terminal goes to the new process too, which then ends by itself.
            except subprocess.TimeoutExpired:
                process.send_signal(signal.SIGTERM if signal.SIGTERM in came else signal.SIGINT)
            code = process.wait()
            if code < 0:  # A signal ended the new process before it could report the interruption.
                raise
            return code


@contextmanager
def only_one(folder: Path) -> Iterator[bool]:
    """Context manager for background compilation: yield True and hold a lock, or False if another process holds it.

    The process gets the lowest priority. If it fails or is killed, a file remains that `died` finds; Ctrl-C removes the file.
    """
    os.nice(19)
    folder.mkdir(parents=True, exist_ok=True)
    with open(folder / LOCK, "a") as lock:
        if not _lock(lock):
            yield False
            return
        (folder / BEGUN).write_text(_versions())
        try:
            yield True
        except Exception:
            raise
        except BaseException:
            forget(folder)
            raise
        forget(folder)


def _lock(file: Any) -> bool:
    import fcntl

    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


def _versions() -> str:
    """Return the versions of the package and the compiler as text; a failure with other versions may not occur again."""
    import llvmlite
    import numba

    from ..compile.cache import STAMPED, stamp_of

    return f"kernels {stamp_of(*STAMPED)}, numba {numba.__version__}, llvmlite {llvmlite.__version__}, {sys.version}"


def compiling(folder: Path) -> bool:
    """Return whether another process is compiling in the background into this folder."""
    try:
        with open(folder / LOCK) as lock:
            return not _lock(lock)
    except OSError:
        return False


def died(folder: Path) -> str:
    """Return a sentence on how a background compilation of the installed versions failed, '' if none did."""
    try:
        if compiling(folder) or (folder / BEGUN).read_text() != _versions():
            return ""
        said = (folder / LOG).read_text(errors="replace").strip().splitlines()
    except OSError:
        return ""
    last = f": {clean(said[-1])[:200]}" if said else ""
    how = "'ik doctor --prepare' compiles where its errors are seen"
    return f"compiling in the background ended before it was done{last} ({folder / LOG}); {how}"


def forget(folder: Path) -> None:
    """Remove the file that marks an unfinished background compilation."""
    (folder / BEGUN).unlink(missing_ok=True)
