"""Solutions carried along a sequence of poses: from a solution of one pose to one of the next, by continuation.

A step is the least joint motion that brings the tip along (the last configuration is the prediction, the damped steps of
`refine.correct` the correction). It counts only where the joints move less than they may and the tip, the joints being moved
in a straight line, stays by the straight line between the poses; otherwise it is halved. So what is joined here is one motion,
never two solutions that happen to be close.
"""

import math

import numpy as np

from .algebra import V3
from .jit import cached, inline, inner, spliced
from .problem import NOW
from .records import HEAD, TASK, Orders, copy, read
from .refine import Bounds, correct
from .search import problem

SHORTEST = 1.0 / 256  # share of the distance between two poses below which a step is not halved again
TURNED = 1e-12  # sine of an angle between two poses below which there is nothing to turn


@inner
def blend(flat, a, b, s, out):
    """Write to out (F, 16) the poses a share s of the way from flat[a] to flat[b] (N, F, 16): straight, and about one axis."""
    for f in range(out.shape[0]):
        A, B, C = flat[a, f], flat[b, f], out[f]
        for k in range(16):
            C[k] = A[k] + s * (B[k] - A[k])
        if s == 0.0 or s == 1.0:
            continue
        sine, cosine = V3(0.0, 0.0, 0.0), -1.0
        for k in range(3):
            x, y = V3(A[k], A[4 + k], A[8 + k]), V3(B[k], B[4 + k], B[8 + k])
            sine, cosine = sine + x.cross(y), cosine + x.dot(y)
        length = math.sqrt(sine.square())
        if length < TURNED:
            for k in range(3):
                C[k], C[4 + k], C[8 + k] = A[k], A[4 + k], A[8 + k]
            continue
        axis = sine * (1.0 / length)
        angle = s * math.atan2(length, cosine)
        c, d = math.cos(angle), math.sin(angle)
        for k in range(3):
            x = V3(A[k], A[4 + k], A[8 + k])
            x = x * c + axis.cross(x) * d + axis * (axis.dot(x) * (1.0 - c))
            C[k], C[4 + k], C[8 + k] = x.x, x.y, x.z


@inline
def within(q, old, most):
    """Whether no joint has moved further than it may."""
    for i in range(q.shape[0]):
        if not abs(q[i] - old[i]) <= most[i]:
            return False
    return True


@spliced
def advance(p, o, weights, box, flat, pose, sheet, a, b, most, deviation, old, new):
    """Move p.desk.q from a solution of pose a to one of pose b; False where there is no continuous motion."""
    q = p.desk.q
    copy(q, old)
    done, part = 0.0, 1.0
    while done < 1.0:
        part = min(part, 1.0 - done)
        blend(flat, a, b, done + part, sheet)
        fine = p.aim(pose, o) == 0.0
        if fine:
            e = correct(p, weights, box)
            fine = e.good and within(q, old, most)
        if fine:
            copy(q, new)
            for i in range(q.shape[0]):
                q[i] = 0.5 * (old[i] + new[i])
            blend(flat, a, b, done + 0.5 * part, sheet)
            p.aim(pose, o)
            e = p.evaluate(q)
            p.keep(e, NOW)
            position, rotation = p.left(NOW)
            fine = position <= deviation[0] and rotation <= deviation[1]
        if fine:
            copy(new, q)
            copy(new, old)
            done += part
            part *= 2.0
        else:
            copy(old, q)
            part *= 0.5
            if part < SHORTEST:
                return False
    return True


@cached
def extend(rows, ends, T, orders, limits, most, deviation, seeds, at, columns, Q, span):
    """Carry seeds (M, n), solutions of the poses at (M,), along all poses T (N, 4, 4) or (N, F, 4, 4), both ways.

    Kernel units throughout: limits (3, n) lower, upper, whether there are both; most (n,): largest step of a joint.
    deviation (2,) [m], [rad]: of the tip between poses. Track m goes to Q[:, columns[m]] (N, K, n), the first and the last pose
    it reaches to span[columns[m]].
    """
    n, N = seeds.shape[1], T.shape[0]
    o = read(Orders, orders)
    first = HEAD + TASK * (ends.size // ends.shape[-1])
    p = problem(rows, ends, orders[HEAD:first], n, o)
    weights = orders[first : first + n]
    box = Bounds(limits)
    flat = T.reshape(N, T[0].size // 16, 16)
    pose = np.empty_like(T[0])
    sheet = pose.reshape(T[0].size // 16, 16)
    old, new = np.empty(n), np.empty(n)
    q = p.desk.q
    for m in range(seeds.shape[0]):
        start, k = at[m], columns[m]
        span[k, 0], span[k, 1] = start, start
        for way in (-1, 1):
            copy(seeds[m], q)
            t = start
            while 0 <= t + way < N:
                if not advance(p, o, weights, box, flat, pose, sheet, t, t + way, most, deviation, old, new):
                    break
                t += way
                for i in range(n):
                    Q[t, k, i] = q[i]
            span[k, 0 if way < 0 else 1] = t
        for i in range(n):
            Q[start, k, i] = seeds[m, i]
