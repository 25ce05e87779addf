"""Mutation testing: plants one mistake at a time, runs the tests that reach it, writes docs/data/mutation.json.

Usage: python scripts/mutate.py [--sample 400] [--seed 1] [--workers 2] [--files search.py ...] [-o FILE]
       python scripts/mutate.py --rooms robot,paths,servo,solvers --sample 200 [...]

A mutant is one change of the source: another operator, comparison, constant or branch. First, every test in TESTS that takes
less than SLOW seconds runs once to record which kernel statements it reaches; then each mutant runs the tests that reach its
statement, the quickest and most successful first. It is killed by the first failure, or by a test that takes TOO_LONG times
as long as before. Compiled lanes and the compilation itself are left out: they have nothing to run uncompiled.

Without --rooms the kernel is changed and runs interpreted. With --rooms the folders named are changed, judged first by the tests of
their own name, then by those of the other rooms (see mutate_rooms.py). The kernel runs compiled, so what the rooms compile
themselves is left out. Statements, elements and keywords are dropped as well, a sample is drawn evenly over the lines of code,
and survivors are printed; the figures go to docs/data/mutation_rooms.json.

pytest collects all tests once. A mutant is planted in a fork of that process: its functions get the changed code. Results are
kept in build/mutate, keyed by the text of the kernel file and of the test, so that after an edit only the affected pairs run
again; survivors are tried again when a new test reaches them.
"""

import argparse
import gc
import hashlib
import importlib
import json
import math
import os
import signal
import sys
import time
import traceback
from collections import defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import mutants as changing
from mutants import Mutant, diff, key, living, mark_all, marked, mutants, plant, text_of, uses
from mutate_rooms import ROOMS, caches, judges, shuffle

ROOT = Path(__file__).resolve().parent.parent
OUTPUT = ROOT / "docs" / "data" / "mutation.json"
KEPT = ROOT / "build" / "mutate"
LEFT_OUT = {"kernel/simd_search.py"}  # see above
TESTS = tuple(
    f"tests/{folder}/{name}.py" if name else f"tests/{folder}"
    for folder, names in {
        "kernel/uncompiled": ("",),
        "kernel": ("test_kernel", "test_qp", "test_constrain", "test_damped_step", "test_search", "test_view"),
        "solvers": (
            "test_solve", "test_tree", "test_tree_preferences", "test_follow", "test_limits", "test_budget", "test_what_counts",
            "test_preferences", "test_others", "test_priority", "test_elimination", "test_decomposition", "test_local_minimum",
            "test_proofs", "test_derivative", "test_free_turns", "test_self_motion", "test_starts", "test_inside_limits",
            "test_one_tip_only", "test_recognition", "test_solutions",
        ),
        "servo": ("test_accuracy", "test_jacobian_rate", "test_loop", "test_motion_limits", "test_servo", "test_status"),
        "paths": ("test_link", "test_refine", "test_continuity", "test_few_joints"),
    }.items()
    for name in names
)  # fmt: skip
SLOW, SLOW_IN_ROOM = 0.8, 4.0  # [s] processor time of a test, uncompiled or not: slower ones are not used
COMPILING = 120.0  # [s] longest test of a room that needs kernels that are not on disk
OUTPUT_ROOMS = OUTPUT.with_name("mutation_rooms.json")
ENOUGH = 8.0  # [s] most test time spent on a surviving mutant
TOO_LONG, LEAST = 10.0, 4.0  # multiple of a test's time, and [s], after which it counts as an endless loop
DEAD = ("killed", "timeout")


# ------------------------------------------------------------------------------------------------------------ running
class Outcome:
    """pytest plugin: whether a test passed, and how long it took. A test that takes too long is interrupted."""

    def __init__(self) -> None:
        self.passed, self.seconds = False, 0.0

    def pytest_runtest_logreport(self, report: Any) -> None:
        """Record the outcome."""
        if report.when == "call":
            self.passed = report.passed
        elif report.failed:
            self.passed = False

    def of(self, item: Any, following: Any, limit: float) -> bool:
        """Run a test; returns whether it passed."""
        self.passed = False
        begun = time.process_time()
        signal.signal(signal.SIGPROF, too_slow)
        signal.setitimer(signal.ITIMER_PROF, limit, 1.0)  # repeats in case the test catches it
        try:
            item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
        except TimeoutError:  # between the phases of the test
            self.passed = False
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0.0)
            self.seconds = time.process_time() - begun
        return self.passed


def too_slow(*_: Any) -> None:
    """End a test that takes too long."""
    raise TimeoutError("too slow")


