"""What the commands share: robot options, vectors of numbers, units, tables, JSON, and notices on stderr."""

import functools
import importlib.util
import json
import logging
import math
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
import typer.core

from ..errors import FrameNotFound, InvalidConfiguration, InvalidOption, InvalidTarget, MissingExtra, clean
from ..files import PARTIAL, write_whole

if TYPE_CHECKING:
    import numpy as np
    from rich.table import Table
    from rich.text import Text

    from ..robot.joints import Joints

# Options that take several numbers: `--q 0.1 -0.2`, `--q 0.1,-0.2` and `--q "0.1 -0.2"` mean the same.
VECTOR_OPTIONS = frozenset(
    "--q --q0 --xyz --rpy --quat-xyzw --center --axis --start --end --direction --tip-axis --mask --joint-weights "
    "--closest".split()
)

PLOTS = (".png", ".pdf", ".svg")
READ = ("file",)  # parameters of commands that are paths and are read; all others are written


def writes(*suffixes: str) -> Callable[[Path | None], Path | None]:
    """Callback of an option that names a file to write: what can be known to go wrong is said before the work starts."""

    def check(file: Path | None) -> Path | None:
        if file is None:
            return None
        if suffixes and file.suffix.lower() not in suffixes:
            raise InvalidOption(f"'{file}' must end in {' or '.join(suffixes)}")
        if suffixes == PLOTS and importlib.util.find_spec("matplotlib") is None:
            raise MissingExtra("matplotlib", "plots")
        if file.is_dir():
            raise InvalidOption(f"'{file}' is a folder, and a file is to be written there")
        if not file.parent.is_dir():
            raise InvalidOption(f"cannot write '{file}': there is no folder '{file.parent}'")
        for place in (file, Path(os.path.realpath(file)).parent):  # it is written beside and renamed
            if place.exists() and not os.access(place, os.W_OK):
                raise InvalidOption(f"cannot write '{file}': no permission")
        return file

    return check


class Command(typer.core.TyperCommand):
    """A command that refuses to write over a file it reads, under whatever name, or two results into one file."""

    def invoke(self, ctx: Any) -> Any:
        """Run the command. Raises InvalidOption."""
        outputs = [value for name, value in ctx.params.items() if isinstance(value, Path) and name not in READ]
        for k, output in enumerate(outputs):
            if any(_same(output, other) for other in outputs[:k]):
                raise InvalidOption(f"two results cannot be written to one file, '{output}'")
        for value in ctx.params.values():
            for word in value if isinstance(value, list | tuple) else [value]:
                if not isinstance(word, str | Path) or any(word is output for output in outputs):
                    continue
                given = str(word).rpartition("=")[2] if not os.path.isfile(word) else word  # SOLVER=PRESET
                for output in outputs:
                    if os.path.isfile(given) and _same(output, given):
                        raise InvalidOption(f"'{output}' would overwrite '{given}', which is read; choose another name")
        return super().invoke(ctx)


def _same(one: str | Path, other: str | Path) -> bool:
    """Whether two names are of one file, there or not: by links too, or by case where that does not count."""
    if os.path.exists(one) and os.path.exists(other):
        return os.path.samefile(one, other)
    return os.path.realpath(one) == os.path.realpath(other)


RobotArg = Annotated[str, typer.Argument(metavar="ROBOT", help="Name (see ik robots) or path of a URDF file.")]
Tip = Annotated[
    str | None,
    typer.Option(metavar="FRAME", help="Tip frame; needed when there are several ends.", rich_help_panel="Robot"),
]
Base = Annotated[
    str | None,
    typer.Option(
        metavar="FRAME", help="Base frame of targets and poses; default: the root link.", rich_help_panel="Robot"
    ),
]
Lock = Annotated[
    list[str] | None,
    typer.Option(metavar="JOINT=VALUE", help="Hold a joint at a value; may be repeated.", rich_help_panel="Robot"),
]
PackageDir = Annotated[
    list[str] | None,
    typer.Option(metavar="DIR", help="Folder in which package:// names are looked up.", rich_help_panel="Robot"),
]
Deg = Annotated[
    bool,
    typer.Option(
        "--deg", help="Turning joints and rpy in degrees; sliding joints stay in metres.", rich_help_panel="Output"
    ),
]
Json = Annotated[
    bool,
    typer.Option("--json", help="Print one JSON object, always in metres and radians.", rich_help_panel="Output"),
]
Out = Annotated[
    Path | None,
    typer.Option(
        "-o",
        "--output",
        metavar="FILE",
        help="Also write the JSON object to a file.",
        rich_help_panel="Output",
        callback=writes(),
    ),
]


# ------------------------------------------------------------------------------------------------------------ numbers
def numbers(text: str) -> list[float] | None:
    """Read the numbers of '1 2', '1,2' or '1'; None when there is none or anything else."""
    try:
        return [float(part) for part in text.replace(",", " ").split()] or None
    except ValueError:
        return None


