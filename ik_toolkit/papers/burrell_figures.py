"""Pictures of the report on Burrell et al. (2016)."""

from collections.abc import Callable
from typing import Any

import numpy as np

from ..study.singularity import Run
from .report import COLOURS


def draw_existence(runs: dict[float, np.ndarray]) -> Callable[[Any], Any]:
    """Errors [mm] over sweeps for each K_p."""

    def draw(plt: Any) -> Any:
        figure, axis = plt.subplots(figsize=(6.0, 3.2), layout="constrained")
        styles = {0.0848: ("--", 1.4), 0.0847: ("-", 1.2), 0.02: ("-", 2.6)}
        for (kp, error), colour in zip(runs.items(), COLOURS, strict=False):
            line, width = styles[kp]
            axis.semilogy(error, line, lw=width, color=colour, label=f"$K_p$ = {kp:g}")
        axis.axhline(1.0, color="0.6", lw=0.8, ls=":")
        axis.text(0.0, 1.05, "1 mm", va="bottom", color="0.4", fontsize=8)
        axis.set(xlabel="sweep", ylabel="error (mm)")
        axis.legend()
        return figure

    return draw


def draw_response(curves: dict[str, np.ndarray]) -> Callable[[Any], Any]:
    """Errors [mm] over iterations of each solver, one panel each."""

    def draw(plt: Any) -> Any:
        figure, axes = plt.subplots(len(curves), 1, figsize=(6.0, 5.0), layout="constrained", sharex=True)
        for axis, (name, error), colour in zip(axes, curves.items(), COLOURS, strict=False):
            axis.semilogy(error, color=colour, lw=1.6)
            axis.axhline(1.0, color="0.6", lw=0.8, ls=":")
            axis.set_title(f"{name}: {len(error) - 1} iterations")
            axis.set_ylabel("error (mm)")
        axes[-1].set_xlabel("iteration")
        return figure

    return draw


def draw_workspace(points: np.ndarray, maps: dict[str, np.ndarray]) -> Callable[[Any], Any]:
    """Goals (N, 3) [mm, paper frame], reached ones as dots and lost ones as circles, one panel a solver."""

    def draw(plt: Any) -> Any:
        figure = plt.figure(figsize=(10.0, 4.6), layout="constrained")
        for k, (name, good) in enumerate(maps.items()):
            axis = figure.add_subplot(1, len(maps), k + 1, projection="3d")
            x, y, z = points.T
            axis.scatter(x[good], z[good], y[good], s=6, color=COLOURS[0], alpha=0.55, lw=0, depthshade=False)
            axis.scatter(
                x[~good], z[~good], y[~good], s=26, facecolors="none", edgecolors=COLOURS[1], lw=1.0, depthshade=False
            )
            axis.set(xlabel="x forward (mm)", ylabel="z right (mm)", zlabel="y up (mm)")
            axis.set_title(f"{name}: {int(good.sum())} of {len(good)}")
            axis.view_init(22, -60)
            axis.set_box_aspect((1, 1.3, 1.3), zoom=0.95)
            for side in (axis.xaxis, axis.yaxis, axis.zaxis):
                side.set_major_locator(plt.MaxNLocator(4))
        return figure

    return draw


def draw_planar(runs: dict[str, Run]) -> Callable[[Any], Any]:
    """Error and manipulability along the runs; runs that stand still are one marker."""

    def draw(plt: Any) -> Any:
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

    return draw
