"""Hashes of what the toolkit answers, so that a change of form can show that it changed nothing.

Usage: python scripts/golden.py -o BEFORE.json           before the change
       python scripts/golden.py --against BEFORE.json    after it: names each row that differs, exit code 1

Each row hashes statuses, iterations and q of one kind of call on one robot: solves with every solver and with options that change
what counts, batches, all solutions, paths and streams of a Tracker. Targets and starts come from fixed seeds. q is rounded to
1e-9 rad or m, because a kernel that is compiled again may differ by 1e-14. What is left depends on the processor and on the
versions of numba and numpy: compare on one machine only.
"""

import argparse
import hashlib
import itertools
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

import ik_toolkit as ik

ROBOTS = ("planar_2r", "hydrolek_7w", "inspection_7dof", "panda", "ur5", "brokk_hydrolek")
SOLVERS = ("lm", "dls", "pinv", "transpose", "newton", "ccd", "pid", "sqp", "state-space", "planar-2r", "inspection")
METHODS = ("cv", "ca", "av", "aa", "aad")
WISHES: dict[str, dict[str, Any]] = {  # options that change what counts, by the name of their row
    "mask": {"mask": [1, 1, 1, 1, 0, 0]},
    "slack": {"slack": [0.0, 0.0, 0.02, 0.1, 0.1, 0.1]},
    "free turn": {"free_turn": "z"},
    "closest": {"closest": True},
}
STREAMS = 3  # seeds of a Tracker's targets, for each method
SAMPLES = 400  # of one stream, 10 ms each


def load(name: str) -> Any:
    """One tip, or every tip where the robot has several."""
    return ik.Tree.load(name) if name == "brokk_hydrolek" else ik.Robot.load(name)


def pose_of(robot: Any, q: np.ndarray) -> Any:
    """Target that q reaches: a pose, or one a tip."""
    T = robot.fk(q)
    return {tip: x.homogeneous for tip, x in T.items()} if isinstance(T, dict) else T.homogeneous


class Row:
    """What one row hashes."""

    def __init__(self) -> None:
        self.sha = hashlib.sha256()
        self.counts: dict[str, int] = {}

    def add(self, q: Any, *words: Any) -> None:
        """Take in one answer; the first word is its status."""
        self.counts[str(words[0])] = self.counts.get(str(words[0]), 0) + 1
        self.sha.update(repr(words).encode() + (np.round(np.asarray(q, dtype=float), 9) + 0.0).tobytes())

    def solve(self, robot: Any, target: Any, *solver: str, **options: Any) -> None:
        """Solve and take in the answer, or the name of the error if the call is refused."""
        try:
            result = ik.solve(robot, target, *solver, **options)
        except ik.IKError as error:
            self.add([], type(error).__name__)
        else:
            self.add(result.q, result.status.name, result.iterations, result.attempt, result.message)

    def value(self) -> str:
        """Hash and counts of statuses."""
        counts = ", ".join(f"{n} {word}" for word, n in sorted(self.counts.items()))
        return f"{self.sha.hexdigest()[:16]}  {counts}"


def solves(robot: Any, count: int) -> Iterator[tuple[str, Row]]:
    """Solve poses and positions with each solver that takes the robot, from home and from a near start."""
    rng = np.random.default_rng(1)
    Q = robot.random_q(rng, count)
    for name in SOLVERS:
        row = Row()
        for i, q in enumerate(Q):
            near = np.clip(q + rng.uniform(-0.1, 0.1, robot.n), robot.lower, robot.upper) if i % 2 else None
            target = pose_of(robot, q)
            if i % 4 == 3 and not isinstance(target, dict):
                target = target[:3, 3]
            row.solve(robot, target, name, q0=near)
        yield f"solve {name}", row


