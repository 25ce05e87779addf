"""Time-optimal motion along a path: TOPP-RA (Pham and Pham, 2018) on exactly the curve that is verified.

A motion that is linear between its rows has jumps in joint speed at the corners, so a cubic spline replaces it. That is another
curve, so it is verified again: between two knots a joint leaves the straight line by at most h^2 / 8 times its largest second
derivative, which moves the tip by at most that times the lever arm. Where that is too much, solved poses are inserted.
"""

import itertools
import math
from typing import Any, NamedTuple

import numpy as np

from ..errors import InvalidOption, MissingExtra, floats, whole
from ..motion.time_law import time_law, times_of
from ..motion.trajectory import Piece, Trajectory, sample
from ..robot.joints import Joints
from ..solvers.plan import Plan
from ..solvers.registry import GENERAL, find_row
from ..validate import positive
from .contact import find_contacts
from .continuity import bounds, settle_between
from .free_motion import connect
from .freedom import missed
from .interpolate import interpolate

ROUNDS = 12  # rounds of inserting poses: each halves the amount by which corners are cut
LEAST = 1e-9  # [rad or m] rows of a curve nearer than this are merged
GRID = 200  # least number of grid points of the time law
FINER = 3  # how often the grid may be doubled when limits are exceeded between its points by more than TOO_FAST
TOO_FAST = 1.02
ROUNDED = 1e-9  # share by which the time law is slowed down to allow for rounding
SUBDIVIDED = 4  # straight segments that replace the spline between two knots in the collision test
MOST_SAMPLES = 1e7
NOWHERE = np.full(2, np.nan)  # places among the poses during a free motion: none


class Proof(NamedTuple):
    """Bounds [m] and [rad] on a tip's deviation from the poses, the clearance [m], and whether they hold for the smooth curve.

    If not, they are those of the piecewise linear motion, which is already verified.
    """

    deviation: float
    turn: float
    clearance: float
    smooth: bool


def retime(result: Any, velocity: Any, acceleration: Any, rate: float, seed: int) -> Trajectory:
    """See `PathResult.retime`."""
    robot = result.robot
    limits = _limits(robot, velocity, acceleration)
    rate, seed = positive(rate, "rate [1/s]"), whole(seed, "seed", 0)
    result.raise_for_status()
    row = find_row(GENERAL)
    plan = Plan(robot, row, row.load()(), result.options)
    made: list[Piece] = []
    missing, message = "", ""
    runs, deviation, turn, clearance = result.pieces, 0.0, 0.0, math.inf
    for k, run in enumerate(runs):
        if k:
            way = connect(robot, result.collision, result.curve[runs[k - 1].stop - 1], result.curve[run.start], seed)
            if way is None:
                pose = int(result.at[run.start])
                missing = f"it ends at pose {pose - 1}: no collision-free motion to the other branch, at pose {pose}, was found"
                break
            made += [_straight(a, b, NOWHERE, limits) for a, b in itertools.pairwise(way)]
        curve, at, found = _proven(plan, result, result.curve[run], result.at[run])
        deviation, turn = max(deviation, found.deviation), max(turn, found.turn)
        clearance = min(clearance, found.clearance)
        if found.smooth:
            made.append(_spline(curve, at, robot, limits))
        elif len(curve) > 1:
            run_at = result.at[run]
            rows = zip(itertools.pairwise(result.curve[run]), itertools.pairwise(run_at), strict=True)
            made += [_straight(*ends, np.array(places), limits) for ends, places in rows]
            message = "no collision-free smooth curve follows the poses, so the robot stops at every row; "
    pieces = tuple(piece for piece in made if piece.duration > 0.0) or tuple(made[:1])
    if not pieces:  # a single pose
        pieces = (_straight(result.curve[0], result.curve[0], result.at[[0, 0]], limits),)
    total = sum(piece.duration for piece in pieces)
    if total * rate > MOST_SAMPLES:
        raise InvalidOption(
            f"rate = {rate:g} gives {total * rate:.3g} samples in {total:.4g} s; at most {MOST_SAMPLES:g}"
        )
    t = np.append(np.arange(math.ceil(total * rate - 1e-9)) / rate, total)
    message += missing or f"all {len(result.q)} poses are passed in {total:.4g} s"
    safe = None if result.collision is None else clearance
    return Trajectory(
        robot, t, *sample(pieces, t), not missing, message, *limits, (deviation, turn), safe, pieces, result.collision
    )


def _limits(robot: Joints, velocity: Any, acceleration: Any) -> tuple[np.ndarray, np.ndarray]:
    """Limits (n,) of speeds and accelerations. Raises InvalidOption, naming the joint."""
    if acceleration is None:
        raise InvalidOption(
            "acceleration= is required: one number, or one per joint [rad/s^2 or m/s^2]; a URDF does not define it"
        )
    made = []
    for name, given, own in (("velocity", velocity, robot.velocity_limits), ("acceleration", acceleration, None)):
        values = np.array(own) if given is None else floats(given, f"{name} must be numbers", InvalidOption)
        if values.shape == ():
            values = np.full(robot.n, values)
        if values.shape != (robot.n,):
            raise InvalidOption(f"{name} must be one number, or {robot.n}, one per joint; not shape {values.shape}")
        for joint, value in zip(robot.joint_names, values, strict=True):
            if not 0.0 < value < math.inf:
                where = (
                    "the robot defines none for this joint; pass velocity=" if given is None else "it must be positive"
                )
                raise InvalidOption(f"{name} of joint '{joint}' is {value:g}: {where}")
        made.append(values)
    return made[0], made[1]


