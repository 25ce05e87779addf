"""Figures of the report on Burrell et al. (2016)."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ...study.singularity import Run
from ...style import COLOURS


def draw_existence(plt: Any, runs: dict[float, np.ndarray], gains: np.ndarray, ends: np.ndarray) -> Any:
    """Draw the error [mm] over sweeps (a sweep updates every joint once) for each K_p, and the final error [mm] over K_p."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(10.0, 3.6), layout="constrained", sharey=True)
    styles = {0.0848: ("--", 1.6, 3), 0.0847: ("-", 2.6, 2), 0.02: ("-", 1.6, 2)}
    for (kp, error), colour in zip(runs.items(), (COLOURS[1], COLOURS[0], COLOURS[2]), strict=False):
        line, width, order = styles[kp]
        label = f"$K_p$ = {kp:g}: {'reached' if error.min() <= 1.0 else f'stalls at {error.min():.3g} mm'}"
        left.semilogy(error, line, lw=width, color=colour, label=label, zorder=order)
    longest = max(len(error) for error in runs.values() if error.min() <= 1.0)
    left.set(xlabel="sweep", ylabel="error (mm)", title="along the run", xlim=(-1, 1.3 * longest))
    left.legend()
    good = ends <= 1.0
    right.semilogy(gains[good], ends[good], "o", ms=3, color=COLOURS[0], label="reached")
    right.semilogy(gains[~good], ends[~good], "o", ms=3.4, mfc="none", mec=COLOURS[1], label="not reached")
    right.axvline(0.08475, color="0.6", lw=0.8)
    right.text(0.0875, 300.0, "0.0847 / 0.0848", color="0.4", fontsize=8)
    right.set(xlabel="$K_p$ (degrees a mm)", title="left at the end, over the gain")
    right.legend(loc="center right")
    for axis in (left, right):
        axis.axhline(1.0, color="0.6", lw=0.8, ls=":")
    return figure


def draw_response(plt: Any, curves: dict[str, np.ndarray]) -> Any:
    """Draw the error [mm] over iterations in a panel for each solver."""
    figure, axes = plt.subplots(len(curves), 1, figsize=(6.0, 5.0), layout="constrained", sharex=True)
    for axis, (name, error), colour in zip(axes, curves.items(), COLOURS, strict=False):
        axis.semilogy(error, color=colour, lw=1.6)
        axis.axhline(1.0, color="0.6", lw=0.8, ls=":")
        axis.set_title(f"{name}:\n{len(error) - 1} iterations")
        axis.set_ylabel("error (mm)")
    axes[-1].set_xlabel("iteration")
    return figure


def draw_workspace(plt: Any, points: np.ndarray, maps: dict[str, np.ndarray]) -> Any:
    """Draw goals (N, 3) [mm, frame of the paper], reached ones as dots and others as circles, in a panel for each solver."""
    figure = plt.figure(figsize=(3.7 * len(maps), 3.9))
    for k, (name, good) in enumerate(maps.items()):
        axis = figure.add_subplot(1, len(maps), k + 1, projection="3d")
        x, y, z = points.T
        axis.scatter(x[good], z[good], y[good], s=6, color=COLOURS[0], alpha=0.55, lw=0, depthshade=False)
        axis.scatter(
            x[~good], z[~good], y[~good], s=26, facecolors="none", edgecolors=COLOURS[1], lw=1.0, depthshade=False
        )
        axis.set_xlabel("x forward (mm)", labelpad=2)
        axis.set_ylabel("z right (mm)", labelpad=4)
        axis.set_zlabel("y up (mm)" if k == len(maps) - 1 else "", labelpad=2)
        axis.set_title(f"{name}:\n{int(good.sum())} of {len(good)}", y=1.02)
        axis.view_init(20, -62)
        axis.set_box_aspect(np.ptp(points[:, (0, 2, 1)], axis=0), zoom=1.0)
        axis.tick_params(labelsize=7, pad=0)
        for side in (axis.xaxis, axis.yaxis, axis.zaxis):
            side.set_major_locator(plt.MultipleLocator(500))
    figure.subplots_adjust(left=0.0, right=0.97, bottom=0.05, top=0.93, wspace=0.02)
    return figure


