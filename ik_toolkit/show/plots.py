"""Charts in one style, readable in print, in grey and with colour blindness. Each returns a matplotlib Figure.

There are charts of solves, tracking runs (the arm along its path, errors, joints and speeds relative to their limits), paths and
trajectories. Lines differ in dashes as well as in colour, so that nothing depends on colour alone; `save` writes a file.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InvalidOption, MissingExtra
from ..files import as_output, whole_file
from ..robot.joints import Joints
from ..servo.result import TrackResult
from ..style import COLOURS, DASHES, GREY, PALE, STYLE
from ..text import length
from .body import skeleton

FLOOR = 1e-12  # [m, rad] smaller errors are drawn at this value, because a logarithmic axis has no zero
SUFFIXES = (".png", ".pdf", ".svg")
COLUMNS = 5  # The legend with the names of the joints has at most this many columns.


@contextmanager
def drawing(style: Any = STYLE) -> Iterator[Any]:
    """Context manager: yield matplotlib's pyplot in this package's style; in the end close new figures. Raises MissingExtra."""
    try:
        import matplotlib.pyplot as plt
    except ImportError:
        raise MissingExtra("matplotlib", "plots") from None
    before = set(plt.get_fignums())
    with plt.rc_context(style):
        try:
            yield plt
        finally:
            for number in set(plt.get_fignums()) - before:
                plt.close(number)
            interactive = plt.isinteractive()
    # Loading the backend for the first figure may switch interactive mode on or off, so it is restored.
    if interactive != plt.isinteractive():
        plt.ion() if interactive else plt.ioff()


@contextmanager
def charts(rows: int, columns: int, size: tuple[float, float], **more: Any) -> Iterator[tuple[Any, Any]]:
    """Context manager: yield a new figure of a size [inches] in this package's style, and its axes (an array, or one)."""
    with drawing() as plt:
        yield plt.subplots(rows, columns, figsize=size, layout="constrained", **more)


def literal_text(text: str) -> str:
    """Escape text so that matplotlib draws it literally: text between two dollar signs would be typeset as a formula."""
    return text.replace("$", r"\$")


def two_views(axes: Sequence[Any]) -> Iterator[tuple[Any, tuple[int, int]]]:
    """Label two matplotlib axes as view from the side and from above; yield each with its coordinates, (0, 2) or (0, 1)."""
    for axis, (i, j), side in zip(axes, ((0, 2), (0, 1)), ("from the side", "from above"), strict=True):
        axis.set(xlabel=f"{'xyz'[i]} [m]", ylabel=f"{'xyz'[j]} [m]", title=side)
        yield axis, (i, j)


def skeletons(robot: Joints, q: np.ndarray) -> list[np.ndarray]:
    """Return the points (K, 3) [m] of each arm at q (n,), in the base frame."""
    return [skeleton(arm, q[place]) for arm, place in zip(robot.arms, robot.places, strict=True)]


def raster(axis: Any, values: np.ndarray, low: Any, high: Any, **look: Any) -> Any:
    """Draw values (X, Y) as coloured cells between two corners (2,) [m]; return matplotlib's image, for a colour bar."""
    axis.grid(False)
    extent = (low[0], high[0], low[1], high[1])
    return axis.imshow(values.T, origin="lower", extent=extent, interpolation="nearest", **look)


def save(figure: Any, path: str | Path) -> Path:
    """Write a figure to a .png, .pdf or .svg file. Raises InvalidOption for another suffix."""
    file = as_output(path, "a plot", *SUFFIXES)
    with whole_file(file) as stream:
        figure.savefig(stream, format=file.suffix[1:].lower(), dpi=160)
    return file


