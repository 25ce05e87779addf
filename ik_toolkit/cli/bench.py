"""`ik bench`: our own solvers side by side on a robot."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..errors import InvalidOption
from ..files import write_table, write_whole
from .arguments import PLOTS, Csv, Json, Out, Tips, load_robot, one_or_several, solver_named, writes
from .output import notice, partial, progress, show, table, write_json
from .streams import uninterrupted

if TYPE_CHECKING:
    from ..study.benchmark import Benchmark

Robots = Annotated[list[str] | None, typer.Argument(metavar="ROBOT", help="Names or URDF files; default hydrolek_7w.")]
Solvers = Annotated[
    list[str] | None,
    typer.Option(
        "-s",
        "--solvers",
        "--solver",
        metavar="NAME,NAME",
        help="Solvers to compare, or FILE.py:CLASS for your own; may be repeated; default: all that apply.",
    ),
]
Targets = Annotated[
    int, typer.Option("--targets", "-n", metavar="N", help="Number of random reachable targets per robot.")
]
Start = Annotated[
    str, typer.Option(metavar="KIND", help="none (each solver's own), home, random, or near (within 0.1 rad).")
]
Task = Annotated[str | None, typer.Option(metavar="KIND", help="pose or position; default: pose for 6 or more joints.")]
Tolerance = Annotated[float, typer.Option(metavar="T", help="Position [m] and orientation [rad] tolerance.")]
Seed = Annotated[int, typer.Option(metavar="N", help="Seed of targets, starts and restarts.")]
Iterations = Annotated[
    int | None, typer.Option(metavar="N", help="Maximum iterations per attempt; default: the solver's own.")
]
Restarts = Annotated[
    int | None, typer.Option(metavar="N", help="Restarts of every solver in the second columns; default 99.")
]
Plot = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="Draw targets solved against time to a .png, .pdf or .svg file.",
        rich_help_panel="Output",
        callback=writes(*PLOTS),
    ),
]
Latex = Annotated[
    Path | None,
    typer.Option(
        "--latex",
        metavar="FILE",
        help="Write the table as LaTeX to a .tex.",
        rich_help_panel="Output",
        callback=writes(".tex"),
    ),
]
FIGURES = ("targets", "solved", "low", "high", "median", "mean", "p99", "iterations", "restarts", "fk_evaluations")
COLUMNS = ("one attempt\n%, 95 %", "\nus", "with restarts\n%, 95 %", "\nus", "\np99 us")


def register(app: typer.Typer) -> None:
    """Add the commands of this module."""
    app.command()(bench)


def bench(
    robots: Robots = None,
    tip: Tips = None,
    solvers: Solvers = None,
    targets: Targets = 300,
    start: Start = "none",
    task: Task = None,
    tolerance: Tolerance = 1e-6,
    max_iterations: Iterations = None,
    restarts: Restarts = None,
    seed: Seed = 0,
    plot: Plot = None,
    csv_file: Csv = None,
    latex: Latex = None,
    as_json: Json = False,
    output: Out = None,
) -> None:
    """Compare the solvers on a robot: success, time, iterations.

    Random reachable targets, one thread, every call timed from Python, failures included. Every solver solves them twice:
    with one attempt, and with the same number of restarts. Success is given with its 95 % Wilson interval, time as the median
    of a call. With several --tip all of them are solved together.
    """
    from ..study.benchmark import BenchmarkInterrupted, benchmark

    chosen = [solver_named(name.strip()) for text in solvers or () for name in text.split(",") if name.strip()]
    if tip and len(robots or ()) > 1:
        raise InvalidOption(f"--tip is for one robot; {len(robots or ())} are given")
    arms = [load_robot(name, one_or_several(tip)) for name in robots or ["hydrolek_7w"]]
    options = {"tolerance": tolerance, "max_iterations": max_iterations, "restarts": restarts}
    given = {key: value for key, value in options.items() if value is not None}
    stopped, counted = False, (0, 0)
    try:
        with progress("solving", None) as bar:

            def step(done: int, count: int) -> None:
                nonlocal counted
                counted = done, count
                bar(done, total=count)

            found = benchmark(
                arms, chosen or None, targets=targets, start=start, task=task, seed=seed, progress=step, **given
            )
    except BenchmarkInterrupted as interrupt:
        found, stopped = interrupt.result, True
        if not found.rows:
            raise KeyboardInterrupt from None
    with uninterrupted():
        write_json(found.to_dict(), as_json, partial(output) if stopped and output else output)
        for file, write in ((csv_file, _write_csv), (latex, _write_latex)):
            if file is not None:
                place = partial(file) if stopped else file
                write(place, found)
                notice(f"wrote {place}")
    if plot is not None and not stopped:
        from ..show.plot import plot as draw

        draw(found, file=plot)
        notice(f"wrote {plot}")
    if not as_json:
        _show(found)
    if stopped:
        notice(f"partial: {counted[0]:,} of {counted[1]:,} solves were made")
        raise KeyboardInterrupt


def _write_csv(file: Path, found: "Benchmark") -> None:
    """The rows as CSV: times in seconds; those of one attempt in columns that begin with once."""
    head = ["robot", "solver", "task", *FIGURES, *(f"once_{name}" for name in FIGURES)]
    both = (((one.robot, one.solver, one.task), (one, one.once or one)) for one in found.rows)
    write_table(
        file, head, ([*names, *(getattr(part, name) for part in parts for name in FIGURES)] for names, parts in both)
    )


def _write_latex(file: Path, found: "Benchmark") -> None:
    """The rows as a LaTeX table (booktabs): success with its interval, median time; one attempt, then with restarts."""
    lines = [
        r"\begin{tabular}{llrrrr}",
        r"\toprule",
        r"robot & solver & one attempt [\%] & median [$\mu$s] & with restarts [\%] & median [$\mu$s] \\",
        r"\midrule",
    ]
    for row in found.rows:
        cells = [name.replace("_", r"\_") for name in (row.robot, row.solver)]
        for one in filter(None, (row.once, row)):
            share = f"{100 * one.solved / one.targets:.4g} [{100 * one.low:.3g}, {100 * one.high:.3g}]"
            cells += [share, _short(1e6 * one.median)]
        lines.append(" & ".join(cells) + r" \\")
    write_whole(file, "\n".join([*lines, r"\bottomrule", r"\end{tabular}", ""]))


def _show(found: "Benchmark") -> None:
    for robot, rows in found.by_robot().items():
        made = table("<\nsolver", *(f">{column}" for column in COLUMNS))
        for row in rows:
            cells = [row.solver]
            for one in filter(None, (row.once, row)):
                share = f"{100 * one.solved / one.targets:.4g}"
                cells += [f"{share} {100 * one.low:.3g}-{100 * one.high:.3g}", _short(1e6 * one.median)]
            made.add_row(*cells, _short(1e6 * row.p99))
        show(f"{robot}: {rows[0].targets} targets ({rows[0].task}), {found.options['restarts']} restarts", made)
    for (robot, solver), why in found.skipped.items():
        notice(f"{robot}: {solver} left out: {why}")


def _short(number: float) -> str:
    return f"{number:.1f}" if number < 100 else f"{number:.0f}"
