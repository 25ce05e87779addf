"""Joint motion along the directions in which the tip can hardly move: singular poses, and the edge of the reach.

The Jacobian is J = sum over k of sigma_k v_k u_k' (v_k joint, u_k task directions). Along a direction with a small sigma_k the
first order says little, so the second is asked as well: to move by v_k moves the tip by sigma_k u_k + b_k / 2 with b_k =
(dJ/dt along v_k) v_k. Of the squared error left, |e|^2 / 2, the second derivative along v_k is

    H_k = sigma_k^2 - e . b_k

Beyond the edge of the reach the error points outwards and b_k inwards: H_k is large, and the arm slides smoothly to the
closest pose, without ever stepping over it, and no direction is damped where the target can be reached. Where H_k is negative
the error can be closed by bending: at sigma_k = 0, where the first order sees no way, the joints go back to the side they came
from. What a Newton step cannot tell (sigma_k and H_k near 0) is left to the joint's own motion, which fades.
"""

import math

import numpy as np

from .box import approach
from .jit import inner
from .linalg import cholesky, make_orthogonal
from .motion import gram

ZERO = 1e-9  # singular value (lengths over reach) below which a direction is not moved at all to first order
LEAST = 1e-3  # lambda at sigma_k = 0: what is lost of a motion through a singular pose is of the order of its square
NOTHING = 1e-12  # added to the squares of singular values, which are above LOST^2 here: no more than rounding
KNOWN = 0.1  # of a unit vector along a direction, from which on it is clear to which side it leads
LOST = 5e-3  # singular value below which a direction is taken out of the task
BENT = 2.0  # or H_k over sigma_k^2 above which it is
FADE = 0.1  # [s] in which a joint's own motion along a singular direction fades
SIDE = (
    0.2  # [s] in which the side is forgotten from which the joints came to a singular pose: a swing across is shorter
)
CLEAR = 1e-4  # singular value from which on it is clear on which side of the singular pose the joints are


@inner
def modes(J, W, U, sigma):
    """One-sided Jacobi: W (n, m) receives sigma_k v_k by columns, U (m, m) the u_k, sigma (m,)."""
    n, m = J.shape
    for r in range(m):
        for i in range(n):
            W[i, r] = J[i, r]
    make_orthogonal(W, U, m)
    for r in range(m):
        a = 0.0
        for i in range(n):
            a += W[i, r] * W[i, r]
        sigma[r] = math.sqrt(a)


@inner
def lost_direction(W, sigma, away, v):
    """Write to v (n,) the joint direction of a mode with sigma_k near 0: `away`, without what moves the tip; False if none."""
    n, m = W.shape
    for i in range(n):
        v[i] = away[i]
    for _ in range(2):  # twice is enough (Kahan)
        for c in range(m):
            if sigma[c] > ZERO:
                s = 0.0
                for i in range(n):
                    s += W[i, c] * v[i]
                s /= sigma[c] * sigma[c]
                for i in range(n):
                    v[i] -= s * W[i, c]
    size = 0.0
    for i in range(n):
        size += v[i] * v[i]
    size = math.sqrt(size)
    for i in range(n):
        v[i] = v[i] / size if size > 0.0 else 0.0
    return size > ZERO


@inner
def along(sigma, border, e, b, asked, own, h, side, cap):
    """Speed along v_k, and H_k. e, b, asked: parts along u_k of the error, of b_k, and of the rate wanted.

    own: v_k' of the joints' rate; side: whether v_k (1) or -v_k (-1) leads back to where the joints came from; cap: highest
    speed.
    """
    H = sigma * sigma - e * b
    fade = max(1.0 - (sigma / border) * (sigma / border), 0.0)
    damping = LEAST * LEAST * fade * fade
    x = (sigma * asked + damping * max(1.0 - h / FADE, 0.0) * own) / (max(H, sigma * sigma) + damping)
    if H < 0.0 and sigma < LOST:
        # The way to bend until the error is gone, taken as a rate as the rest of the error is.
        way = math.sqrt(2.0 * abs(e / b)) / h
        if abs(x) < way:
            x = way if (side if abs(side) > KNOWN else x) > 0.0 else -way
    return min(max(x, -cap), cap), H


