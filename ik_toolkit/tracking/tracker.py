"""`Tracker`: follow targets that arrive one by one, for somebody's control loop."""

from enum import Enum
from typing import Any

import numpy as np

from ..errors import InvalidConfiguration, InvalidOption, InvalidTarget, floats
from ..kernel import motion
from ..robot.pose import AxisTarget, check_target
from ..robot.robot import Robot
from ..robot.tree import require_one_tip
from .engine import bind
from .inputs import positive
from .methods import Method
from .reference import log

JUMP = 0.5  # joint move [rad, or reaches] in one step that is reported as a jump


class StepStatus(Enum):
    """How one step went: OK; LIMITED (a limit held a joint back); JUMPED (a joint moved far); HELD (no usable command)."""

    OK = "ok"
    LIMITED = "limited"
    JUMPED = "jumped"
    HELD = "held"


class Step:
    """One step of a tracker.

    q (n,) [rad or m] and rate (n,) to command now; status; reason, a sentence ('' when OK); position_error [m] and
    orientation_error [rad] (None for positions) left to this step's target.
    """

    __slots__ = ("_info", "orientation_error", "position_error", "q", "rate", "status")

    def __init__(self, q, rate, status, position_error, orientation_error, info) -> None:
        """Keep what the sentence needs; it is made only when asked for."""
        self.q, self.rate, self.status = q, rate, status
        self.position_error, self.orientation_error = position_error, orientation_error
        self._info = info

    @property
    def reason(self) -> str:
        """Why the status is not OK."""
        robot, code, before, finite = self._info
        if self.status is StepStatus.OK:
            return ""
        if self.status is StepStatus.HELD:
            return ("the step is not finite" if finite else "the target is not finite") + ": braking and holding"
        parts = []
        move = np.abs(self.q - before) / robot.chain.unit
        if self.status is StepStatus.JUMPED:
            i = int(np.argmax(move))
            parts.append(f"joint {robot.joint_names[i]} moved {self.q[i] - before[i]:.3g} in one step")
        for bit, name in (
            (motion.POSITION, "position"),
            (motion.VELOCITY, "speed"),
            (motion.ACCELERATION, "acceleration"),
        ):
            held = [j for j, c in zip(robot.joint_names, code, strict=True) if c & bit]
            if held:
                parts.append(f"{name} limit held back {', '.join(held)}")
        return "; ".join(parts)

    def __repr__(self) -> str:
        """Status, error and reason."""
        return f"Step({self.status.name}, {self.position_error:.3g} m{', ' + self.reason if self.reason else ''})"


