"""Six turning joints of a structure that the EAIK package knows: all its answers, through the call of every other solver."""

import functools
from typing import Any, NamedTuple

import numpy as np

from ...errors import MissingExtra, UnknownSolver
from ...kernel import slots
from ...kernel.chain import Chain
from ...kernel.checks import BAD_START, BAD_TARGET, rigid
from ...kernel.jit import cached, jit
from ...kernel.loop import ENTRIES
from .geometry import copy_limits, legal_start, legal_turn, measure_tip, read_screws

N = 6
H, P, R_TIP = slice(0, 18), slice(18, 39), slice(39, 48)  # axes, steps from one to the next, tip's orientation at q = 0


class EAIK(NamedTuple):
    """Analytic answers of the EAIK package for six turning joints, for poses; the legal one nearest q0 is returned.

    Needs the extra 'analytic'. The axes are read off the robot at q = 0; limits, turns and the choice are ours, and every
    answer is evaluated again. Source: Ostermeier, Kuelz, Althoff (2025), "Automatic geometric decomposition for analytical
    inverse kinematics".
    """

    def pack(self, robot: Any) -> np.ndarray:
        """Axes of the arm. Raises UnknownSolver when it is none that EAIK decomposes, MissingExtra without the package."""
        parameters, reason = recognise(robot.chain)
        if reason:
            raise UnknownSolver(f"solver 'eaik' does not fit robot '{robot.name}': {reason}")
        return parameters


def recognise(chain: Chain) -> tuple[np.ndarray, str]:
    """Axes of the arm at q = 0, and '' or why EAIK cannot take it."""
    none = np.zeros(0)
    if chain.n != N:
        return none, f"it has {chain.n} joints on the path, not 6"
    screws = read_screws(chain)
    if isinstance(screws, str):
        return none, screws
    if not screws.turns.all():
        return none, "not all of its joints turn"
    steps = np.diff(np.vstack([np.zeros(3), screws.point, screws.T[:3, 3]]), axis=0)
    parameters = np.concatenate([screws.axis.ravel(), steps.ravel(), screws.T[:3, :3].ravel()])
    if not _arm(parameters.tobytes()).hasKnownDecomposition():
        return none, "EAIK knows no decomposition of its axes"
    return parameters, ""


@functools.lru_cache(16)
def _arm(parameters: bytes) -> Any:
    """EAIK's robot of packed axes."""
    try:
        from eaik.IK_HP import HPRobot
    except ImportError:
        raise MissingExtra("EAIK", "analytic") from None
    p = np.frombuffer(parameters)
    return HPRobot(p[H].reshape(N, 3), p[P].reshape(N + 1, 3))


def branches(p: np.ndarray, T: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """EAIK's answers (K, 6) [rad] for T (4, 4), and which of them (K,) are only nearest, not exact."""
    nothing = np.empty((0, N)), np.empty(0, dtype=bool)
    if not np.isfinite(T).all():
        return nothing
    tool = np.eye(4)
    tool[:3, :3] = p[R_TIP].reshape(3, 3).T
    found = _arm(p.tobytes()).IK(T @ tool)
    Q = np.ascontiguousarray(found.Q, dtype=float).reshape(-1, N)
    good = np.isfinite(Q).all(axis=1)
    return Q[good], np.array(found.is_LS, dtype=bool)[good]


@jit
def joint_values(angles, box, q):
    """Fill q (6,) with the legal turns of angles nearest box[2]; return the worst limit broken and the distance."""
    worst, distance = 0.0, 0.0
    for i in range(N):
        q[i], broken = legal_turn(angles[i], box[0, i], box[1, i], box[2, i])
        worst = max(worst, broken)
        distance += box[3, i] * (q[i] - box[2, i]) ** 2
    return worst, distance


def _compile():
    @cached
    def choose(rows, ends, T, Q, nearest_only, q0, opt, hist, out):
        if not rigid(T):
            out[0] = BAD_TARGET
            return
        if opt[slots.O_GIVEN] > 0.0 and not legal_start(ends, opt, q0):
            out[0] = BAD_START
            return
        box = np.empty((4, N))
        copy_limits(ends, opt, q0, box)
        q, best = np.empty(N), box[2].copy()
        least, near, rough = np.inf, np.inf, True
        for k in range(Q.shape[0]):
            worst, distance = joint_values(Q[k], box, q)
            better = worst < least or (worst == least and distance < near)
            if (rough and not nearest_only[k]) or (rough == nearest_only[k] and better):
                rough, least, near = nearest_only[k], worst, distance
                best[:] = q
        goal, Z, trig = np.empty(12), np.empty((N, 6)), np.zeros((3, 8))
        measure_tip(rows, ends, opt, T, best, box, 0.0, 0.0, 0.0, goal, Z, trig, hist, out)

    @cached
    def every(Q, box, out, broken):
        """Fill out (K, 6) with the legal turns of Q nearest box[2], and broken (K,) with the limit each breaks."""
        for k in range(Q.shape[0]):
            broken[k] = joint_values(Q[k], box, out[k])[0]

    return choose, every


_choose, _every = _compile()


def every_branch(p: np.ndarray, T: np.ndarray, box: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Exact branches (K, 6) [rad] of T (4, 4) at the turns nearest box[2], and the limit (K,) each breaks."""
    Q, nearest_only = branches(p, T)
    Q = Q[~nearest_only]
    broken = np.empty(len(Q))
    out = np.empty_like(Q)
    _every(Q, box, out, broken)
    return out, broken


def _solve(rows, ends, seeds, feat, T, Q0, out, opt, hist) -> None:
    """Loop of the kernel's signature (see kernel.loop.entry), around a package that is called from Python."""
    p = opt[slots.OPT_HEAD + N :]
    for t in range(len(T)):
        q0 = Q0[t if len(Q0) > 1 else 0]
        _choose(rows, ends, T[t], *branches(p, T[t]), q0, opt, hist, out[t])


ENTRIES[EAIK] = _solve
