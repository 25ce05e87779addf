"""Every solution of six revolute joints, whatever their axes, with a certificate that there are no others.

The mathematics is in `kernel/elimination`. The orderings of the loop equation that suit a robot are found at the first target, in
0.01 to 0.1 s, and kept in memory for the process.
"""

import functools
import math
from typing import Any, NamedTuple

import numpy as np

from ...compile.jit import cached
from ...kernel.chain import Chain
from ...kernel.checks import RIGID, is_rigid, rigid
from ...kernel.elimination.binding import answers, make_arm, make_forms
from ...kernel.elimination.closure import joint_at
from ...kernel.elimination.decomposition import Split
from ...kernel.elimination.terms import SIZES, VERDICT
from ...kernel.kinematics import TAU
from ...kernel.records import SIZE, Orders, copy, read
from ...kernel.serial import make_serial
from ..protocol import closed_form
from .eaik import STEPS, N
from .geometry import Branches, Family, Fit, into_limits, no_fit, read_revolute
from .polish import list_with

# Smallest size, as a share of the reach, of an arm that the elimination accepts; size says how far the axes are from meeting in one
# point. In a smaller arm the rounding of a pose is magnified too much.
LEAST_SIZE = 1e-4


class Certificate(NamedTuple):
    """Evidence of how complete a list of solutions of a six-joint arm is: whether there may be others that are not in it.

    Every solution belongs to a root of one polynomial or, if the arm was decomposed into geometric subproblems, to one of their
    branches. The accuracy of the polynomial is measured, not bounded, and that of a decomposition estimated, so a certificate is
    numerical evidence and not a proof by interval arithmetic.
    """

    status: str  # 'CERTAIN', 'DOUBLE' (solutions merge at a singular pose), 'FAMILY' (there is a continuum) or 'UNSURE'
    solutions: int  # number of distinct solutions found, including those outside the limits
    roots: int  # number of roots of the polynomial, or of branches of the decomposition
    # Number of roots that are proven complex and so are no solutions; if the status is CERTAIN, each other root is one solution.
    # For a decomposition: number of branches that do not exist or have merged with others.
    complex: int
    # radius of the largest disc of uncertainty around a real root of the polynomial in exp(i q3); the unit circle has radius 1
    radius: float
    # measured relative error of the polynomial's coefficients, or estimated error of the numbers of a decomposition
    noise: float
    decomposed: bool = False  # whether the arm was decomposed into geometric subproblems; there are no error discs then

    def to_dict(self) -> dict[str, Any]:
        """Return numbers and strings, ready for JSON; a radius that is not finite is None."""
        return {
            **self._asdict(),
            "radius": self.radius if math.isfinite(self.radius) else None,
            "message": self.message,
        }

    @property
    def message(self) -> str:
        """One sentence on whether there may be other solutions, and why."""
        real = self.roots - self.complex
        if self.status == "CERTAIN" and self.decomposed:
            return f"{real} of {self.roots} branches of the arm's geometry are distinct and real: there is no other solution"
        if self.status == "CERTAIN":
            rest = f"; {self.complex} are complex" if self.complex else ""
            return f"{real} of {self.roots} roots are real, each with its solution{rest}: there is no other solution"
        if self.status == "DOUBLE":
            return "solutions merge where the arm is singular: there may be others beside them"
        if self.status == "FAMILY":
            return "the arm can move while the tip stays: there are infinitely many solutions"
        return f"not all of the {self.roots} roots could be told real or complex: there may be other solutions"


def recognise_six_revolute(chain: Chain) -> Fit:
    """Return a Fit: whether a chain is six revolute joints, each moved by its own coordinate, and the array (52,) of their axes."""
    screws = read_revolute(chain, N)
    if isinstance(screws, str):
        return no_fit(screws)
    arm = make_arm(screws.axis, screws.point, screws.T)
    if arm[-1] < LEAST_SIZE * chain.reach:
        return no_fit("its axes meet in one point")
    return Fit(arm, "", 0.0)


@functools.lru_cache(64)
def forms_of(arm: bytes) -> np.ndarray:
    """Return the ways in which the elimination can solve an arm, best first; the result is cached.

    Each is an ordering of the closed loop that the six joints and the target form (see `make_forms`). arm: its array (52,) from
    `make_arm`, as bytes.
    """
    return make_forms(np.frombuffer(arm).copy())  # a copy, because for a read-only array numba would compile again


def certificate_of(answer: list[float]) -> Certificate:
    """Return the Certificate of a list of solutions, given the first row of the answer for that pose (`terms.Notes`), as a list."""
    count, verdict, forms, roots, complex_roots, radius, noise = answer[:7]
    status = VERDICT._fields[int(verdict)].upper()
    return Certificate(status, int(count), int(roots), int(complex_roots), radius, noise, forms == 0.0)


class EliminationAnswer(NamedTuple):
    """All solutions of one pose by the elimination, without regard to limits, and how complete they are."""

    q: np.ndarray  # (K, 6) the solutions [rad], every angle in [-pi, pi)
    certificate: Certificate
    # (K, 2) for status FAMILY, the joint angle that is free at each solution: its position in the loop of joints, counted from 1
    # (0: no angle is free), and by how much it may turn either way [rad]
    free: np.ndarray


