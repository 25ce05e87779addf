"""Bounds on how far a tip leaves the interpolated poses between rows, and the insertion of rows to lower them.

Let the joints move linearly from one row of a curve to the next by dq. Then the tip's position p has the second
derivative p'' = sum_ij dq_i dq_j d2p/dq_i dq_j, where each d2p/dq_i dq_j is at most the distance of the tip from the
axis of the joint nearer the tip. A curve with |p''| <= c over a unit interval leaves its chord by at most c / 8. For a
rotation and its geodesic the bound is similar: the distances are replaced by 1, and a factor allows for the curvature of
the rotation group.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from ..errors import InvalidOption
from ..kernel.chain import joint_levers
from ..kernel.counted_error import KIND
from ..motion.reference import interpolate_poses
from ..robot.rotation import angles_between
from ..solvers.task import relatives, what_counts
from .certificate import Continuity
from .contact import find_contacts
from .freedom import freedom, missed
from .smoothing import settle_rows as settle_rows

# Largest number of rounds of inserting rows into a curve. The bounds fall with the square of the number of pieces, so few rounds
# suffice.
ROUNDS = 12
# A joint motion between two poses that is k times as long as max_step (k >= 1) is divided into at most 256 k pieces. If it needs
# more, it counts as not continuous.
MOST_PIECES = 256
MOST_ROWS = 200_000  # largest number of rows of a curve
LOG_SLOPE = 1.3  # bound on the derivative of the inverse left Jacobian of SO(3), for rotation vectors up to pi
LOG_GAIN = 0.5 * math.pi  # bound on the norm of the inverse left Jacobian of SO(3), for rotation vectors up to pi


class SegmentBounds(NamedTuple):
    """Upper bounds (M-1,) on a tip's motion over each segment between two rows, whose parameter runs from 0 to 1.

    speed, bend [m]: bounds on the first and second derivative of the tip's position; turn, twist [rad]: bounds on its
    angular velocity and angular acceleration; off [m], off_turn [rad]: bounds on the tip's deviation that is due to
    joints leaving the straight line between the rows (`sag` of `bounds`).
    """

    speed: np.ndarray
    bend: np.ndarray
    turn: np.ndarray
    twist: np.ndarray
    off: np.ndarray
    off_turn: np.ndarray


def check(
    plan: Any, kinds: tuple, curve: np.ndarray, at: np.ndarray, T: np.ndarray, cut: np.ndarray, collision: Any = None
) -> Continuity:
    """Bound the tip deviation and test for contact along a motion that is linear between the rows of a curve.

    Every row without NaN must be inside the tolerances of its target, or as near as an arm with too few joints comes.

    plan: the solver's Plan; kinds: the kind of each tip's target (pose, position, ...); curve (M, n) [rad or m]; at (M,): positions
    of its rows on the path through T (N, F, 4, 4); cut (M-1,): whether the motion breaks between two rows; collision: a
    CollisionModel or None.
    """
    judged = bounds(plan, kinds, curve, at, T)
    deviation, turn = bounds(plan, kinds, curve, at, T, beyond=missed(plan, kinds, curve, at, T))
    lacking = np.array([deviation - judged[0], turn - judged[1]])
    moving = ~cut & np.isfinite(curve[1:] + curve[:-1]).all(axis=1)
    deviation[~moving], turn[~moving] = np.nan, np.nan
    if collision is None:
        return Continuity(deviation, turn, lacking)
    return Continuity(deviation, turn, lacking, *find_contacts(collision, curve, at, moving))


def densify(
    plan: Any,
    kinds: tuple,
    q: np.ndarray,
    T: np.ndarray,
    breaks: list[int],
    max_step: tuple[float, float],
    path_tolerance: tuple[float, float],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Insert solved rows into a joint motion until its steps are below max_step (rad, m) and its deviations below path_tolerance.

    q (N, n) [rad or m] are solutions of the poses T (N, F, 4, 4), NaN where a pose is not reached; path_tolerance (m, rad): how far
    a tip may leave the interpolated poses. The motion breaks between pose k and the next for k in breaks. Between two poses that no
    continuous joint motion connects, no row is inserted, and `check` reports the deviation.

    Returns the curve (M, n), the position of each row on the path (M,), and whether the curve breaks after each row (M-1,). Raises
    InvalidOption if max_step is so small that there would be more than MOST_ROWS rows.
    """
    robot = plan.robot
    step = np.where(robot.slides, max_step[1], max_step[0])
    curve, at = q, np.arange(float(len(q)))
    open_ = np.asarray(np.isfinite(q[1:] + q[:-1]).all(axis=1))
    open_[list(breaks)] = False
    given_up = np.zeros(len(q) - 1, dtype=bool)
    strides = np.where(open_[:, None], np.abs(np.diff(q, axis=0)) / step, 0.0).max(axis=1, initial=1.0)
    if strides.sum() > MOST_ROWS:
        raise InvalidOption(
            f"max_step = ({max_step[0]:.3g} rad, {max_step[1]:.3g} m) is too small: steps of this path are up to "
            f"{strides.max():.3g} times as long, and {strides.sum():.3g} rows are more than {MOST_ROWS:,}"
        )
    most = MOST_PIECES * strides
    for _ in range(ROUNDS):
        owner = at[:-1].astype(int)
        deviation, turn = bounds(plan, kinds, curve, at, T)
        # Dividing a segment by k lowers its bound by about k^2, so the root of the excess is the number of pieces.
        excess = [np.sqrt(x / most) for x, most in zip((deviation, turn), path_tolerance, strict=True)]
        wanted = np.max([*excess, (np.abs(np.diff(curve, axis=0)) / step).max(axis=1)], axis=0)
        wanted = np.where(open_[owner] & ~given_up[owner] & (wanted > 1.0), np.ceil(wanted * (1.0 + 1e-9)), 1.0)
        crowded = np.bincount(owner, wanted, len(given_up)) > most
        given_up |= crowded
        wanted = np.where(crowded[owner], 1.0, wanted).astype(int)
        if not (wanted > 1).any():
            break
        first = np.repeat(np.arange(len(wanted)), wanted)  # index of the segment that each piece is part of
        share = (np.arange(len(first)) - np.repeat(np.cumsum(wanted) - wanted, wanted)) / wanted[first]
        places = np.append(at[first] + share * (at[first + 1] - at[first]), at[-1])
        rows = np.vstack([curve[first] + share[:, None] * (curve[first + 1] - curve[first]), curve[-1:]])
        new = np.append(share > 0.0, False)
        rows[~new] = curve  # Interpolation towards a row of NaN has made old rows NaN, so all old rows are restored.
        rows[new], good = settle_between(plan, kinds, rows[new], interpolate_poses(T, places[new], kinds))
        # Where an inserted row has no solution, the segment between its two poses gets no rows at all.
        given_up[np.unique(places[new][~good].astype(int))] = True
        keep = ~new | ~given_up[np.minimum(places, len(q) - 2).astype(int)]
        curve, at = rows[keep], places[keep]
    whole = ~np.isin(np.floor(at).astype(int), np.flatnonzero(given_up)) | (at == np.round(at))
    curve, at = curve[whole], at[whole]
    return curve, at, ~open_[at[:-1].astype(int)]


