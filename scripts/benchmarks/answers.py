"""The answers of docs/benchmarks.md, a table a question, computed from the data of the other commands."""

from collections.abc import Callable
from typing import Any, NamedTuple

import common
import numpy as np
from aims import aims
from kernel import UNREACHABLE
from servo import MICROMETRE

Found = dict[str, dict[str, Any]]
NAMES = {  # of solvers in the README and the chart, where it is not the key
    "ik": "**`ik.Solver`**, bound to a robot", "ik_q0": "**`ik.Solver`**, from q0",
    "ik.solve": "**`ik.solve`**, inputs and result checked",
    "rtb": "Robotics Toolbox `ik_LM(k=0.1)`", "rtb_free": "Robotics Toolbox `ik_LM(k=0.1, joint_limits=False)`",
    "pytracik": "TRAC-IK (pytracik, two threads)",
}  # fmt: skip
SHORT = {  # the same beside six columns
    "ik": "**`ik.Solver`**", "ik.solve": "**`ik.solve`**", "rtb": "Robotics Toolbox", "rtb_free": "Robotics Toolbox, no limits",
    "pytracik": "TRAC-IK", "eaik": "EAIK", "ssik_built": "ssik, generated code", "cartan": "Cartan", "optik": "OptIK",
    "dynibo": "dynibo", "pink": "Pink", "ikpy": "IKPy",
}  # fmt: skip
METHODS = {  # of following a target, where it is not the key
    "ik": "**`ik.Tracker`**, method `cv`", "ik aad": "**`ik.Tracker`**, method `aad`", "rtb": "Robotics Toolbox, resolved rate",
    "dls": "damped least squares, clipped", "jparse": "J-PARSE, clipped", "pink": "Pink",
    "mink": "mink, without acceleration limits",
}  # fmt: skip
ARMS = {  # as their makers write them
    "panda": "Panda", "ur5": "UR5", "xarm7": "xArm7", "kinova": "Kinova", "z1": "Z1", "hydrolek_7w": "HydroLek 7W",
}  # fmt: skip
FIRST = {  # what is compiled, as a user calls it
    "LM": "one target, `lm`", "a second rule (DLS)": "then another solver, `dls`", "several tips": "several tips",
    "several tips after LM": "several tips, after `lm`", "lanes": "a batch, after `lm`",
}  # fmt: skip
NEAREST = 8  # solvers shown with a start nearby
JOINTS = (3, 6, 7, 10, 20, 40)  # shown of those measured


class Answer(NamedTuple):
    """A question, the answer in a sentence or two, the table behind it, and the page below docs/benchmarks with the rest."""

    question: str
    words: str
    table: str
    page: str


def span(values: list[float]) -> str:
    """Smallest and largest value."""
    return f"{common.short(min(values))} to {common.short(max(values))}"


def worst(rows: list[dict[str, Any]]) -> str:
    """Percent solved on the robot with fewest."""
    return f"{min(100 * row['solved'] / row['targets'] for row in rows):.4g}"


def beside(found: Found, start: str, most: int | None = None) -> tuple[str, dict[str, list[dict[str, Any]]]]:
    """Table of the median time of every solver on every robot to strict tolerances, `most` at most, and the rows behind it, fastest
    first.
    """
    runs = {r["robot"]: r["rows"] for r in found["solve"]["runs"] if (r["start"], r["tolerance"]) == (start, "strict")}
    keys = {key: [rows[key] for rows in runs.values() if key in rows] for rows in runs.values() for key in rows}
    middle = {key: float(np.median([row["wall"]["median"] for row in rows])) for key, rows in keys.items()}
    ordered = {key: keys[key] for key in sorted(keys, key=middle.__getitem__) if key != "ik_q0"}
    lines = [
        [
            SHORT.get(key, key),
            worst(ordered[key]),
            *(common.short(rows[key]["wall"]["median"]) if key in rows else "" for rows in runs.values()),
        ]
        for key in list(ordered)[:most]
    ]
    return common.table(["median, us", "solved, %", *(ARMS.get(r, r) for r in runs)], lines), ordered


