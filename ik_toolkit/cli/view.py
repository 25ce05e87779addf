"""`ik view` and `ik panel`: a robot, a configuration or a solve in 3-D, and a robot to move by hand, in the browser."""

from pathlib import Path
from typing import Any

import typer

from ..errors import InvalidOption
from .command import command, flag, option, options, same
from .completion import solvers_like
from .options import RobotOptions, SceneOutput, WholeRobot, joint_vector
from .output import notice
from .pictures import incomplete, present, wait, written
from .target import TargetOptions, in_base, relations

# With one of these options `ik view` solves for a target and shows the result.
SOLVED = ("--xyz", "--matrix", "--target")


@options()
class ViewOptions:
    """Options of `ik view`: what is shown, and where."""

    q: str | None = option("Q1 Q2 ...", "Joint values to show; default: home.", without=SOLVED)
    motion: Path | None = option(
        "FILE",
        "Show a motion from a file: of ik path a path (.csv, .npz, .json) or a trajectory (.csv, .json), "
        "of ik track a run (.csv, .npz, .json).",
        without=["--q", *SOLVED],
    )
    page: Path | None = option(
        "FILE",
        "Write a live page: the robot with its solvers and a target to drag in one .html file, which needs neither "
        "Python nor a network.",
        writes=[".html", ".htm"],
        without=["--html", "--q", "--motion", *SOLVED, "--port"],
    )
    port: int = option("N", "Port on 127.0.0.1; default: a free one.", default=0)
    browse: bool = flag("--open/--no-open", "Open the address in a browser.", default=True)
    html: Path | None = same(SceneOutput, "html", without=["--port"])


@options("Target")
class ViewTarget(TargetOptions):
    """Options of `ik view` for the target that is solved for and shown."""

    xyz: str | None = option("X Y Z", "Solve for this position [m] and show the iterations.")
    rpy: str | None = option("R P Y", "With --xyz: roll, pitch, yaw [rad].", needs=["--xyz"])
    quat_xyzw: str | None = option("X Y Z W", "With --xyz: quaternion.", needs=["--xyz"])
    quat_wxyz: str | None = option("W X Y Z", "With --xyz: quaternion, the real part first.", needs=["--xyz"])
    from_q: None = None
    direction: None = None
    tip_axis: None = None


@options("Start and preferences")
class ViewSolve:
    """Options of `ik view` for the solver and its start."""

    solver: str = option(
        "NAME",
        "Solver for --xyz; see ik solvers.",
        "-s",
        "--solver",
        default="auto",
        panel="Solver",
        complete=solvers_like,
        needs=SOLVED,
    )
    every: bool = flag("--all", "Show every solution found as a ghost.", needs=SOLVED)
    q0: str | None = option("Q1 Q2 ...", "Where the solve starts; default: home.", needs=SOLVED)
    follow: bool = flag(
        "--follow",
        "Show a target to drag, which the robot follows (extra 'panel').",
        without=(
            "--page --base --base-xyz --base-rpy --rail --lock --package-dir --xacro-arg --srdf --group --html --q --motion "
            "--xyz --matrix --target"
        ).split(),
    )


@command
def view(shown: ViewOptions, target: ViewTarget, how: ViewSolve, robot: WholeRobot) -> None:
    """Show a robot in 3-D: at home, at --q, along --motion, or solving for --xyz or --target (with a time slider).

    Serves on 127.0.0.1 until Ctrl-C, or writes one HTML file that needs no network. A robot with several tips is shown
    whole when --tip is left out. With --follow the page has a target to drag, which the arm follows with the steps of the tracker;
    out of reach it goes to the closest pose. With --page that page is a file whose solvers run in the browser. Exit code 1 when the
    solve asked for did not succeed (it is shown all the same).

    Examples:
    ik view hydrolek_7w
    ik view hydrolek_7w --xyz 1.0 0.1 0.2 --html solve.html
    ik view hydrolek_7w --follow
    ik view hydrolek_7w --page hydrolek.html
    """
    _check_port(shown.port)
    if how.follow:
        from ..show.panel.panel import Follower, Panel

        served = Panel(robot.robot, robot.tip, port=shown.port, desk=Follower)
        wait(f"the robot is at {served.url}", served.url, shown.browse)
        served.close()
        return
    from ..show.scene import view as make

    aim: Any = target.read(robot.deg) if target.posed or target.targets else None
    related = relations(target.relative)
    arm = robot.load(robot.choose_tips(aim if target.targets else None, related, target.posed))
    if shown.page is not None:
        scene = make(arm)
        incomplete(scene)
        written(scene.page(shown.page))
        return
    what, solved = arm.home, True
    if shown.motion is not None:
        from ..show.animation import motion_from_file

        what = motion_from_file(arm, shown.motion)
    elif shown.q is not None:
        what = joint_vector(arm, shown.q, "--q", robot.deg)
    elif aim is not None:
        start = joint_vector(arm, how.q0, "--q0", robot.deg)
        what, solved = _solve(arm, aim, how.solver, start, how.every, {"relative_to": related} if related else {})
        at = what[0] if isinstance(what, list) else what.q
        aim = in_base(aim, arm.fk(at), related)
    present(make(arm, what, target=aim), shown.html, shown.html is None, shown.port, shown.browse)
    if not solved:
        raise typer.Exit(1)


def _check_port(port: int) -> None:
    if not 0 <= port < 65536:
        raise InvalidOption(f"--port must be between 0 and 65535, not {port}")


def _solve(arm: Any, target: Any, solver: str, start: Any, every: bool, options: dict[str, Any]) -> tuple[Any, bool]:
    """Return the result with history, or the list of solutions if `every`; and whether a solution was found."""
    from ..solvers.solve import solve as solve_one
    from ..solvers.solve import solve_all

    if every and len(found := solve_all(arm, target, solver, start, **options)):
        notice(found.message)
        return list(found), True
    result = solve_one(arm, target, solver, q0=start, history=True, **options)
    notice(f"{result.status.name}: {result.message}")
    return result, result.success


@options()
class PanelOptions:
    """Options of `ik panel`: the robot, and the address at which the panel is served."""

    robot: str = same(RobotOptions, "robot", default="hydrolek_7w")
    tip: list[str] | None = same(RobotOptions, "tip")
    host: str = option("ADDRESS", "Address to listen on; default: this machine only.", default="127.0.0.1")
    port: int = option("N", "Port; default: a free one.", default=0)
    browse: bool = same(ViewOptions, "browse")


@command
def panel(asked: PanelOptions) -> None:
    """Move joints, drag targets, compare solvers and solutions in a browser, until Ctrl-C.

    Listens on this machine only unless --host says otherwise. The printed address contains an access token: nobody without it
    is let in. Every browser tab has its own robot. A robot with several tips has a target to drag for each.

    Examples:
    ik panel hydrolek_7w
    """
    _check_port(asked.port)
    from ..show.access import is_loopback
    from ..show.panel.panel import Panel

    served = Panel(asked.robot, asked.tip, host=asked.host, port=asked.port)
    if not is_loopback(asked.host):
        notice(
            f"warning: the panel listens at {asked.host}, unencrypted: anyone who knows the address below can use it,"
            " and anyone who can read the network traffic learns it"
        )
    wait(f"the panel is at {served.url}", served.url, asked.browse)
    served.close()
