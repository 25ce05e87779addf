"""`ik.plot`: a chart of any result of the toolkit, in one call."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..errors import InvalidOption
from ..paths.result import PathResult
from ..paths.trajectory import Trajectory
from ..robot.joints import Joints
from ..robot.pose import check_target
from ..solvers.result import Result
from ..solvers.solve import require_robot
from ..study.benchmark import Benchmark
from ..study.tune import TuneResult
from ..study.workspace import Workspace
from ..style import COLOURS
from ..tracking.result import TrackResult
from .paths import plot_motion
from .plots import SUFFIXES, convergence, drawing, plain, save, tracking_errors
from .studies import plot_benchmark, plot_tuning, plot_workspace
from .tracking import plot_track, skeleton


def plot(what: Any, robot: Joints | None = None, *, target: Any = None, file: str | Path | None = None) -> Any:
    """Chart of a result as a matplotlib Figure, shown by a notebook cell that ends with it.

    what: a Result with history, or a dict label -> Result (error at every evaluation); a TrackResult (with robot), or a dict
    label -> TrackResult (their errors); a PathResult or Trajectory (joints, speeds, bounds); a Benchmark; a TuneResult; a
    Workspace (with robot); or, with robot, a configuration q (n,) or a dict label -> q: the arm as lines from the side and
    from above, with a target (pose or position [m]) as a cross. file: also write it (.png, .pdf, .svg). Raises InvalidOption,
    InvalidConfiguration, InvalidTarget, MissingExtra.
    """
    if isinstance(robot, str | Path):
        meant = (
            f"to write the chart give file={str(robot)!r}"
            if Path(robot).suffix.lower() in SUFFIXES
            else "see Robot.load"
        )
        raise InvalidOption(f"a Robot or a Tree is needed as robot=, not {str(robot)!r:.60}; {meant}")
    several = tuple(what.values()) if isinstance(what, Mapping) else (what,)
    if isinstance(what, PathResult | Trajectory):
        figure = plot_motion(what)
    elif isinstance(what, Benchmark):
        figure = plot_benchmark(what)
    elif isinstance(what, TuneResult):
        figure = plot_tuning(what)
    elif isinstance(what, Workspace):
        figure = plot_workspace(what, _needed(robot, "a workspace"))
    elif isinstance(what, TrackResult):
        figure = plot_track(what, _needed(robot, "a tracking run"))
    elif several and all(isinstance(one, TrackResult) for one in several):
        figure = tracking_errors(what)
    elif several and all(isinstance(one, Result) for one in several):
        figure = convergence(what)
    else:
        figure = postures(what, _needed(robot, "configurations"), target)
    if file is not None:
        with drawing():  # keeps text as text in an .svg
            save(figure, file)
    return figure


def _needed(robot: Joints | None, what: str) -> Joints:
    if robot is None:
        raise InvalidOption(f"the chart of {what} needs the robot: ik.plot(what, robot)")
    require_robot(robot)
    return robot


def postures(q: Any, robot: Joints, target: Any = None) -> Any:
    """Draw the arm as lines through its joints at q (n,), or at each q of a dict label -> q, from the side and from above."""
    named = {str(label): one for label, one in q.items()} if isinstance(q, Mapping) else {"": q}
    with drawing() as plt:
        figure, axes = plt.subplots(1, 2, figsize=(8.2, 3.6), layout="constrained")
        for k, (label, one) in enumerate(named.items()):
            one = robot.check_q(one)
            arms = [skeleton(arm, one[place]) for arm, place in zip(robot.arms, robot.places, strict=True)]
            for axis, keep in zip(axes, ((0, 2), (0, 1)), strict=True):
                for number, points in enumerate(arms):
                    name = plain(label) if not number and label else None
                    axis.plot(*points[:, keep].T, "o-", color=COLOURS[k % 8], lw=2.4, ms=4, label=name)
        for axis, (i, j), side in zip(axes, ((0, 2), (0, 1)), ("from the side", "from above"), strict=True):
            if target is not None:
                T = check_target(target)[0]
                x = T[:3, 3] if T.ndim == 2 else T
                axis.plot(x[i], x[j], "x", color=COLOURS[1], ms=10, mew=2.5, label="target")
            axis.set(xlabel=f"{'xyz'[i]} [m]", ylabel=f"{'xyz'[j]} [m]", title=side)
            axis.set_aspect("equal", adjustable="datalim")
            axis.margins(0.1)
        if axes[0].get_legend_handles_labels()[0]:
            figure.legend(*axes[0].get_legend_handles_labels(), loc="outside right upper", fontsize=8)
    return figure
