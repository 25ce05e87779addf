"""Makes the EAIK package a solver of this toolkit: closed forms for many structures of six revolute joints."""

import functools
from typing import Any, NamedTuple

import numpy as np

from ...errors import MissingExtra
from ...kernel.chain import Chain
from ..protocol import closed_form
from .geometry import Branches, Fit, into_limits, no_fit, read_revolute

N = 6
# Largest number of Newton steps that correct a solution of EAIK, or of the elimination, with the robot's own kinematics. One is
# usually enough.
STEPS = 12
# Where the parts of the arm's parameters (48,) begin and end. They describe the arm at q = 0: joint axes (6, 3), vectors from one
# axis to the next (7, 3), rotation matrix of the tip.
H, P, R_TIP = slice(0, 18), slice(18, 39), slice(39, 48)


def recognise_six_axes(chain: Chain) -> Fit:
    """Return whether EAIK has a decomposition for the joint axes that a chain has at q = 0, and the parameters (48,) for it."""
    screws = read_revolute(chain, N)
    if isinstance(screws, str):
        return no_fit(screws)
    steps = np.diff(np.vstack([np.zeros(3), screws.point, screws.T[:3, 3]]), axis=0)
    parameters = np.concatenate([screws.axis.ravel(), steps.ravel(), screws.T[:3, :3].ravel()])
    if not _arm(parameters.tobytes()).hasKnownDecomposition():
        return no_fit("EAIK has no decomposition for its axes")
    return Fit(parameters, "", 0.0)


@functools.lru_cache(16)
def _arm(parameters: bytes) -> Any:
    """Return EAIK's robot object for the parameters that `recognise_six_axes` found, given as bytes."""
    try:
        from eaik.IK_HP import HPRobot
    except ImportError:
        raise MissingExtra("EAIK", "analytic") from None
    p = np.frombuffer(parameters)
    return HPRobot(p[H].reshape(N, 3), p[P].reshape(N + 1, 3))


def branches(p: np.ndarray, T: np.ndarray) -> np.ndarray:
    """Return all solutions (K, 6) [rad] that EAIK finds for the pose T (4, 4); p: the parameters from `recognise_six_axes`.

    Solutions that EAIK flags as inexact are kept, because the flag is set on exact ones, too.
    """
    if not np.isfinite(T).all():
        return np.empty((0, N))
    tool = np.eye(4)
    tool[:3, :3] = p[R_TIP].reshape(3, 3).T
    Q = np.ascontiguousarray(_arm(p.tobytes()).IK(T @ tool).Q, dtype=float).reshape(-1, N)
    return Q[np.isfinite(Q).all(axis=1)]


@closed_form
class EAIK(NamedTuple):
    """Analytic solutions by the package EAIK for six revolute joints, for poses; returns the one in limits nearest q0.

    Needs the extra 'analytic'. The axes are read off the robot at q = 0; this class adds joint limits, shifts by 2 pi and the
    choice of a solution, and computes the errors of every answer itself. Source: Ostermeier, Kuelz, Althoff (2025), "Automatic
    geometric decomposition for analytical inverse kinematics".
    """

    recognise = staticmethod(recognise_six_axes)

    def every(self, robot: Any, p: np.ndarray, T: np.ndarray, box: np.ndarray, count: int) -> Branches:
        """Return the solutions that EAIK finds for the pose T (4, 4), each angle shifted by 2 pi k to be nearest a reference.

        p: the parameters from `recognise_six_axes`; box (4, 6): lower and upper limits, reference [rad], weights. Near singular
        poses some solutions are missing.
        """
        Q = branches(p, T)
        out, excess = np.empty_like(Q), np.empty_like(Q)
        into_limits(Q, box, out, excess)
        return Branches(
            out, excess.max(axis=1), np.zeros((len(Q), 3), dtype=np.int8), False, " of EAIK", (), STEPS, -1, True
        )
