"""`ik.plot`: draws a chart of any result in one call, also of studies (benchmarks, tuning, workspaces)."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InvalidOption
from ..motion.trajectory import Trajectory
from ..paths.result import PathResult
from ..robot.joints import Joints
from ..robot.pose import check_target
from ..servo.path_stability import LeastRate, StabilityChart
from ..servo.result import TrackResult
from ..solvers.batch.result import BatchResult
from ..solvers.result import Result
from ..solvers.solutions import Solutions
from ..solvers.solve import require_robot
from ..study.benchmark import Benchmark
from ..study.calibration import Calibration
from ..study.place import Placements
from ..study.reachability_map import ReachabilityMap
from ..study.tune import TuneResult
from ..study.workspace import Workspace
from ..style import COLOURS, GREY
from ..text import length
from .plots import (
    SUFFIXES,
    charts,
    convergence,
    drawing,
    literal_text,
    plot_motion,
    plot_track,
    raster,
    save,
    skeletons,
    tracking_errors,
    two_views,
)
from .reach_pictures import plot_map, plot_places


def plot(what: Any, robot: Joints | None = None, *, target: Any = None, file: str | Path | None = None) -> Any:
    """Draw a chart of any result as a matplotlib Figure, which a notebook cell that ends with it shows.

    Args:
        what: A Result with history, or a dict label -> Result, for the error after every iteration; a TrackResult, or a
            dict label -> TrackResult for their errors; a PathResult or Trajectory for joints, speeds and bounds; a
            Benchmark, TuneResult, ReachabilityMap, Placements or Workspace; a Calibration for its residuals and errors; a
            LeastRate or StabilityChart; a BatchResult for the share solved within so many iterations; Solutions, the first eight
            as lines; a configuration q (n,) [rad or m] or a dict label -> q for the arm as lines from the side and from above.
        robot: The Robot or Tree, which a TrackResult, a Workspace and configurations need.
        target: Pose or position [m] in the base frame, drawn as a cross in a chart of configurations.
        file: File to which the chart is also written (.png, .pdf, .svg).

    Returns:
        The Figure.

    Raises:
        InvalidOption: There is no chart for this, the robot is missing, or the file has another suffix.
        InvalidConfiguration, InvalidTarget: A configuration or the target is wrong.
        MissingExtra: matplotlib is not installed.
    """
    if isinstance(robot, str | Path):
        drawn = Path(robot).suffix.lower() in SUFFIXES
        meant = f"to write the chart give file={str(robot)!r}" if drawn else "see Robot.load"
        raise InvalidOption(f"a Robot or a Tree is needed as robot=, not {str(robot)!r:.60}; {meant}")
    several = tuple(what.values()) if isinstance(what, Mapping) else (what,)
    if not several:
        raise InvalidOption("there is nothing to draw: the dict is empty; see help(ik.plot)")
    alone = next((draw for kind, draw in ALONE.items() if isinstance(what, kind)), None)
    if alone is not None:
        figure = alone(what)
    elif isinstance(what, Workspace):
        figure = plot_workspace(what, _needed(robot, "a workspace"))
    elif isinstance(what, Solutions):
        figure = postures({f"solution {k}": q for k, q in enumerate(what.q[: len(COLOURS)])}, what.robot, target)
    elif isinstance(what, TrackResult):
        figure = plot_track(what, _needed(robot, "a tracking run"))
    elif all(isinstance(one, TrackResult) for one in several):
        figure = tracking_errors(what)
    elif all(isinstance(one, Result) for one in several):
        figure = convergence(what)
    elif all(isinstance(one, list | tuple | np.ndarray | str) for one in several):
        figure = postures(what, _needed(robot, "configurations"), target)
    else:
        raise InvalidOption(f"there is no chart of a {type(several[0]).__name__}; see help(ik.plot)")
    if file is not None:
        with drawing():  # saved in this package's style, which keeps text as text in an .svg file
            save(figure, file)
    return figure


def _needed(robot: Joints | None, what: str) -> Joints:
    if robot is None:
        raise InvalidOption(f"the chart of {what} needs the robot: ik.plot(what, robot)")
    require_robot(robot)
    return robot


def postures(q: Any, robot: Joints, target: Any = None) -> Any:
    """Draw the arm at q (n,) [rad or m], or at each q of a dict label -> q, as lines from the side and from above."""
    named = {str(label): one for label, one in q.items()} if isinstance(q, Mapping) else {"": q}
    with charts(1, 2, (8.2, 3.6)) as (figure, axes):
        for k, (label, one) in enumerate(named.items()):
            arms = skeletons(robot, robot.check_q(one))
            for axis, keep in two_views(axes):
                for number, points in enumerate(arms):
                    name = literal_text(label) if not number and label else None
                    axis.plot(*points[:, keep].T, "o-", color=COLOURS[k % 8], lw=2.4, ms=4, label=name)
        for axis, (i, j) in two_views(axes):
            if target is not None:
                T = check_target(target)[0]
                x = T[:3, 3] if T.ndim == 2 else T
                axis.plot(x[i], x[j], "x", color=COLOURS[1], ms=10, mew=2.5, label="target")
            axis.set_aspect("equal", adjustable="datalim")
            axis.margins(0.1)
        if axes[0].get_legend_handles_labels()[0]:
            figure.legend(*axes[0].get_legend_handles_labels(), loc="outside right upper", fontsize=8)
    return figure


def plot_benchmark(found: Benchmark) -> Any:
    """Draw a Benchmark, a row for each robot: success rates with 95 % intervals, and the share of targets solved within a time."""
    robots = found.by_robot()
    # in one order, so that a solver has the same colour for every robot
    solvers = list(dict.fromkeys(row.solver for row in found.rows))
    height = 0.7 + len(robots) * max(2.4, 0.7 + 0.3 * len(solvers))
    with charts(len(robots), 2, (9.0, height), squeeze=False) as (figure, axes):
        for (bars, times), (robot, rows) in zip(axes, robots.items(), strict=True):
            for k, row in enumerate(rows):
                at = solvers.index(row.solver)
                style = {"color": COLOURS[at % len(COLOURS)], "ls": ("-", "--", ":")[at // len(COLOURS) % 3]}
                bars.barh(-k, 100.0 * row.solved / row.targets, color=style["color"], height=0.62)
                bars.plot([100.0 * row.low, 100.0 * row.high], [-k, -k], color="black", lw=1.2, marker="|", ms=6)
                seconds = np.append(np.sort(row.seconds[: row.solved]), row.seconds.max())
                share = 100.0 * np.append(np.arange(1, row.solved + 1), row.solved) / row.targets
                times.step(1e6 * seconds, share, where="post", **style)
            bars.set_yticks(-np.arange(len(rows)), [literal_text(row.solver) for row in rows])
            bars.grid(False, axis="y")
            bars.set(xlim=(0, 102), xlabel="of 100 targets")
            bars.set_title(literal_text(f"{robot}: targets solved, 95 % interval"))
            times.set(xscale="log", ylim=(0, 102), title="solved within a time; colours as on the left")
            times.set(ylabel="of 100 targets", xlabel="time of a solve [us]")
        return figure


def plot_batch(batch: BatchResult) -> Any:
    """Draw a BatchResult: the share of targets solved within a number of iterations, and the errors of targets not solved."""
    good = batch.success
    with charts(1, 1, (6.2, 3.2)) as (figure, axis):
        steps = np.maximum(np.sort(batch.iterations[good]), 1)
        share = 100.0 * np.arange(1, len(steps) + 1) / max(len(batch), 1)
        axis.step(np.append(steps, steps[-1:]), np.append(share, share[-1:]), where="post", color=COLOURS[0])
        axis.set(ylim=(0, 102), xlabel="iterations", ylabel="of 100 targets")
        if len(steps) and steps[-1] > 20 * steps[0]:
            axis.set_xscale("log")
            axis.xaxis.set_major_formatter("{x:g}")
        solved = f"{batch.solver} on {batch.plan.robot.name}: {good.sum()} of {len(batch)} solved"
        off = "" if good.all() else f", of the others at most {length(float(batch.position_error[~good].max()))} off"
        axis.set_title(literal_text(solved + off))
    return figure


def plot_least_rate(found: LeastRate) -> Any:
    """Draw a LeastRate: by how much a small error grows per step, over the sample rate, with the ranges of stable rates marked."""
    with charts(1, 1, (6.2, 3.4)) as (figure, axis):
        for low, high in found.bands:
            axis.axvspan(low, high, color=COLOURS[0], alpha=0.15, lw=0)
        axis.loglog(found.rates, np.clip(found.growth, 1e-12, 1e12), color=COLOURS[0])
        axis.axhline(1.0, color="black", lw=0.8)
        for formatter in (axis.xaxis.set_major_formatter, axis.xaxis.set_minor_formatter):
            formatter("{x:g}")
        axis.set(xlabel="sample rate [Hz]", ylabel="factor of a small error over the path")
        stable = f"stable from {found.rate:.4g} to {found.most:.4g} Hz"
        axis.set_title(stable if found.rate < np.inf else f"unstable at {found.most:.4g} Hz")
        return figure


def plot_stability(chart: StabilityChart) -> Any:
    """Draw a StabilityChart. Raises InvalidOption if it has only one row or column."""
    if min(chart.per_step.shape) < 2:
        raise InvalidOption("a chart of stability needs at least two values of gain and two of samples to be drawn")
    with charts(1, 1, (6.2, 4.2)) as (figure, axis):
        figure.colorbar(stability_map(axis, chart), label="factor of a small error in a sample")
        axis.set_title(literal_text(f"{chart.robot} along '{chart.path}': {chart.method}"))
    return figure


def stability_map(axis: Any, chart: StabilityChart) -> Any:
    """Draw a StabilityChart into a matplotlib axis: the stable region, darker where errors die out faster.

    Returns the drawn colours, for a colour bar.
    """
    points = chart.gain, chart.travel, chart.per_step
    shades = axis.contourf(*points, levels=[0.0, 0.5, 0.7, 0.8, 0.9, 0.95, 1.0], cmap="Blues_r", vmin=-0.2, vmax=1.15)
    axis.contour(*points, levels=[1.0], colors="black", linewidths=1.2)
    name = r"$\kappa$ h" if chart.method == "cv" else rf"$k_D$ h, with $k_P$ = {chart.shape:.4g} $k_D^2$"
    axis.set(xlim=(0.0, chart.gain[-1]), ylim=(0.0, chart.travel.max()), xlabel=name)
    axis.set_ylabel("target's travel in a sample [m]")
    return shades


def plot_calibration(found: Calibration) -> Any:
    """Draw a Calibration: residuals of the measurements for nominal and corrected arm, and the arm's errors with 95 % intervals."""
    turns = {one.name: one.turns for one in found.unknowns}
    base = {one.name for one in found.unknowns if one.group == "base"}
    height = 1.0 + 0.17 * max(12, *(sum(turns[name] == kind for name in found.errors) for kind in (False, True)))
    with charts(1, 3, (11.0, height), width_ratios=(3, 2, 2)) as (figure, axes):
        rows, out = np.arange(len(found.after)), list(found.outliers)
        axes[0].semilogy(rows, 1e3 * found.before, "o", color=GREY, ms=3.5, label="as drawn")
        axes[0].semilogy(rows, 1e3 * found.after, "o", color=COLOURS[0], ms=3.5, label="corrected")
        if out:
            axes[0].semilogy(out, 1e3 * found.after[out], "o", color=COLOURS[1], ms=5, label="outlier, left out")
        axes[0].set(xlabel="measurement (row)", ylabel="off by [mm]")
        drawn, corrected = map(length, found.rms)
        axes[0].set_title(literal_text(f"{found.drawn.name}: {drawn} as drawn, {corrected} corrected (RMS)"))
        axes[0].legend(fontsize=8)
        for axis, kind, scale, unit in ((axes[1], False, 1e3, "mm"), (axes[2], True, 180.0 / np.pi, "deg")):
            # Errors of the base are left out (the table has them): they may be metres, beside which no error of the arm could be
            # seen.
            names = [name for name in found.errors if turns[name] == kind and name not in base]
            x, half = scale * np.reshape([found.errors[name] for name in names], (-1, 2)).T
            y = -np.arange(len(names))
            axis.errorbar(x, y, xerr=half, fmt="o", color=COLOURS[0], ms=3.5, lw=1.2)
            axis.set_yticks(y, [literal_text(name) for name in names], fontsize=7)
            axis.axvline(0.0, color="black", lw=0.8)
            axis.set(xlabel=f"error [{unit}]", title=f"{'angles' if kind else 'lengths'}, 95 % interval")
        return figure


