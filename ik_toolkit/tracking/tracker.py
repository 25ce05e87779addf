"""`Tracker`: follow targets that arrive one by one, for somebody's control loop."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..errors import InvalidConfiguration, InvalidOption, floats, near_match
from ..kernel import box, motion
from ..kernel.clock import QUICK
from ..kernel.constrain import DIRECT, LEAVE
from ..kernel.motion import CLIP
from ..kernel.task import POSITION
from ..robot.robot import Robot
from ..robot.tree import Tree
from ..solvers.avoid import collision_model
from .engine import bind
from .inputs import one_of, positive, switch
from .methods import Method
from .obstacles import ROWS, Guard
from .reconfigure import Reconfiguration
from .secondary import Secondary, read_secondary
from .step import Outcome, Step
from .stream import Stream

JUMP = 0.5  # joint move [rad, or reaches] in one step that is reported as a jump
RESYNC = 0.1  # [rad, or reaches] between joints measured and commanded beyond which a tracker starts anew
LATE = 5.0  # longest step, over the first one, after which limits are still kept; a longer one is taken in parts
MODES = {"direct": DIRECT, "leave": LEAVE, "clip": CLIP}
LAWS_KEPT = 64  # lengths of a step for which the numbers of a method are kept
LIMIT_NAMES = ("lower", "upper", "speed", "acceleration")


class Tracker:
    """Follow targets that arrive one by one.

    robot: a Robot, or a Tree (several tips). method: cv, av, ca, aa, aad with its options, see `Method`, or a solver that
    tracks. q0 (n,): start, default home. rate0 (n,): joint rate at the start, default the target's (at rest when acceleration
    limits are given). limits: keep joint positions and speeds of the robot, and accelerations [rad/s^2 or m/s^2] when
    acceleration_limits gives them (number or (n,)): at every sample and in between, for any dt up to dt_max [s] (default five
    times the first; a longer step is taken in parts). A joint outside its limits is brought back.

    on_limit: what gives way where limits bind. "direct": the tip falls behind, but towards its target (for an operator);
    "leave": the error is the least possible now; "clip": the published form, each joint clipped on its own.

    What counts: mask, slack, free_turn, frame, relative_to as in `ik.solve`. Beside the task, in its null space: avoid_limits
    (True, False or a rate [1/s]): lead joints away from near limits; posture (n,) [rad or m] to keep, or (posture, rate);
    elbow {joint: 1 or -1}: the side of its zero on which a joint stays; manipulability [1/s]: how strongly it is raised;
    cost: a function of q (n,) [rad or m] to lower, which returns a number or its slope (n,).

    avoid_collisions: True (the robot's own links) or a CollisionModel: the arm slows down before what is in its way and slides
    along it, and takes no step after which it could not stop without a contact (BLOCKED); for things that stand still.

    reconfigure: where the arm stands at limits short of a target that another posture reaches, move there through the joints
    (RECONFIGURING): at once while the target stands; while it moves, only when the error has cost as much as the way will. Inside
    all limits and elbow sides, with avoid_collisions free of contacts; not while a joint is locked (speed 0). Only with "direct".

    jump: joint move [rad, or reaches] in one step reported as JUMPED; resync [rad, or reaches]: see `update`. Raises
    InvalidOption, InvalidConfiguration.
    """

    def __init__(
        self,
        robot: Robot | Tree,
        method: str | Method = "cv",
        *,
        q0: Any = None,
        rate0: Any = None,
        limits: bool = True,
        acceleration_limits: Any = None,
        on_limit: str = "direct",
        dt_max: float | None = None,
        jump: float = JUMP,
        resync: float = RESYNC,
        avoid_limits: Any = True,
        posture: Any = None,
        elbow: Any = None,
        manipulability: float = 0.0,
        cost: Any = None,
        avoid_collisions: Any = False,
        reconfigure: bool = True,
        **options: Any,
    ) -> None:
        """Bind a robot and a method."""
        if not isinstance(robot, Robot | Tree):
            raise InvalidOption(f"tracking takes a Robot (see Robot.load) or a Tree, not {type(robot).__name__}")
        self.robot = robot
        self.engine = bind(robot, method, limits, options)
        self._mode = read_mode(on_limit, MODES)
        self.jump, self.resync = positive(jump, "jump"), positive(resync, "resync")
        self._limits = limit_rows(robot, limits, acceleration_limits)
        self._speed = np.where(np.isfinite(self._limits[2]), self._limits[2], 1.0) * robot.chain.unit
        self._longest = 0.0 if dt_max is None else positive(dt_max, "dt_max [s]")
        self._at_rest = acceleration_limits is not None
        self.secondary: Secondary = read_secondary(robot, avoid_limits, posture, elbow, manipulability, cost)
        self.secondary.confine(self._limits)
        n = robot.n
        self.stream = Stream(robot)
        self._guard: Guard | None = None
        if avoid_collisions is not False:
            model = collision_model(robot, avoid_collisions)
            self._guard = Guard(robot, model, self._limits * robot.chain.unit, self.engine.gamma)
        self._other: Reconfiguration | None = None
        if switch(reconfigure, "reconfigure") and limits and self._mode == DIRECT:
            self._other = Reconfiguration(robot, self.engine.options, self._guard and self._guard.model)
        m = 6 * self.stream.tips
        self._q, self._rate, self._away = np.zeros(n), np.zeros(n), np.zeros(n)
        self._state = np.zeros(len(motion.STATE))
        self._lines, self._level, self.rows = np.zeros((ROWS, n)), np.zeros(ROWS), 0
        self._active = np.zeros(n, np.int8)
        self._kept = np.zeros(1, np.int8)
        self._caps, self._unmeasured = np.ones((2, 2)), np.zeros(0)
        self._Q, self._R, self._E = np.zeros((2, n)), np.zeros((2, n)), np.zeros((2, m))
        self._C, self._S = np.zeros((1, n), np.uint8), np.zeros((2, 4))
        self._laws: dict[float, np.ndarray] = {}
        self._kinds: tuple | None = None
        self.reset(q0, rate0=rate0)

    def reset(
        self, q0: Any = None, target: Any = None, twist: Any = None, acceleration: Any = None, *, rate0: Any = None
    ) -> None:
        """Start again from q0 (default home), with the target's pose and motion at this moment if they are known."""
        q = self.robot.check_q(self.robot.home if q0 is None else q0, "q0")
        self._begin(q, None if rate0 is None else self.robot.check_q(rate0, "rate0"))
        if self._touching:
            raise InvalidConfiguration(
                f"at q0 '{self._touching[0]}' touches '{self._touching[1]}'; start where nothing touches"
            )
        self._late = self._longest
        self.stream.forget()
        if target is not None:
            self.stream.take(0, target, twist, acceleration)

    def _begin(self, q: np.ndarray, rate: np.ndarray | None) -> None:
        """Stand at q, and forget what was done before."""
        unit = self.robot.chain.unit
        self._q[:] = q / unit
        self._rate[:] = 0.0 if rate is None else rate / unit
        self.engine.memory[:] = 0.0
        self._state[:] = 0.0
        given = rate is not None or self._at_rest
        self._state[motion.STATE.start] = motion.GIVEN if given else motion.MOVING
        self._active[:], self._kept[:] = 0, 0
        self.secondary.side(self._away)
        if self._other:
            self._other.forget()
        self._between: tuple[str, str] | None = None  # what kept the last step from going on
        self._touching = self._guard.restart(q) if self._guard else None

    @property
    def q(self) -> np.ndarray:
        """Present joint values (n,), as commanded."""
        return self._q * self.robot.chain.unit

    def change_limits(
        self, *, lower: Any = None, upper: Any = None, speed: Any = None, acceleration: Any = None
    ) -> None:
        """Replace limits from now on: numbers, (n,), or a dict by joint name [rad or m, per s, per s^2].

        What is beyond a new limit is brought back, as fast as the others allow (RECOVERING): a joint of speed 0 brakes and
        stays. Raises InvalidOption.
        """
        for row, name, value in zip(self._limits, LIMIT_NAMES, (lower, upper, speed, acceleration), strict=True):
            if value is None:
                continue
            new = row * self.robot.chain.unit
            if isinstance(value, Mapping):
                for joint, one in value.items():
                    if joint not in self.robot.joint_names:
                        raise InvalidOption(f"{name}: no joint '{joint}'.{near_match(joint, self.robot.joint_names)}")
                    new[self.robot.joint_names.index(joint)] = floats(one, f"{name} of {joint}", InvalidOption)
            else:
                given = floats(value, f"{name} must be a number or {self.robot.n} numbers", InvalidOption)
                if given.shape not in ((), new.shape):
                    raise InvalidOption(f"{name} must be a number or {self.robot.n} numbers, not {value!r:.60}")
                new[:] = given
            least = -np.inf if name in ("lower", "upper") else 0.0
            if np.isnan(new).any() or (new < least).any():
                raise InvalidOption(f"{name} must be numbers of at least 0, not {value!r:.60}")
            row[:] = new / self.robot.chain.unit
        if (self._limits[0] > self._limits[1]).any():
            raise InvalidOption("lower limits must not be above the upper ones")
        if self._guard:
            self._guard.limits = self._limits * self.robot.chain.unit

    def update(self, target: Any, dt: float, twist: Any = None, acceleration: Any = None, *, q: Any = None) -> Step:
        """Step to where the tip should be dt [s] from now; returns a Step.

        target: T_base_tip (4, 4), pin.SE3, position (3,) or an AxisTarget, of several tips as `ik.Solver` takes them, the same
        kind every time. twist, acceleration (6,) or (3,), of several tips (F, 6) or a dict by tip: of the target at that moment,
        base axes; without twist the last two targets give it, without acceleration it is 0. q (n,): the joints as measured now;
        error and Jacobian are taken there, while limits and the next command go on from the last command. Beyond resync from it
        the tracker starts anew from q, at rest (JUMPED). A target that is not finite is held against (HELD), not raised. Raises
        InvalidTarget for a wrong shape, InvalidOption for a dt that is not positive, InvalidConfiguration for a wrong q.
        """
        dt = positive(dt, "dt [s]")
        robot, stream, unit = self.robot, self.stream, self.robot.chain.unit
        finite = stream.take(1, target, twist, acceleration, dt)
        measured, lag, resynced = self._unmeasured, 0.0, False
        before = self._q * unit
        if q is not None:
            found = robot.check_q(q, "q")
            measured = found / unit
            lag = float(np.abs(measured - self._q).max()) / self.resync
            resynced = lag > 1.0
            if resynced:
                self._begin(found, np.zeros(robot.n))
        self._late = self._late or LATE * dt
        parts = 1 if dt <= self._late else math.ceil(dt / self._late)
        self._step(dt, parts, not finite, measured)
        if finite:
            stream.step_on()
        out = Outcome(
            robot, self._C[0].copy(), before, self._E[1].copy(), self._posed, self._S[0, 3], finite, self.jump, self._speed,
            lag, resynced, self._between, self._other.joints if self._other and self._goes else None,
        )  # fmt: skip
        return Step(self._q * unit, self._rate * unit, out)

    def _step(self, dt: float, parts: int, brake: bool, measured: np.ndarray) -> None:
        """Take one step, in equal parts where it is too long."""
        stream = self.stream
        self.prepare(stream.kinds or (POSITION,) * stream.tips)
        T, V, A = stream.T, stream.V, stream.A
        if parts > 1:
            T, V, A = stream.divided(parts)
        h, other = dt / parts, self._other
        for k in range(parts):
            part = slice(k, k + 2)
            self._goes = other is not None and other.goal is not None and not brake
            (self._go if self._goes else self.take)(
                T[part], V[part], A[part], h, self._Q, self._R, self._E, self._C, self._S, brake=brake, measured=measured,
            )  # fmt: skip
        if other and not self._goes and not brake:

            def error_at(q: np.ndarray) -> np.ndarray:
                one = self._E[:1].copy()
                self.run(T[-1:], V[-1:], A[-1:], h, self._Q[1:], self._R[1:], one, self._C[:0], self._S[1:], measured=q)
                return one[0]

            other.watch(
                self._C[0].tolist(), self._S[0, 3] > 0.0, self._E[1], T[-1], dt, self._q, self._limits, error_at
            )

    def _go(self, T, V, A, h, Q, R, E, C, S, **how) -> None:
        """Take a step towards another posture, or as usual where something is in the way."""
        other, guard, unit = self._other, self._guard, self.robot.chain.unit
        assert other is not None
        before = [one.copy() for one in self.carried()]
        q, rate, late = self._q * unit, self._rate * unit, max(self._late, h)
        self._goes = other.go(self._q, self._rate, T[1], self.engine.gamma, h, late, self._limits)
        if guard and self._goes:
            guard.late = late
            guard.rows(q, rate, h)  # sees what has been added or moved since
            self._goes = guard.allows(q, rate, self._q * unit, self._rate * unit, h)
            if not self._goes:
                self.put_back(before)
                other.blocked()
        if not self._goes:
            self.take(T, V, A, h, Q, R, E, C, S, **how)
            return
        self.engine.memory[:] = 0.0
        self._active[:], self._kept[:] = 0, 0
        self._state[:] = 0.0
        self._state[motion.STATE.start] = motion.READY
        self.secondary.side(self._away)
        self.run(T[1:], V[1:], A[1:], h, Q[1:], R[1:], E[1:], C[:0], S[1:], **how)  # no step: what is left
        C[:], S[0], self._between = 0, 0.0, None

    def prepare(self, kinds: tuple) -> None:
        """Pack what depends on the kinds of target."""
        if self._kinds == kinds:
            return
        self._orders, self._counts = self.engine.orders(kinds)
        rows = ROWS + 2 * int((self._counts[1] > 0.0).sum())
        if self._mode == CLIP and rows > ROWS:
            raise InvalidOption("slack is kept by the constrained step, so on_limit cannot be 'clip'")
        self._kept = np.zeros(rows + 1, np.int8)
        if self._other:
            self._other.ready(kinds)
        self._posed = tuple(bool(self._counts[0, 6 * f + 3 : 6 * f + 6].any()) for f in range(len(kinds)))
        self._kinds = kinds

    def carried(self) -> tuple[np.ndarray, ...]:
        """What is carried from step to step."""
        return self._q, self._rate, self.engine.memory, self._away, self._active, self._kept, self._state

    def put_back(self, kept: Sequence[np.ndarray]) -> None:
        """Be as before: copies of `carried`."""
        for one, before in zip(self.carried(), kept, strict=True):
            one[:] = before

    def run(
        self, T, V, A, h, Q, R, E, C, S, *, brake=False, measured=None, runaway=np.inf, mode=None, clock=None, caps=None,
        limits=None,
    ) -> int:  # fmt: skip
        """Take len(E) - 1 steps from the present state (see kernel/servo.py); returns how many were taken.

        clock: tolerances (position [m], orientation [rad]) of a reference that has one; limits: others than the tracker's.
        """
        law = self._laws.get(h)
        if law is None:
            if len(self._laws) >= LAWS_KEPT:
                self._laws.clear()
            law = self._laws[h] = self.engine.law(h)
        at, state = motion.PLACE, self._state
        law[at.brake], law[at.runaway], law[at.late], law[at.rows] = brake, runaway, max(self._late, h), self.rows
        law[at.mode] = self._mode if mode is None else mode
        law[at.avoid] = self.secondary.avoid
        law[at.clocked] = clock is not None
        if clock is not None:
            law[at.tol_p], law[at.tol_r] = clock
        if self.secondary.each_step:
            self.secondary.look(self._q)
        chain = self.robot.chain
        return self.engine.loop(
            chain.rows, chain.ends, self._orders, T, V, A, h, law, self._counts, self._limits if limits is None else limits,
            self.secondary.wish, self._caps if caps is None else caps, self._q, self._rate, self.engine.memory, self._away,
            self._active, self._kept, state, self._unmeasured if measured is None else measured, self._lines, self._level, Q, R,
            E, C, S,
        )  # fmt: skip

    @property
    def one_by_one(self) -> bool:
        """Whether something has to be looked at before every step, so that the loop cannot take several."""
        return self.secondary.each_step or self._guard is not None

    def take(self, T, V, A, h, Q, R, E, C, S, *, brake=False, clock=None, **how) -> int:
        """Take a step as `run` does, or brake where it could end in a contact."""
        guard, unit = self._guard, self.robot.chain.unit
        if guard is None:
            return self.run(T, V, A, h, Q, R, E, C, S, brake=brake, clock=clock, **how)
        guard.late = max(self._late, h)
        q, rate = self._q * unit, self._rate * unit
        self.rows = guard.rows(q, rate, h)
        self._lines[: self.rows], self._level[: self.rows] = guard.A[: self.rows] * unit, guard.b[: self.rows]
        before = [one.copy() for one in self.carried()]
        done = self.run(T, V, A, h, Q, R, E, C, S, brake=brake, clock=clock, **how)
        held = np.flatnonzero(self._kept[: self.rows])
        self._between = guard.pairs[held[0]] if len(held) and C[0].any() else None
        if not done or guard.allows(q, R[0] * unit, self._q * unit, self._rate * unit, h):
            return done
        wanted = self._rate * unit
        for one, was in zip(self.carried(), before, strict=True):
            one[:] = was
        q, rate = guard.instead(q, rate, wanted, h)
        self._q[:], self._rate[:] = q / unit, rate / unit
        self.engine.memory[:] = 0.0
        self._state[motion.STATE.start] = motion.READY
        self._state[motion.STATE.sigma] = max(self._state[motion.STATE.sigma] - QUICK * h, 0.0)
        self._between = guard.blocked
        S[0, 1:3] = 0.0, -1.0  # the clock stood still
        there = slice(1 if clock is None else 0, None)
        self.run(
            T[there], V[there], A[there], h, Q[1:], R[1:], E[1:], C[:0], S[1:], clock=clock, **how
        )  # no step: what is left
        C[0] = np.where(self._rate == 0.0, box.ROW, box.ROW | box.ACCELERATION) | (box.HELD if brake else 0)
        return 1


def read_mode(on_limit: Any, modes: Mapping[str, int]) -> int:
    """Number of a way to treat limits. Raises InvalidOption."""
    return modes[one_of(on_limit, modes, "on_limit")]


def limit_rows(robot: Robot | Tree, limits: bool, acceleration_limits: Any) -> np.ndarray:
    """Rows lower, upper, speed, acceleration (4, n) in kernel units; infinite where there is none."""
    n, unit = robot.n, robot.chain.unit
    rows = np.full((4, n), np.inf)
    rows[0] = -np.inf
    if switch(limits, "limits"):
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
