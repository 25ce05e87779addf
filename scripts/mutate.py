"""Which mistakes in the kernel do the tests see? Plants one at a time, interpreted, and writes docs/data/mutation.json.

Usage: python scripts/mutate.py [--sample 400] [--seed 1] [--workers 2] [--files search.py ...] [-o FILE]

A mutant is one change of the source: another operator, comparison, constant or branch. First every test of TESTS that takes
less than SLOW seconds runs once and says which kernel lines it reaches; then each mutant runs the tests that reach its line,
the fastest first, in a process forked from one that has all libraries loaded. It is killed by the first failure, or when
it takes TOO_LONG. Compiled lanes and what compiles are left out: uncompiled there is nothing to run. A run that was
interrupted goes on where it stopped; a change of kernel or tests begins anew.
"""

import argparse
import ast
import copy
import hashlib
import importlib.abc
import importlib.machinery
import json
import math
import os
import random
import signal
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).resolve().parent.parent
KERNEL = ROOT / "ik_toolkit" / "kernel"
OUTPUT = ROOT / "docs" / "data" / "mutation.json"
WORK = ROOT / "build" / "mutate"
LEFT_OUT = {"__init__.py", "jit.py", "cache.py", "parts.py", "vector.py", "lanes.py"}  # see above
TESTS = tuple(
    f"tests/{name}"
    for name in (
        "kernel", "solvers/test_solve.py", "solvers/test_tree.py", "solvers/test_tree_preferences.py", "solvers/test_follow.py",
        "solvers/test_limits.py", "solvers/test_budget.py", "solvers/test_what_counts.py", "solvers/test_preferences.py",
        "solvers/test_inside_limits.py", "solvers/test_feedback.py", "solvers/test_inputs.py", "solvers/test_others.py",
        "robot/test_robot.py", "robot/test_pose.py", "tracking",
    )
)  # fmt: skip
SLOW = 4.0  # seconds of a test, uncompiled: slower ones are not used
WATCHED = 3.0  # times as long a test takes while its lines are watched
ENOUGH = 25.0  # seconds of tests a mutant may need when it survives
TOO_LONG = 90.0  # seconds after which a mutant is killed: its loop does not end
OPERATORS = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.FloorDiv: ast.Mult, ast.Mod: ast.Mult,
    ast.RShift: ast.LShift, ast.LShift: ast.RShift, ast.BitXor: ast.BitOr, ast.BitOr: ast.BitAnd, ast.BitAnd: ast.BitOr,
    ast.Pow: ast.Mult,
}  # fmt: skip
COMPARISONS = {
    ast.Lt: (ast.LtE, ast.Gt), ast.LtE: (ast.Lt, ast.Gt), ast.Gt: (ast.GtE, ast.Lt), ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,), ast.NotEq: (ast.Eq,),
}  # fmt: skip
CALLS = {"min": "max", "max": "min", "sin": "cos", "cos": "sin", "ceil": "floor", "floor": "ceil"}


class Mutant(NamedTuple):
    """One change: the number of the node in its file, and of the change at that node."""

    file: str
    node: int
    change: int
    line: int
    what: str

    @property
    def name(self) -> str:
        """Name in the results."""
        return f"{self.file}:{self.line}:{self.node}.{self.change} {self.what}"


