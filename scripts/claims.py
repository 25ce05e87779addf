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
