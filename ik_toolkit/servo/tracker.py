"""`Tracker`: follow targets that arrive one by one, in the caller's control loop."""

import math
from typing import Any

import numpy as np

from ..compile.array_view import LINE
from ..copying import CopiesViews, ReadOnly
from ..errors import InvalidConfiguration, InvalidOption
from ..kernel.counted_error import KIND
from ..robot.narrow import with_limits
from ..robot.robot import Robot
from ..robot.tree import Tree
from ..solvers.collision_free import collision_model
from ..solvers.task import group_levels
from ..validate import LATE, one_of, parts_of_step, positive, rates
from .adapters import bind
from .collision_guard import ROWS, Guard
from .constrained_step import MODE
from .joint_observer import FILTER, JointObserver, read_measured
from .laws import PLACE
from .methods import Method
from .motion_limits import INSTEAD, LIMIT_NAMES, changed_limits, limit_rows, speeds
from .null_space_motion import Secondary, read_secondary
from .reconfigure import REACHED, Postures, Reconfiguration, Taken
from .step import StatusContext, Step, make_outcome
from .target_jump import STRAIGHT, Leap, ways
from .target_stream import STAND, Stream
from .viability import BIT, CALMING, watch
from .workspace import START, STATE, Record, Samples, carried_of, new_carried, new_record, new_settings

JUMP = 0.5  # [rad or arm reaches] joint move in one step that is reported as a jump
RESYNC = 0.1  # [rad or arm reaches] difference of measured and commanded joints above which a measurement is doubted


