"""`ik workspace`: the reach of a robot, and where in it solvers succeed."""

import signal
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..errors import InvalidOption
from .arguments import (
    PLOTS,
    Base,
    BaseRpy,
    BaseXyz,
    Deg,
    Group,
    How,
    Json,
    Lock,
    Out,
    PackageDir,
    RobotArg,
    SrdfFile,
    Tips,
    XacroArg,
    joint_vector,
    load_robot,
    one_or_several,
    writes,
)
from .output import facts, heading, notice, partial, progress, show, table, write_json

if TYPE_CHECKING:
    from ..study.workspace import Workspace

Solvers = Annotated[
    list[str] | None,
    typer.Option("-s", "--solver", metavar="NAME", help="May be repeated; default: the search of auto."),
]
Preset = Annotated[
    list[str] | None,
    typer.Option(metavar="SOLVER=PRESET", help="Also solve with a preset: its name, or a file; may be repeated."),
]
Targets = Annotated[int, typer.Option("-n", "--targets", metavar="N", help="Number of targets.")]
Pose = Annotated[bool, typer.Option("--pose", help="Targets are poses; default: positions.")]
Seed = Annotated[int, typer.Option(metavar="N", help="Seed of the targets.")]
Start = Annotated[str | None, typer.Option("--q0", metavar="Q1 Q2 ...", help="Start of every solve.")]
Tolerance = Annotated[float, typer.Option(metavar="TOL", help="Both tolerances, in m and rad.")]
MaxIterations = Annotated[int | None, typer.Option(metavar="N", help="Maximum iterations per attempt.")]
Restarts = Annotated[int | None, typer.Option(metavar="N", help="Additional attempts from other starts.")]
Csv = Annotated[
    Path | None,
    typer.Option(
        "--csv", metavar="FILE", help="Write every target to a .csv as it is solved.", callback=writes(".csv")
    ),
]
Workers = Annotated[int | None, typer.Option(metavar="N", help="Processes instead of threads.")]
Plot = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="Draw the success map to a .png, .pdf or .svg file.", callback=writes(*PLOTS)),
]
Html = Annotated[
    Path | None,
    typer.Option(
        "--html", metavar="FILE", help="Write robot and targets as one 3-D HTML page.", callback=writes(".html")
    ),
]
LISTED = 10


def register(app: typer.Typer) -> None:
    """Add the command of this module."""
    app.command()(workspace)


def _draw(found: Any, arm: Any, plot: Path | None, html: Path | None) -> None:
    """Pictures of a finished study."""
    if plot is not None:
        from ..show.plot import plot as draw

        draw(found, arm, file=plot)
    if html is not None:
        from ..show.scene import view

        first = next(iter(found.solved))
        title = f"{arm.name}: targets of {found.tip}, {first}"
        view(arm, cloud=(found.points, found.solved[first]), title=title).save(html)


def workspace(
    robot: RobotArg,
    solver: Solvers = None,
    preset: Preset = None,
    targets: Targets = 10_000,
    how: How = "joints",
    pose: Pose = False,
    seed: Seed = 0,
    q0: Start = None,
    tolerance: Tolerance = 1e-3,
    max_iterations: MaxIterations = None,
    restarts: Restarts = None,
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
    as_json: Json = False,
    output: Out = None,
    csv: Csv = None,
    workers: Workers = None,
    plot: Plot = None,
    html: Html = None,
) -> None:
    """Sample targets over the workspace and report, for each solver, successes, iterations, errors and failures.

    With several --tip the workspace is that of the first; the others are free.

    Ctrl-C reports the finished targets and keeps them in NAME.partial (without pictures).
    """
    if targets < 1:
        raise InvalidOption(f"--targets must be at least 1, not {targets}")
    if workers is not None and workers < 1:
        raise InvalidOption(f"--workers must be at least 1, not {workers}")
    tips = one_or_several(tip)
    arm = load_robot(robot, tips, base, lock, package_dir, deg, xacro_arg, base_xyz, base_rpy, srdf, group)

    from ..study.workspace import WorkspaceInterrupted
    from ..study.workspace import workspace as study

    chosen = _chosen(solver, preset)
    options = {"max_iterations": max_iterations, "restarts": restarts}
    stopped = False
    start = None if q0 is None else joint_vector(arm, q0, "--q0", deg)

    with _workers(workers) as executor, progress("solving", targets) as step:
        try:
            found = study(
                arm,
                chosen,
                tip=arm.tips[0],
                targets=targets,
                how=how,
                position_only=not pose,
                seed=seed,
                q0=start,
                file=csv,
                executor=executor,
                progress=step,
                tolerance=tolerance,
                **{key: value for key, value in options.items() if value is not None},
            )
        except WorkspaceInterrupted as interrupt:
            found, stopped = interrupt.result, True
    if not stopped:
        _draw(found, arm, plot, html)
    else:
        done = next(iter(found.outcomes.values())).targets
        kept = f", in {partial(csv)}" if csv is not None else ""
        notice(f"partial: {done:,} of {targets:,} targets{kept}")
    write_json(found.to_dict(), as_json, partial(output) if stopped and output else output)
    if not as_json:
        _show(found)
    if stopped:
        raise KeyboardInterrupt


def _chosen(names: list[str] | None, presets: list[str] | None) -> dict[str, Any]:
    """Solvers by the name they are shown under: --solver and --preset."""
    from ..solvers.presets import from_preset
    from ..solvers.registry import GENERAL, find_row

    chosen: dict[str, Any] = {name: name for name in names or ([] if presets else [GENERAL])}
    for text in presets or ():
        name, equals, which = text.partition("=")
        if not equals:
            raise InvalidOption(f"--preset takes SOLVER=PRESET, not '{text}'")
        chosen[f"{name} {Path(which).stem}"] = from_preset(find_row(name), which)
    return chosen


def _workers(count: int | None) -> Any:
    """Pool of processes, or nothing. Ctrl-C reaches them too; only this process answers it."""
    from concurrent.futures import ProcessPoolExecutor

    if count is None:
        return nullcontext()
    return ProcessPoolExecutor(count, initializer=signal.signal, initargs=(signal.SIGINT, signal.SIG_IGN))


def _show(found: "Workspace") -> None:
    box = " by ".join(f"{a:.3f}..{b:.3f}" for a, b in zip(found.low, found.high, strict=True))
    near, far = found.radius
    show(facts({"reach, sampled": f"x, y, z {box} m", "from the base": f"{near:.3f} to {far:.3f} m"}))
    made = table("<solver", "<solved", "<per 1000", ">steps", ">worst\n(mm)", "<not solved")
    for name, outcome in found.outcomes.items():
        data = outcome.to_dict()
        low, high = data["wilson_95"]
        steps = data["mean_iterations"]
        other = "\n".join(f"{count} {status}" for status, count in outcome.statuses.items() if status != "CONVERGED")
        made.add_row(
            name,
            f"{outcome.solved} of {outcome.targets}",
            f"{1000 * low:.1f}..{1000 * high:.1f}",
            "-" if steps is None else f"{steps:.1f}",
            f"{1000 * outcome.worst:.4g}",
            other or "-",
        )
    show(made)
    for name, rows in found.failures.items():
        if len(rows):
            made = table(">x (m)", ">y (m)", ">z (m)", ">error (mm)")
            show(heading(f"{name}: first failures"))
            for x, y, z, error in rows[:LISTED].tolist():
                made.add_row(f"{x:.4f}", f"{y:.4f}", f"{z:.4f}", f"{1000 * error:.3f}")
            show(made)
