"""Joint motion along singular directions, in which the tip can hardly move: at singular poses, at the edge of reach.

The Jacobian is J = sum over k of sigma_k v_k u_k' (v_k: joint directions, u_k: task directions). Along a direction with
a small sigma_k the first order says little, so the second is used as well. A move along v_k moves the tip by sigma_k
u_k + b_k / 2 with b_k = (dJ/dt along v_k) v_k. The squared error |e|^2 / 2 then has the second derivative along v_k

    H_k = sigma_k^2 - e . b_k

If the target is beyond the edge of the reach, the error e points outwards and b_k inwards. H_k is then large, so the arm slides
smoothly to the closest pose without stepping over it, and no direction is damped while the target can be reached. If H_k is
negative, the error can be closed by bending the arm: at sigma_k = 0, where the first order shows no way, the joints go back to
the side from which they came. If both sigma_k and H_k are near 0, a Newton step is undefined, and the joints keep their
present motion, which fades.

When a redundant arm is stretched out, two joint directions hardly move the tip: bending, and a rotation of the bent
arm. v_k is any mixture of the two and may change with every step. While the target is out of reach, v_k is therefore replaced by
the direction in which b_k is largest, and the side from which the joints came is remembered along that direction.
"""

import math
from typing import NamedTuple

from ..compile.jit import inner
from ..kernel.linalg import cholesky, make_rows_orthogonal
from ..kernel.null_space import is_wide
from ..kernel.records import copy
from ..kernel.vectors import add_multiple, any_of, clear, dot
from .laws import gram

ALONG, BESIDE, BOTH = range(3)  # codes of the joint motions for which `mode_probe` prepares a curvature


class SingularThresholds(NamedTuple):
    """Thresholds by which directions count as singular, and constants for the joint motion along them.

    Singular values are tip motions in arm reaches (or rad) per rad (or arm reach) of a joint.
    """

    zero: float = 1e-9  # singular value below which the tip does not move to first order
    # This is added to the squared singular values before factoring. It is negligible against the smallest one that stays in the
    # task, `lost` squared.
    nothing: float = 1e-12
    # A unit vector points clearly to one side along a direction if its component there exceeds this.
    clearly: float = 0.1
    # The vector `away` remembers the side from which the joints came to a singular pose. It counts if its component along the
    # singular direction exceeds this; a smaller one may come from another singular pose.
    known: float = 0.5
    lost: float = 5e-3  # singular value below which a direction is removed from the task
    # A direction is also removed from the task if the tip motion asked for along it times the curvature of the tip's path exceeds
    # this share of sigma_k^2.
    bent: float = 0.2
    fade: float = 0.1  # [s] time constant with which joint motion fades that does not move the tip at all
    least: float = 1e-3  # damping lambda at sigma_k = 0; a motion through a singular pose errs by about lambda^2
    flat: float = 1e-3  # [arm reaches / rad^2] a smaller curvature counts as zero
    # If the target is out of reach, a step takes this share of the move to the closest pose; full steps would zigzag, as in
    # steepest descent.
    caution: float = 2.0 / 3.0
    # An error is closed with damping if it is below this share of another error that cannot be closed.
    minor: float = 0.1
    clear: float = 1e-4  # singular value above which it is clear on which side of the singular pose the joints are
    # [s] time for which the side from which the joints came is remembered; longer than an oscillation lasts
    side: float = 0.2
    # largest share of an error that a step corrects along a singular direction or in a damped descent; the best one for method cv
    gain: float = 2.0 / 3.0
    # [arm reaches or rad] errors up to this size count as small: rotations then add like vectors, to within a twentieth
    close: float = 0.1


WEAK = SingularThresholds()


