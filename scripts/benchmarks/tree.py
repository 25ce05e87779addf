"""Several tips solved together: random reachable poses for all tips, no starting guess, tolerances 1e-6 m and rad.

python scripts/benchmarks/tree.py      (robots other than brokk_hydrolek need the extra `robots`)

Single calls of a bound solver from Python, every success checked by Pinocchio; and the same targets as one batch on all cores,
best of three.
"""

import common

common.one_thread()

from time import perf_counter  # noqa: E402
from typing import Any  # noqa: E402

import numpy as np  # noqa: E402

import ik_toolkit as ik  # noqa: E402
from ik_toolkit.robot.library import find  # noqa: E402

ROBOTS = ("brokk_hydrolek", "tiago_dual", "baxter", "pr2", "talos", "tiago_pro", "centauro")
TOLERANCE = 1e-6  # m and rad


def measure(name: str, count: int, seed: int) -> dict[str, Any]:
    """Times of single solves, counts, and the rate of a batch."""
    tree = ik.Tree.load(name, tips=list(find(name).tips))
    Q = tree.random_q(np.random.default_rng(seed), count)
    targets = tree.chain.forward(Q)[0]
    solver = ik.Solver(tree)
    for target in targets[:20]:
        solver(target)
    seconds, results = np.empty(count), []
    for k, target in enumerate(targets):
        started = perf_counter()
        results.append(solver(target))
        seconds[k] = perf_counter() - started
    good = [r.success and right(tree, r.q, T) for r, T in zip(results, targets, strict=True)]
    ik.solve_batch(tree, targets[:100])
    rates, many = [], None
    for _ in range(3):
        started = perf_counter()
        many = ik.solve_batch(tree, targets)
        rates.append(count / (perf_counter() - started))
    return {
        "robot": name, "joints": tree.n, "tips": len(tree.tips), **common.rate(sum(good), count),
        **common.microseconds(seconds), "iterations": float(np.mean([r.iterations for r in results])),
        "restarts": float(np.mean([r.restarts for r in results])), "claimed": sum(r.success for r in results),
        "batch_solved": int(many.success.sum()), "per_second": max(rates), "rates": rates,
    }  # fmt: skip


def right(tree: ik.Tree, q: np.ndarray, T: np.ndarray) -> bool:
    """Whether every tip is at its target by Pinocchio, inside the limits."""
    worst = max(max(error) for error in tree.errors(q, T))
    return worst <= TOLERANCE and bool(((q >= tree.lower) & (q <= tree.upper)).all())


def main() -> None:
    parser = common.parser(__doc__, "benchmark_tree.json")
    parser.add_argument("--targets", type=int, default=10_000, help="pairs of poses per robot")
    parser.add_argument("--robots", nargs="+", default=ROBOTS)
    given = parser.parse_args()
    before = common.load_average()
    rows = []
    for name in given.robots:
        try:
            rows.append(measure(name, given.targets, given.seed))
        except ik.IKError as error:
            print(f"{name}: left out, {error}")
    heads = (
        "robot",
        "joints",
        "right, percent",
        "median, us",
        "mean",
        "p99",
        "iterations",
        "restarts",
        "batch: solved",
    )
    table = common.table(
        [*heads, "batch, targets a second (three runs)"],
        [
            [r["robot"], r["joints"], common.percent(r), *(common.short(r[k]) for k in ("median", "mean", "p99")),
             common.short(r["iterations"]), f"{r['restarts']:.2f}", r["batch_solved"],
             ", ".join(f"{x:,.0f}" for x in sorted(r["rates"]))]
            for r in rows
        ],
    )  # fmt: skip
    payload = {"machine": common.machine(), "load_average": [before, common.load_average()], "rows": rows}
    common.write(given.output, payload, table)


if __name__ == "__main__":
    main()
