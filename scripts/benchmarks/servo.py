"""Following a moving target, scenario by scenario: our tracker and the peers on the same streams, judged alike.

python scripts/benchmarks/servo.py --venvs ~/.cache/ik_toolkit_peers -o docs/data/benchmark_servo.json

Virtual time, one sample every 10 ms: no method gets more time than another. Every method gets the same targets, start, and
limits of position, speed and acceleration, has a process of its own, and is judged by its joint values alone
(servo_judge.py) against the best achievable (servo_best.py). The scenarios are in servo_scenarios.py, the methods in
servo_worker.py. --plain leaves the peers out and needs no environments.

The output is written after each stream. A run goes on where the file leaves off with --resume; without it, what is asked for is
run anew. What the file has of other streams and methods stays, if seed and stream are the same. --times measures the step
times alone, in a minute: every method on two streams of each arm, ours from Python and in the compiled loop.
"""

import hashlib
import sys
import tempfile
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path
from typing import Any

import common

common.one_thread()

import numpy as np  # noqa: E402
from peers import Peer, Process  # noqa: E402
from servo_best import best  # noqa: E402
from servo_judge import achievable, judge, missed  # noqa: E402
from servo_scenarios import DT, MAKERS, Scenario, make  # noqa: E402
from servo_worker import around  # noqa: E402

import ik_toolkit as ik  # noqa: E402
from ik_toolkit.robot.library import find  # noqa: E402

ROBOTS = ("panda", "hydrolek_7w", "brokk_hydrolek")
SINGULAR = ("stretched", "0.5 m", "elbow", "singular")  # beginnings of the names of streams that meet singular poses
MICROMETRE = 1e-6  # m: errors as near as that are equal
TIMED = ("eight", "far")  # streams on which --times looks: one inside all limits at first, one beyond the reach
WORKER = Path(__file__).with_name("servo_worker.py")
METHODS = {
    "ik": ("ours", "cv", Peer("ik", "ours", (), "`ik.Tracker`, method `cv`")),
    "ik aad": ("ours", "aad", Peer("ik aad", "ours", (), "`ik.Tracker`, method `aad`")),
    "dls": ("dls", "", Peer("dls", "dls", (), "damped least squares, 0.05, each joint clipped")),
    "jparse": ("jparse", "", Peer("jparse", "jparse", (), "J-PARSE, singular directions scaled, each joint clipped")),
    "pink": (
        "pink", "", Peer("pink", "pink", ("pin-pink", "qpsolvers[daqp]"), "QP with limits of position, speed, acceleration"),
    ),
    "mink": ("mink", "", Peer("mink", "mink", ("mink", "qpsolvers[daqp]"), "QP, no acceleration limit")),
    "rtb": (
        "rtb", "", Peer("rtb", "rtb", ("roboticstoolbox-python",), "resolved rate, damped 0.05, each joint clipped"),
    ),
}  # fmt: skip


def load(name: str) -> Any:
    """A robot, or a tree where the name stands for several tips."""
    tips = find(name).tips
    return ik.Tree.load(name, tips=list(tips)) if len(tips) > 1 else ik.Robot.load(name)


def description(s: Scenario, source: str, folder: Path) -> dict[str, Any]:
    """What a worker needs to know; the arrays go to a file."""
    robot = s.robot
    path = folder / f"{robot.name}.urdf"
    path.write_text(common.serial_urdf(robot) if len(robot.tips) == 1 else robot.urdf, encoding="utf-8")
    arrays = {
        "targets": s.targets, "q0": s.q0, "lower": robot.lower, "upper": robot.upper, "speed": s.speed,
        "acceleration": s.acceleration, "rest": robot.rest,
    }  # fmt: skip
    np.savez(folder / "stream.npz", **arrays)
    joint, at = s.lock or (0, -1)
    return {
        "do": "follow", "robot": source, "path": str(path), "tips": list(robot.tips), "joints": list(robot.joint_names),
        "dt": DT, "delay": s.delay, "measured": s.measured, "noise": s.noise, "lock_joint": joint, "lock_at": at,
        "posture": s.posture, "obstacles": s.obstacles, "seed": s.seed, "input": str(folder / "stream.npz"),
    }  # fmt: skip


def mark_of(s: Scenario) -> str:
    """What tells one stream from another."""
    return hashlib.sha256(s.targets.tobytes() + s.q0.tobytes() + s.robot.lower.tobytes()).hexdigest()[:16]


