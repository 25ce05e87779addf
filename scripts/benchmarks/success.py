"""Success rate of the default solver: 100,000 random reachable targets per robot, no starting guess.

python scripts/benchmarks/success.py            six robots
python scripts/benchmarks/success.py --million  and 1,000,000 targets of the Panda from an iterator, memory watched

A target is the pose of a random configuration inside the limits. Success is as reported by the batch; a random 1 % of the
answers is checked by Pinocchio, including limits.
"""

import resource
from collections.abc import Iterator
from typing import Any

import common
import numpy as np

import ik_toolkit as ik

CHUNK = 10_000
MORE = 1000  # restarts for the targets that failed
RESTARTS = (0, 1, 3, 7, 15, 31, 63)  # the table gives the share of targets that needed at most this many


def check(robot: ik.Robot, targets: np.ndarray, q: np.ndarray, success: np.ndarray, rows: np.ndarray) -> dict[str, Any]:
    """Errors of the given rows by Pinocchio, and the number of successes it does not confirm."""
    wrong, worst = 0, [0.0, 0.0]
    for k in rows[success[rows]]:
        position, orientation = robot.errors(q[k], targets[k])
        worst = [max(worst[0], position), max(worst[1], orientation or 0.0)]
        wrong += position > 1e-6 or (orientation or 0.0) > 1e-6 or bool(robot.outside(q[k]))
    return {"checked": int(success[rows].sum()), "not_confirmed": wrong, "worst_m": worst[0], "worst_rad": worst[1]}


def again(robot: ik.Robot, targets: np.ndarray) -> dict[str, Any]:
    """Solve the failed targets again with more restarts: were they hard, or impossible?"""
    if not len(targets):
        return {"restarts": MORE, "targets": 0, "solved": 0}
    done = ik.solve_batch(robot, targets, restarts=MORE)
    return {"restarts": MORE, "targets": len(targets), "solved": int(done.success.sum())}


def measure(name: str, count: int, seed: int) -> dict[str, Any]:
    """One robot."""
    robot = ik.Robot.load(name)
    rng = np.random.default_rng(seed)
    T = common.random_targets(robot, count, rng)[1]
    done = ik.solve_batch(robot, T)
    good, restarts = done.success, done.restarts
    inside = ((done.q >= robot.lower) & (done.q <= robot.upper)).all(axis=1)
    rows = rng.choice(count, max(1, count // 100), replace=False)
    return {
        "robot": name, **common.rate(int(good.sum()), count), "statuses": done.counts(), "inside": int(inside.sum()),
        "worst_position_error": float(done.position_error[good].max()),
        "worst_orientation_error": float(done.orientation_error[good].max()),
        "restarts": {str(most): float((restarts[good] <= most).mean()) for most in RESTARTS},
        "most_restarts": int(restarts[good].max()), "iterations": float(done.iterations.mean()),
        "pinocchio": check(robot, T, done.q, good, rows), "again": again(robot, T[~good]),
    }  # fmt: skip


def chunks(robot: ik.Robot, count: int, seed: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Targets (CHUNK, 4, 4) and the 1 % of their rows to check; the same every time."""
    rng = np.random.default_rng(seed)
    for _ in range(0, count, CHUNK):
        yield common.random_targets(robot, CHUNK, rng)[1], rng.choice(CHUNK, CHUNK // 100, replace=False)


def million(seed: int, count: int = 1_000_000) -> dict[str, Any]:
    """Panda targets from an iterator; peak memory at a quarter and at the end, less the stored answers."""
    robot = ik.Robot.load("panda")
    peaks: list[tuple[int, int]] = []

    def progress(done: int) -> None:
        peaks.append((done, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024))

    ik.solve_batch(robot, np.tile(np.eye(4), (8, 1, 1)))
    done = ik.solve_batch(robot, (T for T, _ in chunks(robot, count, seed)), progress=progress)
    width = done.table.shape[1] * 8
    early = next((d, p) for d, p in peaks if d >= count // 4)
    good = done.success
    total = {"checked": 0, "not_confirmed": 0, "worst_m": 0.0, "worst_rad": 0.0}
    failed = []
    for k, (T, rows) in enumerate(chunks(robot, count, seed)):
        part = slice(k * CHUNK, (k + 1) * CHUNK)
        failed.append(T[~good[part]])
        found = check(robot, T, done.q[part], good[part], rows)
        total = {key: (max if key.startswith("worst") else int.__add__)(total[key], found[key]) for key in total}
    return {
        "robot": "panda", **common.rate(int(good.sum()), count), "statuses": done.counts(),
        "worst_position_error": float(done.position_error[good].max()),
        "worst_orientation_error": float(done.orientation_error[good].max()),
        "peak_at_quarter": early[1] - early[0] * width, "peak_at_end": peaks[-1][1] - peaks[-1][0] * width,
        "answers": count * width, "pinocchio": total, "again": again(robot, np.concatenate(failed)),
    }  # fmt: skip


def main() -> None:
    parser = common.parser(__doc__, "benchmark_success.json")
    parser.add_argument("--robots", nargs="+", default=common.ROBOTS)
    parser.add_argument("--targets", type=int, default=100_000, help="targets per robot")
    parser.add_argument("--million", action="store_true", help="also 1,000,000 targets of the Panda")
    given = parser.parse_args()
    rows = [measure(name, given.targets, given.seed) for name in given.robots]
    parts = [
        "Default solver `lm`, 1e-6 m and rad, no starting guess; errors are the largest among the successes:",
        common.table(
            ["robot", "solved", "of", "percent (95 % interval)", "worst error, m", "rad", "not confirmed by Pinocchio",
             f"failed ones solved with {MORE} restarts"],
            [
                [r["robot"], f"{r['solved']:,}", f"{r['targets']:,}", common.percent(r), f"{r['worst_position_error']:.2g}",
                 f"{r['worst_orientation_error']:.2g}", f"{r['pinocchio']['not_confirmed']} of {r['pinocchio']['checked']:,}",
                 f"{r['again']['solved']} of {r['again']['targets']}"]
                for r in rows
            ],
        ),
        "Percent of the solved targets that needed at most so many restarts:",
        common.table(
            ["robot", *map(str, RESTARTS), "most", "iterations, mean"],
            [
                [r["robot"], *(f"{100 * share:.5g}" for share in r["restarts"].values()), r["most_restarts"],
                 f"{r['iterations']:.1f}"]
                for r in rows
            ],
        ),
    ]  # fmt: skip
    payload: dict[str, Any] = {"machine": common.machine(), "rows": rows}
    if given.million:
        big = payload["million"] = million(given.seed)
        growth = (big["peak_at_end"] - big["peak_at_quarter"]) / 1e6
        parts.append(
            f"1,000,000 Panda targets from an iterator: {big['solved']:,} solved; of the {big['again']['targets']} others "
            f"{big['again']['solved']} are solved with {MORE} restarts; "
            f"{big['pinocchio']['not_confirmed']} of {big['pinocchio']['checked']:,} checked by Pinocchio not confirmed; "
            f"peak memory without the answers grew by {growth:.1f} MB from a quarter of the targets to the end."
        )
    common.write(given.output, payload, *parts)


if __name__ == "__main__":
    main()