def settle_on_targets(plan: Any, kinds: tuple, q: np.ndarray, T: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Move the configurations q (M, n) [rad or m] onto the targets T (M, F, 4, 4) with the least joint motion.

    Returns the rows (M, n) and whether each is inside the tolerances (M,).
    """
    q, good = np.array(q, dtype=float), np.zeros(len(q), dtype=bool)
    settle_rows(
        *plan.chain[:2], np.ascontiguousarray(T).reshape(-1, *plan.robot.pose_shape), q, plan.orders(kinds, True), good
    )
    return q, good


def settle_between(plan: Any, kinds: tuple, q: np.ndarray, T: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Move the configurations q (M, n) [rad or m] onto the targets T (M, F, 4, 4), or if the arm has too few joints, near them.

    Returns the rows (M, n) and whether each is inside the tolerances, or as near as possible (M,).
    """
    q, good = settle_on_targets(plan, kinds, q, T)
    return q, good | (np.isfinite(q).all(axis=1) & freedom(plan, kinds).lacks)


# --------------------------------------------------------------------------------------------------------- between poses
def bounds(
    plan: Any,
    kinds: tuple,
    curve: np.ndarray,
    at: np.ndarray,
    T: np.ndarray,
    sag: np.ndarray | None = None,
    beyond: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Return upper bounds [m] and [rad], each (M-1,), on how far any tip leaves the interpolated poses between two rows of a curve.

    The rows of the curve (M, n) [rad or m] are solutions at the positions `at` (M,) on the path through the poses T (N, F, 4, 4).
    sag (M-1, n): upper bound on each joint's deviation from the straight line between two rows (default 0). beyond (2, M-1): by how
    much [m], [rad] the rows themselves exceed the tolerances (default 0).
    """
    robot, o = plan.robot, plan.options
    beyond = np.zeros((2, len(curve) - 1)) if beyond is None else beyond
    sag = np.zeros((len(curve) - 1, robot.n)) if sag is None else sag
    arms = zip(robot.arms, robot.places, strict=True)
    tips = [_speeds(arm.chain, np.ascontiguousarray(curve[:, place]), sag[:, place]) for arm, place in arms]
    poses = robot.chain.forward(curve)[0].reshape(len(curve), -1, 4, 4)
    others = relatives(robot, o)
    deviation, turn = np.zeros(len(curve) - 1), np.zeros(len(curve) - 1)
    for f, (kind, counts) in enumerate(zip(kinds, what_counts(robot, o), strict=True)):
        if kind == KIND.free:
            continue
        goal = interpolate_poses(T[:, [f]], at, (kind,))[:, 0]
        other = None if others[f] < 0 else (tips[others[f]], poses[:, others[f]])
        tip = ErrorBounds(tips[f], poses[:, f], goal, other, counts.frame)
        position = o.position_tolerance + beyond[0] + tip.position(counts)
        deviation = np.maximum(deviation, position)
        if kind != KIND.position:
            axis = counts.free_turn is not None or isinstance(kind, tuple)
            turn = np.maximum(turn, tip.rotation(counts, axis, o.orientation_tolerance + beyond[1]))
    return deviation, turn


def _speeds(chain: Any, q: np.ndarray, sag: np.ndarray) -> SegmentBounds:
    """Return bounds on the motion of a chain's tip between the rows q (M, n) [rad or m].

    sag (M-1, n) [rad or m]: upper bound on each joint's deviation from the straight line between two rows.
    """
    rows, move = chain.rows, np.abs(np.diff(q, axis=0)) / chain.unit
    D = np.empty((len(q), len(rows)))
    joint_levers(rows, chain.ends, q, chain.unit, D)
    owner = rows[:, 8].astype(int)
    # Per internal unit of its coordinate a joint turns by an angle (ratio) or slides by a length [m] (stroke); the other is 0.
    ratio, stroke = np.abs(rows[:, 4]), np.abs(rows[:, 6]) * chain.scale
    turns, slides = ratio * move[:, owner], stroke * move[:, owner]
    sag = (sag / chain.unit)[:, owner]
    speed, bend, turn, twist, off = (np.zeros(len(move)) for _ in range(5))
    for r in range(len(rows) - 1, -1, -1):
        # At this point `speed` bounds how far the joints between joint r and the tip move the tip from one row to the next. The
        # tip's distance from axis r is therefore at most the mean of the distances at both rows plus half of `speed`.
        arm = 0.5 * (D[:-1, r] + D[1:, r] + speed)
        bend += turns[:, r] * (turns[:, r] * arm + 2.0 * speed)
        twist += turns[:, r] * turn
        speed += turns[:, r] * arm + slides[:, r]
        turn += turns[:, r]
        off += ratio[r] * sag[:, r] * (arm + off) + stroke[r] * sag[:, r]
    return SegmentBounds(speed, bend, turn, twist, off, sag @ ratio)


class ErrorBounds:
    """Bounds on the errors of one tip between two neighbouring rows of a curve, for each of the M-1 segments."""

    def __init__(self, tip: SegmentBounds, poses: np.ndarray, goal: np.ndarray, other: Any, frame: str) -> None:
        """Bound the derivatives of the errors, and the angular speed of the axes in which they are given.

        tip: bounds on the tip's motion; poses, goal (M, 4, 4): the tip's pose and target at the rows; other: None, or
        the bounds and poses of the tip that the target is relative to; frame: "base", "tip" or "target", the axes of
        the weights (mask) and dead bands (slack).
        """
        self.swing = angles_between(goal[1:, :3, :3], goal[:-1, :3, :3])  # angle [rad] between neighbouring targets
        self.tip, self.ref_turn, self.ref_twist = tip, self.swing, np.zeros_like(self.swing)
        self.bend, self.rate, self.twist = tip.bend, tip.turn, tip.twist
        self.off, self.off_turn = tip.off, tip.off_turn
        target = goal
        if other is not None:
            carrier, carried = other
            arm = np.linalg.norm(goal[:, :3, 3], axis=1)
            arm, step = np.maximum(arm[1:], arm[:-1]), np.linalg.norm(np.diff(goal[:, :3, 3], axis=0), axis=1)
            self.bend = tip.bend + carrier.bend + 2.0 * carrier.turn * step + (carrier.twist + carrier.turn**2) * arm
            self.rate = tip.turn + carrier.turn  # This bounds the tip's angular speed in the frame of the other tip.
            self.twist = tip.twist + carrier.twist + tip.turn * carrier.turn
            self.off = tip.off + carrier.off + carrier.off_turn * arm
            self.off_turn = tip.off_turn + carrier.off_turn
            self.ref_turn = self.swing + carrier.turn
            self.ref_twist = carrier.twist + carrier.turn * self.swing
            target = carried @ goal
        e = target[:, :3, 3] - poses[:, :3, 3]
        size = np.linalg.norm(e, axis=1)
        self.drift = np.linalg.norm(np.diff(e, axis=0), axis=1) + 0.5 * self.bend
        self.away = np.maximum(size[1:], size[:-1]) + 0.125 * self.bend
        self.axes = {
            "base": (0.0, 0.0), "tip": (tip.turn, tip.twist), "target": (self.ref_turn, self.ref_twist)
        }[frame]  # fmt: skip

    def position(self, counts: Any) -> np.ndarray:
        """Return by how much [m] (M-1,) the counted position error may exceed its value at the rows.

        counts: which part of the tip's error counts (Counts: weights, dead bands, frame).
        """
        if counts.mask is None and counts.slack is None:
            # If all components of the error count alike, the axes in which they are given do not matter.
            return 0.125 * self.bend + self.off
        spin, change = self.axes
        second = self.bend + 2.0 * spin * self.drift + (change + spin * spin) * self.away
        # If the joints leave the straight line between the rows, this also rotates the axes of the error; the factor 8 cancels the
        # 0.125 below.
        second += 8.0 * (self.off + self.off_turn * (self.away + self.off))
        return max((counts.mask or (1.0,))[:3]) * 0.125 * second

    def rotation(self, counts: Any, axis: bool, tolerance: np.ndarray) -> np.ndarray:
        """Return an upper bound [rad] (M-1,) on the counted rotation error between the rows.

        counts: as in `position`; axis: whether only the direction of an axis counts; tolerance (M-1,) [rad]: bound on
        the errors at the rows.
        """
        if any(counts.mask or ()) or any((counts.slack or (0.0,))[3:]):
            weight = max((counts.mask or (1.0,))[-3:])
            return tolerance + weight * (0.125 * self._vector() + (LOG_GAIN + math.pi) * self.off_turn)
        if axis:  # axis and target move on the unit sphere; each leaves its chord by at most p'' / 8
            chord = 2.0 * np.sin(0.5 * np.minimum(tolerance, math.pi)) + 0.125 * (self.rate**2 + self.swing**2)
            return 2.0 * np.arcsin(np.minimum(0.5 * chord, 1.0)) + self.off_turn
        # The rotation group has curvature 1/4, so half the rotation over a segment is multiplied by sqrt(1/4).
        bent = 0.25 * np.maximum(self.rate, self.swing)
        near = np.minimum(bent, 1.57)  # From a quarter turn on only half a turn bounds the rotation.
        secant = 1.0 / np.cos(near)
        grown = np.where(near > 1e-4, 2.0 * (secant - 1.0) / np.maximum(near, 1e-4) ** 2, 1.0)
        bound = np.minimum(tolerance * secant + 0.125 * self.twist * grown + self.off_turn, math.pi)
        return np.where(bent < 0.5 * math.pi, bound, math.pi)

    def _vector(self) -> np.ndarray:
        """Return a bound [rad] (M-1,) on the second derivative of the rotation vector from tip to target."""
        left = self.ref_turn + self.tip.turn
        change = self.tip.twist + left * self.tip.turn + self.ref_twist
        second = LOG_GAIN * change + LOG_SLOPE * LOG_GAIN * left**2
        spin, turned = self.axes
        return second + 2.0 * spin * LOG_GAIN * left + (turned + spin * spin) * math.pi
