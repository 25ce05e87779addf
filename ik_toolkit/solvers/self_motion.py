"""Self-motions of arms of seven revolute joints: the curves on which the arm moves while its tip stays, and where they end.

With its first or last joint fixed, such an arm has six joints, whose solutions the elimination lists. Doing this for many values of
that joint (slices) gives a point or more of every curve that is not too short; continuation follows each until it closes. The
limits cut it, at points found by bisection. A curve that lies between two slices is missed, so nothing is proven. Source: Burdick
(1989), "On the inverse kinematics of redundant manipulators: characterization of the self-motion manifolds".
"""

# Numba's type hints are incomplete, so pyright must not report what they lack.
# pyright: reportCallIssue=false, reportArgumentType=false, reportGeneralTypeIssues=false
import math
from collections.abc import Iterator
from itertools import pairwise
from operator import itemgetter
from typing import Any, NamedTuple

import numpy as np

from ..compile.jit import cached, compiled, inline
from ..kernel.elimination.binding import answers, make_arm, make_forms
from ..kernel.elimination.terms import VERDICT
from ..kernel.kinematics import TAU, aim
from ..kernel.null_space import Bounds, direction
from ..kernel.records import SIZE, Orders, copy, read
from ..kernel.serial import make_serial
from .closed_form.geometry import Screws, read_revolute
from .plan import Plan
from .task import POSES

N = 7


@compiled
class MotionEnd(NamedTuple):
    """Codes for why a self-motion curve (joint motion that leaves the tip in place) ends."""

    closed: int = 0  # the curve is closed: it has returned to its beginning
    limit: int = 1
    singular: int = 2  # a singular pose, where the next step would be too short
    long: int = 3  # the curve goes on, but following it was ended at the largest number of points


@compiled
class ContinuationConstants(NamedTuple):
    """Constants of the numerical steps along a self-motion; joint values in rad, lengths over the arm's reach."""

    # number of values at which the first or last joint is fixed; the solutions of the other six are points on self-motions
    slices: int = 64
    longest: float = 0.1  # longest step [norm of the joint motion, rad]
    shortest: float = 1e-6  # shortest step [rad]; a curve that needs a shorter one ends at a singular pose
    # smallest cosine of the angle by which the curve may turn within one step; if it turns more, the step is shortened
    straight: float = 0.99
    newton: int = 8  # largest number of Newton steps that correct a point so that the tip is at its target again
    closed: float = 1e-22  # squared pose error at which the Newton steps of a correction end
    damping: float = 1e-12  # damping of the Newton steps of a correction
    # a joint whose component of the unit tangent is below `level` counts as standing still, so it reverses at that very point
    level: float = 1e-5
    same: float = 1e-6  # [rad] a known solution lies on the curve if its distance from the curve is smaller
    # Near a singular pose the steps may switch to another, closed curve, which never returns to the first point. So the curve also
    # counts as closed if it returns to its point number `past`, 2 `past`, 4 `past`, ...
    past: int = 64
    halvings: int = 40  # number of bisections that locate an end of a curve
    points: int = 2000  # highest number of points of a curve in each direction


END, FOLLOWING = MotionEnd(), ContinuationConstants()


class SelfMotion(NamedTuple):
    """A self-motion within the limits: a curve of joint values along which the arm moves while its tip stays."""

    points: np.ndarray  # (M, 7) [rad], joint values modulo 2 pi; the points where a joint reverses are among them
    lower: np.ndarray  # (7,) least value of each joint on the curve, at an end or where the joint reverses (a fold)
    upper: np.ndarray  # (7,) largest value of each joint on the curve
    ends: tuple[tuple[int, int], ...]  # for each end its `MotionEnd`, and the joint that is at its limit there, or -1


@inline
def onto_pose(p):
    """Correct p.desk.q by Newton steps until the tip is at the target of the problem p; return whether it is. Sets p.desk.J."""
    s = p.desk
    for _ in range(FOLLOWING.newton):
        e = p.evaluate(s.q)
        p.jacobian(e)
        if e.linear.square() + e.angular.square() < FOLLOWING.closed:
            return True
        for i in range(N):
            s.w[i] = 1.0
        p.damped(e, FOLLOWING.damping)
        for i in range(N):
            s.q[i] += s.dq[i]
    return False


@inline
def direction_at(p, box, t, u):
    """Write to u (7,) the unit tangent of the self-motion at p.desk.q that is nearest direction t (7,); return the cosine u . t."""
    s, size, cosine = p.desk, 0.0, 0.0
    for i in range(N):
        s.w[i] = 1.0
    direction(p, t, box)
    for i in range(N):
        size += s.dq[i] * s.dq[i]
    size = max(math.sqrt(size), 1e-300)
    for i in range(N):
        u[i] = s.dq[i] / size
        cosine += u[i] * t[i]
    return cosine


