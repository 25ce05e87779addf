"""Plots of a path result and of a trajectory."""

from typing import Any

import numpy as np

from ..robot.joints import Joints
from ..robot.pose import length
from ..style import COLOURS, DASHES, GREY, PALE
from .plots import drawing, plain


def plot_motion(what: Any) -> Any:
    """Draw a PathResult or a Trajectory. Raises MissingExtra."""
    timed = hasattr(what, "dq")
    with drawing() as plt:
        figure, axes = plt.subplots(
            3 if timed else 2, 1, figsize=(8.6, 7.2 if timed else 5.6), sharex=True, layout="constrained"
        )
        x = what.t if timed else what.at
        _joints(axes[0], what.robot, x, what.q if timed else what.curve, [] if timed else _breaks(what))
        if timed:
            free = np.isnan(what.place)
            for ax, values, limit, title in (
                (axes[1], what.dq, what.velocity, "joint speeds [% of the limit]"),
                (axes[2], what.ddq, what.acceleration, "joint accelerations [% of the limit]"),
            ):
                _lines(ax, x, 100.0 * values / limit, what.robot)
                ax.set_title(title)
                ax.set_ylim(-112.0, 112.0)
                ax.axhline(100.0, color=GREY, lw=0.8)
                ax.axhline(-100.0, color=GREY, lw=0.8)
            for ax in axes if free.any() else ():
                ax.fill_between(x, 0, 1, where=free, transform=ax.get_xaxis_transform(), color=PALE, lw=0)
            axes[-1].set_xlabel("time [s]" + (" (grey: from one branch to the other)" if free.any() else ""))
            title = f"{what.robot.name}: {what.message}"
        else:
            _deviation(axes[1], what)
            axes[-1].set_xlabel("pose")
            title = f"{what.robot.name}: {what.status.name}, {len(what.q)} poses, length {what.length[0]:.4g} rad"
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=7, fontsize=8)
        figure.suptitle(plain(title), x=0.01, ha="left", fontweight="bold")
        return figure


def _breaks(result: Any) -> list[float]:
    return [one.index + 0.5 for one in result.reconfigurations]


def _lines(ax: Any, x: np.ndarray, values: np.ndarray, robot: Joints) -> None:
    for i, name in enumerate(robot.joint_names):
        ax.plot(x, values[:, i], color=COLOURS[i % 8], ls=DASHES[i // 8 % 8], lw=1.3, label=plain(name))


def _joints(ax: Any, robot: Joints, x: np.ndarray, Q: np.ndarray, breaks: list[float]) -> None:
    """Draw joints relative to their limits; those without limits in half turns."""
    bounded = np.isfinite(robot.lower + robot.upper)
    low, high = np.where(bounded, robot.lower, -np.pi), np.where(bounded, robot.upper, np.pi)
    shown = (Q - 0.5 * (low + high)) / (0.5 * (high - low))
    for k in breaks:  # no line across a change of branch
        after = int(np.searchsorted(x, k))
        x, shown = np.insert(x, after, k), np.insert(shown, after, np.nan, axis=0)
    _lines(ax, x, shown, robot)
    for edge in (-1, 1):
        ax.axhline(edge, color=GREY, lw=0.8)
    for k in breaks:
        ax.axvline(k, color=GREY, lw=0.9, ls=":")
    ax.set_yticks([-1, 0, 1], ["lower", "middle", "upper"])
    ax.set_title("joints between their limits" + (" (dotted: the branch changes)" if breaks else ""))


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
    ax.axhline(1.0, color=GREY, lw=0.8)
    ax.set_ylim(bottom=0.0)
    ax.legend(fontsize=8, loc="upper right", bbox_to_anchor=(1.0, 1.16), ncols=2)
    ax.set_title("bound on the deviation between poses, in tolerances")
