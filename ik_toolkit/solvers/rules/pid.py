"""IK-PID: a proportional-integral-derivative law sizes the step of each joint, trial and error gives its sign."""

import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...compile.jit import compiled
from ...errors import InvalidOption
from ...kernel.records import POINTS
from ...kernel.search import WAITING
from ..presets import check_starts, load_preset
from ..protocol import Asked, rule
from ..tuning_space import Parameter, Space, start_parameter

# For each system of units in which a preset may give its gains: the factor that converts a gain to rad per metre of error.
UNITS = {"si": 1.0, "mm-deg": 1000.0 * math.pi / 180.0}


# A trial step of a joint counts as an improvement only if the error falls by more than 1e-14 of the length scale, which is above
# rounding.
ROUNDING = 1e-14


@compiled
class Gains(NamedTuple):
    """The compiled step of IK-PID, one sweep over all joints; its gains are for lengths divided by the robot's length scale.

    Between sweeps, the array p.desk.x keeps the sum of the error norms so far, the last error norm, and whether there is a last
    one.
    """

    kp: float
    ki: float
    kd: float
    orientation: float

    JACOBIAN = False

    def step(self, p, e):
        s = p.desk
        n = s.q.shape[0]
        for i in range(n):
            s.x[8 + i] = s.q[i]
        now = p.norm(e, self.orientation)
        done, cut = False, False
        for k in range(n):
            i = n - 1 - k
            if done:
                break
            if not s.w[i] > 0.0:
                continue
            if not s.affords(2):
                cut = True
                break
            change = now - s.x[1] if s.x[2] > 0.0 else 0.0
            s.x[0] += now
            s.x[1] = now
            s.x[2] = 1.0
            size = self.kp * now + self.ki * s.x[0] + self.kd * change
            old = s.q[i]
            kept = old
            least = now
            for sign in range(2):
                s.q[i] = p.inside(i, old + size if sign == 0 else old - size)
                f = p.try_out(s.q)
                value = p.norm(f, self.orientation)
                # If neither trial lowers the error, the joint stays. A roll joint at the tip, for example, cannot change a
                # position.
                if value < least - ROUNDING:
                    least = value
                    kept = s.q[i]
                    done = f.good
            s.q[i] = kept
            now = least
        for i in range(n):
            s.dq[i] = s.q[i] - s.x[8 + i]
            s.q[i] = s.x[8 + i]
        return WAITING if cut else 0


@rule(step=Gains)
class PID(NamedTuple):
    """IK-PID, Algorithm I: for each joint, tip first, try q + d and q - d with d = kp |e| + ki sum|e| + kd (change of |e|).

    Trials are clamped to the limits; the lowest error wins, and not moving wins ties. A sweep with no movement ends the
    attempt. If kp is not given, it is 0.25 over the length scale, times the median joint range if that is under 1 rad
    (or 1 length scale), and kd is 3 kp unless given. A joint whose lever arm is no longer than the scale then changes the
    error by at most a quarter of |e|; a change above 2 |e| could not reduce it. Source: Burrell et al. (2016), section
    4, eq. (13), Algorithm I; defaults are ours.

    Args:
        kp, ki, kd: Gains K_p, K_i, K_d in rad per m of error; for a prismatic joint they are multiplied by the chain's
            length scale.
        orientation_scale: Factor [m/rad] by which the orientation error is multiplied before it enters the norm
            (default: a fifth of the length scale).
        starts: Configurations (M, n) [rad, m]. Without q0 the one whose tip is nearest the target is used.
        units: "si", or "mm-deg" for the paper's gains (error in mm, increments in degrees).
        tuned: Options of the search that come with a preset.
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
        """Make the rule with published or tuned gains, given by the name of a preset or the path of a preset file.

        Raises InvalidOption listing the presets.
        """
        values, options = load_preset("pid", name, cls._fields)
        return cls(**values)._replace(tuned=options)

    @classmethod
    def space(cls, robot: Any, position_only: bool, initial: "PID | None" = None) -> Space:
        """Return what `ik tune` searches: the gains on log scales, one start and, for poses, the orientation scale.

        initial: the rule from which the search starts, by default one with default gains.
        """
        initial = initial or cls()
        packed = np.array(initial.pack(robot)) / robot.chain.scale
        kp, ki, kd = (float(x) for x in packed[:3])
        start = (
            robot.home[None] if initial.starts is None else np.atleast_2d(np.asarray(initial.starts, dtype=float))[:1]
        )
        parameters = [
            Parameter("kp", kp / 8, kp * 8, kp, "rad/m", True),
            Parameter("ki", 1e-7 * kp, 1e-1 * kp, min(max(ki, 1e-7 * kp), 1e-1 * kp), "rad/m", True),
            Parameter("kd", 1e-2 * kp, 100 * kp, min(max(kd, 1e-2 * kp), 100 * kp), "rad/m", True),
            start_parameter(robot, start),
        ]
        if not position_only:
            scale = float(initial.pack(robot).orientation * robot.chain.scale)
            parameters.append(Parameter("orientation_scale", scale / 10, scale * 10, scale, "m/rad", True))
        return Space(tuple(parameters), initial, lambda values: cls(**values))

    def start_table(self, robot: Any, position_only: bool) -> np.ndarray | None:
        """Return start configurations (M, n) [rad or m] to choose from if no q0 is given; None: start at home.

        Raises InvalidOption on a wrong shape.
        """
        return None if self.starts is None else check_starts("pid", self.starts, robot)

    def pack(self, robot: Any, asked: Asked | None = None) -> Gains:
        """Return the compiled step, with the gains and the orientation scale for lengths divided by the scale of the robot."""
        if self.units not in UNITS:
            raise InvalidOption(f"pid: units must be one of {', '.join(UNITS)}, not '{self.units}'")
        n, scale = robot.n, robot.chain.scale
        to_kernel = UNITS[self.units] * scale
        if self.kp is None:
            ranges = np.atleast_2d(robot.chain.ends)[0, POINTS + 5 * n : POINTS + 6 * n]
            kp = 0.25 * min(1.0, float(np.median(ranges)))
            kd = 3.0 * kp if self.kd is None else self.kd * to_kernel
        else:
            kp, kd = self.kp * to_kernel, (self.kd or 0.0) * to_kernel
        orientation = 0.2 if self.orientation_scale is None else self.orientation_scale / scale
        return Gains(kp, self.ki * to_kernel, kd, orientation)
