"""Last steps of a path search: solve every pose exactly, shorten the joint motion, verify it between the poses.

If a step between two poses fails the verification, the search looks for the best path without that step, and all is
repeated. `fraction` says how far along the path one motion leads if no path was found. `inserted` belongs to the beginning of a
search: it puts interpolated poses between poses that are far apart.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ..kernel.checks import CODE
from ..kernel.counted_error import KIND
from ..kernel.records import AT
from ..motion.reference import interpolate_poses
from ..robot.rotation import angles_between
from .certificate import Continuity
from .continuity import check, densify
from .freedom import freedom
from .path_problem import STEP, Problem
from .path_search import Found, Search
from .result import pieces
from .smoothing import smooth_rows

TRIES = 12  # largest number of paths verified; each excludes the steps that failed in earlier ones
HELD = 2  # where the shortened motion fails the verification, this many poses on either side keep their joint values
ROUNDING = 1e-9  # share of max_step by which rounding may let a step exceed it
SHORTENED = 3  # largest number of attempts to shorten a path; each attempt keeps more poses unchanged


class Terms(NamedTuple):
    """What the motion along a path must keep."""

    step: tuple[float, float]  # largest joint step between rows [rad], [m]
    tolerance: tuple[float, float]  # largest deviation of a tip from the interpolated poses [m], [rad]
    given: bool  # whether the caller gave this tolerance
    allowed: float  # largest number of reconfigurations


class ProvenMotion(NamedTuple):
    """A path found, the joint motion through its poses, and what is proven about that motion.

    found: the path as the search found it; q (N, n) [rad or m]: a solution of each pose, NaN where there is none; curve (M, n): q
    and the rows inserted between; at (M,): position of each row on the path (3.5: halfway from pose 3 to pose 4); continuity: what
    is proven.
    """

    found: Found
    q: np.ndarray
    curve: np.ndarray
    at: np.ndarray
    continuity: Continuity
    leaps: list[float]  # positions on the path after which a step or the tip's deviation is too large

    @property
    def failures(self) -> list[float]:
        """Return the positions on the path where the motion is discontinuous or not proven free of contact."""
        return [*self.leaps, *(one.place for one in self.continuity.contacts), *self.continuity.unproven]


def exact(problem: Problem, q: np.ndarray) -> np.ndarray:
    """Correct configurations q (N, n) [rad, or length / reach] onto their poses; return them [rad or m]. NaN stays NaN."""
    there = np.flatnonzero(np.isfinite(q).all(axis=1))
    made = q.copy()
    # The search stores configurations in single precision, so the exact values of held joints are restored here.
    made[np.ix_(there, problem.plan.held)] = problem.stand[problem.plan.held]
    made[there] = np.clip(made[there], *problem.limits[:2])
    rows, good = problem.settled(made[there], there)
    # Where Newton's steps fail, at a singular pose, the row that the search found is on its pose already.
    made[there[good]] = rows[good]
    return made * problem.unit


def proven(search: Search, found: Found, q: np.ndarray, terms: Terms) -> ProvenMotion:
    """Insert rows where needed between the configurations q (N, n) [rad or m] of a path, and verify the motion.

    found: the path as the search found it. Returns the rows, the motion between them, and what is proven.
    """
    p, step, tolerance = search.problem, terms.step, terms.tolerance
    q = p.inside(q)
    curve, at, cut = densify(p.single, p.kinds, q, p.poses, found.breaks, step, tolerance)
    curve = p.inside(curve)
    proof = check(p.single, p.kinds, curve, at, p.poses, cut, search.model)
    longest = np.where(p.robot.slides, step[1], step[0]) * (1.0 + ROUNDING)
    deviation, turn = proof.judged
    leaps = (deviation > tolerance[0]) | (turn > tolerance[1])
    leaps |= ~cut & (np.abs(np.diff(curve, axis=0)) > longest).any(axis=1)
    return ProvenMotion(found, q, curve, at, proof, at[:-1][leaps].tolist())


def shorten_pieces(
    search: Search, found: Found, q: np.ndarray, held: np.ndarray, step: tuple[float, float]
) -> np.ndarray:
    """Shorten and smooth each continuous piece of a motion q (N, n) [rad or m] through poses, free of contact at the poses.

    held (N,): poses whose rows do not change; step (rad, m): largest joint step.
    """
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


def finished(search: Search, terms: Terms, refine: bool) -> ProvenMotion:
    """Return the best path of a search that passes the verification, or else the best one with breaks where it fails.

    refine: whether to shorten the motion of a redundant robot.
    """
    p, allowed = search.problem, terms.allowed
    for _ in range(TRIES):
        found = search.found if len(search.found.breaks) <= allowed else search.best(allowed)
        q = exact(p, found.q)
        if refine and p.redundant:
            held = np.zeros(len(q), dtype=bool)
            for _ in range(SHORTENED):
                motion = proven(search, found, shorten_pieces(search, found, q, held, terms.step), terms)
                failed = motion.failures
                if not failed:
                    return motion
                for place in failed:
                    held[max(int(place) - HELD, 0) : int(place) + HELD + 2] = True
        motion = proven(search, found, q, terms)
        failed = sorted({int(place) for place in motion.failures})
        if found.contacts or not search.without(found, failed):
            break
    if not motion.leaps:
        return motion
    breaks = sorted({*found.breaks, *(int(place) for place in motion.leaps)})
    if len(breaks) > allowed:
        q[breaks[int(allowed)] + 1 :] = np.nan
        breaks = breaks[: int(allowed)]
    return proven(search, found._replace(breaks=breaks), q, terms)


STEPS = 40  # largest number of Gauss-Newton steps; ten usually suffice
# The cost of a joint step is quadratic below this share of the mean step, else linear, so that joints do not stop and start again.
QUADRATIC_BELOW = 0.5
# Weight of the squared second differences of a path against its joint steps; its square root is the number of poses over which a
# corner is rounded off.
SMOOTHNESS = 10.0
ROUNDS = 6  # largest number of rounds of smoothing; each leaves the rows near contacts of earlier rounds unsmoothed
WINDOW = 4  # number of poses kept unchanged on either side of a pose in contact, doubled in each further round


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

    max_step (rad, m): no step becomes longer than this, or than q's longest step if that is larger. fixed (N,): poses whose rows
    stay. bad: a function of a motion (N, n) that returns the indices of the poses where it is not acceptable, such as those in
    contact; these and their neighbours keep their values in q, and the rest is smoothed again. Returns q itself if nothing better
    is found.
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


# Largest spacing of poses in the search [share of the reach], [rad], so that joints mostly move less than max_step.
FAR = (0.015, np.radians(3.0))
MOST = 1000  # largest number of inserted poses, to bound the search's time; longer paths get a wider spacing
WIDER = 1.5  # factor by which the spacing of poses is raised until at most MOST are inserted


def inserted(robot: Any, T: np.ndarray, kinds: tuple) -> tuple[np.ndarray, np.ndarray]:
    """Insert interpolated poses between poses T (N, F, 4, 4) that are farther apart than FAR.

    kinds: the kind of each tip's target (pose, position, ...). Returns all poses (M, F, 4, 4) and their positions on the path (M,)
    (3.5: halfway from pose 3 to pose 4).
    """
    gaps = np.zeros(len(T) - 1)
    for f, (arm, kind) in enumerate(zip(robot.arms, kinds, strict=True)):
        if kind == KIND.free:
            continue
        away = np.linalg.norm(np.diff(T[:, f, :3, 3], axis=0), axis=1) / (FAR[0] * arm.chain.reach)
        gaps = np.maximum(gaps, away)
        if kind != KIND.position:
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
    """Return after which of the requested poses a path breaks, each index once, from its breaks among all poses.

    breaks: indices of the poses, inserted ones included, after which it breaks; at (M,): positions of all poses on the path through
    the requested ones.
    """
    return sorted({int(at[k]) for k in breaks})


def collapsed(motion: ProvenMotion, at: np.ndarray) -> ProvenMotion:
    """Drop inserted poses from a motion through M poses, at positions `at` (M,) on the path through the requested ones.

    Inserted poses become rows of the curve only. A motion that breaks between two requested poses stops at the first and continues
    at the second.
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
        np.where(next_to, proof.lacking[:, kept[:-1]], 0.0),
        proof.clearance,
        tuple(one._replace(place=x) for one in proof.contacts for x in where([one.place])),
        tuple(where(proof.unproven)),
    )
    found = found._replace(q=found.q[asked], tracks=found.tracks[asked], breaks=sorted(broken))
    return ProvenMotion(found, q, motion.curve[kept], places[kept], proof, where(motion.leaps))


