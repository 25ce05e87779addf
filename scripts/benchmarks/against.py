"""Compare two versions of the package in alternating rounds, each in its own process with its own cache: CPU and compile time.

python scripts/benchmarks/against.py OLD_CHECKOUT --compile 3 -o docs/data/benchmark_against.json

Only ratios are meaningful: one version measures while the other waits. Successes and iterations of both are listed, too. With
--compile N also the CPU time of first calls, each N times in a fresh process with an empty cache. About two minutes for the
rounds, two for each N, on an idle machine.
"""

import argparse
import inspect
import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from math import comb
from pathlib import Path
from time import process_time, thread_time

HERE = Path(__file__).resolve().parents[2]
RULES = ("lm", "dls", "pinv", "transpose", "ccd", "pid", "state-space")
ITEMS = (*RULES, "lanes", "python", "python tree", "track aad", "track dls")
COUNTS = {"lm": 1500, "lanes": 1500, "python": 1500, "dls": 200, "pinv": 60, "transpose": 60, "ccd": 60, "pid": 60}
FIRST = {  # compilation measured for the last of these items, after the others
    "LM": ("lm",), "several tips": ("python tree",), "a second rule (DLS)": ("lm", "dls"), "lanes": ("lm", "lanes"),
    "several tips after LM": ("lm", "python tree"),
}  # fmt: skip


def make_item(name: str, robot_name: str):
    """Function to time for an item, and its successes and iterations per solve afterwards."""
    import numpy as np

    import ik_toolkit as ik
    from ik_toolkit.kernel.counted_error import KIND

    count = COUNTS.get(name, 100)
    rng = np.random.default_rng(3)
    if name == "python tree":
        tips = ["left_tip", "right_tip"]
        load = getattr(ik, "Tree", None)
        tree = load.load("brokk_hydrolek", tips=tips) if load else ik.Robot.load("brokk_hydrolek", tip=tips)
        solver = ik.Solver(tree, "lm")
        targets = [np.array([T.homogeneous for T in tree.fk(tree.random_q(rng)).values()]) for _ in range(count)]
        results = []
        return lambda: results.__setitem__(slice(None), [solver(T) for T in targets]), count, lambda: _of(results)
    robot = ik.Robot.load(robot_name)
    if name.startswith("track"):
        T0 = robot.fk(robot.home + 0.3).homogeneous
        reference = ik.circle(T0, 0.05, duration=2.0)
        q0 = robot.home + 0.3
        # what the older one did
        clip = {"on_limit": "clip"} if "on_limit" in inspect.signature(ik.track).parameters else {}
        return lambda: ik.track(robot, reference, name.split()[1], dt=1e-3, q0=q0, **clip), 2000, lambda: (0, 0)
    T = np.array([robot.fk(robot.random_q(rng)).homogeneous for _ in range(count)])
    solver = ik.Solver(robot, "lm" if name in ("lanes", "python") else name)
    run, arrays, orders, home, width = parts_of(solver, KIND.pose)
    out = np.zeros((count, width))
    rows = lambda: (float((out[:, 0] == 0).mean()), float(out[:, 1].mean()))  # noqa: E731
    if name == "lanes":
        from ik_toolkit.kernel.simd_search import lanes

        return lambda: lanes()(*arrays, T, home, out, orders), count, rows
    if name == "python":
        results = []
        return lambda: results.__setitem__(slice(None), [solver(x) for x in T]), count, lambda: _of(results)
    return lambda: run(T, out), count, rows


def parts_of(solver, kind: int) -> tuple:
    """run(T, out), arrays, orders, home and the width of a row, of today's solvers and of those before plans."""
    plan = getattr(solver, "plan", None)
    if plan is None:
        arrays, orders, home, silent = solver.arrays(kind), solver.pack(kind, False), solver._home, solver._silent
        return lambda T, out: solver._kernel(*arrays, T, home, out, orders, silent), arrays, orders, home, solver._width
    arrays, orders = plan.arrays((kind,), plan.home), plan.orders((kind,), False)
    return lambda T, out: plan.run(T, (kind,), plan.home, False, out), arrays, orders, plan.home, plan.width


def _of(results: list) -> tuple[float, float]:
    return sum(r.success for r in results) / len(results), sum(r.iterations for r in results) / len(results)


def worker(names: list[str], robot: str) -> None:
    """Answer 'ready' with the cost and results of the first calls, 'go' with microseconds per solve for each item."""
    works, first = {}, {}
    for name in names:
        work, count, gave = make_item(name, robot)
        began = process_time()
        work()
        first[name] = [round(process_time() - began, 2), *gave()]
        works[name] = work, count
    for line in sys.stdin:
        times = {}
        for name, (work, count) in works.items():
            best = float("inf")
            for _ in range(3):
                began = thread_time()
                work()
                best = min(best, thread_time() - began)
            times[name] = 1e6 * best / count
        print(json.dumps(first if line.strip() == "ready" else times), flush=True)