# ------------------------------------------------------------------------------------------------------------ mutants
def changes(node: ast.AST) -> Iterator[tuple[str, Any]]:
    """Name of each change of a node, and what makes it (in place)."""
    if isinstance(node, (ast.BinOp, ast.AugAssign)) and type(node.op) in OPERATORS:
        other = OPERATORS[type(node.op)]
        yield f"{type(node.op).__name__} -> {other.__name__}", lambda n: setattr(n, "op", other())
    elif isinstance(node, ast.Compare):
        for other in COMPARISONS.get(type(node.ops[0]), ()):
            yield f"{type(node.ops[0]).__name__} -> {other.__name__}", lambda n, o=other: n.ops.__setitem__(0, o())
    elif isinstance(node, ast.BoolOp):
        other = ast.Or if isinstance(node.op, ast.And) else ast.And
        yield f"{type(node.op).__name__} -> {other.__name__}", lambda n: setattr(n, "op", other())
    elif isinstance(node, (ast.If, ast.IfExp, ast.While)):
        if not (isinstance(node, ast.While) and isinstance(node.test, ast.Constant)):
            yield "condition negated", lambda n: setattr(n, "test", ast.UnaryOp(ast.Not(), n.test))
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        yield "minus dropped", lambda n: setattr(n, "op", ast.UAdd())
    elif isinstance(node, ast.Constant) and type(node.value) in (int, float):
        more = node.value + 1 if isinstance(node.value, int) else 2.0 * node.value if node.value else 1.0
        yield f"{node.value} -> {more}", lambda n: setattr(n, "value", more)
    elif isinstance(node, ast.Constant) and type(node.value) is bool:
        yield f"{node.value} -> {not node.value}", lambda n: setattr(n, "value", not n.value)
    elif isinstance(node, ast.Call):
        name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
        if name in CALLS:
            key = "attr" if isinstance(node.func, ast.Attribute) else "id"
            yield f"{name} -> {CALLS[name]}", lambda n: setattr(n.func, key, CALLS[name])


def functions_of(tree: ast.Module) -> Iterator[ast.AST]:
    """Nodes inside functions that run uncompiled, and values of numeric constants of the module."""
    for top in tree.body:
        if isinstance(top, ast.ClassDef):
            bodies = [f for f in top.body if isinstance(f, ast.FunctionDef)]
        elif isinstance(top, ast.FunctionDef):
            bodies = [top]
        elif isinstance(top, ast.Assign) and isinstance(top.value, (ast.Constant, ast.BinOp, ast.Tuple)):
            yield from ast.walk(top.value)
            continue
        else:
            continue
        for body in bodies:
            if any("overload" in ast.unparse(mark) for mark in body.decorator_list):
                continue  # numba's side of a function whose plain side is what runs here
            for statement in body.body:
                yield from ast.walk(statement)


def mutants(file: str) -> list[Mutant]:
    """All changes of a kernel file."""
    tree = ast.parse((KERNEL / file).read_text(encoding="utf-8"))
    return [
        Mutant(file, i, k, getattr(node, "lineno", 0), what)
        for i, node in enumerate(functions_of(tree))
        for k, (what, _) in enumerate(changes(node))
    ]


def planted(mutant: Mutant) -> ast.Module:
    """The file with the change made."""
    tree = ast.parse((KERNEL / mutant.file).read_text(encoding="utf-8"))
    node = list(functions_of(tree))[mutant.node]
    list(changes(copy.copy(node)))[mutant.change][1](node)
    return ast.fix_missing_locations(tree)


