"""Charts in one style, readable in print, in grey and with colour blindness. Each returns a matplotlib Figure.

Lines differ in dashes as well as in colour, so that nothing depends on colour alone. `save` writes a figure to a file.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InvalidOption, MissingExtra
from ..files import as_path, whole_file
from ..robot.joints import Joints
from ..style import COLOURS, DASHES, GREY, PALE, STYLE
from .attempts import attempts

FLOOR = 1e-12  # [m, rad] smaller values are drawn here: a logarithmic axis has no zero
SUFFIXES = (".png", ".pdf", ".svg")


@contextmanager
def drawing(style: Any = STYLE) -> Iterator[Any]:
    """Matplotlib's pyplot in our style; figures made inside are not kept open. Raises MissingExtra."""
    try:
        import matplotlib.pyplot as plt
    except ImportError:
        raise MissingExtra("matplotlib", "plots") from None
    before = set(plt.get_fignums())
    interactive = plt.isinteractive()
    with plt.rc_context(style):
        try:
            yield plt
        finally:
            for number in set(plt.get_fignums()) - before:
                plt.close(number)
            interactive = plt.isinteractive()
    if interactive != plt.isinteractive():  # the first figure loads the backend, and a notebook's changes this
        plt.ion() if interactive else plt.ioff()


def plain(text: str) -> str:
    """Escape text so that matplotlib draws it literally: text between two dollar signs would be typeset as a formula."""
    return text.replace("$", r"\$")


def save(figure: Any, path: str | Path) -> Path:
    """Write a figure to a .png, .pdf or .svg file. Raises InvalidOption for another suffix."""
    file = as_path(path, "file")
    if file.suffix.lower() not in SUFFIXES:
        raise InvalidOption(f"a plot is written as .png, .pdf or .svg, not '{file.suffix or file.name}'")
    with whole_file(file) as stream:
        figure.savefig(stream, format=file.suffix[1:].lower(), dpi=160)
    return file


def convergence(runs: Any, *, tolerance: float | None = None, title: str = "") -> Any:
    """Error at every evaluation of a solve, several solvers side by side, on one logarithmic scale.

    runs: a Result with history, its history, or a dict label -> either. Draws the attempt that found the result, up to it:
    position [m] as a solid line, orientation [rad] dashed; the other attempts thin and grey, each from its own start. Labels and
    title are drawn literally, never as formulas. tolerance [m, rad]: drawn as a line. Raises InvalidOption for a result without
    history.
    """
    named = _named(runs)
    with drawing() as plt:
        width = min(11.0, 2.0 + 2.6 * len(named)) if len(named) > 1 else 5.6
        figure, axes = plt.subplots(
            1, len(named), figsize=(width, 3.3), sharey=True, squeeze=False, layout="constrained"
        )
        for k, (axis, (label, (history, q))) in enumerate(zip(axes[0], named.items(), strict=True)):
            won, others = attempts(history, q)
            drawn = np.maximum(np.asarray(history["position_error"], dtype=float), FLOOR)
            for other in others:
                name = None if k or other is not others[0] else "other attempts [m]"
                axis.semilogy(drawn[other], color=COLOURS[7], alpha=0.5, lw=0.7, label=name)
            position = drawn[won]
            few = "o" if len(position) < 40 else None
            axis.semilogy(position, color=COLOURS[0], marker=few, ms=3, label="position [m]")
            angle = history.get("orientation_error")
            if angle is not None and np.isfinite(np.asarray(angle, dtype=float)).any():
                shown = np.maximum(np.asarray(angle, dtype=float)[won], FLOOR)
                axis.semilogy(shown, color=COLOURS[1], ls="--", marker=few, ms=3, label="orientation [rad]")
            if tolerance is not None:
                axis.axhline(tolerance, color=GREY, lw=0.9, ls=":", label="tolerance" if not k else None)
            axis.xaxis.get_major_locator().set_params(integer=True)
            axis.set(xlabel="evaluation", title=plain(f"{label}: {len(position) - 1} steps") if label else "")
        axes[0, 0].set_ylabel("error (log scale)")
        axes[0, 0].legend(loc="best", fontsize=8)
        _title(figure, title)
    return figure


