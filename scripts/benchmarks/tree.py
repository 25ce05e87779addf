"""Success and time of several tips solved together: random reachable targets, no starting guess, 1e-6 m and rad.

python scripts/benchmarks/tree.py [-n TARGETS] [-o tree.json]      (robots beside brokk_hydrolek need the extra `robots`)
"""

import argparse
import json
import platform
from time import perf_counter
from typing import Any

import numpy as np

import ik_toolkit as ik
from ik_toolkit.robot.library import find

ROBOTS = ("brokk_hydrolek", "talos", "tiago_dual", "tiago_pro", "baxter", "pr2", "centauro")


def measure(name: str, count: int, seed: int) -> dict[str, Any]:
    """Bound solver called from Python, one target after the other; every success is checked by Pinocchio."""
    tree = ik.Tree.load(name, tips=list(find(name).tips))
    rng = np.random.default_rng(seed)
    targets = tree.chain.forward(np.array([tree.random_q(rng) for _ in range(count)]))[0]
    solver = ik.Solver(tree)
    solver(targets[0])  # compiles or loads
    times, results = np.empty(count), []
    for k, target in enumerate(targets):
        start = perf_counter()
        results.append(solver(target))
        times[k] = 1e6 * (perf_counter() - start)
    worst = 0.0
    for result, target in zip(results, targets, strict=True):
        if result.success:
            worst = max(worst, *(max(error) for error in tree.errors(result.q, target)))
    return {
        "robot": name,
        "joints": tree.n,
        "shared": int((tree.chain.owner < 0).sum()),
        "solved": sum(result.success for result in results),
        "targets": count,
        "mean_us": times.mean(),
        "median_us": np.median(times),
        "p99_us": np.percentile(times, 99),
        "iterations": np.mean([result.iterations for result in results]),
        "restarts_max": max(result.restarts for result in results),
        "worst_error": worst,
    }


def main() -> None:
    """Print the table, and write it as JSON when asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-n", type=int, default=10_000, help="targets a robot")
    parser.add_argument("--seed", type=int, default=123)
    parser.add_argument("-o", "--output")
    arguments = parser.parse_args()
    rows = []
    print(
        "robot            joints shared        solved   mean us  median     p99  iterations  restarts (max)  worst error"
    )
    for name in ROBOTS:
        try:
            row = measure(name, arguments.n, arguments.seed)
        except ik.IKError as error:
            print(f"{name}: left out, {error}")
            continue
        rows.append(row)
        print(
            "{robot:16s} {joints:6d} {shared:6d} {solved:7d}/{targets} {mean_us:9.1f} {median_us:7.1f} {p99_us:7.0f} "
            "{iterations:11.1f} {restarts_max:15d} {worst_error:12.1e}".format(**row),
            flush=True,
        )
    if arguments.output:
        with open(arguments.output, "w", encoding="utf-8") as file:
            json.dump(
                {"machine": platform.processor() or platform.machine(), "rows": rows}, file, indent=2, default=float
            )


if __name__ == "__main__":
    main()
