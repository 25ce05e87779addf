"""Two turning joints with parallel axes, asked for a position: both elbow branches in closed form."""

import math
from typing import Any, NamedTuple

import numpy as np

from ...errors import UnknownSolver
from ...kernel import slots
from ...kernel.chain import Chain
from ...kernel.checks import BAD_START, BAD_TARGET, rigid
from ...kernel.jit import cached, jit
from ...kernel.loop import ENTRIES
from .geometry import FIT, across, angle_about, copy_limits, legal_start, legal_turn, measure_tip, read_screws
from .reach import planar_branches, planar_margin

# Slots of the parameters: base -> arm plane (12), then these, then sign and offset of each angle: theta = sign q + offset.
L1, L2, HEIGHT, ANGLES = 12, 13, 14, 15


class Planar2R(NamedTuple):
    """Both elbow branches of two turning joints with parallel axes, for positions; the legal one nearest q0 is returned.

    Any link lengths, base pose, axis signs, angle and height offsets. Source: Chinyai, eqs. (1)-(5), with the second branch,
    the signs and the quadrants corrected.
    """

    def pack(self, robot: Any) -> np.ndarray:
        """Geometry for the compiled solver. Raises UnknownSolver when the robot is no such arm."""
        parameters, reason = recognise(robot.chain)
        if reason:
            raise UnknownSolver(f"solver 'planar-2r' does not fit robot '{robot.name}': {reason}")
        return parameters


def recognise(chain: Chain) -> tuple[np.ndarray, str]:
    """Parameters of the arm read off its joint axes, and '' or why it is not two parallel turning joints."""
    none = np.zeros(0)
    if chain.n != 2:
        return none, f"it has {chain.n} joints on the path, not 2"
    screws = read_screws(chain)
    if isinstance(screws, str):
        return none, screws
    if not screws.turns.all():
        return none, "one of its two joints slides; both must turn"
    z, other = screws.axis
    tilt = float(np.linalg.norm(np.cross(z, other)))
    if tilt > FIT:
        return none, f"its two axes are not parallel (off by {tilt:.2g} rad)"
    tip = screws.T[:3, 3]
    link = across(z, screws.point[1] - screws.point[0])
    hand = across(z, tip - screws.point[1])
    l1, l2 = float(np.linalg.norm(link)), float(np.linalg.norm(hand))
    if min(l1, l2) <= FIT * chain.reach:
        return none, "its two axes coincide" if l1 <= l2 else "its tip lies on the second axis"
    x = link / l1
    sign = 1.0 if z @ other > 0.0 else -1.0
    R = np.vstack([x, np.cross(z, x), z])
    angles = [1.0, 0.0, sign, angle_about(z, x, hand / l2)]
    height = z @ (tip - screws.point[0])
    return np.concatenate([R.ravel(), -R @ screws.point[0], [l1, l2, height], angles]), ""


@jit
def to_plane(p, T):
    """Position of T (4, 4) in the arm's plane: along it (2), and the distance off it."""
    x = p[0] * T[0, 3] + p[1] * T[1, 3] + p[2] * T[2, 3] + p[9]
    y = p[3] * T[0, 3] + p[4] * T[1, 3] + p[5] * T[2, 3] + p[10]
    z = p[6] * T[0, 3] + p[7] * T[1, 3] + p[8] * T[2, 3] + p[11]
    return x, y, z - p[HEIGHT]


@jit
def joint_values(p, angles, box, q):
    """Fill q (2,) with the legal turns of theta_1, theta_2 nearest box[2]; return the worst limit broken and the distance."""
    worst, distance = 0.0, 0.0
    for i in range(2):
        x = p[ANGLES + 2 * i] * (angles[i] - p[ANGLES + 2 * i + 1])
        q[i], broken = legal_turn(x, box[0, i], box[1, i], box[2, i])
        worst = max(worst, broken)
        distance += box[3, i] * (q[i] - box[2, i]) ** 2
    return worst, distance


@jit
def nearest_on_limits(p, x, y, box, q, best):
    """Fill best (2,) with the legal configuration that comes nearest to (x, y), when no branch is legal.

    Then a joint stands on a limit: with joint 1 there the tip runs on a circle about the elbow, with joint 2 there on one
    about the base; the nearest point of the arc is where the circle's angle is nearest that of the target.
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
        for turned in range(
            3
        ):  # the angle itself, and both limits: of an arc that leaves it out, the nearer end counts
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
                best[:] = q


def _compile_solve():
    @cached
    def solve(rows, ends, seeds, feat, T, Q0, out, opt, hist):
        n = 2
        p = opt[slots.OPT_HEAD + n :]
        box = np.empty((4, n))
        near = p[ANGLES + 1]
        sols = np.empty((2, 2))
        q, best = np.empty(n), np.empty(n)
        goal, Z, trig = np.empty(12), np.empty((2, 6)), np.zeros((3, 4))
        for t in range(T.shape[0]):
            if not rigid(T[t]):
                out[t, 0] = BAD_TARGET
                continue
            q0 = Q0[t if Q0.shape[0] > 1 else 0]
            if opt[slots.O_GIVEN] > 0.0 and not legal_start(ends, opt, q0):
                out[t, 0] = BAD_START
                continue
            copy_limits(ends, opt, q0, box)
            near = p[ANGLES] * box[2, 0] + p[ANGLES + 1]
            x, y, off = to_plane(p, T[t])
            gap = math.hypot(max(0.0, -planar_margin(x, y, p[L1], p[L2])), off)
            least, nearest = np.inf, np.inf
            for k in range(planar_branches(x, y, p[L1], p[L2], near, sols)):
                worst, distance = joint_values(p, sols[k], box, q)
                if worst < least or (worst == least and distance < nearest):
                    least, nearest = worst, distance
                    best[:] = q
            if least > 0.0:
                nearest_on_limits(p, x, y, box, q, best)
            measure_tip(rows, ends, opt, T[t], best, box, least, gap, 0.0, goal, Z, trig, hist, out[t])

    return solve


def _compile_all():
    @cached
    def every(p, T, box, out, broken):
        """Fill out (2, 2) with the branches of T (4, 4) and broken (2,) with the limit each breaks; return how many."""
        x, y, off = to_plane(p, T)
        sols = np.empty((2, 2))
        count = planar_branches(x, y, p[L1], p[L2], p[ANGLES] * box[2, 0] + p[ANGLES + 1], sols)
        for k in range(count):
            broken[k] = joint_values(p, sols[k], box, out[k])[0]
        return count

    return every


ENTRIES[Planar2R] = _compile_solve()
every_branch = _compile_all()
