"""Write docs/benchmarks.md, the answers, and a page below docs/benchmarks/ for the data behind each.

python scripts/benchmarks/page.py docs/data -o docs/benchmarks.md --readme README.md

Draws the chart at its head, too (extra plots). Reads benchmark_NAME.json, which the other commands wrote, from the folder given,
for the names in PAGES; those that are missing are left out.
"""

import argparse
import re
import textwrap
from pathlib import Path
from typing import Any, NamedTuple

import common
from aims import aims
from answers import NAMES, answers

from ik_toolkit.show.plots import drawing, save
from ik_toolkit.style import COLOURS, GREY

NOTE = "<!-- Written by scripts/benchmarks/page.py from docs/data: run the commands again instead of editing. -->"
HEAD = """\
# Benchmarks

How fast and how reliable the solvers, batches, paths and trackers are, beside other packages. Unless stated otherwise, targets are
poses of random configurations within the joint limits, to be reached to 1e-6 m and rad without a starting guess, and Pinocchio
judges the answers. Times are from one machine{machines}: compare ratios. Every figure was written by a command in
`scripts/benchmarks/`; each answer links to the page with its command, versions and all figures.
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
EVERY = """\
Packages that list all solutions of an arm with six joints. UR5 has three parallel axes, Z1 a wrist; the HydroLek has neither, so
EAIK cannot list its solutions and `ik_all` finds them by elimination. Only `ik_all` applies limits and says whether its list is
complete. Targets, timing and judgement are those of the single solves.
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
(`on_limit="clip"`).
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


class Page(NamedTuple):
    """A page below docs/benchmarks: its file, its title, the data it shows, what stands above their tables."""

    name: str
    title: str
    data: str
    about: str = ""


PATH = """\
Problems of CppFlow with obstacles, figures like those of TORM (with our own sizes and positions), a weld along a pipe, two arms.
*Valid*, as in CppFlow: every pose within 0.1 mm and 0.1 deg, steps of at most 7 deg and 2 cm, inside the limits, no contact at the
poses and at three places between neighbours, judged by Pinocchio and coal. Times are processor times of all threads, which
depend little on what else the machine does; they include the result's own checks and proof of continuity. The length is the total
rotation of the revolute joints, the shortest known one TORM's. Times by the clock, on an idle machine, are in the
[guide](../guide/path.md#speed-and-path-length).
"""
PAGES = (
    Page("single_solves", "Single solves", "solve", SOLVE),
    Page("every_solution", "Every solution", "every", EVERY),
    Page("published", "Published tables", "published", PUBLISHED),
    Page("success", "Success", "success"),
    Page("batches", "Batches", "batch"),
    Page("kernel", "Building blocks", "kernel"),
    Page("joints", "Number of joints", "joints"),
    Page("several_tips", "Several tips", "tree"),
    Page("paths", "Whole paths", "path", PATH),
    Page("moving_target", "Following a moving target", "servo", SERVO),
    Page("previous_version", "First use, and the previous version", "against", AGAINST),
)


def detail(page: Page, data: dict[str, Any]) -> str:
    """A page of details: command, machine and tables of one file."""
    parts = [NOTE, f"# {page.title}", page.about.format(old=data.get("old")).strip(), f"```\n{data['command']}\n```"]
    parts += [
        machine(data),
        solvers(data) if page.data == "solve" else "",
        data["tables"].strip().replace("\n### ", "\n## "),
    ]
    text = "\n\n".join(part for part in parts if part)
    return re.sub(r"^### ", "## ", text, flags=re.MULTILINE) + "\n"


def front(found: dict[str, dict[str, Any]], picture: Path) -> str:
    """The page of answers."""
    parts = [NOTE, HEAD.strip().format(machines=machines(found))]
    if "solve" in found:
        parts += chart(found, picture)
    for answer in answers(found):
        link = f"[All figures](benchmarks/{answer.page}.md)"
        parts += [f"## {answer.question}", f"{answer.words} {link}.", answer.table]
    return "\n\n".join([*parts, TREE]) + "\n"


TREE = """\
```{toctree}
:hidden:
:glob:

benchmarks/*
```"""


def machines(found: dict[str, dict[str, Any]]) -> str:
    """Where the data come from, briefly."""
    kinds: dict[str, list[str]] = {}
    for name, data in found.items():
        kinds.setdefault(f"{data['machine']['cpu']}, {data['machine']['cores']} cores", []).append(TITLES[name])
    (usual, _), *others = sorted(kinds.items(), key=lambda item: -len(item[1]))
    return f" ({usual}" + "".join(f"; {', '.join(names)}: {kind}" for kind, names in others) + ")"


TITLES = {page.data: page.title.lower() for page in PAGES}


def solvers(data: dict[str, Any]) -> str:
    """Table of who is compared."""
    rows = [[f"`{key}`", about, data["versions"].get(key, "")] for key, about in data["peers"].items()]
    return common.table(["solver", "what", "version"], rows).replace("---:", "---")


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
    return [f"```{{image}} _static/{picture.name}\n:alt: {CHART}\n```"]


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
    for page in PAGES:
        path = given.folder / f"benchmark_{page.data}.json"
        if path.exists():
            found[page.data] = common.read(path)
    docs, folder = given.output.parent, given.output.with_suffix("")
    for made in (docs / "_static", folder):
        made.mkdir(parents=True, exist_ok=True)
    given.output.write_text(front(found, docs / "_static" / "benchmark.png"), encoding="utf-8")
    for page in PAGES:
        if page.data in found:
            (folder / f"{page.name}.md").write_text(detail(page, found[page.data]), encoding="utf-8")
    head = ["aim (1e-6 m and rad, no starting guess, one thread)", "measured", "met"]
    text = f"{NOTE}\n\n# Aims and results\n\n{common.table(head, aims(found))}\n"
    (folder / "aims.md").write_text(text, encoding="utf-8")
    if given.readme:
        before, rest = given.readme.read_text(encoding="utf-8").split(MARKS[0])
        text = f"{before}{MARKS[0]}\n\n{summary(found)}\n\n{MARKS[1]}{rest.split(MARKS[1])[1]}"
        given.readme.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
