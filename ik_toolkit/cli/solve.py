"""`ik solve`: joint values that bring the tip to a target."""

import math
from contextlib import nullcontext
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import typer

from . import first_use
from . import solve_options as asked
from .arguments import Base, Deg, Json, Lock, Out, PackageDir, RobotArg, Tip, load_robot
from .output import facts, notice, number, show, table, unit, write_json
from .pictures import Chart, Html, Live, draw

if TYPE_CHECKING:
    from ..solvers.result import Result


def register(app: typer.Typer) -> None:
    """Add the commands of this module."""
    app.command()(solve)


def solve(
    robot: RobotArg,
    xyz: asked.Xyz = None,
    rpy: asked.Rpy = None,
    quat_xyzw: asked.Quat = None,
    targets: asked.Targets = None,
    solver: asked.SolverName = "auto",
    param: asked.Params = None,
    preset: asked.Preset = None,
    q0: asked.Start = None,
    tolerance: asked.Tolerance = None,
    position_tolerance: asked.PositionTolerance = None,
    orientation_tolerance: asked.OrientationTolerance = None,
    max_iterations: asked.MaxIterations = None,
    restarts: asked.Restarts = None,
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
    every: asked.All = False,
    file: asked.File = None,
    threads: asked.Threads = None,
    chain: asked.Chain = False,
    cluster: asked.Cluster = None,
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
    line = SimpleNamespace(**locals())  # the command line, for what reads parts of it
    asked.refuse_contradictions(line)
    target: Any = None if file else asked.make_targets(targets, robot) if targets else asked.read_target(line)
    method = asked.choose_solver(solver, param, preset)
    arm = load_robot(robot, list(target) if targets else tip, base, lock, package_dir, deg)
    options = asked.read_options(line, arm)
    start = options.pop("q0")
    if file is not None:
        from .targets import solve_file

        solve_file(
            arm, file, output, method, start, options,
            threads=threads, chain=chain, cluster=cluster, deg=deg, as_json=as_json,
        )  # fmt: skip
    elif every:
        found = _solve_all(arm, target, method, start, options, deg, as_json, output)
        draw(arm, list(found), target, None, html, live)
    else:
        _solve_one(arm, target, method, start, options, line)


def _solve_one(arm: Any, target: Any, method: Any, start: Any, options: dict[str, Any], line: SimpleNamespace) -> None:
    """Solve, print, draw; exit code 1 when it is not solved."""
    from ..solvers.solve import solve as solve_one

    # At a solved start: compiles or loads, so that the time shown below is the solve's own.
    at_home = arm.fk(arm.home)
    position_only = getattr(target, "ndim", 2) == 1
    shown = line.plot is not None or line.html is not None or line.live
    first = {key: value for key, value in options.items() if key != "closest"}
    with nullcontext() if shown else first_use.instead_of_compiling():
        near = arm.home if line.follow else None
        solve_one(arm, at_home.translation if position_only else at_home, method, q0=near, **first)
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
    if not line.targets:
        payload["tip"] = arm.tip
    write_json(payload, line.as_json, line.output)
    if not line.as_json:
        _show(result, line.deg)
    if result.notice:
        notice(result.notice)
    if not result.success:
        notice(f"not solved, {result.status.name}: {result.message}")
    if shown:
        result = solve_one(arm, target, method, q0=start, history=True, **options)
        draw(arm, result, target, line.plot, line.html, line.live)
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


def _show(result: "Result", deg: bool) -> None:
    robot = result.robot
    limited = set(result.limited_joints)
    joints = table("<joint", ">value", "<unit", ">lower", ">upper", "")
    for i, (name, kind) in enumerate(zip(robot.joint_names, robot.joint_kinds, strict=True)):
        value, lower, upper = (number(float(x[i]), kind, deg) for x in (result.q, robot.lower, robot.upper))
        joints.add_row(name, value, unit(kind, deg), lower, upper, "at limit" if name in limited else "")
    show(joints)
    each = {}
    if len(robot.tips) > 1:
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