def single(found: Found) -> Answer:
    """Time of a solve from anywhere."""
    table, rows = beside(found, "random")
    times = [one["wall"]["median"] for one in rows["ik"]]
    ratios = [one["faster"]["wall"]["median"] for one in rows["ik"]]
    checked = [one["wall"]["median"] for one in rows["ik.solve"]]
    words = (
        f"**{span(times)} us**, the median, from Python on one thread: {span(ratios)} times faster than the Robotics Toolbox."
        f" `ik.solve`, which also checks its inputs and lets Pinocchio verify the result, takes {span(checked)} us. *Solved* is the"
        f" share on the robot with the fewest solved, of {max(r['targets'] for r in rows['ik'])} targets (slow packages got fewer);"
        " an empty cell is a robot that the package does not treat. EAIK and ssik are analytic, mink, Pink and dynibo are restarted"
        " by the benchmark."
    )
    return Answer("How fast is one solve, beside other packages?", words, table, "single_solves")


def near(found: Found) -> Answer:
    """Time of a solve from a start nearby."""
    table, rows = beside(found, "near", NEAREST)
    times = [one["wall"]["median"] for one in rows["ik"]]
    words = (
        f"**{span(times)} us** when every joint starts within {common.NEAR} rad of a solution, as from one sample of a motion to"
        f" the next. The {NEAREST} fastest:"
    )
    return Answer("And from a start nearby?", words, table, "single_solves")


def success(found: Found) -> Answer:
    """Share of reachable targets that are solved."""
    rows = found["success"]["rows"]
    solved, targets = (sum(r[key] for r in rows) for key in ("solved", "targets"))
    checked, wrong = (sum(r["pinocchio"][key] for r in rows) for key in ("checked", "not_confirmed"))
    words = (
        f"**{solved:,} of {targets:,} targets**, to 1e-6 m and rad, without a starting guess. Pinocchio checked"
        f" {checked:,} of the answers and refused {wrong}."
    )
    lines = [
        [
            ARMS.get(r["robot"], r["robot"]), common.percent(r), f"{100 * r['restarts']['0']:.4g}", r["most_restarts"],
            f"{r['iterations']:.1f}",
        ]
        for r in rows
    ]  # fmt: skip
    head = ["robot", "solved, % (95 % interval)", "without a restart, %", "most restarts", "iterations, mean"]
    return Answer("How often does it succeed?", words, common.table(head, lines), "success")


def batches(found: Found) -> Answer:
    """Targets a second."""
    rows = {(r["robot"], r["threads"], r["targets"]): r for r in found["batch"]["rows"]}
    columns = sorted({(robot, threads) for robot, threads, _ in rows})
    best = max(r["per_second"] for r in rows.values())
    most = max(r["memory"] for r in rows.values())
    words = (
        f"**Up to {best:,.0f} targets a second** on two cores, with at most {most / 1e6:.1f} MB beyond input and output. Eight"
        " targets are solved side by side on each core."
    )
    lines = [
        [f"{count:,}", *(f"{rows[robot, threads, count]['per_second']:,.0f}" for robot, threads in columns)]
        for count in sorted({count for *_, count in rows})
    ]
    head = [f"{ARMS.get(robot, robot)}, {n} thread{'s' * (n > 1)}" for robot, n in columns]
    return Answer(
        "How many targets a second does a batch solve?", words, common.table(["targets", *head], lines), "batches"
    )


def tips(found: Found) -> Answer:
    """Robots with several tips."""
    rows = found["tree"]["rows"]
    words = (
        f"**{span([r['median'] for r in rows])} us** for both hands of robots with {min(r['joints'] for r in rows)} to"
        f" {max(r['joints'] for r in rows)} joints, all of them moved at once; {sum(r['solved'] for r in rows):,} of"
        f" {sum(r['targets'] for r in rows):,} targets solved."
    )
    lines = [
        [
            r["robot"],
            r["joints"],
            common.short(r["median"]),
            common.short(r["p99"]),
            worst([r]),
            f"{np.median(r['rates']):,.0f}",
        ]
        for r in rows
    ]
    head = ["robot", "joints", "median, us", "99th percentile", "solved, %", "in a batch, a second"]
    return Answer("And with several tips?", words, common.table(head, lines), "several_tips")


