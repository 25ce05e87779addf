"""Time of the closed forms: in the compiled kernel, and through the public calls next to `lm`. Medians of interleaved runs.

python scripts/benchmarks/closed_form.py [-o closed_form.json]
"""

import argparse
from collections.abc import Callable
from pathlib import Path
from time import perf_counter

import common
import numpy as np

import ik_toolkit as ik
from ik_toolkit.kernel.counted_error import KIND
from ik_toolkit.kernel.records import SIZE
from ik_toolkit.solvers.closed_form import inspection, reach

TARGETS = 2000
CALLS = 300


def medians(works: dict[str, tuple[Callable[[], object], int]], runs: int = 15) -> dict[str, float]:
    """Median microseconds per solve of each (function, number of solves), with interleaved runs."""
    times: dict[str, list[float]] = {name: [] for name in works}
    for work, _ in works.values():
        work()
    for _ in range(runs):
        for name, (work, count) in works.items():
            start = perf_counter()
            work()
            times[name].append(1e6 * (perf_counter() - start) / count)
    return {name: float(np.median(values)) for name, values in times.items()}


def kernel_works(arm: ik.Robot, Q: np.ndarray, T: np.ndarray) -> dict[str, tuple[Callable[[], object], int]]:
    """Inspection arm, inside compiled code."""
    p = ik.Inspection().pack(arm)
    P = np.empty((len(T), 12))
    for pose, row in zip(T, P, strict=True):
        inspection.wrist_pose(p, pose, row)
    a4, a6 = p[inspection.A4], p[inspection.A6]
    lifts, near, sols = Q[:, 1].copy(), np.zeros(6), np.empty((8, 6))
    out = np.empty((len(T), SIZE.answer + arm.n))
    home = arm.home[None].copy()

    def solve(rule: ik.Inspection, start: np.ndarray) -> Callable[[], object]:
        plan = ik.Solver(arm, rule).plan
        return lambda: plan.run(T, (KIND.pose,), start, True, out)

    return {
        "kernel: 8 branches at a lift": (lambda: reach.many_branches(P, lifts, a4, a6, near, sols), len(T)),
        "kernel: 8 branches, limits, nearest to q0, evaluated (lift given)": (
            solve(ik.Inspection(lift=0.22), home),
            len(T),
        ),
        "kernel: the same, lift free, q0's lift feasible": (solve(ik.Inspection(), Q), len(T)),
        "kernel: the same, lift free, q0 = home (searches the lift where home's fails)": (
            solve(ik.Inspection(), home),
            len(T),
        ),
    }


def call_works(arm: ik.Robot, targets: list, q0: np.ndarray, names: tuple[str, ...]) -> dict:
    """Bound solvers and ik.solve from Python, started at q0 near each target's own configuration."""

    def loop(call: Callable) -> tuple[Callable[[], object], int]:
        def run() -> None:
            for target, start in zip(targets, q0, strict=True):
                call(target, start)

        return run, len(targets)

    works = {f"{arm.name}, bound {name}": loop(ik.Solver(arm, name)) for name in names}
    for name in names:
        works[f"{arm.name}, ik.solve {name}"] = loop(lambda T, q, name=name: ik.solve(arm, T, name, q0=q))
    return works


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, help="write the numbers to a JSON file")
    output = parser.parse_args().output
    rng = np.random.default_rng(0)
    arm, planar = ik.Robot.load("inspection_7dof"), ik.Robot.load("planar_2r")
    Q = np.array([arm.random_q(rng) for _ in range(TARGETS)])
    T = arm.chain.forward(Q)[0]
    near = np.clip(Q[:CALLS] + rng.uniform(-0.1, 0.1, (CALLS, arm.n)), arm.lower, arm.upper)
    flat = np.array([planar.random_q(rng) for _ in range(CALLS)])
    tips = planar.chain.forward(flat)[0][:, :3, 3].copy()
    works = kernel_works(arm, Q, T)
    works |= call_works(arm, list(T[:CALLS]), near, ("inspection", "lm"))
    works |= call_works(planar, list(tips), flat, ("planar-2r", "lm"))
    times = medians(works)
    width = max(map(len, times))
    for name, value in times.items():
        print(f"{name:<{width}}  {value:8.2f} us")
    if output:
        common.keep(output, {"machine": common.machine(), "median_us": times})


if __name__ == "__main__":
    main()
