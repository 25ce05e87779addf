"""Last steps of a path: exact rows, shortened pieces, verification between poses; repeated without the steps that fail.

`smooth` shortens one continuous piece, keeping its poses, its limits and clear of contact. `inserted` puts others between poses far
apart, so that a path is searched along the way and not only at its corners.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ..kernel.counted_error import FREE, POSITION
from ..robot.rotation import angles_between
from .certificate import Continuity
from .continuity import check, densify
from .interpolate import interpolate_poses
from .path_problem import Problem
from .path_search import Found, Search
from .result import pieces
from .smoothing import smooth_rows

TRIES = 12  # runs of the program, each without further steps that are discontinuous or touch
HELD = 2  # poses kept unchanged on either side of a place where the shortened motion fails
ROUNDING = 1e-9  # share by which a step may exceed its limit
SHORTENED = 3  # attempts to shorten a motion, with more poses held each time


class ProvenMotion(NamedTuple):
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
) -> ProvenMotion:
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
    return ProvenMotion(found, q, curve, at, proof, at[:-1][leaps].tolist())


def shorten_pieces(
    search: Search, found: Found, q: np.ndarray, held: np.ndarray, step: tuple[float, float]
) -> np.ndarray:
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
) -> ProvenMotion:
    """The best path of a search as a motion, proven as far as possible."""
    p = search.problem
    for _ in range(TRIES):
        found = search.found if len(search.found.breaks) <= allowed else search.best(allowed)
        q = exact(p, found.q)
        if refine and p.redundant:
            held = np.zeros(len(q), dtype=bool)
            for _ in range(SHORTENED):
                motion = proven(search, found, shorten_pieces(search, found, q, held, step), step, tolerance, model)
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


STEPS = 40  # most Gauss-Newton steps; ten usually suffice
QUADRATIC_BELOW = (
    0.5  # share of the mean step below which a step's cost is quadratic, so that joints do not stop and start
)
SMOOTHNESS = 10.0  # weight of second differences against steps: corners are rounded over its root, some three poses
ROUNDS = 6  # rounds of refinement, each with more poses held where it touched
WINDOW = 4  # poses held on either side of one that touches; doubled in each further round


def smooth(
    plan: Any,
    kinds: tuple,
    q: np.ndarray,
    T: np.ndarray,
    max_step: tuple[float, float],
    fixed: np.ndarray | None = None,
    bad: Callable[[np.ndarray], Any] | None = None,
) -> np.ndarray:
    """Shorten and smooth a motion q (N, n) [rad or m] through poses T (N, F, 4, 4), staying inside the tolerances.

    max_step (rad, m): no step grows beyond it (or beyond the longest in q). fixed (N,): poses whose joints stay. bad: function of
    a motion (N, n) that returns the poses where it is not acceptable, such as those that touch; these are held at q, and the rest
    is refined again. Returns q itself if nothing better is found.
    """
    robot = plan.robot
    held = np.zeros(len(q), dtype=bool) if fixed is None else np.array(fixed, dtype=bool)
    moves = np.abs(np.diff(q / robot.chain.unit, axis=0))
    if len(q) < 3 or held.all() or not moves.any():
        return q
    mean = float(moves.mean())
    cost = (1.0, SMOOTHNESS / mean, QUADRATIC_BELOW * mean)
    step = np.where(robot.slides, max_step[1], max_step[0])
    window = WINDOW
    for _ in range(ROUNDS):
        made, good = q.copy(), np.zeros(len(q), dtype=bool)
        arrays = (T.reshape(-1, *robot.pose_shape), made, held, plan.orders(kinds, True))
        taken, _, _ = smooth_rows(*plan.chain[:2], *arrays, *cost, step, STEPS, good)
        if not taken or not good.all():
            return q
        worst = np.asarray(() if bad is None else bad(made), dtype=int)
        if not len(worst):
            return made
        for k in worst:
            held[max(k - window, 0) : k + window + 1] = True
        if held.all():
            break
        window *= 2
    return q


FAR = (0.015, np.radians(3.0))  # [fraction of the reach], [rad] between poses: joints then mostly stay within max_step
MOST = 1000  # most inserted poses, a second's work; a path that needs more gets wider spacing
WIDER = 1.5  # factor on the spacing until they are few enough


def inserted(robot: Any, T: np.ndarray, kinds: tuple) -> tuple[np.ndarray, np.ndarray]:
    """Poses T (N, F, 4, 4) with others inserted (M, F, 4, 4), and the place of each (3.5: halfway from 3 to 4)."""
    gaps = np.zeros(len(T) - 1)
    for f, (arm, kind) in enumerate(zip(robot.arms, kinds, strict=True)):
        if kind == FREE:
            continue
        away = np.linalg.norm(np.diff(T[:, f, :3, 3], axis=0), axis=1) / (FAR[0] * arm.chain.reach)
        gaps = np.maximum(gaps, away)
        if kind != POSITION:
            gaps = np.maximum(gaps, angles_between(T[1:, f, :3, :3], T[:-1, f, :3, :3]) / FAR[1])
    pieces = np.maximum(np.ceil(gaps), 1.0)
    while pieces.sum() - len(gaps) > MOST:
        gaps /= WIDER
        pieces = np.maximum(np.ceil(gaps), 1.0)
    if (pieces == 1.0).all():
        return T, np.arange(float(len(T)))
    inner = [k + np.arange(count) / count for k, count in enumerate(pieces.tolist())]
    at = np.append(np.concatenate(inner), len(T) - 1.0)
    return interpolate_poses(T, at, kinds), at


def gaps(at: np.ndarray, breaks: list[int]) -> list[int]:
    """Requested poses after which a path breaks; breaks: the same among all poses, whose places are `at` (M,)."""
    return sorted({int(at[k]) for k in breaks})


def collapsed(motion: ProvenMotion, at: np.ndarray) -> ProvenMotion:
    """Turn a motion through poses at places `at` (M,) into one through the requested poses; inserted ones become knots.

    If it breaks between two requested poses, it stops at the first and continues at the second.
    """
    asked = np.flatnonzero(at == np.round(at))
    if len(asked) == len(at):
        return motion
    q = motion.q[asked]
    whole = np.asarray(np.isfinite(q).all(axis=1))
    missing = np.floor(at[~np.isfinite(motion.q).all(axis=1)]).astype(int)
    broken = {*gaps(at, motion.found.breaks), *(k for k in missing.tolist() if whole[k : k + 2].sum() == 2)}
    places = np.interp(motion.at, np.arange(len(at)), at)
    inside = np.isin(np.floor(places), list(broken)) & (places != np.round(places))
    inside |= ~np.isfinite(motion.curve).all(axis=1) & (places != np.round(places))
    kept = np.flatnonzero(~inside)
    next_to = np.diff(kept) == 1
    found, proof = motion.found, motion.continuity

    def where(places: Any) -> list[float]:
        moved = np.interp(places, np.arange(len(at)), at)
        return [x for x in moved.tolist() if int(x) not in broken or x == int(x)]

    proof = Continuity(
        np.where(next_to, proof.deviation[kept[:-1]], np.nan),
        np.where(next_to, proof.turn[kept[:-1]], np.nan),
        proof.clearance,
        tuple(one._replace(place=x) for one in proof.contacts for x in where([one.place])),
        tuple(where(proof.unproven)),
        None if proof.lacking is None else np.where(next_to, proof.lacking[:, kept[:-1]], 0.0),
    )
    found = found._replace(q=found.q[asked], tracks=found.tracks[asked], breaks=sorted(broken))
    return ProvenMotion(found, q, motion.curve[kept], places[kept], proof, where(motion.leaps))
