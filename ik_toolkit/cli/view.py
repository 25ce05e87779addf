"""`ik view`: a robot, a configuration or a solve in 3-D, in the browser or as one HTML file."""

from pathlib import Path
from types import SimpleNamespace
from typing import Annotated, Any

import typer

from ..errors import InvalidOption
from . import tip_texts
from .arguments import (
    Base,
    BaseRpy,
    BaseXyz,
    Deg,
    Group,
    Lock,
    PackageDir,
    RobotArg,
    SrdfFile,
    Tips,
    XacroArg,
    joint_vector,
    load_robot,
    writes,
)
from .output import notice
from .pictures import Html, present, wait, written
from .solve_options import Matrix, Relative, Targets, is_posed, make_target

Q = Annotated[str | None, typer.Option("--q", metavar="Q1 Q2 ...", help="Joint values to show; default: home.")]
Xyz = Annotated[str | None, typer.Option(metavar="X Y Z", help="Solve for this position [m] and show the iterations.")]
Rpy = Annotated[str | None, typer.Option(metavar="R P Y", help="With --xyz: roll, pitch, yaw [rad].")]
Quat = Annotated[str | None, typer.Option(metavar="X Y Z W", help="With --xyz: quaternion.")]
QuatWxyz = Annotated[str | None, typer.Option(metavar="W X Y Z", help="With --xyz: quaternion, the real part first.")]
SolverName = Annotated[str, typer.Option("-s", "--solver", metavar="NAME", help="Solver for --xyz; see ik solvers.")]
Ghosts = Annotated[bool, typer.Option("--all", help="Show every solution found as a ghost.")]
Start = Annotated[str | None, typer.Option("--q0", metavar="Q1 Q2 ...", help="Where the solve starts; default: home.")]
MotionFile = Annotated[
    Path | None,
    typer.Option(
        "--motion",
        metavar="FILE",
        help="Show a motion from a file: of ik path a path (.csv, .npz, .json) or a trajectory (.csv, .json), "
        "of ik track a run (.csv, .npz, .json).",
    ),
]
Follow = Annotated[
    bool, typer.Option("--follow", help="Show a target to drag, which the robot follows (extra 'panel').")
]
Page = Annotated[
    Path | None,
    typer.Option(
        "--page",
        metavar="FILE",
        help="Write a live page: the robot with its solvers and a target to drag in one .html file, which needs neither "
        "Python nor a network.",
        callback=writes(".html", ".htm"),
    ),
]
Port = Annotated[int, typer.Option(metavar="N", help="Port on 127.0.0.1; default: a free one.")]
Open = Annotated[bool, typer.Option("--open/--no-open", help="Open the address in a browser.")]


def register(app: typer.Typer) -> None:
    """Add the command of this module."""
    app.command()(view)


