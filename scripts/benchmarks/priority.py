"""The option `priority`: how often is the best minimum found, is it a minimum, and what does it cost?

python scripts/benchmarks/priority.py                     all arms, position first
python scripts/benchmarks/priority.py so101 --first orientation
python scripts/benchmarks/priority.py so101 --beyond      targets out of reach

A target is the pose of a random configuration with its orientation turned by --turn about a random axis (0: as it is). It is hit
if the first level is in tolerance and the second within 1 % of the least of --starts single attempts from random starts and of
the answer itself. `first order` is the largest norm of the second level's gradient in the null space of the first, with joints
at a limit held only if that gradient pushes them outwards; it is computed by finite differences of Pinocchio's poses.
"""

import argparse
import time
from typing import Any

import common
import numpy as np
import pinocchio as pin

import ik_toolkit as ik

UR5_NARROW = [(-1.6, 1.6), (-2.2, 0.2), (-2.0, 2.0), (-1.5, 1.5), (-1.0, 1.0), (-1.5, 1.5)]
ARMS = ("so101", "so100", "palletizer", "scara", "ur5_narrow", "hydrolek_7w", "panda")
HIT = 0.01  # share by which the second level may exceed the least found, beside 1e-4 rad or reaches


def load(name: str) -> ik.Robot:
    """An arm of the benchmark."""
    if name != "ur5_narrow":
        return ik.Robot.load(name)
    ur5 = ik.Robot.load("ur5")
    return ur5.narrowed(dict(zip(ur5.joint_names, UR5_NARROW, strict=True)))


def targets(robot: ik.Robot, count: int, turn: float, beyond: bool, rng: np.random.Generator) -> np.ndarray:
    """Poses of random configurations, turned, or moved out of reach."""
    made = []
    for _ in range(count):
        T = robot.fk(robot.random_q(rng)).homogeneous.copy()
        axis = rng.normal(size=3)
        T[:3, :3] = pin.exp3(axis / np.linalg.norm(axis) * turn) @ T[:3, :3]
        if beyond:
            T[:3, 3] *= (robot.reach + rng.uniform(0.0, 0.5) * robot.reach) / np.linalg.norm(T[:3, 3])
        made.append(T)
    return np.array(made)


def levels(robot: ik.Robot, q: np.ndarray, T: np.ndarray, first: str) -> tuple[float, float]:
    """Errors of the first and the second level by Pinocchio."""
    position, orientation = robot.errors(q, T)
    return (position, orientation) if first == "position" else (orientation, position / robot.reach)


def first_order(robot: ik.Robot, q: np.ndarray, T: np.ndarray, first: str) -> float:
    """Norm of the gradient of the second level that no motion along the first level and the limits may lower."""

    def values(q: np.ndarray) -> np.ndarray:
        now = robot.fk(q).homogeneous
        turn = pin.log3(now[:3, :3] @ T[:3, :3].T)
        return np.concatenate([(now[:3, 3] - T[:3, 3]) / robot.reach, turn])

    h, unit = 1e-6, robot.chain.unit
    J = np.array([(values(q + h * unit * e) - values(q - h * unit * e)) / (2 * h) for e in np.eye(robot.n)])
    a, b = (slice(0, 3), slice(3, 6)) if first == "position" else (slice(3, 6), slice(0, 3))
    g, A = J[:, b] @ values(q)[b], J[:, a]
    g = g * (np.sin(x) / x if first == "position" and (x := np.linalg.norm(values(q)[b])) > 0 else 1.0)
    low, high = q <= robot.lower + 1e-12, q >= robot.upper - 1e-12
    held = np.zeros(robot.n, bool)
    for _ in range(2 * robot.n):
        free = ~held
        lam = np.linalg.lstsq(A[free], -g[free], rcond=1e-4)[0]
        z = g + A @ lam
        wrong = (low & (z > 0)) | (high & (z < 0))
        if (wrong == held).all():
            break
        held = wrong
    return float(np.linalg.norm(z[~held]))


def measure(name: str, o: argparse.Namespace) -> dict[str, Any]:
    """One arm."""
    robot, rng = load(name), np.random.default_rng(o.seed)
    T = targets(robot, o.targets, o.turn, o.beyond, rng)
    solver = ik.Solver(robot, priority=o.first)
    solver(T[0])
    times, found, evaluations = [], [], []
    for one in T:
        began = time.perf_counter()
        found.append(solver(one))
        times.append(time.perf_counter() - began)
        evaluations.append(found[-1].fk_evaluations)
    hits, reached, order = 0, 0, []
    for one, result in zip(T, found, strict=True):
        mine = levels(robot, result.q, one, o.first)
        tried = ik.solve_batch(
            robot, np.repeat(one[None], o.starts, 0), priority=o.first, restarts=0, check=0.0,
            q0=np.array([robot.random_q(rng) for _ in range(o.starts)]),
        )  # fmt: skip
        both = [
            mine,
            *(levels(robot, q, one, o.first) for q in tried.q[tried.success if not o.beyond else slice(None)]),
        ]
        least = min(pair[0] for pair in both) if o.beyond else 2e-6
        best = min((pair[1] for pair in both if pair[0] <= least + 1e-5 * o.beyond), default=np.inf)
        good = mine[0] <= least + 1e-5 * o.beyond and mine[1] <= (1 + HIT) * best + 1e-4
        reached += result.success
        hits += good
        if result.success:
            order.append(first_order(robot, result.q, one, o.first))
    micro = 1e6 * np.array(times)
    return {
        "arm": name, "hit": hits / len(T), "converged": reached / len(T),
        "first_order": max(order, default=0.0), "false": int(np.sum(np.array(order) > 1e-5)),
        "evaluations": (float(np.median(evaluations)), float(np.percentile(evaluations, 95))),
        "us": (float(np.median(micro)), float(np.percentile(micro, 95))),
    }  # fmt: skip


def main() -> None:
    """Print a row for each arm."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("arms", nargs="*", default=ARMS)
    parser.add_argument("--first", default="position", choices=("position", "orientation"))
    parser.add_argument("--turn", type=float, default=0.3, help="rad")
    parser.add_argument("--beyond", action="store_true")
    parser.add_argument("--targets", type=int, default=200)
    parser.add_argument("--starts", type=int, default=400)
    parser.add_argument("--seed", type=int, default=7)
    o = parser.parse_args()
    print(common.machine())
    for name in o.arms or ARMS:
        row = measure(name, o)
        print(
            f"{name:12} hit {row['hit']:.3f}  converged {row['converged']:.3f}  first order {row['first_order']:.1e}"
            f" ({row['false']} above 1e-5)  evaluations {row['evaluations'][0]:.0f}, p95 {row['evaluations'][1]:.0f}"
            f"  {row['us'][0]:.0f} us, p95 {row['us'][1]:.0f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