def solutions_of(p: np.ndarray, T: np.ndarray) -> EliminationAnswer:
    """Return all solutions of the pose T (4, 4) by elimination; p: the parameters (52,) from `recognise_six_revolute`."""
    p, T = np.array(p), np.array(T)  # writable copies, because for read-only arrays numba would compile again
    if not is_rigid(T):
        return EliminationAnswer(np.empty((0, N)), Certificate("UNSURE", 0, 0, 0, math.inf, 0.0), np.empty((0, 2)))
    found = answers(forms_of(p.tobytes()), p, T[None])[0]
    certificate = certificate_of(found[0].tolist())
    rows = found[1 : 1 + certificate.solutions]
    return EliminationAnswer(rows[:, :N].copy(), certificate, rows[:, N + 1 :])


@cached
def list_certain(rows, ends, opt, T, found, box, most, table, notes):
    """List the solutions within the limits, for those of N targets whose list is certified to be complete.

    Args:
        rows: (L, 10) geometry of the chain.
        ends: limits of the chain (`records.Ends`).
        opt: option array (`records.Orders`).
        T: (N, 4, 4) targets [m].
        found: (N, SIZES.rows, SIZES.columns) answers of `kernel.elimination.answer.solve_loops`.
        box: (at least 3, 6) lower limits, upper limits, reference [rad].
        most: largest number of rows of a target.
        table: (at least the sum of all solutions, 9) receives the rows of `polish.list_with`, one target after another.
        notes: (N, 2 + `terms.Notes`) receives for each target the index of its first row, the number of its rows, and the first row
            of its answer. The number is -1 if the list is not certified, a row misses the tolerances, or there are more than
            `most`.
    """
    at, n = 0, box.shape[1]
    p = make_serial(rows, ends, opt[SIZE.orders :], n, read(Orders, opt))
    # `list_with` also lists signs of shoulder, elbow and wrist, which the elimination does not have
    none = np.zeros((2, found.shape[1], 3), dtype=np.int8)
    work, broken = np.empty((2, n)), np.empty(found.shape[1])
    q, excess = np.empty((found.shape[1], n)), np.empty((found.shape[1], n))
    for t in range(T.shape[0]):
        notes[t, 0], notes[t, 1] = at, -1
        copy(found[t, 0], notes[t, 2:])
        if found[t, 0, 1] != VERDICT.certain or not rigid(T[t], RIGID.axes):
            continue
        Q = found[t, 1 : 1 + int(found[t, 0, 0]), :N]
        into_limits(Q, box, q, excess)
        for k in range(Q.shape[0]):
            broken[k] = excess[k].max()
        branches = (-1, STEPS, q[: Q.shape[0]], broken, none[0])
        kept, legal = list_with(p, work, opt, T[t], box[2], branches, table[at:], none[1])
        if kept == legal and kept <= most:
            notes[t, 1] = kept
            at += kept


# ------------------------------------------------------------------------------------- self-motions of a decomposed arm
def moving_places(split: Split, place: int) -> tuple[int, ...]:
    """Return which joints move in a self-motion of an arm that is solved by geometric subproblems, as positions in the joint loop.

    split: how the arm is decomposed; place: position in the closed loop of joints of the angle that is free, which comes first in
    the result.
    """
    if split.parallel:
        return {0: (0, 1, 2, 3, 4, 5), 1: (1, 3), 5: (5, 1, 2, 3)}[place]
    return (3, 5) if place == 3 else (place, 3, 4, 5)


def families_of(
    robot: Any, arm: np.ndarray, form: np.ndarray, q: np.ndarray, free: np.ndarray, box: np.ndarray
) -> list[tuple[Family, np.ndarray]]:
    """Return the self-motions of a six-joint arm through q (6,): for each its Family, and one configuration (6,) on it.

    The configuration is the one whose leading joint is nearest the reference. arm (52,), form: arrays of the arm and of its
    decomposition; free (2,): the position (from 1 on) in the loop of joints of the angle that is free, and by how much it may
    turn either way [rad]; box (at least 3, 6): lower limits, upper limits, reference [rad].
    """
    split = Split(*form[: len(Split._fields)])
    place, half = int(free[0]) - 1, float(free[1])
    joints = [joint_at(k, bool(split.backwards), int(split.shift)) for k in moving_places(split, place)]
    names = tuple(robot.joint_names[k] for k in joints)
    lead, last = joints[0], joints[-1]
    low, high = (box[0, lead], box[1, lead]) if np.isfinite(box[:2, lead]).all() else (-math.pi, math.pi)
    found = []
    if len(joints) == 2:  # The axes of two joints coincide, so one can turn while the other turns back.
        slope = -_alignment(arm, q, *sorted((lead, last)))
        for a, b in _ranges(float(q[lead]), slope, float(q[last]), (low, high), box[:2, last]):
            member, at = q.copy(), min(max(box[2, lead], a), b)
            member[lead], member[last] = at, q[last] + slope * (at - q[lead])
            text = f"{names[1]} turns as {names[0]} does, from {a:.4f} to {b:.4f} rad"
            found.append((Family(names, float(a), float(b), text), member))
    elif split.parallel and place == 0:
        found.append((Family(names, None, None, "all joints move, and the tip stays"), q))
    else:
        arcs = [(low, high)]
        if half < math.pi and not np.isfinite(box[:2, lead]).all():
            at = q[lead] + TAU * round((box[2, lead] - q[lead]) / TAU)
            arcs = [(max(at - half, box[0, lead]), min(at + half, box[1, lead]))]
        elif half < math.pi:
            least, most = math.ceil((low - half - q[lead]) / TAU), math.floor((high + half - q[lead]) / TAU)
            turned = [q[lead] + TAU * turn for turn in range(least, most + 1)]
            arcs = [(max(at - half, low), min(at + half, high)) for at in turned]
        for a, b in arcs:
            text = f"{names[0]} turns from {a:.4f} to {b:.4f} rad, and {', '.join(names[1:])} follow, limits of theirs not counted"
            found.append((Family(names, float(a), float(b), text), q))
    return found


