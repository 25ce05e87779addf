"""Try what the documentation promises on many random cases, with any seed; exit code 1 when a promise does not hold.

Usage: python scripts/claims.py [--seed N] [--count N] [--only NAME ...]. Each claim draws its own cases: targets are made
from legal configurations, so an answer exists. --count is the number of cases of a claim; slow claims take a share of it.
"""

import argparse
import sys
from collections.abc import Callable
from time import perf_counter
from typing import NamedTuple

import numpy as np
import pinocchio as pin

import ik_toolkit as ik


class Outcome(NamedTuple):
    """What a claim found: cases tried, those that contradict it, and words on the worst of them."""

    cases: int
    broken: int
    words: str = ""


CLAIMS: dict[str, Callable[[int, int], Outcome]] = {}


def claim(name: str) -> Callable:
    """Register the decorated function (count, seed) -> Outcome; its docstring is the promise."""

    def add(function: Callable[[int, int], Outcome]) -> Callable:
        CLAIMS[name] = function
        return function

    return add


# ---------------------------------------------------------------------------------------------------------- closed forms
def uniform(robot: ik.Robot, count: int, rng: np.random.Generator) -> np.ndarray:
    """Legal configurations (count, n); endless joints within half a turn."""
    low, high = np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi)
    return rng.uniform(low, high, (count, robot.n))


def lost(robot: ik.Robot, Q: np.ndarray, position: bool = False, **options) -> Outcome:
    """Count the targets made from Q (N, n) that a batch does not solve, or solves outside the limits."""
    T = robot.chain.forward(Q)[0]
    batch = ik.solve_batch(robot, T[:, :3, 3] if position else T, **options)
    bad = ~batch.success | (batch.q < robot.lower).any(axis=1) | (batch.q > robot.upper).any(axis=1)
    words = f"first: q={Q[np.argmax(bad)].tolist()}, {ik.Status(int(batch.status[np.argmax(bad)])).name}"
    return Outcome(len(Q), int(bad.sum()), words if bad.any() else "")


def inspection(lift: float | None = None) -> ik.Robot:
    """The inspection robot, with its lift free or locked."""
    return ik.Robot.load("inspection_7dof", locked=None if lift is None else {"lift": lift})


def together(*outcomes: Outcome) -> Outcome:
    """Sum of several outcomes."""
    words = "; ".join(o.words for o in outcomes if o.words)
    return Outcome(sum(o.cases for o in outcomes), sum(o.broken for o in outcomes), words)


def drawn(robot: ik.Robot, count: int, rng: np.random.Generator, **values: float) -> np.ndarray:
    """Legal configurations with some joints at given values."""
    Q = uniform(robot, count, rng)
    for name, value in values.items():
        Q[:, robot.joint_names.index(name)] = value
    return Q


SHOULDER, ELBOW = "arm_pitch", "elbow_pitch"


@claim("level-arms")
def level_arms(count: int, seed: int) -> Outcome:
    """No target of a legal configuration with a level arm (one angle is free there) is lost, lift free or locked."""
    rng = np.random.default_rng(seed)
    return together(
        *(
            lost(robot, drawn(robot, count // 2, rng, **{SHOULDER: 0.0}))
            for robot in (inspection(), inspection(float(rng.uniform(0.05, 0.4))))
        )
    )


@claim("straight-elbows")
def straight_elbows(count: int, seed: int) -> Outcome:
    """No target of a legal configuration with a straight elbow is lost, with the arm level too, lift free or locked."""
    rng = np.random.default_rng(seed)
    robots = (inspection(), inspection(float(rng.uniform(0.05, 0.4))))
    cases = ({ELBOW: 0.0}, {ELBOW: 0.0, SHOULDER: 0.0})
    return together(*(lost(robot, drawn(robot, count // 4, rng, **at)) for robot in robots for at in cases))


@claim("limit-corners")
def limit_corners(count: int, seed: int) -> Outcome:
    """No target of a configuration with 2 to 5 joints at their limits is lost, lift free or locked."""
    rng = np.random.default_rng(seed)
    outcomes = []
    for robot in (inspection(), inspection(float(rng.uniform(0.05, 0.4)))):
        Q = uniform(robot, count // 2, rng)
        ends = np.where(rng.random(Q.shape) < 0.5, robot.lower, robot.upper)
        rank = np.argsort(rng.random(Q.shape), axis=1)
        Q = np.where(rank < rng.integers(2, 6, (len(Q), 1)), ends, Q)
        outcomes.append(lost(robot, Q))
    return together(*outcomes)


# ----------------------------------------------------------------------------------------------------------------- loops
LOOP_ROBOTS = ("hydrolek_7w", "inspection_7dof", "panda", "ur5", "xarm7", "kinova")


@claim("loops")
def loops(count: int, seed: int) -> Outcome:
    """A loop that moves the target by 1 mrad or 1 mm a call: no joint jumps with follow, and without it no jump is silent."""
    rng = np.random.default_rng(seed)
    calls, broken, words = 0, 0, ""
    while calls < count:
        robot = ik.Robot.load(LOOP_ROBOTS[int(rng.integers(len(LOOP_ROBOTS)))])
        following, plain = ik.Solver(robot, follow=True), ik.Solver(robot, "lm")
        q = uniform(robot, 1, rng)[0]
        T = robot.fk(q)
        step = pin.exp6(
            np.concatenate([1e-3 * unit(rng), np.zeros(3)] if rng.random() < 0.5 else [np.zeros(3), 1e-3 * unit(rng)])
        )
        size = np.where(np.array(robot.joint_kinds) == "prismatic", robot.reach, 1.0)
        for _ in range(min(1000, count)):
            T = T * step
            calls += 1
            near, free = following(T.homogeneous, q0=q), plain(T.homogeneous, q0=q)
            far = (np.abs(near.q - q) / size).max() > 0.5
            silent = (np.abs(free.q - q) / size).max() > 0.5 and free.attempt > 0 and not free.notice
            position, orientation = robot.errors(near.q, T.homogeneous)
            false = near.success and max(position, orientation) > 1e-6
            if far or silent or false:
                broken, words = broken + 1, f"{robot.name} from q={q.tolist()}: {near.status.name}, {free.notice!r}"
            if not near.success:
                break
            q = near.q
    return Outcome(calls, broken, words)


def unit(rng: np.random.Generator) -> np.ndarray:
    """Random direction (3,)."""
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)


def main() -> None:
    """Run the claims asked for and print a line each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--count", type=int, default=100_000)
    parser.add_argument("--only", nargs="+", choices=sorted(CLAIMS), metavar="NAME", default=list(CLAIMS))
    given = parser.parse_args()
    failed = 0
    for name in given.only:
        began = perf_counter()
        outcome = CLAIMS[name](given.count, given.seed)
        failed += outcome.broken > 0
        verdict = "holds" if outcome.broken == 0 else f"BROKEN in {outcome.broken}"
        print(
            f"{name:20} {verdict:18} {outcome.cases:9} cases  {perf_counter() - began:6.1f} s  {outcome.words}",
            flush=True,
        )
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