# ---------------------------------------------------------------------------------- how far one motion follows the path
PARTS = 400  # Number of steps in which a path is followed to see how far one motion leads: each is 1/400 of its length.
HALVINGS = 5  # number of step lengths tried, each half the one before, so that the end is found to 1/16 of the first
POSTURES = 16  # largest number of configurations at the first pose from which the path is followed


def lengths(poses: np.ndarray, kinds: tuple) -> np.ndarray:
    """Return the share (N,) of the path's length up to each of the poses (N, F, 4, 4), from 0 to 1.

    The length is the sum of the tips' travel, without tips whose kind in `kinds` is KIND.free. If no position changes, it is
    the sum of the rotation angles of all tips.
    """
    moves = np.linalg.norm(np.diff(poses[..., :3, 3], axis=0), axis=2)
    moves[:, [kind == KIND.free for kind in kinds]] = 0.0
    if not moves.any():
        pairs = poses[:-1, :, :3, :3].reshape(-1, 3, 3), poses[1:, :, :3, :3].reshape(-1, 3, 3)
        moves = angles_between(*pairs).reshape(moves.shape)
    way = np.append(0.0, np.cumsum(moves.sum(axis=1)))
    return way / way[-1] if way[-1] > 0.0 else np.linspace(0.0, 1.0, len(way))


