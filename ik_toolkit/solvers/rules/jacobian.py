"""Rules that use the Jacobian: pseudo-inverse, transpose, damped least squares, Newton-Raphson, Levenberg-Marquardt.

Each class is a rule: its fields are its parameters. `pack(robot)` turns them into the numbers its compiled step reads.
"""

from typing import Any, NamedTuple

import numpy as np

from ...kernel.jit import inline
from ...kernel.kinematics import angle_ratio
from ...kernel.linalg import damped, lu_solve, pseudo_inverse_step
from ...kernel.loop import SINGULAR_STEP, rule


@inline
def rotation_vector(e, y):
    """Write the six errors to y (6,), the rotation part as a rotation vector."""
    ratio = angle_ratio(e.rr)
    y[0], y[1], y[2] = e.e0, e.e1, e.e2
    y[3], y[4], y[5] = ratio * e.e3, ratio * e.e4, ratio * e.e5


class LM(NamedTuple):
    """Levenberg-Marquardt: dq = J'(J J' + damping |e|^2 I)^-1 e; joints pushed past a limit are held and the step redone.

    damping: factor of the squared error (lengths over reach). Source: Sugihara, IEEE Trans. Robotics 27 (2011), eq. (11);
    held joints as an active set.
    """

    damping: float = 0.02
    hold = True
    wrap = True

    def pack(self, robot: Any) -> np.ndarray:
        """Parameters of the compiled step."""
        return np.array([self.damping])


@rule(LM)
def _lm(cls, p, s, e):
    damping = p[0]
    damped(s.J, s.w, s.dq, e, damping * e.ee + 1e-12)
    return 0


class DLS(NamedTuple):
    """Damped least squares: dq = J'(J J' + damping^2 I)^-1 e, constant damping; joints pushed past a limit are held.

    damping: lambda, in units where lengths are divided by the robot's reach (scale). hold: redo a step without the joints it
    would push past a limit; False cuts the step off there, as the published method does. Source: Wampler, IEEE Trans. SMC 16
    (1986); Buss (2004), eq. (11).
    """

    damping: float = 0.03
    hold: bool = True

    def pack(self, robot: Any) -> np.ndarray:
        """Parameters of the compiled step."""
        return np.array([self.damping])


@rule(DLS)
def _dls(cls, p, s, e):
    damping = p[0]
    damped(s.J, s.w, s.dq, e, damping * damping + 1e-12)
    return 0


class Pinv(NamedTuple):
    """Pseudo-inverse: dq = gain pinv(J) e by singular values; those below rcond times the largest count as zero.

    Limits only by clamping q. Source: Whitney, IEEE Trans. Man-Machine Systems 10 (1969); Burrell et al. (2016), eqs.
    (7)-(8).
    """

    gain: float = 1.0
    rcond: float = 1e-8

    def pack(self, robot: Any) -> np.ndarray:
        """Parameters of the compiled step."""
        return np.array([self.gain, self.rcond])


@rule(Pinv)
def _pinv(cls, p, s, e):
    gain, rcond = p[0], p[1]
    rotation_vector(e, s.y)
    for i in range(s.q.shape[0]):
        if not s.w[i] > 0.0:
            for k in range(6):
                s.J[i, k] = 0.0
    pseudo_inverse_step(s.J, s.y, rcond, s.V, s.dq)
    for i in range(s.dq.shape[0]):
        s.dq[i] *= gain
    return 0


class Transpose(NamedTuple):
    """Jacobian transpose: dq = gain alpha J'e with alpha = <e, JJ'e> / <JJ'e, JJ'e>, the exact step along J'e.

    Where J'e = 0 alpha is 0/0 and the arm stands still. Source: Buss (2004), eq. (8); Burrell et al. (2016), eqs. (11)-(12).
    """

    gain: float = 1.0

    def pack(self, robot: Any) -> np.ndarray:
        """Parameters of the compiled step."""
        return np.array([self.gain])


@rule(Transpose)
def _transpose(cls, p, s, e):
    gain = p[0]
    rotation_vector(e, s.y)
    n = s.dq.shape[0]
    top = 0.0
    for i in range(n):
        g = 0.0
        for k in range(6):
            g += s.J[i, k] * s.y[k]
        s.dq[i] = s.w[i] * g
        top += s.w[i] * g * g
    below = 0.0
    for k in range(6):
        g = 0.0
        for i in range(n):
            g += s.J[i, k] * s.dq[i]
        below += g * g
    alpha = gain * top / below if below > 0.0 else 0.0
    for i in range(n):
        s.dq[i] *= alpha
    return 0


class Newton(NamedTuple):
    """Newton-Raphson: dq = J^-1 e, for tasks with as many rows as joints; ends as SINGULAR where J has no inverse.

    Source: Chinyai, eqs. (6)-(9), planar 2R; the error there is f(q) - x with a minus sign, ours is target - actual.
    """

    @classmethod
    def check(cls, robot: Any, rows: int) -> str:
        """Sentence saying why the rule does not fit the robot and task, or ''."""
        if rows != robot.n:
            return (
                f"newton needs as many task rows as joints, and here the task has {rows} and the path {robot.n} joints; "
                "use lm, dls or pinv"
            )
        return ""

    def pack(self, robot: Any) -> np.ndarray:
        """No parameters."""
        return np.zeros(0)


@rule(Newton)
def _newton(cls, p, s, e):
    rotation_vector(e, s.y)
    n = s.dq.shape[0]
    m = 0
    for k in range(6):
        size = 0.0
        for i in range(n):
            size = max(size, abs(s.J[i, k]))
        if size > 1e-12:
            if m == n:
                return SINGULAR_STEP
            for i in range(n):
                s.V[m, i] = s.J[i, k]
            s.y[m] = s.y[k]
            m += 1
    if m < n or not lu_solve(s.V, s.y, n):
        return SINGULAR_STEP
    for i in range(n):
        s.dq[i] = s.y[i]
    return 0
