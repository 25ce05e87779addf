"""A smooth joint curve through the rows of a path, with a proof of how far the tips leave the path between them.

The poses of a path are taken as samples of a motion. Between two poses a tip may leave the straight chord by the path
tolerance, or by 1.25 times the chord's sagitta: the height above the chord of an arc through the poses. A cubic spline goes
through the rows at the poses. Where it leaves a chord too far, solved rows on an arc through the poses are inserted.
Where that does not help, there is no smooth curve, and `timing` stops the motion at corners.
"""

import functools
import itertools
import math
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from ..errors import MissingExtra
from ..kernel.counted_error import KIND
from ..motion.reference import interpolate_poses
from ..robot.joints import Joints
from ..solvers.plan import Plan
from ..solvers.task import relatives
from .contact import find_contacts
from .continuity import bounds, settle_between
from .freedom import off_the_poses

ROUNDS = 12  # largest number of rounds of inserting rows; each halves the distance between the rows
LEAST = 1e-9  # neighbouring rows of a curve whose joints all differ by less are merged [rad or m]
# largest move of a joint between two points at which a spline is examined [rad, or length / reach]
FINE = 0.0125
FEWEST, MOST = 4, 64  # least and largest number of examined points between two rows
# A pose at which the path turns by more than this angle [rad] is a corner, not a sample of a smooth curve.
CORNER = math.radians(60.0)
# factor on the height of an arc over its chord (sagitta), because a spline leaves the chord further than an arc
ARC = 1.25


class Curve(NamedTuple):
    """A cubic spline of the joints over a path coordinate s, and what is proven about it.

    knots (M,): values of s; cubics (4, M-1, n): coefficients between two knots, in s - knot, highest power first; at (M,): position
    of each knot on the path (3.5: halfway from pose 3 to pose 4); deviation [m], turn [rad]: bounds on how far a tip's position and
    rotation leave the chords between the poses; clearance [m]: proven least distance of any two parts, infinite if collisions are
    not checked.
    """

    knots: np.ndarray
    cubics: np.ndarray
    at: np.ndarray
    deviation: float
    turn: float
    clearance: float


def smooth_curve(plan: Plan, result: Any, allowed: np.ndarray, run: slice) -> Curve | None:
    """Return a verified spline along a continuous piece of a path, or None if none was found.

    result: the PathResult; allowed (2, N-1): how far [m] and [rad] a tip may leave each chord between two poses; run:
    the rows of result.curve that make up the piece. The spline goes through the rows at the poses alone or, if that
    fails, through all rows.
    """
    curve, at = result.curve[run], result.at[run]
    ends = np.zeros(len(at), dtype=bool)
    ends[[0, -1]] = True
    arcs = Arcs(result.targets, result.kinds, allowed)
    for kept in ((at == np.round(at)) | ends, np.ones(len(at), dtype=bool)):
        found = _fitted(plan, result, arcs, curve[kept], at[kept])
        if found is not None or kept.all():
            return found
    return None


def _fitted(plan: Plan, result: Any, arcs: "Arcs", curve: np.ndarray, at: np.ndarray) -> Curve | None:
    """Fit a spline through rows of a curve, and insert rows until the spline is near enough to the chords and free of contact.

    curve (M, n) [rad or m]; at (M,): positions of its rows on the path; arcs: gives the poses for the inserted rows. Returns None
    if an inserted row cannot be solved, or ROUNDS do not suffice.
    """
    curve, at, since = _distinct(curve, at, np.append(at[0], at[:-1]))
    if len(curve) < 2:
        return None
    for _ in range(ROUNDS):
        made, broken = _judged(plan, result, arcs.allowed, curve, at)
        if not broken.any():
            return made
        near = np.flatnonzero(broken | np.append(broken[1:], False) | np.append(False, broken[:-1]))
        middle = 0.5 * (since[near + 1] + at[near + 1])
        rows, good = settle_between(plan, result.kinds, 0.5 * (curve[near] + curve[near + 1]), arcs(middle))
        if not good.all():
            return None
        since = np.insert(since, near + 1, since[near + 1])
        since[near + 1 + np.arange(1, len(near) + 1)] = middle
        curve, at, since = _distinct(np.insert(curve, near + 1, rows, axis=0), np.insert(at, near + 1, middle), since)
    return None


