"""`ik bench`: comparison of the solvers of this package on a robot."""

from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import Any

from ..errors import InvalidOption
from ..files import write_whole
from .command import PLOTS, argument, command, option, options, same
from .completion import robots_like, solvers_like
from .options import JsonOutput, ObjectOutput, RobotOptions, TableOutput, given, solver_named
from .output import notice, progress, run_or_part, show, table, whole_or_partial, write_json, write_rows
from .pictures import chart
from .streams import uninterrupted

FIGURES = ("targets", "solved", "low", "high", "median", "mean", "p99", "iterations", "restarts", "fk_evaluations")
COLUMNS = ("\n%", "one attempt\n95 %", "\nus", "\n%", "with restarts\n95 %", "\nus", "\np99 us")


@options()
class BenchOptions:
    """Options for the robots, solvers and targets of `ik bench`."""

    robots: list[str] | None = argument(
        "ROBOT", "Names or URDF files; default hydrolek_7w.", default=None, complete=robots_like
    )
    solvers: list[str] | None = option(
        "NAME,NAME",
        "Solvers to compare, or FILE.py:CLASS for your own; may be repeated; default: all that apply.",
        "-s",
        "--solvers",
        "--solver",
        panel="Solver",
        complete=solvers_like,
    )
    targets: int = option("N", "Number of random reachable targets per robot.", "--targets", "-n", default=300)
    start: str = option("KIND", "none (each solver's own), home, random, or near (within 0.1 rad).", default="none")
    task: str | None = option("KIND", "pose or position; default: pose for 6 or more joints.")
    tolerance: float = option("T", "Position [m] and orientation [rad] tolerance.", default=1e-6, panel="Tolerances")
    max_iterations: int | None = option(
        "N", "Maximum iterations per attempt; default: the solver's own.", panel="Solver"
    )
    restarts: int | None = option("N", "Restarts of every solver in the second columns; default 99.", panel="Solver")
    seed: int = option("N", "Seed of targets, starts and restarts.", default=0, panel="Solver")
    tip: list[str] | None = same(RobotOptions, "tip")


@options("Output")
class BenchOutput:
    """Options for the tables, files and charts of `ik bench`."""

    plot: Path | None = option("FILE", "Draw targets solved against time to a .png, .pdf or .svg file.", writes=PLOTS)
    csv_file: Path | None = same(TableOutput, "csv_file")
    latex: Path | None = option("FILE", "Write the table as LaTeX to a .tex.", writes=[".tex"])
    as_json: bool = same(JsonOutput, "as_json")
    output: Path | None = same(ObjectOutput, "output")


@command
def bench(asked: BenchOptions, out: BenchOutput) -> None:
    """Compare the solvers on a robot: success, time, iterations.

    Random reachable targets, one thread, every call timed from Python, failures included. Every solver solves them twice:
    with one attempt, and with the same number of restarts. Success is given with its 95 % Wilson interval, time as the median
    of a call. With several --tip all of them are solved together.

    Examples:
    ik bench hydrolek_7w
    ik bench planar_2r hydrolek_7w --solvers lm,dls -n 100 --tolerance 1e-4
    ik bench hydrolek_7w --csv bench.csv --latex bench.tex
    """
    from ..study.benchmark import benchmark

    chosen = [solver_named(name.strip()) for text in asked.solvers or () for name in text.split(",") if name.strip()]
    names = asked.robots or ["hydrolek_7w"]
    if asked.tip and len(names) > 1:
        raise InvalidOption(f"--tip is for one robot; {len(names)} are given")
    robots = [RobotOptions(robot=name, tip=asked.tip) for name in names]
    arms = [robot.load(robot.tips) for robot in robots]
    options = {name: value for name, value in given(asked).items() if name not in ("robots", "solvers", "tip")}
    counted = 0, 0
    with progress("solving", None) as bar:

        def step(done: int, count: int) -> None:
            nonlocal counted
            counted = done, count
            bar(done, total=count)

        found, stopped = run_or_part(lambda: benchmark(arms, chosen or None, progress=step, **options))
    if stopped and not found.rows:
        raise KeyboardInterrupt
    with uninterrupted():
        output, csv_file, latex = (whole_or_partial(file, stopped) for file in (out.output, out.csv_file, out.latex))
        write_json(found.to_dict(), out.as_json, output)
        _write_csv(csv_file, found)
        if latex is not None:
            write_whole(latex, _latex(found))
            notice(f"wrote {latex}")
    chart(None if stopped else out.plot, found)
    if not out.as_json:
        _show(found)
    if stopped:
        notice(f"partial: {counted[0]:,} of {counted[1]:,} blocks of targets were solved")
        raise KeyboardInterrupt


def _write_csv(file: Path | None, found: Any) -> None:
    """Write the results as CSV, with times in seconds; columns that begin with "once" are for a single attempt."""
    head = ["robot", "solver", "task", *FIGURES, *(f"once_{name}" for name in FIGURES)]
    both = (((one.robot, one.solver, one.task), (one, one.once or one)) for one in found.rows)
    rows = ([*names, *(getattr(part, name) for part in parts for name in FIGURES)] for names, parts in both)
    write_rows(file, head, rows)


def _latex(found: Any) -> str:
    """Return a LaTeX table (booktabs) of success with its interval and median time, for one attempt and with restarts."""
    lines = [
        r"\begin{tabular}{llrrrr}",
        r"\toprule",
        r"robot & solver & one attempt [\%] & median [$\mu$s] & with restarts [\%] & median [$\mu$s] \\",
        r"\midrule",
    ]
    for row in found.rows:
        cells = [name.replace("_", r"\_") for name in (row.robot, row.solver)]
        for share, low, high, median in _figures(row):
            cells += [f"{share} [{low}, {high}]", median]
        lines.append(" & ".join(cells) + r" \\")
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", ""])


def _show(found: Any) -> None:
    for robot, rows in found.by_robot().items():
        made = table("<\nsolver", *(f">{column}" for column in COLUMNS))
        for row in rows:
            each = ((share, f"{low}-{high}", median) for share, low, high, median in _figures(row))
            made.add_row(row.solver, *chain(*each), _short(1e6 * row.p99))
        show(f"{robot}: {rows[0].targets} targets ({rows[0].task}), {found.options['restarts']} restarts", made)
    for (robot, solver), why in found.skipped.items():
        notice(f"{robot}: {solver} left out: {why}")


def _figures(row: Any) -> Iterator[tuple[str, str, str, str]]:
    """Yield success and the ends of its interval [%], and the median time [us], for one attempt and with restarts."""
    for one in filter(None, (row.once, row)):
        share, low, high = 100 * one.solved / one.targets, 100 * one.low, 100 * one.high
        yield f"{share:.4g}", f"{low:.3g}", f"{high:.3g}", _short(1e6 * one.median)


def _short(number: float) -> str:
    return f"{number:.1f}" if number < 100 else f"{number:.0f}"
