"""Bounds on how fast pairs of shapes can approach each other: for a whole motion, and as linear constraints for one step."""

import math
from typing import NamedTuple

import numpy as np

from ..compile.jit import cached, dual, inline
from .algebra import at3, put3
from .vectors import dot, largest

# To prove that a piece of a motion is free of contact, it is halved as often as needed. If a part smaller than this share of a
# piece would be needed, the proof stops there, and the caller measures the distances again.
FINEST = 1.0 / 64.0


class Bodies(NamedTuple):
    """The shapes of a scene, the pairs of them that may touch, and the moving joints, at one configuration.

    There are S shapes, P pairs and E joints; all vectors are in the axes of the robot's root frame.
    """

    # (E, 6) spatial twist per unit rate of each joint: velocity (3) of the body's point that is at the root's origin, angular
    # velocity (3)
    V: np.ndarray
    coordinates: np.ndarray  # (E,) index in q of each joint, from the root outwards
    middle: np.ndarray  # (S, 3) centres [m] of the spheres around the shapes
    radius: np.ndarray  # (S,) radii [m] of the spheres
    a: np.ndarray  # (P,) index of the first shape of each pair
    b: np.ndarray  # (P,) index of the second shape of each pair
    by_a: np.ndarray  # (P, E) whether a joint moves only the first shape of a pair
    by_b: np.ndarray  # (P, E) whether a joint moves only the second shape of a pair


class NearPairs(NamedTuple):
    """Pairs of shapes whose nearest points are known, one row for each pair."""

    ks: np.ndarray  # (K,) indices of the pairs in `Bodies`
    points: np.ndarray  # (K, 2, 3) nearest points [m] of the first and the second shape, root axes
    gap: np.ndarray  # (K,) distance [m] by which the pair may still approach


class Approach(NamedTuple):
    """Thresholds for how fast a pair of shapes may approach."""

    slope: float  # [1/s] a pair may approach at most at this rate times its gap
    step: float  # [s] length of a control step, in which a pair may use up at most half of its gap
    # A joint is one of those that brake a pair if its effect on the distance, per unit, exceeds this share of the largest effect of
    # any joint.
    share: float
    flat: float  # A pair is left out if no joint changes its distance by more than this per unit [m/rad or m/m].


class HalfPlanes(NamedTuple):
    """Linear constraints A x <= b on the joint rates x, the most restrictive one first."""

    A: np.ndarray  # (R, n) speed of approach of a pair per unit of each joint rate
    b: np.ndarray  # (R,) highest speed [m/s] at which the pair may approach
    order: np.ndarray  # (R,) row of `NearPairs` that each constraint belongs to


class Separation(NamedTuple):
    """Pairs of shapes whose distance and direction are known at one configuration of a motion, one row a pair."""

    ks: np.ndarray  # (K,) indices of the pairs in `Bodies`
    normals: np.ndarray  # (K, 3) unit vectors from the first to the second shape, zero where a shape is not convex
    distances: np.ndarray  # (K,) distances of the pairs [m]


class BrakingPath(NamedTuple):
    """A motion of the joints, such as braking to rest, cut into N pieces of equal duration."""

    Q: np.ndarray  # (N + 1, n) joint values at the ends of the pieces
    R: np.ndarray  # (N + 1, n) joint rates at the ends of the pieces
    L: np.ndarray  # (N + 1, n) length that each joint has travelled since the start, in both directions
    gamma: float  # 1 if joints move at a constant rate in a piece; less than 1 if the rate changes linearly
    h: float  # [s] duration of a piece


@dual
def travelled(start, change, f):
    """Return the length that a joint has travelled, in both directions, at the fraction f (0 to 1) of a piece of a motion.

    The joint's speed is `start` at first and changes linearly by `change` over the piece [per duration of the piece].
    """
    there = start * f + 0.5 * change * f * f
    turn = -start / change if change != 0.0 else -1.0
    if 0.0 < turn < f:  # The joint reverses within the piece, so the lengths there and back are added.
        far = 0.5 * start * turn
        return abs(far) + abs(there - far)
    return abs(there)


@dual
def speed_and_growth(Q, R, k, j, gamma, h):
    """Return the rate of joint j at the start of piece k of a motion, and by how much the rate changes over the piece.

    Both are moves per duration of the piece, not per second. Q, R, gamma and h are fields of the motion, see `BrakingPath`.
    """
    move = Q[k + 1, j] - Q[k, j]
    start = move if gamma == 1.0 else h * R[k, j]
    return start, 2.0 * (move - start)