@inner
def mode_asked(U, r, e, f, gain, h):
    """Parts along u_r of the error that the target leaves in a step, and of the rate wanted."""
    left, asked = 0.0, 0.0
    for c in range(e.shape[0]):
        left += U[c, r] * (e[c] + h * f[c])
        asked += U[c, r] * (f[c] + gain * e[c])
    return left, asked


@inner
def mode_direction(W, sv, r, away, asked, h, v):
    """Write v_r to v (n,); False where there is none to move along."""
    if sv[r] > ZERO:
        for i in range(v.shape[0]):
            v[i] = W[i, r] / sv[r]
        return True
    for i in range(v.shape[0]):
        v[i] = 0.0
    return abs(asked) * h > ZERO and lost_direction(W, sv, away, v)


@inner
def mode_speed(W, U, V, sv, lost, xk, r, bias, v, e, asked, gain, h, border, limits, rate, share, away):
    """Judge mode r by its b (bias (m,)): its speed to xk, v to V and 1 to lost where it is taken out of the task.

    share: of the side on which the joints are now, in the memory of it.
    """
    n, sigma = v.shape[0], sv[r]
    b, own, back, cap, a = 0.0, 0.0, 0.0, np.inf, np.inf
    for c in range(bias.shape[0]):
        b += U[c, r] * bias[c]
    for i in range(n):
        own += v[i] * rate[i]
        back += v[i] * away[i]
        if v[i] != 0.0:
            cap = min(cap, limits[2, i] / abs(v[i]))
            a = min(a, limits[3, i] / abs(v[i]))
    x, H = along(sigma, border, e, b, asked, own, h, back, cap)
    grows = np.sign(b)  # the way along v in which sigma does: the side on which the joints are
    edge = H > BENT * sigma * sigma
    if edge and sigma > LOST and grows * back < 0.0:  # carried far to the other side: back across
        x = -grows * min((sigma / abs(b) + LOST) * gain, cap)
    if a < np.inf:  # so that it can brake before the error is gone, see `ease`
        most = approach(abs(x) / gain, 0.0, 1.0, h, 0.5 * a, h)
        x = min(max(x, -most), most)
    if sigma > CLEAR and not edge:
        for i in range(n):
            away[i] += share * (grows - back) * v[i]
    if sigma < LOST or edge or abs(asked) > cap * sigma:
        lost[r], xk[r] = 1.0, x
        for i in range(n):
            V[i, r] = v[i]


@inner
def take_out(J, W, U, V, lost, f, G):
    """Take the lost directions out of J and of the twist f, and factor what is left for `apply`; returns how many there are."""
    n, m = J.shape
    count = 0
    for r in range(m):
        if lost[r] > 0.0:
            count += 1
            part = 0.0
            for c in range(m):
                part += U[c, r] * f[c]
            for c in range(m):
                f[c] -= part * U[c, r]
                for i in range(n):
                    J[i, c] -= W[i, r] * U[c, r]
    wide = n >= m
    k = m if wide else n
    gram(J, m, wide, 0.0, G)
    for r in range(m):
        if lost[r] > 0.0:
            for c in range(k):
                for d in range(c + 1):
                    G[c, d] += U[c, r] * U[d, r] if wide else V[c, r] * V[d, r]
    if not wide:  # joints that move nothing at all leave their rows empty
        for c in range(k):
            G[c, c] += NOTHING
    cholesky(G, k, 0.0)
    return count


@inner
def along_lost(V, lost, xk, x, speeds):
    """Replace what x (n,) has along the lost directions: by their speeds, or by nothing."""
    for r in range(lost.shape[0]):
        if lost[r] > 0.0:
            own = 0.0
            for i in range(x.shape[0]):
                own += V[i, r] * x[i]
            for i in range(x.shape[0]):
                x[i] += ((xk[r] if speeds > 0.0 else 0.0) - own) * V[i, r]
