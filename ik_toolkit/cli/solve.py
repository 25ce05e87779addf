"""`ik solve`: joint values that bring the tip to a target."""

import math
from contextlib import nullcontext
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import typer

from ..files import write_table
from . import first_use
from . import solve_options as asked
from .arguments import (
    Base,
    BaseRpy,
    BaseXyz,
    Csv,
    Deg,
    Group,
    Json,
    Limit,
    Lock,
    Out,
    PackageDir,
    RobotArg,
    SrdfFile,
    Tips,
    XacroArg,
    load_robot,
    narrowed,
)
from .output import facts, notice, number, show, table, unit, write_json
from .pictures import Chart, Html, Live, draw
from .tip_texts import choose_tips, in_base

if TYPE_CHECKING:
    from ..solvers.result import Result

ABREAST = 4  # solutions of several tips side by side that fit into 80 columns
ACROSS = 6  # joints whose values fit side by side into 80 columns


def register(app: typer.Typer) -> None:
    """Add the commands of this module."""
    app.command()(solve)


def solve(
    robot: RobotArg,
    xyz: asked.Xyz = None,
    rpy: asked.Rpy = None,
    quat_xyzw: asked.Quat = None,
    quat_wxyz: asked.QuatWxyz = None,
    matrix: asked.Matrix = None,
    from_q: asked.FromQ = None,
    targets: asked.Targets = None,
    relative: asked.Relative = None,
    solver: asked.SolverName = "auto",
    param: asked.Params = None,
    preset: asked.Preset = None,
    q0: asked.Start = None,
    tolerance: asked.Tolerance = None,
    position_tolerance: asked.PositionTolerance = None,
    orientation_tolerance: asked.OrientationTolerance = None,
    max_iterations: asked.MaxIterations = None,
    restarts: asked.Restarts = None,
    timeout: asked.Timeout = None,
    seed: asked.Seed = 0,
    limits: asked.Limits = True,
    clamp_q0: asked.ClampQ0 = True,
    direction: asked.Direction = None,
    tip_axis: asked.TipAxis = None,
    mask: asked.Mask = None,
    slack: asked.Slack = None,
    free_turn: asked.FreeTurn = None,
    frame: asked.Frame = None,
    joint_weights: asked.Weights = None,
    closest: asked.Closest = None,
    follow: asked.Follow = None,
    objective: asked.Objective = None,
    avoid_collisions: asked.AvoidCollisions = False,
    obstacle: asked.Obstacles = None,
    margin: asked.Margin = None,
    every: asked.All = False,
    explain: asked.Explain = False,
    file: asked.File = None,
    threads: asked.Threads = None,
    chain: asked.Chain = False,
    cluster: asked.Cluster = None,
    tip: Tips = None,
    base: Base = None,
    base_xyz: BaseXyz = None,
    base_rpy: BaseRpy = None,
    lock: Lock = None,
    limit: Limit = None,
    package_dir: PackageDir = None,
    xacro_arg: XacroArg = None,
    srdf: SrdfFile = None,
    group: Group = None,
    deg: Deg = False,
    as_json: Json = False,
    output: Out = None,
    csv_file: Csv = None,
    plot: Chart = None,
    html: Html = None,
    live: Live = False,
) -> None:
    """Find joint values that bring the tip to a position, or to a pose when --rpy, a quaternion or --matrix is given.

    Several tips of one robot are solved together, shared joints included, with a --target for each. They are those of
    --tip, or the robot's own; one without a target is free. Masks, directions and frames may be given by tip.

    --targets solves many targets at once and writes them to the file named by -o: CSV, NPZ or Parquet.

    --explain adds the D-H table, the closed form with the numbers put in and every branch, or the iterations.

    --plot draws the error per iteration; --view and --html show the robot in 3-D, with the solve as an animation.

    Exit code 0 when solved, otherwise 1: the status says how it ended, and a message on stderr says what to try.
    """
    line = SimpleNamespace(**locals())  # the command line, for what reads parts of it
    asked.refuse_contradictions(line)
    target = asked.read_target(line)
    method = asked.choose_solver(solver, param, preset)
    tips = choose_tips(robot, tip, target if targets else None, relative, asked.is_posed(line), group)
    arm = load_robot(robot, tips, base, lock, package_dir, deg, xacro_arg, base_xyz, base_rpy, srdf, group)
    arm = narrowed(arm, limit, deg, limits)
    target = target if from_q is None else asked.reached(line, arm)
    options = asked.read_options(line, arm)
    start = options.pop("q0")
    if file is not None:
        from .targets import solve_file

        asked_for = {"threads": threads, "cluster": cluster, "deg": deg, "as_json": as_json}
        solve_file(arm, file, output, method, start, options, **asked_for)
    elif every:
        _solve_all(arm, target, method, start, options, line)
    else:
        _solve_one(arm, target, method, start, options, line)


