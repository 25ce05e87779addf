"""Options and arguments the commands share: vectors of numbers, robots, files to write. They are read and refused here."""

import importlib.util
import math
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
import typer.core

from ..errors import FrameNotFound, IKError, InvalidConfiguration, InvalidOption, MissingExtra
from ..text import numbers, vector
from .output import turns
from .usage import UsageError, help_text, in_flags

if TYPE_CHECKING:
    import numpy as np

    from ..robot.joints import Joints

# Options that take several numbers: `--q 0.1 -0.2`, `--q 0.1,-0.2` and `--q "0.1 -0.2"` mean the same.
VECTOR_OPTIONS = frozenset(
    "--q --q0 --xyz --rpy --quat-xyzw --quat-wxyz --matrix --from-q --base-xyz --base-rpy --center --axis --start --end "
    "--direction --tip-axis --mask --slack --free-turn --joint-weights --closest --target --q-end --velocity --acceleration".split()
)

TIP = ("--tip", "--ee")  # two names of one option
PLOTS = (".png", ".pdf", ".svg")
READ = ("file", "poses", "motion")  # path parameters of commands that are read; all others are written


def writes(*suffixes: str) -> Callable[[Path | None], Path | None]:
    """Callback of an option that names a file to write: foreseeable mistakes are reported before the work starts."""

    def check(file: Path | None) -> Path | None:
        if file is None:
            return None
        if suffixes and file.suffix.lower() not in suffixes:
            raise InvalidOption(f"'{file}' must end in {' or '.join(suffixes)}")
        if suffixes == PLOTS and importlib.util.find_spec("matplotlib") is None:
            raise MissingExtra("matplotlib", "plots")
        if file.is_dir():
            raise InvalidOption(f"'{file}' is a folder, not a file")
        if not file.parent.is_dir():
            raise InvalidOption(f"cannot write '{file}': there is no folder '{file.parent}'")
        for place in (file, Path(os.path.realpath(file)).parent):  # it is written next to its place and renamed
            if place.exists() and not os.access(place, os.W_OK):
                raise InvalidOption(f"cannot write '{file}': no permission")
        return file

    return check


def solver_named(text: str) -> Any:
    """A solver's name unchanged, or the class of FILE.py:CLASS. Raises InvalidOption."""
    from ..solvers.registry import is_solver_file, solver_from_file

    return solver_from_file(text) if is_solver_file(text) else text


TARGET = ("xyz", "matrix")  # options that give a whole target
MANY = "for many targets of one tip use ik solve --targets FILE, or ik path --poses FILE for one motion through them"


