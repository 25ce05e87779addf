"""Put the tables that the other commands wrote into one page, docs/benchmarks.md.

python scripts/benchmarks/page.py docs/data -o docs/benchmarks.md --readme README.md

Draws the chart at its head, too (extra plots). Reads benchmark_solve.json, benchmark_published.json, benchmark_success.json,
benchmark_batch.json, benchmark_kernel.json, benchmark_joints.json, benchmark_tree.json, benchmark_servo.json and
benchmark_against.json from the folder given; those that are missing are left out.
"""

import argparse
import re
import textwrap
from pathlib import Path
from typing import Any

import common
from kernel import UNREACHABLE

from ik_toolkit.show.plots import drawing, save
from ik_toolkit.style import COLOURS, GREY

HEAD = """\
<!-- Written by scripts/benchmarks/page.py from docs/data/benchmark_*.json: run the commands again instead of editing. -->
# Benchmarks

How fast and how reliable the solvers, batches and trackers are, compared with other packages. Every number was written by a command
in `scripts/benchmarks/`, which stands above its tables; the same data are in `docs/data/` as JSON. Times are from one machine, so
compare ratios within one run. Targets are poses of random configurations within the joint limits, so all of them are reachable.
"""
MARKS = ("<!-- benchmark: written by scripts/benchmarks/page.py -->", "<!-- end of benchmark -->")
SOLVE = """\
Every solver runs in its own process and virtual environment and gets the same targets, starts and tolerances; solvers take turns,
block by block. Each call is timed from Python, including reading the joint values from the answer, and failures are timed as well.
A solve succeeds if Pinocchio finds its answer within the limits and both tolerances; full turns are forgiven, and of an analytic
solver's answers one has to be right. Every robot is a serial URDF with continuous joints limited to two turns either way. Slow
solvers get only the first few targets, and their ratio is computed on these. EAIK is called through its Python package; called
from C++, with a filter for joint limits, it is not measured, because the package ships no headers to compile against. Everything is
done three times with different targets: times and ratios are medians over these rounds, successes are added up.
"""
SERVO = """\
Simulated time, 100 samples a second. Every method gets the same stream of targets (without velocities), the same start and the same
limits on position, speed and acceleration; mink has no acceleration limits. *Best* is the result of a search that continues from
sample to sample within the position and speed limits; errors and jerk are compared where it stays within 0.8 of the limits.
*Freeze*: no motion for 100 ms, more than 1 mm off, with neither a limit nor a contact in the way. *Jump*: a joint moved or
accelerated more than its limits allow. *Breaks*: samples outside the joints' ranges + steps whose reported motion is outside a
limit between samples. *Chatter*: more than 3 changes of direction in 100 ms. *Back*: the time until the error stays below 1 mm
after a leap or the end of a figure, and the shortest time that the joints' limits allow. Errors count one radian as 0.2 m.
"""
PUBLISHED = """\
Both tables are run again as they were published, by one command; the published columns are copied from the sources named, whose
machines are unknown. *Here* are the same solvers on this machine, with the same targets as ours. TRAC-IK's table: 10,000 reachable
poses per chain, every solve from the middle of the limits, at most 5 ms, 1e-5 m and rad per axis; our solves that took longer count
as failures (late). Base and tip of a chain are our choice where the table does not name them, and continuous joints are limited to
two turns either way. Of the table's 22 chains these are the ones that the packages used here describe; the arms of ABB, Atlas,
Denso, Fanuc, Motoman, Robonaut2, Robosimian, Schunk, TRACLabs and Valkyrie, and the KUKA LWR 4+, are not measured. The Robotics
Toolbox's table: 10,000 poses of the Panda without joint limits, at most 100 searches of 30
iterations, half the squared error at most 1e-6 (1.4 mm and mrad together; ours keeps each below 1).
"""
CHART = "Time of a solve: median (bar) and 99th percentile (line), with the share of targets solved"
AGAINST = """\
*Before* is commit {old}. Each version has its own process and cache and gets the same targets; the rounds alternate. Times are
processor time; ratios are medians with a 95 % interval by order statistics. Trackers run in their published form
(`on_limit="clip"`), the only one that the older version had.
"""


