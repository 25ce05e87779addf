"""Single solves from Python: our solvers and the peers on the same targets, starts and tolerances.

python scripts/benchmarks/solve.py --venvs ~/.cache/ik_toolkit_peers

Every peer runs in its own process with its own virtual environment (created under --venvs the first time), one at a time: each
gets a block of targets in turn, so that background load affects all alike. A worker times each call itself; failures count.
Every answer is checked here by Pinocchio against the limits and both tolerances.
"""

import json
import sys
import tempfile
from collections.abc import Callable
from itertools import pairwise, product
from pathlib import Path
from typing import Any

import common

common.one_thread()

import numpy as np  # noqa: E402
import pinocchio as pin  # noqa: E402
from peers import BY_NAME, PEERS, Peer, Process  # noqa: E402
from worker import EDGE, wrapped  # noqa: E402

import ik_toolkit as ik  # noqa: E402

WARM = 20  # untimed solves at the start


def describe(robot: ik.Robot, folder: Path) -> dict[str, Any]:
    """Robot description for a worker: URDF (text and file), limits, and joint axes at q = 0."""
    path = folder / f"{robot.name}.urdf"
    path.write_text(robot.urdf or "", encoding="utf-8")
    zero = robot.fk(np.zeros(robot.n))
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, pin.neutral(robot.model))
    points = [np.zeros(3), *(data.oMi[k].translation for k in range(1, robot.n + 1)), zero.translation]
    return {
        "path": str(path), "urdf": robot.urdf, "base": robot.base, "tip": robot.tip, "lower": robot.lower.tolist(),
        "upper": robot.upper.tolist(), "H": robot.jacobian(np.zeros(robot.n))[3:].T.tolist(),
        "P": np.diff(points, axis=0).tolist(), "R_tip": zero.rotation.tolist(), "T_zero": zero.homogeneous.tolist(),
    }  # fmt: skip


def right(robot: ik.Robot, answers: np.ndarray, T: np.ndarray, tolerance: tuple[float, float]) -> np.ndarray:
    """Which targets (N,) have an answer inside limits and tolerances, by Pinocchio. Full turns are removed first."""
    good = np.zeros(len(T), dtype=bool)
    for k, solutions in enumerate(answers):
        for q in solutions[np.isfinite(solutions).all(axis=1)]:
            q = wrapped(q, robot.lower, robot.upper)
            if (q < robot.lower - EDGE).any() or (q > robot.upper + EDGE).any():
                continue
            position, orientation = robot.errors(q, T[k])
            if position <= tolerance[0] and (orientation or 0.0) <= tolerance[1]:
                good[k] = True
                break
    return good


def starts(robot: ik.Robot, Q: np.ndarray, kind: str, rng: np.random.Generator) -> np.ndarray:
    """Start configurations (N, n): random inside the limits, or within NEAR of a solution."""
    if kind == "near":
        return np.clip(Q + rng.uniform(-common.NEAR, common.NEAR, Q.shape), robot.lower, robot.upper)
    return np.array([robot.random_q(rng) for _ in Q])


