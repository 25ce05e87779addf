"""Run the hostile-input, torture, thread and process tests, including the long ones, and put the figures into docs/reliability.md.

Usage: python scripts/reliability.py [-o docs/reliability.md] [--mutants]. Takes some minutes, with --mutants none. The counts come
from the tests themselves and stand between two marks of the page; the rest of it is written by hand.
"""

import argparse
import json
import platform
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ET
from collections import defaultdict
from datetime import date
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PARTS = {
    "tests/robot/test_second_fk.py": "Random robots against forward kinematics written a second time",
    "tests/solvers/test_inside_limits.py": "Limits kept to the last digit",
    "tests/solvers/test_inputs.py": "Targets, starts and options that are no numbers, in odd layouts, or reused",
    "tests/solvers/test_fallback.py": "Closed forms at level arms, limits and loose tolerances",
    "tests/kernel/test_uncompiled.py": "Parts of the kernel as plain Python against numpy, Pinocchio and all active sets",
    "tests/kernel/test_cache.py": "Compiled code on disk: edited sources, damaged files, full disks",
    "tests/package/test_files.py": "Outputs: full disks, signals, hostile target files",
    "tests/robot/test_meshes.py": "Hostile and broken meshes",
    "tests/show/test_hostile_names.py": "Names from files in every page and chart",
    "tests/robot/test_check.py": "Broken and hostile URDFs: a corpus, generated giants, and fuzzing of URDF text",
    "tests/robot/test_dh.py": "D-H tables: random tables against Pinocchio, broken files, fuzzing",
    "tests/servo/test_references.py": "Trajectory files: broken and hostile",
    "tests/robot/test_pose.py": "Targets that are not poses",
    "tests/robot/test_robot.py": "Robots that cannot be loaded; pickling; one robot from eight threads",
    "tests/solvers/test_torture.py": "Numerical torture: half turns, reach boundary, singular poses, absurd lengths, "
    "limits of zero width",
    "tests/contract": "The contract of every solver on every kind of robot",
    "tests/package/test_processes.py": "Fork, spawn, two processes compiling at once, a killed one, no folder for the cache",
    "tests/cli/test_interrupts.py": "Ctrl-C, the real signal, in batch, bench, tune and workspace",
    "tests/solvers/test_batch.py": "Batches: threads, executors, interrupts, broken rows",
    "tests/show/test_panel.py": "The panel: typed nonsense, foreign origins, hosts that are not this machine",
    "tests/show/test_panel_abuse.py": "The panel: twenty visitors, malformed messages, leaving in the middle of a solve, memory",
}
MARKS = ("<!-- tests: written by scripts/reliability.py -->", "<!-- end of tests -->")
MUTANTS, MUTANTS_OF_ROOMS = (ROOT / "docs" / "data" / f"{name}.json" for name in ("mutation", "mutation_rooms"))


def run(path: str) -> tuple[dict[str, int], float, list[str]]:
    """Outcome counts (with cases), seconds and notes of one test file, including long runs."""
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.xml"
        command = [sys.executable, "-m", "pytest", path, "-q", "-m", "slow or not slow", f"--junitxml={report}"]
        command += ["-o", "junit_family=xunit1"]  # the kind that keeps properties
        subprocess.run(command, cwd=ROOT, check=False, stdout=subprocess.DEVNULL)
        counts: dict[str, int] = defaultdict(int)
        notes = []
        seconds = 0.0
        for case in ET.parse(report).getroot().iter("testcase"):
            outcome = next((child.tag for child in case if child.tag in ("failure", "error", "skipped")), "passed")
            counts[outcome] += 1
            seconds += float(case.get("time", 0))
            for prop in case.iter("property"):
                if prop.get("name") == "cases":
                    counts["cases"] += int(prop.get("value", "0"))
                elif prop.get("name") == "note":
                    notes.append(f"`{case.get('name')}`: {prop.get('value')}")
    return counts, seconds, notes