def machine(data: dict[str, Any]) -> str:
    """One line on where and with what a run was made."""
    parts = dict(data["machine"])
    text = f"{parts.pop('cpu')}, {parts.pop('cores')} cores, {parts.pop('system')}; "
    nice = parts.pop("nice")
    text += ", ".join(f"{name} {version}" for name, version in parts.items())
    load = data.get("load_average")
    if load:
        text += f". Load average before and after: {load[0]} and {load[1]} (the benchmark itself makes about 1)"
    if nice < 0:
        text += f". The machine was shared: the commands ran with raised priority (nice {nice})"
    return text + "."


def mark(met: bool) -> str:
    return "yes" if met else "**no**"


def aims(found: dict[str, dict[str, Any]]) -> list[list[str]]:
    """Rows (aim, measured, met) of what this project set out to reach."""
    rows = []
    if "success" in found:
        for r in found["success"]["rows"]:
            share = r["solved"] / r["targets"]
            rows.append(
                [f"{r['robot']}: 99.99 % of {r['targets']:,} targets", common.percent(r), mark(share >= 0.9999)]
            )
        big = found["success"].get("million")
        if big:
            wrong = big["pinocchio"]["not_confirmed"]
            text = f"{big['solved']:,} of {big['targets']:,}; {wrong} of {big['pinocchio']['checked']:,} not confirmed"
            rows.append(["1,000,000 Panda targets, 1 % checked by Pinocchio", text, mark(not wrong)])
            left = big["again"]
            text = f"{left['targets']} fail; with {left['restarts']} restarts {left['solved']} of them are solved"
            rows.append(["no failure among them left unexplained", text, mark(left["solved"] == left["targets"])])
            growth = big["peak_at_end"] - big["peak_at_quarter"]
            rows.append(["the same from an iterator: memory flat", f"{growth / 1e6:+.1f} MB", mark(growth < 50e6)])
    if "solve" in found:
        runs = {(r["robot"], r["start"], r["tolerance"]): r["rows"] for r in found["solve"]["runs"]}
        for robot, least, tail in (("panda", 12, 20), ("ur5", 6, None), ("kinova", 6, None)):
            rows += faster(runs.get((robot, "random", "strict"), {}), robot, least, tail)
        strict = runs.get(("ur5", "random", "strict"), {})
        if {"ik", "eaik"} <= strict.keys():
            for key in ("median", "mean"):
                ours, theirs = strict["ik"]["wall"][key], strict["eaik"]["wall"][key]
                text = f"{ours:.2f} us against {theirs:.2f} us"
                rows.append([f"ur5: {key} faster than EAIK (its all answers)", text, mark(ours < theirs)])
        for (robot, start, tolerance), run in runs.items():
            if start == "near" and tolerance == "strict" and {"ik", "cartan"} <= run.keys():
                ours, theirs = run["ik"]["wall"]["median"], run["cartan"]["wall"]["median"]
                text = f"{ours:.2f} us; cartan {theirs:.2f} us"
                rows.append(
                    [
                        f"{robot}: near start, median at most 5 us, faster than cartan",
                        text,
                        mark(ours <= 5 and ours < theirs),
                    ]
                )
        worst = max(
            (
                (run["ik.solve"]["wall"]["median"], key[0])
                for key, run in runs.items()
                if "ik.solve" in run and key[1] == "random"
            ),
            default=None,
        )
        if worst:
            text = f"{worst[0]:.1f} us ({worst[1]}, the slowest)"
            rows.append(["`ik.solve` with everything on, median at most 25 us", text, mark(worst[0] <= 25)])
    if "batch" in found:
        for r in found["batch"]["rows"]:
            if r["targets"] == 100_000 and r["threads"] == 2:
                text = f"{r['per_second']:,.0f} a second, best run {r['best_per_second']:,.0f}"
                for aim in (400_000, 1_000_000):
                    name = f"{r['robot']}: batch of 100,000 on 2 cores, {aim:,} a second"
                    rows.append([name, text, mark(r["per_second"] >= aim)])
        most = max(r["memory"] for r in found["batch"]["rows"]) / 1e6
        rows.append(["memory of a batch beyond input and output, under 50 MB", f"{most:.1f} MB", mark(most < 50)])
    if "kernel" in found:
        most = max(found["kernel"]["median_ns"][UNREACHABLE].values()) / 1e3
        rows.append(
            ["target proven out of reach, answered in 200 us", f"{most:.0f} us (slowest robot)", mark(most <= 200)]
        )
    return rows


