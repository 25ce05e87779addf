"""One step of a tracker as it is returned; the status and its sentence are computed only when they are read."""

import math
from collections.abc import Callable
from enum import Enum
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from ..errors import FAR_AWAY
from ..motion.reference import log
from ..text import angle, length
from .viability import BIT
from .workspace import samples_of


class StatusThresholds(NamedTuple):
    """Thresholds by which the status of a tracker's step is judged."""

    # [m] A larger error is explained by a joint limit or the edge of the reach, where one of them prevents its correction.
    position: float = 1e-3
    angle: float = 5e-3  # [rad] orientation error above which limits or reach are reported as the reason
    # A joint counts as at rest below this share of its speed limit (of 1 rad/s or 1 reach/s if it has none).
    at_rest: float = 1e-3
    # A joint slower than this share of its speed limit counts as not moving at all. Even a gain of 0.1/s would ask for a share of
    # about 1e-4 to close an error that is worth reporting (`position`).
    resting: float = 1e-6
    # The tip counts as coming nearer if the error falls by at least this share of what the feedback alone would remove.
    falling: float = 0.2
    # allowance for rounding: share added to the part of an error that is due to the target's own motion
    rounding: float = 1e-6
    still: float = 1e-3  # The tip counts as hardly coming nearer if a step removes less than this share of the error.


JUDGE = StatusThresholds()


class StepStatus(Enum):
    """Outcome of one tracker step.

    - OK: the arm is at its target, or nothing keeps it from getting nearer. It need not be on target: read `position_error`.
    - LIMITED: a limit held a joint back, or the tip can hardly get nearer, or it is on its way to a target that jumped.
    - AT_LIMIT: the arm rests about as close as a joint's limit, or its reach, allows.
    - BLOCKED: the arm rests as near as a collision ahead allows.
    - RECONFIGURING: the arm moves to another posture, which reaches the target.
    - RECOVERING: a joint outside its limits returns or brakes.
    - FOLLOWING_ERROR: the measured joints are far from the commanded ones, or not finite.
    - JUMPED: a joint moved far, or the tracker restarted from the measured joints.
    - HELD: the target or the command was not finite, or measured joints that are far off do not agree, are not finite or are
      outside the limits.
    """

    OK = "ok"
    LIMITED = "limited"
    AT_LIMIT = "at limit"
    BLOCKED = "blocked"
    RECONFIGURING = "reconfiguring"
    RECOVERING = "recovering"
    FOLLOWING_ERROR = "following error"
    JUMPED = "jumped"
    HELD = "held"


class StatusContext(NamedTuple):
    """What the status of a step depends on besides the step itself; it is the same for all steps of a tracker."""

    robot: Any
    # function that returns the rate [1/s] at which an error falls in steps of a length [s] if nothing hinders it
    natural: Callable[[float], float]
    posed: tuple[bool, ...]  # whether the orientation of each tip counts
    firm: np.ndarray  # (F, 2) whether position and orientation of each tip are of the highest priority level
    jump: float  # [rad or arm reaches] joint move in one step that is reported as a jump
    speed: np.ndarray  # (n,) speed limits [rad/s or m/s]


class Lead(NamedTuple):
    """A joint move that replaces the tracking method: whether it leads to another posture, and in words why it is made."""

    elsewhere: bool
    words: str = "moving to another posture that reaches the target"


class Outcome(NamedTuple):
    """What the status of one step is computed from; the arrays are not shared with the tracker."""

    by: StatusContext
    code: np.ndarray  # (n,) bits of the limits that were active (`viability.LimitBits`)
    before: np.ndarray  # (n,) previous command [rad or arm reaches]
    errors: np.ndarray  # (2, m) errors before and after the step [m, rad]
    # the targets before and after the step: flat array of a `Samples`, which is divided when it is needed
    samples: np.ndarray
    dt: float  # [s] length of the update; a long one is taken in several steps
    h: float  # [s] length of the step
    lost: float  # number of singular directions (in which the tip can hardly move) removed from the task
    down: bool  # whether the step was a damped least-squares step of an arm that is stuck near its target
    finite: bool  # whether all numbers of the target were finite
    # largest difference between measured and commanded joints, as a share of the allowed one; infinite if not finite
    lag: float
    resynced: bool  # whether the tracker restarted from the measured joints
    between: tuple[str, str] | None  # names of the two parts that would have touched
    way: Lead | None  # what led the joints in place of the tracking method


