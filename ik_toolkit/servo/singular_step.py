"""Joint motion along the directions in which the tip can hardly move: singular poses, and the edge of the reach.

The Jacobian is J = sum over k of sigma_k v_k u_k' (v_k joint, u_k task directions). Along a direction with a small sigma_k the
first order says little, so the second is asked as well: to move by v_k moves the tip by sigma_k u_k + b_k / 2 with b_k =
(dJ/dt along v_k) v_k. Of the squared error left, |e|^2 / 2, the second derivative along v_k is

    H_k = sigma_k^2 - e . b_k

Beyond the edge of the reach the error points outwards and b_k inwards: H_k is large, and the arm slides smoothly to the
closest pose, without ever stepping over it, and no direction is damped where the target can be reached. Where H_k is negative
the error can be closed by bending: at sigma_k = 0, where the first order sees no way, the joints go back to the side they came
from. What a Newton step cannot tell (sigma_k and H_k near 0) is left to the joint's own motion, which fades.

Where a redundant arm is stretched out, two directions of the joints hardly move the tip: bending, and a motion that turns the
bent arm. v_k is any mixture of them and may be another one after every step. While the target is out of reach, v_k is
therefore replaced by the direction in which b_k is largest, and the side is kept along that.
"""

import math
from typing import NamedTuple

from ..compile.jit import inner
from ..kernel.linalg import cholesky, make_rows_orthogonal
from .laws import gram

CLOSE = 0.1  # [reaches, or rad] up to which an error is a vector to within a twentieth
ALONG, BESIDE, BOTH = range(3)  # motions whose curvature is evaluated
SIDE = 0.2  # [s] for which the side is kept from which the joints came to a singular pose: a swing across is shorter


class Weak(NamedTuple):
    """When a direction counts as weak, and what is done along it (tests/servo/test_crossings.py, test_out_of_reach.py).

    Singular values are lengths over the reach, for a radian or a reach of a joint.
    """

    zero: float = 1e-9  # singular value below which a direction does not move to first order
    nothing: float = (
        1e-12  # added to the squares of singular values, which are above lost^2 here: no more than rounding
    )
    clearly: float = 0.1  # component of a unit vector along a direction above which it is clear to which side it points
    known: float = 0.5  # the same of a side that was kept: less is left of another singular pose
    lost: float = 5e-3  # singular value below which a direction is taken out of the task
    bent: float = 0.2  # or share of sigma_k^2, for what is asked times the curvature, above which it is
    fade: float = 0.1  # [s] in which a joint's motion fades along a direction in which nothing moves the tip
    least: float = (
        1e-3  # lambda at sigma_k = 0: what is lost of a motion through a singular pose is of the order of its square
    )
    flat: float = 1e-3  # curvature (reaches over rad^2) below which it counts as zero
    # Share of the way to the closest pose that a step takes: beside a free direction whole ways zigzag, as steepest descent does.
    caution: float = 2.0 / 3.0
    minor: float = (
        0.1  # share of an error that cannot be closed, below which what is left along another direction comes with it
    )
    clear: float = 1e-4  # singular value above which it is clear on which side of the singular pose the joints are


WEAK = Weak()


@inner
def modes(J, near, W, U, sigma):
    """One-sided Jacobi: W (m, n) receives sigma_k v_k by rows, U (m, m) the u_k, sigma (m,).

    near (m, m): the u_k found last, from which few rotations are left, zeros at first; receives these, of length 1 again.
    """
    n, m = J.shape
    known = False
    for c in range(m):
        known = known or near[0, c] != 0.0
    for r in range(m):
        for c in range(m):
            U[r, c] = near[r, c] if known else 1.0 if r == c else 0.0
        for i in range(n):
            W[r, i] = 0.0
            for c in range(m):
                W[r, i] += U[r, c] * J[i, c]
    make_rows_orthogonal(W, U, sigma, 0, m, n)
    for r in range(m):
        sigma[r] = math.sqrt(sigma[r])
        size = 0.0
        for c in range(m):
            size += U[r, c] * U[r, c]
        for c in range(m):
            near[r, c] = U[r, c] / math.sqrt(size)


@inner
def begin_anew(slack, near):
    """Forget the u_k found last where errors may come into the task and leave it: one that is out of it is a mode of its own."""
    some = False
    for k in range(slack.shape[0]):
        some = some or slack[k] > 0.0
    for k in range(slack.shape[0]):
        near[0, k] = 0.0 if some else near[0, k]


@inner
def leave_modes(W, sigma, r, x):
    """Take from x (n,) what moves the tip by other modes than r (-1: by any); returns its length."""
    m, n = W.shape
    for c in range(m):
        if c != r and sigma[c] > WEAK.zero:
            part = 0.0
            for i in range(n):
                part += W[c, i] * x[i]
            part /= sigma[c] * sigma[c]
            for i in range(n):
                x[i] -= part * W[c, i]
    size = 0.0
    for i in range(n):
        size += x[i] * x[i]
    return math.sqrt(size)