def ideal_of(s: Scenario, keep: Path | None) -> np.ndarray:
    """Best achievable motion of a stream, from the folder `keep` where an earlier run left it."""
    if keep is None:
        return best(s.robot, s.targets, s.q0, s.robot.lower, s.robot.upper, s.speed * DT)
    path = keep / f"{s.robot.name}_{mark_of(s)}.npy"
    if not path.exists():
        keep.mkdir(parents=True, exist_ok=True)
        np.save(path, best(s.robot, s.targets, s.q0, s.robot.lower, s.robot.upper, s.speed * DT))
    return np.load(path)


def run(
    s: Scenario, source: str, processes: dict[str, Process], folder: Path, keep: Path | None, before: dict[str, Any]
) -> dict[str, Any]:
    """One scenario on one robot: the figures of every method of `processes`, and those of other methods from `before`."""
    message = description(s, source, folder)
    collision = around(ik, s.robot, s) if s.obstacles else None
    shared = ideal_of(s, keep)
    rows, refused = (
        {key: one for key, one in before.get(part, {}).items() if key not in processes} for part in ("rows", "refused")
    )
    for key, process in processes.items():
        adapter, method, _ = METHODS[key]
        output = folder / "answer.npz"
        try:
            reply = process.ask({**message, "adapter": adapter, "method": method, "output": str(output)})
        except RuntimeError as error:
            refused[key] = str(error)
            print(f"  {key}: {error}", file=sys.stderr)
            continue
        with np.load(output) as data:
            Q, R, seconds = data["Q"], data["R"], data["seconds"]
        found = judge(s, Q, R, reply["gamma"], achievable(s, Q, shared), collision)
        found |= {"microseconds": common.microseconds(seconds[5:]), "failed": reply["failed"], "words": reply["words"]}
        found["missed"] = missed(s, found) + ([f"{reply['failed']} steps failed"] if reply["failed"] else [])
        rows[key] = found
        print(f"  {key}: {'; '.join(found['missed']) or 'all aims'}", file=sys.stderr)
    return {"robot": source, "scenario": s.name, "expected": s.expected, "samples": len(s.targets), "rows": rows,
            "refused": refused, "seed": s.seed, "mark": mark_of(s)}  # fmt: skip


def step_times(robots: list[str], processes: dict[str, Process], folder: Path, seed: int) -> list[dict[str, Any]]:
    """Microseconds a step of every method, and of our compiled loop, on two streams of each robot."""
    out = []
    for source in robots:
        robot = load(source)
        for scenario in TIMED:
            s = make(scenario, robot, seed)
            message = description(s, source, folder) | {"output": str(folder / "answer.npz")}
            found = {"robot": source, "scenario": s.name, "rows": {}}
            for key, process in processes.items():
                adapter, method, _ = METHODS[key]
                try:
                    reply = process.ask({**message, "adapter": adapter, "method": method})
                    with np.load(folder / "answer.npz") as data:
                        found["rows"][key] = common.microseconds(data["seconds"][5:])
                    if adapter == "ours":
                        reply = process.ask({**message, "adapter": adapter, "method": method, "do": "loop"})
                        found["rows"][key]["loop"] = 1e6 * reply["seconds"]
                except RuntimeError as error:
                    print(f"  {key}: {error}", file=sys.stderr)
            print(f"{source}, {s.name}: timed", file=sys.stderr)
            out.append(found)
    return out


# ------------------------------------------------------------------------------------------------------------ tables
def tables(results: list[dict[str, Any]]) -> list[str]:
    """Markdown: the sums of a method over all scenarios, then a table a robot."""
    keys = [key for key in METHODS if any(key in r["rows"] for r in results)]
    head = [
        "method",
        "streams",
        "freezes",
        "jumps",
        "limit breaks",
        "contacts",
        "chatter",
        "not back",
        "median, us",
        "p99",
    ]
    parts = ["### All scenarios together", common.table(head, [total(key, results) for key in keys])]
    for robot, group in groupby(results, key=lambda r: r["robot"]):
        rows = [line(r, key) for r in group for key in keys if key in r["rows"]]
        head = ["scenario", "method", "freezes", "jumps", "breaks", "contacts", "chatter", "RMS (best), mm", "peak (best), mm",
                "excess jerk (of best)", "back, s (bound)"]  # fmt: skip
        parts += [f"### {robot}", common.table(head, rows).replace("---:", "---", 1)]
    return parts


