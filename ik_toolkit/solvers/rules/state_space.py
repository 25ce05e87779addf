"""The state-space solver: a static linear system maps the error to joint increments; no Jacobian is evaluated."""

from typing import Any, NamedTuple

import numpy as np

from ...errors import InvalidOption
from ...kernel.kinematics import angle_ratio
from ...kernel.loop import WAITING, rule

UNITS = {"si": (1.0, 1.0), "mm-deg": (1000.0, np.pi / 180.0)}  # per metre of error, rad per unit of increment


class StateSpace(NamedTuple):
    """Algorithm II: x(k+1) = A x(k) + B e(k), dq(k) = C x(k), x(0) = 0, with the literal delay (dq before x absorbs e).

    A (m, m), B (m, 3) for positions or (m, 6), C (n, m); e = target - actual in base axes [m, rad]. Joints saturate at
    their limits and the state is left alone. Without matrices: A = -0.5 I, C = -0.05 I and B = -6 pinv(J(home)), damped; the
    loop is stable where J B C has gains in (0, 1.5), and 0.3 is used. frame: rotation (3, 3) from base axes to the axes B
    is meant in. units: "si", or "mm-deg" (e in mm, increments in degrees). Source: Burrell et al. (2016), eqs. (14)-(15).
    """

    A: Any = None
    B: Any = None
    C: Any = None
    units: str = "si"
    frame: Any = None

    @classmethod
    def designed(cls, robot: Any, position_only: bool) -> "StateSpace":
        """Return matrices from the damped pseudo-inverse of the Jacobian at home (loop gain 0.3)."""
        J = robot.jacobian(robot.home)[: 3 if position_only else 6].copy()
        scale = robot.chain.scale
        J[:3] /= scale
        W = J * robot.chain.unit
        inverse = W.T @ np.linalg.inv(W @ W.T + 0.03**2 * np.eye(len(W)))
        inverse = inverse * robot.chain.unit[:, None]
        inverse[:, :3] /= scale
        n = robot.n
        return cls(A=-0.5 * np.eye(n), B=(0.3 / -0.05) * inverse, C=-0.05 * np.eye(n))

    def pack(self, robot: Any, position_only: bool = False) -> np.ndarray:
        """Pack [m, A, B (m, 6), C] in kernel units and axes. Raises InvalidOption on wrong shapes."""
        given = [part is not None for part in (self.A, self.B, self.C)]
        if not any(given):
            return self.designed(robot, position_only).pack(robot, position_only)
        if not all(given):
            raise InvalidOption("state-space needs all of A, B and C, or none of them")
        if self.units not in UNITS:
            raise InvalidOption(f"state-space: units must be one of {', '.join(UNITS)}, not '{self.units}'")
        A, B, C = (np.atleast_2d(np.asarray(part, dtype=float)) for part in (self.A, self.B, self.C))
        m, n = len(A), robot.n
        if A.shape != (m, m) or B.shape not in ((m, 3), (m, 6)) or C.shape != (n, m):
            raise InvalidOption(
                f"state-space: A (m, m), B (m, 3) or (m, 6), C ({n}, m) are needed; got {A.shape}, {B.shape}, {C.shape}"
            )
        if m > 2 * n:
            raise InvalidOption(f"state-space: at most {2 * n} states for {n} joints, got {m}")
        if not all(np.isfinite(part).all() for part in (A, B, C)):
            raise InvalidOption("state-space: A, B and C must be finite")
        if B.shape[1] == 3 and not position_only:
            raise InvalidOption("state-space: B has three columns, so it solves positions; a pose needs B (m, 6)")
        per_metre, increment = UNITS[self.units]
        axes = np.asarray(robot.chain.ends[:9]).reshape(3, 3)
        if self.frame is not None:
            axes = np.asarray(self.frame, dtype=float) @ axes
        full = np.zeros((m, 6))
        full[:, :3] = B[:, :3] @ axes * (per_metre * robot.chain.scale)
        if B.shape[1] == 6:
            full[:, 3:] = B[:, 3:] @ axes
        C = C * increment / robot.chain.unit[:, None]
        return np.concatenate([[m], A.ravel(), full.ravel(), C.ravel()])


@rule(StateSpace)
def _state_space(cls, p, s, e):
    m = int(p[0])
    n = s.dq.shape[0]
    a = 1
    b = a + m * m
    c = b + 6 * m
    for i in range(n):
        u = 0.0
        for j in range(m):
            u += p[c + i * m + j] * s.x[j]
        s.dq[i] = u if s.w[i] > 0.0 else 0.0
    ratio = angle_ratio(e.rr)
    changed = 0.0
    for i in range(m):
        k = b + 6 * i
        u = (
            p[k] * e.e0
            + p[k + 1] * e.e1
            + p[k + 2] * e.e2
            + ratio * (p[k + 3] * e.e3 + p[k + 4] * e.e4 + p[k + 5] * e.e5)
        )
        for j in range(m):
            u += p[a + i * m + j] * s.x[j]
        s.x[2 * n + i] = u
    for i in range(m):
        changed = max(changed, abs(s.x[2 * n + i] - s.x[i]))
        s.x[i] = s.x[2 * n + i]
    # Joints may rest on their limits while the state still builds up: that is no stall.
    return WAITING if changed > 1e-13 else 0
