"""Last steps of a path: exact rows, shortened pieces, verification between poses; repeated without the steps that fail."""

from typing import Any, NamedTuple

import numpy as np

from .continuity import check, densify
from .problem import Problem
from .proof import Continuity
from .refine import smooth
from .result import pieces
from .search import Found, Search

TRIES = 12  # runs of the program, each without further steps that are discontinuous or touch
HELD = 2  # poses kept unchanged on either side of a place where the shortened motion fails
ROUNDING = 1e-9  # share by which a step may exceed its limit
SHORTENED = 3  # attempts to shorten a motion, with more poses held each time


class Motion(NamedTuple):
    """A finished path: rows q (N, n) [rad or m], the curve through them, and what is proven about it."""

    found: Found
    q: np.ndarray
    curve: np.ndarray
    at: np.ndarray
    continuity: Continuity
    leaps: list[float]  # places among the poses where the motion is not continuous

    @property
    def failures(self) -> list[float]:
        """Places among the poses where the motion is discontinuous, touches, or comes too near to tell."""
        return [*self.leaps, *(one.place for one in self.continuity.contacts), *self.continuity.unproven]


def exact(problem: Problem, q: np.ndarray) -> np.ndarray:
    """Move rows (N, n), in kernel units, inside the tolerances of their poses; returns them in the robot's units."""
    there = np.flatnonzero(np.isfinite(q).all(axis=1))
    made = q.copy()
    made[np.ix_(there, problem.plan.held)] = problem.stand[problem.plan.held]  # tracks are stored in single precision
    made[there] = problem.settled(np.clip(made[there], *problem.limits[:2]), there)[0]
    return made * problem.unit


def proven(
    search: Search, found: Found, q: np.ndarray, step: tuple[float, float], tolerance: tuple[float, float], model: Any
) -> Motion:
    """The verified motion through rows q (N, n), with poses inserted where needed."""
    p = search.problem
    q = p.inside(q)
    curve, at, cut = densify(p.single, p.kinds, q, p.poses, found.breaks, step, tolerance)
    curve = p.inside(curve)
    proof = check(p.single, p.kinds, curve, at, p.poses, cut, model)
    longest = np.where(p.robot.slides, step[1], step[0]) * (1.0 + ROUNDING)
    deviation, turn = proof.judged
    leaps = (deviation > tolerance[0]) | (turn > tolerance[1])
    leaps |= ~cut & (np.abs(np.diff(curve, axis=0)) > longest).any(axis=1)
    return Motion(found, q, curve, at, proof, at[:-1][leaps].tolist())


def shortened(search: Search, found: Found, q: np.ndarray, held: np.ndarray, step: tuple[float, float]) -> np.ndarray:
    """Shorten each continuous piece of q (N, n) without contact; held (N,): poses whose rows stay."""
    p, made = search.problem, q.copy()
    fixed = held.copy()
    fixed[0] |= search.fixed[0]
    fixed[-1] |= search.fixed[1]

    def touching(rows: np.ndarray) -> list[int]:
        return [t for t, x in enumerate(rows) if search.collides(x)]

    for piece in pieces(q, np.arange(len(q)), found.breaks):
        rows = (p.single, p.kinds, q[piece], p.poses[piece], step, fixed[piece])
        made[piece] = smooth(*rows, None if search.collides is None else touching)
    return made


def finished(
    search: Search, step: tuple[float, float], tolerance: tuple[float, float], model: Any, allowed: float, refine: bool
) -> Motion:
    """The best path of a search as a motion, proven as far as possible."""
    p = search.problem
    for _ in range(TRIES):
        found = search.found if len(search.found.breaks) <= allowed else search.best(allowed)
        q = exact(p, found.q)
        if refine and p.redundant:
            held = np.zeros(len(q), dtype=bool)
            for _ in range(SHORTENED):
                motion = proven(search, found, shortened(search, found, q, held, step), step, tolerance, model)
                failed = motion.failures
                if not failed:
                    return motion
                for place in failed:
                    held[max(int(place) - HELD, 0) : int(place) + HELD + 2] = True
        motion = proven(search, found, q, step, tolerance, model)
        failed = sorted({int(place) for place in motion.failures})
        if found.contacts or not search.without(found, failed):
            break
    if not motion.leaps:
        return motion
    breaks = sorted({*found.breaks, *(int(place) for place in motion.leaps)})
    if len(breaks) > allowed:
        q[breaks[int(allowed)] + 1 :] = np.nan
        breaks = breaks[: int(allowed)]
    return proven(search, found._replace(breaks=breaks), q, step, tolerance, model)