def joints(found: Found) -> Answer:
    """Cost against number of joints."""
    rows = [r for r in found["joints"]["rows"] if r["joints"] in JOINTS]
    most = rows[-1]
    words = (
        f"**{common.short(most['median'])} us with {most['joints']} joints**: every further joint makes an iteration longer, and"
        " redundant ones make iterations fewer."
    )
    lines = [
        [
            r["joints"],
            r["task"],
            common.short(r["median"]),
            common.short(r["p99"]),
            f"{r['iterations']:.1f}",
            worst([r]),
        ]
        for r in rows
    ]
    head = ["joints", "task", "median, us", "99th percentile", "iterations, mean", "solved, %"]
    return Answer("What do more joints cost?", words, common.table(head, lines), "joints")


def unreachable(found: Found) -> Answer:
    """Time of a proof."""
    times = {robot: ns / 1e3 for robot, ns in found["kernel"]["median_ns"][UNREACHABLE].items()}
    words = f"**{span(list(times.values()))} us** for a target that lies beyond the reach of the arm, which the status then says."
    head, row = [ARMS.get(r, r) for r in times], [common.short(us) for us in times.values()]
    return Answer(
        "How soon is an impossible target refused?", words, common.table(["", *head], [["us", *row]]), "kernel"
    )


def following(found: Found) -> Answer:
    """Freezes, jumps and broken limits of trackers."""
    runs = found["servo"]["runs"]
    loops = [r["rows"][key]["loop"] for r in found["servo"]["times"] for key in ("ik", "ik aad")]
    pairs = [
        (r["rows"][key], r["rows"]["pink"])
        for r in runs
        for key in ("ik", "ik aad")
        if "excess_jerk" in r["rows"][key] and "excess_jerk" in r["rows"].get("pink", {})
    ]
    closer = sum(ours["rms_compared"] <= pink["rms_compared"] + MICROMETRE for ours, pink in pairs)
    calmer = sum(ours["excess_jerk"] <= pink["excess_jerk"] for ours, pink in pairs)
    robots = {r["robot"] for r in runs}
    lines = []
    for key, name in METHODS.items():
        rows = [r["rows"][key] for r in runs if key in r["rows"]]
        if rows:
            count = lambda part, rows=rows: sum(row[part] or 0 for row in rows)  # noqa: E731
            back = sum(one["seconds"] is None for row in rows for one in row["returns"])
            us = np.median([row["microseconds"]["median"] for row in rows])
            broken = count("breaks") + count("breaks_between")
            frozen = sum(len(row["freezes"]) for row in rows)
            lines.append([name, len(rows), frozen, count("jumps"), broken, count("contacts"), back, f"{us:.0f}"])
    ours = lines[:2]
    words = (
        f"**{sum(line[2] for line in ours)} freezes, {sum(line[3] for line in ours)} jumps, {sum(line[4] for line in ours)} broken"
        f" limits** of ours in {ours[0][1]} streams on {len(robots)} robots: figures that become faster and faster, jitter, leaps,"
        " targets out of reach, singular poses, obstacles, a joint that locks. A step takes"
        f" {span(loops)} us in a compiled loop. Where a target can be followed well inside the limits, our error is no larger"
        f" than Pink's in {closer} of {len(pairs)} cases, and our jerk (beyond that of the best motion) in {calmer}. *Not back*:"
        " leaps and figures after which the error did not fall below 1 mm."
    )
    head = ["method", "streams", "freezes", "jumps", "limits broken", "contacts", "not back", "step from Python, us"]
    return Answer(
        "How well does a control loop follow a moving target?", words, common.table(head, lines), "moving_target"
    )


