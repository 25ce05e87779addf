"""Find and certify all roots of the determinant: which are real, and which solutions they give.

det M(q3) is a trigonometric polynomial of degree d (at most 14 here), D = sum c_k z^k, k = -d ... d, z = exp(i q3). Its values at 2
d + 5 angles give the c_k by a discrete Fourier transform, together with two harmonics that D does not have. What is computed for
these two is only rounding, so they measure the noise of D. All 2 d roots are found by Ehrlich and Aberth's method (Aberth 1973). A
real q3 is a root on the unit circle; the others come in pairs z, 1 / conj(z). Each computed root has an error disc that should hold
the true one.

The noise of the determinant is measured, not bounded, so the certificate is numerical and not a proof by interval arithmetic. An
answer is CERTAIN if every root is one of these:

- complex: its error disc misses the unit circle, so that it belongs to no real solution;
- real: its error disc overlaps no other and touches the circle, and Newton's method from its null vector ends at a solution whose
  q3 is the root;
- one of two whose error discs overlap only each other, where the 12 equations have two null vectors: two such solutions, or none.

It is CERTAIN as well if there are as many solutions as roots that are not complex (`answer.all_counted`).

Otherwise it is DOUBLE, if roots merge in a solution where the arm is singular, or UNSURE.
"""

# Numba's type hints are incomplete, so pyright must not report what they lack.
# pyright: reportCallIssue=false, reportArgumentType=false, reportGeneralTypeIssues=false
import math
from typing import NamedTuple

from ...compile.jit import compiled, inline, inner
from ..records import Array
from .angles import find_angles, find_null, find_two_nulls, split_pair
from .closure import close, joint_at, least_gain, reorder, wrapped
from .equations import determinant, reduce, write_left, write_right
from .terms import SIZES, STATE, TRUST, VERDICT


# ---------------------------------------------------------------------------------------------------------------------- roots
@compiled
class Roots(NamedTuple):
    """The determinant of the loop equations of one target: its values, its roots and their error discs.

    It is a polynomial of degree 2 d in z = exp(i q3), where q3 is the angle of joint 3.
    """

    values: Array  # (K,) values of the determinant at K angles q3, spaced evenly over a turn
    c: Array  # (2 d + 1,) complex coefficients of z^0 ... z^2d, scaled so that the largest is 1 in size
    z: Array  # (2 d,) complex roots of the polynomial
    radius: Array  # (2 d,) radii of the error discs, one around each computed root
    state: Array  # (2 d,) what is known of each root, a number of `terms.RootState`


@inline
def size(z):
    """Return |z|^2 of a complex number z."""
    return z.real * z.real + z.imag * z.imag


@inline
def over(z):
    """Return 1 / z of a complex number z, without the guard against overflow that makes numba's own division slow."""
    share = 1.0 / size(z)
    return complex(z.real * share, -z.imag * share)


@inner
def fit_polynomial(values, degree, tables, c):
    """Write the coefficients c (2 degree + 1,) of the polynomial that has given values at K points of the unit circle.

    They are scaled to at most 1 in size. values: (K,); tables: rows 0 and 1 are cos and sin of the angles 2 pi k / K of the points.
    Returns the estimated error of a coefficient relative to the largest coefficient, or inf if all are 0.
    """
    count = 2 * degree + 5
    noise, largest = 0.0, 0.0
    for h in range(degree + 3):
        a, b = 0.0, 0.0
        for k in range(count):
            m = (h * k) % count
            a += values[k] * tables[0, m]
            b -= values[k] * tables[1, m]
        length = math.sqrt(a * a + b * b)
        if h <= degree:
            c[degree + h], c[degree - h] = complex(a, b), complex(a, -b)
            largest = max(largest, length)
        else:
            noise = max(noise, length)
    if not largest > 0.0:
        return math.inf
    share = 1.0 / largest
    for k in range(2 * degree + 1):
        c[k] = c[k] * share
    # The two harmonics above the degree would be 0 without rounding, so they measure the noise: it is twice the larger of them,
    # plus the rounding of the division.
    return 2.0 * noise * share + 2e-16


