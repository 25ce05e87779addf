"""How stable the number of self-motion curves of seven-joint arms is: with twice as many slices, and against planted solutions.

`python scripts/benchmarks/self_motion.py panda xarm7 -n 1000` prints a line for each robot (name or file).
"""

import argparse
from time import process_time

import numpy as np

import ik_toolkit as ik
from ik_toolkit.solvers.self_motion import FOLLOWING, self_motions


def measure(name: str, count: int, slices: int) -> str:
    """Compare the curves of random legal poses of a robot, found with so many slices and with twice as many."""
    robot = ik.Robot.load(name)
    plan, rng = ik.Solver(robot).plan, np.random.default_rng(1)
    curves, lost, spent = [], 0, 0.0
    for k in range(count):
        q = robot.random_q(rng)
        T = robot.fk(q).homogeneous
        began = process_time()
        found = self_motions(plan, T, slices)
        spent += process_time() - began if k else 0.0  # The first call compiles.
        curves.append((len(found), len(self_motions(plan, T, 2 * slices))))
        gaps = [np.abs((one.points - q + np.pi) % (2 * np.pi) - np.pi).max(axis=1).min() for one in found]
        lost += min(gaps, default=np.inf) > FOLLOWING.longest
    few, many = np.array(curves).T
    return (
        f"{robot.name}: {100 * (few == many).mean():.1f} % of {count} poses have as many curves with {2 * slices} slices as with "
        f"{slices} ({few.mean():.2f} on average); {lost} planted solutions on none; {1e3 * spent / max(1, count - 1):.1f} ms CPU"
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("robots", nargs="+")
    parser.add_argument("-n", type=int, default=1000)
    parser.add_argument("--slices", type=int, default=FOLLOWING.slices)
    asked = parser.parse_args()
    for robot_name in asked.robots:
        print(measure(robot_name, asked.n, asked.slices), flush=True)
