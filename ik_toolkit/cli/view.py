"""`ik view`: a robot, a configuration or a solve in 3-D, in the browser or as one HTML file."""

from typing import Annotated, Any

import typer

from ..errors import InvalidOption
from .arguments import Base, Deg, Lock, PackageDir, RobotArg, Tip, joint_vector, load_robot
from .output import notice
from .pictures import Html, present
from .solve_options import make_target

Q = Annotated[str | None, typer.Option("--q", metavar="Q1 Q2 ...", help="Joint values to show; default: home.")]
Xyz = Annotated[str | None, typer.Option(metavar="X Y Z", help="Solve for this position [m] and show how it went.")]
Rpy = Annotated[str | None, typer.Option(metavar="R P Y", help="With --xyz: roll, pitch, yaw [rad].")]
Quat = Annotated[str | None, typer.Option(metavar="X Y Z W", help="With --xyz: quaternion.")]
SolverName = Annotated[str, typer.Option("-s", "--solver", metavar="NAME", help="Solver for --xyz; see ik solvers.")]
Ghosts = Annotated[bool, typer.Option("--all", help="With --xyz: show every solution found as a ghost.")]
Start = Annotated[str | None, typer.Option("--q0", metavar="Q1 Q2 ...", help="Where the solve starts; default: home.")]
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
    solver: SolverName = "auto",
    every: Ghosts = False,
    q0: Start = None,
    html: Html = None,
    port: Port = 0,
    browse: Open = True,
    tip: Tip = None,
    base: Base = None,
    lock: Lock = None,
    package_dir: PackageDir = None,
    deg: Deg = False,
) -> None:
    """Show a robot in 3-D: at home, at --q, or solving for --xyz (an animation with a time slider).

    Serves on 127.0.0.1 until Ctrl-C, or writes one HTML file that needs no network. A robot with several tips is shown
    whole when --tip is left out. Exit code 1 when the solve asked for did not succeed (it is shown all the same).
    """
    if q is not None and (xyz is not None or every):
        raise InvalidOption("--q shows a configuration and --xyz solves for one: give one of them")
    if xyz is None and (rpy is not None or quat_xyzw is not None or every or q0 is not None):
        raise InvalidOption("--rpy, --quat-xyzw, --q0 and --all belong to --xyz")
    if not 0 <= port < 65536:
        raise InvalidOption(f"--port is between 0 and 65535, not {port}")

    from ..robot.library import find
    from ..show.scene import view as make

    tips = list(find(robot).tips)
    arm = load_robot(robot, tips if tip is None and len(tips) > 1 else tip, base, lock, package_dir, deg)
    target, what, solved = None, None, True
    if q is not None:
        what = joint_vector(arm, q, "--q", deg)
    elif xyz is not None:
        if len(tips) > 1 and tip is None:
            raise InvalidOption(f"choose the tip that --xyz is meant for with --tip: {', '.join(tips)}")
        target = make_target(xyz, rpy, quat_xyzw, deg)
        start = None if q0 is None else joint_vector(arm, q0, "--q0", deg)
        what, solved = _solve(arm, target, solver, start, every)
    present(make(arm, what, target=target), html, port, browse)
    if not solved:
        raise typer.Exit(1)


def _solve(arm: Any, target: Any, solver: str, start: Any, every: bool) -> tuple[Any, bool]:
    """Result with history, or the list of solutions; and whether there is one."""
    from ..solvers.solve import solve as solve_one
    from ..solvers.solve_all import solve_all

    if every:
        found = solve_all(arm, target, solver, start)
        if len(found):
            notice(found.message)
            return list(found), True
    result = solve_one(arm, target, solver, q0=start, history=True)
    notice(f"{result.status.name}: {result.message}")
    return result, result.success
