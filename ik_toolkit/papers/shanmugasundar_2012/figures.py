"""Figures of the report on Shanmugasundar and Sivaramakrishnan (2012)."""

import math
from typing import Any

import numpy as np

from ...robot.robot import Robot
from ...solvers.closed_form import inspection
from ...solvers.closed_form.inspection import Inspection
from ...solvers.solve import solve_all
from ...style import COLOURS


def _skeleton(robot: Robot, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return shoulder, elbow, wrist and tip (4, 3) [m] of one configuration, and the axes of joints 3, 4 and 6 (3, 3)."""
    from ...show.body import joint_frames

    frames = joint_frames(robot, q)
    return np.vstack([frames[[3, 5, 7], :3, 3], robot.fk(q).translation]), frames[[3, 4, 6], :3, 2]


def gallery(plt: Any, robot: Robot) -> Any:
    """Draw the arm in each of the eight solutions of one pose."""
    q = np.array([0.3, 0.22, 0.5, 0.4, 0.6, -0.9, 0.7])
    goal = robot.fk(q)
    found = solve_all(robot, goal, Inspection(lift=0.22), q0=q, limits=False)
    # Sorted so that each row of pictures has one elbow posture, up or down; in a row angles differ by 180 degrees or in sign.
    found = sorted(found, key=lambda x: (-_skeleton(robot, x)[0][1, 2].round(6), len(robot.outside(x))))
    figure, axes = plt.subplots(2, 4, figsize=(9.5, 4.8), subplot_kw={"projection": "3d"}, layout="constrained")
    names = ("axis of joint 3", "axis of joint 4", "axis of joint 6")
    for k, (axis, branch) in enumerate(zip(axes.flat, found, strict=True)):
        P, Z = _skeleton(robot, branch)
        stub = np.array([P[0] - (0, 0, 0.18), P[0]])
        axis.plot(*_skeleton(robot, found[7 - k])[0].T, color="0.85", lw=2, zorder=1)
        axis.plot(*stub.T, color="0.35", lw=5, solid_capstyle="butt")
        axis.plot(*P.T, color=COLOURS[0], lw=3, marker="o", ms=4, mfc="white", zorder=5)
        for place, z, colour, name in zip((P[0], P[0], P[1]), Z, COLOURS[1:4], names, strict=True):
            axis.quiver(*place, *(0.13 * z), color=colour, lw=1.6, arrow_length_ratio=0.3, zorder=6, label=name)
        axis.quiver(
            *P[3], *(0.1 * goal.rotation[:, 0]), color="black", lw=1.2, arrow_length_ratio=0.3, label="tool x axis"
        )
        angles = np.degrees(np.remainder(np.delete(branch, 1) + math.pi, 2 * math.pi) - math.pi)
        broken = robot.outside(branch)
        says = "breaks " + ", ".join(broken[:2]) if broken else "inside the limits"
        says += ",\n" + ", ".join(broken[2:]) if broken[2:] else ""
        title = f"{k + 1}:  " + "  ".join(f"{x:.0f}" for x in angles) + f"\n{says}"
        axis.set_title(title, fontsize=7, color="0.45" if broken else "black", y=0.96)
        axis.set(xlim=(-0.12, 0.4), ylim=(-0.2, 0.32), zlim=(0.5, 1.02))
        axis.set_box_aspect((1, 1, 1), zoom=1.5)
        axis.view_init(20, -65)
        axis.set_axis_off()
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=8)
    figure.suptitle("One pose at one lift, eight configurations: theta_1, theta_3 ... theta_7 in degrees", fontsize=10)
    return figure


def self_motion(
    plt: Any, p: np.ndarray, goal: np.ndarray, exact: np.ndarray, lift: float, published: float, origin: float
) -> Any:
    """Draw theta_1 over the lift (prismatic joint 2) for the pose of Table 2, and near the published lift for the exact pose, too.

    p: parameters of the closed form; goal, exact: the two poses (4, 4) [m]; lift [mm], published and true theta_1 [deg].
    """
    box = np.vstack([np.full(7, -np.inf), np.full(7, np.inf), np.zeros(7), np.ones(7)])

    def loops(T: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return lifts (L,) [mm] and theta_1 (L, 4) [deg], in ascending order, of the branches with cos(theta_5) > 0."""
        low, high = inspection.feasible_lifts(p, T)[0]
        lifts = 0.5 * (low + high) - 0.5 * (high - low) * np.cos(np.linspace(0.0, math.pi, 801))
        out, broken, theta = np.empty((8, 7)), np.empty(8), np.empty((len(lifts), 4))
        for k, d in enumerate(lifts[1:-1], 1):
            found = inspection.every_branch(p, T, box, np.array([d]), out, broken)
            theta[k] = np.sort(out[:found, 0][np.abs(out[:found, 4]) < math.pi / 2])
        # At the least and the largest lift both elbow branches meet, so the curves end at the mean of their neighbours.
        for k, nearby in ((0, 1), (-1, -2)):
            theta[k] = np.repeat(theta[nearby].reshape(2, 2).mean(axis=1), 2)
        return 1000.0 * lifts, np.degrees(theta)

    figure, (whole, detail) = plt.subplots(1, 2, figsize=(9.0, 3.6), layout="constrained", width_ratios=(3, 2))
    for T, colour, label in (
        (goal, COLOURS[0], "Table 2, projected"),
        (exact, COLOURS[4], "before rounding (20 deg)"),
    ):
        lifts, theta = loops(T)
        for a, b in ((0, 1), (2, 3)):
            x, y = np.concatenate([lifts, lifts[::-1]]), np.concatenate([theta[:, a], theta[::-1, b]])
            for axis in (whole, detail) if T is goal else (detail,):
                axis.plot(x, y, color=colour, lw=1.8, label=label if a else None)
    whole.axvline(lift, color="0.4", lw=1, ls=":")
    whole.annotate(
        f"{lift:g} mm, published", (lift, 0), xytext=(4, 0), textcoords="offset points", fontsize=8, color="0.4"
    )
    whole.set(xlabel="lift (mm)", ylabel="theta_1 (deg)", title="Table 2 pose: theta_1 of every solution (two loops)")
    whole.set(yticks=range(-180, 181, 60), ylim=(-185, 185))
    detail.axvline(lift, color="0.4", lw=1, ls=":")
    detail.plot(lift, published, "s", color=COLOURS[1], ms=7, label=f"published theta_1 = {published:g} deg")
    detail.plot(lift, origin, "D", color=COLOURS[2], ms=7, label=f"origin of the pose, {origin:g} deg")
    detail.set(xlabel="lift (mm)", ylabel="theta_1 (deg)", title="Near the published lift")
    detail.set(xlim=(219.7, 221.7), ylim=(16, 26), xticks=(220, 220.5, 221, 221.5))
    detail.legend(fontsize=7.5, loc="upper right")
    return figure
