"""Two published tables, rerun as published: those of TRAC-IK and of the Robotics Toolbox authors.

python scripts/benchmarks/published.py --venvs ~/.cache/ik_toolkit_peers -o docs/data/benchmark_published.json

The published figures below come from the addresses in SOURCES. They are listed next to ours and, with --venvs, to those of the
same solvers on this machine, on the same targets. Every answer is checked here by Pinocchio.
"""

import sys
import tempfile
from pathlib import Path
from time import perf_counter
from typing import Any

import common

common.one_thread()

import numpy as np  # noqa: E402
from peers import Peer, Process  # noqa: E402
from solve import describe, right  # noqa: E402

import ik_toolkit as ik  # noqa: E402

HERE = Path(__file__).resolve().parent
SOURCES = {
    "trac_ik": "README of TRAC-IK (https://bitbucket.org/traclabs/trac_ik, read in the copy https://github.com/aprotyas/trac_ik),"
    " results of v1.4.6; machine not named",
    "rtb": "https://github.com/jhavl/dkt, Part 1, notebook 4, sections 4.7 and 4.8 (J. Haviland and P. Corke; machine not named)",
}
IIWA = (
    "rtb/lib/python*/site-packages/rtbdata/xacro/kuka_description/kuka_lbr_iiwa/urdf/lbr_iiwa_14_r820.urdf"  # of a peer
)
# chain of TRAC-IK's table: description, base, tip (the table does not name them), published rate [%] and mean time [ms]
CHAINS = {
    "Baxter arm": ("baxter", "torso", "left_gripper", 99.62, 0.43),
    "Fetch arm": (str(HERE / "data" / "fetch.urdf"), "torso_lift_link", "gripper_link", 99.99, 0.26),
    "Jaco2": ("kinova", "base", "j2s6s200_end_effector", 99.78, 0.41),
    "Franka Emika Panda": ("panda", "panda_link0", "panda_hand_tcp", 99.70, 0.38),
    "PR2 arm": ("pr2", "torso_lift_link", "r_wrist_roll_link", 99.95, 0.38),
    "KUKA LBR iiwa 14 R820": (IIWA, "base_link", "tool0", 99.84, 0.31),
}
LIMIT, EACH = 5e-3, 1e-5  # [s] per solve; [m] and [rad] per axis
# the notebook's fastest row and its plainest: method, mean iterations, infeasible, mean searches, mean time [us]
NOTEBOOK = (
    ("LM Chan 0.1", 15.41, 0, 1.21, 39.03),
    ("LM Sugihara 0.0001", 22.01, 0, 1.26, 51.98),
    ("Newton-Raphson", 29.59, 0, 1.48, 57.01),
)
ENERGY = 1e-6  # half the squared error [m, rad] that the notebook accepts
WARM = 20  # untimed solves at the start


def ours(
    robot: ik.Robot, T: np.ndarray, q0: np.ndarray | None, **options: Any
) -> tuple[np.ndarray, np.ndarray, list[Any]]:
    """Seconds (N,), answers (N, 1, n) and results of the bound solver, called with poses (N, 4, 4) one after the other."""
    solver = ik.Solver(robot, "lm", **options)
    for pose in T[:WARM]:
        solver(pose, q0=q0)
    seconds, found = np.empty(len(T)), []
    for k, pose in enumerate(T):
        started = perf_counter()
        result = solver(pose, q0=q0)
        answer = result.q
        seconds[k] = perf_counter() - started
        found.append((answer, result))
    answers = np.array([q if result.success else np.full(robot.n, np.nan) for q, result in found])[:, None]
    return seconds, answers, [result for _, result in found]


def within(robot: ik.Robot, answers: np.ndarray, T: np.ndarray, each: float) -> np.ndarray:
    """Which answers (N, 1, n) are inside the limits and off by at most `each` along and about every axis."""
    inside = right(robot, answers, T, (2.0 * each, 2.0 * each))  # sqrt(3) at most
    for k in np.flatnonzero(inside):
        off = robot.fk(answers[k, 0]).homogeneous
        turn = T[k, :3, :3].T @ off[:3, :3]
        vector = 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
        turned = T[k, :3, :3].T @ (off[:3, 3] - T[k, :3, 3])
        inside[k] = max(np.abs(vector).max(), np.abs(turned).max()) <= each * (1 + 1e-6)
    return inside


def trac_ik(count: int, seed: int, venvs: Path | None, folder: Path) -> dict[str, Any]:
    """TRAC-IK's table: from the middle of the limits, 5 ms a solve, failures count."""
    peer = Peer("pytracik", "pytracik_published", ("pytracik",), "TRAC-IK by its Python binding")
    process = Process(peer, venvs, folder) if venvs else None
    rows = {}
    for name, (source, base, tip, rate, mean) in CHAINS.items():
        if source == IIWA:
            source = next((str(file) for file in venvs.glob(source)), "") if venvs else ""
        if not source:
            print(f"{name} left out: its description is in the environment of rtb (--venvs)", file=sys.stderr)
            continue
        loaded = ik.Robot.load(source, base=base, tip=tip)
        robot = ik.Robot.load(common.serial_urdf(loaded), base=base, tip=tip)
        robot.name = name.replace(" ", "_")
        _, T = common.random_targets(robot, count, np.random.default_rng(seed))
        middle = 0.5 * (robot.lower + robot.upper)
        seconds, answers, _ = ours(robot, T, middle, position_tolerance=EACH, orientation_tolerance=EACH)
        good = within(robot, answers, T, EACH)
        late = good & (seconds > LIMIT)
        rows[name] = {
            "joints": robot.n,
            "published": {"percent": rate, "ms": mean},
            "ours": {
                **common.rate(int((good & ~late).sum()), count),
                "late": int(late.sum()),
                "ms": 1e3 * float(np.minimum(seconds, LIMIT).mean()),
            },
        }
        if process:
            process.build({**describe(robot, folder), "tol_p": EACH, "tol_r": EACH, "timeout": LIMIT})
            (seconds, _), answers = process.solve(T, np.tile(middle, (count, 1)))
            good = within(robot, answers, T, EACH)
            rows[name]["here"] = {**common.rate(int(good.sum()), count), "ms": 1e3 * float(seconds.mean())}
        print(name, rows[name], file=sys.stderr)
    if process:
        process.close()
    return {"rows": rows, "here": process.version if process else ""}


