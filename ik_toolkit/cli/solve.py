"""`ik solve`: joint values that bring the tip to a target."""

import json
import math
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..errors import InvalidOption, InvalidTarget
from . import first_use
from .common import (
    Base,
    Deg,
    Json,
    Lock,
    Out,
    PackageDir,
    RobotArg,
    Tip,
    assignments,
    facts,
    joint_vector,
    load_robot,
    notice,
    number,
    numbers,
    show,
    table,
    unit,
    vector,
    write_json,
)
from .view import Chart, Html, Live, draw

if TYPE_CHECKING:
    from ..solvers.result import Result

Xyz = Annotated[
    str | None, typer.Option("--xyz", metavar="X Y Z", help="Where the tip shall be, in the base frame [m].")
]
Rpy = Annotated[str | None, typer.Option("--rpy", metavar="R P Y", help="Roll, pitch, yaw of the tip [rad]: Rz Ry Rx.")]
Quat = Annotated[
    str | None, typer.Option("--quat-xyzw", metavar="X Y Z W", help="Rotation of the tip as a quaternion.")
]
Targets = Annotated[
    list[str] | None,
    typer.Option(
        "--target",
        metavar="TIP:X,Y,Z[,QX,QY,QZ,QW]",
        help="Instead of --xyz: target of one of several tips, solved together; repeat for each.",
    ),
]
SolverName = Annotated[str, typer.Option("-s", "--solver", metavar="NAME", help="See ik solvers; auto picks for you.")]
Params = Annotated[
    list[str] | None,
    typer.Option("-p", "--param", metavar="NAME=VALUE", help="Parameter of the solver; may be repeated."),
]
Preset = Annotated[str | None, typer.Option(metavar="NAME", help="Published or tuned parameters, by name.")]
Start = Annotated[str | None, typer.Option("--q0", metavar="Q1 Q2 ...", help="Where to start; default: home.")]
Tolerance = Annotated[float | None, typer.Option(metavar="TOL", help="Both tolerances, in m and rad; default 1e-6.")]
PositionTolerance = Annotated[float | None, typer.Option(metavar="M", help="Position tolerance [m].")]
OrientationTolerance = Annotated[float | None, typer.Option(metavar="RAD", help="Orientation tolerance [rad].")]
MaxIterations = Annotated[int | None, typer.Option(metavar="N", help="Steps a descent; default: the solver's own.")]
Restarts = Annotated[
    int | None, typer.Option(metavar="N", help="Further descents from other starts; default: the solver's own.")
]
Seed = Annotated[int, typer.Option(metavar="N", help="Seed of the random restarts.")]
Limits = Annotated[bool, typer.Option("--limits/--no-limits", help="Keep the joints inside their limits.")]
ClampQ0 = Annotated[
    bool, typer.Option("--clamp-q0/--refuse-q0", help="What to do with a start outside the limits: clamp it, or stop.")
]

Direction = Annotated[
    str | None,
    typer.Option("--direction", metavar="X Y Z", help="Point --tip-axis along this; the turn about it stays free."),
]
TipAxis = Annotated[
    str | None, typer.Option("--tip-axis", metavar="X Y Z", help="Axis of the tip for --direction; default its z.")
]
Mask = Annotated[
    str | None,
    typer.Option("--mask", metavar="X Y Z RX RY RZ", help="Six weights of what counts; 0 leaves it free."),
]
MaskFrame = Annotated[str, typer.Option("--mask-frame", metavar="base|tip", help="Axes the mask is meant in.")]
Weights = Annotated[
    str | None, typer.Option("--joint-weights", metavar="W1 W2 ...", help="How freely each joint moves; 0: not at all.")
]
Closest = Annotated[
    str | None, typer.Option("--closest", metavar="Q1 Q2 ...", help="Of several solutions the one nearest this.")
]
Follow = Annotated[
    float | None,
    typer.Option(
        "--follow",
        metavar="RAD",
        help="One attempt that moves no joint further than this from --q0 (slides: times reach).",
    ),
]
Objective = Annotated[
    str | None,
    typer.Option(
        "--objective", metavar="NAME", help="For redundant arms: mid-range, reference (near q0) or manipulability."
    ),
]
AvoidCollisions = Annotated[
    bool, typer.Option("--avoid-collisions", help="Only solutions in which the robot's links do not touch.")
]
Obstacles = Annotated[
    list[str] | None,
    typer.Option(
        "--obstacle",
        metavar="KIND:...",
        help="Shape not to touch, in the base frame; may be repeated. box:x,y,z,sx,sy,sz sphere:x,y,z,r "
        "cylinder:x,y,z,r,length; boxes and cylinders also with ,roll,pitch,yaw. Implies --avoid-collisions.",
    ),
]
File = Annotated[
    Path | None,
    typer.Option(
        "--targets",
        metavar="FILE",
        help="Instead of --xyz: many targets, solved on all cores; -o names the solutions' file. CSV with the header "
        "x,y,z or x,y,z,qx,qy,qz,qw or x,y,z,roll,pitch,yaw, or NPZ with targets, or xyz and quat_xyzw.",
    ),
]
Threads = Annotated[int | None, typer.Option(metavar="N", help="With --targets: threads; default: all cores.")]
Chain = Annotated[
    bool, typer.Option("--chain", help="With --targets: waypoints in order, each solved from the answer before it.")
]
Cluster = Annotated[
    str | None, typer.Option(metavar="ADDRESS", help="With --targets: use the Dask scheduler at this address.")
]
All = Annotated[
    bool, typer.Option("--all", help="List every distinct solution inside the limits, nearest to q0 (or home) first.")
]