@inner
def lost_direction(W, sigma, away, v):
    """Write to v (n,) the joint direction of a mode with sigma_k near 0: `away`, without what moves the tip; False if none."""
    for i in range(v.shape[0]):
        v[i] = away[i]
    leave_modes(W, sigma, -1, v)
    size = leave_modes(W, sigma, -1, v)  # twice is enough (Kahan)
    for i in range(v.shape[0]):
        v[i] = v[i] / size if size > WEAK.zero else 0.0  # a remainder of rounding is not a direction
    return size > WEAK.zero


@inner
def part_along(V, r, x):
    """Component of x (n,) along V_r."""
    part = 0.0
    for i in range(x.shape[0]):
        part += V[i, r] * x[i]
    return part


@inner
def bring_along(V, r, x, value, share):
    """Bring the component of x (n,) along V_r by a share of the way to a value."""
    own = part_along(V, r, x)
    for i in range(x.shape[0]):
        x[i] += share * (value - own) * V[i, r]


@inner
def mode_probe(V, r, rate, part, h, x):
    """Write to x (n,) the motion whose curvature is evaluated: along V_r, of the joints beside it in a step, or both together.

    Returns the rate along V_r.
    """
    own = part_along(V, r, rate)
    for i in range(x.shape[0]):
        x[i] = 0.0
        if part != ALONG:
            x[i] += h * (rate[i] - own * V[i, r])
        if part != BESIDE:
            x[i] += V[i, r]
    return own


@inner
def way_along(sigma, b, E, own, side, home, h):
    """The way y along v_k that sigma y + b y^2 / 2 = E asks for, or gets nearest to; and D, below 0 where it is out of reach.

    There are two, one on each side of the singular pose: the one to which the joints are already moving (own, their way in a
    step); from rest at the singular pose, or with `home`, the one where they came from (side > 0: that is along v_k).
    """
    D, kept = sigma * sigma, own
    if abs(b) > WEAK.flat:
        middle = -sigma / b
        D += 2.0 * b * E
        y, half = middle, math.sqrt(max(D, 0.0)) / abs(b)
        heading = own - middle
        if abs(side) > WEAK.clearly and (home or abs(heading) < WEAK.clearly * half):
            heading = side
        if half > 0.0:
            half = half if heading > 0.0 else -half
            # the second form where the first is a difference of nearly equal numbers
            y = middle + half if middle * half > 0.0 else -2.0 * E / (b * (middle - half))
    else:
        D -= 2.0 * WEAK.flat * abs(E)  # as for the largest curvature that counts as zero
        y = min(max(E / sigma, -sigma / WEAK.flat), sigma / WEAK.flat) if sigma > WEAK.zero else 0.0
        kept *= max(1.0 - h / WEAK.fade, 0.0)
    weight = D if D > 0.0 else -0.5 * D  # second derivative there of the squared error
    return (weight * y + WEAK.least * WEAK.least * kept) / (weight + WEAK.least * WEAK.least), D


@inner
def mode_part(U, r, vector):
    """Part of a vector (m,) along u_r."""
    part = 0.0
    for c in range(vector.shape[0]):
        part += U[r, c] * vector[c]
    return part


@inner
def rest_of(e, part):
    """Length of an error (m,) without its part along one direction."""
    size = 0.0
    for c in range(e.shape[0]):
        size += e[c] * e[c]
    return math.sqrt(max(size - part * part, 0.0))


@inner
def mode_moved(U, r, e, ahead, f, h):
    """Part along u_r of the target's motion in a step: a difference of two errors, except for large ones: those are not vectors."""
    size = 0.0
    for c in range(e.shape[0]):
        size += e[c] * e[c]
    if size > CLOSE * CLOSE:
        return h * mode_part(U, r, f)
    return mode_part(U, r, ahead) - mode_part(U, r, e)


@inner
def mode_direction(W, sv, r, away, way, v):
    """Write v_r to v (n,); False where there is no direction to move along."""
    if sv[r] > WEAK.zero:
        for i in range(v.shape[0]):
            v[i] = W[r, i] / sv[r]
        return True
    for i in range(v.shape[0]):
        v[i] = 0.0
    return abs(way) > WEAK.zero and lost_direction(W, sv, away, v)


@inner
def begin_bent(W, V, sigma, r, away, x):
    """Write to x (n,) the direction along which the slope of a mode is taken, see `bent_direction`: v_r, or what is known of it."""
    for i in range(x.shape[0]):
        x[i] = away[i]
    size = leave_modes(W, sigma, r, x)
    for i in range(x.shape[0]):
        x[i] = x[i] / size if size > WEAK.known else V[i, r]


