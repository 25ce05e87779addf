"""Options of `ik solve` and their meaning: a target, a solver, the options of a call."""

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Annotated, Any

import typer

from ..errors import InvalidOption, InvalidTarget
from ..text import parameter, vector
from . import tip_texts
from .arguments import assignments, joint_vector, solver_named
from .obstacles import avoided

Xyz = Annotated[
    str | None,
    typer.Option("--xyz", metavar="X Y Z", help="Target tip position in the base frame [m]."),
]
Rpy = Annotated[
    str | None,
    typer.Option("--rpy", metavar="R P Y", help="Target roll, pitch, yaw [rad] (Rz Ry Rx)."),
]
Quat = Annotated[
    str | None,
    typer.Option("--quat-xyzw", metavar="X Y Z W", help="Target orientation as a quaternion, real part last."),
]
QuatWxyz = Annotated[
    str | None,
    typer.Option("--quat-wxyz", metavar="W X Y Z", help="Target orientation as a quaternion, real part first."),
]
Matrix = Annotated[
    str | None,
    typer.Option(
        "--matrix",
        metavar="M11 M12 ...",
        help="Target pose as the 12 or 16 numbers of its matrix, row by row; replaces --xyz.",
    ),
]
Targets = Annotated[
    list[str] | None,
    typer.Option(
        "--target",
        metavar="TIP:X,Y,Z[,...]",
        help="Target of one of several tips solved together; repeat for each; replaces --xyz. A position, or a pose when "
        "roll, pitch, yaw or a quaternion x y z w follow, or 12 or 16 numbers of a matrix. A tip without a target is free.",
    ),
]
Relative = Annotated[
    list[str] | None,
    typer.Option(
        "--relative",
        metavar="TIP:OTHER",
        help="Read the target of TIP in the moving frame of the tip OTHER; may be repeated.",
    ),
]
FromQ = Annotated[
    str | None,
    typer.Option(
        "--from-q",
        metavar="Q1 Q2 ...",
        help="Target where the tip, or every tip, stands at these joint values; replaces --xyz.",
    ),
]
SolverName = Annotated[
    str,
    typer.Option(
        "-s", "--solver", metavar="NAME", help="Solver; see ik solvers. auto chooses one for the robot and target."
    ),
]
Params = Annotated[
    list[str] | None,
    typer.Option("-p", "--param", metavar="NAME=VALUE", help="Set a parameter of the solver; may be repeated."),
]
Preset = Annotated[str | None, typer.Option(metavar="NAME", help="Published or tuned parameters, by name.")]
Start = Annotated[
    str | None,
    typer.Option("--q0", metavar="Q1 Q2 ...", help="Start configuration; default: chosen by the solver, or home."),
]
Tolerance = Annotated[
    float | None,
    typer.Option(metavar="TOL", help="Position [m] and orientation [rad] tolerance; default 1e-6."),
]
PositionTolerance = Annotated[float | None, typer.Option(metavar="M", help="Position tolerance [m].")]
OrientationTolerance = Annotated[float | None, typer.Option(metavar="RAD", help="Orientation tolerance [rad].")]
MaxIterations = Annotated[
    int | None,
    typer.Option(metavar="N", help="Maximum iterations per attempt; default: the solver's own."),
]
Restarts = Annotated[
    int | None,
    typer.Option(metavar="N", help="Additional attempts from other starts; default: the solver's own."),
]
Timeout = Annotated[
    float | None,
    typer.Option(metavar="S", help="Time for the solve [s]; unlike every other option not deterministic."),
]
Seed = Annotated[int, typer.Option(metavar="N", help="Seed of the random restarts.")]
Limits = Annotated[bool, typer.Option("--limits/--no-limits", help="Enforce joint limits.")]
ClampQ0 = Annotated[
    bool,
    typer.Option("--clamp-q0/--refuse-q0", help="Clamp a start outside the limits, or reject it."),
]