def join_vectors(argv: Sequence[str]) -> list[str]:
    """Join the numbers that follow a vector option into one argument (the parser takes one, and reads -1 as an option)."""
    joined: list[str] = []
    collecting = False
    for position, token in enumerate(argv):
        if token == "--":  # noqa: S105  a word of the command line
            return [*joined, *argv[position:]]
        if collecting and numbers(token):
            joined[-1] += ("" if joined[-1].endswith("=") else ",") + token
            continue
        after = argv[position + 1] if position + 1 < len(argv) else ""
        collecting = token in VECTOR_OPTIONS and numbers(after) is not None
        joined.append(f"{token}=" if collecting else token)
    return joined


def vector(text: str, option: str, size: int | None = None) -> list[float]:
    """Read a vector option's numbers; InvalidOption or InvalidTarget when they are not numbers or not `size` many."""
    values = numbers(text)
    if values is None:
        raise InvalidOption(f"{option} takes numbers, not '{text}'")
    if size is not None and len(values) != size:
        raise InvalidTarget(f"{option} takes {size} numbers; got {len(values)}")
    return values


def joint_vector(robot: "Joints", text: str, option: str, deg: bool) -> "np.ndarray":
    """Joint values (n,) [rad or m] of a vector option; turning joints are read in degrees when `deg`."""
    values = vector(text, option)
    if len(values) != robot.n:
        raise InvalidConfiguration(
            f"{option} takes {robot.n} values, one per joint ({', '.join(robot.joint_names)}); got {len(values)}"
        )
    pairs = zip(values, robot.joint_kinds, strict=True)
    return robot.check_q([math.radians(x) if deg and turns(kind) else x for x, kind in pairs], option)


def assignments(pairs: Sequence[str] | None, option: str) -> dict[str, str]:
    """Split KEY=VALUE arguments; InvalidOption when one has no '='."""
    split = {}
    for pair in pairs or ():
        key, equals, value = pair.partition("=")
        if not (key and equals and value):
            raise InvalidOption(f"{option} takes NAME=VALUE, not '{pair}'")
        split[key.strip()] = value.strip()
    return split


def turns(kind: str) -> bool:
    """Whether a joint kind is measured as an angle."""
    return kind != "prismatic"


def number(value: float, kind: str, deg: bool) -> str:
    """Joint value (given in rad or m) for a table; its unit is `unit(kind, deg)`."""
    if not math.isfinite(value):
        return "none"
    degrees = deg and turns(kind)
    return fixed(math.degrees(value) if degrees else value, 4 if degrees else 6)


def fixed(value: float, digits: int) -> str:
    """Write a number with this many decimals, and zero without a sign."""
    return f"{round(value, digits) + 0.0:.{digits}f}"


def unit(kind: str, deg: bool) -> str:
    """Unit of a joint kind's value."""
    return "m" if not turns(kind) else "deg" if deg else "rad"


# -------------------------------------------------------------------------------------------------------------- robots
def load_robot(
    source: str,
    tip: str | list[str] | None = None,
    base: str | None = None,
    lock: Sequence[str] | None = None,
    package_dir: Sequence[str] | None = None,
    deg: bool = False,
) -> Any:
    """Load the Robot (for a list of tips: the Tree) that the shared options describe.

    Values of --lock are degrees for turning joints when `deg`.
    """
    from ..robot.library import find
    from ..robot.robot import Robot
    from ..robot.tree import Tree

    tips = find(source).tips
    if tip is None and len(tips) > 1:
        raise FrameNotFound(f"robot '{source}' has {len(tips)} tips; choose one with --tip: {', '.join(tips)}")
    robot: Robot | Tree
    if isinstance(tip, list):
        robot = Tree.load(source, tips=tip, base=base, package_dirs=package_dir or ())
    else:
        robot = Robot.load(source, tip=tip, base=base, package_dirs=package_dir or ())
    if not lock:
        return robot
    values = {}
    for joint, text in assignments(lock, "--lock").items():
        value = numbers(text)
        if value is None or len(value) != 1:
            raise InvalidOption(f"--lock {joint} takes one number, not '{text}'")
        values[joint] = math.radians(value[0]) if deg and not slides(robot, joint) else value[0]
    return robot.locked(values)


def slides(robot: "Joints", joint: str) -> bool:
    """Whether a joint of the model (on the path or not) is prismatic."""
    model = robot.model
    return model.existJointName(joint) and model.joints[model.getJointId(joint)].shortname().startswith("JointModelP")