class Tracker:
    """Follow targets that arrive one by one.

    method: cv, av, ca, aa, aad with its options, see `Method`. q0 (n,): start, default home. rate0 (n,): joint rate at the
    start, default the target's (at rest when acceleration limits are given). limits: keep joint positions and speeds of
    the robot, and accelerations [rad/s^2 or m/s^2] when acceleration_limits gives them (number or (n,)); position, speed
    and acceleration hold at every sample. jump: joint move [rad, or reaches] in one step reported as JUMPED. Raises
    InvalidOption, InvalidConfiguration.
    """

    def __init__(
        self,
        robot: Robot,
        method: str | Method = "cv",
        *,
        q0: Any = None,
        rate0: Any = None,
        limits: bool = True,
        acceleration_limits: Any = None,
        jump: float = JUMP,
        **options: Any,
    ) -> None:
        """Bind a robot and a method."""
        require_one_tip(robot, "tracking")
        self.robot = robot
        self.engine = bind(robot, method, limits, options)
        self.jump = positive(jump, "jump")
        self._limits = limit_rows(robot, limits, acceleration_limits)
        self._at_rest = acceleration_limits is not None
        n = robot.n
        self._q, self._rate = np.zeros(n), np.zeros(n)
        self._state = np.zeros(len(motion.STATE))
        self._T, self._V, self._A = np.zeros((2, 4, 4)), np.zeros((2, 6)), np.zeros((2, 6))
        self._T[:] = np.eye(4)
        self._Q, self._R, self._E = np.zeros((2, n)), np.zeros((2, n)), np.zeros((2, 6))
        self._code, self._D = np.zeros((1, n), np.uint8), np.zeros(1)
        self.reset(q0, rate0=rate0)

    def reset(
        self, q0: Any = None, target: Any = None, twist: Any = None, acceleration: Any = None, *, rate0: Any = None
    ) -> None:
        """Start again from q0 (default home), with the target's pose and motion at this moment if they are known."""
        q = self.robot.check_q(self.robot.home if q0 is None else q0, "q0")
        if self._limits[0].max() > -np.inf or self._limits[1].min() < np.inf:
            outside = self.robot.outside(q)
            if outside:
                raise InvalidConfiguration(
                    f"q0 is outside the limits of {', '.join(outside)}; move it inside or use limits=False"
                )
        self._q[:] = q / self.robot.chain.unit
        self._rate[:] = 0.0
        self.engine.forget()
        self._state[:] = motion.MOVING, 0.0, 0.0
        if rate0 is not None:
            self._rate[:] = self.robot.check_q(rate0, "rate0") / self.robot.chain.unit
        if rate0 is not None or self._at_rest:
            self._state[motion.STATE.start] = motion.GIVEN
        self._m = 0
        if target is not None:
            self._take(0, target, twist, acceleration)

    @property
    def q(self) -> np.ndarray:
        """Present joint values (n,)."""
        return self._q * self.robot.chain.unit

    def update(self, target: Any, dt: float, twist: Any = None, acceleration: Any = None) -> Step:
        """Step to where the tip should be dt [s] from now; returns a Step.

        target: T_base_tip (4, 4), pin.SE3 or position (3,), the same kind every time. twist, acceleration (6,) or (3,): of
        the target at that moment, base axes; without twist the last two targets give it, without acceleration it is 0. A
        target that is not finite is held against (HELD), not raised. Raises InvalidTarget for a wrong shape, InvalidOption
        for a dt that is not positive.
        """
        dt = positive(dt, "dt [s]")
        finite = self._take(1, target, twist, acceleration, dt)
        before = self.q
        self._steps(self._T, self._V, self._A, dt, not finite, np.inf, self._Q, self._R, self._E, self._code, self._D)
        if finite:
            self._T[0], self._V[0], self._A[0] = self._T[1], self._V[1], self._A[1]
        code, e, unit = self._code[0], self._E[1], self.robot.chain.unit
        q = self._q * unit
        if code.any() and code[0] & motion.HELD:
            status = StepStatus.HELD
        elif (np.abs(q - before) > self.jump * unit).any():
            status = StepStatus.JUMPED
        else:
            status = StepStatus.LIMITED if code.any() else StepStatus.OK
        orientation = float(np.sqrt(e[3:] @ e[3:])) if self._m == 6 else None
        info = (self.robot, code.copy(), before, finite)
        return Step(q, self._rate * unit, status, float(np.sqrt(e[:3] @ e[:3])), orientation, info)

    def _steps(self, T, V, A, dt, brake, runaway, Q, R, E, C, D) -> int:
        """Take len(T) - 1 steps from the present state; return how many were taken."""
        fixed = (float(brake), runaway, self._limits, self._q, self._rate, self._state)
        return self.engine.run(T, V, A, dt, self._m, *fixed, Q, R, E, C, D)

    def _take(self, slot: int, target: Any, twist: Any, acceleration: Any, dt: float = 0.0) -> bool:
        """Write a target into slot 0 (now) or 1 (end of step); False when it is not finite (the last one stays)."""
        if isinstance(target, AxisTarget):
            raise InvalidTarget(
                "a tracker takes no axis target: give a pose (4, 4), or a position to leave every turn free"
            )
        raw = floats(getattr(target, "homogeneous", target), "a tracker takes a 4x4 pose or a position", InvalidTarget)
        m = {(3,): 3, (4, 4): 6}.get(raw.shape)
        if m is None or self._m not in (0, m):
            wanted = "a 4x4 pose or a position of 3 numbers" if m is None else "targets of one kind, poses or positions"
            raise InvalidTarget(f"a tracker takes {wanted}, not shape {raw.shape}")
        first = self._m == 0
        motion_given = [np.zeros(6), np.zeros(6)]
        for given, value, name in zip(motion_given, (twist, acceleration), ("twist", "acceleration"), strict=True):
            if value is not None:
                array = floats(value, f"{name} must have {m} values", InvalidTarget)
                if array.shape not in ((m,), (6,)):
                    raise InvalidTarget(f"{name} must have {m} values, not shape {array.shape}")
                given[: len(array)] = array
        if not (np.isfinite(raw).all() and np.isfinite(motion_given).all()):
            if first:
                self._m = m
                self._T[0] = self._T[1] = self._here(m)
                self._m = 0 if slot == 0 else m
            self._T[1], self._V[1], self._A[1] = self._T[0], 0.0, 0.0
            return False
        self._m = m
        if m == 3:
            self._T[slot, :3, 3] = raw
        else:
            self._T[slot] = raw if _rigid(raw) else check_target(raw)[0]
        if first and slot == 1:
            self._T[0] = self._T[1]
            self._V[0], self._A[0] = motion_given
        if slot == 1 and twist is None:
            motion_given[0][:3] = (self._T[1, :3, 3] - self._T[0, :3, 3]) / dt
            if m == 6:
                motion_given[0][3:] = log(self._T[1, :3, :3] @ self._T[0, :3, :3].T) / dt
        self._V[slot], self._A[slot] = motion_given
        return True

    def _here(self, m: int) -> np.ndarray:
        T = self.robot.chain.forward(self.q)[0][0]
        return T if m == 6 else np.vstack([np.hstack([np.eye(3), T[:3, 3:]]), T[3:]])