def fraction(search: Search, motion: ProvenMotion) -> float:
    """Return the share (0 to 1, to better than 0.1 %) of the path's length that one motion follows from the start.

    A motion ends at its first jump, contact or pose out of reach. From there the given motion is continued step by step.
    If no start q0 is fixed, motions from other configurations at the first pose are tried as well. The result is a lower
    bound: another posture of a redundant arm may go further.
    """
    p = search.problem
    way, at = lengths(p.poses, p.kinds), p.at
    touched = min((one.place for one in motion.continuity.contacts), default=np.inf)
    runs = pieces(motion.curve, motion.at, motion.found.breaks)
    rows = int((motion.at[runs[0]] < touched).sum()) if runs and runs[0].start == 0 else 0
    if rows == len(motion.curve):
        return 1.0
    reached = float(np.interp(motion.at[rows - 1], at, way)) if rows else 0.0
    # The search does not bound the joint steps of an arm with too few joints, so the default largest step is used here.
    most = (
        np.minimum(p.most, np.where(p.robot.slides, STEP[1], STEP[0]) / p.unit)
        if freedom(p.single, p.kinds).lacks
        else p.most
    )

    def follow(q: np.ndarray, begin: float) -> float:
        """Return the share of the path's length reached from q (n,) [rad or m], a solution at the share `begin`."""

        def step(s: float) -> np.ndarray | None:
            T = interpolate_poses(p.poses, np.array([np.interp(s, way, np.arange(len(way)))]), p.kinds)
            row = p.follower.solve(T.reshape(-1, *p.robot.pose_shape), p.kinds, q[None], True)
            new = row[p.follower.q_columns].copy()
            near = (np.abs(new - q) <= most * p.unit).all()
            free = search.collides is None or not search.collides(new)
            return new if row[AT.status] == CODE.converged and near and free else None

        done, part = begin, 1.0 / PARTS
        for _ in range(HALVINGS):
            while done < 1.0 and (new := step(min(done + part, 1.0))) is not None:
                q, done = new, min(done + part, 1.0)
            part *= 0.5
        return done

    found = [reached]
    if rows:
        found.append(follow(motion.curve[rows - 1], reached))
    if not search.fixed[0]:
        found += [follow(q * p.unit, 0.0) for q in search.tracks.at(0)[:POSTURES]]
    return max(found)