@inner
def modes(J, near, W, U, sigma):
    """Compute the singular value decomposition of J (n, m) by one-sided Jacobi rotations.

    W (m, n) receives sigma_k v_k as rows, U (m, m) the u_k as rows, sigma (m,) the singular values. near (m, m): the u_k of the
    last call (zeros at first), from which the rotations start, so that few are needed; it receives the new u_k, normalised.
    """
    n, m = J.shape
    known = any_of(near[0])
    for r in range(m):
        for c in range(m):
            U[r, c] = near[r, c] if known else 1.0 if r == c else 0.0
        for i in range(n):
            W[r, i] = dot(J[i], U[r], m)
    make_rows_orthogonal(W, U, sigma)
    for r in range(m):
        sigma[r] = math.sqrt(sigma[r])
        size = math.sqrt(dot(U[r], U[r], m))
        for c in range(m):
            near[r, c] = U[r, c] / size


@inner
def leave_modes(W, sigma, r, x):
    """Remove from the joint motion x (n,), in place, what moves the tip, except along task direction u_r (none excepted if r = -1).

    W (m, n): rows sigma_k v_k, and sigma (m,): singular values, from `modes`. Returns the length of what is left of x.
    """
    m, n = W.shape
    for c in range(m):
        if c != r and sigma[c] > WEAK.zero:
            add_multiple(x, -dot(W[c], x, n) / (sigma[c] * sigma[c]), W[c], n)
    return math.sqrt(dot(x, x, n))


@inner
def lost_direction(W, sigma, away, v):
    """Write to v (n,) a unit joint direction that does not move the tip: `away` (n,) without the part that moves it.

    W (m, n): rows sigma_k v_k, and sigma (m,): singular values, from `modes`. Returns False if nothing is left of `away`.
    """
    copy(away, v)
    leave_modes(W, sigma, -1, v)
    # A second projection removes the rounding of the first; twice is enough (Kahan).
    size = leave_modes(W, sigma, -1, v)
    for i in range(v.shape[0]):
        v[i] = v[i] / size if size > WEAK.zero else 0.0  # If only rounding is left, there is no direction.
    return size > WEAK.zero


@inner
def bring_along(v, x, value, share):
    """Change the component of x (n,) along the unit vector v (n,) towards `value`, by the given share of the difference."""
    n = x.shape[0]
    add_multiple(x, share * (value - dot(v, x, n)), v, n)


@inner
def mode_probe(v, rate, part, h, x):
    """Write to x (n,) the joint motion along which the curvature of the tip's path is evaluated next; return the rate along v.

    v (n,): unit joint direction of a singular value; rate (n,): present joint rates. part: ALONG for v itself; BESIDE for the
    joints' move in a step of h [s] without its part along v; BOTH for the sum of these two.
    """
    n = x.shape[0]
    own = dot(v, rate, n)
    clear(x)
    if part != ALONG:
        add_multiple(x, h, rate, n)
        add_multiple(x, -h * own, v, n)
    if part != BESIDE:
        add_multiple(x, 1.0, v, n)
    return own