def register(app: typer.Typer) -> None:
    """Add the commands of this module."""
    app.command()(solve)


def solve(
    robot: RobotArg,
    xyz: Xyz = None,
    rpy: Rpy = None,
    quat_xyzw: Quat = None,
    targets: Targets = None,
    solver: SolverName = "auto",
    param: Params = None,
    preset: Preset = None,
    q0: Start = None,
    tolerance: Tolerance = None,
    position_tolerance: PositionTolerance = None,
    orientation_tolerance: OrientationTolerance = None,
    max_iterations: MaxIterations = None,
    restarts: Restarts = None,
    seed: Seed = 0,
    limits: Limits = True,
    clamp_q0: ClampQ0 = True,
    direction: Direction = None,
    tip_axis: TipAxis = None,
    mask: Mask = None,
    mask_frame: MaskFrame = "base",
    joint_weights: Weights = None,
    closest: Closest = None,
    follow: Follow = None,
    objective: Objective = None,
    avoid_collisions: AvoidCollisions = False,
    obstacle: Obstacles = None,
    every: All = False,
    file: File = None,
    threads: Threads = None,
    chain: Chain = False,
    cluster: Cluster = None,
    tip: Tip = None,
    base: Base = None,
    lock: Lock = None,
    package_dir: PackageDir = None,
    deg: Deg = False,
    as_json: Json = False,
    output: Out = None,
    plot: Chart = None,
    html: Html = None,
    live: Live = False,
) -> None:
    """Find joint values that bring the tip to a position, or a pose when --rpy or --quat-xyzw is given.

    Several tips of one robot are solved together, shared joints included, with one --target for each.

    With --targets many are solved at once and written to the file that -o names: CSV, NPZ or Parquet by its ending.

    --plot draws the way the error went; --view and --html show the robot in 3-D, the solve as an animation.

    Exit code 0 when solved, 1 when not: the status says how it ended, and the sentence on stderr what to try.
    """
    if file is None and (threads is not None or chain or cluster is not None):
        raise InvalidOption("--threads, --chain and --cluster go with --targets FILE")
    target: Any = None
    if file is not None:
        if targets or every or any(x is not None for x in (xyz, rpy, quat_xyzw, direction, tip_axis)):
            raise InvalidOption("--targets FILE says all targets; leave out --xyz and its kin, --target and --all")
        if plot is not None or html is not None or live:
            raise InvalidOption("--plot, --html and --view show one solve, not the many of --targets FILE")
    elif targets:
        if any(x is not None for x in (xyz, rpy, quat_xyzw, direction, tip_axis, tip)):
            raise InvalidOption("--target says tip and pose together; leave out --xyz, its rotation options and --tip")
        if every:
            raise InvalidOption("--all is for one tip; give one target with --xyz and --tip")
        target = make_targets(targets, robot)
    elif xyz is None:
        raise InvalidOption("Missing option '--xyz' (or '--targets FILE' for many, '--target' for several tips)")
    else:
        target = make_target(xyz, rpy, quat_xyzw, deg, direction, tip_axis)
    method = choose_solver(solver, param, preset)
    arm = load_robot(robot, list(target) if targets else tip, base, lock, package_dir, deg)

    from ..solvers.solve import solve as solve_one

    given = {
        "tolerance": tolerance,
        "position_tolerance": position_tolerance,
        "orientation_tolerance": orientation_tolerance,
        "max_iterations": max_iterations,
        "restarts": restarts,
        "mask": None if mask is None else tuple(vector(mask, "--mask", 6)),
        "mask_frame": None if mask is None else mask_frame,
        "joint_weights": None if joint_weights is None else tuple(vector(joint_weights, "--joint-weights", arm.n)),
        "objective": objective,
        "follow": follow,
    }
    options: dict[str, Any] = {key: value for key, value in given.items() if value is not None}
    options |= {"seed": seed, "limits": limits, "q0_outside": "clamp" if clamp_q0 else "refuse"}
    start = None if q0 is None else joint_vector(arm, q0, "--q0", deg)
    if avoid_collisions or obstacle:
        from .obstacles import collision_model

        options["avoid_collisions"] = collision_model(arm, obstacle or ())
    if file is not None:
        from .targets import solve_file

        if closest is not None:
            if start is not None:
                raise InvalidOption("give --closest or --q0, not both: the search starts there")
            start, options["closest"] = joint_vector(arm, closest, "--closest", deg), True
        solve_file(
            arm, file, output, method, start, options,
            threads=threads, chain=chain, cluster=cluster, deg=deg, as_json=as_json,
        )  # fmt: skip
        return
    if every:
        if plot is not None:
            raise InvalidOption("--plot draws one solve, and --all asks for many")
        if closest is not None:
            raise InvalidOption("--all lists the solutions nearest to --q0 first; give that instead of --closest")
        found = _solve_all(arm, target, method, start, options, deg, as_json, output)
        draw(arm, list(found), target, None, html, live)
        return
    # At a solved start: compiles or loads, so that the time shown below is the solve's own.
    at_home = arm.fk(arm.home)
    position_only = getattr(target, "ndim", 2) == 1
    shown = plot is not None or html is not None or live
    with nullcontext() if shown else first_use.instead_of_compiling():
        near = arm.home if follow else None
        solve_one(arm, at_home.translation if position_only else at_home, method, q0=near, **options)
    if closest is not None:
        options["closest"] = joint_vector(arm, closest, "--closest", deg)
    options["max_evaluations"] = first_use.budget()
    result = solve_one(arm, target, method, q0=start, **options)
    if first_use.budget() and not result.success and result.status.name != "UNREACHABLE":
        raise typer.Exit(first_use.NOT_ANSWERED)
    payload = {
        "kernel": first_use.kernel(),
        **result.to_dict(),
        "base": arm.base,
        "target": getattr(target, "T_base_tip", target),
    }
    if not targets:
        payload["tip"] = arm.tip
    write_json(payload, as_json, output)
    if not as_json:
        _show(result, deg)
    if result.notice:
        notice(result.notice)
    if not result.success:
        notice(f"not solved, {result.status.name}: {result.message}")
    if shown:
        draw(arm, solve_one(arm, target, method, q0=start, history=True, **options), target, plot, html, live)
    if not result.success:
        raise typer.Exit(1)


