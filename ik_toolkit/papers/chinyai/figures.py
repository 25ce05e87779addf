"""Figures of the report on Chinyai: the outcome of Newton's iteration over targets and over starts."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from ...style import COLOURS
from ..report import cell

KINDS = {"plain": 0, "search": 1, "LM": 2, "step": 3}  # variants of Newton's step: full, line search, LM, limited


def _outcome(rows: np.ndarray) -> np.ndarray:
    """Return the outcomes of rows of `newton_all` as floats: 0 for theta_2 >= 0, 1 for theta_2 < 0, NaN without convergence."""
    return np.where(rows[:, 2] < 0, np.nan, np.where(np.sin(rows[:, 1]) >= 0, 0.0, 1.0))


def _legend(figure: Any, plt: Any) -> None:
    patches = [plt.Rectangle((0, 0), 1, 1, fc=c, ec="0.6", lw=0.5) for c in (COLOURS[0], COLOURS[4], "white")]
    names = ("solution with theta_2 > 0", "solution with theta_2 < 0", "no convergence in 50 steps")
    figure.legend(patches, names, loc="outside lower center", ncols=3, fontsize=8)


def target_basins(converge: Callable, limit: float, shares: dict[str, float]) -> Any:
    """Draw the outcome for all targets from the start (45, 90) degrees.

    limit: joint limit [rad] of the clipped variant; shares: solved targets [%] in the table of convergence, by its columns.
    """

    def draw(plt: Any) -> Any:
        side = np.linspace(-2.0, 2.0, 401)
        x, y = np.meshgrid(side, side)
        X = np.column_stack([x.ravel(), y.ravel()])
        inside = np.hypot(*X.T) <= 2.0
        start = np.radians((45.0, 90.0))
        colours = plt.matplotlib.colors.ListedColormap([COLOURS[0], COLOURS[4]])
        panels = [
            ("plain Newton", "plain", "plain", 1e9),
            ("steps of at most 0.5 rad", "step", "step", 1e9),
            ("Levenberg-Marquardt", "LM", "LM", 1e9),
            ("plain, clipped at 150 deg", "plain + clip", "plain", limit),
        ]
        figure, axes = plt.subplots(1, 4, figsize=(10.5, 3.3), layout="constrained", sharey=True)
        for axis, (title, column, kind, clip) in zip(axes, panels, strict=True):
            picture = np.full(len(X), np.nan)
            rows = converge(X[inside], 1.0, 1.0, start, KINDS[kind], clip)
            picture[inside] = _outcome(rows)
            axis.imshow(
                picture.reshape(x.shape),
                origin="lower",
                extent=(-2, 2, -2, 2),
                cmap=colours,
                vmin=0,
                vmax=1,
                interpolation="nearest",
            )
            axis.add_patch(plt.Circle((0, 0), 2.0, fill=False, ec="0.3", lw=0.8))
            elbow = (math.cos(start[0]), math.sin(start[0]))
            hand = (elbow[0] + math.cos(start.sum()), elbow[1] + math.sin(start.sum()))
            axis.plot(*np.array([(0, 0), elbow, hand]).T, color="black", lw=2.2, marker="o", ms=3.5, mfc="white")
            axis.set_title(f"{title}:\n{cell(shares[column])} %")
            axis.set(xlabel="x (m)", xticks=(-2, 0, 2), yticks=(-2, 0, 2), aspect="equal")
        axes[0].set_ylabel("y (m)")
        _legend(figure, plt)
        return figure

    return draw


def start_basins(converge: Callable, target: tuple[float, float]) -> Any:
    """Draw the outcome for one target from all starting angles."""

    def draw(plt: Any) -> Any:
        side = np.radians(np.linspace(-180.0, 180.0, 481))
        a, b = np.meshgrid(side, side)
        starts = np.column_stack([a.ravel(), b.ravel()])
        X = np.tile(np.array(target), (len(starts), 1))
        colours = plt.matplotlib.colors.ListedColormap([COLOURS[0], COLOURS[4]])
        figure, axes = plt.subplots(1, 3, figsize=(10.5, 4.1), layout="constrained", sharey=True)
        for axis, (title, kind) in zip(
            axes,
            (("plain Newton", "plain"), ("with step halving", "search"), ("Levenberg-Marquardt", "LM")),
            strict=True,
        ):
            rows = converge(X, 1.0, 1.0, starts, KINDS[kind])
            axis.imshow(
                _outcome(rows).reshape(a.shape),
                origin="lower",
                extent=(-180, 180, -180, 180),
                cmap=colours,
                vmin=0,
                vmax=1,
                interpolation="nearest",
            )
            c2 = (target[0] ** 2 + target[1] ** 2 - 2.0) / 2.0
            for sign, shape in ((1, "o"), (-1, "s")):
                t2 = sign * math.acos(c2)
                t1 = math.atan2(target[1], target[0]) - math.atan2(math.sin(t2), 1 + math.cos(t2))
                axis.plot(math.degrees(t1), math.degrees(t2), shape, color="white", mec="black", ms=6)
            axis.set_title(
                f"{title}:\n{cell(100 * np.mean(rows[:, 2] >= 0))} %, mean {rows[rows[:, 2] >= 0, 2].mean():.1f} steps"
            )
            axis.set(
                xlabel="start theta_1 (deg)",
                xticks=(-180, -90, 0, 90, 180),
                yticks=(-180, -90, 0, 90, 180),
                aspect="equal",
            )
        axes[0].set_ylabel("start theta_2 (deg)")
        _legend(figure, plt)
        return figure

    return draw
