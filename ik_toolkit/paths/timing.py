"""Time-optimal motion along a path: the time law of the smooth joint curve that `smooth_curve` verified."""

import itertools
import math
from dataclasses import replace
from typing import Any

import numpy as np

from ..errors import InvalidOption, NotSolved, floats, whole
from ..motion.time_law import time_law, times_of
from ..motion.trajectory import Piece, Trajectory, sample
from ..robot.joints import Joints
from ..solvers.plan import Plan
from ..solvers.registry import GENERAL, find_row
from ..text import angle, duration, figure, length
from ..validate import positive
from .contact import clearance_along, connect, find_contacts
from .path_problem import read_path_tolerance
from .smooth_curve import LEAST, Curve, corners, sagittas, smooth_curve

# least number of grid points of the time law of a smooth piece; ten times as many for a tip speed that is to be kept
GRID = 200
TOO_FAST = 1.001  # A piece that exceeds its limits by no more than this factor is slowed down as a whole.
LOWERED = 8  # largest number of times that the path speed is lowered where limits are exceeded between grid points
ROUNDED = 1e-9  # share by which a time law is slowed down to allow for rounding
MOST_SAMPLES = 1e7  # A trajectory of more samples is refused, because such a rate must be a mistake.
# positions on the path of the two ends of a free motion from one branch to another: NaN, because it is not on the path
NOWHERE = np.full(2, np.nan)
KEPT = 0.99  # A tip counts as keeping the requested speed if it has at least this share of it.
NUDGE = 1e-6  # step of the finite difference for a tip's speed, as a share of the length of the curve
TOLD = 3  # largest number of positions that a message lists


def retime(
    result: Any, velocity: Any, acceleration: Any, rate: float, seed: int, path_tolerance: Any, tip_speed: Any
) -> Trajectory:
    """Return the time-optimal motion along a PathResult; arguments and errors are those of `PathResult.retime`."""
    robot = result.robot
    limits = _limits(robot, velocity, acceleration)
    rate, seed = positive(rate, "rate [1/s]"), whole(seed, "seed", 0)
    asked = math.inf if tip_speed is None else positive(tip_speed, "tip_speed [m/s]")
    result.raise_for_status()
    free_now = _free_now(result)
    row = find_row(GENERAL)
    plan = Plan(robot, row, row.load()(), result.options)
    made: list[Piece] = []
    missing, stops = "", []
    runs, places, count, (result, order) = result.pieces, result.at, len(result.q), _without_repeats(result)
    allowed, deviation, turn, clearance = _allowed(result, path_tolerance), 0.0, 0.0, math.inf
    for k, run in enumerate(runs):
        if k:
            way = connect(robot, result.collision, result.curve[runs[k - 1].stop - 1], result.curve[run.start], seed)
            if way is None:
                pose = int(places[run.start])
                missing = f"it ends at pose {pose - 1}: no collision-free motion to the other branch, at pose {pose}, was found"
                break
            made += [_line(robot, ends, NOWHERE, limits, asked) for ends in itertools.pairwise(way)]
            clearance = min(clearance, clearance_along(result.collision, way))
        for j, (found, piece, rows) in enumerate(_pieces(plan, result, allowed, run, limits, asked)):
            if j and piece.duration:
                stops.append(float(places[rows.start]))
            off, turned, free = (
                (*result.deviation, free_now) if found is None else (found.deviation, found.turn, found.clearance)
            )
            deviation, turn, clearance = max(deviation, off), max(turn, turned), min(clearance, free)
            made.append(_with_repeats(piece, order))
    if not made:  # A path of a single pose has no motion.
        made = [_straight(result.curve[0], result.curve[0], places[[0, 0]], limits)]
        clearance = clearance_along(result.collision, result.curve[:1])
    pieces, t = _instants(made, rate)
    total = float(t[-1])
    slow, kept = ((), "") if tip_speed is None else _kept_speed(robot, pieces, asked)
    passed = "the pose is" if count == 1 else f"all {count} poses are"
    message = missing or f"{passed} passed in {duration(total, 4)}"
    if stops:
        message += f"; it stops at pose {_listed(stops)}, as no smooth curve passes there within the tolerance"
    if (np.array([deviation, turn]) > allowed.max(axis=1)).any():
        off = f"{length(deviation)} and {angle(turn)}"
        message += f"; between the stops it leaves the chords by up to {off}: give path_tolerance to solve_path"
    safe = None if result.collision is None else clearance
    return Trajectory(
        robot, t, *sample(pieces, t), not missing, message + kept, *limits, (deviation, turn), safe, pieces, result.collision,
        tuple(stops), slow,
    )  # fmt: skip