@inner
def bent_direction(W, V, sigma, r, slope):
    """Let V_r be the direction along which the tip's way is bent; returns the singular value along it.

    Where sigma_r is next to nothing a redundant arm has a second direction as good as v_r, and v_r turns from the one to the other
    with the smallest motion. Only along the bent one can the tip get nearer. It is that of slope (n,), the curvature along u_r of
    motions along the direction of `begin_bent` and each joint: one step of a power iteration.
    """
    size = leave_modes(W, sigma, r, slope)
    if size < WEAK.flat:
        return sigma[r]
    own = part_along(V, r, slope)
    sign = 1.0 if own >= 0.0 else -1.0
    for i in range(slope.shape[0]):
        V[i, r] = sign * slope[i] / size
    return sigma[r] * abs(own) / size


@inner
def take_out(J, W, U, V, lost, f, G):
    """Take the lost directions out of J and of the twist f, and factor what is left for `apply`; returns how many there are."""
    n, m = J.shape
    count = 0
    for r in range(m):
        if lost[r] > 0.0:
            count += 1
            part = mode_part(U, r, f)
            for c in range(m):
                f[c] -= part * U[r, c]
            for i in range(n):
                for c in range(m):
                    J[i, c] -= W[r, i] * U[r, c]
    wide, k = n >= m, min(n, m)
    gram(J, m, wide, 0.0, G)
    for r in range(m):
        if lost[r] > 0.0:
            for c in range(k):
                for d in range(c + 1):
                    G[c, d] += U[r, c] * U[r, d] if wide else V[c, r] * V[d, r]
    if not wide:  # joints that move nothing at all leave their rows empty
        for c in range(k):
            G[c, c] += WEAK.nothing
    cholesky(G, k, 0.0)
    return count


@inner
def by_modes(J, W, U, lost, ask, y):
    """Write the task, J and what is asked, by the modes that are kept, where some are lost: independent rows say the same.

    A row of weight 0 is a mode of its own, as long as `modes` began without directions of another task.
    """
    n, m = J.shape
    some = False
    for r in range(m):
        some = some or lost[r] > 0.0
    if not some:
        return
    for r in range(m):
        y[r] = 0.0 if lost[r] > 0.0 else mode_part(U, r, ask)
    for r in range(m):
        ask[r] = y[r]
    for i in range(n):
        for r in range(m):
            J[i, r] = 0.0 if lost[r] > 0.0 else W[r, i]


@inner
def hold_back(U, sigma, lost, bend, e, ahead, f, more):
    """Shrink what is asked for along the directions that are not lost, where what is lost cannot be reached.

    bend: the largest curvature of the tip's way. Times the error left it adds to sigma_k^2 of the second derivative, and whole
    ways J^+ e would go too far and back for ever (Levenberg and Marquardt). The error is that of the tips that a direction moves:
    an arm that is stretched out does not hold back another. Of a target that goes past beyond the edge, the closest pose goes less
    far, too. more (m,) is scratch.
    """
    m = lost.shape[0]
    for r in range(m):
        more[r] = 0.0
    for first in range(0, m, 6):
        tip, left = range(first, min(first + 6, m)), 0.0
        for c in tip:
            part = 0.0
            for r in range(m):
                if lost[r] > 0.0:
                    part += mode_part(U, r, e) * U[r, c]
            left += part * part
        for r in range(m):
            for c in tip:
                more[r] += U[r, c] * U[r, c] * left
    for r in range(m):
        if lost[r] == 0.0:
            extra = bend * math.sqrt(more[r])
            share = extra / (sigma[r] * sigma[r] + extra)
            for vector in (e, ahead, f):
                part = share * mode_part(U, r, vector)
                for c in range(vector.shape[0]):
                    vector[c] -= part * U[r, c]


@inner
def along_lost(V, lost, xk, x, speeds):
    """Replace what x (n,) has along the lost directions: by their speeds, or by nothing."""
    for r in range(lost.shape[0]):
        if lost[r] > 0.0:
            bring_along(V, r, x, xk[r] if speeds > 0.0 else 0.0, 1.0)


@inner
def down_slopes(W, V, sigma, pull, x, speeds):
    """Bring what x (n,) has along what a bent v_k leaves of the slope sigma_k v_k to the way down, or to nothing.

    Joints that drift there are pulled back in one step once the slope is no small one, at WEAK.lost: they come to it by then.
    """
    for r in range(pull.shape[0]):
        share = min(2.0 * sigma[r] / WEAK.lost - 1.0, 1.0)
        if pull[r] == 0.0 or share <= 0.0:
            continue
        own, size, part = part_along(V, r, W[r]), 0.0, 0.0
        for i in range(x.shape[0]):
            slope = W[r, i] - own * V[i, r]
            size += slope * slope
            part += slope * x[i]
        if size > WEAK.zero * WEAK.zero:
            for i in range(x.shape[0]):
                x[i] += share * (speeds * pull[r] - part / size) * (W[r, i] - own * V[i, r])
