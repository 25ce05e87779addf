"""The section of the report on the inspection of a canister's welds: seams, workspace and torques, which the paper announces."""

from typing import Any

import numpy as np

from ...robot.robot import Robot
from ...solvers.closed_form.lift_windows import lift_windows
from ...study.reachability import reachability
from ...style import COLOURS
from ..report import Report
from .weld import MARGIN, Canister, WeldPlan, inspect_weld

ANGLES, HEIGHTS = np.radians(np.linspace(-40.0, 40.0, 41)), np.linspace(0.05, 0.65, 41)  # the two seams [rad], [m]
SEAMS = {"girth, 80 deg at 350 mm": (ANGLES, 0.35), "longitudinal, 50 to 650 mm": (0.0, HEIGHTS)}
TURNS = np.radians(np.arange(7.5, 360.0, 15.0))  # about the line of sight; at 90 deg arm_pitch would stay at its limit
SPEED = 0.02  # speed of the tip along the seam [m/s]


def weld(report: Report, robot: Robot) -> None:
    """Add the section to the report."""
    report.heading("Beyond the paper: the welds of a canister, workspace and torques")
    canister, plans, rows, forces = Canister(), {}, [], []
    for name, seam in SEAMS.items():
        seams = [canister.seam(*seam, turn=turn) for turn in TURNS]
        seen = np.array([[bool(found) for found in lift_windows(robot, poses)] for poses in seams])
        made = {k: inspect_weld(robot, seams[k], canister) for k in np.flatnonzero(seen.all(axis=1)).tolist()}
        k = min(made, key=lambda k: (not made[k].path.success, round(made[k].travel, 6), made[k].path.length))
        plan = plans[name] = made[k]
        share, most = 100.0 * seen.mean(axis=0), 1000.0 * max(one.travel for one in made.values())
        off, tilt = plan.path.deviation
        rows.append([f"{name}, 41 poses", f"{share.min():.0f} to {share.max():.0f}", len(made), np.degrees(TURNS[k])])
        rows[-1] += [
            1000.0 * plan.travel,
            most,
            plan.path.status.name,
            f"{1000 * off:.2f} mm, {np.degrees(tilt):.2f} deg",
        ]
        rows[-1].append(1000.0 * (plan.path.clearance or 0.0))
        motion, torques, weight = plan.torques(tip_speed=SPEED)
        forces += [[f"{name}, {motion.duration:.1f} s", *np.abs(torques).max(axis=0)]]
        forces += [["of this by motion", *np.abs(torques - weight).max(axis=0)]]
    head = [
        "seam",
        f"turns of {len(TURNS)} that see a pose (%)",
        "that see all",
        "turn taken (deg)",
        "least lift travel (mm)",
    ]
    head += ["at the worst turn", "motion", "deviation at most", "clearance at least (mm)"]
    report.table("weld", head, rows)
    report.text(
        f"""The robot is to look at the welds of canisters; the paper plans none. Ours stands {canister.foot[0]:g} m in front of the
        robot, with a radius of {1000 * canister.radius:g} mm. The tool looks along its x axis, at right angles to the surface, 50 mm
        away, and one turn about this line is kept along a seam. At each pose the lifts that keep all limits are exact intervals, a
        branch at a time: a joint can be at a limit only at the roots of polynomials of degree 12 or less. The sum of the steps of
        the lift is the least over all lifts in these intervals, {1000 * MARGIN:g} mm from their ends, at the 41 poses, on one branch.
        Between the poses the motion is certified: its deviation is bounded, and it keeps the clearance from the canister and itself."""
    )
    report.figure(
        "weld.png",
        "Above: the girth weld, seen from above; below: the longitudinal weld, seen from the side. Right: intervals of the lift on "
        "the branch of the plan (blue) and on all (grey), with the lift of least travel (red)",
        draw_weld(robot, canister, plans),
    )
    names = [
        f"{name} ({'N' if slides else 'Nm'})" for name, slides in zip(robot.joint_names, robot.slides, strict=True)
    ]
    report.table("torques", [f"largest at {1000 * SPEED:g} mm/s", *names], forces)
    any_, gaze = maps(robot, canister)
    report.number("workspace", {"any orientation": any_.counts(), "gaze": gaze.counts()})
    report.text(
        f"""Torques by Pinocchio (recursive Newton-Euler), joints accelerating by at most 1 rad/s^2 or m/s^2. The paper gives no
        masses; ours are those of solid steel cylinders of the lengths of Table 2. In the vertical plane through the column the tip
        reaches {100 * any_.reached.mean():.0f} % of {any_.reached.size} cells of 20 mm with some orientation. With a level gaze
        outwards, one of 12 turns reaches {100 * gaze.reached.mean():.0f} % of {gaze.reached.size} cells of 70 mm, half the width."""
    )
    caption = "Workspace in the plane through the column: manipulability (left); share of 12 turns reached with a level gaze (right)"
    report.figure("workspace.png", caption, draw_maps(any_, gaze))