def _solve_one(arm: Any, target: Any, method: Any, start: Any, options: dict[str, Any], line: SimpleNamespace) -> None:
    """Solve, print, draw; exit code 1 when it is not solved."""
    from ..solvers.solve import solve as solve_one

    shown = line.plot is not None or line.html is not None or line.live
    first = {key: value for key, value in options.items() if key != "closest"}
    with nullcontext() if shown else first_use.instead_of_compiling():
        # At a solved start: compiles or loads, so that the time shown below is the solve's own.
        solve_one(arm, _at_home(arm, target, options), method, q0=arm.home if line.follow else None, **first)
    if first_use.budget():
        options |= {"max_evaluations": first_use.budget(), "timeout": None}
    result = solve_one(arm, target, method, q0=start, **options)
    if first_use.budget() and not result.success and result.status.name != "UNREACHABLE":
        raise typer.Exit(first_use.NOT_ANSWERED)
    explained = result.explain() if line.explain else None
    explanation = {} if explained is None else {"explanation": explained.to_dict()}
    write_json(
        {"kernel": first_use.kernel(), **result.to_dict(), **_asked(arm, target, options), **explanation},
        line.as_json,
        line.output,
    )
    if not line.as_json:
        _show(result, target, options, line.deg)
        if explained is not None:
            show(str(explained))
    if result.notice:
        notice(result.notice)
    if not result.success:
        notice(f"not solved, {result.status.name}: {result.message}")
    if shown:
        result = solve_one(arm, target, method, q0=start, history=True, **options)
        _draw(arm, result, result.q, target, options, line)
    if not result.success:
        raise typer.Exit(1)


def _at_home(arm: Any, target: Any, options: dict[str, Any]) -> Any:
    """A target of the same form as the given one that is met at home."""
    T = arm.each_tip(arm.fk(arm.home))
    relative = options.get("relative_to") or {}  # an unknown tip among them is refused by the solver
    made = arm.for_tips({tip: T[relative[tip]].actInv(T[tip]) if relative.get(tip) in T else T[tip] for tip in T})
    return made.translation if getattr(target, "ndim", 2) == 1 else made


def _asked(arm: Any, target: Any, options: dict[str, Any]) -> dict[str, Any]:
    """The request, for JSON."""
    plain = {tip: getattr(one, "T_base_tip", one) for tip, one in arm.each_tip(target).items()}
    relative = options.get("relative_to")
    more = {"relative_to": relative} if relative else {} if arm.by_tip else {"tip": arm.tip}
    return {"base": arm.base, "target": arm.for_tips(plain), **more}


def _draw(arm: Any, what: Any, q: Any, target: Any, options: dict[str, Any], line: SimpleNamespace) -> None:
    """Requested pictures, with the targets as they are when the robot is at q."""
    if line.plot is not None or line.html is not None or line.live:
        draw(arm, what, in_base(target, arm.fk(q), options.get("relative_to")), line.plot, line.html, line.live)