def mutation(file: Path) -> list[str]:
    """Lines on the last mutation run of the kernel or of the rooms, from the figures of scripts/mutate.py."""
    found = json.loads(file.read_text(encoding="utf-8"))
    low, high = found["95 %"]
    lost = sum(row["not reached"] for row in found["folders"].values())
    of = (
        "All of them were tried"
        if found["tried"] == found["mutants in all"]
        else f"Of these {found['tried']} were drawn at random"
    )
    dropped = found["equivalent in it"]
    same = (
        f"; {dropped} of them change nothing that is promised (the file says why) and are left out" if dropped else ""
    )
    unseen = f"{lost} of the rest are reached by none of these tests. " if lost else ""
    kernel = file == MUTANTS
    what, where, left, tests, first = (
        "one operator, comparison, constant or branch",
        "the kernel",
        "code for vectors of eight lanes, and code that runs only in numba",
        "the tests that reach it and take less than a second uncompiled",
        "folder",
    )
    since = "Some led to tests, so a sample never seen would come out lower."
    if not kernel:
        since = "The sample had not been seen before; some survivors have led to tests since."
        what += ", statement, element or keyword"
        where, left, first = "the rooms", "what a room compiles itself", "room"
        tests = "those tests of the room that reach it and take less than four seconds"
    lines = [
        f"## Mutation tests of {where}",
        "",
        f"`{found['command']}` changes {what} of {where} at a time, {found['mutants in all']:,} changes in all, and runs {tests}. "
        f"{of} (seed {found['seed']}){same}. The tests detect {found['killed']} of {found['counted']}: "
        f"{100 * found['share killed']:.1f} % (95 % interval {100 * low:.1f} to {100 * high:.1f} %, Wilson). "
        f"{unseen}Not counted: {left}. "
        f"The survivors are listed in `docs/data/{file.name}`. {since}",
        "",
        f"| {first} | mutants | killed | not reached |",
        "|---|---:|---:|---:|",
    ]
    for part, row in found["folders"].items():
        lines.append(f"| `{part}` | {row['mutants']} | {row['killed']} | {row['not reached']} |")
    return [*lines, ""]


def measured() -> list[str]:
    """Run every part; returns the lines of its figures."""
    lines = [
        f"Written by `python scripts/reliability.py` on {date.today()}, Python {platform.python_version()}, "
        f"{platform.system()} {platform.machine()}. Each row is one test file or folder, slow tests included; the command is "
        '`python -m pytest FILE -m "slow or not slow"`.',
        "",
        "| what is tested | file | tests | solves | failed | skipped | seconds |",
        "|---|---|---:|---:|---:|---:|---:|",
    ]
    remarks = []
    for path, what in PARTS.items():
        counts, seconds, notes = run(path)
        failed = counts["failure"] + counts["error"]
        tests = counts["passed"] + failed
        solves = f"{counts['cases']:,}" if counts["cases"] else ""
        lines.append(f"| {what} | `{path}` | {tests} | {solves} | {failed} | {counts['skipped']} | {seconds:.0f} |")
        remarks += notes
        print(lines[-1], file=sys.stderr)
    return [*lines, "", *(f"- {remark}" for remark in remarks)]


def main() -> None:
    """Write the figures of every part, and those of the mutation tests."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "docs" / "reliability.md")
    parser.add_argument("--mutants", action="store_true", help="write the mutation tests only; run nothing")
    given = parser.parse_args()
    before, rest = given.output.read_text(encoding="utf-8").split(MARKS[0])
    old, after = rest.split(MARKS[1])
    figures = old.partition("## Mutation tests")[0].strip() if given.mutants else "\n".join(measured())
    tables = [line for file in (MUTANTS, MUTANTS_OF_ROOMS) if file.exists() for line in mutation(file)]
    text = "\n".join([figures, "", *tables]).strip()
    given.output.write_text(f"{before}{MARKS[0]}\n\n{text}\n\n{MARKS[1]}{after}", encoding="utf-8")


if __name__ == "__main__":
    main()