def _solve_all(
    arm: Any, target: Any, method: Any, start: Any, options: dict[str, Any], deg: bool, as_json: bool, output: Any
) -> Any:
    """Print all solutions and return them; exit code 1 when there is none."""
    from ..solvers.solve_all import solve_all

    found = solve_all(arm, target, method, start, **options)
    where = {"base": arm.base, "tip": arm.tip, "target": getattr(target, "T_base_tip", target)}
    write_json({**found.to_dict(), **where}, as_json, output)
    if not as_json and len(found):
        made = table(">#", *(">" + name.replace("_", "_\n") for name in arm.joint_names), ">distance")
        units = (unit(kind, deg) for kind in arm.joint_kinds)
        made.add_row("", *units, "", style="dim")
        for k, (q, distance) in enumerate(zip(found, found.distance, strict=True), 1):
            values = (number(float(x), kind, deg) for x, kind in zip(q, arm.joint_kinds, strict=True))
            made.add_row(str(k), *values, f"{distance:.3g}")
        show(made)
    if not as_json:
        complete = "these are all" if found.complete else "there may be more"
        show(facts({"solutions": f"{len(found)}, {complete}; solver {found.solver}", "found": found.message}))
    if not len(found):
        notice(f"no solution: {found.message}")
        raise typer.Exit(1)
    return found


