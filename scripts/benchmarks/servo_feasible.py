"""Joint motions that keep well inside the limits, followed by their tip's poses alone: how many does `track` complete?

python scripts/benchmarks/servo_feasible.py --seeds 1 2 3 4

Each joint swings as a sum of three sines inside 0.9 of its range and 0.6 of its speed; 4 s, 100 samples a second. A motion counts
when no sample is off by more than 0.1 mm or 1 mrad. About a second for 60 motions of a robot.
"""

import argparse
import warnings
from collections import Counter

import numpy as np

import ik_toolkit as ik

ROBOTS = ("panda", "ur5", "inspection_7dof", "hydrolek_7w", "kinova")
DURATION, DT = 4.0, 0.01  # s
RANGE, SPEED = 0.9, 0.6  # shares of the limits
UNLIMITED = 1.5  # rad/s or m/s of a joint whose speed has no limit
TOLERANCES = {"position_tolerance": 1e-4, "orientation_tolerance": 1e-3}  # m, rad
STEP = 1e-5  # s; of the difference that gives dJ/dt


def motion(robot: ik.Robot, rng: np.random.Generator) -> tuple:
    """Reference of the tip, and joint values and rates at its start."""
    low, high = np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi)
    half = 0.5 * RANGE * (high - low)
    middle = 0.5 * (low + high) + half * rng.uniform(-0.8, 0.8, robot.n)
    v = np.where((robot.velocity_limits > 0.0) & (robot.velocity_limits < np.inf), robot.velocity_limits, UNLIMITED)
    w = 2.0 * np.pi * rng.uniform(0.2, 1.0, (3, robot.n)) / DURATION
    phase, share = rng.uniform(0.0, 2.0 * np.pi, (3, robot.n)), rng.uniform(0.2, 1.0, (3, robot.n))
    free = half - np.abs(middle - 0.5 * (low + high))
    size = share / share.sum(axis=0) * np.minimum(free, rng.uniform(0.1, 1.0, robot.n))
    size *= np.minimum(1.0, SPEED * v / (size * w).sum(axis=0))

    def joints(t: np.ndarray, order: int) -> np.ndarray:
        """Joint values (N, n) at t (N,), or their derivatives of an order."""
        swing = (size * w**order * np.sin(w * t[:, None, None] + phase + 0.5 * np.pi * order)).sum(axis=1)
        return swing + (middle if order == 0 else 0.0)

    def tip(t: np.ndarray) -> tuple:
        q, rate = joints(t, 0), joints(t, 1)
        T, J = robot.chain.forward(q, jacobian=True)
        after, before = (robot.chain.forward(q + s * STEP * rate, jacobian=True)[1] for s in (1.0, -1.0))
        bend = (after - before) / (2.0 * STEP)
        V = np.einsum("kij,kj->ki", J, rate)
        return T, V, np.einsum("kij,kj->ki", J, joints(t, 2)) + np.einsum("kij,kj->ki", bend, rate)

    start = np.zeros(1)
    return ik.Reference(tip, DURATION, name="joint motion"), joints(start, 0)[0], joints(start, 1)[0]


def main() -> None:
    """Print a line a robot, and one for each motion that was left."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--method", default="cv")
    parser.add_argument("--robots", nargs="*", default=list(ROBOTS))
    parser.add_argument("--seeds", nargs="*", type=int, default=[1])
    parser.add_argument("--count", type=int, default=60)
    given = parser.parse_args()
    warnings.simplefilter("ignore")  # gains are not what is asked here
    for name in given.robots:
        robot, found, left = ik.Robot.load(name), Counter(), []
        for seed in given.seeds:
            rng = np.random.default_rng(seed)
            for k in range(given.count):
                reference, q0, rate0 = motion(robot, rng)
                run = ik.track(robot, reference, given.method, dt=DT, q0=q0, rate0=rate0, **TOLERANCES)
                found[run.status.name] += 1
                if not run.success:
                    left.append((seed, k, run.status.name, 1e3 * float(run.position_error.max())))
        total = given.count * len(given.seeds)
        print(f"{name}: {total - len(left)} of {total} ({', '.join(f'{v} {s}' for s, v in found.items())})", flush=True)
        for seed, k, status, off in left:
            print(f"    seed {seed}, motion {k}: {status}, {off:.2g} mm")


if __name__ == "__main__":
    main()