def in_forks(tasks: list, work: Callable[[Any], Any], seconds: Callable[[Any], float], workers: int) -> Iterator[tuple]:
    """Yield each task with the result of `work(task)` in a silent fork; None: it crashed, "late": it was killed."""
    waiting, running = list(reversed(tasks)), {}
    while waiting or running:
        while waiting and len(running) < workers:
            task = waiting.pop()
            pid = os.fork()
            if pid == 0:
                in_fork(work, task)
            running[pid] = task, time.monotonic() + seconds(task)
        time.sleep(0.02)
        for pid, (task, ends) in list(running.items()):
            late = time.monotonic() > ends
            if late:
                os.kill(pid, signal.SIGKILL)
            if os.waitpid(pid, 0 if late else os.WNOHANG)[0]:
                del running[pid]
                answer = KEPT / f"{pid}.json"
                yield (
                    task,
                    json.loads(answer.read_text(encoding="utf-8")) if answer.exists() else "late" if late else None,
                )
                answer.unlink(missing_ok=True)


def in_fork(work: Callable[[Any], Any], task: Any) -> None:
    """Do the work, write its result, and exit."""
    nothing = os.open(os.devnull, os.O_RDWR)
    for stream in (0, 1, 2):
        os.dup2(nothing, stream)
    try:
        text = json.dumps(work(task))
        (KEPT / f"{os.getpid()}.json").write_text(text, encoding="utf-8")
    except BaseException:
        (KEPT / "error.txt").write_text(traceback.format_exc(), encoding="utf-8")
    finally:
        os._exit(0)


