"""How fast pairs of parts can come closer: bounds for a whole motion, and half-planes for one step.

V (E, 6): velocity of each moving joint per unit of its coordinate, of the point at the root's origin (3) and the turn (3).
coordinates (E,): joint of q behind each, from the root outwards. by_a, by_b (P, E): whether it moves only the first part of a
pair, or only the second.
"""

import math

import numpy as np

from .algebra import V3, at3
from .jit import cached, inner


@inner
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
