"""The command `ik`: modules of commands (see command.py). Heavy imports happen inside commands."""

import functools
import importlib
import logging
import signal
import sys
from collections.abc import Sequence
from contextlib import redirect_stdout
from typing import Annotated, Any

import typer

from .. import __version__
from ..errors import IKError, MissingExtra
from . import first_use
from .command import add_commands
from .output import LogNotices, notice
from .streams import Output, open_standard_streams, stoppable, with_input
from .usage import Group, UsageError

# Every module of commands, in the order in which the help lists them.
MODULES = "robots solve path track gains reproduce solvers bench tune workspace reach place calibrate files view doctor".split()
NOT_SOLVED, BAD_INPUT, MISSING_EXTRA, BUG, INTERRUPTED, TERMINATED = 1, 2, 3, 70, 130, 143


def _version(value: bool) -> None:
    if value:
        print(f"ik_toolkit {__version__}")
        raise typer.Exit


def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
    debug: Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")] = False,
) -> None:
    """Inverse kinematics for any robot description.

    Metres and radians unless --deg. Results go to stdout, notices to stderr; --json prints one object.

    Exit codes: 0 solved or done, 1 not solved or invalid, 2 invalid input, 3 missing extra, 130 Ctrl-C, 143 SIGTERM.
    Files are written whole or not at all; a long command that is stopped keeps its finished part as FILE.partial.
    """


def application() -> typer.Typer:
    """Return the Typer program `ik` with all of its commands."""
    app = typer.Typer(name="ik", cls=Group, pretty_exceptions_enable=False, rich_markup_mode=None)
    app.callback()(_options)
    for module in MODULES:
        add_commands(app, importlib.import_module(f".{module}", __name__))
    return app


@functools.cache  # Building the command line takes 30 ms, so a process that calls `main` repeatedly does it once.
def _command() -> Any:
    """Return the command line as click runs it."""
    return typer.main.get_command(application())


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit code. Invalid input becomes one sentence on stderr, never a traceback."""
    open_standard_streams()
    arguments = [*(sys.argv[1:] if argv is None else argv)]
    debug = "--debug" in arguments
    arguments = [argument for argument in arguments if argument != "--debug"]
    shown = LogNotices("" if "--deg" in arguments else " Then add --deg.")
    shown.addFilter(lambda _: not first_use.said_before())
    logging.getLogger("ik_toolkit.compile").setLevel(logging.INFO)
    logging.getLogger("ik_toolkit").addHandler(shown)
    came: list[int] = []  # The numbers of the signals (SIGINT, SIGTERM) that have arrived to end the command.
    if argv is None:
        first_use.allow()
    try:
        with redirect_stdout(Output(sys.stdout)), stoppable(came), with_input(arguments) as arguments:
            try:
                code = _command().main(args=arguments or ["--help"], prog_name="ik", standalone_mode=False) or 0
                sys.stdout.flush()
            except first_use.CompileNeeded as needed:
                return first_use.again(arguments, needed.folder, came)
        return _stopped(came) if code == INTERRUPTED else code
    except (KeyboardInterrupt, typer.Abort):
        return _stopped(came)
    except Exception as error:
        if came:  # After Ctrl-C any error is a consequence: Python may drop the KeyboardInterrupt and continue.
            return _stopped(came)
        if debug:
            raise
        text, code = _explain(error)
        notice(f"ik: {text}")
        return code
    finally:
        logging.getLogger("ik_toolkit").removeHandler(shown)


def _stopped(came: list[int]) -> int:
    terminated = signal.SIGTERM in came
    notice("ik: terminated" if terminated else "ik: interrupted")
    return TERMINATED if terminated else INTERRUPTED


def _explain(error: Exception) -> tuple[str, int]:
    """Return a sentence about an error, and the exit code for it."""
    if isinstance(error, MissingExtra):
        return str(error), MISSING_EXTRA
    if isinstance(error, IKError):
        return str(error), BAD_INPUT
    if isinstance(error, UsageError):
        context = getattr(error, "ctx", None)
        command = context.command_path if context else "ik"
        option = getattr(error, "option_name", None)
        # If click finds no similar option, one with the same words in another order (--limit-speed, --speed-limit) may be meant.
        if context and option and not getattr(error, "possibilities", True):
            names = [name for parameter in context.command.params for name in parameter.opts]
            error.possibilities = [one for one in names if sorted(one.split("-")) == sorted(option.split("-"))]  # type: ignore[attr-defined]
        message = error.format_message().rstrip(".")  # type: ignore[attr-defined]
        return f"{message}{'' if message.endswith('?') else '.'} See {command} --help", BAD_INPUT
    if isinstance(error, OSError):
        said = error.strerror or str(error) or type(error).__name__
        return f"{said}: {error.filename}" if error.filename else said, BAD_INPUT
    if isinstance(error, MemoryError):
        return f"not enough memory{f': {error}' if str(error) else ''}", BAD_INPUT
    return (
        f"unexpected {type(error).__name__}: {str(error).partition(chr(10))[0]} (a bug of ik_toolkit; --debug shows the traceback)",
        BUG,
    )