class Planter(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Imports one kernel module from a changed tree."""

    def __init__(self, mutant: Mutant) -> None:
        self.name = f"ik_toolkit.kernel.{mutant.file[:-3]}"
        self.path = str(KERNEL / mutant.file)
        self.code = compile(planted(mutant), self.path, "exec")

    def find_spec(self, name: str, path: Any, target: Any = None) -> Any:
        """Ours, or None."""
        if name == self.name:
            return importlib.machinery.ModuleSpec(name, self, origin=self.path, is_package=False)
        return None

    def exec_module(self, module: Any) -> None:
        """Run the changed code."""
        module.__file__ = self.path
        exec(self.code, module.__dict__)  # noqa: S102  our own source, changed


# ------------------------------------------------------------------------------------------------------------ tests
def too_slow(*_: Any) -> None:
    """End a test that takes too long to be used."""
    raise TimeoutError("slower than SLOW")


class Reach:
    """pytest plugin: which kernel lines each test that passes reaches, and its time."""

    def __init__(self) -> None:
        self.found: dict[str, dict] = {}
        self.lines: set[tuple[str, int]] = set()
        self.kernel = str(KERNEL)

    def _watch(self, frame: Any, event: str, _: Any) -> Any:
        if not frame.f_code.co_filename.startswith(self.kernel):
            return None
        if event == "line":
            self.lines.add((os.path.basename(frame.f_code.co_filename), frame.f_lineno))
        return self._watch

    def pytest_runtest_call(self, item: Any) -> None:
        """Watch, for as long as a test may take."""
        self.lines = set()
        signal.signal(signal.SIGALRM, too_slow)
        signal.setitimer(signal.ITIMER_REAL, WATCHED * SLOW)
        sys.settrace(self._watch)

    def pytest_runtest_logreport(self, report: Any) -> None:
        """Keep the lines of a test that passed."""
        if report.when == "call":
            sys.settrace(None)
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            if report.passed and self.lines:
                lines: dict[str, list[int]] = {}
                for file, line in sorted(self.lines):
                    lines.setdefault(file, []).append(line)
                self.found[report.nodeid] = {"seconds": report.duration / WATCHED, "lines": lines}


def forked(work: Any, seconds: float) -> int | None:
    """Exit code of `work()` in a fork that says nothing; None when it took too long."""
    child = os.fork()
    if child == 0:
        os.setpgid(0, 0)
        nothing = os.open(os.devnull, os.O_RDWR)
        for stream in (0, 1, 2):
            os.dup2(nothing, stream)
        code = 70
        try:
            code = int(work())
        except BaseException:
            import traceback

            (WORK / "error.txt").write_text(traceback.format_exc(), encoding="utf-8")
        finally:
            os._exit(code)
    ends = time.monotonic() + seconds
    while time.monotonic() < ends:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.02)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return None


def pytest_run(names: list[str], plugins: list[Any]) -> int:
    """Run tests in this process."""
    import pytest

    os.chdir(ROOT)
    return pytest.main(["-x", "-q", "-p", "no:cacheprovider", "-p", "no:xdist", *names], plugins=plugins)


def look(path: Path, file: str) -> None:
    """Write which lines the tests of one file reach."""

    def work() -> int:
        import pytest

        os.chdir(ROOT)
        reach = Reach()
        options = ["-q", "-p", "no:cacheprovider", "-p", "no:xdist"]
        pytest.main([*options, file], plugins=[reach])
        path.write_text(json.dumps(reach.found), encoding="utf-8")
        return 0

    forked(work, 3600.0)


def killed(mutant: Mutant, names: list[str]) -> str:
    """What became of a mutant: killed, timeout, survived, or not reached by any test."""
    if not names:
        return "not reached"

    def work() -> int:
        sys.meta_path.insert(0, Planter(mutant))
        return pytest_run(names, [])

    code = forked(work, TOO_LONG)
    return "timeout" if code is None else "survived" if code == 0 else "killed"


def wilson(k: int, n: int) -> tuple[float, float]:
    """95 % interval of a share (Wilson, 1927)."""
    z = 1.959964
    middle, width = (k + z * z / 2) / (n + z * z), z / (n + z * z) * math.sqrt(k * (n - k) / n + z * z / 4)
    return middle - width, middle + width


def main() -> None:
    """Look, plant, count."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sample", type=int, default=0, help="mutants to try, by chance; 0: all")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--files", nargs="*", default=[])
    parser.add_argument("-o", "--output", type=Path, default=OUTPUT)
    given = parser.parse_args()
    os.environ["NUMBA_DISABLE_JIT"] = os.environ["IK_TOOLKIT_WAIT"] = "1"
    sys.path.insert(0, str(ROOT))
    import numba  # noqa: F401  loaded here, so that no fork loads it again
    import numpy  # noqa: F401
    import pinocchio  # noqa: F401
    import pytest  # noqa: F401

    sources = [
        *KERNEL.glob("*.py"),
        *(p for t in TESTS for p in ([ROOT / t] if t.endswith(".py") else (ROOT / t).glob("*.py"))),
    ]
    stamp = hashlib.sha256(b"".join(p.read_bytes() for p in sorted(sources))).hexdigest()[:12]
    place = WORK / stamp
    place.mkdir(parents=True, exist_ok=True)
    files = [str(p.relative_to(ROOT)) for p in sorted(sources) if p.name.startswith("test_")]
    waiting = [(place / f"{Path(f).stem}.json", f) for f in files]
    with ThreadPoolExecutor(given.workers) as pool:
        for path, file in waiting:
            if not path.exists():
                pool.submit(look, path, file)
    tests = {name: t for path, _ in waiting if path.exists() for name, t in json.loads(path.read_text()).items()}
    tests = dict(sorted(((k, t) for k, t in tests.items() if t["seconds"] < SLOW), key=lambda kt: kt[1]["seconds"]))
    lines = {name: {(f, n) for f, ns in t["lines"].items() for n in ns} for name, t in tests.items()}
    at_import = {
        name for name in tests if name.startswith("tests/kernel")
    }  # for constants, which no line of a test reaches

    def chosen(mutant: Mutant) -> list[str]:
        names, total = [], 0.0
        for name in tests:
            if (mutant.file, mutant.line) in lines[name] or (mutant.line in loose[mutant.file] and name in at_import):
                total += tests[name]["seconds"]
                if total > ENOUGH:
                    break
                names.append(name)
        return names

    wanted = given.files or [p.name for p in sorted(KERNEL.glob("*.py")) if p.name not in LEFT_OUT]
    loose = {f: constants(f) for f in wanted}
    todo = [m for f in wanted for m in mutants(f)]
    everything = len(todo)
    random.Random(given.seed).shuffle(todo)  # noqa: S311
    todo = todo[: given.sample] if given.sample else todo
    log = place / "results.jsonl"
    done = dict(json.loads(line) for line in log.read_text().splitlines()) if log.exists() else {}

    def attempt(mutant: Mutant) -> None:
        if mutant.name not in done:
            done[mutant.name] = killed(mutant, chosen(mutant))
            with log.open("a") as out:
                out.write(json.dumps([mutant.name, done[mutant.name]]) + "\n")
            print(f"{len(done):5d} {done[mutant.name]:12} {mutant.name}", flush=True)

    with ThreadPoolExecutor(given.workers) as pool:
        list(pool.map(attempt, todo))
    write(given.output, todo, done, everything, given.seed, stamp)