def faster(run: dict[str, Any], robot: str, least: float, tail: float | None) -> list[list[str]]:
    """Rows of the comparison with the Robotics Toolbox, by the clock and by processor time."""
    if "faster" not in run.get("ik", {}) or "rtb" not in run:
        return []
    rows = []
    for key, name, bound in (("median", "median", least), ("p99", "99th percentile", tail)):
        if bound is None:
            continue
        wall, processor = (run["ik"]["faster"][clock][key] for clock in ("wall", "processor"))
        text = f"{wall:.1f} times ({run['ik']['wall'][key]:.1f} against {run['rtb']['wall'][key]:.0f} us)"
        text += f"; processor time {processor:.1f} times"
        rows.append([f"{robot}: {name} {bound} times faster than `ik_LM(k=0.1)`", text, mark(wall >= bound)])
    return rows


def section(title: str, data: dict[str, Any] | None, about: str = "") -> list[str]:
    """Heading, command, machine and tables of one file."""
    if data is None:
        return []
    parts = [f"## {title}", about.strip(), f"```\n{data['command']}\n```", machine(data)]
    return [part for part in parts if part] + [data["tables"].strip()]


def solvers(data: dict[str, Any]) -> str:
    """Table of who is compared."""
    rows = [[f"`{key}`", about, data["versions"].get(key, "")] for key, about in data["peers"].items()]
    return common.table(["solver", "what", "version"], rows).replace("---:", "---")


NAMES = {  # of rows, where it is not the key
    "ik": "**`ik.Solver`**, bound to a robot", "ik_q0": "**`ik.Solver`**, from q0",
    "ik.solve": "**`ik.solve`**, inputs and result checked",
    "rtb": "Robotics Toolbox `ik_LM(k=0.1)`", "rtb_free": "Robotics Toolbox `ik_LM(k=0.1, joint_limits=False)`",
    "pytracik": "TRAC-IK (pytracik, two threads)",
}  # fmt: skip