def compare(
    robot: ik.Robot,
    processes: dict[str, Process],
    kind: str,
    name: str,
    count: int,
    blocks: int,
    seed: int,
    folder: Path,
) -> dict[str, Any]:
    """One robot, one kind of start, one tolerance: times and correct answers of every applicable peer."""
    tolerance = common.TOLERANCES[name]
    rng = np.random.default_rng(seed)
    Q, T = common.random_targets(robot, count + WARM, rng)
    q0 = starts(robot, Q, kind, rng)
    description = {**describe(robot, folder), "tol_p": tolerance[0], "tol_r": tolerance[1], "near": kind == "near"}
    times: dict[str, list[np.ndarray]] = {}
    answers: dict[str, list[np.ndarray]] = {}
    refused: dict[str, str] = {}
    for key, process in processes.items():
        if process.peer.six and robot.n != 6:
            continue
        try:
            process.build(description)
            process.solve(T[count:], q0[count:])
            times[key], answers[key] = [], []
        except RuntimeError as error:
            refused[key] = str(error)
    edges = np.linspace(0, count, blocks + 1).astype(int)
    for a, b in pairwise(edges):
        for key in list(times):
            end = min(b, int(count * processes[key].peer.share))
            if a >= end:
                continue
            try:
                seconds, found = processes[key].solve(T[a:end], q0[a:end])
            except RuntimeError as error:
                refused[key] = str(error)
                times.pop(key)
                continue
            times[key].append(seconds)
            answers[key].append(right(robot, found, T[a:end], tolerance))
    rows = {}
    for key in times:
        seconds, good = np.concatenate(times[key], axis=1), np.concatenate(answers[key])
        summary = {"wall": common.microseconds(seconds[0]), "processor": common.microseconds(seconds[1])}
        rows[key] = {**common.rate(int(good.sum()), len(good)), **summary, "seconds": seconds}
    return {"robot": robot.name, "start": kind, "tolerance": name, "rows": rows, "refused": refused}


def ratios(run: dict[str, Any], against: str) -> None:
    """Add the speed ratio to `against` on the same targets to every row, then drop the individual times."""
    reference = run["rows"].get(against)
    for row in run["rows"].values():
        if reference is None:
            continue
        count = row["targets"]
        if count <= reference["targets"]:
            row["faster"] = {}
            for clock, times in zip(("wall", "processor"), reference["seconds"], strict=True):
                other = common.microseconds(times[:count])
                row["faster"][clock] = {key: other[key] / row[clock][key] for key in ("median", "mean", "p99")}
    for row in run["rows"].values():
        del row["seconds"]


def settled(rounds: list[dict[str, Any]]) -> dict[str, Any]:
    """Merge rounds into one run: the median of each figure (the machine has slow minutes), and the sum of the successes."""
    rows = {}
    for key in rounds[0]["rows"]:
        same = [run["rows"][key] for run in rounds if key in run["rows"]]
        rows[key] = common.rate(sum(row["solved"] for row in same), sum(row["targets"] for row in same))
        rows[key] |= _medians(
            [{part: row[part] for part in ("wall", "processor", "faster") if part in row} for row in same]
        )
    return {**rounds[0], "rows": rows, "refused": {k: v for run in rounds for k, v in run["refused"].items()}}


def _medians(same: list[Any]) -> Any:
    """Median of each number in dictionaries of the same structure."""
    if isinstance(same[0], dict):
        return {key: _medians([part[key] for part in same]) for key in same[0]}
    return float(np.median(same))


def tables(runs: list[dict[str, Any]], against: str) -> list[str]:
    """Markdown: for each kind of start and tolerance the times, the ratios and the successes."""
    parts = []
    for kind, name in dict.fromkeys((run["start"], run["tolerance"]) for run in runs):
        group = [run for run in runs if (run["start"], run["tolerance"]) == (kind, name)]
        keys = [peer.name for peer in PEERS if any(peer.name in run["rows"] for run in group)]
        head = ["solver", *(run["robot"] for run in group)]
        position, orientation = common.TOLERANCES[name]
        start = "random starts" if kind == "random" else f"starts within {common.NEAR} rad of a solution"
        parts.append(f"### {start[0].upper()}{start[1:]}, {position:g} m and {orientation:g} rad")
        for title, cell in (
            ("Microseconds a solve, median / mean / 99th percentile:", _times),
            (f"Times faster than `{against}` in the same run, median / 99th percentile:", _faster("wall")),
            (
                "The same in processor time of all threads, which other work on the machine does not touch (reading this "
                "clock counts, which weighs on the fastest):",
                _faster("processor"),
            ),
            ("Success (within limits and tolerances by Pinocchio), percent (95 % interval), and targets:", _success),
        ):
            rows = {key: [cell(run["rows"].get(key)) for run in group] for key in keys}
            if any(any(cells) for key, cells in rows.items() if key != against):  # ratios need the same targets
                parts += [title, common.table(head, [[f"`{key}`", *cells] for key, cells in rows.items()])]
    return parts