def joint_paths(q: Any, robot: Joints, *, t: Any = None, title: str = "") -> Any:
    """Each joint's value over time or over steps; grey marks the range outside its limits.

    q (N, n) [rad or m], robot for names, kinds and limits; t (N,) [s], else steps. Angles are drawn in degrees.
    """
    Q = _matrix(q, robot.n)
    x = np.arange(len(Q)) if t is None else np.asarray(t, dtype=float)
    with drawing() as plt:
        columns = min(3, robot.n)
        rows = -(-robot.n // columns)
        figure, axes = plt.subplots(
            rows,
            columns,
            figsize=(3.0 * columns + 0.6, 1.75 * rows + 0.5),
            sharex=True,
            squeeze=False,
            layout="constrained",
        )
        for i, axis in enumerate(axes.flat):
            if i >= robot.n:
                axis.set_axis_off()
                continue
            angle = robot.joint_kinds[i] != "prismatic"
            scale = np.degrees(1.0) if angle else 1.0
            lower, upper, values = scale * robot.lower[i], scale * robot.upper[i], scale * Q[:, i]
            bounded = np.isfinite(lower) and np.isfinite(upper)
            low, high = (lower, upper) if bounded else (values.min(), values.max())
            pad = 0.08 * max(high - low, 1e-6)
            low, high = min(low, values.min()) - pad, max(high, values.max()) + pad
            axis.set_ylim(low, high)
            for edge, end in ((lower, low), (upper, high)):
                if np.isfinite(edge):
                    axis.axhspan(*sorted((edge, end)), color=PALE, lw=0)
                    axis.axhline(edge, color=GREY, lw=0.8)
            axis.plot(x, values, color=COLOURS[0])
            axis.set_title(plain(f"{robot.joint_names[i]} [{'deg' if angle else 'm'}]"))
            if i + columns >= robot.n:
                axis.set_xlabel("time [s]" if t is not None else "step")
                axis.tick_params(labelbottom=True)
        _title(figure, title)
    return figure


def tracking_errors(runs: Any, *, title: str = "") -> Any:
    """Position and orientation error over time of one or several tracking runs, on logarithmic scales.

    runs: a TrackResult or a dict label -> TrackResult.
    """
    named = runs if isinstance(runs, Mapping) else {getattr(runs, "method", ""): runs}
    turning = [run.orientation_error is not None for run in named.values()]
    with drawing() as plt:
        figure, axes = plt.subplots(
            1 + any(turning),
            1,
            figsize=(6.2, 2.4 + 1.9 * any(turning)),
            sharex=True,
            squeeze=False,
            layout="constrained",
        )
        for k, (label, run) in enumerate(named.items()):
            style = {"color": COLOURS[k % 8], "ls": DASHES[k % 8], "lw": 1.3}
            axes[0, 0].semilogy(run.t, np.maximum(run.position_error, FLOOR), label=plain(label), **style)
            if run.orientation_error is not None:
                axes[1, 0].semilogy(run.t, np.maximum(run.orientation_error, FLOOR), **style)
        axes[0, 0].set_ylabel("position error [m]")
        if any(turning):
            axes[1, 0].set_ylabel("orientation error [rad]")
        axes[-1, 0].set_xlabel("time [s]")
        axes[0, 0].legend(fontsize=8, ncols=4, loc="lower left", bbox_to_anchor=(0.0, 1.0))
        _title(figure, title)
    return figure


def stability_region(
    x: Any,
    y: Any,
    radius: Callable[[float, float], float] | Any,
    *,
    xlabel: str,
    ylabel: str,
    marks: Mapping[str, tuple[float, float]] | None = None,
    title: str = "",
) -> Any:
    """Stability of a method: the spectral radius over two gains, with the contour at 1 emphasised.

    x (X,), y (Y,): the gains; radius: array (Y, X), or a function of (x, y). marks: label -> (x, y), e.g. gains in use.
    """
    X, Y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    R = np.array([[radius(a, b) for a in X] for b in Y]) if callable(radius) else np.asarray(radius, dtype=float)
    if R.shape != (len(Y), len(X)):
        raise InvalidOption(f"radius must have the shape ({len(Y)}, {len(X)}), rows by y, not {R.shape}")
    with drawing() as plt:
        figure, axis = plt.subplots(figsize=(5.4, 4.0), layout="constrained")
        axis.grid(False)
        filled = axis.contourf(X, Y, np.clip(R, 0.0, 2.0), levels=np.linspace(0.0, 2.0, 21), cmap="cividis_r")
        axis.contour(X, Y, R, levels=[1.0], colors="black", linewidths=1.8)
        for k, (label, point) in enumerate((marks or {}).items()):
            axis.plot(*point, ls="", marker="os^Dv"[k % 5], mfc="white", mec="black", ms=7, label=label)
        if marks:
            axis.legend(fontsize=8, loc="upper right", frameon=True)
        bar = figure.colorbar(filled, ax=axis, ticks=[0, 0.5, 1, 1.5, 2])
        bar.set_label("spectral radius (below 1: stable; 2: and above)")
        axis.set(xlabel=xlabel, ylabel=ylabel)
        _title(figure, title)
    return figure


def success_map(points: Any, success: Any, *, title: str = "") -> Any:
    """Targets (N, 3) [m] seen from the side and from above; unreached ones are drawn as crosses on top."""
    P, good = _matrix(points, 3), np.asarray(success, dtype=bool)
    if good.shape != (len(P),):
        raise InvalidOption(f"success must have one value per point ({len(P)}), not shape {good.shape}")
    with drawing() as plt:
        figure, axes = plt.subplots(1, 2, figsize=(8.2, 3.9), layout="constrained")
        for axis, (i, j), side in zip(axes, ((0, 2), (0, 1)), ("from the side", "from above"), strict=True):
            axis.plot(*P[good][:, [i, j]].T, ls="", marker="o", ms=2.2, mec="none", color=COLOURS[5], label="reached")
            axis.plot(*P[~good][:, [i, j]].T, ls="", marker="x", ms=5, mew=1.1, color=COLOURS[1], label="not reached")
            axis.set(xlabel=f"{'xyz'[i]} [m]", ylabel=f"{'xyz'[j]} [m]", title=side)
            axis.set_aspect("equal", adjustable="datalim")
        axes[0].legend(fontsize=8, loc="lower left", bbox_to_anchor=(0.0, 1.06), ncols=2, handletextpad=0.3)
        _title(figure, f"{title + ': ' if title else ''}{good.sum()} of {len(good)} reached")
    return figure


def bars(
    values: Mapping[str, float],
    intervals: Mapping[str, tuple[float, float]] | None = None,
    *,
    unit: str,
    log: bool = False,
    title: str = "",
) -> Any:
    """Horizontal bars with intervals and numbers, in the given order (for benchmarks).

    values: label -> value; intervals: label -> (low, high), drawn as a whisker; unit: axis label.
    """
    names = list(values)
    x = np.array([values[name] for name in names], dtype=float)
    with drawing() as plt:
        figure, axis = plt.subplots(figsize=(6.4, 0.9 + 0.36 * len(names)), layout="constrained")
        place = np.arange(len(names))[::-1]
        axis.barh(place, x, color=COLOURS[5], height=0.62)
        ends = x.copy()
        for k, name in enumerate(names):
            if intervals and name in intervals:
                low, high = intervals[name]
                axis.plot([low, high], [place[k]] * 2, color="black", lw=1.2, marker="|", ms=6)
                ends[k] = max(ends[k], high)
        if log:
            axis.set_xscale("log")
        for at, value, end in zip(place, x, ends, strict=True):
            axis.annotate(f"{value:.4g}", (end, at), xytext=(5, 0), textcoords="offset points", va="center", fontsize=8)
        axis.set_yticks(place, [plain(name) for name in names])
        axis.grid(False, axis="y")
        axis.tick_params(axis="y", length=0)
        axis.margins(x=0.14)
        axis.set_xlabel(unit)
        _title(figure, title)
    return figure


def _title(figure: Any, text: str) -> None:
    if text:
        figure.suptitle(plain(text), x=0.01, ha="left", fontweight="bold", fontsize=10)


def _matrix(values: Any, columns: int) -> np.ndarray:
    array = np.atleast_2d(np.asarray(values, dtype=float))
    if array.ndim != 2 or array.shape[1] != columns or not len(array):
        raise InvalidOption(f"expected an array with {columns} columns, not of shape {array.shape}")
    return array


def _named(runs: Any) -> dict[str, tuple[Any, Any]]:
    """Label -> history and result q (None if unknown), from anything `convergence` accepts."""
    single = not isinstance(runs, Mapping) or "position_error" in runs
    named = {getattr(runs, "solver", ""): runs} if single else dict(runs)
    if not named:
        raise InvalidOption("there are no runs to draw")
    found = {}
    for label, run in named.items():
        history, q = (run, None) if isinstance(run, Mapping) else (run.history, run.q)
        if history is None:
            raise InvalidOption(f"the result {label!r} has no history: solve with history=True")
        found[label] = history, q
    return found