def view(
    robot: RobotArg,
    q: Q = None,
    xyz: Xyz = None,
    rpy: Rpy = None,
    quat_xyzw: Quat = None,
    quat_wxyz: QuatWxyz = None,
    matrix: Matrix = None,
    targets: Targets = None,
    relative: Relative = None,
    solver: SolverName = "auto",
    every: Ghosts = False,
    q0: Start = None,
    motion: MotionFile = None,
    follow: Follow = False,
    html: Html = None,
    page: Page = None,
    port: Port = 0,
    browse: Open = True,
    tip: Tips = None,
    base: Base = None,
    base_xyz: BaseXyz = None,
    base_rpy: BaseRpy = None,
    lock: Lock = None,
    package_dir: PackageDir = None,
    xacro_arg: XacroArg = None,
    srdf: SrdfFile = None,
    group: Group = None,
    deg: Deg = False,
) -> None:
    """Show a robot in 3-D: at home, at --q, along --motion, or solving for --xyz or --target (with a time slider).

    Serves on 127.0.0.1 until Ctrl-C, or writes one HTML file that needs no network. A robot with several tips is shown
    whole when --tip is left out. With --follow the page has a target to drag, and the arm goes after it with the steps of
    the tracker, at the edge of its reach to the closest pose; with --page that page is a file, and its solvers run in the
    browser. Exit code 1 when the solve asked for did not succeed (it is shown all the same).
    """
    line = SimpleNamespace(**locals())
    solving = xyz is not None or matrix is not None or bool(targets)
    _refuse_contradictions(line, solving)
    shown = {"--html": html, "--q": q, "--motion": motion, "--xyz and --target": solving}
    if follow:
        read = {"--page": page, "--base": base, "--lock": lock, "--package-dir": package_dir, "--xacro-arg": xacro_arg}
        _alone("--follow", read | {"--srdf": srdf, "--group": group} | shown)
        _follow(robot, tip, port, browse)
        return
    if page is not None:
        _alone("--page", shown)

    from ..show.scene import view as make

    target: Any = None
    if solving:
        target = tip_texts.targets(targets, deg) if targets else make_target(line)
    tips = tip_texts.choose_tips(robot, tip, target if targets else None, relative, is_posed(line), group)
    arm = load_robot(robot, tips, base, lock, package_dir, deg, xacro_arg, base_xyz, base_rpy, srdf, group)
    if page is not None:
        written(make(arm).page(page))
        return
    what, solved = arm.home, True
    if motion is not None:
        from ..show.animation import motion_from_file

        what = motion_from_file(arm, motion)
    elif q is not None:
        what = joint_vector(arm, q, "--q", deg)
    elif solving:
        start = None if q0 is None else joint_vector(arm, q0, "--q0", deg)
        related = tip_texts.relations(relative)
        what, solved = _solve(arm, target, solver, start, every, {"relative_to": related} if related else {})
        at = what[0] if isinstance(what, list) else what.q
        target = tip_texts.in_base(target, arm.fk(at), related)
    present(make(arm, what, target=target), html, port, browse)
    if not solved:
        raise typer.Exit(1)


def _refuse_contradictions(line: SimpleNamespace, solving: bool) -> None:
    """Raise InvalidOption for options of `ik view` that do not go together."""
    if line.q is not None and (solving or line.every):
        raise InvalidOption("--q shows a configuration, --xyz and --target solve for one: give one of them")
    if line.motion is not None and (solving or line.every or line.q is not None):
        raise InvalidOption("--motion shows the motion of a file; omit --q, --xyz and --target")
    if is_posed(line) and line.xyz is None and line.matrix is None:
        raise InvalidOption("--rpy and the quaternions belong to --xyz")
    if not solving and (line.every or line.q0 is not None):
        raise InvalidOption("--q0 and --all belong to --xyz or --target")
    if is_posed(line) and line.targets:
        raise InvalidOption("--target gives tip and pose together; omit --xyz and the rotation options")
    if line.relative and not line.targets:
        raise InvalidOption("--relative is for several tips, with a --target for each")
    if not 0 <= line.port < 65536:
        raise InvalidOption(f"--port must be between 0 and 65535, not {line.port}")


def _alone(option: str, others: dict[str, Any]) -> None:
    """Raise InvalidOption when an option for a draggable robot is combined with options that set what is shown."""
    given = [name for name, value in others.items() if value]
    if given:
        raise InvalidOption(f"{option} goes without {' and '.join(given)}")


def _follow(robot: str, tips: Any, port: int, browse: bool) -> None:
    """Serve a page with a target to drag until Ctrl-C."""
    from ..show.panel.follower import Follower
    from ..show.panel.panel import Panel

    served = Panel(robot, tips, port=port, desk=Follower)
    wait(f"the robot is at {served.url}", served.url, browse)
    served.close()


def _solve(arm: Any, target: Any, solver: str, start: Any, every: bool, options: dict[str, Any]) -> tuple[Any, bool]:
    """Result with history, or the list of solutions; and whether any was found."""
    from ..solvers.solve import solve as solve_one
    from ..solvers.solve_all import solve_all

    if every:
        found = solve_all(arm, target, solver, start, **options)
        if len(found):
            notice(found.message)
            return list(found), True
    result = solve_one(arm, target, solver, q0=start, history=True, **options)
    notice(f"{result.status.name}: {result.message}")
    return result, result.success