def constants(file: str) -> set[int]:
    """Lines of constants of a module: whatever uses them may see a change."""
    tree = ast.parse((KERNEL / file).read_text(encoding="utf-8"))
    return {top.lineno for top in tree.body if isinstance(top, ast.Assign)}


def write(path: Path, todo: list[Mutant], done: dict[str, str], everything: int, seed: int, stamp: str) -> None:
    """Shares by file, and the survivors by name."""
    before = json.loads(path.read_text()) if path.exists() else {}
    same = before.get("equivalent", {})  # judged by hand: name without the line's number -> reason
    rows = {}
    for file in sorted({m.file for m in todo}):
        mine = [m for m in todo if m.file == file and key(m.name) not in same]
        dead = sum(done[m.name] in ("killed", "timeout") for m in mine)
        rows[file] = {"mutants": len(mine), "killed": dead}
    total, dead = sum(r["mutants"] for r in rows.values()), sum(r["killed"] for r in rows.values())
    low, high = wilson(dead, total) if total else (0.0, 1.0)
    result = {
        "command": "python scripts/mutate.py", "seed": seed, "sources": stamp, "mutants in all": everything, "tried": len(todo),
        "share killed": round(dead / max(total, 1), 4), "95 %": [round(low, 4), round(high, 4)], "files": rows,
        "survivors": sorted(m.name for m in todo if done[m.name] not in ("killed", "timeout") and key(m.name) not in same),
        "equivalent": same,
    }  # fmt: skip
    path.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    print(json.dumps({k: result[k] for k in ("tried", "share killed", "95 %", "files")}, indent=1))


def key(name: str) -> str:
    """Name of a mutant that survives edits of other lines: file and change, with the text of its line."""
    place, what = name.split(" ", 1)
    file, line, _ = place.split(":")
    text = (KERNEL / file).read_text(encoding="utf-8").splitlines()[int(line) - 1].strip()
    return f"{file}: {text} [{what}]"


if __name__ == "__main__":
    main()