def _judged(
    plan: Plan, result: Any, allowed: np.ndarray, curve: np.ndarray, at: np.ndarray
) -> tuple[Curve, np.ndarray]:
    """Return the spline through the rows `curve` (M, n) [rad or m], and whether (M-1,) it is unacceptable between two rows.

    It is unacceptable where a tip leaves the chord by more than `allowed` (2, N-1) [m], [rad], or where the motion is not proven
    free of contact. at (M,): positions of the rows on the path.
    """
    robot = plan.robot
    knots = coordinate(curve, robot.chain.unit)
    parts, knots, cubics = _subdivided(curve / robot.chain.unit, knots, _cubics(robot, curve, knots))
    rows = np.vstack([cubics[3], curve[-1:]])
    places = _places(plan, result, rows, at, parts)
    sag = _sag(knots, cubics)
    left = off_the_poses(plan, result.kinds, rows, places, result.targets)
    off, turned = bounds(plan, result.kinds, rows, places, result.targets, sag, left)
    chord = np.minimum(places[:-1], places[1:]).astype(int).clip(0, allowed.shape[1] - 1)
    broken = (off > allowed[0][chord]) | (turned > allowed[1][chord])
    clearance = math.inf
    if result.collision is not None and not broken.any():
        clearance, contacts, unproven = find_contacts(
            result.collision, rows, np.arange(float(len(rows))), np.ones(len(rows) - 1, dtype=bool), sag
        )
        places_of = np.array([*(contact.place for contact in contacts), *unproven])
        broken[np.minimum(places_of.astype(int), len(broken) - 1)] = True
    made = Curve(knots, cubics, places, float(off.max()), float(turned.max()), clearance)
    return made, np.add.reduceat(broken, np.append(0, np.cumsum(parts)[:-1])) > 0


