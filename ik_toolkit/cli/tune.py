"""`ik tune`: search a solver's parameters for a robot and write them as a preset."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..errors import InvalidOption
from ..files import write_table
from .arguments import (
    PLOTS,
    Base,
    BaseRpy,
    BaseXyz,
    Csv,
    Deg,
    How,
    Json,
    Lock,
    PackageDir,
    RobotArg,
    Tips,
    XacroArg,
    load_robot,
    one_or_several,
    writes,
)
from .output import facts, notice, partial, progress, show, write_json
from .streams import uninterrupted

if TYPE_CHECKING:
    from ..study.tune import TuneResult

SolverArg = Annotated[
    str, typer.Argument(metavar="SOLVER", help="Solver with presets, a gain or a damping; see ik solvers.")
]
Method = Annotated[str, typer.Option("-m", "--method", metavar="cma|pso", help="CMA-ES or a particle swarm.")]
Pose = Annotated[bool, typer.Option("--pose", help="Targets are poses; default: positions.")]
Maps = Annotated[
    int | None,
    typer.Option(
        metavar="K", help="For a solver with maps: K starts, each with its map; 1: as published. Default: its own."
    ),
]
From = Annotated[str | None, typer.Option("--from", metavar="PRESET", help="Preset the search starts from.")]
Targets = Annotated[int, typer.Option(metavar="N", help="Training targets.")]
HeldOut = Annotated[
    int, typer.Option(metavar="N", help="Number of held-out sets of 1000 targets that evaluate the result.")
]
Generations = Annotated[int, typer.Option(metavar="N", help="Maximum number of generations.")]
Population = Annotated[
    int | None, typer.Option(metavar="N", help="Candidates per generation; default: by problem size.")
]
Seconds = Annotated[float | None, typer.Option(metavar="S", help="Stop the search after this time.")]
Seed = Annotated[int, typer.Option(metavar="N", help="Seed of the search and of the targets.")]
Tolerance = Annotated[float, typer.Option(metavar="TOL", help="Both tolerances, in m and rad.")]
MaxIterations = Annotated[int, typer.Option(metavar="N", help="Maximum iterations per solve.")]
Out = Annotated[
    Path | None,
    typer.Option(
        "-o", "--output", metavar="FILE", help="Preset; default: ROBOT-SOLVER.toml.", callback=writes(".toml")
    ),
]
Resume = Annotated[bool, typer.Option("--resume", help="Continue from FILE.npz, which every run writes beside FILE.")]
Plot = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="Draw the convergence to a .png, .pdf or .svg file.", callback=writes(*PLOTS)),
]


def register(app: typer.Typer) -> None:
    """Add the command of this module."""
    app.command()(tune)


def _telling(bar: Callable) -> Callable:
    """Report to a progress bar the least cost of the generations so far."""
    least = float("inf")

    def step(generation: int, costs: Any) -> None:
        nonlocal least
        least = min(least, float(costs.min()))
        bar(generation, f"generation {generation}, cost {least:.4f}")

    return step


def tune(
    robot: RobotArg,
    solver: SolverArg,
    method: Method = "cma",
    pose: Pose = False,
    maps: Maps = None,
    from_: From = None,
    targets: Targets = 2000,
    held_out: HeldOut = 10,
    generations: Generations = 200,
    population: Population = None,
    seconds: Seconds = None,
    seed: Seed = 0,
    tolerance: Tolerance = 1e-3,
    max_iterations: MaxIterations = 1000,
    how: How = "joints",
    tip: Tips = None,
    base: Base = None,
    base_xyz: BaseXyz = None,
    base_rpy: BaseRpy = None,
    lock: Lock = None,
    package_dir: PackageDir = None,
    xacro_arg: XacroArg = None,
    deg: Deg = False,
    as_json: Json = False,
    csv_file: Csv = None,
    output: Out = None,
    resume: Resume = False,
    plot: Plot = None,
) -> None:
    """Tune a solver's gains and starts for a robot, and evaluate them on held-out targets.

    The result is a preset for ik solve --preset FILE. Ctrl-C keeps the best so far as FILE.partial; --resume continues from there.
    """
    arm = load_robot(robot, one_or_several(tip), base, lock, package_dir, deg, xacro_arg, base_xyz, base_rpy)

    from ..solvers.presets import from_preset
    from ..solvers.registry import find_row
    from ..study.tune import tune as search

    initial = None if from_ is None else from_preset(find_row(solver), from_)
    preset = output or Path(f"{Path(robot).stem}-{solver}.toml")
    writes(".toml")(preset)
    record = preset.with_suffix(".npz")
    writes(".npz")(record)
    with _record(record, resume), progress("searching", generations) as bar:
        result = search(
            arm,
            solver,
            position_only=not pose,
            method=method,
            maps=maps,
            initial=initial,
            targets=targets,
            held_out=held_out,
            generations=generations,
            population=population,
            seconds=seconds,
            seed=seed,
            tolerance=tolerance,
            max_iterations=max_iterations,
            how=how,
            checkpoint=record,
            progress=_telling(bar),
        )
    if result.interrupted:
        preset = partial(preset)
    with uninterrupted():
        result.save(preset)
        _write_csv(csv_file, result)
    if plot is not None and not result.interrupted:
        from ..show.plot import plot as draw

        draw(result, file=plot)
    write_json({**result.to_dict(), "preset": str(preset)}, as_json)
    if not as_json:
        _show(result, preset)
    if result.interrupted:
        notice(
            f"partial: the best so far is in {preset}, evaluated on one held-out set; --resume continues from {record}"
        )
        raise KeyboardInterrupt


def _write_csv(file: Path | None, result: "TuneResult") -> None:
    """The scores as CSV, where asked for: a row for each rule, the tuned one also on the training targets."""
    if file is None:
        return
    file = partial(file) if result.interrupted else file
    scores = {f"{name}, held out": one for name, one in result.scores.items()} | {"tuned, training": result.train}
    rows = (
        (name, one.total, sum(one.successes), one.share, *one.interval, one.iterations) for name, one in scores.items()
    )
    write_table(file, ["rule", "targets", "solved", "share", "low", "high", "iterations"], rows)
    notice(f"wrote {file}")


@contextmanager
def _record(file: Path, resume: bool) -> Iterator[None]:
    """Keep the record of an earlier search beside `file` until this one has begun its own; --resume continues from it."""
    from ..study.tune import check_record

    if resume and not file.exists():
        raise InvalidOption(f"there is nothing to resume: no file '{file}'")
    if resume or not file.exists():
        yield
        return
    check_record(file)
    set_aside = file.rename(partial(file))
    try:
        yield
    finally:
        if file.exists():
            set_aside.unlink()
        else:
            set_aside.rename(file)


def _show(result: "TuneResult", preset: Path) -> None:
    show(
        facts(
            {
                "default, held out": result.scores["default"],
                "start, held out": result.before,
                "tuned, training": result.train,
                "tuned, held out": result.held_out,
                "verdict": result.verdict,
                "search": f"{result.method}, {result.evaluations} evaluations, {result.elapsed:.0f} s",
                "preset": preset,
            }
        )
    )