def convergence(runs: Any, *, title: str = "") -> Any:
    """Draw the error after every iteration of a solve, several solvers side by side, on one logarithmic scale.

    The attempt that found the result is drawn up to it, the position [m] as a solid line, the orientation [rad] dashed;
    the other attempts are thin and grey. runs is a Result with history, or a dict label -> Result. Labels and title are
    drawn literally, never as formulas. Raises InvalidOption for a result without history.
    """
    named = runs if isinstance(runs, Mapping) else {runs.solver: runs}
    if not named:
        raise InvalidOption("there are no runs to draw")
    for label, run in named.items():
        if run.history is None:
            raise InvalidOption(f"the result {label!r} has no history: solve with history=True")
    size = (min(11.0, 2.0 + 2.6 * len(named)) if len(named) > 1 else 5.6, 3.3)
    with charts(1, len(named), size, sharey=True, squeeze=False) as (figure, axes):
        for k, (axis, (label, run)) in enumerate(zip(axes[0], named.items(), strict=True)):
            _, *errors, others = iterates(run)
            every, position, angle = (np.maximum(x, FLOOR) for x in (run.history["position_error"], *errors))
            for other in others:
                name = None if k or other is not others[0] else "other attempts [m]"
                axis.semilogy(every[other], color=COLOURS[7], alpha=0.5, lw=0.7, label=name)
            few = "o" if len(position) < 40 else None
            axis.semilogy(position, color=COLOURS[0], marker=few, ms=3, label="position [m]")
            if np.isfinite(angle).any():
                axis.semilogy(angle, color=COLOURS[1], ls="--", marker=few, ms=3, label="orientation [rad]")
            axis.xaxis.get_major_locator().set_params(integer=True)
            axis.set(xlabel="iteration", title=literal_text(f"{label}: {len(position) - 1} iterations"))
        axes[0, 0].set_ylabel("error (log scale)")
        axes[0, 0].legend(loc="best", fontsize=8)
        if title:
            figure.suptitle(literal_text(title), x=0.01, ha="left", fontweight="bold", fontsize=10)
    return figure


def iterates(result: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[np.ndarray]]:
    """Return the iterations of the attempt that found a Result: joint values (N, n), position errors [m] and angles [rad].

    The Result must have a history. The iterations end at the result; an angle that does not count is NaN. A fourth value lists
    the rows of the history that belong to each of the first twelve other attempts.
    """
    history, number = result.history, result.history["attempt"]
    same = np.flatnonzero((history["q"] == result.q).all(axis=1))
    last = int(same[-1]) if len(same) else len(number) - 1
    rows = np.flatnonzero(number[: last + 1] == number[last])
    Q, position, angle = (np.asarray(history[key])[rows] for key in ("q", "position_error", "orientation_error"))
    if not len(same):  # The result is not in the history if it was refined after the search, so it is added.
        Q, position = np.vstack([Q, result.q]), np.append(position, result.position_error)
        angle = np.append(angle, np.nan if result.orientation_error is None else result.orientation_error)
    return Q, position, angle, [np.flatnonzero(number == one) for one in np.unique(number) if one != number[last]][:12]


def tracking_errors(runs: Mapping[Any, TrackResult]) -> Any:
    """Draw position and orientation error over time of each TrackResult of a dict, on logarithmic scales."""
    turning = any(run.orientation_error is not None for run in runs.values())
    with charts(1 + turning, 1, (6.2, 2.4 + 1.9 * turning), sharex=True, squeeze=False) as (figure, axes):
        for k, (label, run) in enumerate(runs.items()):
            style = {"color": COLOURS[k % 8], "ls": DASHES[k % 8], "lw": 1.3}
            axes[0, 0].semilogy(run.t, np.maximum(run.position_error, FLOOR), label=literal_text(str(label)), **style)
            if run.orientation_error is not None:
                axes[1, 0].semilogy(run.t, np.maximum(run.orientation_error, FLOOR), **style)
        axes[0, 0].set_ylabel("position error [m]")
        if turning:
            axes[1, 0].set_ylabel("orientation error [rad]")
        axes[-1, 0].set_xlabel("time [s]")
        axes[0, 0].legend(fontsize=8, ncols=4, loc="lower left", bbox_to_anchor=(0.0, 1.0))
    return figure


# ----------------------------------------------------------------------------------------------------- motions
def plot_track(result: TrackResult, robot: Joints) -> Any:
    """Draw a TrackResult: the tip's path, and errors, joints and speeds over time. Raises MissingExtra without matplotlib."""
    slowed = result.added_time > 0.0
    with drawing() as plt:
        figure = plt.figure(figsize=(10.5, 8.2 if slowed else 6.8), layout="constrained")
        grid = figure.add_gridspec(2, 2, width_ratios=(1.0, 1.15), wspace=0.1)
        _path_panel(figure.add_subplot(grid[:, 0], projection="3d"), result, robot)
        right = grid[:, 1].subgridspec(3 + slowed, 1, height_ratios=(1.0, 1.0, 1.0, 0.6)[: 3 + slowed])
        axes = right.subplots(sharex=True)
        _errors(axes[0], result)
        _joints(axes[1], robot, result.joint_names, result.t, result.q, [])
        axes[1].set_ylim(-1.15, 1.15)
        axes[1].set_title("joint positions between their limits", loc="left")
        _speeds(axes[2], result, robot)
        if slowed:
            _clock(axes[3], result)
        axes[-1].set_xlabel("time [s]")
        joints = axes[2].get_legend_handles_labels()
        for columns in range(COLUMNS, 0, -1):  # Joint names may be long, so the legend gets as many columns as fit.
            legend = figure.legend(*joints, fontsize=7.5, ncols=columns, loc="outside lower right")
            if columns == 1 or legend.get_window_extent().width < figure.bbox.width:
                break
            legend.remove()
        settings = ", ".join(f"{k} {v:.4g}" for k, v in result.options.items())
        method = f"{result.method} ({settings})" if settings else result.method
        title = literal_text(f"{result.robot}: {method}, {1 / result.dt:.4g} Hz: {result.status.name.lower()}")
        figure.suptitle(title, x=0.01, ha="left", fontweight="bold")
        return figure