def _solve_all(arm: Any, target: Any, method: Any, start: Any, options: dict[str, Any], line: SimpleNamespace) -> None:
    """Print all solutions and draw them; exit code 1 when there is none."""
    from ..solvers.solve_all import solve_all

    found = solve_all(arm, target, method, start, **options)
    write_json({**found.to_dict(), **_asked(arm, target, options)}, line.as_json, line.output)
    if line.csv_file is not None:
        rows = ([*q.tolist(), float(distance)] for q, distance in zip(found, found.distance, strict=True))
        write_table(line.csv_file, [*arm.joint_names, "distance"], rows)
        notice(f"wrote {line.csv_file}")
    if not line.as_json:
        show(*_solutions(found, line.deg))
        complete = "these are all" if found.complete else "there may be more"
        show(facts({"solutions": f"{len(found)}, {complete}; solver {found.solver}", "found": found.message}))
    if not len(found):
        notice(f"no solution: {found.message}")
        raise typer.Exit(1)
    _draw(arm, list(found), found[0], target, options, line)


def _solutions(found: Any, deg: bool) -> list[Any]:
    """Tables of solutions: a row each if the joints fit as columns, otherwise a column each, a few per table."""
    arm, made = found.robot, []
    kinds = arm.joint_kinds
    in_rows = arm.n <= ACROSS
    if in_rows and len(found):
        made.append(table(">#", *(">" + name.replace("_", "_\n") for name in arm.joint_names), ">distance"))
        made[0].add_row("", *(unit(kind, deg) for kind in kinds), "", style="dim")
        for k, (q, distance) in enumerate(zip(found, found.distance, strict=True), 1):
            values = (number(float(x), kind, deg) for x, kind in zip(q, kinds, strict=True))
            made[0].add_row(str(k), *values, f"{distance:.3g}")
    for first in range(0, 0 if in_rows else len(found), ABREAST):
        rows = range(first, min(first + ABREAST, len(found)))
        made.append(table("<joint", "<unit", *(f">{k + 1}" for k in rows)))
        for i, (name, kind) in enumerate(zip(arm.joint_names, kinds, strict=True)):
            made[-1].add_row(name, unit(kind, deg), *(number(float(found.q[k, i]), kind, deg) for k in rows))
        made[-1].add_row("distance", "", *(f"{found.distance[k]:.3g}" for k in rows), style="dim")
    return made


def _show(result: "Result", target: Any, options: dict[str, Any], deg: bool) -> None:
    robot = result.robot
    limited = set(result.limited_joints)
    joints = table("<joint", ">value", "<unit", ">lower", ">upper", "")
    for i, (name, kind) in enumerate(zip(robot.joint_names, robot.joint_kinds, strict=True)):
        value, lower, upper = (number(float(x[i]), kind, deg) for x in (result.q, robot.lower, robot.upper))
        joints.add_row(name, value, unit(kind, deg), lower, upper, "at limit" if name in limited else "")
    show(joints)
    if len(robot.tips) > 1:
        relative = options.get("relative_to") or {}
        tips = table("<tip", "<target in", ">position\nerror", ">orientation\nerror")
        for tip, position in result.position_errors.items():
            angle = result.orientation_errors[tip]
            left = "free" if angle is None else f"{math.degrees(angle):.3g} deg" if deg else f"{angle:.3g} rad"
            given = (relative.get(tip, robot.base), _length(position), left)
            tips.add_row(tip, *(given if tip in target else ("no target", "free", "free")))
        show(tips)
    counts = f"{result.iterations}, restarts {result.restarts}, FK evaluations {result.fk_evaluations}"
    errors = {"position error": _length(result.position_error), "orientation error": _angle(result.orientation_error)}
    status = {"status": f"{result.status.name}, solver {result.solver}"}
    show(
        facts(
            {**status, **({} if len(robot.tips) > 1 else errors), "iterations": counts, "time": _time(result.elapsed)}
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