@inner
def slope(c, n, z):
    """Return P'(z) / P(z) of a polynomial P = sum c_k z^k (k = 0 ... n), and whether P(z) is not 0.

    If z is outside the unit circle, the polynomial is evaluated in powers of 1 / z. c: (n + 1,) complex coefficients.
    """
    inside = size(z) <= 1.0
    x = z if inside else over(z)
    value, rate = (c[n] if inside else c[0]), complex(0.0, 0.0)
    for k in range(1, n + 1):
        rate = rate * x + value
        value = value * x + c[n - k if inside else k]
    if size(value) == 0.0:
        return rate, False
    ratio = rate * over(value)
    return (ratio if inside else (n - x * ratio) * x), True


@inner
def find_roots(r, n):
    """Find all n roots of a polynomial by Ehrlich and Aberth's method, and write them to r.z.

    The coefficients are r.c (r: `Roots`). The method is Newton's for all roots at once, with a term in each step that repels the
    other roots.
    """
    for i in range(n):
        angle, length = 2.0 * math.pi * (i + 0.37) / n, 1.25 if i % 2 == 0 else 0.8
        r.z[i] = complex(length * math.cos(angle), length * math.sin(angle))
        r.state[i] = STATE.open
    for _ in range(TRUST.sweeps):
        worst = 0.0
        for i in range(n):
            if r.state[i] != STATE.open:
                continue
            z = r.z[i]
            ratio, some = slope(r.c, n, z)
            if not some:
                r.state[i] = STATE.settled
                continue
            for j in range(n):
                apart = z - r.z[j]
                if size(apart) > 0.0:
                    ratio -= over(apart)
            if size(ratio) == 0.0:
                continue
            step = over(ratio)
            r.z[i] = z - step
            move = math.sqrt(size(step) / (size(z) + 1e-300))
            worst = max(worst, move)
            if move < TRUST.settled:
                r.state[i] = STATE.settled
        if worst < TRUST.quiet:
            break


@inner
def find_discs(r, n, noise):
    """Write to r.radius the radii of error discs around the n computed roots r.z of a polynomial.

    A disc that overlaps no other holds exactly one true root. r: `Roots`; noise: relative error of a coefficient, from
    `fit_polynomial`.
    """
    last = math.sqrt(size(r.c[n]))
    for i in range(n):
        z, value, weight = r.z[i], r.c[n], 1.0
        for k in range(n - 1, -1, -1):
            value = value * z + r.c[k]
            weight = weight * size(z) + 1.0
        product = last
        for j in range(n):
            if j != i:
                product *= math.sqrt(size(z - r.z[j]))
        left = math.sqrt(size(value)) + noise * math.sqrt(weight)
        r.radius[i] = TRUST.disc * left / product if product > 0.0 else math.inf


# -------------------------------------------------------------------------------------------------------------------- account
@inner
def set_up(d):
    """Write the equations of an arm's loop for one target, and the values of their determinant at evenly spaced angles.

    The ordering of the loop (the joint it begins at, and its direction) is d.form. Returns the pose that closes the loop in this
    ordering, and the rank of the equations (see `equations.reduce`). d: working memory, an `answer.Work`.
    """
    pose = reorder(d.loop.axes, d.loop.X, d.form[0] > 0.0, int(d.form[1]), d.e.lines)
    write_left(d.e.lines, d.e.robot)
    write_right(d.e.lines, pose, d.e.target)
    rank = reduce(d.e, d.mix)
    for k in range(2 * int(d.form[3]) + 5):
        d.r.values[k] = determinant(d.e.W, d.tables[0, k], d.tables[1, k], d.A, d.N)
    return pose, rank


@inner
def near(d, i, n):
    """Return the last of n roots whose error disc overlaps that of root i (or -1), and the number of such roots.

    d: working memory, an `answer.Work`.
    """
    r, other, count = d.r, -1, 0
    for j in range(n):
        if j != i and math.sqrt(size(r.z[i] - r.z[j])) <= TRUST.apart * (r.radius[i] + r.radius[j]):
            other, count = j, count + 1
    return other, count


