"""`Tracker`: follow targets that arrive one by one, in the caller's control loop."""

from typing import Any, ClassVar

import numpy as np

from ..copying import CopiesViews, ReadOnly
from ..errors import InvalidConfiguration, InvalidOption
from ..kernel.counted_error import KIND
from ..robot.narrow import with_limits
from ..robot.robot import Robot
from ..robot.tree import Tree
from ..solvers.collision_free import collision_model
from ..validate import LATE, one_of, parts_of_step, positive, rates
from .adapters import bind
from .constrained_step import MODE
from .joint_observer import FILTER, JointObserver, read_measured
from .methods import Method
from .null_space_motion import Secondary, read_secondary
from .reconfigure import REACHED, Postures, Reconfiguration, Taken
from .step import Step, make_outcome
from .stepper import LIMIT_NAMES, Stepper, speeds
from .target_jump import STRAIGHT, Leap, ways
from .target_stream import STAND, Stream
from .viability import BIT
from .workspace import START, STATE, Samples, new_record

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

    # what to do instead of assigning to an attribute, by name; "" stands for all others
    _INSTEAD: ClassVar = {
        **dict.fromkeys(("limits", *LIMIT_NAMES), "use change_limits"),
        "q": "use reset(q0), or pass q= to update where joints are measured",
        "": "make a Tracker with the robot, method and options that are meant",
    }
    VIEWS, SHARED = ("_code", "_error"), ("robot", "_world")

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
        mode = getattr(MODE, one_of(on_limit, MODE._fields, "on_limit"))
        self.jump, self.resync = positive(jump, "jump"), positive(resync, "resync")
        self._longest = 0.0 if dt_max is None else positive(dt_max, "dt_max [s]")
        secondary: Secondary = read_secondary(robot, avoid_limits, posture, elbow, manipulability, cost)
        self._world = None if avoid_collisions is False else collision_model(robot, avoid_collisions)
        self.stepper = stepper = Stepper(
            robot, self.engine, limits, acceleration_limits, mode, secondary, self._world, self.jump
        )
        self.stream = Stream(robot)
        moves = bool(limits) and mode == MODE.direct
        self._postures = Postures(robot, self.engine.options, speeds(stepper.limits)) if moves else None
        # objects that move the joints in place of the tracking method where that fails or is slow
        self._ways = ways(self._postures, self.engine, straight, reconfigure, self._world)
        self._out = new_record(2, robot.n, 6 * self.stream.tips)
        self._cut()
        self._observer = JointObserver(robot.n, delay, noise)
        self._goes: Leap | Reconfiguration | None = None  # what led the last step in place of the method, or None
        self.reset(q0, rate0=rate0)
        self._seal()

    def _cut(self) -> None:
        """Make views of the record of a step."""
        self._code, self._error = self._out.C[0], self._out.E[1]

    def reset(
        self, q0: Any = None, target: Any = None, twist: Any = None, acceleration: Any = None, *, rate0: Any = None
    ) -> None:
        """Start again from q0 (default home) and rate0, with the target's pose and motion now if they are known."""
        q = self.robot.check_q(self.robot.home if q0 is None else q0, "q0")
        self._begin(q, None if rate0 is None else rates(self.robot, rate0))
        if self.stepper.touching:
            one, other = self.stepper.touching
            raise InvalidConfiguration(f"at q0 '{one}' touches '{other}'; start where nothing touches")
        self.stepper.late, secondary = self._longest, self.stepper.secondary
        if secondary.cost is not None:  # An invalid cost must raise its error here, not later in a control loop.
            secondary.look(self.stepper.q)
        self.stream.forget()
        if target is not None:
            self.stream.take(0, target, twist, acceleration)

    def _begin(self, q: np.ndarray, rate: np.ndarray | None, *, jumped: bool = False) -> None:
        """Set the joints to q and rate (n,) [rad or m, per s], and forget all earlier steps."""
        self.stepper.begin(q, rate)
        for way in self._ways:
            way.begin()
        self._observer.reset(jumped=jumped)
        self.stream.look_anew()
        self._behind = False  # whether the last examined step left an error

    @property
    def q(self) -> np.ndarray:
        """Present command (n,) [rad or m]."""
        return self.stepper.joints()[0]

    def change_limits(
        self, *, lower: Any = None, upper: Any = None, speed: Any = None, acceleration: Any = None
    ) -> None:
        """Replace limits from now on: numbers, (n,), or a dict by joint name [rad or m, per s, per s^2].

        Joints beyond a new limit are brought back (RECOVERING); at a speed limit of 0 they brake and stay. Raises InvalidOption.
        """
        given: dict[str, Any] = dict(zip(LIMIT_NAMES, (lower, upper, speed, acceleration), strict=True))
        self.stepper.change_limits(given)

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
        stepper, stream, lag, resynced = self.stepper, self.stream, 0.0, False
        parts_of_step(dt, stepper.late or LATE * dt, self._longest > 0.0)  # This refuses a dt that is absurdly long.
        finite = stream.take(1, target, twist, acceleration, dt)
        stepper.pace = stream.pace
        if (kinds := stream.kinds or (KIND.pose,) * stream.tips) != stepper.kinds:
            stepper.prepare(kinds)
            if self._postures:
                self._postures.ready(kinds)
        (observer := self._observer).send(before := stepper.q.copy())
        if q is not None:
            lag = observer.take(read_measured(self.robot, q), dt, self.resync, stepper.limits) / self.resync
            if resynced := observer.confirmed:
                self._begin(observer.far * self.robot.chain.unit, np.zeros(self.robot.n), jumped=True)
        stepper.late = stepper.late or LATE * dt
        h = dt / (parts := parts_of_step(dt, stepper.late))
        for part in stream.divided(parts) if parts > 1 else (stream.samples,):
            if observer.used:
                stepper.settings.measured[:] = stepper.q + observer.offset
            self._step(part, h, not finite or observer.doubts > 1, observer.used)
        if observer.used:
            self._error[:] = stepper.error_at(stepper.q + observer.offset, part, h)
        code, lost = self._code.copy(), self._out.S[0]
        if self._postures and finite and not self._goes:
            stream.unseen += dt
            left = self._postures.size(self._error)
            behind = left >= REACHED
            # Most steps end at their target, or follow a moving one unhindered, and need not be examined.
            if (lost or stream.stand[STAND.still] or (code & BIT.position).any()) if behind else self._behind:
                self._watch(stream.samples, h, dt, left)
                self._behind = behind
        now = stepper.joints()
        # Before the first finite target there is no error to tell.
        errors = self._out.E.copy() if stream.kinds else np.full_like(self._out.E, np.nan)
        out = make_outcome((
            stepper.judged, code, before, errors, stream.samples.block.copy(), dt, h, lost,
            stepper.state[STATE.share] > 0.0, finite, lag, resynced, stepper.between, self._goes.why if self._goes else None,
        ))  # fmt: skip
        if finite:
            stream.step_on()
        return Step(now[0], now[1], out)

    def _step(self, samples: Samples, h: float, brake: bool, measured: bool) -> None:
        """Take one step, led by the first of `_ways` that has a goal (a joint move), or else by the method."""
        stepper, goes = self.stepper, None if brake else next((way for way in self._ways if way.goal is not None), None)
        if goes is not self._goes:
            self._goes = goes
        if goes:
            self._go(goes, samples, h, brake=brake, measured=measured)
        else:
            (stepper.take if stepper.guard else stepper.run)(samples, h, self._out, brake=brake, measured=measured)

    def _go(self, way: Leap | Reconfiguration, samples: Samples, h: float, **how: bool) -> None:
        """Take a step led by `way`, or by the method if `way` has no goal any more or a collision blocks its step."""
        stepper, guard, late = self.stepper, self.stepper.guard, max(self.stepper.late, h)
        before, (q, rate) = stepper.carried(), stepper.joints()
        goes = way.go(stepper.q, stepper.rate, samples.T[1], self.engine.gamma, h, late, stepper.limits, self._code)
        if guard and goes:
            guard.late = late
            guard.rows(q, rate, h)  # Its result is not needed, but it notices obstacles that were added or moved.
            next_q, next_rate = stepper.joints()
            goes = guard.allows(q, rate, next_q, next_rate, h)
            if not goes:
                stepper.put_back(before)
                way.blocked()
        if not goes:
            self._goes = None
            stepper.take(samples, h, self._out, **how)
            return
        stepper.forget(START.ready)
        stepper.end(samples, h, self._out, **how)
        self._code &= BIT.recovering  # Other limits are not reported, because a joint move makes full use of them.
        self._out.S[0], stepper.between = 0.0, None

    def _watch(self, samples: Samples, h: float, dt: float, left: float) -> None:
        """Examine the step just taken, which may start a move to another posture or to a target that jumped; left [m]: error."""
        stepper, out, unseen, self.stream.unseen = self.stepper, self._out, self.stream.unseen, 0.0
        taken = Taken(
            self._code, out.S[0] > 0.0, out.E, left, samples.T, self.stream.stand, dt, h, unseen, stepper.q, stepper.rate,
            stepper.limits, lambda q: stepper.error_at(q, samples, h),
        )  # fmt: skip
        for way in self._ways:
            way.watch(taken)
