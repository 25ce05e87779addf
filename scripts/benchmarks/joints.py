"""Cost against the number of joints, from 3 to 40: generated chains of revolute joints.

python scripts/benchmarks/joints.py

A chain of n joints has links of 1/n m and axes that alternate between z, y and x; arms with fewer than six joints get
positions as targets, the others poses.
"""

import common

common.one_thread()

from time import perf_counter  # noqa: E402
from typing import Any  # noqa: E402

import numpy as np  # noqa: E402

import ik_toolkit as ik  # noqa: E402

LIMIT = 2.5  # rad either way


def chain_urdf(n: int) -> str:
    """URDF of the chain with n joints and 1 m of links."""
    axes = ("0 0 1", "0 1 0", "1 0 0")
    parts = ["<robot name='chain'><link name='l0'/>"]
    for k in range(n):
        parts.append(
            f"<link name='l{k + 1}'/><joint name='j{k}' type='revolute'><parent link='l{k}'/><child link='l{k + 1}'/>"
            f"<origin xyz='{(1 / n if k else 0):.9f} 0 0'/><axis xyz='{axes[k % 3]}'/>"
            f"<limit lower='{-LIMIT}' upper='{LIMIT}' effort='1' velocity='1'/></joint>"
        )
    parts.append(
        f"<link name='tip'/><joint name='end' type='fixed'><parent link='l{n}'/><child link='tip'/>"
        f"<origin xyz='{1 / n:.9f} 0 0'/></joint></robot>"
    )
    return "".join(parts)


def measure(n: int, count: int, seed: int) -> dict[str, Any]:
    """Times of single solves from Python, and counts."""
    robot = ik.Robot.load(chain_urdf(n), tip="tip")
    T = common.random_targets(robot, count, np.random.default_rng(seed))[1]
    targets = list(T) if n >= 6 else [np.ascontiguousarray(t[:3, 3]) for t in T]
    solver = ik.Solver(robot)
    for target in targets[:20]:
        solver(target)
    seconds, good, iterations = np.empty(count), 0, 0
    for k, target in enumerate(targets):
        started = perf_counter()
        result = solver(target)
        seconds[k] = perf_counter() - started
        good += result.success
        iterations += result.iterations
    each = 1e6 * seconds.sum() / max(1, iterations)
    return {
        "joints": n, "task": "pose" if n >= 6 else "position", **common.rate(good, count),
        **common.microseconds(seconds), "iterations": iterations / count, "us_per_iteration": each,
    }  # fmt: skip


def main() -> None:
    parser = common.parser(__doc__, "benchmark_joints.json")
    parser.add_argument("--joints", nargs="+", type=int, default=(3, 4, 5, 6, 7, 8, 10, 12, 16, 20, 25, 30, 35, 40))
    parser.add_argument("--targets", type=int, default=1000, help="targets per chain")
    given = parser.parse_args()
    before = common.load_average()
    rows = [measure(n, given.targets, given.seed) for n in given.joints]
    table = common.table(
        ["joints", "task", "median, us", "mean", "p99", "iterations, mean", "us an iteration", "success, percent"],
        [
            [r["joints"], r["task"], *(common.short(r[k]) for k in ("median", "mean", "p99", "iterations")),
             f"{r['us_per_iteration']:.2f}", common.percent(r)]
            for r in rows
        ],
    )  # fmt: skip
    payload = {"machine": common.machine(), "load_average": [before, common.load_average()], "rows": rows}
    common.write(given.output, payload, "Bound solver from Python, 1e-6 m and rad, no starting guess:", table)


if __name__ == "__main__":
    main()