def total(key: str, results: list[dict[str, Any]]) -> list[Any]:
    """One method over everything."""
    rows = [r["rows"][key] for r in results if key in r["rows"]]
    count = lambda name: sum(row[name] or 0 for row in rows)  # noqa: E731
    lost = sum(back["seconds"] is None for row in rows for back in row["returns"])
    us = [f"{np.median([row['microseconds'][part] for row in rows]):.0f}" for part in ("median", "p99")]
    frozen = sum(len(row["freezes"]) for row in rows)
    broken = f"{count('breaks')} + {count('breaks_between')}"
    return [f"`{key}`", len(rows), frozen, count("jumps"), broken, count("contacts"), count("chatter"), lost, *us]


def line(r: dict[str, Any], key: str) -> list[Any]:
    """One method in one scenario."""
    row = r["rows"][key]
    blank = lambda x: "" if x is None else x  # noqa: E731
    pair = lambda a, b: f"{common.short(1e3 * row[a])} ({common.short(1e3 * row[b])})"  # noqa: E731
    if "rms_best" in row:
        error = [pair("rms_compared", "rms_best"), pair("peak_compared", "peak_best")]
        jerk = f"{common.short(row['excess_jerk'])} ({common.short(row['best_jerk'])})"
    else:
        error, jerk = [common.short(1e3 * row["rms"]), common.short(1e3 * row["peak"])], ""
    back = ", ".join("no" if b["seconds"] is None else f"{b['seconds']:.2f} ({b['bound']:.2f})" for b in row["returns"])
    broken = f"{row['breaks']} + {row['breaks_between']}"
    return [f"{r['scenario']} ({r['expected']})", f"`{key}`", len(row["freezes"]), row["jumps"], broken,
            blank(row["contacts"]), blank(row["chatter"]), *error, jerk, back]  # fmt: skip


def against_pink(results: list[dict[str, Any]]) -> str:
    """Markdown: our excess jerk and error beside Pink's, where the best achievable stays well inside the limits.

    The aim: at most half of Pink's excess jerk where that exceeds a tenth of the best motion's jerk, else at most 1.1 times, at
    an error no larger, to a micrometre.
    """
    rows = []
    for r in results:
        pink = r["rows"].get("pink", {})
        for key in ("ik", "ik aad"):
            ours = r["rows"].get(key, {})
            if "excess_jerk" not in pink or "excess_jerk" not in ours:
                continue
            share = ours["excess_jerk"] / pink["excess_jerk"]
            most = 0.5 if pink["excess_jerk"] > 0.1 * pink["best_jerk"] else 1.1
            closer = ours["rms_compared"] <= pink["rms_compared"] + MICROMETRE
            jerk = [common.short(x) for x in (ours["best_jerk"], ours["excess_jerk"], pink["excess_jerk"])]
            error = [common.short(1e3 * one["rms_compared"]) for one in (ours, pink)]
            calm = share <= most
            held = "both" if calm and closer else "jerk" if calm else "error" if closer else "neither"
            rows.append([f"{r['robot']}, {r['scenario']}", f"`{key}`", *jerk, f"{share:.2f} ({most})", *error, held])
    head = [
        "stream",
        "method",
        "jerk of the best",
        "ours, excess",
        "Pink's",
        "share (aim)",
        "RMS, mm",
        "Pink's",
        "reached",
    ]
    return common.table(head, rows)


def singular_poses(results: list[dict[str, Any]]) -> str:
    """Markdown: the streams that meet singular poses, RMS error in mm and excess jerk, with what treats them in other ways."""
    keys, rows = ("ik", "ik aad", "jparse", "dls"), []
    for r in results:
        known = [r["rows"].get(key, {}) for key in keys]
        if r["scenario"].startswith(SINGULAR) and all("excess_jerk" in row for row in known):
            pairs = [(known[0]["rms_best"], known[0]["best_jerk"])]
            pairs += [(row["rms_compared"], row["excess_jerk"]) for row in known]
            shown = [f"{common.short(1e3 * error)} ({common.short(jerk)})" for error, jerk in pairs]
            rows.append([f"{r['robot']}, {r['scenario']}", *shown])
    return common.table(["stream", "best (its jerk)", *(f"`{key}`" for key in keys)], rows)