def draw_planar(plt: Any, runs: dict[str, Run]) -> Any:
    """Draw the position error and the manipulability of the planar arm over the iterations of each run.

    A run in which no joint moves is drawn as a marker.
    """
    figure, axes = plt.subplots(1, 2, figsize=(10.0, 3.6), layout="constrained")
    still = [name for name, run in runs.items() if run.stands_still]
    moving = {name: run for name, run in runs.items() if not run.stands_still}
    for (name, run), colour in zip(moving.items(), COLOURS[1:], strict=False):
        label = name.replace("state space, ", "")
        axes[0].semilogy(run.position_error, color=colour, lw=1.6, label=label)
        axes[1].plot(run.manipulability, color=colour, lw=1.6)
    axes[0].plot([0], [1.0], "s", color="black", ms=6, label="stand still: " + ", ".join(still))
    axes[1].plot([0], [0.0], "s", color="black", ms=6)
    axes[0].axhline(0.02, color="0.6", lw=0.8, ls=":")
    axes[0].set(xlabel="iteration", ylabel="error (link units)")
    axes[1].set(xlabel="iteration", ylabel="manipulability (lengths over the scale)")
    figure.legend(loc="outside lower center", ncols=2, fontsize=8)
    return figure


def draw_gains(plt: Any, gains: Sequence[float], swept: dict[str, list[int]]) -> Any:
    """Draw over the gain K_p [degrees per mm] how many of 1000 goals are reached, with a line for each start."""
    figure, axis = plt.subplots(figsize=(6.4, 3.4), layout="constrained")
    for (name, row), colour, mark in zip(swept.items(), COLOURS, "os^", strict=False):
        axis.semilogx(gains, row, "-" + mark, ms=4, lw=1.4, color=colour, label=f"start {name}")
    axis.axhline(200, color="0.6", lw=0.8, ls=":")
    axis.text(0.0012, 212, 'published: "say 20 %" when poorly tuned', color="0.35", fontsize=8)
    axis.plot([0.02], [960], "*", ms=11, color="black", zorder=4)
    axis.annotate("published 960 at 0.02", (0.02, 960), (0.03, 1010), fontsize=8, color="0.2")
    axis.set(xlabel="$K_p$ (degrees a mm)", ylabel="goals of 1000 reached", ylim=(-20, 1070))
    axis.legend(loc="lower center", bbox_to_anchor=(0.42, 0.45))
    return figure


def draw_reach(plt: Any, reachable: np.ndarray, shapes: dict[str, np.ndarray], target: tuple[float, float]) -> Any:
    """Draw the reachable points of the planar arm (N, 2), and its joints and tip (4, 2) in each named configuration."""
    figure, axis = plt.subplots(figsize=(6.4, 5.2), layout="constrained")
    axis.plot(*reachable.T, ".", ms=1.6, color="0.82", zorder=0, rasterized=True)
    styles = (("--", COLOURS[1], 5.0), ("-", COLOURS[0], 2.0), ("-", "0.45", 1.6))
    for (name, points), (line, colour, width) in zip(shapes.items(), styles, strict=False):
        axis.plot(*points.T, line, color=colour, lw=width, marker="o", ms=4, label=name)
    axis.plot(*target, "*", ms=13, color="black", label=f"target ({target[0]:g}, {target[1]:g})", zorder=5)
    axis.set(xlabel="x (link units)", ylabel="y (link units)", aspect="equal", xlim=(-3.2, 6.5))
    axis.legend(loc="center left", bbox_to_anchor=(0.0, 0.34), fontsize=8)
    return figure


def draw_stability(plt: Any, gains: Any, bound: float, margins: np.ndarray, swept: list[list[float]]) -> Any:
    """Draw loop gains (N, r) in the complex plane, and beside it the share of gain margins (N,) of IK-PID above each K_p.

    bound: upper bound on a real loop gain. swept: for some K_p the row (K_p, share of margins above it [%], goals solved [%]).
    """
    figure, (left, right) = plt.subplots(1, 2, figsize=(10.0, 3.6), layout="constrained")
    left.plot(gains.real.ravel(), gains.imag.ravel(), ".", ms=2, alpha=0.3, color=COLOURS[0])
    for at in (0.0, bound):
        left.axvline(at, color=COLOURS[1], lw=1.2, ls="--")
    left.set(xlabel="real part", ylabel="imaginary part", title="loop gain (dashed: bounds where it is real)")
    right.plot(np.sort(margins), 100.0 * (1.0 - np.arange(len(margins)) / len(margins)), color=COLOURS[0])
    kp, _, solved = np.array(swept).T
    right.plot(kp, solved, "o", color=COLOURS[1])
    right.annotate("margin above $K_p$", (0.035, 97.0), (0.06, 92.0), color=COLOURS[0])
    right.annotate("solved by runs", (kp[3], solved[3]), (0.115, 45.0), color=COLOURS[1])
    right.set(xlabel="$K_p$ (degrees a mm)", ylabel="goals (%)", title="IK-PID", ylim=(0.0, 104.0))
    return figure