def _alignment(arm: np.ndarray, q: np.ndarray, first: int, last: int) -> float:
    """Return 1.0 if the axes two joints apart have the same direction at q, -1.0 if they have opposite ones."""
    axis, along, middle = arm[:36].reshape(6, 6)[[first, last, first + 1], :3]
    c, s = math.cos(q[first + 1]), math.sin(q[first + 1])
    turned = along * c + np.cross(middle, along) * s + middle * (middle @ along) * (1.0 - c)
    return math.copysign(1.0, float(axis @ turned))


def _ranges(at: float, slope: float, other: float, own: tuple, others: np.ndarray) -> list[tuple[float, float]]:
    """Return the ranges of a joint x in `own` for which another joint, other + slope (x - at), is inside its limits `others` (2,).

    The other joint counts modulo 2 pi; slope is 1.0 or -1.0.
    """
    if not others[1] - others[0] < TAU:
        return [own]
    a, b = sorted(at + slope * (limit - other) for limit in others)
    turns = TAU * np.arange(math.ceil((own[0] - b) / TAU), math.floor((own[1] - a) / TAU) + 1)
    return [(max(a + turn, own[0]), min(b + turn, own[1])) for turn in turns]


@closed_form
class Elimination(NamedTuple):
    """Every solution of any six revolute joints by elimination, certified; returns the one within limits nearest q0.

    The loop closure is reduced to one polynomial, each root of which is proven real or complex, within measured noise. An arm with
    a wrist or three parallel axes is decomposed into geometric subproblems instead, if these are simple. Sources: Raghavan and Roth
    (1993), "Inverse kinematics of the general 6R manipulator and related linkages"; Manocha and Canny (1994), "Efficient inverse
    kinematics for general 6R manipulators"; Elias and Wen (2022), "IK-Geo: Unified robot inverse kinematics using subproblem
    decomposition".
    """

    recognise = staticmethod(recognise_six_revolute)

    def certain(
        self, chain: tuple, forms: np.ndarray, p: np.ndarray, opt: np.ndarray, T: np.ndarray, box: np.ndarray, most: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """List the solutions of N poses at once; return the arrays `table` and `notes` that `list_certain` fills.

        chain: rows, ends and further arrays of a plan; forms, p: what `forms_of` and `recognise_six_revolute` return; opt: option
        array; T (N, 4, 4); box (4, 6): limits, reference, weights; most: largest number of solutions of a pose.
        """
        found = answers(forms, p, T)
        table, notes = np.empty((len(T) * SIZES.rows, 3 + N)), np.empty((len(T), 2 + SIZES.columns))
        list_certain(*chain[:2], opt, T, found, box, most, table, notes)
        return table, notes

    def every(self, robot: Any, p: np.ndarray, T: np.ndarray, box: np.ndarray, count: int) -> Branches:
        """Return all solutions of the pose T (4, 4), each angle shifted by 2 pi k to be nearest the reference box[2].

        p: the parameters from `recognise_six_revolute`; box (4, 6): lower and upper limits, reference [rad], weights. A list that
        is not certified to be complete is marked, so that a search adds what it finds.
        """
        Q, certificate, free = solutions_of(p, T)
        families = []
        if certificate.status == "FAMILY":
            form, single = forms_of(p.tobytes())[0], free[:, 0] == 0.0
            families = [one for k in np.flatnonzero(~single) for one in families_of(robot, p, form, Q[k], free[k], box)]
            Q = np.vstack([Q[single], *(member for _, member in families)])
        q, excess, sure = np.empty_like(Q), np.empty_like(Q), certificate.status == "CERTAIN"
        into_limits(Q, box, q, excess)
        broken = excess.max(axis=1)
        partial = not sure and not (families and (broken == 0.0).any())
        signs = np.zeros((len(Q), 3), dtype=np.int8)
        named = tuple(family for family, _ in families)
        return Branches(q, broken, signs, sure, "", named, STEPS, -1, partial, certificate)
