"""Every solution of each target pose: the orderings of a robot's loop are tried in turn until one answer is certified."""

# Numba's type hints are incomplete, so pyright must not report what they lack.
# pyright: reportCallIssue=false, reportArgumentType=false, reportGeneralTypeIssues=false
import math
from typing import NamedTuple

import numpy as np

from ...compile.array_view import cut, fold, keep, view
from ...compile.jit import build, cached, compiled, inline, inner
from ..algebra import M3, V3, Pose, at3, pose_from, product, put3, put_axes, rotation_at
from ..records import Array, copy
from .account import Roots, account_for, near, off_circle, put_solution, set_up, size, to_joints
from .angles import Null, find_angles, find_null
from .closure import JointLoop, close, inverse, least_gain, pose_of, rotated, wrapped
from .decomposition import decompose
from .equations import LoopEquations
from .terms import DOUBT, SIZES, STATE, TRUST, VERDICT


@inner
def merge_into(one, whole):
    """Add the solutions in the list `one` to the list `whole`, except those that are there already.

    Both lists (SIZES.rows, SIZES.columns) are for the same target, see `solve_loops`. Returns whether `whole` then contains no
    solution that `one` lacks.
    """
    for k in range(1, int(one[0, 0]) + 1):
        if put_solution(whole, one[k], one[k, 6], one[k, 7]) == 0:
            whole[int(whole[0, 0]), 8] = one[k, 8]
    return whole[0, 0] == one[0, 0]


@compiled
class Work(NamedTuple):
    """Working memory of `solve_loops`: all arrays that are used to solve for one target with one ordering of the loop."""

    target: Array  # (12,) rigid motion from the tip's pose at q = 0 to the target
    loop: JointLoop
    e: LoopEquations
    r: Roots
    null: Null
    A: Array  # (6, 9) scratch for `equations.determinant`
    N: Array  # (9, 9) scratch for `equations.determinant`
    row: Array  # (SIZES.whole,) the ordering of the loop that is being solved; the next three arrays are parts of it
    form: Array  # (SIZES.form,) the fields of a `terms.Form`: direction and first joint of the loop, rank and degree
    tables: Array  # (2, SIZES.samples) cos and sin of the angles at which the determinant is evaluated
    mix: Array  # (6, 14) factors by which more than 6 equations are combined into 6, see `equations.reduce`
    found: Array  # (SIZES.rows, SIZES.columns) the solutions found with this ordering, see `solve_loops`


@build
def make_work(block, axes):
    """Return the working memory `Work`, cut from the array `block`; axes: (6, 6) joint axes at q = 0."""
    block[0] = 0.0
    target, X, J, back, error, q = cut(block, np.float64, (12, 12, (6, 6), (6, 6), 6, 6))
    lines, left, right, V, scales = cut(block, np.float64, ((6, 6), (27, 14), (9, 14), (8, 14), 8))
    reduced, W, values = cut(block, np.float64, ((27, 14), (3, 6, 9), SIZES.samples))
    c, z = cut(block, np.complex128, (2 * SIZES.degree + 1, 2 * SIZES.degree))
    radius, state, M, P, x = cut(block, np.float64, (2 * SIZES.degree, 2 * SIZES.degree, (12, 12), (12, 12), 12))
    pair, monomials, t, A, N = cut(block, np.float64, ((2, 12), 14, 6, (6, 9), (9, 9)))
    order, swaps = cut(block, np.int64, (8, 12))
    row, found = cut(block, np.float64, (SIZES.whole, (SIZES.rows, SIZES.columns)))
    tables = fold(row[SIZES.form :], np.float64, 2, SIZES.samples)
    mix = fold(row[SIZES.form + SIZES.tables :], np.float64, 6, SIZES.numbers)
    return Work(
        target, JointLoop(axes, X, J, back, swaps, error, q), LoopEquations(lines, left, right, V, scales, order, reduced, W),
        Roots(values, c, z, radius, state), Null(M, P, swaps, x, pair, monomials, t), A, N,
        row, row[: SIZES.form], tables, mix, found,
    )  # fmt: skip


@inline
def sharpened(R):
    """Return a nearly orthonormal matrix R (M3) made more exactly orthonormal: R (3 - R'R) / 2, which squares its error.

    This is a step of Newton's method for the polar factor.
    """
    a, b, c = R.x.dot(R.y), R.x.dot(R.z), R.y.dot(R.z)
    x = R.x * (1.5 - 0.5 * R.x.square()) - (R.y * a + R.z * b) * 0.5
    y = R.y * (1.5 - 0.5 * R.y.square()) - (R.x * a + R.z * c) * 0.5
    return M3(x, y, R.z * (1.5 - 0.5 * R.z.square()) - (R.x * b + R.y * c) * 0.5)


