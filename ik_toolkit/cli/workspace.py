"""`ik workspace`: the reach of a robot, and where in it solvers succeed."""

import signal
from contextlib import nullcontext
from pathlib import Path
from typing import Any

from ..errors import InvalidOption, whole
from ..text import length
from .command import PLOTS, command, flag, option, options
from .completion import solvers_like
from .options import ObjectOutput, WholeRobot, given, joint_vector
from .output import heading, notice, partial, progress, run_or_part, show, table, whole_or_partial, write_json
from .pictures import chart, show_scene

LISTED = 10


@options()
class WorkspaceOptions:
    """Options of `ik workspace`: solvers, targets, and which files are written."""

    solver: list[str] | None = option(
        "NAME", "May be repeated; default: the search of auto.", "-s", "--solver", panel="Solver", complete=solvers_like
    )
    preset: list[str] | None = option(
        "SOLVER=PRESET", "Also solve with a preset: its name, or a file; may be repeated.", panel="Solver"
    )
    targets: int = option("N", "Number of targets.", "-n", "--targets", default=10_000)
    how: str = option("joints|volume", "Targets uniform in joints or in volume.", "--sample", default="joints")
    pose: bool = flag("--pose", "Targets are poses; default: positions.")
    seed: int = option("N", "Seed of the targets.", default=0, panel="Solver")
    q0: str | None = option("Q1 Q2 ...", "Start of every solve.", panel="Start and preferences")
    tolerance: float = option("TOL", "Both tolerances, in m and rad.", default=1e-3, panel="Tolerances")
    max_iterations: int | None = option("N", "Maximum iterations per attempt.", panel="Solver")
    restarts: int | None = option("N", "Additional attempts from other starts.", panel="Solver")
    csv: Path | None = option("FILE", "Write every target to a .csv as it is solved.", writes=[".csv"])
    workers: int | None = option("N", "Processes instead of threads.")
    plot: Path | None = option("FILE", "Draw the success map to a .png, .pdf or .svg file.", writes=PLOTS)
    html: Path | None = option("FILE", "Write robot and targets as one 3-D HTML page.", writes=[".html"])


@command
def workspace(asked: WorkspaceOptions, robot: WholeRobot, out: ObjectOutput) -> None:
    """Sample targets over the workspace and report, for each solver, successes, iterations, errors and failures.

    With several --tip the workspace is that of the first; the others are free.

    Ctrl-C reports the finished targets and keeps them in NAME.partial (without pictures).

    Examples:
    ik workspace hydrolek_7w -n 1000 --plot map.png
    ik workspace hydrolek_7w --solver lm --solver dls --csv targets.csv
    """
    arm = robot.load(robot.tips)

    from ..study.workspace import workspace as study

    chosen = _chosen(asked.solver, asked.preset)
    unchanged = ("targets", "how", "seed", "tolerance", "max_iterations", "restarts")
    options = {name: value for name, value in given(asked).items() if name in unchanged}
    start = joint_vector(arm, asked.q0, "--q0", robot.deg)
    with _workers(asked.workers) as executor, progress("solving", asked.targets) as step:
        options |= {"q0": start, "file": asked.csv, "executor": executor, "progress": step}
        found, stopped = run_or_part(
            lambda: study(arm, chosen, tip=arm.tips[0], position_only=not asked.pose, **options)
        )
    if not stopped:
        first = next(iter(found.solved))
        title = f"{arm.name}: targets of {found.tip}, {first}"
        chart(asked.plot, found, arm)
        show_scene(arm, None, asked.html, cloud=(found.points, found.solved[first]), title=title)
    else:
        done = next(iter(found.outcomes.values())).targets
        kept = f", in {partial(asked.csv)}" if asked.csv is not None else ""
        notice(f"partial: {done:,} of {asked.targets:,} targets{kept}")
    write_json(found.to_dict(), out.as_json, whole_or_partial(out.output, stopped))
    if not out.as_json:
        _show(found)
    if stopped:
        raise KeyboardInterrupt


def _chosen(names: list[str] | None, presets: list[str] | None) -> dict[str, Any]:
    """Return the solvers of --solver and --preset, by the name under which they are shown."""
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
    """Return a pool of worker processes, or a context without one. The workers ignore Ctrl-C, which this process handles."""
    from concurrent.futures import ProcessPoolExecutor

    if count is None:
        return nullcontext()
    return ProcessPoolExecutor(
        whole(count, "workers"), initializer=signal.signal, initargs=(signal.SIGINT, signal.SIG_IGN)
    )


def _show(found: Any) -> None:
    box = " by ".join(f"{a:.3f}..{b:.3f}" for a, b in zip(found.low, found.high, strict=True))
    near, far = found.radius
    show({"reach, sampled": f"x, y, z {box} m", "from the base": f"{near:.3f} to {far:.3f} m"})
    made = table("<solver", "<solved", "<per 1000", ">steps", ">worst", "<not solved")
    for name, outcome in found.outcomes.items():
        data = outcome.to_dict()
        low, high = data["wilson_95"]
        steps = data["mean_iterations"]
        other = "\n".join(f"{count} {status}" for status, count in outcome.statuses.items() if status != "CONVERGED")
        cells = (f"{outcome.solved} of {outcome.targets}", f"{1000 * low:.1f}..{1000 * high:.1f}")
        made.add_row(name, *cells, "-" if steps is None else f"{steps:.1f}", length(outcome.worst), other or "-")
    show(made)
    for name, rows in found.failures.items():
        if len(rows):
            shown = [(*(f"{x:.4f}" for x in at), f"{1000 * error:.3f}") for *at, error in rows[:LISTED].tolist()]
            made = table(">x (m)", ">y (m)", ">z (m)", ">error (mm)", rows=shown)
            show(heading(f"{name}: first failures"), made)