def make_target(
    xyz: str,
    rpy: str | None,
    quat_xyzw: str | None,
    deg: bool,
    direction: str | None = None,
    tip_axis: str | None = None,
) -> Any:
    """Target of the pose options: (3,) when the orientation is free, (4, 4), or an AxisTarget; rpy in degrees when `deg`."""
    from ..robot.pose import pose

    angles = vector(rpy, "--rpy", 3) if rpy is not None else None
    if angles is not None and deg:
        angles = [math.radians(x) for x in angles]
    quat = vector(quat_xyzw, "--quat-xyzw", 4) if quat_xyzw is not None else None
    axis = (0.0, 0.0, 1.0) if tip_axis is None else vector(tip_axis, "--tip-axis", 3)
    if tip_axis is not None and direction is None:
        raise InvalidOption("--tip-axis says which axis --direction turns; give --direction too")
    towards = None if direction is None else vector(direction, "--direction", 3)
    return pose(vector(xyz, "--xyz", 3), rpy=angles, quat_xyzw=quat, axis=axis, direction=towards)


def make_targets(texts: list[str], robot: str) -> dict[str, Any]:
    """Targets by tip of TIP:X,Y,Z[,QX,QY,QZ,QW]; tips in the order the robot lists them, so that q has one order."""
    from ..robot.library import find
    from ..robot.pose import pose

    made = {}
    for text in texts:
        tip, colon, rest = text.rpartition(":")
        values = numbers(rest) or []
        if not (tip and colon and len(values) in (3, 7)):
            raise InvalidTarget(f"--target takes TIP:X,Y,Z or TIP:X,Y,Z,QX,QY,QZ,QW, not '{text}'")
        if tip in made:
            raise InvalidTarget(f"--target gives '{tip}' twice")
        made[tip] = pose(values[:3], quat_xyzw=values[3:] or None)
    listed = [tip for tip in find(robot).tips if tip in made]
    return {tip: made[tip] for tip in dict.fromkeys([*listed, *made])}


def choose_solver(name: str, params: list[str] | None, preset: str | None) -> Any:
    """Solver name, or a rule with its preset and parameters applied. Raises UnknownSolver, InvalidOption."""
    from ..solvers.registry import find_row, make_rule

    if name == "auto" and not params and not preset:
        return name
    row = find_row("lm" if name == "auto" else name)
    values = {key: _value(text) for key, text in assignments(params, "-p").items()}
    if preset is None:
        return make_rule(row, values) if values else name
    cls = row.load()
    if not hasattr(cls, "preset"):
        raise InvalidOption(f"solver '{row.name}' has no presets")
    make_rule(row, values)  # names the parameter that does not exist
    return cls.preset(preset)._replace(**values)


def _value(text: str) -> Any:
    """Read a number, a list (JSON) or a word."""
    try:
        return float(text) if not text.lstrip("+-").isdigit() else int(text)
    except ValueError:
        pass
    try:
        return json.loads(text)
    except ValueError:
        return text


def _show(result: "Result", deg: bool) -> None:
    from ..solvers.tree import TreeResult

    robot = result.robot
    limited = set(result.limited_joints)
    joints = table("<joint", ">value", "<unit", ">lower", ">upper", "")
    for i, (name, kind) in enumerate(zip(robot.joint_names, robot.joint_kinds, strict=True)):
        value, lower, upper = (number(float(x[i]), kind, deg) for x in (result.q, robot.lower, robot.upper))
        joints.add_row(name, value, unit(kind, deg), lower, upper, "at limit" if name in limited else "")
    show(joints)
    each = {}
    if isinstance(result, TreeResult):
        angles = result.orientation_errors
        each = {f"at {tip}": f"{_length(x)}, {_angle(angles[tip])}" for tip, x in result.position_errors.items()}
    show(
        facts(
            {
                "status": f"{result.status.name}, solver {result.solver}",
                "position error": _length(result.position_error),
                "orientation error": _angle(result.orientation_error),
                **each,
                "iterations": f"{result.iterations}, restarts {result.restarts}, FK evaluations {result.fk_evaluations}",
                "time": _time(result.elapsed),
            }
        )
    )


def _angle(value: float | None) -> str:
    return "free" if value is None else f"{value:.3g} rad ({math.degrees(value):.3g} deg)"


def _length(value: float) -> str:
    return f"{value:.3g} m" if value < 1e-6 or value >= 1 else f"{1000 * value:.4g} mm"


def _time(seconds: float) -> str:
    return (
        f"{1e6 * seconds:.0f} us"
        if seconds < 1e-3
        else f"{1e3 * seconds:.3g} ms"
        if seconds < 1
        else f"{seconds:.3g} s"
    )
