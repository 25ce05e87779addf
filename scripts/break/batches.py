"""Solve millions of batch targets and check every answer with a second FK (tests/second_fk.py).

Usage: python scripts/break/batches.py [--seed N] [--rows N]. Robots: the shipped ones, example-robot-data's arms where they
are installed, and random URDFs. Targets: poses and positions, most of them reachable, some made at joint limits, some out of
reach; as plain, float32, strided, transposed, read-only and Fortran arrays, and from iterators, one of which refills a
single buffer; with and without q0. Exit code 1 when a success is above its tolerance or an answer is outside the limits.
"""

import argparse
import collections
import faulthandler
import sys
import traceback
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import ik_toolkit as ik
from ik_toolkit.errors import IKError

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))
from robots import DATA_ARMS, SHIPPED, have_data
from second_fk import SecondFK, pose_errors, random_case

ROWS = 20_000  # per batch
RANDOM = 120  # random robots, about two for every three turns of known ones
TOLERANCE = 1e-6
ROUNDING = 1e-12  # of the robot's size [m], and [rad]: what two ways to compute a pose may differ by
LAYOUTS = ("plain", "float32", "strided", "transposed", "read-only", "fortran", "iterator", "one buffer")


class Subject(NamedTuple):
    """A robot under test and its judge."""

    name: str
    robot: ik.Robot
    judge: SecondFK


def subjects(seed: int) -> Iterator[Subject]:
    """Every robot once: known ones first."""
    for name, tip in [*((name, None) for name in SHIPPED), *(DATA_ARMS if have_data() else ())]:
        robot = ik.Robot.load(name, tip=tip)
        yield Subject(name, robot, SecondFK(robot.urdf, robot.base, robot.tip))
    for i in range(RANDOM):
        case = random_case(np.random.default_rng([seed, i]), most=12)
        try:
            robot = ik.Robot.load(case.text, base=case.base, tip=case.tip, locked=case.locked)
        except IKError:
            continue  # scripts/break/robots.py lists what is refused
        robot = robot if case.tool is None else robot.with_tool(case.tool)
        yield Subject(f"random {i}", robot, case.judge())


def legal(robot: ik.Robot, rng: np.random.Generator, count: int) -> np.ndarray:
    """Legal q (count, n), one value in ten at a limit; within half a turn, or one reach, where there is no limit."""
    far = np.where(np.array(robot.joint_kinds) == "prismatic", robot.reach, np.pi)
    low = np.where(np.isfinite(robot.lower), robot.lower, np.minimum(-far, robot.upper - far))
    high = np.where(np.isfinite(robot.upper), robot.upper, np.maximum(far, robot.lower + far))
    Q = (low + (high - low) * rng.random((count, robot.n))).clip(robot.lower, robot.upper)
    edge = np.where(rng.random(Q.shape) < 0.5, low, high)
    return np.where(rng.random(Q.shape) < 0.1, edge, Q)


