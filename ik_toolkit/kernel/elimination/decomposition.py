"""Arms whose geometry splits into subproblems, so that all their solutions are branches of at most three square roots.

- A wrist: the last three axes meet in a point, which joints 1 to 3 place. Two square roots give these joints if axes 2 and 3, or 1
  and 2, are parallel or meet (Pieper 1968). Joints 4 to 6 give the orientation.
- Three parallel axes: axes 2 to 4 are parallel, and axes 5 and 6 meet in a point. Joint 1 alone sets how high this point is along
  the parallel axes. The direction of these axes then gives joints 5 and 6, and joints 2 to 4 are a planar arm.

"First" and "last" are those of the reordered loop (`closure.reorder`), so that a wrist may be at the base, or in the middle. An arm
that almost fits is decomposed as if it did, and each branch is refined on the actual arm. The misfit counts as an error of every
number. Where that error could make a branch appear or vanish, the answer is UNSURE, and the elimination is used.
"""

# Numba's type hints are incomplete, so pyright must not report what they lack.
# pyright: reportCallIssue=false, reportArgumentType=false, reportGeneralTypeIssues=false
import itertools
import math
from typing import NamedTuple

import numpy as np

from ...compile.jit import inline, inner
from .account import put_solution, to_joints
from .angles import any_normal
from .closure import (
    Line,
    close,
    joint_at,
    least_gain,
    line_moved,
    line_of,
    measure_loop,
    reorder,
    rotated,
    turned,
    wrapped,
)
from .subproblems import Angles, angle_from, arcs_between, circle_about, height_on, solve_sum, square_on
from .terms import DOUBT, SIZES, TRUST, VERDICT


class Split(NamedTuple):
    """A way to decompose an arm into subproblems: its joint order, and which of its axes meet or are parallel.

    It is the start of a row of `forms` of `answer.solve_loops`, with the same layout as a `terms.Form`. The last 84 numbers of the
    row hold the joints' axes, moved so that they meet or are parallel exactly.
    """

    backwards: float  # 1 if the loop is reversed
    shift: float  # how many joints after the first one the reordered loop begins
    parallel: float  # 1 if axes 2 to 4 are parallel, 0 if the last three axes meet in a wrist
    degree: float  # always 0, which tells a Split from a Form: there is no determinant
    off: float  # how far the actual axes are from the moved ones [rad and arm sizes, summed], at least the rounding error
    # 1 if the equation that is solved first equates distances (two axes meet), 0 if heights along an axis (two are parallel)
    square: float
    third: float  # 1 if the unknown of the equation that is solved first is joint 3, 0 if it is joint 1


# ------------------------------------------------------------------------------------------------------------------ branches
@inline
def turn_back(v, line, t):
    """Return a direction v turned about a line by the angle -t [rad]."""
    return rotated(v, line.along, math.cos(t), -math.sin(t))


@inline
def lever(line, point):
    """Return the distance of a point (V3) from a line."""
    return circle_about(line, point, 1.0).width()


@inner
def put_branch(d, free, half, merged, doubt, error, near):
    """Add one branch, a joint solution of a decomposed arm, to the list d.found, after refining it on the actual arm.

    A doubtful branch gives the whole list the status UNSURE.

    Args:
        d: Working memory (`answer.Work`); the branch is in d.null.t (6,), angles of the reordered loop.
        free: Index in the loop of an angle that may have any value, or -1.
        half: By how much that angle may turn either way [rad].
        merged: Whether the branch may be the same as another, or may not exist.
        doubt: Whether it is doubtful.
        error: Bound of the errors of its angles [rad].
        near: Whether to add only branches that may be the same as another, and not to refine them.
    """
    q, found = d.loop.q, d.found
    to_joints(d)
    if near:
        count = int(found[0, 0])
        if merged and count + 1 < SIZES.rows:
            found[0, 0] = count + 1.0
            for i in range(6):
                found[count + 1, i] = wrapped(q[i])
            found[0, 7] = -1.0 if free >= 0 else found[0, 7]
        return
    # A free angle needs no refining, but one that is only doubtfully free is refined: the list must not have poses that miss the
    # target.
    free = -1 if doubt else free
    size, moved, inexact = measure_loop(d.loop, q), 0.0, d.form[4] > DOUBT.rounding
    if free < 0 and (size > TRUST.closed or (inexact and not merged)):
        size = close(d.loop)
        for place in range(6):
            t = -d.null.t[place] if d.form[0] > 0.0 else d.null.t[place]
            moved = max(moved, abs(wrapped(q[joint_at(place, d.form[0] > 0.0, int(d.form[1]))] - t)))
    for i in range(6):
        q[i] = wrapped(q[i])
    # A solution in a continuum need not be as accurate as an isolated one.
    closed = size < (TRUST.closed if free < 0 else DOUBT.loose) and moved <= max(DOUBT.apart, DOUBT.band * error)
    gain, again = least_gain(d.loop), 0
    if closed:
        again = put_solution(found, q, gain, 1.0 + free)
        if again == 0 and free >= 0:
            found[int(found[0, 0]), 8] = half
    vague = not merged and (gain * DOUBT.apart < DOUBT.rounding or (inexact and again > 0))
    if doubt or vague or not closed:
        found[0, 1] = VERDICT.unsure
    elif free >= 0 and found[0, 1] != VERDICT.unsure:
        found[0, 1] = VERDICT.family