@inline
def step_along(p, box, q, t, h, x, u):
    """Fill x and u (7,) with the point a step h [rad] along tangent t from q, and its tangent; False if the curve bends much."""
    for i in range(N):
        p.desk.q[i] = q[i] + h * t[i]
    if not onto_pose(p):
        return False
    far = 0.0
    for i in range(N):
        x[i] = p.desk.q[i]
        far += (x[i] - q[i]) ** 2
    return far <= (1.1 * h + FOLLOWING.shortest) ** 2 and direction_at(p, box, t, u) >= FOLLOWING.straight


@inline
def passes(p, box, q, t, h, point, x, u):
    """Return whether a point (7,), modulo 2 pi, lies on a self-motion between q (7,) and the end of a step h [rad] along t (7,)."""
    off, a = 0.0, 0.0
    for i in range(N):
        d = point[i] - q[i]
        d -= TAU * np.rint(d / TAU)
        off += d * d
        a += d * t[i]
    if off > (1.5 * h) ** 2 or a < -0.1 * h or a > 1.1 * h:
        return False
    for _ in range(6):
        if not step_along(p, box, q, t, a, x, u):
            return False
        worst, more = 0.0, 0.0
        for i in range(N):
            d = point[i] - x[i]
            d -= TAU * np.rint(d / TAU)
            worst = max(worst, abs(d))
            more += d * t[i]
        if worst < FOLLOWING.same:
            return True
        a += more
    return False


