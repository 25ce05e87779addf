"""Charts in one style, readable in print, in grey and with colour blindness. Each returns a matplotlib Figure.

Lines differ in dashes as well as in colour, so that nothing depends on colour alone. `save` writes a figure to a file.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InvalidOption, MissingExtra
from ..files import as_path, whole_file
from ..style import COLOURS, DASHES, GREY, STYLE

FLOOR = 1e-12  # [m, rad] smaller errors are drawn at this value, because a logarithmic axis has no zero
SUFFIXES = (".png", ".pdf", ".svg")


@contextmanager
def drawing(style: Any = STYLE) -> Iterator[Any]:
    """Yield matplotlib's pyplot in our style; figures made inside are not kept open. Raises MissingExtra."""
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
    if interactive != plt.isinteractive():  # the first figure loads the backend, which may change this
        plt.ion() if interactive else plt.ioff()


def literal_text(text: str) -> str:
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
    """Draw the error at every evaluation of a solve, several solvers side by side, on one logarithmic scale.

    The attempt that found the result is drawn up to it, the position [m] as a solid line, the orientation [rad] dashed;
    the other attempts are thin and grey. runs is a Result with history, its history, or a dict label -> either. Labels
    and title are drawn literally, never as formulas. tolerance [m, rad] is drawn as a line. Raises InvalidOption for a
    result without history.
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
            axis.set(xlabel="evaluation", title=literal_text(f"{label}: {len(position) - 1} steps") if label else "")
        axes[0, 0].set_ylabel("error (log scale)")
        axes[0, 0].legend(loc="best", fontsize=8)
        _title(figure, title)
    return figure


def attempts(history: Mapping[str, Any], q: Any = None) -> tuple[np.ndarray, list[np.ndarray]]:
    """Return the rows of the winning attempt, up to its result, and those of the first twelve others.

    If the result q (n,) is not among the rows because it was refined, the last row is used instead, and without q the
    row with the smallest position error. A history without the column `attempt` is one attempt.
    """
    error = np.asarray(history["position_error"], dtype=float)
    number = np.asarray(history.get("attempt", np.zeros(len(error), dtype=int)))
    rows = np.arange(len(error))
    if q is None:
        answer = int(np.argmin(error))
    else:
        same = np.flatnonzero((np.asarray(history["q"]) == q).all(axis=1))
        answer = int(same[-1]) if len(same) else len(error) - 1
    won = number[answer]
    others = [rows[number == one] for one in np.unique(number) if one != won][:12]
    return rows[(number == won) & (rows <= answer)], others


def iterates(result: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[np.ndarray]]:
    """Return joint values (N, n), position errors [m] and angles [rad] of the winning attempt of a Result with history.

    They end at the result; an angle that does not count is NaN. The last value lists the rows of the other attempts.
    """
    won, others = attempts(result.history, result.q)
    Q, position, angle = (np.asarray(result.history[key])[won] for key in ("q", "position_error", "orientation_error"))
    if not np.array_equal(Q[-1], result.q):  # refined after the search
        Q, position = np.vstack([Q, result.q]), np.append(position, result.position_error)
        angle = np.append(angle, np.nan if result.orientation_error is None else result.orientation_error)
    return Q, position, angle, others


def tracking_errors(runs: Any, *, title: str = "") -> Any:
    """Draw position and orientation error over time of a TrackResult, or a dict label -> TrackResult, on logarithmic scales."""
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
            axes[0, 0].semilogy(run.t, np.maximum(run.position_error, FLOOR), label=literal_text(label), **style)
            if run.orientation_error is not None:
                axes[1, 0].semilogy(run.t, np.maximum(run.orientation_error, FLOOR), **style)
        axes[0, 0].set_ylabel("position error [m]")
        if any(turning):
            axes[1, 0].set_ylabel("orientation error [rad]")
        axes[-1, 0].set_xlabel("time [s]")
        axes[0, 0].legend(fontsize=8, ncols=4, loc="lower left", bbox_to_anchor=(0.0, 1.0))
        _title(figure, title)
    return figure


def _title(figure: Any, text: str) -> None:
    if text:
        figure.suptitle(literal_text(text), x=0.01, ha="left", fontweight="bold", fontsize=10)


def _named(runs: Any) -> dict[str, tuple[Any, Any]]:
    """Map each label to a history and the result q (None if unknown), from anything `convergence` accepts."""
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
