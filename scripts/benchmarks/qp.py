"""Cost of the constrained step alone, by number of joints and active constraints: median, p99 and worst, in microseconds.

python scripts/benchmarks/qp.py [-o qp.json]
"""

import common

common.one_thread()

import argparse  # noqa: E402
from pathlib import Path  # noqa: E402
from time import perf_counter  # noqa: E402

import numpy as np  # noqa: E402

from ik_toolkit.compile.jit import cached  # noqa: E402
from ik_toolkit.servo.constrained_step import MODE, Allowed, StepTaken, TaskRate, constrain, make_room  # noqa: E402

ROWS = 12
SAMPLES = 40  # consecutive problems, each slightly different from the previous one, as in a run
INNER = 50  # steps per timing: a call from Python costs some microseconds
REPEATS = 15  # the minimum of these is a step's own time: background load only adds
# Mode, speed limits over what the task needs (0: the wanted motion fits), number of half-planes.
CASES = {
    "x_want fits": (MODE.leave, 0.0, 0),
    "leave": (MODE.leave, 0.3, 0),
    "direct": (MODE.direct, 0.3, 0),
    "leave, 12 half-planes": (MODE.leave, 0.3, ROWS),
    "direct, 12 half-planes": (MODE.direct, 0.3, ROWS),
    "nearly everything binds": (MODE.direct, 0.03, ROWS),
}


@cached
def run(J, v, want, low, high, planes, count, mode, repeats, active, kept):
    """Run the steps `repeats` times from the same start; returns the sum of their statuses."""
    n, m = J.shape[1], J.shape[2]
    A, b = planes[:, :n].copy(), planes[:, n].copy()
    room = make_room(n, m, A.shape[0])
    weight, size, at_rest = np.ones(m), np.ones(n), np.zeros(n)
    taken = StepTaken(np.empty(n), active, kept)
    before, held = active.copy(), kept.copy()
    total = 0
    for _ in range(repeats):
        active[:] = before
        kept[:] = held
        for i in range(J.shape[0]):
            asked = TaskRate(J[i], weight, weight, v[i], want[i], at_rest, size, mode, 0.01, 0.0)
            total += constrain(asked, Allowed(low, high, A, b, count), room, taken)
    return total


def measure(n: int, case: tuple, runs: int, rng: np.random.Generator) -> np.ndarray:
    """Microseconds of each step, the minimum of REPEATS."""
    mode, tight, count = case
    times = []
    for _ in range(runs):
        J = rng.normal(size=(n, 6)) + np.cumsum(0.02 * rng.normal(size=(SAMPLES, n, 6)), axis=0)
        x = rng.normal(size=n) + np.cumsum(0.02 * rng.normal(size=(SAMPLES, n)), axis=0)
        v = np.einsum("tij,ti->tj", J, x)
        reach = 10.0 if tight == 0.0 else 3.0 * tight * np.sqrt(6.0 / n)
        low, high = -reach * rng.uniform(0.3, 1.0, n), reach * rng.uniform(0.3, 1.0, n)
        planes = np.column_stack([rng.normal(size=(ROWS, n)), reach * rng.uniform(0.0, 0.3, ROWS)])
        active, kept = np.zeros(n, np.int8), np.zeros(ROWS, np.int8)
        for i in range(SAMPLES):
            one = [J[i : i + 1], v[i : i + 1], x[i : i + 1], low, high, planes, count, mode]
            spent, started = [], (active.copy(), kept.copy())
            for _ in range(REPEATS):
                active[:], kept[:] = started
                start = perf_counter()
                run(*one, INNER, active, kept)
                spent.append((perf_counter() - start) / INNER)
            times.append(min(spent) * 1e6)
    return np.array(times)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=10)
    parser.add_argument("-o", "--output", type=Path)
    options = parser.parse_args()
    found = {}
    print("| joints | case | median | p99 | worst |\n|---|---|---|---|---|")
    for n in (7, 16, 30):
        for name, case in CASES.items():
            times = measure(n, case, options.runs, np.random.default_rng(n))
            row = {"median": np.median(times), "p99": np.percentile(times, 99), "worst": times.max()}
            found[f"{n}, {name}"] = row
            print(f"| {n} | {name} | " + " | ".join(f"{value:.2f}" for value in row.values()) + " |", flush=True)
    if options.output:
        common.keep(options.output, {"machine": common.machine(), "microseconds": found})


if __name__ == "__main__":
    main()