# -------------------------------------------------------------------------------------------------------------- output
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
def on_sigterm(came: list[bool]) -> Iterator[None]:
    """Let SIGTERM end what is inside as Ctrl-C does, and note in `came` that it was the former."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    process = os.getpid()

    def stop(*_: Any) -> None:
        if os.getpid() != process:  # a worker forked from here
            os._exit(143)
        came.append(True)
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before if before is not None else signal.SIG_DFL)


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Ctrl-C and SIGTERM wait for the end of what is inside: a file written by half is lost."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[Any] = []
    before = {
        number: signal.signal(number, lambda number, frame: came.append((number, frame)))
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler if handler is not None else signal.SIG_DFL)
    for number, frame in came[:1]:
        handler = before[number]
        if callable(handler):
            handler(number, frame)  # pyright: ignore[reportCallIssue, reportOptionalCall]
        elif handler == signal.SIG_DFL:
            raise KeyboardInterrupt


def partial(output: Path) -> Path:
    """Name of a result that is not whole, beside the one asked for."""
    return output.with_name(output.name + PARTIAL)


class Output:
    """Standard output for people who pipe it: a reader that leaves early does not end the command or change its exit code.

    Characters the terminal's encoding lacks are escaped.
    """

    def __init__(self, stream: Any) -> None:
        """Wrap a stream."""
        self._stream = stream
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")

    def __getattr__(self, name: str) -> Any:
        """Everything else is the stream's."""
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write, unless nobody reads any more."""
        try:
            return self._stream.write(text)
        except BrokenPipeError:
            return self._drop(len(text))

    def flush(self) -> None:
        """Flush, unless nobody reads any more."""
        try:
            self._stream.flush()
        except BrokenPipeError:
            self._drop(0)

    def _drop(self, count: int) -> int:
        os.dup2(os.open(os.devnull, os.O_WRONLY), self._stream.fileno())
        return count


def notice(text: str) -> None:
    """Print one line of prose on stderr, if anybody is there to read it."""
    try:
        print(clean(text), file=sys.stderr, flush=True)
    except (OSError, ValueError, AttributeError):  # a closed stderr (Python sets None), a reader that left, a full disk
        pass


@functools.cache
def notice_once(text: str) -> None:
    """Print one line of prose on stderr, the first time only."""
    notice(text)


class LogNotices(logging.Handler):
    """Shows what the package logs on stderr; that it compiles is said once, whatever the number of kernels."""

    def emit(self, record: logging.LogRecord) -> None:
        """Print one record."""
        if record.name == "ik_toolkit.compile":
            notice_once(f"compiling the solver ({record.args[1]}) ...")  # type: ignore[index]
        else:
            notice(f"{record.levelname.lower()}: {record.getMessage()}")


def plain(value: Any) -> Any:
    """Turn arrays, paths and enums into what JSON has; numbers that are not finite become null."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | set):
        return [plain(item) for item in value]
    if hasattr(value, "tolist"):  # numpy array or scalar
        return plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, str | int | bool) or value is None:
        return value
    return str(value)


def write_json(payload: dict[str, Any], as_json: bool, output: Path | None = None) -> None:
    """Print the object on stdout when `as_json`, and write it to `output` when that is given."""
    if output is not None:
        write_whole(output, json.dumps(plain(payload), indent=2, allow_nan=False) + "\n")
        notice(f"wrote {output}")
    if as_json:
        print(json.dumps(plain(payload), allow_nan=False))


def table(*columns: str) -> "Table":
    """Empty table in the house style; columns named '<...' or '>...' never wrap, the latter are right-aligned."""
    from rich import box
    from rich.table import Table

    made = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for column in columns:
        right, whole = column.startswith(">"), column.startswith(("<", ">"))
        made.add_column(column.lstrip("<>"), justify="right" if right else "left", no_wrap=whole, overflow="fold")
    return made


def show(*things: Any) -> None:
    """Print tables and lines on stdout: as wide as the terminal, 100 columns where there is none."""
    from rich.cells import cell_len
    from rich.console import Console
    from rich.segment import Segment, Segments

    width = None if sys.stdout.isatty() or "COLUMNS" in os.environ else 100
    console = Console(width=width, highlight=False, markup=False)
    room = console.width
    for thing in things:
        least = 0  # in a narrow terminal a long line is better than numbers cut short
        for column in getattr(thing, "columns", ()):
            lines = [line for cell in (column.header, *column.cells) for line in str(cell).split("\n")]
            least += 3 + (max(map(cell_len, lines)) if column.no_wrap else 12)
        console.width = max(room, least)
        drawn = console.render(console.render_str(clean(thing)) if isinstance(thing, str) else thing)
        console.print(Segments(Segment(clean(part.text), part.style, part.control) for part in drawn), end="")


def heading(text: str) -> "Text":
    """Bold line above a table or a list."""
    from rich.text import Text

    return Text(text, style="bold")


def facts(rows: dict[str, Any]) -> "Table":
    """Two-column list of names and values, without lines; rows whose value is None are left out."""
    from rich.table import Table

    made = Table.grid(padding=(0, 2))
    made.add_column(style="dim", no_wrap=True)
    made.add_column(overflow="fold")
    for name, value in rows.items():
        if value is not None:
            made.add_row(name, str(value))
    return made