@inner
def split_wrist(d, pose, off, near):
    """Find all joint solutions of an arm whose last three axes meet (a wrist), and add them to d.found.

    d: working memory (`answer.Work`); pose: pose of the loop, reordered so that these three axes come last; off, near: as for
    `decompose`.
    """
    lines, t = d.e.lines, d.null.t
    one, two, three = line_of(lines, 0), line_of(lines, 1), line_of(lines, 2)
    four, five, six = line_of(lines, 3), line_of(lines, 4), line_of(lines, 5)
    goal = pose.axes.times(six.point) + pose.point
    square, third = d.form[5] > 0.0, d.form[6] > 0.0
    lead = 2 if third else 0  # index in t of the joint angle that is found first
    error = off * (1.0 + math.sqrt(goal.square()))
    # Let c be the wrist centre, Ei the motion of joint i, and X the pose to reach. E2 takes the point E3 c to E1^-1 X c, so both
    # have the same height along axis 2, and the same distance from any point of axis 2.
    ring, other = circle_about(one, goal, -1.0), circle_about(three, four.point, 1.0)
    ring, other = (other, ring) if third else (ring, other)
    height, square1, height2, square2 = (
        height_on(ring, two.along), square_on(ring, two.point), height_on(other, two.along), square_on(other, two.point),
    )  # fmt: skip
    # One side of one of the two equations is constant, so that equation has one unknown.
    here, there, here2, there2 = (square1, square2, height, height2) if square else (height, height2, square1, square2)
    A = solve_sum(here, there.k, error)
    normal = any_normal(six.along)
    for i in range(A.number):
        x = A.first if i == 0 else A.second
        cx, sx = math.cos(x), math.sin(x)
        at = ring.spot(cx, sx)
        vague = here2.drift(cx, sx, A.error) + error * (1.0 + math.sqrt((at - two.point).square()))
        B = solve_sum(there2, here2.value(cx, sx), vague)
        for j in range(B.number):
            y = B.first if j == 0 else B.second
            then = other.spot(math.cos(y), math.sin(y))
            far = error + A.error * ring.width() + B.error * other.width()
            start, end = (at, then) if third else (then, at)
            C = angle_from(two.along, start - two.point, end - two.point, far)
            t[lead], t[1], t[2 - lead] = x, C.first, y
            turn = off + A.error + B.error + C.error
            u, n = pose.axes.times(six.along), pose.axes.times(normal)
            for k in range(3):
                line = line_of(lines, k)
                u, n = turn_back(u, line, t[k]), turn_back(n, line, t[k])
            # Joints 4 and 5 follow from R4^-1 u = R5 l6, where Ri is the rotation of joint i, l6 the direction of axis 6, and u
            # this direction turned by the pose and back by joints 1 to 3.
            cone = circle_about(Line(four.along, u * 0.0), u, -1.0)
            D = solve_sum(height_on(cone, five.along), five.along.dot(six.along), turn)
            doubt = A.doubt or B.doubt or C.doubt or D.doubt
            merged = A.merged or B.merged or C.merged or D.merged
            free = lead if A.free else 2 - lead if B.free else 1 if C.free else 3 if D.free else -1
            if D.number == 0 and (A.free or B.free or C.free):
                # The free angle was tried at a single value only, so there may be solutions at others.
                d.found[0, 1], d.found[0, 7] = VERDICT.unsure, -1.0
            for k in range(D.number):
                t[3] = D.first if k == 0 else D.second
                z = turn_back(u, four, t[3])
                t[4] = angle_from(five.along, six.along, z, 0.0).first
                t[5] = angle_from(six.along, normal, turn_back(turn_back(n, four, t[3]), five, t[4]), 0.0).first
                put_branch(d, free, math.pi, merged, doubt, turn + D.error, near)