def through(
    robot: Joints, Q: Any, velocity: Any = None, acceleration: Any = None, *, collision: Any = None, rate: float = 100.0
) -> Trajectory:
    """Return the motion through configurations Q (N, n) [rad or m], straight in the joints, at rest at each one.

    `place` of the result counts configurations (3.5: halfway from configuration 3 to 4). Limits, rate and errors are as in
    `PathResult.retime`. With a CollisionModel as `collision` the motion goes around obstacles, or ends where no way around was
    found.
    """
    limits, rate = _limits(robot, velocity, acceleration), positive(rate, "rate [1/s]")
    rows = np.array([robot.check_q(q) for q in Q])
    if not len(rows):
        raise InvalidOption("there is no configuration to go through")
    made, missing = [_straight(rows[0], rows[0], np.zeros(2), limits)], ""
    clearance = clearance_along(collision, rows[:1])
    for k, (a, b) in enumerate(itertools.pairwise(rows)):
        way = connect(robot, collision, a, b, 0)
        if way is None:
            missing = f"it ends at configuration {k + 1}: no collision-free motion to the next one was found"
            break
        places = np.linspace(k, k + 1, len(way))
        made += [_straight(way[i], way[i + 1], places[i : i + 2], limits) for i in range(len(way) - 1)]
        clearance = min(clearance, clearance_along(collision, way))
    pieces, t = _instants(made, rate)
    message = missing or f"all {len(rows)} configurations are passed in {duration(float(t[-1]), 4)}"
    safe = None if collision is None else clearance
    return Trajectory(
        robot, t, *sample(pieces, t), not missing, message, *limits, (0.0, 0.0), safe, pieces, collision
    )  # fmt: skip


def _instants(made: list[Piece], rate: float) -> tuple[tuple[Piece, ...], np.ndarray]:
    """Return the pieces that take time, or the first one if none does, and the times (N,) [s] of their samples.

    Raises InvalidOption if there would be too many samples.
    """
    pieces = tuple(piece for piece in made if piece.duration > 0.0) or tuple(made[:1])
    total = sum(piece.duration for piece in pieces)
    if total * rate > MOST_SAMPLES:
        raise InvalidOption(
            f"rate = {rate:g} gives {figure(total * rate)} samples in {duration(total, 4)}; at most {MOST_SAMPLES:g}"
        )
    return pieces, np.append(np.arange(math.ceil(total * rate - 1e-9)) / rate, total)


def _free_now(result: Any) -> float:
    """Return the proven least distance [m] of any two parts on a PathResult, with all obstacles where they are now.

    Obstacles may have moved since the path was found. Raises NotSolved if parts touch.
    """
    if result.collision is None:
        return math.inf
    moving = np.zeros(len(result.curve) - 1, dtype=bool)
    for piece in result.pieces:
        moving[piece.start : piece.stop - 1] = True
    free, contacts, unproven = find_contacts(result.collision, result.curve, result.at, moving)
    if contacts:
        touching, place = " and ".join(contacts[0].pair), round(contacts[0].place, 3)
        message = f"obstacles have moved since the path was found: {touching} touch at pose {place:g}; search again"
        proof = replace(result.continuity, clearance=free, contacts=contacts, unproven=unproven)
        raise NotSolved(replace(result, status=type(result.status).COLLISION, continuity=proof, message=message))
    return free