class Tracker(CopiesViews, ReadOnly):
    """Makes a robot's tips follow targets that arrive one by one, in the caller's control loop.

    Args:
        robot: A Robot, or a Tree (several tips).
        method: A Method, its name (cv, av, ca, aa, aad), or a solver that tracks; its options go into `options`.
        q0, rate0: Joint values at the start (n,), default home, and rates (n,), by default those that follow the target (0
            with acceleration limits).
        limits: Whether to keep position and speed limits, or narrower limits as in `ik.solve`. Joints outside are brought back.
        acceleration_limits: Number or (n,) [rad/s^2 or m/s^2]. All limits hold between samples, too, but with cv, av and
            solvers the rates jump at samples (aad: by at most a sixth of limit x dt).
        on_limit: What gives way to limits. "direct": the tip falls behind, but moves towards its target; "leave": the error
            is the least possible now; "clip": each joint is clipped on its own, as in the published form.
        dt_max: Longest step [s] that keeps limits (default five times the first dt); a longer dt is taken in parts.
        jump, resync: Joint move in a step that is reported as a jump, and difference between command and measurement above
            which the measurement is not believed until the next one agrees [rad or arm reaches].
        avoid_limits: Gain [1/s] (or True, False) of null-space motion away from near limits.
        posture: Joint values (n,) to move to in the null space, or (joint values, gain [1/s]).
        elbow: A dict from joint names to 1 or -1: the side of zero on which a joint stays.
        manipulability: Gain [1/s] with which manipulability is raised in the null space.
        cost: Function of q (n,) [rad or m] to lower in the null space; it returns a finite number or its gradient (n,).
        avoid_collisions: True (the robot's own links) or a CollisionModel. The arm slows down and slides along
            obstacles, and takes no step after which it could not stop before a static one (BLOCKED).
        reconfigure: Only with "direct". Move in joint space to another posture if only that reaches the target
            (RECONFIGURING): at once if the target rests, else when the error has cost as much as the move. Not with a locked joint.
        straight: Only with "direct". To a target that jumped and stands still, the tip moves straight. If that takes more than
            `straight` times as long as a direct joint move, this move is made instead (inf: only if there is no straight line).
        delay, noise: Age [samples] and standard deviation [rad or arm reaches] of measured joints, see JointObserver.
        options: Options of the method, and mask, slack, free_turn, frame, priority, relative_to, length_scale (0.2 m) of
            `ik.solve`.

    Raises InvalidOption (here and in `update` also for a cost that is not finite), InvalidConfiguration.
    """

    _INSTEAD = INSTEAD
    VIEWS, SHARED = ("_code", "_error", "_limits", "_q", "_rate", "_state"), ("robot", "_world")

    def __init__(
        self,
        robot: Robot | Tree,
        method: str | Method = "cv",
        *,
        q0: Any = None,
        rate0: Any = None,
        limits: Any = True,
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
        straight: float = STRAIGHT,
        delay: int = FILTER.delay,
        noise: float = FILTER.noise,
        **options: Any,
    ) -> None:
        """Bind a robot and a method; the arguments are described in the docstring of the class."""
        if not isinstance(robot, Robot | Tree):
            raise InvalidOption(f"tracking takes a Robot (see Robot.load) or a Tree, not {type(robot).__name__}")
        robot, limits = self.robot, limits = with_limits(robot, limits)
        self.engine = bind(robot, method, limits, options, Tracker.__init__.__kwdefaults__ or ())
        self._mode = getattr(MODE, one_of(on_limit, MODE._fields, "on_limit"))
        self.jump, self.resync = positive(jump, "jump"), positive(resync, "resync")
        self._limits = limit_rows(robot, limits, acceleration_limits)
        self._speed = speeds(self._limits) * robot.chain.unit
        self._longest = 0.0 if dt_max is None else positive(dt_max, "dt_max [s]")
        self._at_rest = acceleration_limits is not None
        self.secondary: Secondary = read_secondary(robot, avoid_limits, posture, elbow, manipulability, cost)
        self.secondary.confine(self._limits)
        self.stream = Stream(robot)
        self._world = None if avoid_collisions is False else collision_model(robot, avoid_collisions)
        self._guard: Guard | None = None
        if self._world is not None:
            self._guard = Guard(robot, self._world, self._limits * robot.chain.unit, self.engine.gamma)
        n, m = robot.n, 6 * self.stream.tips
        moves = bool(limits) and self._mode == MODE.direct
        self._postures = Postures(robot, self.engine.options, speeds(self._limits)) if moves else None
        # objects that move the joints in place of the tracking method where that fails or is slow
        self._ways = ways(self._postures, self.engine, straight, reconfigure, self._world)
        self._settings, self._out, self._here = new_settings(n, m, ROWS), new_record(2, n, m), new_record(1, n, m)
        self._settings.limits[:], self._settings.wish[:] = self._limits, self.secondary.wish
        self._carried = new_carried(n, self.engine.memory, ROWS + 2 * m + 1, m)  # an error with slack takes two rows
        self._cut()
        self._units = np.array([robot.chain.unit, robot.chain.unit])
        self._observer, self._rows = JointObserver(n, delay, noise), 0
        self._ordered: tuple = ()  # arguments of the last call of `_order`, which is called again only if they change
        self._kinds: tuple | None = None
        self._goes: Leap | Reconfiguration | None = None  # what led the last step in place of the method, or None
        self.reset(q0, rate0=rate0)
        self._seal()

    def _cut(self) -> None:
        """Make views of the arrays that the compiled loop reads and writes."""
        self._code, self._error = self._out.C[0], self._out.E[1]
        self._limits, self.secondary.wish = self._settings.limits, self._settings.wish
        (self._q, self._rate), self._state = self._carried.motion, self._carried.state

    def reset(
        self, q0: Any = None, target: Any = None, twist: Any = None, acceleration: Any = None, *, rate0: Any = None
    ) -> None:
        """Start again from q0 (default home) and rate0, with the target's pose and motion now if they are known."""
        q = self.robot.check_q(self.robot.home if q0 is None else q0, "q0")
        self._begin(q, None if rate0 is None else rates(self.robot, rate0))
        if self._touching:
            one, other = self._touching
            raise InvalidConfiguration(f"at q0 '{one}' touches '{other}'; start where nothing touches")
        self._late = self._longest
        if self.secondary.cost is not None:  # An invalid cost must raise its error here, not later in a control loop.
            self.secondary.look(self._q)
        self.stream.forget()
        if target is not None:
            self.stream.take(0, target, twist, acceleration)

    def _begin(self, q: np.ndarray, rate: np.ndarray | None, *, jumped: bool = False) -> None:
        """Set the joints to q and rate (n,) [rad or m, per s], and forget all earlier steps."""
        unit = self.robot.chain.unit
        self._q[:] = q / unit
        self._rate[:] = 0.0 if rate is None else rate / unit
        self._carried.swings[:], self._state[STATE.free] = 0.0, CALMING.lasting
        self._forget(START.given if rate is not None or self._at_rest else START.with_target)
        for way in self._ways:
            way.begin()
        self._observer.reset(jumped=jumped)
        self.stream.look_anew()
        self._behind = False  # whether the last examined step left an error
        self._between: tuple[str, str] | None = None  # the pair of parts that blocked the last step
        self._touching = self._guard.restart(q) if self._guard else None

    def _forget(self, start: int) -> None:
        """Forget the method's state, but not the joints' motion and oscillation; start: how the next step begins."""
        own = self._carried
        joints, swings, free = own.motion.copy(), own.swings.copy(), own.state[STATE.free]
        own.block[LINE:] = 0.0
        own.motion[:], own.swings[:], own.state[STATE.free] = joints, swings, free
        own.state[STATE.start] = start
        self.secondary.side(own.away)

    def _begins_at_rest(self) -> bool:
        """Return whether no step was taken yet and the joints are at rest, their rates given as 0."""
        return bool(self._state[STATE.start] == START.given and not self._rate.any())

    @property
    def q(self) -> np.ndarray:
        """Present command (n,) [rad or m]."""
        return self._q * self.robot.chain.unit

    def change_limits(
        self, *, lower: Any = None, upper: Any = None, speed: Any = None, acceleration: Any = None
    ) -> None:
        """Replace limits from now on: numbers, (n,), or a dict by joint name [rad or m, per s, per s^2].

        Joints beyond a new limit are brought back (RECOVERING); at a speed limit of 0 they brake and stay. Raises InvalidOption.
        """
        given: dict[str, Any] = dict(zip(LIMIT_NAMES, (lower, upper, speed, acceleration), strict=True))
        self._limits[:] = changed_limits(self.robot, self._limits, given)
        if self._guard:
            self._guard.limits = self._limits * self.robot.chain.unit

    def update(self, target: Any, dt: float, twist: Any = None, acceleration: Any = None, *, q: Any = None) -> Step:
        """Take a step towards the pose that the tip should have dt [s] from now; return a Step, which holds the command.

        Args:
            target: T_base_tip (4, 4), pin.SE3, position (3,) or AxisTarget; for several tips as in `ik.Solver`; always
                of one kind.
            dt: Length of the step [s].
            twist: Twist of the target at that time, (6,) or (3,), base axes, for several tips (F, 6) or a dict; default
                from the last two targets.
            acceleration: Acceleration of the target at that time, in the same form; default 0.
            q: Joint values (n,) as measured now, from which a filter estimates the joints (JointObserver). A measurement that is
                off by more than `resync` from the command it answers to is left out (FOLLOWING_ERROR). If the next one agrees
                with it, the tracker restarts from there, at rest (JUMPED); else, or outside the limits, it brakes (HELD).

        For a target that is not finite, whatever its kind, the arm brakes (HELD). Raises InvalidTarget for a wrong shape,
        InvalidOption for a dt that is not positive or is too long, InvalidConfiguration for a wrong q.
        """
        dt = positive(dt, "dt [s]")
        parts_of_step(dt, self._late or LATE * dt, self._longest > 0.0)  # This refuses a dt that is absurdly long.
        stream, lag, resynced = self.stream, 0.0, False
        finite = stream.take(1, target, twist, acceleration, dt)
        if stream.kinds != self._kinds or self._kinds is None:
            self.prepare(stream.kinds or (KIND.pose,) * stream.tips)
        (observer := self._observer).send(before := self._q.copy())
        if q is not None:
            lag = observer.take(read_measured(self.robot, q), dt, self.resync, self._limits) / self.resync
            if resynced := observer.confirmed:
                self._begin(observer.far * self._units[0], np.zeros(self.robot.n), jumped=True)
        if not self._late:  # Only the first step assigns, as assigning to a sealed object takes half a microsecond.
            self._late = LATE * dt
        h = dt / (parts := parts_of_step(dt, self._late))
        for part in stream.divided(parts) if parts > 1 else (stream.samples,):
            if observer.used:
                self._settings.measured[:] = self._q + observer.offset
            self._step(part, h, not finite or observer.doubts > 1, observer.used)
        if observer.used:
            self._error[:] = self.error_at(self._q + observer.offset, self.stream.last_of(part), h)
        code, lost = self._code.copy(), self._out.S[0]
        if self._postures and finite and not self._goes:
            stream.unseen += dt
            left = self._postures.size(self._error)
            behind = left >= REACHED
            # Most steps end at their target, or follow a moving one unhindered, and need not be examined.
            if (lost or stream.stand[STAND.still] or (code & BIT.position).any()) if behind else self._behind:
                self._watch(stream.samples, h, dt, left)
                self._behind = behind
        now = self._carried.motion * self._units
        # Before the first finite target there is no error to tell.
        errors = self._out.E.copy() if stream.kinds else np.full_like(self._out.E, np.nan)
        out = make_outcome((
            self._judged, code, before, errors, stream.samples.block.copy(), dt, h, lost,
            self._state[STATE.share] > 0.0, finite, lag, resynced, self._between, self._goes.why if self._goes else None,
        ))  # fmt: skip
        if finite:
            stream.step_on()
        return Step(now[0], now[1], out)

    def _step(self, samples: Samples, h: float, brake: bool, measured: bool) -> None:
        """Take one step, led by the first of `_ways` that has a goal (a joint move), or else by the method."""
        goes = None if brake else next((way for way in self._ways if way.goal is not None), None)
        if goes is not self._goes:
            self._goes = goes
        if goes:
            self._go(goes, samples, h, brake=brake, measured=measured)
        else:
            (self.take if self._guard else self.run)(samples, h, self._out, brake=brake, measured=measured)

    def _go(self, way: Leap | Reconfiguration, samples: Samples, h: float, **how: bool) -> None:
        """Take a step led by `way`, or by the method if `way` has no goal any more or a collision blocks its step."""
        guard, late = self._guard, max(self._late, h)
        before, (q, rate) = self.carried(), self._carried.motion * self._units
        goes = way.go(self._q, self._rate, samples.T[1], self.engine.gamma, h, late, self._limits, self._code)
        if guard and goes:
            guard.late = late
            guard.rows(q, rate, h)  # Its result is not needed, but it notices obstacles that were added or moved.
            next_q, next_rate = self._carried.motion * self._units
            goes = guard.allows(q, rate, next_q, next_rate, h)
            if not goes:
                self.put_back(before)
                way.blocked()
        if not goes:
            self._goes = None
            self.take(samples, h, self._out, **how)
            return
        self._forget(START.ready)
        self._end(self.stream.last_of(samples), h, self._out, **how)
        self._code &= BIT.recovering  # Other limits are not reported, because a joint move makes full use of them.
        self._out.S[0], self._between = 0.0, None

    def _watch(self, samples: Samples, h: float, dt: float, left: float) -> None:
        """Examine the step just taken, which may start a move to another posture or to a target that jumped; left [m]: error."""
        out, unseen, self.stream.unseen = self._out, self.stream.unseen, 0.0
        taken = Taken(
            self._code, out.S[0] > 0.0, out.E, left, samples.T, self.stream.stand, dt, h, unseen, self._q, self._rate,
            self._limits, lambda q: self.error_at(q, self.stream.last_of(samples), h),
        )  # fmt: skip
        for way in self._ways:
            way.watch(taken)

    def _now(self, samples: Samples, h: float, **how: Any) -> Record:
        """Return the present joints and errors as a Record, without a step; it is valid until the next call."""
        self.run(samples, h, self._here, **how)
        return self._here

    def error_at(self, q: np.ndarray, samples: Samples, h: float) -> np.ndarray:
        """Return the error (m,) [m, rad] to a target at joint values q (n,) [rad or arm reaches], valid until the next call."""
        self._settings.measured[:] = q
        return self._now(samples, h, measured=True).E[0]

    def _end(self, samples: Samples, h: float, out: Record, **how: Any) -> None:
        """Write the state after a step to the last row of the step's record `out`."""
        now = self._now(samples, h, **how)
        out.Q[1], out.R[1], out.E[1], out.S[1] = now.Q[0], now.R[0], now.E[0], now.S[0]

    def prepare(self, kinds: tuple) -> None:
        """Prepare for targets of these kinds, KIND.pose or KIND.position for each tip. Raises InvalidOption: slack with "clip"."""
        if self._kinds == kinds:
            return
        self._orders, counts = self.engine.orders(kinds)
        weights, slack = counts[:2]
        slacks = 2 * int((slack > 0.0).sum())
        if self._mode == MODE.clip and slacks:
            raise InvalidOption("slack is kept by the constrained step, so on_limit cannot be 'clip'")
        if self._postures:
            self._postures.ready(kinds)
        self._settings.counts[:] = counts
        self._carried.block[3] = (ROWS if self._guard else 0) + slacks + 1
        self._carried = carried_of(self._carried.block)
        self._carried.kept[:], self._carried.basis[:] = 0, 0.0
        posed = tuple(weights.reshape(-1, 2, 3)[:, 1].any(axis=1).tolist())
        firm = np.array(group_levels(self.robot, self.engine.options)).reshape(-1, 2) == 0
        self._judged = StatusContext(self.robot, self.engine.natural, posed, firm, self.jump, self._speed)
        self._kinds = kinds

    def carried(self) -> np.ndarray:
        """Return a copy of the tracker's whole state between steps (`Carried`), as one flat array, see `put_back`."""
        return self._carried.block.copy()

    def put_back(self, kept: np.ndarray) -> None:
        """Go back to an earlier state of the tracker, which `carried` returned."""
        self._carried.block[:] = kept

    def run(
        self, samples: Samples, h: float, out: Record, *, brake: bool = False, measured: bool = False,
        runaway: float = math.inf,
    ) -> int:  # fmt: skip
        """Take as many steps of h [s] towards the targets in `samples` as `out` has room for; return how many were taken."""
        # Gains that are chosen anew for every step's length would make method ca oscillate where step lengths differ.
        pace = max(h, min(self.stream.pace, self._late))
        ordered = h, pace, brake, measured, runaway, self._late, self._rows, self.secondary.avoid
        if ordered != self._ordered:
            self._order(*ordered)
            self._ordered = ordered
        if self.secondary.each_step and len(out.E) > 1:  # With room for one sample no step is taken.
            self.secondary.look(self._q)
        chain = self.robot.chain
        return self.engine.loop(
            chain.rows, chain.ends, self._orders, self._settings.block, self._carried.block, samples.block, out.block, h
        )

    def _order(self, h, pace, brake, measured, runaway, late, rows, avoid) -> None:
        """Write the method's parameters to the settings; pace [s]: step length for which the gains are chosen."""
        law, at = self._settings.law, PLACE
        law[:] = self.engine.law(pace)
        law[at.brake], law[at.measured], law[at.runaway], law[at.late] = brake, measured, runaway, max(late, h)
        law[at.rows], law[at.avoid], law[at.mode] = rows, avoid, self._mode

    @property
    def one_by_one(self) -> bool:
        """Whether steps must be taken singly, because a cost or distances to obstacles are evaluated before each of them."""
        return self.secondary.each_step or self._guard is not None

    def take(self, samples: Samples, h: float, out: Record, *, brake: bool = False, **how: Any) -> int:
        """Take steps as `run` does; near obstacles one step, or brake if it could end in a contact. Return how many were taken."""
        guard, unit = self._guard, self.robot.chain.unit
        if guard is None:
            return self.run(samples, h, out, brake=brake, **how)
        guard.late = max(self._late, h)
        q, rate = self._carried.motion * self._units
        self._rows = r = guard.rows(q, rate, h)
        self._settings.lines[:r], self._settings.level[:r] = guard.A[:r] * unit, guard.b[:r]
        before = self.carried()
        done = self.run(samples, h, out, brake=brake, **how)
        held = np.flatnonzero(self._carried.kept[:r])
        self._between = guard.pairs[held[0]] if len(held) and out.C[0].any() else None
        next_q, next_rate = self._carried.motion * self._units
        if not done or guard.allows(q, out.R[0] * unit, next_q, next_rate, h):
            return done
        self.put_back(before)
        self._carried.motion[:] = guard.instead(q, rate, next_q, next_rate, h) / self._units
        move = (self._q - q / unit) / h
        watch(self._carried.swings, move, move, speeds(self._limits), 1.0, h)
        state, at = self._state, STATE
        state[at.start], state[at.free] = START.ready, 0.0
        self._carried.memory[:], self._between = 0.0, guard.blocked
        self._end(self.stream.last_of(samples), h, out, **how)
        hard = np.isclose(np.abs(self._rate * unit - rate), h * guard.most)
        out.C[0] = np.where(hard, BIT.row | BIT.acceleration, BIT.row) | (BIT.held if brake else 0)
        return 1