@dual
def position(Q, R, L, k, j, gamma, h, f):
    """Return the value of joint j at the fraction f (0 to 1) of piece k of a motion, and the length it has travelled by then.

    Q, R, L, gamma and h are fields of the motion, see `BrakingPath`.
    """
    start, change = speed_and_growth(Q, R, k, j, gamma, h)
    return Q[k, j] + start * f + 0.5 * change * f * f, L[k, j] + travelled(start, change, f)


@cached
def along(Q, R, L, gamma, h, u, q, length) -> None:
    """Write to q (n,) the joint values after u pieces of a motion, and to length (n,) how far each joint has travelled by then.

    u may be a fraction. Q, R, L, gamma and h are fields of the motion, see `BrakingPath`.
    """
    k = min(int(u), Q.shape[0] - 2)
    for j in range(q.shape[0]):
        q[j], length[j] = position(Q, R, L, k, j, gamma, h, u - k)


@inline
def speed_at(V, e, point):
    """Return the velocity of a point (V3, root axes) per unit rate of joint e; V: (E, 6) twists, see `Bodies`."""
    return at3(V[e], 0) + at3(V[e], 3).cross(point)


@cached
def levers(parts, way, out, spread) -> None:
    """Write to out (P, E) how much closer each pair of shapes can come at most per unit of each joint.

    The bound holds while no joint moves further than `way`. It is the joint's lever arm: the distance from its axis to the far side
    of the shape's bounding sphere, plus how far the later joints can move the shape.

    Args:
        parts: `Bodies` where the motion starts.
        way: (n,) largest move of each joint [rad or m].
        out: (P, E) receives how much closer each pair can come per unit of each moving joint.
        spread: (P,) receives how much closer each pair can come through the moves of all joints together [m].
    """
    V, coordinates, middle, radius, a, b, by_a, by_b = parts
    E = V.shape[0]
    own = np.empty((middle.shape[0], E))
    turn = np.empty(E)
    for e in range(E):
        turn[e] = math.sqrt(at3(V[e], 3).square())
        for s in range(middle.shape[0]):
            own[s, e] = math.sqrt(speed_at(V, e, at3(middle[s], 0)).square()) + turn[e] * radius[s]
    for p in range(a.shape[0]):
        spread[p] = 0.0
        for e in range(E):
            out[p, e] = 0.0
        for side in range(2):
            s = a[p] if side == 0 else b[p]
            moved = by_a[p] if side == 0 else by_b[p]
            later = 0.0
            for e in range(E - 1, -1, -1):
                if moved[e]:
                    lever = own[s, e] + turn[e] * later
                    later += lever * way[coordinates[e]]
                    out[p, e] += lever
            spread[p] += later


@cached
def rows(parts, facing, rate, deceleration, rules, planes) -> int:
    """Write the linear constraints on the joint rates under which pairs of shapes can still brake before they touch.

    Three bounds limit the speed at which a pair approaches: `rules.slope` times its gap, half of its gap in a control step, and,
    for each joint that takes part in the braking, the speed that this joint can bring to zero within the gap.

    Args:
        parts: `Bodies` at the current configuration.
        facing: The pairs, as `NearPairs`.
        rate: (n,) current joint rates [rad/s or m/s].
        deceleration: (n,) braking deceleration of the joints [rad/s^2 or m/s^2].
        rules: Thresholds, as `Approach`.
        planes: `HalfPlanes`, filled from the first row on.

    Returns:
        How many constraints were written.
    """
    V, coordinates, by_a, by_b = parts.V, parts.coordinates, parts.by_a, parts.by_b
    ks, points, gap = facing
    slope, step, share, flat = rules
    A, b, order = planes
    K, n = ks.shape[0], A.shape[1]
    all_rows, bounds, room = np.zeros((K, n)), np.empty(K), np.empty(K)
    for r in range(K):
        row, first, second = all_rows[r], at3(points[r, 0], 0), at3(points[r, 1], 0)
        normal = second - first
        normal = normal * (1.0 / max(math.sqrt(normal.square()), 1e-300))
        for e in range(V.shape[0]):
            if by_a[ks[r], e]:
                row[coordinates[e]] += normal.dot(speed_at(V, e, first))
            elif by_b[ks[r], e]:
                row[coordinates[e]] -= normal.dot(speed_at(V, e, second))
        most, weakest = largest(row), np.inf
        for j in range(n):
            size = abs(row[j])
            if size > share * most:
                weakest = min(weakest, size * deceleration[j])
        bounds[r] = gap[r] * min(slope, 0.5 / step)
        if gap[r] > 0.0:
            bounds[r] = min(bounds[r], math.sqrt(2.0 * weakest * gap[r]))
        room[r] = bounds[r] - dot(row, rate, n) if most > flat else np.inf
    count = 0
    while count < A.shape[0]:
        best = -1
        for r in range(K):
            if room[r] < np.inf and (best < 0 or room[r] < room[best]):
                best = r
        if best < 0:
            break
        room[best] = np.inf
        A[count], b[count], order[count] = all_rows[best], bounds[best], best
        count += 1
    return count