def _rigid(T: np.ndarray) -> bool:
    """Whether (4, 4) numbers are a pose: the long look of `check_target`, which mends or refuses, costs ten times as much."""
    (a, b, c, _), (d, e, f, _), (g, h, i, _), last = T.tolist()
    off = (
        a * a + b * b + c * c - 1.0, d * d + e * e + f * f - 1.0, a * d + b * e + c * f,
        b * f - c * e - g, c * d - a * f - h, a * e - b * d - i,
    )  # fmt: skip
    return last == [0.0, 0.0, 0.0, 1.0] and max(map(abs, off)) < 1e-9


def limit_rows(robot: Robot, limits: bool, acceleration_limits: Any) -> np.ndarray:
    """Rows lower, upper, speed, acceleration (4, n) in kernel units; infinite where there is none."""
    n, unit = robot.n, robot.chain.unit
    rows = np.full((4, n), np.inf)
    rows[0] = -np.inf
    if not isinstance(limits, bool | np.bool_):
        raise InvalidOption(f"limits is True or False, not {limits!r}")
    if limits:
        speed = np.asarray(robot.velocity_limits, dtype=float)
        rows[0], rows[1] = robot.lower / unit, robot.upper / unit
        rows[2] = np.where(speed > 0.0, speed, np.inf) / unit
    if acceleration_limits is not None:
        if not limits:
            raise InvalidOption("acceleration_limits need limits=True")
        what = f"acceleration_limits must be a number or {n} numbers"
        a = floats(acceleration_limits, what, InvalidOption)
        if a.shape not in ((), (n,)):
            raise InvalidOption(f"{what}, not {acceleration_limits!r:.60}")
        if not (a > 0.0).all():
            raise InvalidOption(f"acceleration_limits must be positive, not {acceleration_limits!r}")
        rows[3] = a / unit
    return rows