@inner
def off_circle(z):
    """Return the distance of a root from the unit circle, 0 for a root exp(i q3) of a real angle q3.

    Roots come in pairs z and 1 / conj(z); for a root outside the circle, the distance is that of its partner inside.
    """
    length = math.sqrt(size(z))
    return 1.0 - (length if length <= 1.0 else 1.0 / length)


@inner
def is_complex(z, radius):
    """Return whether a root z certainly belongs to no real angle: its error disc clearly misses the unit circle."""
    gap = off_circle(z)
    return gap > (TRUST.clear if gap > TRUST.band else TRUST.clearer) * radius / max(1.0, size(z))


@inner
def to_joints(d):
    """Convert the joint angles d.null.t of a reordered loop to d.loop.q (6,), in the arm's own joint order.

    Their signs change if the loop is reversed. d: working memory, an `answer.Work`.
    """
    backwards, shift = d.form[0] > 0.0, int(d.form[1])
    for place in range(6):
        t = d.null.t[place]
        d.loop.q[joint_at(place, backwards, shift)] = -t if backwards else t


@inner
def settle_root(d, root, radius):
    """Refine approximate joint angles d.null.t by Newton's method, and return whether they lead to the solution of a root.

    They do if the method converges and the angle q3 of the solution, d.loop.q, agrees with the root. root: angle of the root [rad];
    radius: radius of its error disc; d: working memory, an `answer.Work`.
    """
    backwards, shift, q = d.form[0] > 0.0, int(d.form[1]), d.loop.q
    to_joints(d)
    if not close(d.loop) < TRUST.closed:
        return False
    kept = q[joint_at(2, backwards, shift)]
    off = abs(wrapped(kept + root if backwards else kept - root))
    for i in range(6):
        q[i] = wrapped(q[i])
    return off <= max(TRUST.kept, min(TRUST.kept_most, TRUST.kept_radii * radius))


@inner
def tolerance(gain):
    """Return how far a joint [rad] may differ between two entries of a list that count as the same solution.

    A rounding error of 1e-11 in the pose moves the joints by 1e-11 divided by the gain (about the least singular value of the
    Jacobian), which is a large move at singular poses.
    """
    return TRUST.same if gain > 1e-4 else max(TRUST.same, min(1e-3, 1e-11 / max(gain, 1e-300)))


@inner
def put_solution(found, q, gain, root):
    """Add a solution q (6,) to a list; return the row of an equal solution that is there already, or 0 if it is new.

    found: the list (SIZES.rows, SIZES.columns), see `answer.solve_loops`; gain: distance from a singular pose
    (`closure.least_gain`); root: angle [rad] of the root of the determinant that it belongs to.
    """
    count = int(found[0, 0])
    for k in range(1, count + 1):
        near, i = max(tolerance(gain), tolerance(found[k, 6])), 0
        while i < 6 and abs(wrapped(found[k, i] - q[i])) <= near:
            i += 1
        if i == 6:
            return k
    if count + 1 < SIZES.rows:
        found[0, 0] = count + 1.0
        for i in range(6):
            found[count + 1, i] = q[i]
        found[count + 1, 6], found[count + 1, 7], found[count + 1, 8] = gain, root, 0.0
    return 0


