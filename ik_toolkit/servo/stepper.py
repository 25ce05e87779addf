"""Steps of a robot's joints towards samples of targets, and the joint limits as arrays that the steps keep."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from ..compile.array_view import LINE
from ..copying import CopiesViews
from ..errors import InvalidOption, floats, near_match
from ..robot.robot import Robot
from ..robot.tree import Tree
from ..solvers.task import group_levels
from ..validate import switch
from .adapters import Published, RuleSteps
from .collision_guard import ROWS, Guard
from .constrained_step import MODE
from .laws import PLACE
from .null_space_motion import Secondary
from .step import StatusContext
from .viability import BIT, CALMING, LIMIT, UNLIMITED, watch
from .workspace import START, STATE, Record, Samples, carried_of, new_carried, new_record, new_samples, new_settings

LIMIT_NAMES = ("lower", "upper", "speed", "acceleration")


class Stepper(CopiesViews):
    """Moves a robot's joints in steps towards samples of targets, inside the joint limits and clear of obstacles.

    `Tracker` takes such steps towards targets that arrive one by one, `track` along a whole reference.

    limits (4, n): lower, upper, speed, acceleration; they may be changed in place. q, rate (n,): the present joints. state, away:
    parts of `Carried`. All are in rad or arm reaches. settings: other inputs of the compiled loop. secondary: null-space motion.
    guard: what keeps the arm clear of obstacles, or None. late [s]: longest later step, in which the joints must still be able to
    stop. pace [s]: least step length for which gains are chosen. kinds: kind of target of each tip, as given to `prepare`, which
    also makes judged, the `StatusContext`. between: names of the two parts that blocked the last step, or None. touching: names of
    two parts that touched at the start, or None.
    """

    VIEWS = ("limits", "q", "rate", "state", "away")

    def __init__(
        self, robot: Robot | Tree, engine: Published | RuleSteps, limits: bool, acceleration_limits: Any, mode: int,
        secondary: Secondary, world: Any, jump: float,
    ) -> None:  # fmt: skip
        """Bind a robot and its tracking method (engine); `begin` and `prepare` must follow before the first step.

        limits, acceleration_limits, jump: as in `Tracker`; mode: what gives way to limits, a number of `StepModes`; world: a
        CollisionModel or None. Raises InvalidOption.
        """
        self.robot, self.engine, self.secondary, self._mode, self._jump = robot, engine, secondary, mode, jump
        n, tips, unit, rows = robot.n, len(robot.tips), robot.chain.unit, limit_rows(robot, limits, acceleration_limits)
        self._at_rest, self._units = acceleration_limits is not None, np.array([unit, unit])
        self._speed = speeds(rows) * unit
        secondary.confine(rows)
        self.guard = None if world is None else Guard(robot, world, rows * unit, engine.gamma)
        self.settings, self._here = new_settings(n, 6 * tips, ROWS), new_record(1, n, 6 * tips)
        self.settings.limits[:], self.settings.wish[:] = rows, secondary.wish
        # an error with slack takes two rows
        self._carried = new_carried(n, engine.memory, ROWS + 12 * tips + 1, 6 * tips)
        self._cut()
        self._last = new_samples(1, tips)
        self._ordered: tuple = ()  # arguments of the last call of `_order`, which is called again only if they change
        self._rows, self.late, self.pace = 0, 0.0, 0.0
        self.kinds: tuple | None = None

    def _cut(self) -> None:
        """Make views of the arrays that the compiled loop reads and writes."""
        self.limits, self.secondary.wish = self.settings.limits, self.settings.wish
        (self.q, self.rate), self.away, self.state = self._carried.motion, self._carried.away, self._carried.state

    def begin(self, q: np.ndarray, rate: np.ndarray | None) -> None:
        """Set the joints to q and rate (n,) [rad or m, per s], and forget all earlier steps."""
        self.q[:], self.rate[:] = q / self._units[0], 0.0 if rate is None else rate / self._units[0]
        self._carried.swings[:], self.state[STATE.free] = 0.0, CALMING.lasting
        self.forget(START.given if rate is not None or self._at_rest else START.with_target)
        self.between: tuple[str, str] | None = None
        self.touching = self.guard.restart(q) if self.guard else None

    def forget(self, start: int) -> None:
        """Forget the method's state, but not the joints' motion and oscillation; start: how the next step begins."""
        own = self._carried
        joints, swings, free = own.motion.copy(), own.swings.copy(), own.state[STATE.free]
        own.block[LINE:] = 0.0
        own.motion[:], own.swings[:], own.state[STATE.free] = joints, swings, free
        own.state[STATE.start] = start
        self.secondary.side(own.away)

    def begins_at_rest(self) -> bool:
        """Return whether no step was taken yet and the joints are at rest, their rates given as 0."""
        return bool(self.state[STATE.start] == START.given and not self.rate.any())

    def prepare(self, kinds: tuple) -> None:
        """Prepare for targets of these kinds, KIND.pose or KIND.position for each tip. Raises InvalidOption: slack with "clip"."""
        self._orders, counts = self.engine.orders(kinds)
        weights, slack = counts[:2]
        slacks = 2 * int((slack > 0.0).sum())
        if self._mode == MODE.clip and slacks:
            raise InvalidOption("slack is kept by the constrained step, so on_limit cannot be 'clip'")
        self.settings.counts[:] = counts
        self._carried.block[3] = (ROWS if self.guard else 0) + slacks + 1
        self._carried = carried_of(self._carried.block)
        self._carried.kept[:], self._carried.basis[:] = 0, 0.0
        posed = tuple(weights.reshape(-1, 2, 3)[:, 1].any(axis=1).tolist())
        firm = np.array(group_levels(self.robot, self.engine.options)).reshape(-1, 2) == 0
        self.judged = StatusContext(self.robot, self.engine.natural, posed, firm, self._jump, self._speed)
        self.kinds = kinds

    def joints(self) -> np.ndarray:
        """Return the present joint values and rates (2, n) [rad or m, per s]."""
        return self._carried.motion * self._units

    def change_limits(self, given: Mapping[str, Any]) -> None:
        """Replace limits from now on; given: as in `changed_limits`. Raises InvalidOption."""
        self.limits[:] = changed_limits(self.robot, self.limits, given)
        if self.guard:
            self.guard.limits = self.limits * self.robot.chain.unit

    def carried(self) -> np.ndarray:
        """Return a copy of the whole state between steps (`Carried`), as one flat array, see `put_back`."""
        return self._carried.block.copy()

    def put_back(self, kept: np.ndarray) -> None:
        """Go back to an earlier state, which `carried` returned."""
        self._carried.block[:] = kept

    def _now(self, samples: Samples, h: float, **how: Any) -> Record:
        """Return the joints and their errors from the last of the targets as a Record, which is valid until the next call."""
        last = self._last
        last.T[0], last.V[0], last.A[0] = samples.T[-1], samples.V[-1], samples.A[-1]
        self.run(last, h, self._here, **how)  # With room for one sample no step is taken.
        return self._here

    def error_at(self, q: np.ndarray, samples: Samples, h: float) -> np.ndarray:
        """Return the error (m,) [m, rad] to the last of the targets at joint values q (n,) [rad or arm reaches].

        It is valid until the next call.
        """
        self.settings.measured[:] = q
        return self._now(samples, h, measured=True).E[0]

    def end(self, samples: Samples, h: float, out: Record, **how: Any) -> None:
        """Write the state after a step to the last row of the step's record `out`."""
        now = self._now(samples, h, **how)
        out.Q[1], out.R[1], out.E[1], out.S[1] = now.Q[0], now.R[0], now.E[0], now.S[0]

    def run(
        self, samples: Samples, h: float, out: Record, *, brake: bool = False, measured: bool = False,
        runaway: float = math.inf,
    ) -> int:  # fmt: skip
        """Take as many steps of h [s] towards the targets in `samples` as `out` has room for; return how many were taken."""
        # Gains that are chosen anew for every step's length would make method ca oscillate where step lengths differ.
        pace = max(h, min(self.pace, self.late))
        ordered = h, pace, brake, measured, runaway, self.late, self._rows, self.secondary.avoid
        if ordered != self._ordered:
            self._order(*ordered)
            self._ordered = ordered
        if self.secondary.each_step and len(out.E) > 1:  # With room for one sample no step is taken.
            self.secondary.look(self.q)
        chain = self.robot.chain
        return self.engine.loop(
            chain.rows, chain.ends, self._orders, self.settings.block, self._carried.block, samples.block, out.block, h
        )

    def _order(self, h, pace, brake, measured, runaway, late, rows, avoid) -> None:
        """Write the method's parameters to the settings; pace [s]: step length for which the gains are chosen."""
        law, at = self.settings.law, PLACE
        law[:] = self.engine.law(pace)
        law[at.brake], law[at.measured], law[at.runaway], law[at.late] = brake, measured, runaway, max(late, h)
        law[at.rows], law[at.avoid], law[at.mode] = rows, avoid, self._mode

    @property
    def one_by_one(self) -> bool:
        """Whether steps must be taken singly, because a cost or distances to obstacles are evaluated before each of them."""
        return self.secondary.each_step or self.guard is not None

    def take(self, samples: Samples, h: float, out: Record, *, brake: bool = False, **how: Any) -> int:
        """Take steps as `run` does; near obstacles one step, or brake if it could end in a contact. Return how many were taken."""
        guard, unit = self.guard, self.robot.chain.unit
        if guard is None:
            return self.run(samples, h, out, brake=brake, **how)
        guard.late = max(self.late, h)
        q, rate = self.joints()
        self._rows = r = guard.rows(q, rate, h)
        self.settings.lines[:r], self.settings.level[:r] = guard.A[:r] * unit, guard.b[:r]
        before = self.carried()
        done = self.run(samples, h, out, brake=brake, **how)
        held = np.flatnonzero(self._carried.kept[:r])
        self.between = guard.pairs[held[0]] if len(held) and out.C[0].any() else None
        next_q, next_rate = self.joints()
        if not done or guard.allows(q, out.R[0] * unit, next_q, next_rate, h):
            return done
        self.put_back(before)
        self._carried.motion[:] = guard.instead(q, rate, next_q, next_rate, h) / self._units
        move = (self.q - q / unit) / h
        watch(self._carried.swings, move, move, speeds(self.limits), 1.0, h)
        state, at = self.state, STATE
        state[at.start], state[at.free] = START.ready, 0.0
        self._carried.memory[:], self.between = 0.0, guard.blocked
        self.end(samples, h, out, **how)
        hard = np.isclose(np.abs(self.rate * unit - rate), h * guard.most)
        out.C[0] = np.where(hard, BIT.row | BIT.acceleration, BIT.row) | (BIT.held if brake else 0)
        return 1