def wishes(robot: Any, count: int) -> Iterator[tuple[str, Row]]:
    """Solve poses near home with each group of WISHES that the robot takes."""
    for name, options in WISHES.items():
        rng, row = np.random.default_rng(3), Row()
        for _ in range(count // 4):
            near = np.clip(robot.home + rng.uniform(-0.8, 0.8, robot.n), robot.lower, robot.upper)
            row.solve(robot, pose_of(robot, near), **options)
        yield f"solve, {name}", row


def batches(robot: Any, count: int) -> Iterator[tuple[str, Row]]:
    """A batch of reachable and pushed targets, and every solution of a few."""
    rng = np.random.default_rng(2)
    targets = [pose_of(robot, q) for q in robot.random_q(rng, 4 * count)]
    stacked: Any = (
        {tip: np.array([T[tip] for T in targets]) for tip in targets[0]} if isinstance(targets[0], dict) else targets
    )
    batch, row = ik.solve_batch(robot, stacked), Row()
    for status, q, iterations in zip(batch.status, batch.q, batch.iterations, strict=True):
        row.add(q, str(status), int(iterations))
    yield "solve_batch", row
    row = Row()
    for target in targets[: max(count // 20, 3)]:
        try:
            found = ik.solve_all(robot, target, starts=200)
        except ik.IKError as error:
            row.add([], type(error).__name__)
            continue
        row.add(found.q, f"{len(found.q)} solutions", found.complete)
    yield "solve_all", row


def motions(robot: Any, count: int) -> Iterator[tuple[str, Row]]:
    """Paths through poses of drawn motions, and streams of targets that jump, move and rest."""
    row = Row()
    for seed in range(max(count // 50, 2)):
        rng = np.random.default_rng(seed)
        ends = robot.random_q(rng, 3)
        way = np.vstack([np.linspace(a, b, 15) for a, b in itertools.pairwise(ends)])
        poses = [pose_of(robot, q) for q in way]
        stacked: Any = (
            {tip: np.array([T[tip] for T in poses]) for tip in poses[0]} if isinstance(poses[0], dict) else poses
        )
        path = ik.solve_path(robot, stacked)
        row.add(path.q, path.status.name, path.message)
    yield "solve_path", row
    for method in METHODS:
        row = Row()
        for seed in range(STREAMS):
            rng = np.random.default_rng(seed)
            tracker = ik.Tracker(robot, method, q0=robot.home)
            goal = robot.home
            for k in range(SAMPLES):
                if k % 100 == 0:
                    near = np.clip(robot.home + rng.uniform(-0.6, 0.6, robot.n), robot.lower, robot.upper)
                    first, goal = goal, near if k % 300 else robot.random_q(rng)
                x = min((k % 100) / 90.0, 1.0) if k % 300 else 1.0
                step = tracker.update(pose_of(robot, first + x * (goal - first)), dt=0.01)
                row.add(step.q, step.status.name)
        yield f"Tracker {method}", row


def main() -> None:
    """Compute every row; write or compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-n", "--count", type=int, default=200, help="targets a solver and robot (default 200)")
    parser.add_argument("-r", "--robots", nargs="+", default=list(ROBOTS))
    parser.add_argument("-o", "--output", type=Path, help="JSON to write")
    parser.add_argument("--against", type=Path, help="JSON written before, with the same --count and --robots")
    given = parser.parse_args()
    found: dict[str, str] = {}
    for name in given.robots:
        robot = load(name)
        for part in (solves, wishes, batches, motions):
            for what, row in part(robot, given.count):
                found[f"{name}: {what}"] = row.value()
                print(f"{name:16} {what:18} {row.value()}", flush=True)
    if given.output:
        given.output.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    if given.against:
        before = json.loads(given.against.read_text(encoding="utf-8"))
        differ = [key for key in before.keys() | found.keys() if before.get(key) != found.get(key)]
        for key in sorted(differ):
            print(f"differs: {key}\n  before {before.get(key)}\n  now    {found.get(key)}")
        print(f"{len(found) - len(differ)} of {len(found)} rows are equal")
        sys.exit(bool(differ))


if __name__ == "__main__":
    main()
