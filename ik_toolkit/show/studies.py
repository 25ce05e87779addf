"""Figures of studies: benchmarks, convergence of a tuning run, failures over the workspace."""

from typing import Any

import numpy as np

from ..robot.joints import Joints
from ..study.benchmark import Benchmark
from ..study.tune import TuneResult
from ..study.workspace import Workspace
from ..style import COLOURS, GREY
from .plots import drawing, plain
from .tracking import skeleton


def plot_benchmark(found: Benchmark) -> Any:
    """Draw, one row per robot, the success rate with its 95 % interval, and the share of targets solved over time."""
    robots = found.by_robot()
    solvers = list(dict.fromkeys(row.solver for row in found.rows))  # each solver has the same colour everywhere
    with drawing() as plt:
        height = 0.7 + len(robots) * max(2.4, 0.7 + 0.3 * len(solvers))
        figure, axes = plt.subplots(len(robots), 2, figsize=(9.0, height), layout="constrained", squeeze=False)
        for (bars, times), (robot, rows) in zip(axes, robots.items(), strict=True):
            for k, row in enumerate(rows):
                at = solvers.index(row.solver)
                style = {"color": COLOURS[at % len(COLOURS)], "ls": ("-", "--", ":")[at // len(COLOURS) % 3]}
                bars.barh(-k, 100.0 * row.solved / row.targets, color=style["color"], height=0.62)
                bars.plot([100.0 * row.low, 100.0 * row.high], [-k, -k], color="black", lw=1.2, marker="|", ms=6)
                seconds = np.append(np.sort(row.seconds[: row.solved]), row.seconds.max())
                share = 100.0 * np.append(np.arange(1, row.solved + 1), row.solved) / row.targets
                times.step(1e6 * seconds, share, where="post", **style)
            bars.set_yticks(-np.arange(len(rows)), [plain(row.solver) for row in rows])
            bars.grid(False, axis="y")
            bars.set(xlim=(0, 102), title=plain(f"{robot}: targets solved, 95 % interval"), xlabel="of 100 targets")
            times.set(
                xscale="log",
                ylim=(0, 102),
                title="solved within a time; colours as on the left",
                ylabel="of 100 targets",
                xlabel="time of a solve [us]",
            )
        return figure


LEAST_RATE = 1.0  # [%] least end of a map's colour scale, when hardly anything fails
MARKED = 200  # most failures that are marked individually


def plot_tuning(result: TuneResult) -> Any:
    """Draw cost over generations, with the held-out result in the title."""
    with drawing() as plt:
        figure, axis = plt.subplots(figsize=(6.2, 3.4), layout="constrained")
        generation = np.arange(1, len(result.history) + 1)
        axis.semilogy(generation, result.history[:, 2], color=GREY, lw=1, label="median of the generation")
        axis.semilogy(generation, result.history[:, 1], color=COLOURS[1], lw=1, label="best of the generation")
        axis.semilogy(generation, result.history[:, 0], color=COLOURS[0], lw=2, label="best so far")
        axis.set(xlabel="generation", ylabel="cost (1 = all targets fail)")
        low, high = result.held_out.interval
        axis.set_title(
            plain(f"{result.solver} on {result.robot}, {result.method}: {1000 * result.before.share:.1f} before,\n")
            + f"{1000 * result.held_out.share:.1f} [{1000 * low:.1f}, {1000 * high:.1f}] of 1000 held-out targets after"
        )
        axis.legend(loc="upper right")
        return figure


def plot_workspace(found: Workspace, robot: Joints) -> Any:
    """Draw, for each solver, the failure rate seen from above and from the side; failures are marked if they are few.

    The scale ends at the largest rate of any cell, so that rare failures are visible. The robot is drawn at home for reference.
    """
    arms = [skeleton(arm, robot.home[place]) for arm, place in zip(robot.arms, robot.places, strict=True)]
    with drawing() as plt:
        rows = len(found.outcomes)
        figure, axes = plt.subplots(rows, 2, figsize=(7.4, 0.3 + 4.0 * rows), layout="constrained", squeeze=False)
        image, worst, drawn = None, LEAST_RATE, []
        for row, (name, outcome) in zip(axes, found.outcomes.items(), strict=True):
            for axis, across, keep in ((row[0], 2, (0, 1)), (row[1], 1, (0, 2))):
                targets, solved = found.map[name].sum(axis=1 + across)
                with np.errstate(invalid="ignore"):
                    rate = np.where(targets > 0, 100.0 * (1.0 - solved / targets), np.nan)
                worst = max(worst, float(np.nanmax(rate)))
                ends = found.low + found.cell * np.array(found.map[name].shape[1:])
                extent = (found.low[keep[0]], ends[keep[0]], found.low[keep[1]], ends[keep[1]])
                image = axis.imshow(rate.T, origin="lower", extent=extent, cmap="PuBu", interpolation="nearest")
                drawn.append(image)
                axis.grid(False)
                for arm in arms:
                    axis.plot(*arm[:, keep].T, color=COLOURS[6], lw=2.2, marker="o", ms=3.5)
                bad = found.failures[name] if outcome.targets - outcome.solved <= MARKED else np.empty((0, 4))
                axis.plot(bad[:, keep[0]], bad[:, keep[1]], "o", mfc="none", mec=COLOURS[1], ms=3, mew=0.7)
                axis.set(xlabel=f"{'xyz'[keep[0]]} [m]", ylabel=f"{'xyz'[keep[1]]} [m]", aspect="equal")
            row[0].set_title(f"{plain(name)}\n{outcome.solved} of {outcome.targets} solved, from above")
            row[1].set_title("circles: not solved\nfrom the side" if len(bad) else "from the side")
        for one in drawn:
            one.set_clim(-0.15 * worst, worst)  # zero failures are pale, not white: white means no target
        figure.colorbar(
            image,
            ax=axes,
            label="failures [%]",
            boundaries=np.linspace(0.0, worst, 101),
            ticks=np.linspace(0.0, worst, 5),
            shrink=min(0.8, 1.6 / rows),
            aspect=30,
            pad=0.02,
        )
        return figure