class Run:
    """pytest plugin: instead of running the tests it collected, run them on mutants."""

    def __init__(self, given: argparse.Namespace) -> None:
        self.given, self.outcome = given, Outcome()
        self.slow = SLOW_IN_ROOM if given.rooms else SLOW
        chosen = {*ROOMS, *given.rooms}  # what is looked at does not depend on which of the usual rooms are changed
        chosen = [f for f in changing.files() if not given.rooms or f.split("/")[0] in chosen]
        self.stamps = {f: stamp(changing.PACKAGE / f) for f in chosen}
        self.kills: dict[str, int] = defaultdict(int)
        self.tests: dict[str, dict] = {}

    def pytest_runtestloop(self, session: Any) -> bool:
        """Record reach, plant mutants, write results."""
        session.config.pluginmanager.register(self.outcome)
        self.items = {item.nodeid: item for item in session.items}
        self.files = {name: stamp(ROOT / name.split("::")[0]) for name in self.items}
        for file in changing.files():
            text_of(file)  # read before forking
        for file in self.stamps:  # some are loaded when first needed
            if file not in changing.scripts() and not file.endswith("__init__.py"):
                importlib.import_module("ik_toolkit." + file[:-3].replace("/", "."))
        gc.unfreeze()  # what is frozen is not found
        self.caches = caches() if self.given.rooms else []
        self.functions = {f: found for f, found in living().items() if f in self.stamps}
        gc.collect()
        gc.freeze()  # forks share untouched memory
        self.look()
        self.lines = {name: {(f, n) for f, ns in t["lines"].items() for n in ns} for name, t in self.tests.items()}
        self.plant_all()
        return True

    def look(self) -> None:
        """Find which statements each test reaches, unless already known."""
        place = KEPT / ("reach_rooms.json" if self.given.rooms else "reach.json")
        known = json.loads(place.read_text(encoding="utf-8")) if place.exists() else {}

        def stands(name: str) -> bool:
            old = known.get(name, {"stamp": ""})
            if old["stamp"] != self.files[name]:
                return False
            slow = not old["passed"] or old["seconds"] >= self.slow  # and stays so, whatever changes in the kernel
            return slow or all(self.stamps.get(f) == s for f, s in old["kernel"].items())

        def work(names: list[str]) -> dict:
            reached = mark_all(self.functions, new_code)
            found = {}
            for name in names:
                for marks in reached.values():
                    marks[:] = bytes(len(marks))
                for cache in self.caches:
                    cache.cache_clear()
                # the marks take time
                for limit in (2.0 * self.slow,) if not self.given.rooms else (COMPILING, 2.0 * self.slow):
                    passed = self.outcome.of(self.items[name], None, limit)
                    if self.outcome.seconds < self.slow:
                        break  # otherwise something may have been compiled: again
                lines = {f: [n for n, mark in enumerate(marks) if mark] for f, marks in reached.items() if any(marks)}
                found[name] = {"passed": passed, "seconds": self.outcome.seconds, "lines": lines}
            return found

        new: dict[str, list[str]] = defaultdict(list)  # by file: its tests need the same kernels
        for name in self.items:
            if not stands(name):
                new[name.split("::")[0] if self.given.rooms else name].append(name)
        new_code = marked(self.functions) if new else {}
        late = (600.0 if self.given.rooms else 20.0), 4.0 * self.slow  # [s] for all, and for each
        tasks = in_forks(list(new.values()), work, lambda names: late[0] + late[1] * len(names), self.given.workers)
        for i, (names, found) in enumerate(tasks):
            for name in names:
                nothing = {"passed": False, "seconds": math.inf, "lines": {}}
                known[name] = found[name] if isinstance(found, dict) else nothing
                known[name] |= {"stamp": self.files[name], "kernel": {f: self.stamps[f] for f in known[name]["lines"]}}
            if self.given.rooms or i % 100 == 99 or i == len(new) - 1:
                print(f"{i + 1} of {len(new)} looked at: {names[-1]}", flush=True)
                place.write_text(json.dumps(known), encoding="utf-8")
        self.tests = {n: known[n] for n in self.items if known[n]["passed"] and known[n]["seconds"] < self.slow}

    def chosen(self, mutant: Mutant) -> list[str]:
        """Tests of its room that reach a mutant."""
        at = {(mutant.file, mutant.statement)} if mutant.statement else uses(mutant.constant)
        if mutant.file in changing.scripts():
            at = uses("WORKER") | at
        return sorted(name for name in self.tests if not at.isdisjoint(self.lines[name]))

    def ordered(self, names: list[str], first: str, file: str) -> list[str]:
        """As many tests as there is time for: those of the room first, then those that find most in the least time."""
        total, taken = 0.0, []
        own = judges(file.split("/")[0]) if self.given.rooms else ("",)

        def rank(n: str) -> tuple:
            return n != first, not n.startswith(own), self.tests[n]["seconds"] / (1 + self.kills[n])

        for name in sorted(names, key=rank):
            total += self.tests[name]["seconds"]
            if taken and total > self.given.enough:
                break
            taken.append(name)
        return taken

    def plant_all(self) -> None:
        """Try mutants not yet tried on these tests, and write the shares."""
        rooms = self.given.rooms
        usual = [f for f in self.stamps if (f.split("/")[0] in rooms if rooms else f not in LEFT_OUT)]
        wanted = self.given.files or usual
        every = [m for f in wanted for m in mutants(f)]
        shuffle(every, self.given.seed, exact({m.file for m in every}) if self.given.rooms else None)
        todo = every[: self.given.sample] if self.given.sample else every
        log = KEPT / "results.jsonl"
        before = [json.loads(line) for line in log.read_text(encoding="utf-8").splitlines()] if log.exists() else []
        known = {(r["kernel"], r["mutant"]): r for r in before}
        hints = {r["text"]: r["by"] for r in before if r["by"]}
        done: dict[str, str] = {}
        again = []
        for mutant in todo:
            names = self.chosen(mutant)
            old = known.get((self.stamps[mutant.file], mutant.name))
            less = old and not old["by"] and old.get("enough", ENOUGH) < self.given.enough
            if (
                old
                and not less
                and old["tests"] == (self.files.get(old["by"], "gone") if old["by"] else self.together(names))
            ):
                done[mutant.name] = old["what"]
                self.kills[old["by"]] += 1
            elif names:
                again.append((mutant, names))
            else:
                done[mutant.name] = "not reached"

        def work(task: tuple) -> dict:
            mutant, names = task
            plant(mutant, self.functions)
            items = [self.items[n] for n in self.ordered(names, hints.get(key(mutant.name), ""), mutant.file)]
            for item, following in zip(items, [*items[1:], None], strict=True):
                limit = max(LEAST, TOO_LONG * self.tests[item.nodeid]["seconds"])
                if not self.outcome.of(item, following, limit):
                    return {"what": "timeout" if self.outcome.seconds > limit else "killed", "by": item.nodeid}
            return {"what": "survived", "by": ""}

        print(f"{len(done)} known, {len(again)} to try", flush=True)
        with log.open("a", encoding="utf-8") as out:
            for i, ((mutant, names), found) in enumerate(
                in_forks(again, work, lambda _: 20.0 * self.given.enough, self.given.workers)
            ):
                if not isinstance(found, dict):
                    found = {"what": "timeout" if found else "crash", "by": ""}  # see error.txt
                done[mutant.name] = found["what"]
                self.kills[found["by"]] += 1
                tests = self.files[found["by"]] if found["by"] else self.together(names)
                found |= {
                    "mutant": mutant.name,
                    "text": key(mutant.name),
                    "kernel": self.stamps[mutant.file],
                    "tests": tests,
                    "enough": self.given.enough,
                }
                out.write(json.dumps(found) + "\n")
                out.flush()
                print(f"{i + 1:5d} {found['what']:12} {mutant.name}  {found['by']}", flush=True)
        write(self.given, todo, done, len(every), self.stamps)

    def together(self, names: list[str]) -> str:
        """Hash of the current text of these tests."""
        return hashlib.sha256("".join(f"{n} {self.files[n]}" for n in names).encode()).hexdigest()[:12]


