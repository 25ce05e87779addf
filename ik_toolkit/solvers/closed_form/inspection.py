"""Solves an arm with a spherical shoulder on a lift, a prismatic joint (the 7-joint inspection robot): all branches in closed form.

The arm is recognised by its axes. Joint 1 turns about an axis along which joint 2 slides (in either order, or the prismatic joint
is locked or absent). Axes 1, 3 and 4 meet in one point, the shoulder, each at right angles to the next. Axis 5 is parallel to axis
4. Axis 6 crosses axis 5 at right angles, in the plane through the shoulder perpendicular to axis 5. Axis 7 is parallel to axis 6.
Base, tool, axis signs, angle offsets and lengths are arbitrary.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ...compile.jit import cached, inner
from ...errors import InvalidOption
from ...kernel.chain import Chain
from ...kernel.checks import CODE, RIGID, rigid
from ...kernel.kinematics import room
from ...kernel.records import AT, ORDER, SIZE, copy
from ..explain.worked_solution import WorkedSolution
from ..protocol import Asked, closed_form, fitted
from .geometry import (
    FIT,
    NEAR,
    SNAP,
    Fit,
    across,
    angle_about,
    copy_limits,
    measure_tip,
    no_fit,
    read_screws,
)
from .lift_arm import (
    A4,
    A6,
    GIVEN,
    LIFT,
    MIDDLE,
    NEAREST,
    NEARLY,
    WINDOWS,
    choose_lift,
    joint_values,
    lift_limits,
    narrow_windows,
    near_angles,
    pick,
    pick_level,
    scan_lifts,
    shoulder_on_axes,
    stopped_at,
    wrist_pose,
)
from .lift_list import every_branch, feasible_lifts, listing, nearest_pose
from .nearest import choose
from .reach import inspection_branches, inspection_margin, inspection_nearest, lift_intervals

__all__ = ["Inspection", "every_branch", "feasible_lifts", "nearest_pose", "recognise", "wrist_pose"]
# largest number of Newton steps that refine an answer with the robot's own kinematics
STEPS = 24
CHOICES: dict[Any, int] = {"nearest": NEAREST, "mid": MIDDLE}


def recognise(chain: Chain) -> Fit:
    """Return a Fit: whether, and how exactly, a chain is a six-joint arm with a spherical shoulder, on a prismatic lift or not."""
    if chain.n not in (6, 7):
        return no_fit(f"it has {chain.n} joints on the path, not a lift and 6 revolute joints (or these 6)")
    screws = read_screws(chain)
    if isinstance(screws, str):
        return no_fit(screws)
    slides = np.flatnonzero(~screws.turns)
    if len(slides) != chain.n - 6 or (len(slides) and slides[0] > 1):
        return no_fit("its only prismatic joint must be the lift, first or second on the path")
    order = np.flatnonzero(screws.turns)
    z1, z3, z4, z5, z6, z7 = screws.axis[order]
    c1, c3, c4, c5, c6, c7 = screws.point[order]
    off = []  # pairs of a deviation [rad, or length / reach] from the assumed geometry, and a message about it
    if len(slides):
        turned = np.linalg.norm(np.cross(z1, screws.axis[slides[0]]))
        off.append((turned, "its lift does not move along the first revolute axis"))
    # Messages number revolute joints from the base, so that they are the same with and without a lift.
    for pair, a, b in (("1 and 2", z1, z3), ("2 and 3", z3, z4), ("4 and 5", z5, z6)):
        off.append((abs(a @ b), f"its revolute joints {pair} are not at right angles (cosine {a @ b:.2g})"))
    for pair, a, b in (("3 and 4", z4, z5), ("5 and 6", z6, z7)):
        off.append((np.linalg.norm(np.cross(a, b)), f"its revolute joints {pair} are not parallel"))
    # The shoulder is the point where the first three revolute axes (1, 3 and 4) meet. It is computed as the foot on axis 1 of a
    # point of axis 3, and axes 3 and 4 must pass through it.
    shoulder = c1 + z1 * (z1 @ (c3 - c1))
    for place, z, c in (("second", z3, c3), ("third", z4, c4)):
        missed = np.linalg.norm(across(z, c - shoulder)) / chain.reach
        off.append((missed, f"its {place} revolute axis misses the point where the first and second are nearest"))
    # the elbow: where axis 5 crosses the plane through the shoulder that is perpendicular to axis 4
    level5 = c5 + z4 * (z4 @ (shoulder - c5))
    missed = np.linalg.norm(across(z6, c6 - level5)) / chain.reach
    off.append((missed, "its fifth revolute axis does not cross the fourth level with the shoulder"))
    for value, words in off:
        if value > NEAR:
            return no_fit(words)
    level7 = c7 + z6 * (z6 @ (level5 - c7))
    upper, fore = level5 - shoulder, level7 - level5
    a4, a6 = float(np.linalg.norm(upper)), float(np.linalg.norm(fore))
    if min(a4, a6) <= NEAR * chain.reach:
        return no_fit("two of its parallel revolute axes coincide")
    # The offset of each angle is the angle between D-H x axes at q = 0; axes 5 and 7 are assumed to point along axes 4 and 6.
    s5, s7 = math.copysign(1.0, z4 @ z5), math.copysign(1.0, z6 @ z7)
    x1, x3, x4, x6 = np.cross(z1, z3), np.cross(z3, z4), upper / a4, fore / a6
    x5 = np.cross(z6, z4)
    signs = [1.0, 1.0, 1.0, s5, 1.0, s7]
    offsets = [
        0.0,
        angle_about(z3, x1, x3),
        angle_about(z4, x3, x4),
        angle_about(z4, x4, x5),
        angle_about(z6, x5, x6),
        0.0,
    ]
    R = np.vstack([x1, np.cross(z1, x1), z1])
    wrist = np.eye(4)
    wrist[:3, :3] = np.column_stack([x6, np.cross(z6, x6), z6])
    wrist[:3, 3] = level7
    E = np.linalg.inv(screws.T) @ wrist
    lift = [float(slides[0]), math.copysign(1.0, z1 @ screws.axis[slides[0]])] if len(slides) else [-1.0, 1.0]
    joints = np.column_stack([order, signs, offsets]).ravel()
    parameters = np.concatenate([R.ravel(), -R @ shoulder, E[:3, :3].ravel(), E[:3, 3], [a4, a6], joints, lift])
    return Fit(parameters, "", float(max(value for value, _ in off)))


@inner
def best_branch(p, P, box, near, allowed, scratch, best):
    """Find the best solution (branch) of a wrist pose P: inside the limits the nearest to the reference, else the least outside.

    The solution is written to best (n,). p: the arm's parameters; P (12,): see `wrist_pose`; box (4, n): limits, reference,
    weights; near (6,): values of angles that are free; allowed [m]: a wrist pose that is out of reach by less may be so by
    rounding. Returns the lift [m], by how much a limit is exceeded [rad or m], the distance of P from the reach [m], and the
    stroke [m] that the prismatic joint lacks to reach P.
    """
    spans, moved, sols, tries, row, limits = scratch
    q, trial = tries[0], tries[1]
    d, count = choose_lift(p, P, box, spans)
    gap, stroke = max(0.0, -inspection_margin(P, d, p[A4], p[A6])), 0.0
    broken = pick(p, P, d, box, near, moved, sols, q, best)[0]
    free = p[LIFT] >= 0.0 and p[LIFT + 2] != GIVEN
    if broken > 0.0:
        least = pick_level(p, P, d, free, box, near, row, q, trial)
        if least < broken or (least == 0.0 and gap > 0.0):
            broken = least
            copy(trial, best)
    if free and broken > 0.0 and count != 0:
        if count < 0:
            low, high = lift_limits(p, box)
            count = lift_intervals(P, p[A4], p[A6], low, high, spans)
        broken = scan_lifts(p, P, box, near, spans[:count], moved, sols, tries, best)
        if broken > 0.0:
            broken = narrow_windows(p, P, box, near, spans[:count], limits, row, q, best)
    # If the pose is out of reach by less than `allowed`, that may be rounding, and the prismatic joint lacks no stroke.
    elif free and gap >= allowed:
        d, gap, stroke = stopped_at(p, P, box, d, gap, spans)
        if stroke > 0.0:  # the answer for a target that the arm would reach if the prismatic joint had more stroke
            broken = max(pick(p, P, d, box, near, moved, sols, q, best)[0], SNAP)
    return d, broken, gap, stroke


@cached
def solve_inspection(rows, ends, seeds, feat, T, Q0, out, opt, hist):
    """Solve targets with the closed form: of the solutions (branches) inside the limits, the one nearest the start is the answer.

    If there is none, the row gets the configuration that comes nearest, and the status says why. The arguments are those of
    `protocol.ClosedForm.loop`.
    """
    n = seeds.shape[1]
    p = opt[SIZE.weights + n :]
    box, near, P, moved, sols = np.empty((4, n)), np.empty(6), np.empty(12), np.empty(12), np.empty((8, 6))
    best, branches = np.empty(n), np.empty((9, n))
    scratch = np.empty((2, 2)), moved, sols, np.empty((2, n)), np.empty(6), np.empty(WINDOWS)
    goal, joints, trig = np.empty(12), np.empty(room(n)[0]), np.zeros(room(n)[1])
    for t in range(T.shape[0]):
        if not rigid(T[t], RIGID.axes):
            out[t, 0] = CODE.bad_target
            continue
        q0 = Q0[t if Q0.shape[0] > 1 else 0]
        if not copy_limits(ends, opt, q0, box):
            out[t, 0] = CODE.bad_start
            continue
        near_angles(p, box, near)
        wrist_pose(p, T[t], P)
        d, broken, gap, stroke = best_branch(p, P, box, near, opt[ORDER.tol_p], scratch, best)
        lever = p[A4] + p[A6] + math.sqrt(p[21] * p[21] + p[22] * p[22] + p[23] * p[23])
        # how far [m] the wrist may move while the orientation stays within its tolerance
        slack = opt[ORDER.tol_r] * lever
        nearly, spent = p[NEARLY] > 0.0, 0.0
        i = int(p[LIFT])
        fixed = i if p[LIFT + 2] == GIVEN else -1
        able = fixed < 0 or box[0, fixed] <= best[fixed] <= box[1, fixed]
        if able and (nearly or (broken > 0.0 and stroke == 0.0 and gap < opt[ORDER.tol_p] + slack)):
            # If the arm fits only approximately, or limits or reach are only just exceeded, the best branch and all others at the
            # same lift are refined by Newton steps with the robot's own kinematics.
            at = p[LIFT + 1] * best[i] if i >= 0 else 0.0
            copy(P, moved)
            inspection_nearest(moved, at, p[A4], p[A6])
            found = inspection_branches(moved, at, p[A4], p[A6], near, sols)
            copy(best, branches[0])
            for k in range(found):
                joint_values(p, sols[k], at, box, branches[k + 1])
            choose(rows, ends, T[t], branches[: found + 1], STEPS, fixed, q0, opt, hist, out[t])
            if nearly or out[t, AT.status] == CODE.converged:
                continue
            spent = out[t, AT.evaluations] - 1.0
        if nearly:  # If the arm fits only approximately, the closed form cannot prove that a target is out of reach.
            broken, gap = 0.0, 0.0
        if broken > 0.0 and stroke == 0.0 and max(shoulder_on_axes(p, P, d, near)):
            broken = 0.0  # A free angle was tried at one value only, so it is not proven that limits block the target.
        measure_tip(rows, ends, opt, T[t], best, box, broken, gap, slack, goal, joints, trig, hist, out[t])
        out[t, AT.evaluations] += spent
        if out[t, AT.status] == CODE.limit_blocked:
            out[t, AT.excess] = stroke


@closed_form
class Inspection(NamedTuple):
    """All branches (8) of a spherical shoulder on a lift (prismatic joint), for poses; returns the one inside limits nearest q0.

    Source: Shanmugasundar and Sivaramakrishnan (2012), eqs. (7)-(13), completed by the other branches, the lift as the free
    parameter, a reach test and singular poses.

    Args:
        lift: Value of the prismatic joint. 'nearest' takes the feasible value nearest q0's, or another if no branch there is inside
            the limits; 'mid' takes the middle of the longest feasible interval, with the same exception; a number [m] takes only
            that.
    """

    lift: float | str = "nearest"

    recognise = staticmethod(recognise)
    every = staticmethod(listing)

    def pack(self, robot: Any, asked: Asked | None = None) -> np.ndarray:
        """Return the arm's parameters (49,), which include how the value of the prismatic joint is chosen; `lift_arm` names them.

        Raises UnknownSolver if the robot has another structure, InvalidOption if `lift` is none of its choices.
        """
        parameters, _, off = fitted(self, robot)
        choice = CHOICES.get(self.lift, GIVEN)
        value = 0.0
        if choice == GIVEN:
            try:
                value = float(self.lift)
            except ValueError:
                value = math.nan
            if not math.isfinite(value):
                raise InvalidOption(f"lift must be 'nearest', 'mid' or a number of metres, not {self.lift!r}")
        return np.concatenate([parameters, [choice, value, float(off > FIT)]])

    def held(self, robot: Any) -> dict[int, float]:
        """Return {index of the prismatic joint in q: its value [m]} if `lift` is a number, otherwise an empty dict."""
        place = np.flatnonzero(robot.slides)
        return {} if self.lift in CHOICES or not len(place) else {int(place[0]): float(self.lift)}

    def derive(self, robot: Any, p: np.ndarray, T: np.ndarray, box: np.ndarray) -> WorkedSolution:
        """Return the formulas and their numbers for the pose T (4, 4), to explain a solve.

        p: what `pack` returns; box (4, n): lower and upper limits, the answer to be explained, weights.
        """
        from .inspection_steps import derive

        return derive(robot, p, T, box)

    def loop(self, robot: Any) -> Callable:
        """Return the compiled function that solves targets with this closed form, called as `protocol.ClosedForm.loop` says."""
        return solve_inspection