def headline(found: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """Rows of the comparison that README and chart show, the fastest first: random poses of the Panda, strict tolerances."""
    runs = {(r["robot"], r["start"], r["tolerance"]): r["rows"] for r in found["solve"]["runs"]}
    rows = runs["panda", "random", "strict"]
    return dict(sorted(rows.items(), key=lambda item: item[1]["wall"]["median"]))


def chart(found: dict[str, dict[str, Any]], picture: Path) -> list[str]:
    """Draw the headline to `picture`; return the lines of the page that show it."""
    rows = headline(found)
    begin = 0.5 * min(row["wall"]["median"] for row in rows.values())  # a logarithmic axis has no zero
    most = max(row["wall"]["p99"] for row in rows.values())
    with drawing() as plt:
        figure, axis = plt.subplots(figsize=(7.6, 0.8 + 0.33 * len(rows)), layout="constrained")
        for k, (name, row) in enumerate(rows.items()):
            median, tail = row["wall"]["median"], row["wall"]["p99"]
            own = name.startswith("ik") and name != "ikpy"
            axis.barh(-k, median - begin, left=begin, height=0.62, color=COLOURS[0] if own else COLOURS[7])
            axis.plot([median, tail], [-k, -k], color=GREY, lw=1.2, marker="|", ms=6)
            solved = 100 * row["solved"] / row["targets"]
            text = f"{common.short(median)} us,  {solved:.4g} % solved"
            axis.annotate(text, (tail, -k), xytext=(7, 0), textcoords="offset points", va="center", fontsize=8)
        labels = [textwrap.fill(re.sub("[*`]", "", NAMES.get(name, name)), 32) for name in rows]
        axis.set_xscale("log")
        axis.set_xlim(begin, 100.0 * most)  # with room for the last row's text
        axis.set_yticks([-k for k in range(len(rows))], labels)
        axis.grid(False, axis="y")
        axis.tick_params(axis="y", length=0)
        axis.set_xlabel("time of a solve [us]: median (bar) and 99th percentile (line), log scale")
        figure.suptitle("Random poses of the Panda to 1e-6 m and rad, one call from Python, one thread", fontsize=10)
        save(figure, picture)
    return [f"```{{image}} _static/{picture.name}\n:alt: {CHART}\n```", first_use(found)]


def first_use(found: dict[str, dict[str, Any]]) -> str:
    """Sentence on what the first use costs: the peers are compiled when they are installed, ours on the machine."""
    seconds = {name: now for name, _, now in found.get("against", {}).get("first", [])}
    if not seconds:
        return ""
    return (
        f"The default solver is compiled when a machine uses it for the first time. That takes {seconds['LM']:.1f} s of processor"
        f" time, once; a second solver takes {seconds['a second rule (DLS)']:.1f} s, one for several tips"
        f" {seconds['several tips']:.1f} s. The code is kept on disk. The other packages need no such step."
    )


def summary(found: dict[str, dict[str, Any]]) -> str:
    """The few figures of the README: one robot, every solver."""
    shown = {key: row for key, row in headline(found).items() if key != "ik_q0"}
    rows = [
        [
            f"{NAMES.get(key, key)} {found['solve']['versions'].get(key, '')}".strip(),
            *(common.short(1.0 * row["wall"][part]) for part in ("median", "p99")),
            f"{100 * row['solved'] / row['targets']:.4g}",
        ]
        for key, row in shown.items()
    ]
    batch = next(r for r in found["batch"]["rows"] if (r["robot"], r["targets"], r["threads"]) == ("panda", 100_000, 2))
    machine = found["solve"]["machine"]["cpu"]
    return "\n\n".join(
        [
            f"{max(row['targets'] for row in shown.values())} random poses of the Panda to 1e-6 m and rad, one call from Python"
            f" each, one thread, {machine}, medians of {found['solve']['rounds']} interleaved rounds. Success: within limits and"
            " tolerances, verified by Pinocchio, so answers found without limits count only where they keep them. Packages"
            " without restarts are restarted from random configurations for up to 50 ms.",
            common.table(["", "median, us", "99th percentile, us", "success, %"], rows),
            f"`ik.solve_batch` solves eight targets side by side on each core: {round(batch['per_second'], -4):,.0f} such poses a"
            " second on two cores. Other robots, tolerances and starts, versions and commands: [benchmarks](docs/benchmarks.md).",
            first_use(found),
        ]
    ).strip()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="folder with the JSON files")
    parser.add_argument("-o", "--output", type=Path, default=Path("docs/benchmarks.md"))
    parser.add_argument("--readme", type=Path, help="also put the summary between the benchmark marks of this file")
    given = parser.parse_args()
    found = {}
    for name in ("solve", "published", "success", "batch", "kernel", "joints", "tree", "servo", "against"):
        path = given.folder / f"benchmark_{name}.json"
        if path.exists():
            found[name] = common.read(path)
    (given.output.parent / "_static").mkdir(parents=True, exist_ok=True)
    parts = [HEAD.strip()]
    if "solve" in found:
        parts += chart(found, given.output.parent / "_static" / "benchmark.png")
        parts += section("Single solves, compared with other packages", found["solve"], SOLVE)[:-1]
        parts += [solvers(found["solve"]), found["solve"]["tables"].strip()]
    parts += section("Published tables", found.get("published"), PUBLISHED)
    rows = aims(found)
    if rows:
        parts += [
            "## Aims and results",
            common.table(["aim (1e-6 m and rad, no starting guess, one thread)", "measured", "met"], rows),
        ]
    parts += section("Success", found.get("success"))
    parts += section("Batch", found.get("batch"))
    parts += section("Building blocks", found.get("kernel"))
    parts += section("Number of joints", found.get("joints"))
    parts += section("Several tips", found.get("tree"))
    parts += section("Following a moving target", found.get("servo"), SERVO)
    parts += section(
        "Compared with the previous version",
        found.get("against"),
        AGAINST.format(old=found.get("against", {}).get("old")),
    )
    given.output.write_text("\n\n".join(part for part in parts if part) + "\n", encoding="utf-8")
    if given.readme:
        before, rest = given.readme.read_text(encoding="utf-8").split(MARKS[0])
        text = f"{before}{MARKS[0]}\n\n{summary(found)}\n\n{MARKS[1]}{rest.split(MARKS[1])[1]}"
        given.readme.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
