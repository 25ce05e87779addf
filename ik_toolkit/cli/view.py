"""`ik view`: a robot, a configuration or a solve in 3-D, in the browser or as one HTML file."""

import signal
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..errors import InvalidOption
from .common import (
    PLOTS,
    Base,
    Deg,
    Lock,
    PackageDir,
    RobotArg,
    Tip,
    joint_vector,
    load_robot,
    notice,
    writes,
)

if TYPE_CHECKING:
    from ..show.scene import Scene

Q = Annotated[str | None, typer.Option("--q", metavar="Q1 Q2 ...", help="Joint values to show; default: home.")]
Xyz = Annotated[str | None, typer.Option(metavar="X Y Z", help="Solve for this position [m] and show how it went.")]
Rpy = Annotated[str | None, typer.Option(metavar="R P Y", help="With --xyz: roll, pitch, yaw [rad].")]
Quat = Annotated[str | None, typer.Option(metavar="X Y Z W", help="With --xyz: quaternion.")]
SolverName = Annotated[str, typer.Option("-s", "--solver", metavar="NAME", help="Solver for --xyz; see ik solvers.")]
Ghosts = Annotated[bool, typer.Option("--all", help="With --xyz: show every solution found as a ghost.")]
Start = Annotated[str | None, typer.Option("--q0", metavar="Q1 Q2 ...", help="Where the solve starts; default: home.")]
Html = Annotated[
    Path | None,
    typer.Option(
        "--html",
        metavar="FILE",
        help="Write the scene as one page that needs no network.",
        callback=writes(".html", ".htm"),
    ),
]
Chart = Annotated[
    Path | None,
    typer.Option(
        "--plot",
        metavar="FILE",
        help="Draw the error at every step to a .png, .pdf or .svg file.",
        callback=writes(*PLOTS),
    ),
]
Live = Annotated[bool, typer.Option("--view", help="Show it in 3-D in the browser, until Ctrl-C.")]
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
        from .solve import make_target

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


def draw(arm: Any, what: Any, target: Any, plot: Path | None, html: Path | None, live: bool) -> None:
    """Pictures asked for of a result with history or of several solutions: chart, page, scene in the browser."""
    if plot is not None and len(what.history["q"]) < 2:
        notice("no plot: the solve took no step")
    elif plot is not None:
        from ..show.plots import convergence, save

        title = f"{arm.name}, {what.solver}: {what.status.name}"
        notice(f"wrote {save(convergence(what, title=title), plot)}")
    if html is not None or live:
        from ..show.scene import view as make

        scene = make(arm, what, target=getattr(target, "T_base_tip", target))
        if html is not None:
            present(scene, html)
        if live:
            present(scene, None)


def present(scene: "Scene", html: Path | None, port: int = 0, browse: bool = True) -> None:
    """Write the page, or serve it until Ctrl-C or SIGTERM."""
    if html is not None:
        notice(f"wrote {scene.save(html)} ({html.stat().st_size / 1e6:.1f} MB, opens without a network)")
        return
    try:
        url = scene.serve(port)
    except OSError as error:
        raise InvalidOption(f"port {port} cannot be used: {error.strerror or error}") from None
    wait(f"the scene is at {url}", url, browse)
    scene.close()


def wait(announcement: str, url: str, browse: bool) -> None:
    """Say where the page is, open a browser, and wait for Ctrl-C or SIGTERM."""
    done = threading.Event()
    before = signal.signal(signal.SIGTERM, lambda *_: done.set())
    try:
        notice(f"{announcement}  (Ctrl-C ends it)")
        if browse:
            import webbrowser

            threading.Thread(target=webbrowser.open, args=(url,), daemon=True).start()
        while not done.wait(0.5):
            pass
    except KeyboardInterrupt:
        notice("")
    finally:
        signal.signal(signal.SIGTERM, before)