@inner
def motion_to(T, arm, X):
    """Write to X (12,) the motion that takes the tip from its pose at q = 0 to the target T (4, 4) [m].

    X is a rotation matrix by rows, then a translation, with lengths divided by the arm's size. arm: (52,) geometry, as for
    `solve_loops`.
    """
    target = pose_from(T)
    # A target's axes may be off by 1e-6, but solutions must close the loop to 1e-11.
    R = sharpened(sharpened(target.axes))
    back = inverse(Pose(rotation_at(arm, 36), at3(arm, 45)))
    put_axes(X, 0, product(R, back.axes))
    put3(X, 9, (target.point - at3(arm, 48)) * (1.0 / arm[51]) + R.times(back.point))


@inner
def use_form(d):
    """Solve for the target in d (Work) with the ordering of the loop in d.form, and write the solutions to d.found.

    The method is elimination, or decomposition into subproblems if the ordering's degree is 0. Returns the pose of the reordered
    loop and the rank of its equations; after a decomposition, the pose of the loop and a rank of 0.
    """
    if d.form[3] == 0.0:
        decompose(d, d.form[4], False)
        return pose_of(d.loop.X), 0
    return account_for(d)


@inner
def nudge(d, angle):
    """Write to d.loop.X a pose slightly displaced from the target of d (Work), to solve for in its place.

    It is turned by a small angle [rad] and moved by a similar share of the arm's size. An angle of 0 restores the target itself.
    """
    pose, axis = pose_of(d.target), V3(0.48, -0.6, 0.64)  # The axis of the displacement is an arbitrary unit vector.
    R, c, s = pose.axes, math.cos(angle), math.sin(angle)
    turn = M3(rotated(R.x, axis, c, s), rotated(R.y, axis, c, s), rotated(R.z, axis, c, s))
    put_axes(d.loop.X, 0, turn)
    put3(d.loop.X, 9, rotated(pose.point, axis, c, s) + V3(axis.y, axis.z, axis.x) * (0.7 * angle))


@inner
def look_around(d, forms, whole):
    """Look for more solutions of a target whose list may be incomplete, by solving for slightly displaced poses.

    Their solutions are brought back to the target by Newton's method and added to `whole`. Where roots coincide for the target,
    those of a displaced pose do not. Solutions found in this way certify nothing. d: `Work`; forms: orderings of the loop; whole:
    (SIZES.rows, SIZES.columns) the list, see `solve_loops`.
    """
    for k in range(8):  # Four displaced poses are tried, each with the two best orderings.
        f = k // 4
        if f < forms.shape[0]:
            copy(forms[f], d.row)
            nudge(d, (1e-3 if k % 4 < 2 else 2e-2) * (1.0 if k % 2 == 0 else -1.0))
            use_form(d)
            nudge(d, 0.0)
            for n in range(1, int(d.found[0, 0]) + 1):
                for i in range(6):
                    d.loop.q[i] = d.found[n, i]
                if close(d.loop) < TRUST.closed:
                    for i in range(6):
                        d.loop.q[i] = wrapped(d.loop.q[i])
                    put_solution(whole, d.loop.q, least_gain(d.loop), 0.0)


@inner
def all_counted(whole, real):
    """Return whether a list has as many solutions as there are roots that may be real, so that there can be no others.

    Each isolated solution belongs to a root of its own, even where roots are too close to be told apart. If a solution is nearly
    singular, the result is False, because two entries might be one solution. whole: (SIZES.rows, SIZES.columns) the list, see
    `solve_loops`; real: number of roots not proven complex.
    """
    for k in range(1, int(whole[0, 0]) + 1):
        if whole[k, 6] < TRUST.singular:
            return False
    return whole[0, 0] == real