@inner
def split_parallel(d, pose, off, near):
    """Find all joint solutions of an arm whose axes 2 to 4 are parallel and whose axes 5 and 6 meet; add them to d.found.

    d: working memory (`answer.Work`); pose: pose of the loop, reordered so that the axes are these; off, near: as for `decompose`.
    """
    lines, t = d.e.lines, d.null.t
    one, two, three = line_of(lines, 0), line_of(lines, 1), line_of(lines, 2)
    four, five, six = line_of(lines, 3), line_of(lines, 4), line_of(lines, 5)
    goal, w = pose.axes.times(six.point) + pose.point, two.along
    error = off * (1.0 + math.sqrt(goal.square()))
    # Let Ei be the motion of joint i, X the pose to reach, w the direction of the parallel axes, and o the point where axes 5 and 6
    # meet. E2 E3 E4 keeps heights along w, so o and E1^-1 X o have the same height.
    A = solve_sum(height_on(circle_about(one, goal, -1.0), w), w.dot(six.point), error)
    normal, elbow = any_normal(w), circle_about(three, four.point, 1.0)
    for i in range(12 if A.free else A.number):
        if A.free and d.found[0, 0] > 0.0:
            break
        t[0] = A.second if i == 1 else A.first + (math.pi / 6.0) * i
        c1, s1 = math.cos(t[0]), math.sin(t[0])
        # Joints 5 and 6 follow from R5 R6 v = w with v = X^-1 R1 w, where Ri is the rotation of joint i and w the direction of the
        # parallel axes.
        v = pose.axes.across(rotated(w, one.along, c1, s1))
        cone = circle_about(Line(six.along, v * 0.0), v, 1.0)
        turn = off + A.error
        D = solve_sum(height_on(cone, five.along), five.along.dot(w), turn)
        unsure, loose, half = A.doubt or D.doubt, D.free, math.pi
        # Axis 6 is parallel to axes 2 to 4 here, so joint 6 is free within the range in which the elbow reaches. The middle of it
        # is listed.
        if loose:
            t[4] = angle_from(five.along, v, w, 0.0).first
            a, fold = turned(four, five, math.cos(t[4]), -math.sin(t[4])).point, square_on(elbow, two.point)
            far = square_on(circle_about(six, a, -1.0), pose.axes.across(turned(two, one, c1, s1).point - pose.point))
            arcs = arcs_between(far, fold.k - fold.swing(), fold.k + fold.swing())
            D = Angles(arcs.first, arcs.second, arcs.number, 0.0, True, True, unsure)
            half = arcs.half
        for k in range(D.number):
            t[5] = D.first if k == 0 else D.second
            c6, s6 = math.cos(t[5]), math.sin(t[5])
            t[4] = angle_from(five.along, rotated(v, six.along, c6, s6), w, 0.0).first
            # The equation E2 E3 E4 = E1^-1 X E6^-1 E5^-1 (Ei: motion of joint i) is applied to the point of axis 4, which E4 does
            # not move, and to a vector normal to the parallel axes.
            at5 = turned(Line(normal, four.point), five, math.cos(t[4]), -math.sin(t[4]))
            at6 = line_moved(pose, turned(at5, six, c6, -s6))
            line, swept = turned(at6, one, c1, -s1), circle_about(one, at6.point, -1.0)
            arms = D.error * (lever(five, at5.point) + lever(six, at5.point))
            away, error2 = line.point - two.point, error + arms
            vague = square_on(swept, two.point).drift(c1, s1, A.error) + error2 * (1.0 + math.sqrt(away.square()))
            B = solve_sum(square_on(elbow, two.point), 0.5 * away.square(), vague)
            whole = angle_from(w, normal, line.along, 0.0).first
            for j in range(B.number):
                t[2] = B.first if j == 0 else B.second
                start = elbow.spot(math.cos(t[2]), math.sin(t[2])) - two.point
                C = angle_from(w, start, away, error2 + A.error * swept.width() + B.error * elbow.width())
                t[1] = C.first
                t[3] = four.along.dot(w) * (whole - t[1] - three.along.dot(w) * t[2])
                merged = A.merged or B.merged or C.merged or D.merged
                free = 0 if A.free else 5 if loose else 1 if C.free else -1
                put_branch(d, free, half, merged, unsure or B.doubt or C.doubt, turn + error2 + B.error + C.error, near)
    if A.free and d.found[0, 0] == 0.0:
        # Any value of joint 1 may have solutions, and only twelve values were tried.
        d.found[0, 1], d.found[0, 7] = VERDICT.unsure, -1.0