make_outcome = partial(tuple.__new__, Outcome)  # makes an Outcome faster than Outcome(...) does


class Step:
    """One step of a tracker.

    q (n,) [rad or m] and rate (n,) [rad/s or m/s]: command these now. position_error [m] and orientation_error [rad] (None for
    positions): distances left to this step's target, for several tips the largest, NaN before the first finite target. They are
    taken at `q`, or if joints are measured, where the joints are estimated to be at the end of the step. at_rest, between and
    status: see these properties.
    reason: a sentence, '' for OK at the target.
    """

    __slots__ = ("_outcome", "q", "rate")

    def __init__(self, q: np.ndarray, rate: np.ndarray, outcome: Outcome) -> None:
        """Keep the command q, rate, and the outcome from which status and reason are computed when they are read."""
        self.q, self.rate, self._outcome = q, rate, outcome

    @property
    def position_error(self) -> float:
        """Distance [m] left to the target; the largest of several tips."""
        e = self._outcome.errors[1].reshape(-1, 6)[:, :3]
        return float(np.sqrt((e * e).sum(axis=1).max()))

    @property
    def orientation_error(self) -> float | None:
        """Rotation angle [rad] left to the target, the largest of several tips; None if no orientation counts."""
        o = self._outcome
        if not any(o.by.posed):
            return None
        e = o.errors[1].reshape(-1, 6)[list(o.by.posed), 3:]
        return float(np.sqrt((e * e).sum(axis=1).max()))

    @property
    def status(self) -> StepStatus:
        """How the step went, as an `ik.StepStatus`, whose help says what each means. OK does not mean on target."""
        o = self._outcome
        if o.code[0] & BIT.held:
            return StepStatus.HELD
        if o.resynced or (self._moved() > o.by.jump).any():
            return StepStatus.JUMPED
        held = int(np.bitwise_or.reduce(o.code))
        if held & BIT.recovering:
            return StepStatus.RECOVERING
        if o.way is not None:
            return StepStatus.RECONFIGURING if o.way.elsewhere else StepStatus.LIMITED
        if o.lag > 0.5:
            return StepStatus.FOLLOWING_ERROR
        # A limit may also stop the arm from closing an error of a lower priority level.
        stays = (held and self._away(every=True)) or ((o.lost or self._rests()) and self._away())
        if stays and self.at_rest and not self._falls():
            return StepStatus.BLOCKED if held & BIT.row else StepStatus.AT_LIMIT
        hindered = held or (self._away() and (o.down or not self._falls()))
        return StepStatus.LIMITED if hindered else StepStatus.OK

    def _moved(self) -> np.ndarray:
        """Return how far (n,) the joints moved in this step [rad or arm reaches]."""
        return np.abs(self.q / self._outcome.by.robot.chain.unit - self._outcome.before)

    @property
    def between(self) -> tuple[str, str] | None:
        """Names of the two parts that would touch if a collision ahead holds the arm back, else None."""
        return self._outcome.between

    @property
    def at_rest(self) -> bool:
        """Whether all joints are slower than a thousandth of their speed limits."""
        return bool((np.abs(self.rate) <= JUDGE.at_rest * self._outcome.by.speed).all())

    def _rests(self) -> bool:
        """Return whether no joint moves although there was an error before the step, so that no motion reduces this error."""
        before, after = np.abs(self._outcome.errors)
        return bool(
            (np.abs(self.rate) <= JUDGE.resting * self._outcome.by.speed).all() and before.max() > 0.5 * after.max()
        )

    def _falls(self) -> bool:
        """Return whether the error, with lengths in arm reaches, falls about as fast as feedback lets it fall without hindrance.

        If an arm cannot follow, but its target comes back, the error falls, too, but more slowly.
        """
        o, (before, after) = self._outcome, self._sizes()
        swerve = (1.0 + JUDGE.rounding) * self._swerve()
        return bool(after < (1.0 - JUDGE.falling * min(o.by.natural(o.h) * o.h, 1.0)) * before + swerve)

    def _sizes(self) -> np.ndarray:
        """Return the size (2,) of the errors before and after the step, with lengths in arm reaches."""
        return self._size(self._outcome.errors)

    def _size(self, errors: np.ndarray) -> np.ndarray:
        """Return the norms (K,) of errors (K, m) of the first priority level, with lengths in arm reaches."""
        by = self._outcome.by
        parts = errors.reshape(len(errors), -1, 2, 3) * by.firm[:, :, None] * [[1.0 / by.robot.reach], [1.0]]
        return np.linalg.norm(parts.reshape(len(errors), -1), axis=1)

    def _swerve(self) -> float:
        """Return the difference between the target's motion and the one predicted by its twist, which no method can foresee."""
        _, T, V, _ = samples_of(self._outcome.samples)
        turns = [log(after[:3, :3] @ before[:3, :3].T) for before, after in zip(*T, strict=True)]
        turns = np.array(turns) * np.array(self._outcome.by.posed)[:, None]
        moved = np.concatenate([T[1, :, :3, 3] - T[0, :, :3, 3], turns], axis=1)
        return float(self._size(moved.reshape(1, -1) - V[:1] * self._outcome.dt)[0])

    def _away(self, *, every: bool = False) -> bool:
        """Return whether the remaining error of the first priority level (or of every) exceeds JUDGE.position or JUDGE.angle."""
        by = self._outcome.by
        left = np.linalg.norm(self._outcome.errors[1].reshape(-1, 2, 3), axis=2) * np.maximum(by.firm, every)
        return bool(left[:, 0].max() > JUDGE.position or (left[:, 1] * by.posed).max() > JUDGE.angle)

    @property
    def reason(self) -> str:
        """A sentence that says why the status is not OK, or for OK that an error is still left; '' if there is nothing to say."""
        o, status = self._outcome, self.status
        if status is StepStatus.OK:
            before, after = self._sizes()
            how = "the target and coming nearer" if after < before else "a target that moves otherwise than foreseen"
            return f"{self._left()} from {how}" if self._away() else ""
        parts, unread = [], "" if o.lag < math.inf else "the measured joints are not finite"
        if o.resynced:
            parts.append("the measured joints were too far from the commanded ones: restarted from the measurement")
        elif status is StepStatus.JUMPED:
            i = int(np.argmax(self._moved()))
            move = self.q[i] - o.before[i] * o.by.robot.chain.unit[i]
            parts.append(f"joint {o.by.robot.joint_names[i]} moved {move:.3g} in one step")
        if status is StepStatus.HELD:
            doubt = unread or "the measured joints leap about, or are outside their limits"
            doubted = o.lag > 1.0 and not o.resynced
            what = "the target is not finite" if not o.finite else doubt if doubted else "the step is not finite"
            return "; ".join([*parts, f"{what}: braking and holding"])
        if o.lag > 0.5 and not o.resynced:  # said whatever the status: a move to another posture goes before it
            parts.append(unread or "the measured joints are far from the commanded ones")
        if self.position_error > FAR_AWAY * o.by.robot.reach:
            parts.append("were millimetres meant?")
        if status is StepStatus.AT_LIMIT:
            limited = not o.lost and o.code.any()
            parts.append(f"about as close as {'the limits allow' if limited else 'the arm reaches from here'}")
        elif status is StepStatus.LIMITED and o.way is None and not o.code.any():
            before, after = self._sizes()
            slowly = after < (1.0 - JUDGE.still) * before
            how = "coming nearer, but slowly" if slowly else "the tip can hardly get nearer to its target from here"
            parts.append(f"{self._left()} away: {how}")
        if o.way is not None:
            parts.append(o.way.words)
        words = (
            (BIT.recovering, "outside its limits, moving back:"),
            (BIT.position, "position limit on"),
            (BIT.velocity, "speed limit on"),
            (BIT.acceleration, "acceleration limit on"),
            (BIT.calmed, "kept from swinging or overshooting:"),
            (BIT.row, f"{' and '.join(o.between)} would touch: slowing" if o.between else "an obstacle slows"),
        )
        for bit, name in words:
            held = [j for j, c in zip(o.by.robot.joint_names, o.code, strict=True) if c & bit]
            if held:
                parts.append(f"{name} {', '.join(held)}")
        return "; ".join(parts)

    def _left(self) -> str:
        """Return the errors left in words."""
        turned = self.orientation_error
        return length(self.position_error) + (f", {angle(turned)}" if turned else "")

    def __repr__(self) -> str:
        """Return a line with status, position error and reason."""
        reason = self.reason
        return f"Step({self.status.name}, {self.position_error:.3g} m{', ' + reason if reason else ''})"