class Command(typer.core.TyperCommand):
    """A command that refuses several tips where it takes one, an output that it also reads, and two outputs to one file."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Read the arguments. Raises InvalidOption."""
        given = {word.partition("=")[0] for word in args}
        if "--group" in given and given.intersection(TIP):
            raise InvalidOption(f"--group has tips of its own; leave out {' and '.join(given.intersection(TIP))}")
        tips = sum(word.partition("=")[0] in TIP for word in args)
        if tips > 1 and any(
            option.name == "tip" and not option.multiple for option in self.params
        ):  # the last would count
            raise InvalidOption(
                f"{ctx.command_path} takes one tip and {' or '.join(TIP)} names {tips}; choose one of them"
            )
        for option in self.params:
            if option.name in TARGET and sum(word.partition("=")[0] in option.opts for word in args) > 1:
                raise InvalidOption(f"{option.opts[0]} is given twice; {MANY}")
        try:
            return super().parse_args(ctx, args)
        except UsageError as error:
            error.ctx = ctx  # type: ignore[attr-defined]  # a missing value comes without: whose help to see
            raise

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Write the help."""
        formatter.write(help_text(self, ctx))

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
                        raise InvalidOption(
                            f"'{output}' would overwrite '{given}', which is an input; choose another name"
                        )
        try:
            return super().invoke(ctx)
        except IKError as error:
            error.args = (in_flags(str(error), self), *error.args[1:])
            raise


def _same(one: str | Path, other: str | Path) -> bool:
    """Whether two names mean one file, existing or not: also through links, or by case where case is ignored."""
    if os.path.exists(one) and os.path.exists(other):
        return os.path.samefile(one, other)
    return os.path.realpath(one) == os.path.realpath(other)


RobotArg = Annotated[
    str, typer.Argument(metavar="ROBOT", help="Robot name (see ik robots), or path of a URDF, xacro or MJCF file.")
]
Tip = Annotated[
    str | None,
    typer.Option(
        *TIP,
        metavar="FRAME",
        help="Tip: a frame, link or joint; default: guessed from its name and reported.",
        rich_help_panel="Robot",
    ),
]
Tips = Annotated[
    list[str] | None,
    typer.Option(
        *TIP,
        metavar="FRAME",
        help="Tip: a frame, link or joint; repeat to solve for several tips together.",
        rich_help_panel="Robot",
    ),
]
Base = Annotated[
    str | None,
    typer.Option(
        metavar="FRAME", help="Base frame of targets and poses; default: the root link.", rich_help_panel="Robot"
    ),
]
BaseXyz = Annotated[
    str | None,
    typer.Option(
        metavar="X Y Z",
        help="Where the robot's root stands in the world [m]; targets and poses are then given in the world.",
        rich_help_panel="Robot",
    ),
]
BaseRpy = Annotated[
    str | None,
    typer.Option(metavar="R P Y", help="How it stands there: roll, pitch, yaw [rad].", rich_help_panel="Robot"),
]
Lock = Annotated[
    list[str] | None,
    typer.Option(metavar="JOINT=VALUE", help="Hold a joint at a value; may be repeated.", rich_help_panel="Robot"),
]
Limit = Annotated[
    list[str] | None,
    typer.Option(
        "--limit",
        metavar="JOINT:LOWER:UPPER",
        help="Narrow the limits of a joint [rad, m; degrees with --deg]; an end left empty stays; may be repeated.",
        rich_help_panel="Robot",
    ),
]
PackageDir = Annotated[
    list[str] | None,
    typer.Option(metavar="DIR", help="Folder to search for package:// names.", rich_help_panel="Robot"),
]
XacroArg = Annotated[
    list[str] | None,
    typer.Option(
        metavar="NAME:=VALUE", help="Value of a xacro file's argument; may be repeated.", rich_help_panel="Robot"
    ),
]
SrdfFile = Annotated[
    str | None,
    typer.Option(
        "--srdf",
        metavar="FILE",
        help="SRDF of the robot; default: the one next to its file (see ik info).",
        rich_help_panel="Robot",
    ),
]
Group = Annotated[
    str | None,
    typer.Option(metavar="NAME", help="Group of the SRDF, which sets base and tips.", rich_help_panel="Robot"),
]
Deg = Annotated[
    bool,
    typer.Option("--deg", help="Angles in degrees; lengths stay in metres.", rich_help_panel="Output"),
]
UrdfOut = Annotated[
    Path | None,
    typer.Option(
        "-o", "--output", metavar="FILE", help="Write the URDF to a file instead of stdout.", callback=writes()
    ),
]
How = Annotated[str, typer.Option("--sample", metavar="joints|volume", help="Targets uniform in joints or in volume.")]
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

Csv = Annotated[
    Path | None,
    typer.Option(
        "--csv", metavar="FILE", help="Write the table to a .csv.", rich_help_panel="Output", callback=writes(".csv")
    ),
]


# ------------------------------------------------------------------------------------------------------------ numbers
def join_vectors(argv: Sequence[str]) -> list[str]:
    """Join the numbers that follow a vector option into one argument (the parser takes one, and reads -1 as an option)."""
    joined: list[str] = []
    collecting = False
    for position, token in enumerate(argv):
        if token == "--":  # noqa: S105  a word of the command line
            return [*joined, *argv[position:]]
        if collecting and joined[-1].endswith("="):  # the first of them, which may begin with TIP:
            joined[-1] += token
            continue
        if collecting and numbers(token):
            joined[-1] += f",{token}"
            continue
        after = argv[position + 1] if position + 1 < len(argv) else ""
        collecting = token in VECTOR_OPTIONS and numbers(after.rpartition(":")[2]) is not None
        joined.append(f"{token}=" if collecting else token)
    return joined


def joint_vector(robot: "Joints", text: str, option: str, deg: bool) -> "np.ndarray":
    """Joint values (n,) [rad or m] of a vector option, or of the configuration it names; revolute joints in degrees when `deg`."""
    name = text.strip()
    if name in robot.named or (
        name[:1].isalpha() and len(name.replace(",", " ").split()) == 1 and numbers(name) is None
    ):
        return robot.named[name]
    values = vector(text, option)
    if len(values) != robot.n:
        raise InvalidConfiguration(
            f"{option} takes {robot.n} values, one per joint ({', '.join(robot.joint_names)}); got {len(values)}"
        )
    pairs = zip(values, robot.joint_kinds, strict=True)
    return robot.check_q([math.radians(x) if deg and turns(kind) else x for x, kind in pairs], option)


def assignments(pairs: Sequence[str] | None, option: str, mark: str = "=") -> dict[str, str]:
    """Split NAME=VALUE arguments. Raises InvalidOption when one has no '=' (or `mark`)."""
    split = {}
    for pair in pairs or ():
        key, equals, value = pair.partition(mark)
        if not (key and equals and (value or mark == ":=")):  # xacro's prefixes and suffixes are often empty
            raise InvalidOption(f"{option} takes NAME{mark}VALUE, not '{pair}'")
        split[key.strip()] = value.strip()
    return split


# -------------------------------------------------------------------------------------------------------------- robots
def load_robot(
    source: str,
    tip: str | list[str] | None = None,
    base: str | None = None,
    lock: Sequence[str] | None = None,
    package_dir: Sequence[str] | None = None,
    deg: bool = False,
    xacro_arg: Sequence[str] | None = None,
    base_xyz: str | None = None,
    base_rpy: str | None = None,
    srdf: str | None = None,
    group: str | None = None,
) -> Any:
    """Load the Robot (for a list of tips, or a group with several: the Tree) that the shared options describe.

    Values of --lock are degrees for revolute joints when `deg`, and so is --base-rpy.
    """
    from ..robot.library import find
    from ..robot.robot import Robot
    from ..robot.tree import Tree

    options: dict[str, Any] = {"base": base, "package_dirs": package_dir or (), "srdf": srdf}
    options["xacro_args"] = assignments(xacro_arg, "--xacro-arg", ":=") or None
    if base_xyz is not None or base_rpy is not None:
        from ..robot.pose import pose

        angles = vector(base_rpy or "0 0 0", "--base-rpy", 3)
        place = vector(base_xyz or "0 0 0", "--base-xyz", 3)
        options["on_base"] = pose(place, rpy=[math.radians(x) for x in angles] if deg else angles)
    tips = find(source).tips
    if group is None and tip is None and len(tips) > 1:
        raise FrameNotFound(f"robot '{source}' has {len(tips)} tips; choose one with --tip: {', '.join(tips)}")
    robot: Robot | Tree
    if group is not None:
        whole = Tree.load(source, group=group, **options)
        robot = whole if isinstance(tip, list) or len(whole.tips) > 1 else whole.arms[0]
    elif isinstance(tip, list):
        robot = Tree.load(source, tips=tip, **options)
    else:
        try:
            robot = Robot.load(source, tip=tip, **options)
        except FrameNotFound as several:
            if not several.tips:
                raise
            ends = FrameNotFound(str(several).partition(", or solve")[0] + "; ik info --list-tips shows all")
            ends.tips = several.tips
            raise ends from None
    if not lock:
        return robot
    values = {}
    for joint, text in assignments(lock, "--lock").items():
        value = numbers(text)
        if value is None or len(value) != 1:
            raise InvalidOption(f"--lock {joint} takes one number, not '{text}'")
        values[joint] = math.radians(value[0]) if deg and not slides(robot, joint) else value[0]
    return robot.locked(values)


def narrowed(robot: Any, limit: Sequence[str] | None, deg: bool, limits: bool = True) -> Any:
    """The robot with the limits of --limit JOINT:LOWER:UPPER, which are degrees for revolute joints when `deg`."""
    if not limit:
        return robot
    if not limits:
        raise InvalidOption("--limit narrows limits that --no-limits leaves out; give one of them")
    ranges = {}
    for text in limit:
        joint, *ends = text.rsplit(":", 2)
        values: list[Any] = [numbers(end) or [] if end.strip() else [None] for end in ends]
        if len(ends) != 2 or any(len(value) != 1 for value in values):
            raise InvalidOption(f"--limit takes JOINT:LOWER:UPPER, two numbers or one of them, not '{text}'")
        if joint in ranges:
            raise InvalidOption(f"--limit names joint '{joint}' twice")
        degrees = deg and not slides(robot, joint)
        ranges[joint] = [math.radians(x) if degrees and x is not None else x for x, *_ in values]
    return robot.narrowed(ranges)


def one_or_several(tips: list[str] | None) -> str | list[str] | None:
    """What `load_robot` makes of a --tip that may be repeated: one is a Robot's, several are a Tree's."""
    return tips[0] if tips and len(tips) == 1 else tips or None


def slides(robot: "Joints", joint: str) -> bool:
    """Whether a joint of the model (on the path or not) is prismatic."""
    model = robot.model
    return model.existJointName(joint) and model.joints[model.getJointId(joint)].shortname().startswith("JointModelP")