def paths(found: Found) -> Answer:
    """Whole paths."""
    rows = found["path"]["problems"]
    valid, seeds = (sum(r[key] for r in rows) for key in ("valid", "seeds"))
    times = [float(np.median(r["processor"])) for r in rows]
    truth = found["path"]["truth"]
    fewest, enumerated = (sum(t[key] for t in truth) for key in ("equal", "paths"))
    words = (
        f"**{valid} of {seeds} paths are valid**, found in {span(times)} s of processor time with collision checks and the proof"
        f" of continuity. Of {enumerated} random paths whose true minimum is known, {fewest} have as few reconfigurations as"
        " there can be. *Valid*: every pose within 0.1 mm and 0.1 deg, small steps, inside the limits, no contact, judged by"
        " Pinocchio and coal."
    )
    lines = [
        [r["problem"].replace("__", ", "), r["poses"], f"{r['valid']} of {r['seeds']}", common.short(np.median(r["processor"])),
         f"{np.median(r['lengths']):.2f}", "" if r["known"] is None else r["known"]]
        for r in rows
    ]  # fmt: skip
    head = ["problem", "poses", "valid", "processor, s", "length of the joint path, rad", "TORM's, rad"]
    return Answer("Does it find whole paths among obstacles?", words, common.table(head, lines), "paths")


def published(found: Found) -> Answer:
    """TRAC-IK's table."""
    rows = found["published"]["trac_ik"]["rows"]
    times = [r["ours"]["ms"] * 1e3 for r in rows.values()]
    ratios = [r["here"]["ms"] / r["ours"]["ms"] for r in rows.values()]
    words = (
        f"TRAC-IK's own table, run again with {found['published']['targets']:,} targets a chain: **{span(times)} us a solve**, the"
        f" mean, {span(ratios)} times faster than TRAC-IK on the same machine."
    )
    lines = [
        [
            name, *(f"{r[who]['ms']:.3f}" for who in ("ours", "here")), r["published"]["ms"],
            *(worst([r[who]]) for who in ("ours", "here")), f"{r['published']['percent']:.4g}",
        ]
        for name, r in rows.items()
    ]  # fmt: skip
    head = [
        "mean, ms",
        "`ik.Solver`",
        "TRAC-IK here",
        "published",
        "solved, %: `ik.Solver`",
        "TRAC-IK here",
        "published",
    ]
    return Answer("How does it do on tables that others published?", words, common.table(head, lines), "published")


def first_use(found: Found) -> Answer:
    """Cost of compilation."""
    rows = [[FIRST.get(what, what), f"{now:.1f}"] for what, _, now in found["against"]["first"]]
    words = (
        "**Seconds, once on each machine**: what is used for the first time is compiled, and the code is kept on disk. The other"
        " packages need no such step."
    )
    table = common.table(["first call with an empty cache", "processor time, s"], rows)
    return Answer("What does the first use cost?", words, table, "previous_version")


def missed(found: Found) -> Answer:
    """Aims not reached."""
    rows = aims(found)
    left = [row[:2] for row in rows if row[2] != "yes"]
    words = f"**{len(left)} of {len(rows)}** aims that were set before measuring:"
    return Answer("Which of our own aims are missed?", words, common.table(["aim", "measured"], left), "aims")


ANSWERS: list[tuple[Callable[[Found], Answer], tuple[str, ...]]] = [  # in the order of the page, with the data each needs
    (single, ("solve",)), (near, ("solve",)), (success, ("success",)), (batches, ("batch",)), (tips, ("tree",)),
    (joints, ("joints",)), (unreachable, ("kernel",)), (paths, ("path",)), (following, ("servo",)),
    (published, ("published",)), (first_use, ("against",)), (missed, ("solve",)),
]  # fmt: skip


def answers(found: Found) -> list[Answer]:
    """Every question whose data are there."""
    return [answer(found) for answer, needs in ANSWERS if all(name in found for name in needs)]