@inner
def way_along(sigma, b, E, own, side, home, h):
    """Return the move y along a joint direction v_k that moves the tip by E along u_k, or as nearly as it can.

    sigma and b: tip motion and curvature along u_k per unit of y, so that sigma y + b y^2 / 2 = E is solved. Also returns the
    discriminant D of this equation, which is negative if E is out of reach. There are two solutions, one on each side of the
    singular pose. The result is the one towards which the joints already move (own: their move along v_k in a step). If they rest
    at the singular pose, or with `home`, it is the one on the side from which they came (side > 0: the side to which v_k points).
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
            # The second form of the root avoids a difference of nearly equal numbers.
            y = middle + half if middle * half > 0.0 else -2.0 * E / (b * (middle - half))
    else:
        D -= 2.0 * WEAK.flat * abs(E)  # D for the largest curvature that counts as zero
        y = min(max(E / sigma, -sigma / WEAK.flat), sigma / WEAK.flat) if sigma > WEAK.zero else 0.0
        kept *= max(1.0 - h / WEAK.fade, 0.0)
    # The weight is the second derivative of half the squared error at the solution.
    weight = D if D > 0.0 else -0.5 * D
    return (weight * y + WEAK.least * WEAK.least * kept) / (weight + WEAK.least * WEAK.least), D


@inner
def mode_moved(u, e, ahead, f, h):
    """Return the target's motion along the task direction u (m,) in a step of h [s].

    It is the difference between the errors to the target at the end of the step, `ahead`, and now, `e`. If the error is large, it
    is h times the target's twist f instead, since large rotations do not add like vectors.
    """
    m = e.shape[0]
    if dot(e, e, m) > WEAK.close * WEAK.close:
        return h * dot(u, f, m)
    return dot(u, ahead, m) - dot(u, e, m)


@inner
def mode_direction(W, sv, r, away, way, v):
    """Write to v (n,) the unit joint direction that belongs to singular value r; return False if there is none to move along.

    W (m, n): rows sigma_k v_k, and sv (m,): singular values, from `modes`; way: tip motion that is asked for along this direction.
    For a singular value near 0 the direction is the part of the joint motion `away` (n,) that does not move the tip; there is none
    if `way` is 0.
    """
    clear(v)
    if sv[r] > WEAK.zero:
        add_multiple(v, 1.0 / sv[r], W[r], v.shape[0])
        return True
    return abs(way) > WEAK.zero and lost_direction(W, sv, away, v)


@inner
def begin_curved(W, v, sigma, r, away, x):
    """Write to x (n,) the joint direction from which the search of `bent_direction` starts.

    It is `away` (n,) without what moves the tip along task directions other than u_r or, if little is left of it, v (n,). W (m, n):
    rows sigma_k v_k, and sigma (m,): singular values, from `modes`.
    """
    copy(away, x)
    size = leave_modes(W, sigma, r, x)
    for i in range(x.shape[0]):
        x[i] = x[i] / size if size > WEAK.known else v[i]


@inner
def bent_direction(W, v, sigma, r, slope):
    """Turn v (n,), the joint direction of a singular value sigma_r near 0, to where a joint motion curves the tip's path along u_r.

    A stretched redundant arm has two joint directions that hardly move the tip, and v may be any mixture of them. Only the one
    along which the tip's path is curved can bring the tip nearer. The gradient of sigma_r, slope (n,), points along it: entry i is
    the component along u_r of (dJ/dt along x) for a motion of joint i alone, where x is what `begin_curved` wrote (one step of a
    power iteration). W (m, n): rows sigma_k v_k, and sigma (m,): singular values, from `modes`. Returns the tip's motion along u_r
    per unit of motion along the new v.
    """
    size = leave_modes(W, sigma, r, slope)
    if size < WEAK.flat:
        return sigma[r]
    own = dot(v, slope, v.shape[0])
    sign = 1.0 if own >= 0.0 else -1.0
    for i in range(slope.shape[0]):
        v[i] = sign * slope[i] / size
    return sigma[r] * abs(own) / size


@inner
def take_out(J, W, U, V, lost, f, G):
    """Remove the task directions marked by 1 in lost (m,) from the Jacobian J (n, m) and the target's twist f (m,).

    W (m, n): rows sigma_k v_k, and U (m, m): rows u_k, from `modes`; V (m, n): joint directions of the directions removed. G
    receives the Cholesky factor of what is left of J, for `laws.apply`. Returns how many directions were removed.
    """
    n, m = J.shape
    count = 0
    for r in range(m):
        if lost[r] > 0.0:
            count += 1
            add_multiple(f, -dot(U[r], f, m), U[r], m)
            for i in range(n):
                add_multiple(J[i], -W[r, i], U[r], m)
    wide = is_wide(J, m)
    k = m if wide else n
    gram(J, m, wide, 0.0, G)
    for r in range(m):
        if lost[r] > 0.0:
            for c in range(k):
                for d in range(c + 1):
                    G[c, d] += U[r, c] * U[r, d] if wide else V[r, c] * V[r, d]
    if not wide:  # Without this addition a joint that does not move the tip would make the matrix singular.
        for c in range(k):
            G[c, c] += WEAK.nothing
    cholesky(G, k, 0.0)
    return count


@inner
def by_modes(J, W, U, lost, ask, y):
    """Rewrite the task, J (n, m) and the rates ask (m,), in the task directions u_k that are kept; its rows are then independent.

    W (m, n): rows sigma_k v_k, and U (m, m): rows u_k, from `modes`; lost (m,): 1 for a direction that is removed; y (m,): scratch.
    An error of weight 0 keeps a direction of its own if `modes` was started with zeros in `near`.
    """
    n, m = J.shape
    if not any_of(lost):
        return
    copy(ask, y)
    for r in range(m):
        kept = 0.0 if lost[r] > 0.0 else 1.0
        ask[r] = kept * dot(U[r], y, m)
        for i in range(n):
            J[i, r] = kept * W[r, i]


@inner
def hold_back(U, sigma, lost, bend, e, ahead, f, more):
    """Damp the correction of errors that can be closed, while another error, along directions removed from the task, cannot.

    Along each direction u_k that is kept, e, ahead and the target's twist f (m,) are multiplied by sigma_k^2 / (sigma_k^2 + bend r)
    (Levenberg-Marquardt). Here r is the error that cannot be closed, and bend the largest curvature of the tip's path. The second
    derivative of the squared error is sigma_k^2 + bend r, so undamped steps J^+ e would overshoot to and fro for ever. Only r of
    the tips that u_k moves counts, so that one stretched arm does not slow down another. The twist is damped as well, because the
    closest pose moves less than a target beyond the edge of the reach. U (m, m): rows u_k; sigma (m,): singular values; lost (m,):
    1 for a direction that is removed; more (m,): scratch.
    """
    m = lost.shape[0]
    clear(more)
    for first in range(0, m, 6):
        tip, left = range(first, min(first + 6, m)), 0.0
        for c in tip:
            part = 0.0
            for r in range(m):
                if lost[r] > 0.0:
                    part += dot(U[r], e, m) * U[r, c]
            left += part * part
        for r in range(m):
            for c in tip:
                more[r] += U[r, c] * U[r, c] * left
    for r in range(m):
        if lost[r] == 0.0:
            extra = bend * math.sqrt(more[r])
            share = extra / (sigma[r] * sigma[r] + extra)
            for vector in (e, ahead, f):
                add_multiple(vector, -share * dot(U[r], vector, m), U[r], m)


@inner
def along_lost(V, lost, xk, x, speeds):
    """Set the components of the joint rates x (n,) along directions removed from the task to xk (m,), or to 0 if `speeds` is 0.

    V (m, n): joint direction of each singular direction; lost (m,): 1 for a direction that is removed.
    """
    for r in range(lost.shape[0]):
        if lost[r] > 0.0:
            bring_along(V[r], x, xk[r] if speeds > 0.0 else 0.0, 1.0)


@inner
def down_slopes(W, V, sigma, pull, x, speeds):
    """Let the joints also move along the part of v_k that is lost where `bent_direction` has replaced v_k by another direction V_k.

    slope_k is the part of sigma_k v_k (row k of W) that is perpendicular to V_k (row k of V); the tip still moves along it. The
    component of the rates x (n,) along slope_k becomes pull[k] slope_k, or 0 if `speeds` is 0; if pull[k] is 0, x stays. The change
    is faded in while sigma_k grows from half of WEAK.lost to WEAK.lost.
    """
    n = x.shape[0]
    for r in range(pull.shape[0]):
        share = min(2.0 * sigma[r] / WEAK.lost - 1.0, 1.0)
        if pull[r] == 0.0 or share <= 0.0:
            continue
        own, size, part = dot(V[r], W[r], n), 0.0, 0.0
        for i in range(n):
            slope = W[r, i] - own * V[r, i]
            size += slope * slope
            part += slope * x[i]
        if size > WEAK.zero * WEAK.zero:
            more = share * (speeds * pull[r] - part / size)
            add_multiple(x, more, W[r], n)
            add_multiple(x, -more * own, V[r], n)