# ------------------------------------------------------------------------------------------------------------ the curve
def _proven(plan: Plan, result: Any, curve: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, np.ndarray, Proof]:
    """Rows and places of a piece, with poses inserted until the spline through them is verified, and its proof."""
    robot = plan.robot
    curve, at, since = _distinct(curve, at, np.append(at[0], at[:-1]))
    if len(curve) < 2:
        return curve, at, Proof(0.0, 0.0, math.inf, False)
    allowed = np.maximum(result.path_tolerance, result.deviation)
    for _ in range(ROUNDS):
        knots = _coordinate(curve, robot.chain.unit)
        cubics = _cubics(robot, curve, knots)
        beyond = missed(plan, result.kinds, curve, at, result.targets)
        deviation, turn = bounds(plan, result.kinds, curve, at, result.targets, _sag(knots, cubics), beyond)
        broken = (deviation > allowed[0]) | (turn > allowed[1])
        clearance = 0.0
        if not broken.any():
            clearance, broken = _touching(result.collision, knots, cubics, curve)
        if not broken.any():
            return curve, at, Proof(float(deviation.max()), float(turn.max()), clearance, True)
        near = np.flatnonzero(broken | np.append(broken[1:], False) | np.append(False, broken[:-1]))
        middle = 0.5 * (since[near + 1] + at[near + 1])
        rows, good = settle_between(
            plan, result.kinds, 0.5 * (curve[near] + curve[near + 1]), interpolate(result.targets, middle, result.kinds)
        )
        if not good.all():
            break
        since = np.insert(since, near + 1, since[near + 1])
        since[near + 1 + np.arange(1, len(near) + 1)] = middle
        curve, at, since = _distinct(np.insert(curve, near + 1, rows, axis=0), np.insert(at, near + 1, middle), since)
    clearance = math.inf if result.clearance is None else result.clearance
    deviation, turn = result.deviation
    return curve, at, Proof(deviation, turn, clearance, False)


