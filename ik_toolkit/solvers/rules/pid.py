"""IK-PID: a proportional-integral-derivative law sizes the step of each joint, trial and error gives its sign."""

import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...errors import InvalidOption
from ...kernel.kinematics import angle_ratio
from ...kernel.loop import measure, rule
from ...kernel.slots import E_VECTORS, O_KIND, O_LIMITS, O_TOL_P, O_TOL_R
from ..presets import check_starts, load_preset

UNITS = {"si": 1.0, "mm-deg": 1000.0 * math.pi / 180.0}  # rad/m per unit of gain


ROUNDING = 1e-14  # of the length scale: what a trial gains beyond that is no noise of the arithmetic


class PID(NamedTuple):
    """IK-PID, Algorithm I: for each joint, tip first, try q + d and q - d with d = kp |e| + ki sum|e| + kd (change of |e|).

    Trials are clamped to the limits; the lowest error wins, not moving wins ties; a sweep with no movement ends the descent.
    kp, ki, kd: gains K_p, K_i, K_d in rad per m of error (a sliding joint moves gain times the chain's length scale).
    Without kp: kp = 0.25 over the length scale, times the median joint range where that is under 1 rad (or scale), and kd = 3 kp
    unless given: a joint whose lever is no longer than the scale then changes the error by a quarter of it at most, far from
    the 2 |e| beyond which no trial helps. orientation_scale: metres per radian by which the orientation error is scaled before
    it joins the norm (default a fifth of the length scale). starts (M, n) [rad, m]: without q0 the one whose tip is nearest the
    target is taken. units: "si", or "mm-deg" for the paper's gains (error in mm, increments in degrees). tuned: options a
    preset brings along. Source: Burrell et al. (2016), section 4, eq. (13), Algorithm I; defaults are ours.
    """

    kp: float | None = None
    ki: float = 0.0
    kd: float | None = None
    orientation_scale: float | None = None
    starts: Any = None
    units: str = "si"
    tuned: Any = None

    @classmethod
    def preset(cls, name: str | Path) -> "PID":
        """Published or tuned gains, by name or path of a file. Raises InvalidOption listing the presets."""
        values, options = load_preset("pid", name, cls._fields)
        return cls(**values)._replace(tuned=options)

    def options(self) -> dict[str, Any]:
        """Tolerance and iteration limit of the preset."""
        return dict(self.tuned or {})

    def start_table(self, robot: Any, position_only: bool) -> np.ndarray | None:
        """Starts (M, n) [rad, m] to choose from without q0, or None for home. Raises InvalidOption on a wrong shape."""
        return None if self.starts is None else check_starts("pid", self.starts, robot)

    def pack(self, robot: Any) -> np.ndarray:
        """Gains in kernel units and the orientation scale."""
        if self.units not in UNITS:
            raise InvalidOption(f"pid: units must be one of {', '.join(UNITS)}, not '{self.units}'")
        n, scale = robot.n, robot.chain.scale
        to_kernel = UNITS[self.units] * scale
        if self.kp is None:
            ranges = robot.chain.ends[E_VECTORS + 5 * n : E_VECTORS + 6 * n]
            kp = 0.25 * min(1.0, float(np.median(ranges)))
            kd = 3.0 * kp if self.kd is None else self.kd * to_kernel
        else:
            kp, kd = self.kp * to_kernel, (self.kd or 0.0) * to_kernel
        orientation = 0.2 if self.orientation_scale is None else self.orientation_scale / scale
        return np.array([kp, self.ki * to_kernel, kd, orientation])


@rule(PID, sweep=True)
def _pid(cls, p, s, e):
    n = s.q.shape[0]
    kind = int(s.opt[O_KIND])
    tol_p = s.opt[O_TOL_P] / s.ends[E_VECTORS + 7 * n]
    tp, tr = tol_p * tol_p, s.opt[O_TOL_R] * s.opt[O_TOL_R]
    kp, ki, kd, orientation_scale = p[0], p[1], p[2], p[3]
    weight = orientation_scale * orientation_scale
    count = 0
    for i in range(n):
        s.x[8 + i] = s.q[i]
    ratio = angle_ratio(e.rr)
    now = math.sqrt(e.pp + weight * ratio * ratio * e.rr)
    done = False
    for k in range(n):
        i = n - 1 - k
        if done:
            break
        if not s.w[i] > 0.0:
            continue
        change = now - s.x[1] if s.x[2] > 0.0 else 0.0
        s.x[0] += now
        s.x[1] = now
        s.x[2] = 1.0
        step = kp * now + ki * s.x[0] + kd * change
        old = s.q[i]
        kept = old
        least = now
        for sign in range(2):
            trial = old + step if sign == 0 else old - step
            if s.opt[O_LIMITS] > 0.0:
                trial = min(max(trial, s.lower[i]), s.upper[i])
            s.q[i] = trial
            px, py, pz, f = measure(s.rows, s.ends, s.tip, s.goal, s.mask, kind, s.q, s.Z, s.ang, s.sn, s.cs, s.V, s.y)
            count += 1
            ratio = angle_ratio(f.rr)
            value = math.sqrt(f.pp + weight * ratio * ratio * f.rr)
            if value < least - ROUNDING:  # not moving wins ties, as of a roll about the tip when only positions count
                least = value
                kept = trial
                done = f.pp < tp and f.rr < tr
        s.q[i] = kept
        now = least
    for i in range(n):
        s.dq[i] = s.q[i] - s.x[8 + i]
        s.q[i] = s.x[8 + i]
    return count
