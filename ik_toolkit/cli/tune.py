"""`ik tune`: search a solver's parameters for a robot and write them as a preset."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ..errors import InvalidOption
from ..files import require_place
from .command import PLOTS, argument, command, flag, option, options, same
from .completion import solvers_like
from .options import TableOutput, WholeRobot
from .output import notice, partial, progress, show, whole_or_partial, write_json, write_rows
from .pictures import chart
from .streams import uninterrupted
from .workspace import WorkspaceOptions


@options()
class TunedRobot(WholeRobot):
    """Options for the robot for which a solver is tuned, without SRDF."""

    srdf: None = None
    group: None = None


@options()
class TuneOptions:
    """Options of `ik tune`: solver, search, targets, and which files are written."""

    solver: str = argument("SOLVER", "Solver with presets, a gain or a damping; see ik solvers.", complete=solvers_like)
    method: str = option("cma|pso", "CMA-ES or a particle swarm.", "-m", "--method", default="cma")
    pose: bool = same(WorkspaceOptions, "pose")
    maps: int | None = option(
        "K", "For a solver with maps: K starts, each with its map; 1: as published. Default: its own."
    )
    from_: str | None = option("PRESET", "Preset the search starts from.", "--from")
    targets: int = option("N", "Training targets.", default=2000)
    held_out: int = option("N", "Number of held-out sets of 1000 targets that evaluate the result.", default=10)
    generations: int = option("N", "Maximum number of generations.", default=200)
    population: int | None = option("N", "Candidates per generation; default: by problem size.")
    seconds: float | None = option("S", "Time after which no further generation begins.")
    seed: int = option("N", "Seed of the search and of the targets.", default=0, panel="Solver")
    tolerance: float = same(WorkspaceOptions, "tolerance")
    max_iterations: int = option("N", "Maximum iterations per solve.", default=1000, panel="Solver")
    how: str = same(WorkspaceOptions, "how")
    output: Path | None = option("FILE", "Preset; default: ROBOT-SOLVER.toml.", "-o", "--output", writes=[".toml"])
    resume: bool = flag("--resume", "Continue from FILE.npz, which every run writes beside FILE.")
    plot: Path | None = option("FILE", "Draw the convergence to a .png, .pdf or .svg file.", writes=PLOTS)


def _telling(bar: Callable) -> Callable:
    """Return a function that shows the least cost of all generations so far in a progress bar."""
    least = float("inf")

    def step(generation: int, costs: Any) -> None:
        nonlocal least
        least = min(least, float(costs.min()))
        bar(generation, f"generation {generation}, cost {least:.4f}")

    return step


@command
def tune(robot: TunedRobot, asked: TuneOptions, out: TableOutput) -> None:
    """Tune a solver's gains and starts for a robot, and evaluate them on held-out targets.

    The result is a preset for ik solve --preset FILE. Ctrl-C keeps the best so far as FILE.partial; --resume continues from there.

    Examples:
    ik tune hydrolek_7w pid --seconds 60 -o mine.toml
    ik solve hydrolek_7w --xyz 1.0 0.1 0.2 --preset mine.toml
    """
    arm = robot.load(robot.tips)

    from ..solvers.presets import from_preset
    from ..solvers.registry import find_row
    from ..study.tune import tune as search

    initial = None if asked.from_ is None else from_preset(find_row(asked.solver), asked.from_)
    preset = asked.output or Path(f"{Path(robot.robot).stem}-{asked.solver}.toml")
    record = preset.with_suffix(".npz")
    for file in (preset, record):
        require_place(file)
    unchanged = "method maps targets held_out generations population seconds seed tolerance max_iterations how".split()
    with _record(record, asked.resume), progress("searching", asked.generations, asked.seconds) as bar:
        options = {name: getattr(asked, name) for name in unchanged} | {"initial": initial, "checkpoint": record}
        result = search(arm, asked.solver, position_only=not asked.pose, progress=_telling(bar), **options)
    if result.interrupted:
        preset = partial(preset)
    with uninterrupted():
        result.save(preset)
        _write_csv(out.csv_file, result)
    chart(None if result.interrupted else asked.plot, result)
    write_json({**result.to_dict(), "preset": str(preset)}, out.as_json)
    if not out.as_json:
        _show(result, preset)
    if result.interrupted:
        notice(
            f"partial: the best so far is in {preset}, evaluated on one held-out set; --resume continues from {record}"
        )
        raise KeyboardInterrupt


def _write_csv(file: Path | None, result: Any) -> None:
    """Write the scores as CSV, if a file is given: a row for each parameter set, for the tuned one also on the training targets."""
    file = whole_or_partial(file, result.interrupted)
    scores = {f"{name}, held out": one for name, one in result.scores.items()} | {"tuned, training": result.train}
    rows = (
        (name, one.total, sum(one.successes), one.share, *one.interval, one.iterations) for name, one in scores.items()
    )
    write_rows(file, ["rule", "targets", "solved", "share", "low", "high", "iterations"], rows)


@contextmanager
def _record(file: Path, resume: bool) -> Iterator[None]:
    """Context manager: keep the checkpoint of an earlier search until this one has written its own; --resume continues from it."""
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


def _show(result: Any, preset: Path) -> None:
    show({
        "default, held out": result.scores["default"],
        "start, held out": result.before,
        "tuned, training": result.train,
        "tuned, held out": result.held_out,
        "verdict": result.verdict,
        "search": f"{result.method}, {result.evaluations} evaluations, {result.elapsed:.0f} s",
        "preset": preset,
    })  # fmt: skip