def laid_out(T: np.ndarray, layout: str) -> tuple[Any, np.ndarray]:
    """Targets (N, ...) in one of the layouts, and their values in it."""
    if layout == "float32":
        given = T.astype(np.float32)
        return given, given.astype(float)
    if layout == "strided":
        wide = np.full((len(T), 2, *T.shape[1:]), np.nan)
        wide[:, 1] = T
        return wide[:, 1], T
    if layout == "transposed":  # the same numbers in another memory order
        return (np.ascontiguousarray(np.swapaxes(T, 1, 2)).swapaxes(1, 2), T) if T.ndim == 3 else (T, T)
    if layout == "read-only":
        given = T.copy()
        given.setflags(write=False)
        return given, T
    if layout == "fortran":
        return np.asfortranarray(T), T
    if layout == "iterator":
        return iter(np.array_split(T, 7)), T
    if layout == "one buffer":

        def refill() -> Iterator[np.ndarray]:
            buffer = np.empty((len(T) // 8 + 1, *T.shape[1:]))
            for start in range(0, len(T), len(buffer)):
                part = T[start : start + len(buffer)]
                buffer[: len(part)] = part
                yield buffer[: len(part)]

        return refill(), T
    return T, T


def rigid(T: np.ndarray) -> np.ndarray:
    """Poses with the nearest rotation, for which a pose of few digits is solved."""
    U, _, Vt = np.linalg.svd(T[:, :3, :3])
    T = T.copy()
    T[:, :3, :3] = U @ Vt
    return T


def attempt(subject: Subject, layout: str, rng: np.random.Generator, count: int) -> dict[str, int]:
    """Solve one batch of `count` targets; returns counts of rows."""
    robot, judge = subject.robot, subject.judge
    T = judge.fk(legal(robot, rng, count), robot.joint_names)
    far = rng.random(count) < 0.05
    T[far, :3, 3] += rng.normal(size=(int(far.sum()), 3)) * robot.reach
    positions = rng.random() < 0.3
    given, values = laid_out(np.ascontiguousarray(T[:, :3, 3]) if positions else T, layout)
    q0 = (None, robot.home, legal(robot, rng, count))[int(rng.choice([0, 0, 1, 2]))]
    if q0 is not None and q0.ndim == 2 and layout in ("iterator", "one buffer"):
        q0 = q0[0]
    tolerance = (
        TOLERANCE * min(max(robot.reach, 1e-9), 1.0) if robot.reach < 0.1 else TOLERANCE * max(1.0, robot.reach / 10.0)
    )
    batch = ik.solve_batch(robot, given, q0=q0, position_tolerance=tolerance, orientation_tolerance=TOLERANCE)
    if layout == "float32" and not positions:
        values = rigid(values)
    position, angle = pose_errors(judge.fk(batch.q, robot.joint_names), values)
    size = max(robot.reach, judge.largest_offset())
    above = (position > tolerance + ROUNDING * size) | (angle > TOLERANCE * (1.0 + 1e-9) + ROUNDING)
    outside = ((batch.q < robot.lower) | (batch.q > robot.upper)).any(axis=1) | judge.outside(
        batch.q, robot.joint_names
    )
    return {
        "rows": len(batch),
        "converged": int(batch.success.sum()),
        "above tolerance": int((batch.success & above).sum()),
        "outside limits": int(outside.sum()),
        "not finite": int((~np.isfinite(batch.q)).any(axis=1).sum()),
        "rows lost": abs(len(batch) - count),
    }


def main(seed: int, rows: int) -> int:
    """Solve `rows` targets; return the exit code."""
    total: collections.Counter[str] = collections.Counter()
    by_layout: dict[str, collections.Counter[str]] = {layout: collections.Counter() for layout in LAYOUTS}
    failed: list[str] = []
    everyone = list(subjects(seed))
    known = [subject for subject in everyone if not subject.name.startswith("random")]
    strange = [subject for subject in everyone if subject.name.startswith("random")]
    turn = 0
    while total["rows"] < rows:
        rng = np.random.default_rng([seed, 7, turn])
        pool = known if turn % 2 else strange
        subject, layout = pool[(turn // 2) % len(pool)], LAYOUTS[int(rng.integers(len(LAYOUTS)))]
        turn += 1
        try:
            found = attempt(subject, layout, rng, min(ROWS, rows - total["rows"]))
        except Exception:
            what = traceback.format_exc().strip().splitlines()[-1]
            failed.append(f"turn {turn - 1}, {subject.name}, {layout}: {what[:200]}")
            if len(failed) >= 50:
                break
            continue
        total.update(found)
        by_layout[layout].update(found)
        if found["above tolerance"] or found["outside limits"] or found["not finite"] or found["rows lost"]:
            failed.append(f"turn {turn - 1}, {subject.name}, {layout}: {found}")
    print(f"seed {seed}: {total['rows']:,} answers of {len(everyone)} robots in {turn} batches")
    print(f"{'':12}{'rows':>12}{'converged':>12}{'above':>8}{'outside':>9}")
    for name, found in {**by_layout, "all": total}.items():
        cells = (found["rows"], found["converged"], found["above tolerance"], found["outside limits"])
        print("{:12}{:>12,}{:>12,}{:>8,}{:>9,}".format(name, *cells))
    for what in failed[:30]:
        print(f"  {what}")
    print(f"batches that failed: {len(failed)}")
    return 1 if failed else 0


if __name__ == "__main__":
    faulthandler.enable()  # reports where the process crashed
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--rows", type=int, default=5_000_000)
    arguments = parser.parse_args()
    sys.exit(main(arguments.seed, arguments.rows))