def _without_repeats(result: Any) -> tuple[Any, np.ndarray]:
    """Return a PathResult without the poses that repeat the pose before, at which the joints stand still.

    Only `targets` (N, F, 4, 4), `q` (N, n) and `at` (M,) change: a spline over the poses needs a distance between any two of them.
    Also returns the place (N,) of each former pose on the new path.
    """
    T, q = result.targets, result.q
    still = (np.abs(np.diff(T, axis=0)).max(axis=(1, 2, 3)) <= LEAST) & (
        np.abs(np.diff(q, axis=0)).max(axis=1) <= LEAST
    )
    kept = np.append(True, ~still)
    order = np.cumsum(kept) - 1.0
    return replace(result, targets=T[kept], q=q[kept], at=np.interp(result.at, np.arange(len(T)), order)), order


def _with_repeats(piece: Piece, order: np.ndarray) -> Piece:
    """Return a piece with `at` on the path before `_without_repeats`; where a pose repeats, two knots are equal."""
    poses = np.arange(float(len(order)))
    before = poses[-1] - np.interp(order[-1] - piece.at, order[-1] - order[::-1], poses)
    after = np.interp(piece.at, order, poses)
    twice = np.flatnonzero((after - before > 0.5) & (np.diff(piece.at, append=np.inf) > 0.0))
    cubics = piece.coefficients[:, np.minimum(twice, len(piece.knots) - 2)]
    return piece._replace(
        knots=np.insert(piece.knots, twice + 1, piece.knots[twice]),
        coefficients=np.insert(piece.coefficients, twice, cubics, axis=1),
        at=np.insert(before, twice + 1, after[twice]),
    )


def _listed(places: list[Any]) -> str:
    """Return the first TOLD of some positions as text, and the number of the others."""
    more = len(places) - TOLD
    return ", ".join(f"{one:g}" if isinstance(one, float) else one for one in places[:TOLD]) + (
        f" and {more} more" if more > 0 else ""
    )


def _allowed(result: Any, path_tolerance: Any) -> np.ndarray:
    """Return how far [m] and [rad] (2, N-1) a tip may leave each chord between two poses of a PathResult.

    path_tolerance: (m, rad) for all chords, or None for the default of `PathResult.retime`. Raises InvalidOption.
    """
    pair = result.path_tolerance if path_tolerance is None else read_path_tolerance(path_tolerance, result.options)
    lacking = np.nanmax(result.continuity.lacking, axis=1, initial=0.0)
    allowed = np.tile((pair + lacking)[:, None], max(len(result.targets) - 1, 1))
    if path_tolerance is not None or result.tolerance_given or len(result.targets) < 2:
        return allowed
    return np.maximum(allowed, sagittas(result.targets, result.kinds))