@inline
def turning_point(p, box, q, t, h, i, x, u):
    """Find the point x (7,) within a step h [rad] along t from q where joint i reverses; return the length of the step to it."""
    low, high = 0.0, h
    for _ in range(FOLLOWING.halvings // 2):
        middle = 0.5 * (low + high)
        if step_along(p, box, q, t, middle, x, u) and u[i] * t[i] > 0.0:
            low = middle
        else:
            high = middle
    return low


@cached
def follow(rows, ends, opt, T, start, sign, seeds, seen, out):
    """Follow a self-motion from `start` (7,) in one direction, ignoring limits, and list its points.

    The solutions `seeds` that the curve passes are marked in `seen`. Every point where a joint reverses is added, so that each
    joint moves monotonically from point to point. rows, ends, opt: geometry, limits and options of a plan's chain; T (4, 4):
    target [m]; sign: 1 for the direction of `first_direction`, -1 for the other; seeds (S, 7): solutions [rad]; seen (S,): 1 for
    those on a curve found so far. The curve is written to out (points, 7). Returns the first and the last + 1 of its points, and
    the reason (`MotionEnd`) why it ends there.
    """
    p = make_serial(rows, ends, opt[SIZE.orders :], N, read(Orders, opt))
    aim(p.ends, T, p.goal)
    places, vectors = np.zeros((3, N)), np.zeros((6, N))
    places[0], places[1] = -np.inf, np.inf
    box = Bounds(places)
    q, t, x, u, y, v = vectors[0], vectors[1], vectors[2], vectors[3], vectors[4], vectors[5]
    copy(start, p.desk.q)
    onto_pose(p)
    copy(p.desk.q, q)
    copy(q, out[0])
    first_direction(p, box, y, v, t)
    for i in range(N):
        t[i] *= sign
    size, past, h = 1, FOLLOWING.past, FOLLOWING.longest
    while size < out.shape[0]:
        if not step_along(p, box, q, t, h, x, u):
            h *= 0.5
            if h < FOLLOWING.shortest:
                return 0, size, END.singular
            continue
        step = h
        for i in range(N):
            if u[i] * t[i] < 0.0 and min(abs(u[i]), abs(t[i])) > FOLLOWING.level:
                step = min(step, turning_point(p, box, q, t, step, i, y, v))
        if step < h:
            step_along(p, box, q, t, step, x, u)
        for k in range(seeds.shape[0]):
            if seen[k] == 0 and passes(p, box, q, t, step, seeds[k], y, v):
                seen[k] = 1
        # If the curve is back at an earlier point that is not the first, the steps have switched to another, closed curve near a
        # singular pose. Only that curve is kept.
        for known in (0, past):
            if size > known + 3 and passes(p, box, q, t, step, out[known], y, v):
                copy(y, out[size])
                return known, size + 1, END.closed
        copy(x, out[size])
        size += 1
        if size == 2 * past:
            past = size - 1
        copy(x, q)
        copy(u, t)
        h = min(1.5 * h, FOLLOWING.longest)
    return 0, size, END.long


@inline
def first_direction(p, box, y, v, start):
    """Write to start (7,) the unit tangent of the self-motion at p.desk.q, largest component positive; y, v (7,): scratch."""
    best = -1.0
    for i in range(N):
        for k in range(N):
            y[k] = 1.0 if k == i else 0.0
        direction_at(p, box, y, v)
        # Each joint's unit vector is projected onto the null space. The longest projection is taken, because that of a joint which
        # hardly moves is mostly rounding error.
        if p.desk.dq[i] > best:
            best = p.desk.dq[i]
            copy(v, start)


@cached
def cross(rows, ends, opt, T, a, b, i, value, y):
    """Write to y (7,) the point of a self-motion between a and b where joint i has `value`; return its place on the way, 0..1."""
    p = make_serial(rows, ends, opt[SIZE.orders :], N, read(Orders, opt))
    aim(p.ends, T, p.goal)
    low, high = 0.0, 1.0
    for _ in range(FOLLOWING.halvings):
        middle = 0.5 * (low + high)
        for k in range(N):
            p.desk.q[k] = a[k] + middle * (b[k] - a[k])
        onto_pose(p)
        if (p.desk.q[i] < value) == (a[i] < value):
            low = middle
        else:
            high = middle
    copy(p.desk.q, y)
    return low


def arcs(points: np.ndarray, stops: list[int], limits: np.ndarray, crossing: Any) -> list[SelfMotion]:
    """Cut a self-motion, given by points (M, 7) [rad], at the joint limits (2, 7) [rad]; return the parts inside the limits.

    stops: why the curve ends on both sides (`MotionEnd`). A limit shifted by 2 pi k is also a limit. crossing(a, b, joint,
    value): function that finds the point between a and b where the joint has that value; it returns how far along the way the
    point lies (0 to 1), then the point.
    """
    half = 0.5 * (limits[1] - limits[0])
    middle = np.where(np.isfinite(half), limits[0], 0.0) + np.where(np.isfinite(half), half, 0.0)

    def off(x: np.ndarray) -> np.ndarray:
        """Return the difference of each joint from the middle of its range, modulo 2 pi in [-pi, pi)."""
        return (x - middle + np.pi) % TAU - np.pi

    def curve(points: np.ndarray, ends: tuple) -> SelfMotion:
        """Return points (M, 7) of a self-motion as a SelfMotion, shifted by 2 pi k inside the limits, or nearest 0."""
        turns = np.rint((0.5 * (points.min(axis=0) + points.max(axis=0)) - middle) / TAU)
        points = points - TAU * turns
        return SelfMotion(points, points.min(axis=0), points.max(axis=0), ends)

    # Within one step a joint may cross all angles outside its limits. Two points outside the limits are then added, so that the
    # curve is cut there.
    rows, outer = [points[0]], 0.5 * (half + np.pi)
    for a, b in pairwise(points):
        passed = np.flatnonzero((half < np.pi) & (np.abs(off(b) - off(a)) > np.pi)).tolist()
        both = [(i, c[i] - off(c)[i] + np.copysign(outer[i], off(c)[i])) for i in passed for c in (a, b)]
        beyond = sorted((crossing(a, b, i, value) for i, value in both), key=itemgetter(0))
        rows += [*(y for _, y in beyond), b]
    points = np.array(rows)
    if stops[0] == END.closed:
        wrong = np.flatnonzero((np.abs(off(points)) > half).any(axis=1))
        if not len(wrong):
            return [curve(points, ((END.closed, -1),) * 2)]
        turns = TAU * np.rint((points[-1] - points[0]) / TAU)
        # A closed curve has no ends, so its list of points is rotated to begin at one outside the limits, where it is cut anyway.
        points = np.vstack([points[wrong[0] :], points[1 : wrong[0] + 1] + turns])
    aside = off(points)
    bad = np.abs(aside) > half

    def at_limits(k: int, place: int) -> Iterator[tuple[float, np.ndarray, tuple[int, int]]]:
        """Yield (place on the way from k to k + 1, q, (END.limit, joint)) where a joint beyond a limit at `place` crosses it."""
        for i in np.flatnonzero(bad[place]).tolist():
            value = points[place, i] - aside[place, i] + np.copysign(half[i], aside[place, i])
            yield *crossing(points[k], points[k + 1], i, value), (END.limit, i)

    made, part, came = [], [], (stops[0], -1)
    for k in range(len(points) - 1):
        if (bad[k] & bad[k + 1]).any():
            continue
        enter = max(at_limits(k, k), key=itemgetter(0), default=(0.0, points[k], (stops[0], -1)))
        leave = min(at_limits(k, k + 1), key=itemgetter(0), default=(1.0, points[k + 1], (stops[-1], -1)))
        if enter[0] > leave[0]:
            continue
        if k == 0 or bad[k].any():
            part, came = [enter[1]], enter[2]
        part.append(leave[1])
        if k == len(points) - 2 or bad[k + 1].any():
            made.append(curve(np.array(part), (came, leave[2])))
    return made


class Slicing(NamedTuple):
    """A seven-joint arm with its first or last joint fixed, so that the solver for six revolute joints applies."""

    joint: int  # index of the joint that is fixed: 0 (first) or 6 (last)
    screws: Screws
    arm: np.ndarray  # (52,) geometry of the six other joints, as `make_arm` returns it
    forms: np.ndarray  # orderings of the closed loop of the six joints for the elimination, best first (`make_forms`)


def slicings_of(plan: Plan) -> list[Slicing]:
    """Return up to two ways to solve a seven-joint arm with a six-joint solver (first or last joint fixed); [] if impossible."""
    if "slicing" not in plan.memo:
        plan.memo["slicing"] = _slicings(plan)
    return plan.memo["slicing"]


def _slicings(plan: Plan) -> list[Slicing]:
    robot, o = plan.robot, plan.options
    if robot.n != N or robot.pose_shape != (4, 4) or o.in_part or o.priority is not None or len(plan.held):
        return []
    screws = read_revolute(robot.chain, N)
    if isinstance(screws, str):
        return []
    found, rng = [], np.random.default_rng(0)
    T = robot.chain.forward(rng.uniform(-np.pi, np.pi, (16, N)))[0].reshape(-1, 4, 4)
    for joint, others in ((N - 1, slice(0, N - 1)), (0, slice(1, N))):
        arm = make_arm(screws.axis[others], screws.point[others], screws.T)
        forms = make_forms(arm)
        if len(forms) and (answers(forms, arm, T)[:, 0, 1] == VERDICT.certain).mean() > 0.5:
            found.append(Slicing(joint, screws, arm, forms))
    return found


def sliced(cut: Slicing, T: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return the poses (K, 4, 4) that the six other joints must reach if the fixed joint has these values (K,) [rad]."""
    axis, point = cut.screws.axis[cut.joint], cut.screws.point[cut.joint]
    cross = np.cross(np.eye(3), axis)
    s, c = -np.sin(values)[:, None, None], np.cos(values)[:, None, None]
    back = np.tile(np.eye(4), (len(values), 1, 1))
    back[:, :3, :3] += s * cross + (1.0 - c) * cross @ cross
    back[:, :3, 3] = point - back[:, :3, :3] @ point
    return back @ T if cut.joint == 0 else T @ np.linalg.inv(cut.screws.T) @ back @ cut.screws.T


def self_motions(plan: Plan, T: np.ndarray, slices: int = FOLLOWING.slices) -> list[SelfMotion]:
    """Find self-motions of a seven-joint arm at T (4, 4) inside the limits: those that solutions with a fixed joint lie on.

    The first or last joint is fixed at `slices` values in turn. Self-motions along which it takes none of them are missed.
    """
    cuts, limits = slicings_of(plan), plan.box
    limits = np.where(limits[1] - limits[0] >= TAU, [[-np.inf], [np.inf]], limits)  # a full turn covers every angle
    values, found = (np.arange(slices) + 0.5) / slices * TAU - np.pi, []
    for cut in cuts:
        said = answers(cut.forms, cut.arm, sliced(cut, T, values))
        count = said[:, 0, 0].astype(int)
        Q = np.vstack([said[k, 1 : 1 + count[k], : N - 1] for k in range(slices)])
        found.append(np.insert(Q, cut.joint, np.repeat(values, count), axis=1))
    seeds = np.vstack(found)
    seen, curves, arrays = np.zeros(len(seeds)), [], (*plan.chain[:2], plan.orders(POSES, True), T)
    out, y = np.empty((FOLLOWING.points, N)), np.empty(N)

    def crossing(*where: Any) -> tuple[float, np.ndarray]:
        return cross(*arrays, *where, y), y.copy()

    while not seen.all():
        start, parts, stops = int(np.argmin(seen)), [], []
        seen[start] = 1
        for sign in (1.0, -1.0):
            first, end, stop = follow(*arrays, seeds[start], sign, seeds, seen, out)
            parts.append(out[first:end].copy())
            stops.insert(0, stop)
            if stop == END.closed:
                break
        points = parts[-1] if stops[0] == END.closed else np.vstack([parts[1][:0:-1], parts[0]])
        found = arcs(points, stops, limits, crossing)
        curves += [one for one in found if not any(_same(one, other) for other in curves)]
    return curves


def _same(one: SelfMotion, other: SelfMotion) -> bool:
    """Return whether two curves have the same range in every joint, and the first passes where the other begins."""
    if max(np.abs(one.lower - other.lower).max(), np.abs(one.upper - other.upper).max()) > 10.0 * FOLLOWING.same:
        return False
    apart = np.abs((one.points - other.points[0] + np.pi) % TAU - np.pi)
    return bool(apart.max(axis=1).min() < FOLLOWING.longest)
