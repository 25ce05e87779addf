"""Shared parts of the claims: their registry, random configurations, and the count of lost targets."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

import ik_toolkit as ik


class Outcome(NamedTuple):
    """Result of a claim: cases tried, cases that contradict it, and a note on the worst of them."""

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


def uniform(robot: ik.Robot, count: int, rng: np.random.Generator) -> np.ndarray:
    """Legal configurations (count, n); continuous joints within half a turn."""
    low, high = np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi)
    return rng.uniform(low, high, (count, robot.n))


def lost(robot: ik.Robot, Q: np.ndarray, position: bool = False, move: Any = 0.0, **options: Any) -> Outcome:
    """Count the targets made from Q (N, n), shifted by `move` (N, 3) [m], that a batch fails to solve or solves outside limits."""
    T = robot.chain.forward(Q)[0]
    T[:, :3, 3] += move
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


def unit(rng: np.random.Generator) -> np.ndarray:
    """Random direction (3,)."""
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)
