"""Targets that swing slowly at random, in reach, at its edge and beyond: do joints chatter, and how close does the tip stay?

python scripts/benchmarks/servo_random.py --seeds 8

Swings below 1.5 Hz of 3 to 25 % of the reach, and turns of up to 1 rad, about a place that the tip goes to first; 4 s, 100 samples
a second, mostly too fast or too far for the arm. Chatter is counted as in servo_judge.py. The error is the root of the mean
square over the last 2.5 s, an angle counted at 0.2 m, in shares of the reach. About a minute for 13 robots and 8 seeds.
"""

import argparse
import warnings
from types import SimpleNamespace

import common

common.one_thread()

import numpy as np  # noqa: E402
import pinocchio as pin  # noqa: E402
from servo_judge import chatter  # noqa: E402
from servo_scenarios import DT, usual  # noqa: E402

import ik_toolkit as ik  # noqa: E402

ROBOTS = (
    "planar_2r", "planar_3r", "hydrolek_7w", "inspection_7dof", "panda", "ur5", "kinova", "xarm7", "so101", "two_dofs", "z1",
    "ur10_limited", "talos_arm",
)  # fmt: skip
PLACES = {"in reach": 0.6, "at its edge": 0.95, "beyond": 1.3}  # reaches from the base
STEPS, SETTLED = 400, 150
LEVER = 0.2  # m


def smooth(t: np.ndarray) -> np.ndarray:
    """From 0 to 1 over a second."""
    t = np.minimum(t, 1.0)
    return t * t * (3.0 - 2.0 * t)


def stream(robot: ik.Robot, seed: int, place: float, pose: bool) -> tuple[np.ndarray, list[np.ndarray]]:
    """Start (n,), and targets: positions (3,) or poses (4, 4)."""
    rng = np.random.default_rng(seed)
    q0 = robot.random_q(rng)
    start = robot.fk(q0)
    flat = np.ptp([robot.fk(robot.random_q(rng)).translation for _ in range(4)], axis=0) < 1e-9  # of a planar arm
    way, size, angle = rng.normal(size=3), robot.reach * rng.choice([0.03, 0.1, 0.25]), rng.choice([0.1, 0.5, 1.0])
    way[flat] = 0.0
    tempo, phase = 2.0 * np.pi * rng.uniform(0.1, 1.5, 6), rng.uniform(0.0, 2.0 * np.pi, 6)
    turn = pin.log3(start.rotation.T @ pin.Quaternion(rng.normal(size=4)).normalized().toRotationMatrix())
    t = DT * np.arange(STEPS)
    swings = smooth(2.0 * t)[:, None] * np.sin(np.outer(t, tempo) + phase)
    swings[:, :3][:, flat] = 0.0
    share, end = smooth(t)[:, None], place * robot.reach * way / np.linalg.norm(way)
    positions = start.translation + share * (end - start.translation) + size * swings[:, :3]
    if not pose:
        return q0, list(positions)
    turns = [
        start.rotation @ pin.exp3(a * turn) @ pin.exp3(angle * b) for a, b in zip(share, swings[:, 3:], strict=True)
    ]
    return q0, [pin.SE3(R, p).homogeneous for R, p in zip(turns, positions, strict=True)]


def run(robot: ik.Robot, method: str, acceleration: float, stream: tuple) -> tuple[int, float]:
    """Windows of chatter, and the error in reaches."""
    q0, targets = stream
    limits = acceleration * usual(robot) if acceleration else None
    tracker = ik.Tracker(robot, method, q0=q0, acceleration_limits=limits)
    steps = [tracker.update(target, DT) for target in targets]
    left = [step.position_error**2 + (LEVER * (step.orientation_error or 0.0)) ** 2 for step in steps[SETTLED:]]
    Q = np.array([q0, *(step.q for step in steps)])
    return chatter(SimpleNamespace(robot=robot), Q), float(np.sqrt(np.mean(left))) / robot.reach


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", nargs="+", default=ROBOTS)
    parser.add_argument("--methods", nargs="+", default=("cv", "aad"))
    parser.add_argument("--seeds", type=int, default=8, help="how many of each kind of stream")
    parser.add_argument(
        "--accelerations", nargs="+", type=float, default=(0.0, 5.0), help="limits, in speed limits a second; 0: none"
    )
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    robots = [ik.Robot.load(name) for name in given.robots]
    rows, total = [], [0, 0, 0]
    for method in given.methods:
        for acceleration in given.accelerations:
            for name, place in PLACES.items():
                found = [
                    run(robot, method, acceleration, stream(robot, seed, place, pose))
                    for robot in robots
                    for pose in ((False,) if robot.name.startswith("planar") else (False, True))
                    for seed in range(given.seeds)
                ]
                windows, errors = zip(*found, strict=True)
                counts = len(found), sum(w > 0 for w in windows), sum(windows)
                total = [a + b for a, b in zip(total, counts, strict=True)]
                rows.append([f"`{method}`", acceleration or "none", name, *counts, f"{np.mean(errors):.4f}"])
    print(common.table(["method", "acceleration", "targets", "runs", "with chatter", "windows", "error"], rows))
    print(f"{total[0]} runs, {total[1]} with chatter, {total[2]} windows")


if __name__ == "__main__":
    main()