def notebook(count: int, seed: int, venvs: Path | None, folder: Path) -> dict[str, Any]:
    """The notebook's table: the Panda without limits, any start, at most 100 searches of 30 iterations."""
    loaded = ik.Robot.load("panda", tip="panda_hand_tcp")
    robot = ik.Robot.load(common.serial_urdf(loaded), base=loaded.base, tip=loaded.tip)
    robot.name = "panda"
    _, T = common.random_targets(robot, count, np.random.default_rng(seed))
    each = float(np.sqrt(ENERGY))  # of both errors: half the sum of their squares is then ENERGY
    same: dict[str, Any] = {"max_iterations": 30, "restarts": 99, "limits": False}
    same |= {"position_tolerance": each, "orientation_tolerance": each}
    seconds, answers, results = ours(robot, T, None, **same)
    rows = {"ours": summary(robot, T, answers, seconds)}
    rows["ours"]["searches"] = float(np.mean([result.attempt + 1 for result in results]))
    rows["ours"]["iterations"] = float(np.mean([result.iterations for result in results]))
    version = ""
    if venvs:
        process = Process(
            Peer("rtb", "rtb_published", ("roboticstoolbox-python",), "as in the notebook"), venvs, folder
        )
        process.build({**describe(robot, folder), "tol_p": each, "tol_r": each})
        (seconds, _), answers = process.solve(T, np.zeros((count, robot.n)))
        rows["here"] = summary(robot, T, answers, seconds)
        version = process.version
        process.close()
    print(rows, file=sys.stderr)
    return {"rows": rows, "published": [list(row) for row in NOTEBOOK], "here": version}


def summary(robot: ik.Robot, T: np.ndarray, answers: np.ndarray, seconds: np.ndarray) -> dict[str, Any]:
    """Number of answers the notebook would accept, and the mean time [us]."""
    off = np.array(
        [
            robot.errors(q, pose) if np.isfinite(q).all() else (np.inf, np.inf)
            for (q,), pose in zip(answers, T, strict=True)
        ]
    )
    good = 0.5 * (off**2).sum(axis=1) <= ENERGY * (1 + 1e-6)
    return {**common.rate(int(good.sum()), len(T)), "us": 1e6 * float(seconds.mean())}


def tables(trac: dict[str, Any], panda: dict[str, Any]) -> list[str]:
    """Both tables as Markdown."""
    head = [
        "chain",
        "joints",
        "published, %",
        "published, ms",
        "here, %",
        "here, ms",
        "`ik.Solver`, %",
        "`ik.Solver`, ms",
    ]
    lines = []
    for name, row in trac["rows"].items():
        cells = [f"{100 * row[k]['solved'] / row[k]['targets']:.2f}" if k in row else "" for k in ("here", "ours")]
        times = [f"{row[k]['ms']:.3f}" if k in row else "" for k in ("here", "ours")]
        told, late = row["published"], row["ours"]["late"]
        cells[1] += f" ({late} late)" if late else ""
        lines.append(
            [name, row["joints"], told["percent"], told["ms"], cells[0], times[0], cells[1], f"**{times[1]}**"]
        )
    rows = [[f"{method} (published)", a, b, c, d] for method, a, b, c, d in panda["published"]]
    for key, name in (("here", f"LM Chan 0.1 (Robotics Toolbox {panda['here']}, here)"), ("ours", "**`ik.Solver`**")):
        if key in panda["rows"]:
            row = panda["rows"][key]
            words = [common.short(row[k]) if k in row else "" for k in ("iterations", "searches", "us")]
            rows.append([name, words[0], row["targets"] - row["solved"], words[1], words[2]])
    notebook_head = ["method", "mean iterations", "not solved", "mean searches", "mean time, us"]
    return [
        f"### TRAC-IK's table\n\nPublished: {SOURCES['trac_ik']}. Here: pytracik {trac['here']}, which runs two threads.",
        common.table(head, lines),
        f"### The Robotics Toolbox's table\n\nPublished: {SOURCES['rtb']}.",
        common.table(notebook_head, rows),
    ]


def main() -> None:
    parser = common.parser(__doc__, "benchmark_published.json")
    parser.add_argument(
        "--venvs", type=Path, help="folder for the peers' virtual environments; without it they are not run"
    )
    parser.add_argument("--targets", type=int, default=10_000, help="as published: 10,000")
    given = parser.parse_args()
    before = common.load_average()
    with tempfile.TemporaryDirectory() as name:
        trac = trac_ik(given.targets, given.seed, given.venvs, Path(name))
        panda = notebook(given.targets, given.seed, given.venvs, Path(name))
    payload = {
        "machine": common.machine(),
        "load_average": [before, common.load_average()],
        "targets": given.targets,
        "sources": SOURCES,
        "trac_ik": trac,
        "notebook": panda,
    }
    common.write(given.output, payload, *tables(trac, panda))


if __name__ == "__main__":
    main()
