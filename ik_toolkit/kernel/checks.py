"""Decisions made outside the iteration: whether a target is a pose and in reach, and why an attempt makes no progress."""

import math
from typing import NamedTuple

from ..compile.jit import cached, inner
from .algebra import V3, at3, put3, rotation_at
from .counted_error import allowance
from .records import WHAT
from .vectors import dot


class StatusCodes(NamedTuple):
    """The status numbers that compiled solvers return; `solvers.status.Status` explains them to the user.

    Number 10 is not used here: it is COLLISION, which Python finds after the compiled search.
    """

    converged: int = 0
    stalled: int = 1
    iteration_limit: int = 2
    limit_blocked: int = 3
    unreachable: int = 4
    singular: int = 5
    not_finite: int = 6
    check_failed: int = 7
    # The next two codes say that the target or the start is invalid. Python then raises an error, so users never see them.
    bad_target: int = 8
    bad_start: int = 9
    too_far: int = 11
    # States of an attempt that has no final status yet: it goes on; it stands still, because no joint moves any more
    # (`search.conclude` finds out why); or it has come near the best minimum known so far.
    going: int = -1
    still: int = -2
    known: int = -3


class PoseThresholds(NamedTuple):
    """Thresholds that decide whether an array (4, 4) counts as a pose. The values were chosen by hand, not derived."""

    axes: float = 1e-6  # by how much the dot product of two axes may differ from its exact value, 1 or 0
    last_row: float = 1e-9  # by how much the four numbers of the last row may differ, in sum, from 0 0 0 1
    far: float = 1e100  # [m] A pose with coordinates beyond this is refused, because their squares would overflow.


class ProofThresholds(NamedTuple):
    """Thresholds by which a failed attempt is explained: target out of reach, singular pose, or blocked by joint limits."""

    # A target is proven unreachable only if it is out of reach by more than this [arm reaches], which exceeds rounding.
    reach_slack: float = 1e-9
    # If the rotation tolerance is this wide or wider [rad], the target does not determine where the last joint has to be.
    wide: float = 2.0
    unseen: float = 1e-16  # If |J' e|^2 is at most this share of |J|^2 |e|^2 (rounding), no joint changes the error e.
    # An attempt is blocked by limits if the joints that can still move have less than this share of the squared gradient of the
    # error.
    blocked: float = 1e-4


CODE, RIGID, PROOF = StatusCodes(), PoseThresholds(), ProofThresholds()


@inner
def ring(p, reach, hole, ends, slack):
    """Return the length by which a point lies outside an arm's reach, or inside the hole around its base; negative if neither.

    The arm reaches points whose distance from its base is between `hole` and `reach`; both bounds are relaxed by `slack`. The base
    may itself be mounted on a vertical prismatic joint, whose range is in `ends` (Ends). p (V3): the point in the first joint's
    frame. All lengths are divided by the arm's reach.
    """
    across = p.x * p.x + p.y * p.y
    low, high = ends.bound(4), ends.bound(5)
    near = p.z - min(max(p.z, low), high)
    far = max(abs(p.z - low), abs(p.z - high))
    return max(math.sqrt(across + near * near) - reach, hole - math.sqrt(across + far * far)) - slack


@inner
def beyond(goal, ends, task, tol_p, tol_r):
    """Return the length [arm reaches] by which a target is proven out of reach, 0 if nothing is proven.

    Two points must be in reach, within the tolerances: the target's point, for the arm, and the position of the last joint that the
    target's rotation implies, for the arm without its tool. (If the rotation about an axis is free, the part of the tool normal to
    this axis is left out.) goal: (GOAL,) target, as `problem.take` writes it; ends: `Ends`; task: the fields of a `Task`; tol_p,
    tol_r: tolerances of position [arm reaches] and rotation [rad].
    """
    point, slack = at3(goal, 9), allowance(task, 0, tol_p) + PROOF.reach_slack
    if not slack < math.inf:
        return 0.0
    worst = max(0.0, ring(point, ends.bound(0), ends.bound(1), ends, slack))
    angle = allowance(task, 3, tol_r)
    if angle < PROOF.wide:
        tool, side = at3(ends.flat, 21), 0.0
        if task[WHAT.free] > 0.0:
            axis = at3(task, WHAT.ax)
            along = axis * axis.dot(tool)
            side = math.sqrt((tool - along).square())
            tool = along
        wrist = point - rotation_at(goal, 0).times(tool)
        slack += angle * math.sqrt(tool.square()) + side
        worst = max(worst, ring(wrist, ends.bound(2), ends.bound(3), ends, slack))
    return worst


@inner
def edge(goal, ends, excess):
    """Move a target that is out of reach onto the edge of the reach, where the search can approach it.

    It moves by `excess` [arm reaches] towards the first joint, or away from it if it is too near. goal: (GOAL,) target, as
    `problem.take` writes it.
    """
    p = at3(goal, 9)
    centre = V3(0.0, 0.0, min(max(p.z, ends.bound(4)), ends.bound(5)))
    out = p - centre
    d = math.sqrt(out.square())
    put3(goal, 9, centre + out * (1.0 - excess / d if d > 0.5 * ends.bound(0) else 1.0 + excess / max(d, 1e-300)))


@inner
def rigid(T, within):
    """Return whether T (4, 4) is a pose: finite, right-handed, last row 0 0 0 1, and orthonormal axes.

    within: by how much the dot product of two axes may differ from its exact value, 1 or 0.
    """
    total = 0.0
    last = abs(T[3, 3] - 1.0)
    for r in range(3):
        total += abs(T[r, 3])
        last += abs(T[3, r])
        for c in range(r, 3):
            g = T[0, r] * T[0, c] + T[1, r] * T[1, c] + T[2, r] * T[2, c]
            if not abs(g - (1.0 if r == c else 0.0)) < within:
                return False
    det = T[0, 0] * (T[1, 1] * T[2, 2] - T[1, 2] * T[2, 1]) - T[0, 1] * (T[1, 0] * T[2, 2] - T[1, 2] * T[2, 0])
    det += T[0, 2] * (T[1, 0] * T[2, 1] - T[1, 1] * T[2, 0])
    return det > 0.0 and total < RIGID.far and last < RIGID.last_row


@cached
def is_rigid(T):
    """Return whether T (4, 4) is a pose: the function `rigid`, with its usual tolerance, compiled so that Python may call it."""
    return rigid(T, RIGID.axes)


@inner
def standstill(p, look, near, boxed):
    """Return why an attempt makes no progress: CODE.limit_blocked, CODE.singular (no joint changes the error) or CODE.stalled.

    p: the problem, whose p.desk.J must be the Jacobian at the configuration of the errors `look`; near: the joint limits that steps
    must respect (Ends); boxed: whether there are any.
    """
    q, J = p.desk.q, p.desk.J
    whole, free, size = 0.0, 0.0, 0.0
    for i in range(q.shape[0]):
        g = p.slope(look, i)
        size += dot(J[i], J[i], J.shape[1])
        whole += g * g
        if not (boxed and ((q[i] <= near.lower(i) and g < 0.0) or (q[i] >= near.upper(i) and g > 0.0))):
            free += g * g
    if whole <= PROOF.unseen * look.ee * size:
        return CODE.singular
    return CODE.limit_blocked if free < PROOF.blocked * whole else CODE.stalled