Direction = Annotated[
    list[str] | None,
    typer.Option(
        "--direction", metavar="[TIP:]X Y Z", help="Point --tip-axis in this direction; rotation about it is free."
    ),
]
TipAxis = Annotated[
    list[str] | None,
    typer.Option("--tip-axis", metavar="[TIP:]X Y Z", help="Axis of the tip for --direction; default z."),
]
Mask = Annotated[
    list[str] | None,
    typer.Option(
        "--mask",
        metavar="[TIP:]X Y Z RX RY RZ",
        help="Six error weights; 0 frees a coordinate. For all tips, or as TIP:... for one; may be repeated.",
    ),
]
Slack = Annotated[
    list[str] | None,
    typer.Option(
        "--slack",
        metavar="[TIP:]X Y Z RX RY RZ",
        help="Six half widths within which the error is zero [m, rad; degrees with --deg]; inf frees a coordinate.",
    ),
]
FreeTurn = Annotated[
    list[str] | None,
    typer.Option(
        "--free-turn",
        metavar="[TIP:]X Y Z",
        help="Axis of the tip about which it may rotate freely: x, y, z or a vector.",
    ),
]
Frame = Annotated[
    list[str] | None,
    typer.Option("--frame", metavar="[TIP:]base|tip|target", help="Axes of --mask and --slack."),
]
Weights = Annotated[
    str | None,
    typer.Option("--joint-weights", metavar="W1 W2 ...", help="How freely each joint moves; 0 holds it."),
]
Closest = Annotated[
    str | None,
    typer.Option("--closest", metavar="Q1 Q2 ...", help="Return the solution nearest this configuration."),
]
Follow = Annotated[
    float | None,
    typer.Option(
        "--follow",
        metavar="RAD",
        help="Single attempt that moves no joint further than this from --q0 (prismatic joints: times reach).",
    ),
]
Objective = Annotated[
    str | None,
    typer.Option(
        "--objective",
        metavar="NAME",
        help="Secondary objective for redundant robots: mid-range, reference (near q0) or manipulability.",
    ),
]
Margin = Annotated[
    float | None,
    typer.Option(metavar="M", help="Distance [m] below which parts count as touching. Implies --avoid-collisions."),
]
AvoidCollisions = Annotated[
    bool,
    typer.Option("--avoid-collisions", help="Accept only solutions without self-collision."),
]
Obstacles = Annotated[
    list[str] | None,
    typer.Option(
        "--obstacle",
        metavar="KIND:...",
        help="Obstacle to avoid, in the base frame; may be repeated. box:x,y,z,sx,sy,sz sphere:x,y,z,r "
        "cylinder:x,y,z,r,length; boxes and cylinders also with ,roll,pitch,yaw. Implies --avoid-collisions.",
    ),
]
File = Annotated[
    Path | None,
    typer.Option(
        "--targets",
        metavar="FILE",
        rich_help_panel="Many targets",
        help="Many targets from a file, solved on all cores and written to -o; replaces --xyz. CSV with the header "
        "x,y,z or x,y,z,qx,qy,qz,qw or x,y,z,roll,pitch,yaw; NPZ with targets, or xyz and quat_xyzw (quat_wxyz). Several tips: "
        "CSV columns TIP.x, TIP.y, ..., or NPZ with an array TIP (N, 4, 4) or (N, 3) for each, or targets (N, tips, 4, 4).",
    ),
]
Threads = Annotated[
    int | None,
    typer.Option(metavar="N", help="With --targets: threads; default: all cores."),
]
Chain = Annotated[bool, typer.Option("--chain", hidden=True)]
Cluster = Annotated[
    str | None,
    typer.Option(metavar="ADDRESS", help="With --targets: use the Dask scheduler at this address."),
]
Explain = Annotated[
    bool,
    typer.Option(
        "--explain",
        help="Show how the answer comes about: D-H table, closed form with the numbers put in, branches, iterations.",
        rich_help_panel="Output",
    ),
]
All = Annotated[
    bool,
    typer.Option("--all", help="List every distinct solution within limits, nearest to q0 (or home) first."),
]
AXES = ("x", "y", "z")
PASSED_ON = (
    "tolerance",
    "position_tolerance",
    "orientation_tolerance",
    "max_iterations",
    "restarts",
    "timeout",
    "seed",
    "objective",
    "follow",
)  # options of the command that are passed on unchanged