def time_table(times: list[dict[str, Any]]) -> str:
    """Markdown: microseconds a step."""
    rows = []
    for r in times:
        pink = r["rows"].get("pink", {}).get("median")
        for key, row in r["rows"].items():
            us = [common.short(row[part]) for part in ("median", "p99")]
            loop = row.get("loop")
            share = common.short(pink / loop) if pink and loop else ""
            rows.append([f"{r['robot']}, {r['scenario']}", f"`{key}`", *us, common.short(loop) if loop else "", share])
    return common.table(["stream", "method", "median, us", "p99", "compiled loop", "Pink's over it"], rows)


def streams(
    given: Any, kept: list[dict[str, Any]], processes: dict[str, Process], folder: Path
) -> Iterator[dict[str, Any]]:
    """One stream after another, with what `kept` has of it."""
    for robot in given.robots:
        loaded = load(robot)
        for scenario in given.scenarios:
            try:
                s = make(scenario, loaded, given.seed)
            except (ik.IKError, ValueError) as error:
                print(f"{robot}, {scenario}: left out, {error}", file=sys.stderr)
                continue
            before = next((r for r in kept if (r["robot"], r.get("mark")) == (robot, mark_of(s))), {})
            known = {*before.get("rows", {}), *before.get("refused", {})} if given.resume else set()
            asked = {key: process for key, process in processes.items() if key not in known}
            print(f"{robot}, {s.name}: {len(s.targets)} samples", file=sys.stderr)
            if asked:
                yield run(s, robot, asked, folder, given.keep, before)


def save(
    given: Any, kept: dict[str, Any], done: list[dict[str, Any]], processes: dict[str, Process], load: float
) -> str:
    """Write what was kept of the file and what was done now; returns the tables."""
    runs = list({(r["robot"], r["scenario"]): r for r in [*kept["runs"], *done]}.values())
    runs.sort(key=lambda r: (*ROBOTS, r["robot"]).index(r["robot"]))
    payload = {
        "machine": common.machine(), "load_average": [load, common.load_average()], "seed": given.seed, "dt": DT,
        "peers": {key: peer.about for key, (_, _, peer) in METHODS.items()},
        "versions": kept["versions"] | {key: one.version for key, one in processes.items() if one.version},
        "runs": runs, "times": kept["times"],
    }  # fmt: skip
    parts = [*tables(runs), "### Against Pink", against_pink(runs), "### Singular poses", singular_poses(runs)]
    parts += ["### Step times", time_table(kept["times"])]
    return common.keep(given.output, payload, *parts)


def main() -> None:
    parser = common.parser(__doc__, "benchmark_servo.json")
    parser.add_argument("--venvs", type=Path, help="folder for the peers' virtual environments")
    parser.add_argument("--plain", action="store_true", help="ours and the plain damped step only")
    parser.add_argument("--keep", type=Path, help="folder where best achievable motions are kept for another run")
    parser.add_argument("--robots", nargs="+", default=ROBOTS)
    parser.add_argument("--scenarios", nargs="+", default=list(MAKERS), choices=list(MAKERS))
    parser.add_argument("--resume", action="store_true", help="leave out what the output file has already")
    parser.add_argument("--times", action="store_true", help="the step times alone")
    parser.add_argument("--methods", nargs="+", default=list(METHODS), choices=list(METHODS))
    given = parser.parse_args()
    if given.venvs is None and not given.plain:
        raise SystemExit("give --venvs, a folder for the peers' environments, or --plain")
    keys = [key for key in given.methods if not (given.plain and METHODS[key][2].packages)]
    kept: dict[str, Any] = {"seed": given.seed, "runs": [], "times": [], "versions": {}}
    if given.output.exists():
        found = common.read(given.output)
        kept = found if found["seed"] == given.seed else kept
    before, done = common.load_average(), []
    with tempfile.TemporaryDirectory() as name:
        folder, processes = Path(name), {}
        for key in keys:
            try:
                processes[key] = Process(METHODS[key][2], given.venvs, folder, WORKER)
            except RuntimeError as error:
                print(f"{key}: {error}", file=sys.stderr)
        try:
            if given.times:
                kept["times"] = step_times(given.robots, processes, folder, given.seed)
            else:
                for found in streams(given, kept["runs"], processes, folder):
                    done.append(found)
                    save(given, kept, done, processes, before)
        finally:
            for process in processes.values():
                process.close()
        print(save(given, kept, done, processes, before))


if __name__ == "__main__":
    main()