def plot_tuning(result: TuneResult) -> Any:
    """Draw the progress of a tuning run: cost over generations, with the result on held-out targets in the title."""
    with charts(1, 1, (6.2, 3.4)) as (figure, axis):
        generation, (best, now, median) = np.arange(1, len(result.history) + 1), result.history.T[:3]
        axis.semilogy(generation, median, color=GREY, lw=1, label="median of the generation")
        axis.semilogy(generation, now, color=COLOURS[1], lw=1, label="best of the generation")
        axis.semilogy(generation, best, color=COLOURS[0], lw=2, label="best so far")
        axis.set(xlabel="generation", ylabel="cost (1 = all targets fail)")
        before, after, low, high = (
            1000 * x for x in (result.before.share, result.held_out.share, *result.held_out.interval)
        )
        words = f"{before:.1f} before,\n{after:.1f} [{low:.1f}, {high:.1f}] of 1000 held-out targets after"
        axis.set_title(literal_text(f"{result.solver} on {result.robot}, {result.method}: {words}"))
        axis.legend(loc="upper right")
        return figure


def plot_workspace(found: Workspace, robot: Joints) -> Any:
    """Draw, for each solver, the failure rate seen from above and from the side; failures are marked if they are few.

    The scale ends at the largest rate of any cell, so that rare failures are visible. The robot is drawn at home for
    reference.
    """
    rows, drawn = len(found.outcomes), []
    worst = 1.0  # [%] upper end of the colour scale; it is raised to the largest failure rate of any cell
    with charts(rows, 2, (7.4, 0.3 + 4.0 * rows), squeeze=False) as (figure, axes):
        for row, (name, outcome) in zip(axes, found.outcomes.items(), strict=True):
            few = outcome.targets - outcome.solved <= 200
            bad = found.failures[name] if few else np.empty((0, 4))
            ends = found.low + found.cell * np.array(found.map[name].shape[1:])
            for axis, keep in two_views(row[::-1]):
                # sum over the axis along which this view looks
                targets, solved = found.map[name].sum(axis=4 - sum(keep))
                with np.errstate(invalid="ignore"):
                    rate = np.where(targets > 0, 100.0 * (1.0 - solved / targets), np.nan)
                worst = max(worst, float(np.nanmax(rate)))
                drawn.append(raster(axis, rate, found.low[[*keep]], ends[[*keep]], cmap="PuBu"))
                for points in skeletons(robot, robot.home):
                    axis.plot(*points[:, keep].T, color=COLOURS[6], lw=2.2, marker="o", ms=3.5)
                axis.plot(*bad[:, keep].T, "o", mfc="none", mec=COLOURS[1], ms=3, mew=0.7)
                axis.set_aspect("equal")
            row[0].set_title(f"{literal_text(name)}\n{outcome.solved} of {outcome.targets} solved, from above")
            row[1].set_title("circles: not solved\nfrom the side" if len(bad) else "from the side")
        for one in drawn:
            # The scale begins below 0, so that cells without failures are pale; white is for cells without targets.
            one.set_clim(-0.15 * worst, worst)
        scale = {"boundaries": np.linspace(0.0, worst, 101), "ticks": np.linspace(0.0, worst, 5)}
        shape = {"shrink": min(0.8, 1.6 / rows), "aspect": 30, "pad": 0.02}
        figure.colorbar(drawn[-1], ax=axes, label="failures [%]", **scale, **shape)
        return figure


# the function that draws each type of result which needs no robot or target
ALONE: dict[type, Callable[[Any], Any]] = {
    PathResult: plot_motion,
    Trajectory: plot_motion,
    Benchmark: plot_benchmark,
    ReachabilityMap: plot_map,
    LeastRate: plot_least_rate,
    StabilityChart: plot_stability,
    Placements: plot_places,
    TuneResult: plot_tuning,
    BatchResult: plot_batch,
    Calibration: plot_calibration,
}