@inner
def decompose(d, off, near):
    """Find all joint solutions of the target in d (`answer.Work`) by decomposing the arm, and write them to d.found.

    The decomposition is in d.form and d.mix, see `Split`. off: the error that every number is assumed to have. near: whether to
    list only solutions that may merge with another within this error, without refining them.
    """
    found = d.found
    for k in range(SIZES.columns):
        found[0, k] = 0.0
    found[0, 1] = VERDICT.certain
    pose = reorder(d.mix, d.loop.X, d.form[0] > 0.0, int(d.form[1]), d.e.lines)
    if d.form[2] > 0.0:
        split_parallel(d, pose, off, near)
    else:
        split_wrist(d, pose, off, near)
    if found[0, 1] != VERDICT.unsure or off < DOUBT.alike:
        found[0, 3], found[0, 4] = SIZES.branches, SIZES.branches - found[0, 0]
    found[0, 6] = off


# --------------------------------------------------------------------------------------------------------------- recognition
def splits_of(arm: np.ndarray) -> list[np.ndarray]:
    """Return the decompositions that an arm may have, as a list of `Split` rows; those that fit it best come first.

    arm: (52,) geometry, see `answer.solve_loops`.
    """
    wrist, lines = (True, (3, 4, 5)), arm[:36].reshape(6, 6)
    # Each row has the fields `parallel`, `square` and `third` of a Split, then its conditions: axes that must meet (True) or be
    # parallel (False).
    structures = (
        (0, 0, 0, (wrist, (False, (1, 2)))),
        (0, 1, 0, (wrist, (True, (1, 2)))),
        (0, 0, 1, (wrist, (False, (0, 1)))),
        (0, 1, 1, (wrist, (True, (0, 1)))),
        (1, 0, 0, ((False, (1, 2, 3)), (True, (4, 5)))),
    )
    found = []
    for backwards, shift in itertools.product((0, 1), range(6)):
        joints = [joint_at(place, bool(backwards), shift) for place in range(6)]
        for parallel, square, third, conditions in structures:
            made = lines.copy()
            for meet, places in conditions:
                which = [joints[place] for place in places]
                if any(abs(i - j) != 1 for i, j in itertools.pairwise(which)):
                    break  # In the arm's order these joints are not consecutive, so the target's pose would be between two of them.
                made[which] = (_meeting if meet else _parallel)(made[which])
            else:
                off = max(_apart(lines, made), DOUBT.rounding)
                row = np.zeros(SIZES.whole)
                row[:7] = Split(backwards, shift, parallel, 0, off, square, third)
                row[-84:].reshape(6, 14)[:, :6] = made
                found.append(row)
    found = [row for row in found if row[4] < DOUBT.off]
    return sorted(found, key=lambda row: (round(math.log10(row[4])), row[1], row[0]))


def nearest_point(lines: np.ndarray) -> np.ndarray:
    """Return the point (3,) nearest to lines (K, 6), each a unit direction and a point."""
    axes, points = lines[:, :3], lines[:, 3:]
    P = np.eye(3) - axes[:, :, None] * axes[:, None, :]  # projection onto the plane normal to each axis
    return np.linalg.lstsq(P.reshape(-1, 3), (P @ points[:, :, None]).ravel(), rcond=None)[0]


def _apart(lines: np.ndarray, others: np.ndarray) -> float:
    """Return by how much axes (6, 6) differ from others: the sum of changes in direction and of displacements normal to them."""
    steps = others[:, 3:] - lines[:, 3:]
    across = steps - lines[:, :3] * (steps * lines[:, :3]).sum(axis=1, keepdims=True)
    return float(np.linalg.norm(others[:, :3] - lines[:, :3], axis=1).sum() + np.linalg.norm(across, axis=1).sum())


def _meeting(lines: np.ndarray) -> np.ndarray:
    """Return lines (K, 6) moved so that all pass through the point nearest to them."""
    return np.hstack([lines[:, :3], np.broadcast_to(nearest_point(lines), (len(lines), 3))])


def _parallel(lines: np.ndarray) -> np.ndarray:
    """Return lines (K, 6) turned to their common mean direction, each keeping its sense."""
    signs = np.sign(lines[:, :3] @ lines[0, :3])
    mean = signs @ lines[:, :3]
    return np.hstack([np.outer(signs, mean / max(float(np.linalg.norm(mean)), 1e-9)), lines[:, 3:]])