@inner
def take_pair(d, pose, rank, i, j):
    """Find the two solutions, if any, of two roots whose error discs overlap only each other.

    Symmetric arms have two solutions with the same q3, so the determinant has two equal roots. Both roots are marked real and their
    solutions added if there are two, or marked complex if there are none. d: working memory, an `answer.Work`; pose, rank: what
    `set_up` returned; i, j: indices of the roots.
    """
    r, null, found = d.r, d.null, d.found
    middle = 0.5 * (r.z[i] + r.z[j])
    radius = max(r.radius[i], r.radius[j])
    if not (off_circle(middle) < min(TRUST.paired, 10.0 * radius) and radius < TRUST.wide):
        return
    root = math.atan2(middle.imag, middle.real)
    second, third = find_two_nulls(d.e.W, root, null)
    if second > TRUST.second:
        return
    real = split_pair(null)
    if real == 0 and third > TRUST.third and second < TRUST.second_complex and TRUST.kept_radii * radius < TRUST.third:
        r.state[i], r.state[j] = STATE.complex, STATE.complex
    if real != 2:
        return
    before = found[0, 0]
    for k in range(2):
        find_angles(d.e, rank, pose, root, null.pair[k], null)
        if settle_root(d, root, radius):
            put_solution(found, d.loop.q, least_gain(d.loop), root)
    if found[0, 0] == before + 2.0:
        r.state[i], r.state[j] = STATE.real, STATE.real
    else:
        found[0, 0] = before


@inner
def take_root(d, pose, rank, i, lone):
    """Find the solution that belongs to root i of the determinant, and add it to the list of solutions.

    Returns the best of `terms.Verdicts` that the root allows for the whole list. d: working memory, an `answer.Work`; pose, rank:
    what `set_up` returned; lone: whether the root's error disc overlaps no other.
    """
    z, radius = d.r.z[i], d.r.radius[i]
    gap = off_circle(z)
    # If the disc overlaps no other, it holds one true root, which is its own partner 1 / conj(z) and so lies on the circle: the
    # disc must reach the circle.
    if not (gap <= radius + 1e-13 if lone else gap < 1e-3):
        return VERDICT.unsure
    root = math.atan2(z.imag, z.real)
    find_null(d.e.W, root, d.null)
    find_angles(d.e, rank, pose, root, d.null.x, d.null)
    if not settle_root(d, root, radius):
        return VERDICT.unsure
    gain = least_gain(d.loop)
    again = put_solution(d.found, d.loop.q, gain, root)
    if again > 0:
        return VERDICT.double if d.found[again, 6] < TRUST.singular else VERDICT.unsure
    d.r.state[i] = STATE.real
    return VERDICT.certain if radius <= TRUST.wide else VERDICT.unsure


@inner
def account_for(d):
    """Find the joint solutions of one target by elimination, with one ordering of the loop, and write them to d.found.

    d: working memory (`answer.Work`), with the target and the ordering. Returns what `set_up` returned.
    """
    found, r, n = d.found, d.r, 2 * int(d.form[3])
    for k in range(SIZES.columns):
        found[0, k] = 0.0
    found[0, 1] = VERDICT.unsure
    pose, rank = set_up(d)
    largest = 0.0
    for k in range(n + 5):
        largest = max(largest, abs(r.values[k]))
    noise = fit_polynomial(r.values, n // 2, d.tables, r.c) if largest > TRUST.flat * d.form[4] else math.inf
    if rank < int(d.form[2]) or not noise <= TRUST.noisy:
        return pose, rank
    find_roots(r, n)
    find_discs(r, n, noise)
    status = VERDICT.certain
    for i in range(n):
        r.state[i] = STATE.complex if is_complex(r.z[i], r.radius[i]) else STATE.open
    for i in range(n):
        j, count = near(d, i, n)
        if count == 1 and i < j and near(d, j, n)[1] == 1:
            take_pair(d, pose, rank, i, j)
    worst = 0.0
    for i in range(n):
        if r.state[i] == STATE.open:
            status = max(status, take_root(d, pose, rank, i, near(d, i, n)[1] == 0))
            worst = max(worst, r.radius[i])
    rest = 0.0
    for i in range(n):
        rest += 1.0 if r.state[i] == STATE.complex else 0.0
    for k in range(1, int(found[0, 0]) + 1):
        if found[k, 6] < TRUST.family:
            status = max(status, VERDICT.double)
    found[0, 1], found[0, 3], found[0, 4], found[0, 5], found[0, 6] = status, n, rest, worst, noise
    return pose, rank