# -------------------------------------------------------------------------------------------------------- joint limits
def limit_rows(robot: Robot | Tree, limits: bool, acceleration_limits: Any) -> np.ndarray:
    """Return the limits (4, n) of the joints in internal units: rows lower, upper, speed, acceleration.

    Limits that a joint does not have are infinite. The internal unit is 1 rad for a revolute joint, and about the arm's reach
    (`chain.scale`) for a prismatic joint.

    Args:
        robot: The robot whose position and speed limits are read.
        limits: Whether position and speed limits apply.
        acceleration_limits: None, a number or (n,) [rad/s^2 or m/s^2].

    Raises:
        InvalidOption: acceleration_limits has a wrong shape or is not positive, or is given without limits.
    """
    n, unit = robot.n, robot.chain.unit
    rows = np.full((4, n), np.inf)
    rows[LIMIT.lowest] = -np.inf
    if switch(limits, "limits"):
        speed = np.asarray(robot.velocity_limits, dtype=float)
        rows[LIMIT.lowest], rows[LIMIT.highest] = robot.lower / unit, robot.upper / unit
        rows[LIMIT.speed] = np.where(speed > 0.0, speed, np.inf) / unit
    if acceleration_limits is not None:
        if not limits:
            raise InvalidOption("acceleration_limits must go with limits=True")
        what = f"acceleration_limits must be a number or {n} numbers"
        a = floats(acceleration_limits, what, InvalidOption)
        if a.shape not in ((), (n,)):
            raise InvalidOption(f"{what}, not {acceleration_limits!r:.60}")
        if not (a > 0.0).all():
            raise InvalidOption(f"acceleration_limits must be positive, not {acceleration_limits!r}")
        rows[LIMIT.acceleration] = a / unit
    return rows