def refuse_contradictions(line: SimpleNamespace) -> None:
    """Raise InvalidOption for options of `ik solve` that do not go together, or a target that is missing."""
    posed = is_posed(line) or line.direction is not None or line.tip_axis is not None
    drawn = line.html is not None or line.live
    if line.chain:
        raise InvalidOption("--chain has been removed; `ik path` (ik.solve_path) follows poses in one joint motion")
    if line.file is None and (line.threads is not None or line.cluster is not None):
        raise InvalidOption("--threads and --cluster go with --targets FILE")
    if line.from_q is not None and (line.targets or line.file is not None or posed):
        raise InvalidOption("--from-q gives the whole target; omit --xyz, --target and the other pose options")
    if line.file is not None:
        if line.targets or line.every or posed:
            raise InvalidOption(
                "--targets FILE replaces --xyz and the other pose options, --target and --all; omit them"
            )
        if line.plot is not None or drawn:
            raise InvalidOption(
                "--plot, --html and --view show a single solve and cannot be combined with --targets FILE"
            )
        if line.closest is not None and line.q0 is not None:
            raise InvalidOption("give --closest or --q0, not both: the search starts there")
    elif line.targets:
        if is_posed(line):
            raise InvalidOption("--target gives tip and pose together; omit --xyz and the rotation options")
    elif line.relative:
        raise InvalidOption("--relative is for several tips, with a --target for each")
    elif line.xyz is None and line.matrix is None and line.from_q is None:
        raise InvalidOption(
            "Missing option '--xyz' (or '--matrix', '--from-q', '--targets FILE' for many, '--target' for several tips)"
        )
    if line.csv_file is not None and not line.every:
        raise InvalidOption("--csv writes the solutions of --all; -o writes a single one, and those of --targets")
    if line.explain and (line.every or line.file is not None):
        raise InvalidOption("--explain explains a single solve and cannot be combined with --all or --targets FILE")
    if line.every:
        if line.plot is not None:
            raise InvalidOption("--plot draws a single solve and cannot be combined with --all")
        if line.closest is not None:
            raise InvalidOption("--all lists the solutions nearest to --q0 first; give that instead of --closest")


def read_options(line: SimpleNamespace, arm: Any) -> dict[str, Any]:
    """Options of the call, only those given; among them q0 and, of a file of targets, closest as a word. Raises InvalidOption."""
    given = {name: getattr(line, name) for name in PASSED_ON}
    if line.joint_weights is not None:
        given["joint_weights"] = tuple(vector(line.joint_weights, "--joint-weights", arm.n))
    options = {name: value for name, value in given.items() if value is not None} | read_counting(line)
    options |= {"limits": line.limits, "q0_outside": "clamp" if line.clamp_q0 else "refuse"}
    options["q0"] = None if line.q0 is None else joint_vector(arm, line.q0, "--q0", line.deg)
    options |= avoided(arm, line)
    if line.closest is not None:
        nearest = joint_vector(arm, line.closest, "--closest", line.deg)
        options |= {"closest": nearest} if line.file is None else {"q0": nearest, "closest": True}
    return options


def read_counting(line: SimpleNamespace) -> dict[str, Any]:
    """Options that select which part of a target counts, only those given. Raises InvalidOption."""
    given = {
        "mask": tip_texts.vectors(line.mask, "--mask", 6),
        "slack": tip_texts.values(line.slack, "--slack", lambda text: _slack(text, line.deg)),
        "free_turn": tip_texts.values(line.free_turn, "--free-turn", _axis),
        "frame": tip_texts.values(line.frame, "--frame", str),
        "relative_to": tip_texts.relations(line.relative),
    }
    return {name: value for name, value in given.items() if value is not None}


