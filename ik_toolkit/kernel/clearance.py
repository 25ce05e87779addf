"""How fast pairs of parts can come closer: bounds for a whole motion, and half-planes for one step.

V (E, 6): velocity of each moving joint per unit of its coordinate, of the point at the root's origin (3) and the turn (3).
coordinates (E,): joint of q behind each, from the root outwards. by_a, by_b (P, E): whether it moves only the first part of a
pair, or only the second.
"""

import math

import numpy as np

from ..compile.jit import cached, dual, inline
from .algebra import at3, put3

FINEST = 1.0 / 64.0  # of a piece: what cannot be proven in parts of this size needs a new measurement


@dual
def travelled(start, change, f):
    """How far a joint has gone a fraction f into a piece: its speed grows evenly from `start` by `change` [per piece]."""
    there = start * f + 0.5 * change * f * f
    turn = -start / change if change != 0.0 else -1.0
    if 0.0 < turn < f:  # it reverses on the way
        far = 0.5 * start * turn
        return abs(far) + abs(there - far)
    return abs(there)


@dual
def speed_and_growth(Q, R, k, j, gamma, h):
    """Speed of joint j at the start of piece k and its growth [per piece], as the methods assume (see `interpolate`)."""
    move = Q[k + 1, j] - Q[k, j]
    start = move if gamma == 1.0 else h * R[k, j]
    return start, 2.0 * (move - start)


@dual
def position(Q, R, L, k, j, gamma, h, f):
    """Value of joint j a fraction f into piece k, and how far it has gone by then."""
    start, change = speed_and_growth(Q, R, k, j, gamma, h)
    return Q[k, j] + start * f + 0.5 * change * f * f, L[k, j] + travelled(start, change, f)


@cached
def along(Q, R, L, gamma, h, u, q, length) -> None:
    """Joint values q (n,) u pieces along a path of `brake`, and how far (n,) each joint has gone by then."""
    k = min(int(u), Q.shape[0] - 2)
    for j in range(q.shape[0]):
        q[j], length[j] = position(Q, R, L, k, j, gamma, h, u - k)


@inline
def speed_at(V, e, point):
    """Velocity of a point when joint e moves."""
    return at3(V[e], 0) + at3(V[e], 3).cross(point)


@cached
def levers(V, coordinates, middle, radius, a, b, by_a, by_b, way, out, spread) -> None:
    """How much closer each pair can come per unit of each moving joint, out (P, E), while joint i goes up to way (n,).

    middle (S, 3), radius (S,): spheres around the shapes; a, b (P,): shapes of the pairs. spread (P,): the sum over all of
    the way. A joint's lever is the distance of its axis from the far end of the sphere now, and grows by as much as the
    joints after it can move the shape.
    """
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
def rows(V, coordinates, by_a, by_b, ks, points, gap, rate, deceleration, slope, step, share, flat, A, b, order) -> int:
    """Half-planes A x <= b (R, n), (R,) for the joint rates x that let pairs ks (K,) still brake; returns how many.

    points (K, 2, 3): nearest points of each pair; gap (K,): distance [m] it may still lose; rate (n,): now; deceleration (n,)
    of the joints. A pair comes closer by at most slope [1/s] times its gap, by half of it in a step [s], and so that all
    joints with a share in it can end it within the gap. The rows that leave the least room come first; order (R,) says of which of
    ks they are. A pair with no entry above flat is left out.
    """
    K, n = ks.shape[0], A.shape[1]
    all_rows, bounds, room = np.zeros((K, n)), np.empty(K), np.empty(K)
    for r in range(K):
        first, second = at3(points[r, 0], 0), at3(points[r, 1], 0)
        normal = second - first
        normal = normal * (1.0 / max(math.sqrt(normal.square()), 1e-300))
        for e in range(V.shape[0]):
            if by_a[ks[r], e]:
                all_rows[r, coordinates[e]] += normal.dot(speed_at(V, e, first))
            elif by_b[ks[r], e]:
                all_rows[r, coordinates[e]] -= normal.dot(speed_at(V, e, second))
        largest, closing = 0.0, 0.0
        for j in range(n):
            largest = max(largest, abs(all_rows[r, j]))
            closing += all_rows[r, j] * rate[j]
        weakest = np.inf
        for j in range(n):
            size = abs(all_rows[r, j])
            if size > share * largest:
                weakest = min(weakest, size * deceleration[j])
        bounds[r] = gap[r] * min(slope, 0.5 / step)
        if gap[r] > 0.0:
            bounds[r] = min(bounds[r], math.sqrt(2.0 * weakest * gap[r]))
        room[r] = bounds[r] - closing if largest > flat else np.inf
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
    """How far a part may be from where its velocities now would take it, after the joints went `length` (second order)."""
    total, before = 0.0, 0.0
    for e in range(length.shape[0]):
        if moved[e]:
            total += lever[e] * length[e] * (before + 0.5 * turn[e] * length[e])
            before += turn[e] * length[e]
    return total


@cached
def free_until(
    V, coordinates, middle, radius, a, b, by_a, by_b, ks, normals, distances, levers, Q, R, L, gamma, h, start, out
) -> None:
    """How far each of the pairs ks (K,) is certainly free along a path of `brake`, out (K,) in pieces, seen from `start` pieces.

    distances (K,) [m] they have, and normals (K, 3), from first to second, at the start; V, middle (S, 3) as in `levers`, there,
    too; levers (P, E) for all of the path. Nothing convex reaches through the plane between two parts before their points have
    come that much closer along its normal: by the velocities at the start times the moves of the joints, and by the bend of
    their ways. A zero normal stands for parts that are not convex: then only the length of the paths counts.
    """
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
        before = 0.0  # how much closer at the place reached so far
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
                # Between two places the motion leaves the straight line by up to an eighth of the speed's change.
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