def _subdivided(curve: np.ndarray, knots: np.ndarray, cubics: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Divide the intervals of a spline so finely that no joint moves further than about FINE within a part.

    curve (M, n) [internal units]: the joint values at the knots. Returns the number of parts of each interval (M-1,), and the knots
    and cubics of the same spline over all parts.
    """
    steps = np.abs(np.diff(curve, axis=0)).max(axis=1) / FINE
    parts = np.clip(np.ceil(steps), FEWEST, MOST).astype(int)
    k = np.repeat(np.arange(len(parts)), parts)
    share = (np.arange(len(k)) - np.repeat(np.cumsum(parts) - parts, parts)) / parts[k]
    x = (share * np.diff(knots)[k])[:, None]
    a, b, c, d = cubics[:, k]
    moved = np.array([a, 3.0 * a * x + b, (3.0 * a * x + 2.0 * b) * x + c, ((a * x + b) * x + c) * x + d])
    return parts, np.append(knots[k] + x[:, 0], knots[-1]), moved


def _places(plan: Plan, result: Any, rows: np.ndarray, at: np.ndarray, parts: np.ndarray) -> np.ndarray:
    """Return the position on the path of each row of a spline: the point of the chord that is nearest the tips.

    rows (K, n) [rad or m]: the spline at the ends of all parts; at (M,): positions of the rows that were interpolated; parts
    (M-1,): number of parts between two of these. The result (K,) never decreases.
    """
    share = np.concatenate([np.arange(k) / k for k in parts] + [[1.0]])
    k = np.append(np.repeat(np.arange(len(parts)), parts), len(parts) - 1)
    ends = interpolate_poses(result.targets, at, result.kinds)[..., :3, 3]
    chords, counted = np.diff(ends, axis=0), [kind != KIND.free for kind in result.kinds]
    poses = plan.robot.chain.forward(rows)[0].reshape(len(rows), -1, 4, 4)
    away = []
    for f, other in enumerate(relatives(plan.robot, plan.options)):
        own = poses[:, f] if other < 0 else np.linalg.inv(poses[:, other]) @ poses[:, f]
        away.append(own[:, :3, 3])
    gone = (np.stack(away, axis=1) - ends[k])[:, counted]
    chords = chords[:, counted]
    square = (chords**2).sum(axis=(1, 2))[k]
    foot = np.divide((gone * chords[k]).sum(axis=(1, 2)), square, out=share.copy(), where=square > LEAST**2)
    made = at[k] + foot.clip(0.0, 1.0) * np.diff(at)[k]
    made[np.append(0, np.cumsum(parts))] = at
    return np.maximum.accumulate(made)


def corners(T: np.ndarray, kinds: tuple) -> np.ndarray:
    """Return whether (N,) the path of a tip turns by more than CORNER at each of the poses T (N, F, 4, 4); False at both ends."""
    found = np.zeros(len(T), dtype=bool)
    for f, kind in enumerate(kinds):
        chords = np.diff(T[:, f, :3, 3], axis=0)
        if kind != KIND.free and len(chords) > 1:
            across = np.linalg.norm(np.cross(chords[:-1], chords[1:]), axis=1)
            angle = np.arctan2(across, (chords[:-1] * chords[1:]).sum(axis=1))
            found[1:-1] |= angle > CORNER
    return found


def sagittas(T: np.ndarray, kinds: tuple) -> np.ndarray:
    """Return how far [m] and [rad] (2, N-1) a smooth curve through the poses T (N, F, 4, 4) leaves each chord.

    The result is ARC times the sagitta of an arc through the poses; an arc ends at a corner. kinds: the kind of each tip's target
    (pose, position, ...); tips whose kind is KIND.free are left out.
    """
    found, corner = np.zeros((2, len(T) - 1)), corners(T, kinds)
    for f, kind in enumerate(kinds):
        if kind == KIND.free or len(T) < 3:
            continue
        turns = np.zeros((len(T) - 1, 3))
        if kind != KIND.position:
            turns = np.array([pin.log3(a.T @ b) for a, b in zip(T[:-1, f, :3, :3], T[1:, f, :3, :3], strict=True)])
        for row, moves in zip(found, (np.diff(T[:, f, :3, 3], axis=0), turns), strict=True):
            bend = np.append(np.append(0.0, np.linalg.norm(np.diff(moves, axis=0), axis=1)), 0.0)
            bend[corner] = 0.0
            np.maximum(row, ARC * 0.125 * np.maximum(bend[:-1], bend[1:]), out=row)
    return found


class Arcs:
    """Interpolates between poses T (N, F, 4, 4) of a path by cubic splines from corner to corner.

    The interpolation is linear on a chord between two neighbouring corners, and on a chord that the tip may leave by less than an
    arc would (`allowed` (2, N-1) [m], [rad]).
    """

    def __init__(self, T: np.ndarray, kinds: tuple, allowed: np.ndarray) -> None:
        """Find the chords that the tips may leave as far as an arc does; the arguments are those of the class."""
        self.T, self.kinds, self.allowed = T, kinds, allowed
        self.wide = np.ones(allowed.shape[1], dtype=bool)
        if len(T) > 1:
            self.wide[:] = (allowed >= sagittas(T, kinds)).all(axis=0)

    @functools.cached_property
    def _splines(self) -> list[tuple[int, int, int, np.ndarray, Any, Any]]:
        """Return the splines of each tip, from every corner or end of the path to the next.

        Each entry is: the numbers a and b of the poses at the two corners, the tip's index, the tip's path length
        (b - a + 1,) [m] at these poses, and the splines of position and of rotation (None if only the position counts)
        over that length.
        """
        from scipy.interpolate import CubicSpline
        from scipy.spatial.transform import Rotation, RotationSpline

        made = []
        ends = np.unique([0, *np.flatnonzero(corners(self.T, self.kinds)).tolist(), len(self.T) - 1])
        for a, b in itertools.pairwise(ends.tolist()):
            for f, kind in enumerate(self.kinds) if b - a > 1 else ():
                if kind == KIND.free:
                    continue
                part = self.T[a : b + 1, f]
                way = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(part[:, :3, 3], axis=0), axis=1) + LEAST))
                places = CubicSpline(way, part[:, :3, 3], bc_type="not-a-knot" if b - a > 2 else "natural")
                turns = None if kind == KIND.position else RotationSpline(way, Rotation.from_matrix(part[:, :3, :3]))
                made.append((a, b, f, way, places, turns))
        return made

    def __call__(self, at: np.ndarray) -> np.ndarray:
        """Return the interpolated poses (M, F, 4, 4) at the positions `at` (M,) on the path (3.5: halfway from pose 3 to 4)."""
        made = interpolate_poses(self.T, at, self.kinds)
        wide = self.wide[at.astype(int).clip(0, len(self.wide) - 1)]
        for a, b, f, way, places, turns in self._splines if wide.any() else ():
            some = np.flatnonzero(wide & (at >= a) & (at <= b))
            if not len(some):
                continue
            u = np.interp(at[some], np.arange(a, b + 1), way)
            made[some, f, :3, 3] = places(u)
            if turns is not None:
                made[some, f, :3, :3] = turns(u).as_matrix()
        return made


def _distinct(curve: np.ndarray, at: np.ndarray, since: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Leave out the rows of a curve (M, n) that equal the row before.

    at (M,): positions of the rows on the path; since (M,): positions where the motion to each row begins. Both are returned, too.
    """
    moved = np.append(True, np.abs(np.diff(curve, axis=0)).max(axis=1) > LEAST)
    return curve[moved], at[moved], since[moved]


def coordinate(curve: np.ndarray, unit: np.ndarray) -> np.ndarray:
    """Return the length of a joint path up to each row of a curve (M, n) [rad or m], as (M,): the path coordinate of its spline.

    The length is measured in units of `unit` (n,): 1 rad, or for a prismatic joint a length [m].
    """
    return np.append(0.0, np.cumsum(np.linalg.norm(np.diff(curve / unit, axis=0), axis=1)))


def _cubics(robot: Joints, curve: np.ndarray, knots: np.ndarray) -> np.ndarray:
    """Return the coefficients (4, M-1, n) of the cubic spline through the rows of a curve (M, n) at knots (M,).

    Its end conditions are "not-a-knot", or natural for up to three rows. A joint that would overshoot its limits gets a
    monotone cubic (PCHIP), which stays between neighbouring rows.
    """
    try:
        from scipy.interpolate import CubicSpline, PchipInterpolator
    except ImportError:
        raise MissingExtra("scipy", "paths") from None
    cubics = CubicSpline(knots, curve, bc_type="not-a-knot" if len(curve) > 3 else "natural").c
    a, b, c, d = cubics
    with np.errstate(divide="ignore", invalid="ignore"):  # Extrema of a joint are the roots of 3 a x^2 + 2 b x + c.
        root = np.sqrt(b * b - 3.0 * a * c)
        turning = np.nan_to_num([(-b - root) / (3.0 * a), (-b + root) / (3.0 * a), -0.5 * c / b])
    x = np.where((turning > 0.0) & (turning < np.diff(knots)[:, None]), turning, 0.0)
    swing = ((a * x + b) * x + c) * x + d
    beyond = ((swing > robot.upper) | (swing < robot.lower)).any(axis=(0, 1))
    if beyond.any():
        cubics = np.where(beyond, PchipInterpolator(knots, curve).c, cubics)
    return cubics


def _sag(knots: np.ndarray, cubics: np.ndarray) -> np.ndarray:
    """Return an upper bound (M-1, n) on how far each joint of a spline leaves the straight line between two knots."""
    h = np.diff(knots)[:, None]
    bend = np.maximum(np.abs(2.0 * cubics[1]), np.abs(2.0 * cubics[1] + 6.0 * cubics[0] * h))
    return 0.125 * h * h * bend
