"""Batch solves: targets per second against the number of targets and threads, and peak memory beyond input and output.

python scripts/benchmarks/batch.py

Every size runs in its own process, so that the peak memory is its own: the growth of the peak resident size during the solve,
less the size of the answers.
"""

import json
import os
import resource
import subprocess
import sys
from time import perf_counter, process_time
from typing import Any

import common
import numpy as np

import ik_toolkit as ik


def peak() -> int:
    """Peak resident size of this process [bytes]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def measure(name: str, count: int, threads: int, runs: int, seed: int) -> dict[str, Any]:
    """Solve `count` targets `runs` times and report the median time."""
    robot = ik.Robot.load(name)
    T = common.random_targets(robot, count, np.random.default_rng(seed))[1]
    ik.solve_batch(robot, T[:64], threads=threads)
    before = peak()
    busy, started = process_time(), perf_counter()
    done = ik.solve_batch(robot, T, threads=threads)
    seconds, processor = [perf_counter() - started], [process_time() - busy]
    size = done.table.nbytes
    beyond = max(0, peak() - before - size)
    solved = int(done.success.sum())
    for _ in range(runs - 1):
        busy, started = process_time(), perf_counter()
        ik.solve_batch(robot, T, threads=threads)
        seconds.append(perf_counter() - started)
        processor.append(process_time() - busy)
    return {
        "robot": name, "targets": count, "threads": threads, "solved": solved, "seconds": float(np.median(seconds)),
        "per_second": count / float(np.median(seconds)), "best_per_second": count / min(seconds),
        "processor_us": 1e6 * float(np.median(processor)) / count, "memory": beyond, "input": T.nbytes, "output": size,
    }  # fmt: skip


def main() -> None:
    parser = common.parser(__doc__, "benchmark_batch.json")
    parser.add_argument("--robots", nargs="+", default=("panda", "ur5"))
    parser.add_argument("--sizes", nargs="+", type=int, default=(100, 1000, 10_000, 100_000, 1_000_000))
    parser.add_argument("--threads", nargs="+", type=int, default=sorted({1, os.cpu_count() or 1}))
    parser.add_argument("--runs", type=int, default=5, help="runs per size (one from 1,000,000 targets on)")
    parser.add_argument("--one", metavar="JSON", help="(internal) measure one size in this process")
    given = parser.parse_args()
    if given.one:
        print(json.dumps(measure(**json.loads(given.one))))
        return
    before = common.load_average()
    rows = []
    for name in given.robots:
        for count in given.sizes:
            for threads in given.threads:
                runs = given.runs if count < 1_000_000 else 1
                task = {"name": name, "count": count, "threads": threads, "runs": runs, "seed": given.seed}
                command = [sys.executable, __file__, "--one", json.dumps(task)]
                run = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
                rows.append(json.loads(run.stdout))
                print(rows[-1], file=sys.stderr)
    table = common.table(
        ["robot", "targets", "threads", "seconds", "targets a second", "best run", "processor us a target", "solved",
         "memory beyond input and output, MB"],
        [
            [r["robot"], f"{r['targets']:,}", r["threads"], f"{r['seconds']:.3g}", f"{r['per_second']:,.0f}",
             f"{r['best_per_second']:,.0f}", f"{r['processor_us']:.2f}", f"{r['solved']:,}", f"{r['memory'] / 1e6:.1f}"]
            for r in rows
        ],
    )  # fmt: skip
    payload = {"machine": common.machine(), "load_average": [before, common.load_average()], "rows": rows}
    common.write(given.output, payload, "`solve_batch`, 1e-6 m and rad, no starting guess:", table)


if __name__ == "__main__":
    main()