def speeds(limits: np.ndarray) -> np.ndarray:
    """Return the speed limits (n,) from limits (4, n), with UNLIMITED in place of infinite ones."""
    return np.where(limits[LIMIT.speed] < np.inf, limits[LIMIT.speed], UNLIMITED)


def changed_limits(robot: Robot | Tree, rows: np.ndarray, given: Mapping[str, Any]) -> np.ndarray:
    """Return a copy of the limits (4, n) [rad or arm reaches, per s, per s^2] with some of its rows replaced.

    Args:
        robot: The robot, for the names and units of its joints.
        rows: Present limits (4, n): lower, upper, speed, acceleration.
        given: For each name of LIMIT_NAMES a number, an array (n,), a dict by joint name [rad or m, per s, per s^2], or None
            to keep the row.

    Raises:
        InvalidOption: A value is not a number, there is no such joint, a speed or acceleration is negative, or lower is
            above upper.
    """
    rows, unit = rows.copy(), robot.chain.unit
    for row, name in zip(rows, LIMIT_NAMES, strict=True):
        value = given[name]
        if value is None:
            continue
        new = row * unit
        if isinstance(value, Mapping):
            for joint, one in value.items():
                if joint not in robot.joint_names:
                    raise InvalidOption(f"{name}: no joint '{joint}'.{near_match(joint, robot.joint_names)}")
                number = floats(one, f"{name} of {joint} must be a number", InvalidOption)
                if number.ndim:
                    raise InvalidOption(f"{name} of {joint} must be a number, not {one!r:.60}")
                new[robot.joint_names.index(joint)] = number
        else:
            numbers = floats(value, f"{name} must be a number or {robot.n} numbers", InvalidOption)
            if numbers.shape not in ((), new.shape):
                raise InvalidOption(f"{name} must be a number or {robot.n} numbers, not {value!r:.60}")
            new[:] = numbers
        least = -np.inf if name in ("lower", "upper") else 0.0
        if np.isnan(new).any() or (new < least).any():
            raise InvalidOption(f"{name} must be numbers{'' if least else ' of at least 0'}, not {value!r:.60}")
        row[:] = new / unit
    if (rows[LIMIT.lowest] > rows[LIMIT.highest]).any():
        raise InvalidOption("lower limits must not be above the upper ones")
    return rows