def start(place: Path, cache: Path, robot: str, items: Sequence[str]) -> subprocess.Popen:
    """Start a worker on a checkout with a cache."""
    env = {**os.environ, "PYTHONPATH": str(place), "NUMBA_CACHE_DIR": str(cache), "OMP_NUM_THREADS": "1"}
    command = [sys.executable, __file__, "worker", robot, *items]
    return subprocess.Popen(command, env=env, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)


def ask(process: subprocess.Popen, word: str) -> dict:
    """Answer of a worker."""
    assert process.stdin is not None and process.stdout is not None
    process.stdin.write(word + "\n")
    process.stdin.flush()
    return json.loads(process.stdout.readline())


def end(process: subprocess.Popen) -> None:
    """End a worker."""
    assert process.stdin is not None
    process.stdin.close()
    process.wait()


def interval(values: list[float]) -> tuple[float, float]:
    """95 % interval of the median by order statistics (binomial distribution)."""
    n, k, below = len(values), 0, 0.0
    while below + comb(n, k) / 2**n <= 0.025:
        below += comb(n, k) / 2**n
        k += 1
    ordered = sorted(values)
    return ordered[max(k - 1, 0)], ordered[n - max(k, 1)]


def speed(places: Sequence[Path], given: argparse.Namespace) -> list[list]:
    """Rows (item, old, new [us], ratio, its interval, successes and iterations of both)."""
    processes = [start(place, given.cache / f"speed-{k}", given.robot, given.items) for k, place in enumerate(places)]
    first = [ask(process, "ready") for process in processes]
    times: list[dict[str, list[float]]] = [{}, {}]
    for k in range(given.rounds):
        for which in (0, 1) if k % 2 else (1, 0):
            for key, value in ask(processes[which], "go").items():
                times[which].setdefault(key, []).append(value)
    for process in processes:
        end(process)
    rows = []
    for key, old in times[0].items():
        ratios = [b / a for a, b in zip(old, times[1][key], strict=True)]
        middle = statistics.median(old), statistics.median(times[1][key]), statistics.median(ratios)
        rows.append([key, *middle, interval(ratios), first[0][key][1:], first[1][key][1:]])
    return rows


def compiling(places: Sequence[Path], given: argparse.Namespace) -> list[list]:
    """Rows (what, old, new): median CPU seconds of a first call in a fresh process with an empty cache."""
    rows = []
    for what, items in FIRST.items():
        found: list[list[float]] = [[], []]
        for k in range(given.compile):
            for which in (0, 1) if k % 2 else (1, 0):
                cache = given.cache / "first"
                shutil.rmtree(cache, ignore_errors=True)
                process = start(places[which], cache, given.robot, items)
                found[which].append(ask(process, "ready")[items[-1]][0])
                end(process)
        rows.append([what, *(statistics.median(f) for f in found)])
        print(*rows[-1], file=sys.stderr)
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("old", type=Path, help="checkout of the older version")
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--items", nargs="*", default=list(ITEMS), choices=ITEMS)
    parser.add_argument("--robot", default="panda")
    parser.add_argument("--compile", type=int, default=0, metavar="N", help="also first compiles, each N times")
    parser.add_argument("-o", "--output", type=Path, help="JSON to write, for page.py")
    given = parser.parse_args()
    from common import load_average, machine, table, write  # not in the workers: it imports the package

    places, load = (given.old.resolve(), HERE), load_average()
    with tempfile.TemporaryDirectory() as folder:
        given.cache = Path(folder)
        rows = speed(places, given) if given.items else []
        first = compiling(places, given) if given.compile else []
    head = [
        "",
        "before, us",
        "now, us",
        "ratio",
        "95 % interval",
        "successes before",
        "now",
        "iterations before",
        "now",
    ]
    tables = [
        table(
            head,
            [
                [f"`{key}`", f"{a:.3f}", f"{b:.3f}", f"**{r:.3f}**", f"{low:.3f} to {high:.3f}"]
                + [f"{x[0]:.4f}" for x in (was, is_)]
                + [f"{x[1]:.2f}" for x in (was, is_)]
                for key, a, b, r, (low, high), was, is_ in rows
            ],
        )
    ]
    if first:
        lines = [[what, f"{a:.1f}", f"{b:.1f}", f"{b / a:.2f}"] for what, a, b in first]
        tables.append(table(["first call with an empty cache", "before, CPU s", "now, CPU s", "ratio"], lines))
    if given.output:
        command = ["git", "-C", str(given.old), "rev-parse", "--short", "HEAD"]
        old = subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
        payload = {
            "old": old,
            "machine": machine(),
            "load_average": [load, load_average()],
            "rounds": given.rounds,
            "rows": rows,
        }
        write(given.output, {**payload, "first": first}, *tables)
    else:
        print("\n\n".join(tables))


if __name__ == "__main__":
    worker(sys.argv[3:], sys.argv[2]) if sys.argv[1:2] == ["worker"] else main()
