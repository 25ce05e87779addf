"""Standard streams and signals of a command: `-`, closed streams, pipes closed by the reader, Ctrl-C and SIGTERM."""

import os
import re
import shutil
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

from ..errors import InvalidOption
from ..files import JSON_BYTES

RAISED_AGAIN = 0.05  # Time [s] after which Ctrl-C is raised again if Python has dropped its exception.
IMPORTING = 20.0  # Ctrl-C waits for the end of an import for at most this time [s].


def open_standard_streams() -> None:
    """Give a process started with a closed stdin, stdout or stderr (`>&-`) the null device in its place.

    Otherwise the next file opened would get its number, and what is printed would go there.
    """
    for number, name, mode in ((0, "stdin", "r"), (1, "stdout", "w"), (2, "stderr", "w")):
        if getattr(sys, name) is not None:
            continue
        try:
            os.fstat(number)
        except OSError:
            os.dup2(os.open(os.devnull, os.O_RDWR), number)
        setattr(sys, name, open(number, mode, encoding="utf-8", closefd=False))


@contextmanager
def with_input(arguments: Sequence[str]) -> Iterator[list[str]]:
    """Context manager: yield the arguments with `-` replaced by a temporary file that holds all of standard input.

    The file is named after the robot in it, with a suffix by its contents: .urdf, .npz, .toml, .json or .csv. A file is needed,
    because commands may read their input twice. XML, TOML and JSON are cut one byte after the largest size that is accepted, so
    that they are refused. Raises InvalidOption, also if the input is neither text nor NPZ.
    """
    places = [k for k, word in enumerate(arguments) if re.fullmatch(r"(--[a-z-]+=)?-", word)]
    if not places:
        yield [*arguments]
        return
    for k in places:
        name = arguments[k][:-2] or arguments[k - 1]
        if re.fullmatch("-o|--(output|html|plot|csv|latex|page)", name):
            raise InvalidOption(f"{name} takes the name of a file, not -, which stands for standard input")
    if len(places) > 1:
        raise InvalidOption("- stands for standard input, which can be read only once; name a file in the other place")
    with tempfile.TemporaryDirectory(prefix="ik_stdin_") as folder:
        source = sys.stdin.buffer
        head = source.read(10_000)
        start = head.lstrip(b"\xef\xbb\xbf \t\r\n")
        if not start:
            raise InvalidOption("standard input is empty")
        named = re.search(rb"""<(?:robot|mujoco)\b[^>]*?\b(?:name|model)\s*=\s*["']([\w.-]+)["']""", start)
        kinds = {rb"\A<": ".urdf", rb"\APK": ".npz", rb"(?m)^\w+ *= ": ".toml", rb"\A[{[]": ".json"}
        kind = next((kind for mark, kind in kinds.items() if re.search(mark, start)), ".csv")
        if kind != ".npz" and b"\0" in head:
            raise InvalidOption("standard input is neither UTF-8 text nor an NPZ file")
        file = Path(folder) / ((named[1].decode() if named else "stdin") + kind)
        with file.open("wb") as written:
            written.write(head)
            if kind in (".csv", ".npz"):  # Files of these kinds hold many targets, so their size has no limit.
                shutil.copyfileobj(source, written)
            else:
                written.write(source.read(JSON_BYTES + 1 - len(head)))
        changed = [*arguments]
        changed[places[0]] = changed[places[0]][:-1] + str(file)
        yield changed


@contextmanager
def handling(numbers: Iterable[int], handler: Callable[..., Any]) -> Iterator[dict[int, Any]]:
    """Context manager in which `handler` handles these signals; it yields the earlier handlers by number, and restores them."""
    before = {number: signal.signal(number, handler) for number in numbers}
    try:
        yield before
    finally:
        for number, earlier in before.items():
            signal.signal(number, earlier if earlier is not None else signal.SIG_DFL)


@contextmanager
def stoppable(came: list[int]) -> Iterator[None]:
    """Context manager in which Ctrl-C and SIGTERM raise KeyboardInterrupt; the number of the signal is appended to `came`.

    If Python drops the exception, as in code called from C (numba's compiler, finalizers), it is raised again soon after. It is not
    raised during an import, because a library that tries to import another one takes any exception as "not installed".
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    process, show_dropped, waiting = os.getpid(), sys.unraisablehook, list[float]()

    def again(number: int) -> None:
        main = threading.main_thread().ident  # The signal is sent to the main thread, which may be blocked, to wake it.
        threading.Timer(RAISED_AGAIN, signal.pthread_kill, [main, number]).start()

    def stop(number: int, frame: FrameType | None) -> None:
        if os.getpid() != process:  # This is a forked worker process, which ends at once.
            os._exit(128 + number)
        if _importing(frame):
            waiting.append(time.monotonic())
            if waiting[-1] < waiting[0] + IMPORTING:
                again(number)
                return
        came.append(number)
        raise KeyboardInterrupt

    def dropped(what: Any) -> None:
        if came and issubclass(what.exc_type, KeyboardInterrupt):
            again(came[-1])
        else:
            show_dropped(what)

    # A shell may have set Ctrl-C to be ignored, as it does for commands in the background, and then it stays ignored.
    heard = [signal.SIGTERM]
    heard += [signal.SIGINT] if signal.getsignal(signal.SIGINT) is signal.default_int_handler else []
    with handling(heard, stop):
        sys.unraisablehook = dropped
        try:
            yield
        finally:
            sys.unraisablehook = show_dropped


def _importing(frame: FrameType | None) -> bool:
    """Return whether a stack frame, or one of its callers, is importing a module."""
    while frame is not None:
        if frame.f_code.co_filename == "<frozen importlib._bootstrap>":
            return True
        frame = frame.f_back
    return False


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Context manager that delays Ctrl-C and SIGTERM until the end of its block, so that files are written completely."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[Any] = []
    with handling((signal.SIGINT, signal.SIGTERM), lambda *signalled: came.append(signalled)) as before:
        yield
    for number, frame in came[:1]:
        handler = before[number]
        if callable(handler):
            handler(number, frame)  # pyright: ignore[reportCallIssue, reportOptionalCall]
        elif handler == signal.SIG_DFL:
            raise KeyboardInterrupt


class Output:
    """Standard output that may be a pipe: if its reader closes it early, the command continues and its exit code is unchanged.

    Characters the terminal's encoding lacks are escaped.
    """

    def __init__(self, stream: Any) -> None:
        """Wrap a stream."""
        self._stream = stream
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")

    def __getattr__(self, name: str) -> Any:
        """Return any other attribute of the stream."""
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write text, unless the reader has closed the pipe; return its length."""
        try:
            return self._stream.write(text)
        except BrokenPipeError:
            return self._drop(len(text))

    def flush(self) -> None:
        """Write out what is buffered, unless the reader has closed the pipe."""
        try:
            self._stream.flush()
        except BrokenPipeError:
            self._drop(0)

    def _drop(self, count: int) -> int:
        os.dup2(os.open(os.devnull, os.O_WRONLY), self._stream.fileno())
        return count