def _path_panel(ax: Any, result: TrackResult, robot: Joints) -> None:
    from matplotlib.ticker import MaxNLocator

    count = len(result.t)
    for i, shade in ((0, "#C8C8C8"), (count // 2, "#969696"), (count - 1, "#4D4D4D")):
        for points in skeletons(robot, result.q[i]):
            ax.plot(*points.T, color=shade, lw=2.2, marker="o", ms=3.5, zorder=1)
    ways, wanted = (array.reshape(count, -1, 3) for array in (result.xyz, result.target_xyz))
    for k in range(ways.shape[1]):
        names = ("", "", "") if k else ("target", "tip", "start")
        ax.plot(*wanted[:, k].T, color=COLOURS[6], lw=0.9, ls="--", label=names[0], zorder=3)
        ax.plot(*ways[:, k].T, color=COLOURS[1], lw=2.0, label=names[1], zorder=2)
        ax.plot(*ways[:1, k].T, color=COLOURS[1], marker="s", ms=5, ls="", label=names[2], zorder=4)
    corners = np.vstack([*skeletons(robot, result.q[0]), ways.reshape(-1, 3), wanted.reshape(-1, 3)])
    low, high = corners.min(axis=0), corners.max(axis=0)
    # at least a quarter of the largest side, so that the drawing of a planar arm has some depth
    half = np.maximum(0.5 * (high - low), 0.25 * (high - low).max())
    for middle, size, name in zip(0.5 * (low + high), half, "xyz", strict=True):
        getattr(ax, f"set_{name}lim")(middle - size, middle + size)
    ax.set_box_aspect(half, zoom=0.92)
    ax.view_init(elev=22, azim=-60)
    for name, axis in zip("xyz", (ax.xaxis, ax.yaxis, ax.zaxis), strict=True):
        axis.pane.set_alpha(0.0)
        axis._axinfo["grid"].update(color=PALE, linewidth=0.6)
        axis.set_major_locator(MaxNLocator(3))
        getattr(ax, f"set_{name}label")(f"{name} [m]")
    ax.set_title("arm at start, half time and end (light to dark)", loc="left")
    ax.legend(loc="upper left", fontsize=8)


def _errors(ax: Any, result: TrackResult) -> None:
    turned, t = result.orientation_error, result.t
    ax.semilogy(t, np.maximum(result.position_error, FLOOR), color=COLOURS[0], lw=1.3, label="position [m]")
    if turned is not None:
        ax.semilogy(t, np.maximum(turned, FLOOR), color=COLOURS[4], lw=1.3, label="orientation [rad]")
    held = np.append(result.at_limits.any(axis=1), False)
    if held.any():
        ax.fill_between(t, 0, 1, where=held, transform=ax.get_xaxis_transform(), color=PALE, lw=0, label="at a limit")
    ax.axhline(result.position_tolerance, color=COLOURS[0], lw=0.8, ls=":", label="tolerance")
    if turned is not None:
        ax.axhline(result.orientation_tolerance, color=COLOURS[4], lw=0.8, ls=":")
    ax.set_title("error at the samples", loc="left", pad=20)  # room for the legend between title and curves
    ax.legend(fontsize=8, ncols=4, loc="lower left", bbox_to_anchor=(-0.02, 1.0), borderaxespad=0.0)


def _clock(ax: Any, result: TrackResult) -> None:
    """Draw the clock rate of the reference."""
    ax.stairs(result.sigma, result.t, fill=True, color=PALE)
    ax.stairs(result.sigma, result.t, color=COLOURS[0], lw=1.3)
    ax.set_ylim(0.0, 1.05)
    joint = result.pace_joint
    pace = f", limited by {literal_text(joint)}" if joint else ""
    ax.set_title(f"clock rate: {result.added_time:.3g} s added to {result.clock[-1]:.4g} s{pace}", loc="left")


def _speeds(ax: Any, result: TrackResult, robot: Joints) -> None:
    limit = np.where(robot.velocity_limits > 0, robot.velocity_limits, np.inf)
    bounded = bool(np.isfinite(limit).all())
    speed = np.diff(result.q, axis=0) / result.dt
    _lines(ax, result.t[1:], 100.0 * speed / limit if bounded else speed, result.joint_names)
    ax.set_title("joint speeds" + (" [% of the limit]" if bounded else " [rad/s or m/s]"), loc="left")


def plot_motion(what: Any) -> Any:
    """Draw joints of a PathResult, or joints, speeds and accelerations of a Trajectory. Raises MissingExtra without matplotlib."""
    timed = hasattr(what, "dq")
    with charts(3 if timed else 2, 1, (8.6, 7.2 if timed else 5.6), sharex=True) as (figure, axes):
        x = what.t if timed else what.at
        breaks = [] if timed else [one.index + 0.5 for one in what.reconfigurations]
        _joints(axes[0], what.robot, what.robot.joint_names, x, what.q if timed else what.curve, breaks)
        axes[0].set_title("joints between their limits" + (" (dotted: the branch changes)" if breaks else ""))
        if timed:
            free = np.isnan(what.place)
            for ax, values, limit, title in (
                (axes[1], what.dq, what.velocity, "joint speeds [% of the limit]"),
                (axes[2], what.ddq, what.acceleration, "joint accelerations [% of the limit]"),
            ):
                _lines(ax, x, 100.0 * values / limit, what.robot.joint_names)
                ax.set_title(title)
                ax.set_ylim(-112.0, 112.0)
                _edges(ax, -100.0, 100.0)
            for ax in axes if free.any() else ():
                ax.fill_between(x, 0, 1, where=free, transform=ax.get_xaxis_transform(), color=PALE, lw=0)
            axes[-1].set_xlabel("time [s]" + (" (grey: from one branch to the other)" if free.any() else ""))
            title = f"{what.robot.name}: {what.message}"
        else:
            _deviation(axes[1], what)
            axes[-1].set_xlabel("pose")
            title = f"{what.robot.name}: {what.status.name}, {len(what.q)} poses, length {what.length[0]:.4g} rad"
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=7, fontsize=8)
        figure.suptitle(literal_text(title), x=0.01, ha="left", fontweight="bold")
        return figure


def _lines(ax: Any, x: np.ndarray, values: np.ndarray, names: Sequence[str]) -> None:
    for i, name in enumerate(names):
        ax.plot(x, values[:, i], color=COLOURS[i % 8], ls=DASHES[i // 8 % 8], lw=1.3, label=literal_text(name))


def _edges(ax: Any, *heights: float) -> None:
    for y in heights:
        ax.axhline(y, color=GREY, lw=0.8)


def _joints(
    ax: Any, robot: Joints, names: Sequence[str], x: np.ndarray, Q: np.ndarray, breaks: Sequence[float]
) -> None:
    """Draw joints relative to their limits; those without limits in units of 180 degrees."""
    bounded = np.isfinite(robot.upper - robot.lower)
    low, high = np.where(bounded, robot.lower, -np.pi), np.where(bounded, robot.upper, np.pi)
    shown = (Q - 0.5 * (low + high)) / (0.5 * (high - low))
    for k in breaks:  # NaN leaves a gap in the lines where the path jumps to another branch (reconfiguration).
        after = int(np.searchsorted(x, k))
        x, shown = np.insert(x, after, k), np.insert(shown, after, np.nan, axis=0)
    _lines(ax, x, shown, names)
    _edges(ax, -1.0, 1.0)
    for k in breaks:
        ax.axvline(k, color=GREY, lw=0.9, ls=":")
    ax.set_yticks([-1, 0, 1], ["lower", "middle", "upper"])


def _deviation(ax: Any, result: Any) -> None:
    """Draw the bounds between the poses relative to their tolerances."""
    proof, tolerance = result.continuity, result.path_tolerance
    for values, most, colour, dash, name in (
        (proof.deviation, tolerance[0], COLOURS[0], "-", f"position (1 = {length(tolerance[0])})"),
        (proof.turn, tolerance[1], COLOURS[4], "--", f"orientation (1 = {np.degrees(tolerance[1]):.3g} deg)"),
    ):
        if np.isfinite(values).any():
            ax.stairs(values / most, result.at, color=colour, ls=dash, lw=1.3, label=name, baseline=None)
    for contact in proof.contacts:
        ax.axvline(contact.place, color=COLOURS[1], lw=1.0)
    _edges(ax, 1.0)
    ax.set_ylim(bottom=0.0)
    ax.legend(fontsize=8, loc="upper right", bbox_to_anchor=(1.0, 1.16), ncols=2)
    ax.set_title("bound on the deviation between poses, in tolerances")
