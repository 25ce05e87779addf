"""Figures of the report on Chinyai: the outcome of Newton's iteration over targets and over starts."""

import math
from typing import Any

import numpy as np

from ...style import COLOURS
from ..report import cell
from .formulas import LEVENBERG, LIMIT, NO_CLIP, PLAIN, SEARCH, STEP, closed_form, converge


def outcomes(rows: np.ndarray) -> np.ndarray:
    """Return to which solution each Newton run converged: 0. for theta_2 >= 0, 1. for theta_2 < 0, NaN if to none.

    rows: the results (N, 4) of `newton_all`.
    """
    return np.where(rows[:, 2] < 0, np.nan, np.where(np.sin(rows[:, 1]) >= 0, 0.0, 1.0))


def _legend(figure: Any, plt: Any) -> None:
    patches = [plt.Rectangle((0, 0), 1, 1, fc=c, ec="0.6", lw=0.5) for c in (COLOURS[0], COLOURS[4], "white")]
    names = ("solution with theta_2 > 0", "solution with theta_2 < 0", "no convergence in 50 steps")
    figure.legend(patches, names, loc="outside lower center", ncols=3, fontsize=8)


def _image(axis: Any, plt: Any, picture: np.ndarray, half: float) -> None:
    """Show outcomes over a square of -half to half: 0 and 1 in the colours of the two solutions, 2 and 3 in pale ones."""
    colours = [plt.matplotlib.colors.to_rgb(COLOURS[k]) for k in (0, 4)]
    pale = [tuple(0.72 + 0.28 * x for x in colour) for colour in colours]
    axis.imshow(
        picture, origin="lower", extent=(-half, half, -half, half), vmin=0, vmax=3, interpolation="nearest",
        cmap=plt.matplotlib.colors.ListedColormap(colours + pale),
    )  # fmt: skip
    ticks = (-0.5 * half, 0.0, 0.5 * half)
    axis.set(xticks=ticks, yticks=ticks, aspect="equal")


def grid(count: int) -> np.ndarray:
    """Return a grid of starting angles (count^2, 2) [rad], from -180 to 180 degrees for each joint."""
    side = np.radians(np.linspace(-180.0, 180.0, count))
    return np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)


def target_basins(plt: Any, shares: dict[str, float]) -> Any:
    """Draw for which targets Newton-Raphson converges from the start (45, 90) degrees, and to which solution.

    shares: percentage of targets solved, by variant ("plain", "step", "LM", "plain + clip"), for the panels' titles.
    """
    side = np.linspace(-2.0, 2.0, 401)
    x, y = np.meshgrid(side, side)
    X = np.column_stack([x.ravel(), y.ravel()])
    inside = np.hypot(*X.T) <= 2.0
    start = np.radians((45.0, 90.0))
    panels = [
        ("plain Newton", "plain", PLAIN, NO_CLIP),
        ("steps of at most 0.5 rad", "step", STEP, NO_CLIP),
        ("Levenberg-Marquardt", "LM", LEVENBERG, NO_CLIP),
        ("plain, clipped at 150 deg", "plain + clip", PLAIN, LIMIT),
    ]
    figure, axes = plt.subplots(1, 4, figsize=(10.5, 3.3), layout="constrained", sharey=True)
    for axis, (title, column, kind, clip) in zip(axes, panels, strict=True):
        picture = np.full(len(X), np.nan)
        rows = converge(X[inside], 1.0, 1.0, start, kind, clip)
        picture[inside] = outcomes(rows)
        _image(axis, plt, picture.reshape(x.shape), 2.0)
        axis.add_patch(plt.Circle((0, 0), 2.0, fill=False, ec="0.3", lw=0.8))
        elbow = (math.cos(start[0]), math.sin(start[0]))
        hand = (elbow[0] + math.cos(start.sum()), elbow[1] + math.sin(start.sum()))
        axis.plot(*np.array([(0, 0), elbow, hand]).T, color="black", lw=2.2, marker="o", ms=3.5, mfc="white")
        axis.set_title(f"{title}:\n{cell(shares[column])} %")
        axis.set(xlabel="x (m)")
    axes[0].set_ylabel("y (m)")
    _legend(figure, plt)
    return figure


def start_basins(plt: Any, target: tuple[float, float]) -> Any:
    """Draw to which solution, if any, Newton-Raphson converges for one target from all starting angles."""
    starts, panels = grid(481), {}
    for title, kind in (("plain Newton", PLAIN), ("with step halving", SEARCH), ("Levenberg-Marquardt", LEVENBERG)):
        rows = converge(np.tile(target, (len(starts), 1)), 1.0, 1.0, starts, kind)
        good = rows[:, 2] >= 0
        panels[f"{title}:\n{cell(100 * np.mean(good))} %, mean {rows[good, 2].mean():.1f} steps"] = outcomes(rows)
    return over_starts(plt, panels, target)


def over_starts(plt: Any, panels: dict[str, np.ndarray], target: tuple[float, float]) -> Any:
    """Draw panels of outcomes over all starting angles, with both solutions of the target marked.

    panels: by title, the outcomes (count^2,) at the starts of `grid`: 0 or 1 for the two solutions, NaN for no convergence.
    """
    figure, axes = plt.subplots(1, len(panels), figsize=(10.5, 4.1), layout="constrained", sharey=True)
    for axis, (title, picture) in zip(axes, panels.items(), strict=True):
        _image(axis, plt, picture.reshape(math.isqrt(len(picture)), -1), 180.0)
        t1, t2, u1, u2 = np.degrees(closed_form(*target, 1.0, 1.0))
        axis.plot(t1, t2, "o", u1, u2, "s", color="white", mec="black", ms=6)
        axis.set_title(title)
        axis.set(xlabel="start theta_1 (deg)")
    axes[0].set_ylabel("start theta_2 (deg)")
    _legend(figure, plt)
    return figure