def _axis(text: str) -> tuple[float, ...]:
    """An axis of the tip: x, y, z or three numbers."""
    name = text.strip().lower()
    if name in AXES:
        return tuple(float(name == axis) for axis in AXES)
    return tuple(vector(text, "--free-turn", 3))


def _slack(text: str, deg: bool) -> tuple[float, ...]:
    """Half widths [m, rad], the last three given in degrees when `deg`."""
    widths = vector(text, "--slack", 6)
    return (*widths[:3], *(math.radians(x) if deg else x for x in widths[3:]))


def is_posed(line: SimpleNamespace) -> bool:
    """Whether any of the options that describe a single target is given."""
    return any(given is not None for given in (line.xyz, line.matrix, line.rpy, line.quat_xyzw, line.quat_wxyz))


def make_target(line: SimpleNamespace, direction: list[str] | None = None, tip_axis: list[str] | None = None) -> Any:
    """Target of the pose options: (3,) when the orientation is free, (4, 4), or an AxisTarget; rpy in degrees when `line.deg`."""
    from ..robot.pose import pose

    if line.matrix is not None:
        if any(
            given is not None for given in (line.xyz, line.rpy, line.quat_xyzw, line.quat_wxyz, direction, tip_axis)
        ):
            raise InvalidOption("--matrix gives the whole pose; omit --xyz, the rotation options and --direction")
        x = vector(line.matrix, "--matrix")
        if len(x) not in tip_texts.MATRIX:
            raise InvalidTarget(f"--matrix takes 12 or 16 numbers, row by row; got {len(x)}")
        return tip_texts.matrix(x)
    angles = vector(line.rpy, "--rpy", 3) if line.rpy is not None else None
    if angles is not None and line.deg:
        angles = [math.radians(x) for x in angles]
    xyzw = vector(line.quat_xyzw, "--quat-xyzw", 4) if line.quat_xyzw is not None else None
    wxyz = vector(line.quat_wxyz, "--quat-wxyz", 4) if line.quat_wxyz is not None else None
    towards, axis = tip_texts.directions(direction, tip_axis)
    for option, one in (("--direction", towards), ("--tip-axis", axis)):
        if isinstance(one, dict):
            raise InvalidOption(f"{option} TIP:... goes with --target; for --xyz leave out the tip")
    return pose(
        vector(line.xyz or "", "--xyz", 3),
        rpy=angles,
        quat_xyzw=xyzw,
        quat_wxyz=wxyz,
        axis=axis or tip_texts.Z,
        direction=towards,
    )


def read_target(line: SimpleNamespace) -> Any:
    """Target of the options of `ik solve`: targets by tip, one target (see `make_target`), or None.

    None is for a file of targets, and for --from-q, which needs the robot (see `reached`).
    """
    if line.targets:
        return tip_texts.targets(line.targets, line.deg, line.direction, line.tip_axis)
    if line.file is not None or line.from_q is not None:
        return None
    return make_target(line, line.direction, line.tip_axis)


def reached(line: SimpleNamespace, arm: Any) -> Any:
    """Target of --from-q: the pose (4, 4) of the tip there, of several tips a dict by tip."""
    at = arm.fk(joint_vector(arm, line.from_q, "--from-q", line.deg))
    return arm.for_tips({tip: T.homogeneous for tip, T in arm.each_tip(at).items()})


def choose_solver(name: str, params: list[str] | None, preset: str | None) -> Any:
    """Solver name, or a rule with its preset and parameters applied. Raises UnknownSolver, InvalidOption."""
    from ..solvers.presets import from_preset
    from ..solvers.registry import GENERAL, find_row, make_rule

    if name == "auto" and not params and not preset:
        return name
    asked = solver_named(name)
    row = find_row(GENERAL if asked == "auto" else asked)
    values = {key: parameter(key, text) for key, text in assignments(params, "-p").items()}
    if preset is None:
        return make_rule(row, values) if values else asked
    return from_preset(row, preset, values)