@inner
def list_near(d, pose, rank, within, whole):
    """Append approximate solutions to a certified list: joint values whose pose may be within a tolerance of the target.

    There is one for each complex root near the unit circle, or each merged branch of a decomposition: where two solutions have just
    become complex, the pose nearest the target is near the angles that belong to the root moved onto the circle. If two such roots
    coincide, the list ends and whole[0, 7] is -1. d: `Work`; pose, rank: from `use_form`; within: largest distance of such a root
    from the circle; whole: (SIZES.rows, SIZES.columns) the list, see `solve_loops`.
    """
    n, at = 2 * int(d.form[3]), int(whole[0, 0])
    if n == 0:
        decompose(d, max(d.form[4], DOUBT.near * within * within), True)
        for k in range(1, int(d.found[0, 0]) + 1):
            for i in range(6):
                whole[at + k, i] = d.found[k, i]
        whole[0, 7] = d.found[0, 0] if d.found[0, 7] == 0.0 else -1.0
        return
    for i in range(n):
        z = d.r.z[i]
        if d.r.state[i] != STATE.complex or off_circle(z) > within:
            continue
        if near(d, i, n)[1] > 0 or at + 1 >= SIZES.rows:
            whole[0, 7] = -1.0
            return
        if size(z) > 1.0:
            continue  # The partner of this root inside the circle, 1 / conj(z), is listed instead.
        root = math.atan2(z.imag, z.real)
        find_null(d.e.W, root, d.null)
        find_angles(d.e, rank, pose, root, d.null.x, d.null)
        to_joints(d)
        at += 1
        for k in range(6):
            whole[at, k] = wrapped(d.loop.q[k])
    whole[0, 7] = at - whole[0, 0]


@cached
def solve_loops(forms, arm, T, found, values, within):
    """List every joint solution of N target poses for an arm of six revolute joints.

    The loop equation E1(q1) ... E6(q6) = X may be written in several orderings: reversed or not, begun at any joint. They are tried
    in turn until one certifies its list, or until roots merge (DOUBLE). Solutions found with earlier orderings stay listed; if the
    certified list lacks one of them, its certificate is rejected. An answer is also certified if it has as many solutions as one
    ordering's determinant has roots that are not proven complex.

    Args:
        forms: (F, SIZES.whole) orderings of the loop, best first: a `Form` or a `decomposition.Split`, with its tables.
        arm: (52,) the six joint axes at q = 0 (a direction and a point each), the tip's pose at q = 0 (rotation matrix by rows,
            then the point), the arm's centre (3,) [m] and its size [m]. Points are measured from the centre and divided by the
            size.
        T: (N, 4, 4) targets [m].
        found: (N, SIZES.rows, SIZES.columns) answers: a row of `Notes`, then one row per solution with q in [-pi, pi).
        values: (N, SIZES.samples) receives the values of the first ordering's determinant, and nothing is solved. Pass an array
            of shape (0, SIZES.samples) to solve.
        within: complex roots this near the unit circle give approximate solutions, see `list_near`; 0: none.
    """
    block = np.empty(SIZES.block)
    for t in range(T.shape[0]):
        d = make_work(view(block), fold(view(arm), np.float64, 6, 6))
        motion_to(view(T[t]), view(arm), d.target)
        nudge(d, 0.0)
        for k in range(SIZES.columns):
            found[t, 0, k] = 0.0
        status, roots, real = VERDICT.unsure, 0.0, math.inf
        for f in range(forms.shape[0]):
            copy(view(forms[f]), d.row)
            if values.shape[0] > 0:
                found[t, 0, 3] = set_up(d)[1]
                copy(d.r.values, view(values[t]))
                break
            pose, rank = use_form(d)
            alone = merge_into(d.found, view(found[t]))
            status = int(d.found[0, 1]) if alone or d.found[0, 1] != VERDICT.certain else VERDICT.unsure
            left = d.found[0, 3] - (d.found[0, 4] if d.form[3] > 0.0 else 0.0)
            if d.found[0, 3] > 0.0 and left < real:
                roots, real = d.found[0, 3], left
            for k in range(3, SIZES.columns):
                found[t, 0, k] = d.found[0, k]
            found[t, 0, 2] = f + 1.0 if d.form[3] > 0.0 else 0.0
            if status == VERDICT.certain and within > 0.0:
                list_near(d, pose, rank, within, view(found[t]))
            if status != VERDICT.unsure:
                break
        if status == VERDICT.unsure and values.shape[0] == 0:
            look_around(d, view(forms), view(found[t]))
        if status != VERDICT.certain and all_counted(view(found[t]), real):
            status = VERDICT.certain
            found[t, 0, 3], found[t, 0, 4], found[t, 0, 5] = roots, roots - real, 0.0
            found[t, 0, 7] = -1.0 if roots > real else 0.0  # Complex roots near the circle are not listed here.
        found[t, 0, 1] = status
    keep(block)