def maps(robot: Robot, canister: Canister) -> tuple[Any, Any]:
    """Return the workspace in the plane y = 0: with any orientation, and for a level gaze with 12 turns."""
    gaze = [canister.seam(0.0, 0.0, turn=turn)[0, :3, :3] for turn in TURNS[::2]]
    any_ = reachability(robot, ((-0.6, 0.0, 0.1), (0.6, 0.0, 1.5)), resolution=0.02, audit=200)
    half = ((0.0, 0.0, 0.1), (0.6, 0.0, 1.5))
    return any_, reachability(robot, half, resolution=0.07, orientations=np.array(gaze), audit=200)


def draw_weld(robot: Robot, canister: Canister, plans: dict[str, WeldPlan]) -> Any:
    """Draw for each plan the arm at five poses (girth: from above) and its lifts."""
    from ...show.body import joint_frames

    def draw(plt: Any) -> Any:
        figure, axes = plt.subplots(len(plans), 2, figsize=(8.0, 6.4), layout="constrained", width_ratios=(4, 5))
        x, y, z = canister.foot
        for (left, right), (name, plan), k in zip(axes, plans.items(), (1, 2), strict=True):
            if k == 1:
                left.add_patch(plt.Circle((x, y), canister.radius, color="0.85"))
            else:
                left.add_patch(
                    plt.Rectangle((x - canister.radius, z), 2 * canister.radius, canister.height, color="0.85")
                )
                left.plot([0, 0], [0, 0.53], color="0.5", lw=7, solid_capstyle="butt")
            seam = plan.path.targets[:, 0]
            for q in plan.path.q[:: (len(seam) - 1) // 4]:
                places = np.vstack([joint_frames(robot, q)[[2, 3, 5, 7], :3, 3], robot.fk(q).translation])
                left.plot(places[:, 0], places[:, k], "-o", color=COLOURS[0], lw=2, ms=3.5, mfc="white")
            left.plot(seam[:, 0, 3], seam[:, k, 3], color=COLOURS[1], lw=1.5)
            left.set(xlabel="x (m)", ylabel=f"{'xyz'[k]} (m)", title=name, aspect="equal")
            for pose, found in enumerate(plan.windows):
                for one in sorted(found, key=lambda one: one.branch == plan.branch):
                    mine = one.branch == plan.branch
                    right.vlines(
                        pose, 1000 * one.low, 1000 * one.high, color=COLOURS[0] if mine else "0.85", lw=3 if mine else 5
                    )
            right.plot(1000 * plan.lifts, color=COLOURS[1], lw=2)
            right.set(
                xlabel="pose along the seam",
                ylabel="lift (mm)",
                title=f"travel {1000 * plan.travel:.1f} mm",
                ylim=(-10, 450),
            )
        return figure

    return draw


def draw_maps(any_: Any, gaze: Any) -> Any:
    """Draw the two maps of the workspace."""

    def draw(plt: Any) -> Any:
        figure, axes = plt.subplots(1, 2, figsize=(8.0, 4.4), layout="constrained", width_ratios=(2, 1.3))
        for axis, found, what in zip(axes, (any_, gaze), ("manipulability", "share"), strict=True):
            values, grid = found.slice("y", 0.0, what)[0], found.grid
            ends = np.array([grid.low, grid.low + grid.size * grid.shape])
            box = {
                "origin": "lower",
                "extent": (*ends[:, 0], *ends[:, 2]),
                "interpolation": "nearest",
                "aspect": "equal",
            }
            image = axis.imshow(np.where(values > 0.0, values, np.nan).T, cmap="viridis", vmin=0.0, **box)
            axis.grid(False)
            axis.set(xlabel="x (m)", ylabel="z (m)", title=what if found is any_ else "share of turns, level gaze")
            figure.colorbar(image, ax=axis, shrink=0.8)
        return figure

    return draw
