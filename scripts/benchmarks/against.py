"""Two versions of the package in alternate rounds, each in a process and with a cache of its own: CPU time, and what compiles.

python scripts/benchmarks/against.py OLD_CHECKOUT [--rounds 15] [--items lm lanes ...]

Only ratios count; the two processes never run at the same time. 'first' is the CPU time of the first call: with an empty
cache (--empty) the compiler, otherwise loading. Successes and iterations of both versions stand beside it.
"""

import argparse
import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from time import process_time, thread_time

HERE = Path(__file__).resolve().parents[2]
RULES = ("lm", "dls", "pinv", "transpose", "ccd", "pid", "state-space")
ITEMS = (*RULES, "lanes", "python", "python tree", "track aad", "track dls")
COUNTS = {"lm": 1500, "lanes": 1500, "python": 1500, "dls": 200, "pinv": 60, "transpose": 60, "ccd": 60, "pid": 60}


def make_item(name: str, robot_name: str):
    """Work of an item, and successes and iterations a solve when it has run."""
    import numpy as np

    import ik_toolkit as ik
    from ik_toolkit.kernel.task import POSE

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
        return lambda: ik.track(robot, reference, name.split()[1], dt=1e-3, q0=q0), 2000, lambda: (0, 0)
    T = np.array([robot.fk(robot.random_q(rng)).homogeneous for _ in range(count)])
    solver = ik.Solver(robot, "lm" if name in ("lanes", "python") else name)
    kernel, arrays, orders, home, silent, width = parts_of(solver, POSE)
    out = np.zeros((count, width))
    rows = lambda: (float((out[:, 0] == 0).mean()), float(out[:, 1].mean()))  # noqa: E731
    if name == "lanes":
        from ik_toolkit.kernel.lanes import lanes

        return lambda: lanes()(*arrays, T, home, out, orders), count, rows
    if name == "python":
        results = []
        return lambda: results.__setitem__(slice(None), [solver(x) for x in T]), count, lambda: _of(results)
    return lambda: kernel(*arrays, T, home, out, orders, silent), count, rows


def parts_of(solver, kind: int) -> tuple:
    """Loop, arrays, orders, home, an empty history and the width of a row, of today's solvers and of those before plans."""
    plan = getattr(solver, "plan", None)
    if plan is None:
        return (
            solver._kernel, solver.arrays(kind), solver.pack(kind, False), solver._home, solver._silent, solver._width
        )  # fmt: skip
    return plan.kernel, plan.arrays((kind,), plan.home), plan.orders((kind,), False), plan.home, plan.silent, plan.width


def _of(results: list) -> tuple[float, float]:
    return sum(r.success for r in results) / len(results), sum(r.iterations for r in results) / len(results)


def worker(names: list[str], robot: str) -> None:
    """Answer 'ready' with what the first calls cost and gave, 'go' with microseconds a piece for each item."""
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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("old", type=Path)
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--items", nargs="+", default=list(ITEMS), choices=ITEMS)
    parser.add_argument("--robot", default="panda")
    parser.add_argument("--empty", action="store_true", help="begin with empty caches: what compiling costs")
    given = parser.parse_args()
    processes = []
    for place in (given.old.resolve(), HERE):
        cache = Path(tempfile.gettempdir()) / f"ik-against-{place.name}"
        if given.empty:
            shutil.rmtree(cache, ignore_errors=True)
        env = {**os.environ, "PYTHONPATH": str(place), "NUMBA_CACHE_DIR": str(cache), "OMP_NUM_THREADS": "1"}
        command = [sys.executable, __file__, "worker", given.robot, *given.items]
        processes.append(subprocess.Popen(command, env=env, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True))

    def ask(process: subprocess.Popen, word: str) -> dict:
        process.stdin.write(word + "\n")
        process.stdin.flush()
        return json.loads(process.stdout.readline())

    first = [ask(process, "ready") for process in processes]
    times: list[dict[str, list[float]]] = [{}, {}]
    for k in range(given.rounds):
        for which in (0, 1) if k % 2 else (1, 0):
            for key, value in ask(processes[which], "go").items():
                times[which].setdefault(key, []).append(value)
    print(f"{'':14} {'old':>9} {'new':>9} us  ratio (95 %)         first call [s]   successes       iterations")
    for key, old in times[0].items():
        new = times[1][key]
        ratios = sorted(b / a for a, b in zip(old, new, strict=True))
        low, high = ratios[int(0.025 * len(ratios))], ratios[-1 - int(0.025 * len(ratios))]
        a, b = first[0][key], first[1][key]
        print(
            f"{key:14} {statistics.median(old):9.3f} {statistics.median(new):9.3f}     {statistics.median(ratios):.3f} "
            f"({low:.3f}-{high:.3f})  {a[0]:6.2f} {b[0]:6.2f}   {a[1]:.4f} {b[1]:.4f}   {a[2]:.3f} {b[2]:.3f}"
        )
    for process in processes:
        process.stdin.close()
        process.wait()


if __name__ == "__main__":
    worker(sys.argv[3:], sys.argv[2]) if sys.argv[1:2] == ["worker"] else main()