@dual
def second_order_motion(turn, lever, moved, length):
    """Return a bound [m] on the second-order part of a body's motion, which its Jacobian at the start does not predict.

    turn (E,): angular speed per unit of each joint; lever (E,): lever arms of the joints; moved (E,): whether a joint moves the
    body; length (E,): how far the joints move.
    """
    total, before = 0.0, 0.0
    for e in range(length.shape[0]):
        if moved[e]:
            total += lever[e] * length[e] * (before + 0.5 * turn[e] * length[e])
            before += turn[e] * length[e]
    return total


@cached
def free_until(parts, pairs, levers, path, start, out) -> None:
    """Find how far along a path each pair is proven free of contact.

    Two convex shapes cannot touch before they have approached along the normal of a plane between them by their
    distance. The approach is bounded by the velocities at the start times the joint moves, plus a second-order bound on
    the curvature of the motion. For shapes that are not convex (their normal is zero) the approach is bounded by the
    lengths that the joints travel, times their lever arms.

    Args:
        parts: `Bodies` at the point `start` of the path.
        pairs: `Separation` of K pairs at that point.
        levers: (P, E) from the function `levers`, for the whole path.
        path: `BrakingPath`.
        start: Where the proof begins, in pieces from the beginning of the path; may be a fraction.
        out: (K,) receives where each pair's proof ends [pieces].
    """
    V, coordinates, middle, radius, a, b, by_a, by_b = parts
    ks, normals, distances = pairs
    Q, R, L, gamma, h = path
    E, last = V.shape[0], Q.shape[0] - 1
    first = min(int(start), last - 1)
    rate, turn, swing = np.empty(E), np.empty(E), np.empty((2, 3 * E))
    size = np.empty(E)
    begun, gone, length = np.empty(E), np.empty(E), np.empty(E)
    for e in range(E):
        turn[e] = math.sqrt(at3(V[e], 3).square())
        j = coordinates[e]
        begun[e], gone[e] = position(Q, R, L, first, j, gamma, h, start - first)
    for r in range(ks.shape[0]):
        p = ks[r]
        normal = at3(normals[r], 0)
        flat = normal.square() == 0.0
        for e in range(E):
            swung = normal.cross(at3(V[e], 3))
            moved_a, moved_b = 1.0 if by_a[p, e] else 0.0, 1.0 if by_b[p, e] else 0.0
            rate[e] = moved_a * normal.dot(speed_at(V, e, at3(middle[a[p]], 0)))
            rate[e] -= moved_b * normal.dot(speed_at(V, e, at3(middle[b[p]], 0)))
            put3(swing[0], 3 * e, swung * (moved_a * radius[a[p]]))
            put3(swing[1], 3 * e, swung * (moved_b * radius[b[p]]))
            spread = moved_a * radius[a[p]] + moved_b * radius[b[p]]
            size[e] = abs(rate[e]) + spread * math.sqrt(swung.square())
        k, f0, share, done = first, start - first, 1.0, start
        before = 0.0  # bound [m] on how much closer the pair has come so far
        while done < last and share >= FINEST:
            f = min(1.0, f0 + share)
            way, curve, closing = 0.0, 0.0, 0.0
            turned_a, turned_b = normal * 0.0, normal * 0.0
            for e in range(E):
                there, by_then = position(Q, R, L, k, coordinates[e], gamma, h, f)
                move, length[e] = there - begun[e], by_then - gone[e]
                way += levers[p, e] * length[e]
                closing += rate[e] * move
                turned_a = turned_a + at3(swing[0], 3 * e) * move
                turned_b = turned_b + at3(swing[1], 3 * e) * move
                # Between any two points of a piece, a joint deviates from motion at a constant rate by at most 1/8 of the change of
                # its rate over the piece (in moves per piece).
                curve += 0.125 * abs(speed_and_growth(Q, R, k, coordinates[e], gamma, h)[1]) * size[e]
            closing += math.sqrt(turned_a.square()) + math.sqrt(turned_b.square())
            bent = second_order_motion(turn, levers[p], by_a[p], length) + second_order_motion(
                turn, levers[p], by_b[p], length
            )
            if way < distances[r] or (not flat and max(closing, before) + curve + bent < distances[r]):
                before, done = closing, k + f
                k, f0 = (k + 1, 0.0) if f == 1.0 else (k, f)
            else:
                share *= 0.5
        out[r] = done