def _distinct(curve: np.ndarray, at: np.ndarray, since: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows, their places, and the places where the motion to them begins, without rows equal to the one before."""
    moved = np.append(True, np.abs(np.diff(curve, axis=0)).max(axis=1) > LEAST)
    return curve[moved], at[moved], since[moved]


def _coordinate(curve: np.ndarray, unit: np.ndarray) -> np.ndarray:
    """Path length in joint space up to each row."""
    return np.append(0.0, np.cumsum(np.linalg.norm(np.diff(curve / unit, axis=0), axis=1)))


def _cubics(robot: Joints, curve: np.ndarray, knots: np.ndarray) -> np.ndarray:
    """Coefficients (4, M-1, n) of the natural cubic spline through the rows of a curve (M, n).

    A joint that would overshoot its limits gets the monotone spline, which stays between neighbouring rows.
    """
    try:
        from scipy.interpolate import CubicSpline, PchipInterpolator
    except ImportError:
        raise MissingExtra("scipy", "paths") from None
    cubics = CubicSpline(knots, curve, bc_type="natural").c
    a, b, c, d = cubics
    with np.errstate(divide="ignore", invalid="ignore"):  # turning points: the roots of 3 a x^2 + 2 b x + c
        root = np.sqrt(b * b - 3.0 * a * c)
        turning = np.nan_to_num([(-b - root) / (3.0 * a), (-b + root) / (3.0 * a), -0.5 * c / b])
    x = np.where((turning > 0.0) & (turning < np.diff(knots)[:, None]), turning, 0.0)
    swing = ((a * x + b) * x + c) * x + d
    beyond = ((swing > robot.upper) | (swing < robot.lower)).any(axis=(0, 1))
    if beyond.any():
        cubics = np.where(beyond, PchipInterpolator(knots, curve).c, cubics)
    return cubics


def _sag(knots: np.ndarray, cubics: np.ndarray) -> np.ndarray:
    """Upper bound (M-1, n) on each joint's deviation of a spline from the straight line between two knots."""
    h = np.diff(knots)[:, None]
    bend = np.maximum(np.abs(2.0 * cubics[1]), np.abs(2.0 * cubics[1] + 6.0 * cubics[0] * h))
    return 0.125 * h * h * bend


def _touching(collision: Any, knots: np.ndarray, cubics: np.ndarray, curve: np.ndarray) -> tuple[float, np.ndarray]:
    """Clearance [m] of a spline, and which segments (M-1,) touch or cannot be proven free."""
    touching = np.zeros(len(curve) - 1, dtype=bool)
    if collision is None:
        return math.inf, touching
    share = np.arange(SUBDIVIDED) / SUBDIVIDED
    x = (share * np.diff(knots)[:, None])[..., None]
    a, b, c, d = cubics[:, :, None]
    rows = np.vstack([(((a * x + b) * x + c) * x + d).reshape(-1, curve.shape[1]), curve[-1:]])
    at = np.append((np.arange(len(touching))[:, None] + share).ravel(), len(touching))
    sag = np.repeat(_sag(knots, cubics), SUBDIVIDED, axis=0) / SUBDIVIDED**2
    clearance, contacts, unproven = find_contacts(collision, rows, at, np.ones(len(rows) - 1, dtype=bool), sag)
    places = np.array([*(contact.place for contact in contacts), *unproven])
    touching[np.minimum(places.astype(int), len(touching) - 1)] = True
    return clearance, touching


# ------------------------------------------------------------------------------------------------------------- the times
def _spline(curve: np.ndarray, at: np.ndarray, robot: Joints, limits: tuple[np.ndarray, np.ndarray]) -> Piece:
    """Time-optimal spline through the rows of a curve; the limits also hold between the grid points."""
    knots = _coordinate(curve, robot.chain.unit)
    piece = Piece(knots, _cubics(robot, curve, knots), knots, knots, knots, at)
    between = max(1, math.ceil(GRID / (len(knots) - 1)))
    for _ in range(FINER + 1):
        grid = np.unique(np.concatenate([knots[:-1] + k / between * np.diff(knots) for k in range(between)] + [knots]))
        _, slope, bend = piece.curve(grid)
        speed, _ = time_law(slope, bend, grid, *limits, start=0.0, end=0.0)
        made = piece._replace(s=grid, speed=speed, t=times_of(grid, speed))
        factor = _excess(made, limits)
        if factor <= TOO_FAST:
            break
        between *= 2
    return made.slower(factor)


def _excess(piece: Piece, limits: tuple[np.ndarray, np.ndarray]) -> float:
    """Factor by which a piece must be slowed down for its limits to hold at every instant.

    Between two grid points the squared path speed is linear in s and the curve is cubic, so accelerations are quadratic: their
    extrema, and the points where they vanish and a speed is extreme, are known exactly.
    """
    k = np.searchsorted(piece.knots, 0.5 * (piece.s[1:] + piece.s[:-1]), side="right") - 1
    step, squares = np.diff(piece.s), piece.speed**2
    gain = 0.5 * np.diff(squares) / step

    def motion(share: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rates and accelerations (G-1, n) at shares (G-1, n) of the intervals."""
        x = (piece.s[:-1] - piece.knots[k])[:, None] + share * step[:, None]
        a, b, c, _ = piece.coefficients[:, k]
        slope, bend = (3.0 * a * x + 2.0 * b) * x + c, 6.0 * a * x + 2.0 * b
        square = squares[:-1, None] + share * np.diff(squares)[:, None]
        return slope * np.sqrt(np.maximum(square, 0.0)), bend * square + slope * gain[:, None]

    ends = np.zeros((len(step), piece.coefficients.shape[2]))
    (dq0, first), (_, middle), (dq1, last) = motion(ends), motion(ends + 0.5), motion(ends + 1.0)
    a, b = 2.0 * (first - 2.0 * middle + last), 4.0 * middle - 3.0 * first - last
    with np.errstate(divide="ignore", invalid="ignore"):
        root = np.sqrt(b * b - 4.0 * a * first)
        shares = [-0.5 * b / a, 0.5 * (-b - root) / a, 0.5 * (-b + root) / a, -first / b]
    inside = [motion(np.clip(np.nan_to_num(share), 0.0, 1.0)) for share in shares]
    speeds = np.abs([dq0, dq1, *(one[0] for one in inside)]) / limits[0]
    gains = np.abs([first, last, *(one[1] for one in inside)]) / limits[1]
    return max(1.0, (1.0 + ROUNDED) * max(float(speeds.max()), math.sqrt(float(gains.max()))))


def _straight(a: np.ndarray, b: np.ndarray, at: np.ndarray, limits: tuple[np.ndarray, np.ndarray]) -> Piece:
    """Time-optimal straight line from a to b (n,), rest to rest: full acceleration, full speed, full braking."""
    way = b - a
    length = float(np.abs(way).max())
    if length <= LEAST:
        still = np.zeros(2)
        return Piece(np.array([0.0, 1.0]), np.zeros((4, 1, len(a))), still, still, still, at)
    slope = way / length
    moving = np.abs(slope) > 0.0
    top, gain = (float((limit[moving] / np.abs(slope[moving])).min()) for limit in limits)
    ramp = min(0.5 * length, 0.5 * top * top / gain)
    peak = math.sqrt(2.0 * gain * ramp)
    s = np.array([0.0, ramp, length - ramp, length]) if ramp < 0.5 * length else np.array([0.0, ramp, length])
    speed = np.array([0.0, peak, peak, 0.0]) if len(s) == 4 else np.array([0.0, peak, 0.0])
    cubics = np.stack([np.zeros_like(a), np.zeros_like(a), slope, a])[:, None]
    return Piece(np.array([0.0, length]), cubics, s, speed, times_of(s, speed), at)
