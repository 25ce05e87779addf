"""Every solution of six revolute joints, whatever their axes, with a certificate that there are no others.

The mathematics is in `kernel/elimination`. What a robot needs (how to read its loop) is found at the first target, in 0.01 to
0.1 s, and kept in memory for the process.
"""

import functools
import math
from typing import Any, NamedTuple

import numpy as np

from ...compile.jit import cached
from ...kernel.chain import Chain
from ...kernel.checks import is_rigid
from ...kernel.elimination.binding import answers, make_arm, make_forms
from ...kernel.elimination.terms import Notes
from ..protocol import closed_form
from .eaik import STEPS, N, eaik_branches
from .families import families_of
from .geometry import Branches, Fit, legal_turn, no_fit, read_revolute

# Least distance of the axes from one point, as a share of the reach; rounding of a pose (1e-16) is 1e-12 of that.
LEAST_SIZE = 1e-4


class Certificate(NamedTuple):
    """What a list of solutions is known to be, from the roots of one polynomial that holds all of them, or from a decomposition.

    The accuracy of the polynomial is measured, not bounded, so a certificate is numerical evidence and no interval arithmetic. So
    is that of a decomposition, whose errors are estimated.
    """

    status: str  # 'CERTAIN', 'DOUBLE' (solutions merge in a singular one), 'FAMILY' (there is a continuum) or 'UNSURE'
    solutions: int  # distinct solutions found, limits or not
    roots: int  # roots of the polynomial, or branches of the decomposition
    # Roots proven complex, which are no solutions; of a certain answer each of the others is one solution. Of a decomposition, the
    # branches that do not exist or have merged with others.
    complex: int
    radius: float  # radius of the largest disc that holds a real root; a full turn is 2 pi long
    noise: (
        float  # measured error of the polynomial's coefficients beside the largest; error of a decomposition's numbers
    )
    decomposed: bool = (
        False  # whether the arm has been decomposed into geometric subproblems, so that there are no discs
    )

    def to_dict(self) -> dict[str, Any]:
        """Return numbers and strings, ready for JSON; a radius that is not finite is None."""
        return {
            **self._asdict(),
            "radius": self.radius if math.isfinite(self.radius) else None,
            "message": self.message,
        }

    @property
    def message(self) -> str:
        """One sentence."""
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
    """Return whether a chain has six revolute joints, each moved by one coordinate, with the numbers (52,) of their axes."""
    screws = read_revolute(chain, N)
    if isinstance(screws, str):
        return no_fit(screws)
    arm = make_arm(screws.axis, screws.point, screws.T)
    if arm[-1] < LEAST_SIZE * chain.reach:
        return no_fit("its axes meet in one point")
    return Fit(arm, "", 0.0)


@functools.lru_cache(64)
def forms_of(arm: bytes) -> np.ndarray:
    """Return the ways to read the loop of an arm (its 52 numbers as bytes), best first."""
    return make_forms(np.frombuffer(arm).copy())  # numba takes an array that is read-only for another type


class Said(NamedTuple):
    """What the elimination says of one pose, limits or not."""

    q: np.ndarray  # (K, 6) the solutions in [-pi, pi) [rad]
    # (K,) 1 / |J^-1|, lengths over the arm's size: an error e is no nearer a solution than e over this
    gain: np.ndarray
    certificate: Certificate
    near: np.ndarray | None  # (M, 6) where else a pose may be within a tolerance; None if that is not known
    # (K, 2) of a FAMILY: 0 or the number of the place whose angle is free, from 1 on, and by how much it may turn either way [rad]
    free: np.ndarray


def solutions_of(p: np.ndarray, T: np.ndarray, within: float = 0.0) -> Said:
    """Return what the elimination says of the pose T (4, 4); p: the numbers that `recognise_six_revolute` found.

    within: how far a root may be complex for its configuration to be listed in `near`.
    """
    p, T = np.array(p), np.array(T)  # writable: numba takes an array that is read-only for another type
    if not is_rigid(T):
        empty = np.empty((0, N))
        return Said(empty, np.empty(0), Certificate("UNSURE", 0, 0, 0, math.inf, 0.0), None, np.empty((0, 2)))
    found = answers(forms_of(p.tobytes()), p, T[None], within)[0]
    notes = Notes(*found[0, : len(Notes._fields)].tolist())
    count = int(notes.count)
    status = ("CERTAIN", "DOUBLE", "UNSURE", "FAMILY")[int(notes.status)]  # the numbers of `terms`
    certificate = Certificate(
        status, count, int(notes.roots), int(notes.complex), notes.radius, notes.noise, notes.forms == 0.0,
    )  # fmt: skip
    rest = None if notes.near < 0.0 else found[1 + count : 1 + count + int(notes.near), :N].copy()
    rows = found[1 : 1 + count]
    return Said(rows[:, :N].copy(), rows[:, N], certificate, rest, rows[:, N + 1 :])


@cached
def into_limits(Q, box, out, excess):
    """Fill out (K, n) with solutions Q (K, n) on the full turns inside the limits that are nearest a reference.

    The rows of box (at least 3, n) are lower limits, upper limits and reference [rad]. excess (K, n) [rad] is by how much each
    joint breaks its limits.
    """
    for k in range(Q.shape[0]):
        for i in range(Q.shape[1]):
            out[k, i], excess[k, i] = legal_turn(Q[k, i], box[0, i], box[1, i], box[2, i])


@closed_form
class Elimination(NamedTuple):
    """Every solution of any six revolute joints by elimination, certified; returns the one within limits nearest q0.

    The loop closure is reduced to one polynomial, whose roots are all accounted for, within measured noise. An arm with a wrist or
    three parallel axes is decomposed into geometric subproblems instead, if these are simple. Sources: Raghavan and Roth (1993),
    "Inverse kinematics of the general 6R manipulator and related linkages"; Manocha and Canny (1994), "Efficient inverse kinematics
    for general 6R manipulators"; Elias and Wen (2022), "IK-Geo: Unified robot inverse kinematics using subproblem decomposition".
    """

    recognise = staticmethod(recognise_six_revolute)

    def every(self, robot: Any, p: np.ndarray, T: np.ndarray, box: np.ndarray, count: int) -> Branches:
        """Return all solutions of the pose T (4, 4), each on the full turns nearest the reference box[2].

        If they are not certified to be all, a search adds what it finds.
        """
        Q, _, certificate, _, free = solutions_of(p, T)
        families = []
        if certificate.status == "FAMILY":
            form, single = forms_of(p.tobytes())[0], free[:, 0] == 0.0
            families = [one for k in np.flatnonzero(~single) for one in families_of(robot, p, form, Q[k], free[k], box)]
            Q = np.vstack([Q[single], *(member for _, member in families)])
        q, broken, sure = np.empty_like(Q), np.empty(len(Q)), certificate.status == "CERTAIN"
        eaik_branches(Q, box, q, broken)
        partial = not sure and not (families and (broken == 0.0).any())
        signs = np.zeros((len(Q), 3), dtype=np.int8)
        named = tuple(family for family, _ in families)
        return Branches(q, broken, signs, sure, "", named, STEPS, -1, partial, certificate)
