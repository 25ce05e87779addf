"""Solves two revolute joints with parallel axes for a position: both elbow branches in closed form."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ...compile.jit import cached, inner
from ...kernel.chain import Chain
from ...kernel.checks import CODE, RIGID, rigid
from ...kernel.kinematics import room
from ...kernel.records import SIZE, copy
from ..explain.worked_solution import WorkedSolution
from ..protocol import closed_form
from .geometry import (
    FIT,
    NEAR,
    Branches,
    Family,
    Fit,
    across,
    angle_about,
    copy_limits,
    legal_turn,
    measure_tip,
    no_fit,
    one_turn,
    read_revolute,
)
from .nearest import choose
from .reach import ANGLES, L1, L2, NEARLY, joint_values, list_planar, planar_branches, planar_margin, to_plane

STEPS = 8  # number of Newton steps that correct a solution if the two axes are only nearly parallel


def recognise_planar(chain: Chain) -> Fit:
    """Return a Fit: whether, and how exactly, a chain consists of two revolute joints with parallel axes."""
    screws = read_revolute(chain, 2)
    if isinstance(screws, str):
        return no_fit(screws)
    z, other = screws.axis
    tilt = float(np.linalg.norm(np.cross(z, other)))
    if tilt > NEAR:
        return no_fit(f"its two axes are not parallel (off by {tilt:.2g} rad)")
    tip = screws.T[:3, 3]
    link = across(z, screws.point[1] - screws.point[0])
    hand = across(z, tip - screws.point[1])
    l1, l2 = float(np.linalg.norm(link)), float(np.linalg.norm(hand))
    if min(l1, l2) <= NEAR * chain.reach:
        return no_fit("its two axes coincide" if l1 <= l2 else "its tip lies on the second axis")
    x = link / l1
    sign = 1.0 if z @ other > 0.0 else -1.0
    R = np.vstack([x, np.cross(z, x), z])
    angles = [1.0, 0.0, sign, angle_about(z, x, hand / l2), float(tilt > FIT)]
    height = z @ (tip - screws.point[0])
    return Fit(np.concatenate([R.ravel(), -R @ screws.point[0], [l1, l2, height], angles]), "", tilt)


@inner
def nearest_on_limits(p, x, y, box, q, best):
    """Fill best (2,) with the configuration inside the limits whose tip is nearest (x, y) [m], if no branch is inside them.

    One joint is then at a limit. If it is joint 1, the tip moves on an arc about the elbow; if it is joint 2, on an arc about the
    base. The nearest point of the arc lies in the direction of (x, y) from its centre, or is an end of the arc. p: the arm's
    parameters (`reach`); box (4, 2): lower and upper limits, reference [rad], weights; q (2,) is scratch.
    """
    a, b = p[L1], p[L2]
    miss = np.inf
    for side in range(4):
        i, limit = side // 2, box[side % 2, side // 2]
        if not np.isfinite(limit):
            continue
        fixed = p[ANGLES + 2 * i] * limit + p[ANGLES + 2 * i + 1]
        if i == 0:
            free = math.atan2(y - a * math.sin(fixed), x - a * math.cos(fixed)) - fixed
        else:
            free = math.atan2(y, x) - math.atan2(b * math.sin(fixed), a + b * math.cos(fixed))
        j = 1 - i
        q[i] = limit
        angle = p[ANGLES + 2 * j] * (free - p[ANGLES + 2 * j + 1])
        # Three angles are tried: the one towards (x, y), and the arc's two ends in case the arc does not contain it.
        for turned in range(3):
            if turned == 0:
                q[j] = legal_turn(angle, box[0, j], box[1, j], box[2, j])[0]
                q[j] = min(max(q[j], box[0, j]), box[1, j])
            elif np.isfinite(box[turned - 1, j]):
                q[j] = box[turned - 1, j]
            t1 = p[ANGLES] * q[0] + p[ANGLES + 1]
            t2 = t1 + p[ANGLES + 2] * q[1] + p[ANGLES + 3]
            off = math.hypot(a * math.cos(t1) + b * math.cos(t2) - x, a * math.sin(t1) + b * math.sin(t2) - y)
            if off < miss:
                miss = off
                copy(q, best)


@cached
def solve_planar(rows, ends, seeds, feat, T, Q0, out, opt, hist):
    """Solve targets with the closed form: of the solutions (branches) inside the limits, the one nearest the start is the answer.

    If there is none, the row gets the configuration whose tip is nearest the target. The arguments are those of
    `protocol.ClosedForm.loop`.
    """
    n = 2
    p = opt[SIZE.weights + n :]
    box = np.empty((4, n))
    sols, Q = np.empty((2, 2)), np.empty((2, n))
    q, best = np.empty(n), np.empty(n)
    goal, joints, trig = np.empty(12), np.empty(room(2)[0]), np.zeros(room(2)[1])
    for t in range(T.shape[0]):
        if not rigid(T[t], RIGID.axes):
            out[t, 0] = CODE.bad_target
            continue
        q0 = Q0[t if Q0.shape[0] > 1 else 0]
        if not copy_limits(ends, opt, q0, box):
            out[t, 0] = CODE.bad_start
            continue
        near = p[ANGLES] * box[2, 0] + p[ANGLES + 1]
        x, y, off = to_plane(p, T[t])
        gap = math.hypot(max(0.0, -planar_margin(x, y, p[L1], p[L2])), off)
        count = planar_branches(x, y, p[L1], p[L2], near, sols)
        # If the axes are only nearly parallel, solutions are corrected by Newton steps, and failures prove nothing.
        if p[NEARLY] > 0.0:
            for k in range(count):
                joint_values(p, sols[k], box, Q[k])
            choose(rows, ends, T[t], Q[:count], STEPS, -1, q0, opt, hist, out[t])
            continue
        least, nearest = np.inf, np.inf
        for k in range(count):
            worst, distance = joint_values(p, sols[k], box, q)
            if worst < least or (worst == least and distance < nearest):
                least, nearest = worst, distance
                copy(q, best)
        if least > 0.0:
            nearest_on_limits(p, x, y, box, q, best)
        measure_tip(rows, ends, opt, T[t], best, box, least, gap, 0.0, goal, joints, trig, hist, out[t])


@closed_form
class Planar2R(NamedTuple):
    """Both elbow branches of two revolute joints with parallel axes, for positions; returns the one within limits nearest q0.

    Link lengths, base pose, axis signs, angle and height offsets are free. Source: Chinyai, eqs. (1)-(5), with the
    second branch, the signs and the quadrants corrected.
    """

    recognise = staticmethod(recognise_planar)

    def every(self, robot: Any, p: np.ndarray, T: np.ndarray, box: np.ndarray, count: int) -> Branches:
        """Return the elbow branches of two parallel revolute axes for the position of T (4, 4).

        If the links fold back onto the base, the first joint is free and `count` of its values are listed. p: the arm's parameters
        (`reach`); box (4, 2): lower and upper limits, reference [rad], weights.
        """
        q, broken, marks = np.empty((2, 2)), np.empty(2), np.empty((2, 3), dtype=np.int8)
        found, folded = list_planar(p, T, box, q, broken, marks)
        nearly = p[NEARLY] > 0.0
        families = ()
        if folded and found and broken[0] == 0.0:
            low, high = one_turn(box[0, 0], box[1, 0], box[2, 0])
            q = np.column_stack([np.linspace(low, high, count), np.full(count, q[0, 1])])
            found, broken, marks = count, np.zeros(count), np.zeros((count, 3), dtype=np.int8)
            first = robot.joint_names[0]
            text = f"the links fold back onto the base: {first} is free from {low:.6g} to {high:.6g} rad"
            families = (Family((first,), float(low), float(high), text),)
        complete = not (nearly or families)
        return Branches(q[:found], broken[:found], marks[:found], complete, "", families, STEPS if nearly else 0)

    def derive(self, robot: Any, p: np.ndarray, T: np.ndarray, box: np.ndarray) -> WorkedSolution:
        """Return the formulas and their numbers for the position of T (4, 4), to explain a solve.

        p: the arm's parameters (`reach`); box (4, n): lower and upper limits, the answer to be explained [rad], weights.
        """
        from .planar_2r_steps import derive_planar

        return derive_planar(robot, p, T, box)

    def loop(self, robot: Any) -> Callable:
        """Return the compiled function that solves targets with this closed form, called as `protocol.ClosedForm.loop` says."""
        return solve_planar