def stamp(path: Path) -> str:
    """Hash of the text of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()[:12]


def wilson(k: int, n: int) -> tuple[float, float]:
    """95 % interval of a share (Wilson, 1927)."""
    z = 1.959964
    middle, width = (k + z * z / 2) / (n + z * z), z / (n + z * z) * math.sqrt(k * (n - k) / n + z * z / 4)
    return middle - width, middle + width


def write(given: argparse.Namespace, todo: list[Mutant], done: dict[str, str], everything: int, stamps: dict) -> None:
    """Write shares by folder, and the survivors by name."""
    before = json.loads(given.output.read_text()) if given.output.exists() else {}
    # Judged by hand, by `exact` name: what is equivalent, and what a test kills in the source, though not as planted.
    same, in_source = before.get("equivalent", {}), before.get("killed in the source", {})
    names = exact({m.file for m in todo})
    done = {**done, **{m.name: "killed" for m in todo if names[m.name] in in_source}}
    counted = [m for m in todo if names[m.name] not in same]
    rows = {}
    part = {m: m.file.split("/")[0] if given.rooms else m.file.rpartition("/")[0] for m in counted}
    for file in sorted(set(part.values())):
        ends = [done[m.name] for m in counted if part[m] == file]
        rows[file] = {
            "mutants": len(ends), "killed": sum(e in DEAD for e in ends), "not reached": ends.count("not reached"),
            **({"in time": ends.count("timeout")} if given.rooms else {}),
        }  # fmt: skip
    total, dead = len(counted), sum(r["killed"] for r in rows.values())
    low, high = wilson(dead, total) if total else (0.0, 1.0)
    kernel = hashlib.sha256("".join(stamps[f] for f in sorted(stamps)).encode()).hexdigest()[:12]
    given_rooms = f" --rooms {','.join(given.rooms)}" if given.rooms else ""
    command = f"python scripts/mutate.py{given_rooms}" + (
        f" --sample {given.sample} --seed {given.seed}" if given.sample else ""
    )
    result = {
        "command": command, "seed": given.seed, "kernel": kernel, "mutants in all": everything, "tried": len(todo),
        "equivalent in it": len(todo) - total, "counted": total, "killed": dead,
        "share killed": round(dead / max(total, 1), 4), "95 %": [round(low, 4), round(high, 4)], "folders": rows,
        "survivors": sorted(f"{m.name} ({done[m.name]})" for m in counted if done[m.name] not in DEAD),
        "equivalent": same, "killed in the source": in_source,
    }  # fmt: skip
    given.output.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    for mutant in (m for m in counted if given.rooms and done[m.name] not in DEAD):
        print(f"\n{mutant.name} ({done[mutant.name]})\n{names[mutant.name]}\n{diff(mutant)}")
    print(json.dumps({k: result[k] for k in ("tried", "share killed", "95 %", "folders")}, indent=1))


def exact(files: set[str]) -> dict[str, str]:
    """Stable name of each mutant of some files, unaffected by edits of other lines: its `key`, numbered if a line has several."""
    names, seen = {}, defaultdict(int)
    for mutant in (m for file in sorted(files) for m in mutants(file)):
        text = key(mutant.name)
        seen[text] += 1
        names[mutant.name] = f"{text} {seen[text]}" if seen[text] > 1 else text
    return names


def main() -> None:
    """Collect the tests and hand them to `Run`."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sample", type=int, default=0, help="mutants to try, chosen at random; 0: all")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--files", nargs="*", default=[])
    parser.add_argument(
        "--rooms", type=lambda text: text.split(","), default=[], help="folders to change, not the kernel"
    )
    parser.add_argument(
        "--enough", type=float, default=ENOUGH, help="[s] of tests for a mutant that none of them notices"
    )
    parser.add_argument("-o", "--output", type=Path)
    given = parser.parse_args()
    given.output = (given.output or (OUTPUT_ROOMS if given.rooms else OUTPUT)).resolve()
    os.environ["IK_TOOLKIT_WAIT"] = "1"
    if given.rooms:
        changing.in_package()
    else:
        os.environ["NUMBA_DISABLE_JIT"] = "1"
    sys.path.insert(0, str(ROOT))
    KEPT.mkdir(parents=True, exist_ok=True)
    os.chdir(ROOT)
    import pytest

    tests = [f for room in {*ROOMS, *given.rooms} for f in judges(room)] if given.rooms else TESTS
    sys.exit(pytest.main(["-q", "-s", "-p", "no:cacheprovider", "-p", "no:xdist", *tests], plugins=[Run(given)]))


if __name__ == "__main__":
    main()