def _times(row: dict[str, Any] | None) -> str:
    return "" if row is None else " / ".join(common.short(row["wall"][key]) for key in ("median", "mean", "p99"))


def _faster(clock: str) -> Callable[[dict[str, Any] | None], str]:
    def cell(row: dict[str, Any] | None) -> str:
        if row is None or "faster" not in row:
            return ""
        return " / ".join(common.short(row["faster"][clock][key]) for key in ("median", "p99"))

    return cell


def _success(row: dict[str, Any] | None) -> str:
    return "" if row is None else f"{common.percent(row)}, {row['targets']}"


def started(peers: list[Peer], venvs: Path, folder: Path) -> dict[str, Process]:
    """Processes of the peers that could be installed."""
    processes = {}
    for peer in peers:
        try:
            processes[peer.name] = Process(peer, venvs, folder)
        except RuntimeError as error:
            print(f"{peer.name}: {error}", file=sys.stderr)
    return processes


def main() -> None:
    parser = common.parser(__doc__, "benchmark_solve.json")
    parser.add_argument("--venvs", type=Path, required=True, help="folder for the peers' virtual environments")
    parser.add_argument("--robots", nargs="+", default=common.ROBOTS)
    # A list of all solutions answers another question and is compared in a run of its own.
    singles = [peer.name for peer in PEERS if peer.name != "ik_all"]
    parser.add_argument("--peers", nargs="+", default=singles, choices=list(BY_NAME))
    parser.add_argument("--starts", nargs="+", default=("random", "near"), choices=("random", "near"))
    parser.add_argument("--tolerances", nargs="+", default=tuple(common.TOLERANCES), choices=tuple(common.TOLERANCES))
    parser.add_argument(
        "--targets", type=int, default=2000, help="targets per robot; slow peers get only the first few"
    )
    parser.add_argument("--blocks", type=int, default=20, help="blocks into which the targets are divided")
    parser.add_argument(
        "--rounds", type=int, default=3, help="number of repetitions with different targets; medians are reported"
    )
    parser.add_argument("--against", default="rtb", choices=list(BY_NAME), help="reference peer for the ratios")
    given = parser.parse_args()
    before = common.load_average()
    rounds: dict[tuple[str, str, str], list[dict[str, Any]]] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        processes = started([BY_NAME[key] for key in given.peers], given.venvs, folder)
        try:
            for number, robot in product(range(given.rounds), given.robots):
                loaded = ik.Robot.load(robot)
                arm = ik.Robot.load(common.serial_urdf(loaded), base=loaded.base, tip=loaded.tip)
                arm.name = robot
                for kind, tolerance in product(given.starts, given.tolerances):
                    seed = given.seed + number
                    run = compare(arm, processes, kind, tolerance, given.targets, given.blocks, seed, folder)
                    ratios(run, given.against)
                    rounds.setdefault((robot, kind, tolerance), []).append(run)
                    line = {k: f"{_times(v)} {100 * v['solved'] / v['targets']:.4g}%" for k, v in run["rows"].items()}
                    print(robot, kind, tolerance, json.dumps(line), run["refused"] or "", file=sys.stderr)
        finally:
            for process in processes.values():
                process.close()
        versions = {key: process.version for key, process in processes.items() if process.version}
    runs = [settled(same) for same in rounds.values()]
    about = {key: BY_NAME[key].about for key in processes}
    payload = {
        "machine": common.machine(), "load_average": [before, common.load_average()], "targets": given.targets,
        "rounds": given.rounds,
        "seed": given.seed, "against": given.against, "peers": about, "versions": versions, "runs": runs,
    }  # fmt: skip
    common.write(given.output, payload, *tables(runs, given.against))


if __name__ == "__main__":
    main()