def _pieces(
    plan: Plan, result: Any, allowed: np.ndarray, run: slice, limits: tuple[np.ndarray, np.ndarray], tip_speed: float
) -> list[tuple[Curve | None, Piece, slice]]:
    """Divide a continuous run of rows of a path's curve into as few pieces as possible, each from rest to rest.

    The result is one smooth curve if there is one within the bounds `allowed` (2, N-1) [m], [rad] on leaving the
    chords. Else the run is divided at its corners, and a part without corners becomes straight lines from row to row.
    limits: joint speeds and accelerations (n,); tip_speed [m/s]. Returns for each piece its verified Curve (None if
    straight), its timed Piece, and its rows.
    """
    if run.stop - run.start < 2:
        return []
    found = smooth_curve(plan, result, allowed, run)
    if found is not None:
        curve = Piece(found.knots, found.cubics, found.knots, found.knots, found.knots, found.at)
        return [(found, _fastest(curve, plan.robot, limits, tip_speed), run)]
    places = np.flatnonzero(corners(result.targets, result.kinds))
    cuts = [int(k) for k in np.searchsorted(result.at, places) if run.start < k < run.stop - 1]
    if run.stop - run.start == 2:
        return [(None, _line(plan.robot, result.curve[run], result.at[run], limits, tip_speed), run)]
    bounds = [run.start, *(cuts or [(run.start + run.stop - 1) // 2]), run.stop - 1]
    parts = [slice(a, b + 1) for a, b in itertools.pairwise(bounds)]
    return [one for part in parts for one in _pieces(plan, result, allowed, part, limits, tip_speed)]


def _tip_rates(robot: Joints, piece: Piece, s: np.ndarray) -> np.ndarray:
    """Return how fast (G,) [m per unit of s] the fastest tip moves along a piece, at the path coordinates s (G,)."""
    h = NUDGE * (piece.knots[-1] - piece.knots[0])
    low, high = np.maximum(s - h, piece.knots[0]), np.minimum(s + h, piece.knots[-1])
    before, after = (robot.chain.forward(piece.curve(x)[0])[0].reshape(len(s), -1, 4, 4) for x in (low, high))
    return np.linalg.norm((after - before)[:, :, :3, 3], axis=2).max(axis=1) / (high - low)


def _kept_speed(robot: Joints, pieces: tuple[Piece, ...], asked: float) -> tuple[tuple[tuple[float, float], ...], str]:
    """Return the ranges of the path (first, last position) where the fastest tip is slower than `asked` [m/s], and a text on them.

    Free motions between two branches of solutions, in which the tip is not faster, are left out.
    """
    found: list[tuple[float, float]] = []
    fastest = 0.0
    for piece in pieces:
        if np.isnan(piece.at).any():
            continue
        speed = piece.speed * _tip_rates(robot, piece, piece.s)
        fastest, slow = max(fastest, float(speed.max())), speed < KEPT * asked
        places = np.interp(piece.s, piece.knots, piece.at)
        edges = np.flatnonzero(np.diff(np.concatenate([[False], slow, [False]]).astype(int)))
        for a, b in edges.reshape(-1, 2).tolist():
            found.append((float(places[max(a - 1, 0)]), float(places[min(b, len(places) - 1)])))
    if fastest < KEPT * asked:
        return tuple(found), f"; the limits allow the tip {fastest:.4g} m/s at most, not {asked:.4g} m/s"
    where = " on the path" if any(np.isnan(piece.at).any() for piece in pieces) else ""
    ranges = [f"{round(a, 3):g} to {round(b, 3):g}" for a, b in found]
    return tuple(found), f"; the tip keeps {asked:.4g} m/s{where}" + (
        f" except from pose {_listed(ranges)}" if found else ""
    )


def _limits(robot: Joints, velocity: Any, acceleration: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return the joint limits (n,) of speed [rad/s or m/s] and of acceleration [rad/s^2 or m/s^2].

    velocity: one number, one per joint, or None for the robot's own; acceleration: one number or one per joint. Raises
    InvalidOption, naming the joint.
    """
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


# ------------------------------------------------------------------------------------------------------------- the times
def _fastest(piece: Piece, robot: Joints, limits: tuple[np.ndarray, np.ndarray], tip_speed: float) -> Piece:
    """Return a piece of a path with its time-optimal motion, from rest to rest; limits also hold between the grid points.

    limits: joint speeds and accelerations (n,); tip_speed: the highest speed of any tip [m/s], infinite for none.
    """
    knots = piece.knots
    # The tip reaches its speed limit only at the fastest point around each grid point and is slower elsewhere, so a tip speed that
    # is to be kept needs a finer grid.
    points = GRID if tip_speed == math.inf else 10 * GRID
    between = max(2, math.ceil(points / (len(knots) - 1)))
    step = np.diff(knots) / between
    # Acceleration from rest to a low tip speed takes a small part of the first interval, so this is divided more finely.
    nearer = 4.0 ** -np.arange(1.0, 8.0)
    ends = [knots, knots[0] + nearer * step[0], knots[-1] - nearer * step[-1]]
    grid = np.unique(np.concatenate([*ends, *(knots[:-1] + k * step for k in range(1, between))]))
    _, slope, bend = piece.curve(grid)
    top = _ceiling(robot, piece, grid, tip_speed)
    for _ in range(LOWERED):
        speed, _ = time_law(slope, bend, grid, *limits, top=top, start=0.0, end=0.0)
        made = piece._replace(s=grid, speed=speed, t=times_of(grid, speed))
        excess = _excess(made, limits)
        if excess.max() <= TOO_FAST:
            break
        around = np.maximum(np.append(excess, 1.0), np.append(1.0, excess))
        top = np.where(around > 1.0, np.minimum(top, speed / around), top)
    return made.slower(float(excess.max()))


def _ceiling(robot: Joints, piece: Piece, grid: np.ndarray, tip_speed: float) -> np.ndarray:
    """Return the highest ds/dt (G,) at which no tip exceeds `tip_speed` [m/s], at a grid point and half way to its neighbours."""
    if tip_speed == math.inf:
        return np.full(len(grid), np.inf)
    middle = _tip_rates(robot, piece, 0.5 * (grid[1:] + grid[:-1]))
    rates = np.max([_tip_rates(robot, piece, grid), np.append(middle, 0.0), np.append(0.0, middle)], axis=0)
    return tip_speed / np.maximum(rates, 1e-9)


def _excess(piece: Piece, limits: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Return for each grid interval of a piece the factor (G-1,), 1 or more, by which it is too fast for the joint limits.

    A piece that is slowed down as a whole by the largest factor keeps its limits at every instant.

    Between two grid points the squared path speed is linear in s and the curve is cubic, so joint accelerations are
    quadratic in s. Their extrema, and their zeros (at which joint speeds are extreme), therefore have a closed form.
    """
    k = np.searchsorted(piece.knots, 0.5 * (piece.s[1:] + piece.s[:-1]), side="right") - 1
    step, squares = np.diff(piece.s), piece.speed**2
    gain = 0.5 * np.diff(squares) / step

    def motion(share: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return joint rates and accelerations (G-1, n) at these shares (0 to 1, (G-1, n)) of the grid intervals."""
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
    return np.maximum(1.0, (1.0 + ROUNDED) * np.maximum(speeds, np.sqrt(gains)).max(axis=(0, 2)))


def _line(robot: Joints, ends: Any, at: np.ndarray, limits: tuple[np.ndarray, np.ndarray], tip_speed: float) -> Piece:
    """Return the motion of `_straight` between two ends (n,), with no tip faster than `tip_speed` [m/s] (may be infinite)."""
    start, end = ends
    line = _straight(start, end, at, limits)
    return _fastest(line, robot, limits, tip_speed) if line.duration and tip_speed < math.inf else line


def _straight(a: np.ndarray, b: np.ndarray, at: np.ndarray, limits: tuple[np.ndarray, np.ndarray]) -> Piece:
    """Return the time-optimal straight joint motion from a to b (n,) [rad or m], from rest to rest.

    It accelerates fully, keeps the highest speed and brakes fully. at (2,): positions of a and b on the path; limits: joint speeds
    and accelerations (n,).
    """
    way = b - a
    length = float(np.abs(way).max())
    if length <= LEAST:
        still = np.zeros(2)
        cubics = np.stack([0.0 * a, 0.0 * a, 0.0 * a, a])[:, None]
        return Piece(np.array([0.0, 1.0]), cubics, still, still, still, at)
    slope = way / length
    moving = np.abs(slope) > 0.0
    top, gain = (float((limit[moving] / np.abs(slope[moving])).min()) for limit in limits)
    ramp = min(0.5 * length, 0.5 * top * top / gain)
    peak = math.sqrt(2.0 * gain * ramp)
    s = np.array([0.0, ramp, length - ramp, length]) if ramp < 0.5 * length else np.array([0.0, ramp, length])
    speed = np.array([0.0, peak, peak, 0.0]) if len(s) == 4 else np.array([0.0, peak, 0.0])
    cubics = np.stack([np.zeros_like(a), np.zeros_like(a), slope, a])[:, None]
    return Piece(np.array([0.0, length]), cubics, s, speed, times_of(s, speed), at)
