"""Targets as they arrive in a control loop: how they are read and checked, how they move, and whether they stand still."""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from ..compile.array_view import flat, view
from ..compile.jit import cached_small, compiled, inline, inner
from ..copying import CopiesViews
from ..errors import InvalidTarget, floats
from ..kernel.algebra import M3, V3, put3
from ..kernel.checks import rigid
from ..kernel.counted_error import KIND
from ..kernel.kinematics import angle_ratio, rotation_error
from ..kernel.records import copy
from ..kernel.vectors import clear
from ..motion.reference import exp, log
from ..robot.pose import AxisTarget, as_array
from ..robot.ros import is_by_name
from ..solvers.batch.targets import SHAPES
from ..solvers.task import read_one, read_target
from ..validate import FLOAT
from .workspace import Samples, new_samples, samples_from, samples_of


class TargetCodes(NamedTuple):
    """Codes for how far a new target has been checked (an argument of `arrive`) and whether it is accepted (its result)."""

    fine: int = 0  # as argument: the target has been checked; as result: it is accepted
    doubtful: int = 1  # as argument: the target has not been checked; as result: Python has to check it in full
    refused: int = 2  # the target is not finite, so the last one is kept


@compiled
class ArrivalThresholds(NamedTuple):
    """Thresholds by which targets are accepted, and their motion is judged."""

    # Rotation matrices whose entries err by less are accepted at once; the full check corrects or refuses others.
    tight: float = 1e-9
    # [m/s, or rotation matrix entries per s] A target slower than this is at rest, if it is so for a while: a target that reverses
    # is slow only briefly.
    rests: float = 5e-4
    # [m, or rotation matrix entries] A larger change from one target to the next is a jump; a fast hand moves a fifth of it.
    jump: float = 0.05
    # Number of targets over which the longest step is remembered; gains are chosen for this step. If steps vary from 0.5 to 1.5
    # times their mean, method ca then reduces an error to 0.59 of it in each step, with gains for each step only to 0.99.
    recent: int = 10
    # [m, or rotation matrix entries] largest change of a stationary target in the time `wait`: 20 mm/s, or 0.014 rad/s; set by hand
    still: float = 2e-3
    # [s] A target stands still if it has moved by no more than `still` within this time; set by hand.
    wait: float = 0.1


GIVEN, ARRIVAL = TargetCodes(), ArrivalThresholds()


class RestState(NamedTuple):
    """Names for the entries of an array that says whether a target stands still; STAND.seconds etc. are the indices.

    Before its first motion a target counts as having jumped.
    """

    seconds: int  # [s] time for which the target has stood still, to within ARRIVAL.still
    jumped: int  # 1: the target jumped to the pose at which it now stands still
    still: int  # 1: the target hardly moved since the last sample, or only trembles as measured targets do
    rest: int  # [s] time for which the target has been at rest; a trembling target never is
    known: int  # 1: the entries after this one hold the F poses at which the target stands still


STAND = RestState._make(range(len(RestState._fields)))


@inner
def finite(A):
    """Return whether all numbers of A (K,) are finite."""
    total = 0.0
    for k in range(A.shape[0]):
        total += abs(A[k])
    return total < math.inf


@inline
def axes_of(T):
    """Return the rotation of a pose (4, 4) as an M3, a record of nine numbers, which compiled code handles faster than an array."""
    return M3(V3(T[0, 0], T[1, 0], T[2, 0]), V3(T[0, 1], T[1, 1], T[2, 1]), V3(T[0, 2], T[1, 2], T[2, 2]))


@inner
def turn_left(T0, T1):
    """Return the rotation vector, in base axes, from the rotation of T0 (4, 4) to that of T1."""
    angular = rotation_error(axes_of(T0), axes_of(T1))
    return angular * angle_ratio(angular.square())


@inner
def replace(T, V, A, source, place):
    """Copy poses T, twists V and accelerations A (rows: samples) from row `source` to row `place`."""
    copy(flat(T[source]), flat(T[place]))
    copy(V[source], V[place])
    copy(A[source], A[place])


@inner
def difference(T0, T1, dt, V, first):
    """Write to V[first:] the twist that moves pose T0 to T1 (4, 4) in dt [s].

    If the rotations are equal, its angular part is exactly zero.
    """
    put3(V, first, V3(T1[0, 3] - T0[0, 3], T1[1, 3] - T0[1, 3], T1[2, 3] - T0[2, 3]) * (1.0 / dt))
    turned = False
    for r in range(3):
        for c in range(3):
            turned = turned or T0[r, c] != T1[r, c]
    put3(V, first + 3, turn_left(T0, T1) * (1.0 / dt) if turned else V3(0.0, 0.0, 0.0))


@inner
def distance_between(A, B, first):
    """Return the Euclidean distance between the numbers A (K,) and as many of B, from index `first` on."""
    total = 0.0
    for k in range(A.shape[0]):
        total += (A[k] - B[first + k]) ** 2
    return math.sqrt(total)


@inner
def look(T, stand, dt):
    """Update `stand` (5 + 16 F,), which says whether the target stands still (`RestState`), after a new target.

    T (2, F, 4, 4): the last two targets, dt [s] apart.
    """
    at, first, now = STAND, len(STAND), flat(T[1])
    moved, most = distance_between(now, flat(T[0]), 0), ARRIVAL.still * dt / ARRIVAL.wait
    if stand[at.known] == 0.0 or moved > ARRIVAL.jump or distance_between(now, stand, first) > ARRIVAL.still:
        stand[at.jumped] = 1.0 if moved > ARRIVAL.jump or (stand[at.jumped] != 0.0 and moved <= most) else 0.0
        stand[at.seconds], stand[at.known] = 0.0, 1.0
        for k in range(now.shape[0]):
            stand[first + k] = now[k]
    else:
        stand[at.seconds] += dt
    stand[at.rest] = stand[at.rest] + dt if moved <= ARRIVAL.rests * dt else 0.0
    stand[at.still] = 1.0 if moved <= most or stand[at.seconds] >= ARRIVAL.wait else 0.0


@cached_small
def arrive(samples, given, stand, slot, how, posed, first, moved, twist, acceleration, dt):
    """Write a new target into sample `slot` of `samples`: 0 is the last target, 1 the next one.

    samples, given: arrays that hold the fields of Samples, of two targets and of the new one; stand (5 + 16 F,): see `RestState`;
    how: what is known of the target, a number of `TargetCodes`. posed: bit f is set if tip f has an orientation. first: whether
    there was no target before. moved: whether the former next target becomes the last one. twist, acceleration: whether they are
    given; if not, the twist follows from the last two targets, dt [s] apart, and the acceleration is 0. Returns a number of
    `TargetCodes`, too; after GIVEN.doubtful the caller must check the target in full and call again.
    """
    (_, T, V, A), (_, Ts, Vs, As) = samples_of(view(samples)), samples_of(view(given))
    if moved:
        replace(T, V, A, 1, 0)
    held = how == GIVEN.refused or (twist and not finite(Vs[0])) or (acceleration and not finite(As[0]))
    for f in range(T.shape[1]):
        if not abs(Ts[0, f, 0, 3]) + abs(Ts[0, f, 1, 3]) + abs(Ts[0, f, 2, 3]) < math.inf:
            held = True
        elif how == GIVEN.doubtful and (posed >> f) & 1 and not rigid(Ts[0, f], ARRIVAL.tight):
            return GIVEN.doubtful
    if held:
        copy(flat(T[0]), flat(T[1]))
        clear(V[1])
        clear(A[1])
        return GIVEN.refused
    for f in range(T.shape[1]):
        for r in range(4):
            for c in range(0 if (posed >> f) & 1 else 3, 4):
                T[slot, f, r, c] = Ts[0, f, r, c]
    for k in range(V.shape[1]):
        V[slot, k] = Vs[0, k] if twist else 0.0
        A[slot, k] = As[0, k] if acceleration else 0.0
    if slot == 1:
        if first:
            replace(T, V, A, 1, 0)
        for f in range(0 if twist else T.shape[1]):
            difference(T[0, f], T[1, f], dt, V[1], 6 * f)
        look(T, stand, dt)
    return GIVEN.fine


class Stream(CopiesViews):
    """The targets of a tracker: the last and the next one (`samples`), and whether the next one stands still (`stand`).

    kinds: kind of target of each tip, None before the first target. pace [s]: the longest recent time between targets.
    unseen [s]: time since the tracker last examined a step.
    """

    VIEWS = ("_poses",)
    SHARED = ("robot",)

    def __init__(self, robot: Any) -> None:
        """Make room for the targets of a robot's tips."""
        self.robot = robot
        self.tips = len(robot.tips)
        self.kinds: tuple | None = None
        self.samples, self._given = (new_samples(count, self.tips) for count in (2, 1))
        for one in (self.samples, self._given):
            one.T[:] = np.eye(4)
        self.stand = np.zeros(len(STAND) + 16 * self.tips)  # whether and where the target stands still, see `RestState`
        self._cut()
        self.unseen = 0.0
        self._posed = 0  # Bit f says that tip f has an orientation.
        self._moved = 0
        # the longest recent time between two targets [s]; of the targets since then, the longest time [s] and their number
        self.pace, self._second, self._count = 0.0, 0.0, 0

    def _cut(self) -> None:
        """Make views of the poses that a new target is copied to."""
        self._poses = list(self._given.T[0])

    def forget(self) -> None:
        """Forget the targets; the next one may be of any kind."""
        self.kinds = None
        self.pace = 0.0

    def look_anew(self) -> None:
        """Forget whether the target stands still; when it next does, it counts as having jumped there."""
        self.stand[:] = 0.0
        self.stand[STAND.jumped] = 1.0
        self.unseen = 0.0

    def take(self, slot: int, target: Any, twist: Any, acceleration: Any, dt: float = 0.0) -> bool:
        """Read a target and write it to sample `slot`: 0 (now) or 1 (end of the step); return whether it is finite.

        If it is not finite, the last target is kept. twist, acceleration: as in `Tracker.update`; dt [s]: time since the last
        target. Raises InvalidTarget.
        """
        if dt >= self.pace:
            self.pace, self._second, self._count = dt, 0.0, 0
        elif slot:
            self._keep_pace(dt)
        kinds, how = self._as_it_is(target) or self._read_in_full(target)
        if twist is not None:
            self._given.V[0] = self._motion(twist, "twist")
        if acceleration is not None:
            self._given.A[0] = self._motion(acceleration, "acceleration")
        done = self._arrive(slot, kinds, how, twist is not None, acceleration is not None, dt)
        if done == GIVEN.doubtful:
            kinds, how = self._read_in_full(target)
            done = self._arrive(slot, kinds, how, twist is not None, acceleration is not None, dt)
        return done == GIVEN.fine

    def _keep_pace(self, dt: float) -> None:
        """Forget the longest time between targets after ARRIVAL.recent shorter ones; the longest of these replaces it."""
        self._second, self._count = max(self._second, dt), self._count + 1
        if self._count >= ARRIVAL.recent:
            self.pace, self._second, self._count = self._second, 0.0, 0

    def step_on(self) -> None:
        """Note that a step was taken to the next target; it becomes the last target when another one arrives."""
        self._moved = 1

    def divided(self, parts: int) -> list[Samples]:
        """Return the motion from the last target to the next in equal parts, each as Samples of its two ends."""
        f = np.linspace(0.0, 1.0, parts + 1)
        ends = self.samples
        T = np.repeat(ends.T[:1], parts + 1, axis=0)
        for k in range(self.tips):
            T[:, k, :3, 3] += f[:, None] * (ends.T[1, k, :3, 3] - ends.T[0, k, :3, 3])
            turn = log(ends.T[1, k, :3, :3] @ ends.T[0, k, :3, :3].T)
            T[:, k, :3, :3] = exp(f[:, None] * turn) @ ends.T[0, k, :3, :3]
        T[-1] = ends.T[1]
        V, A = (one[0] + f[:, None] * (one[1] - one[0]) for one in (ends.V, ends.A))
        return [samples_from(T[k : k + 2], V[k : k + 2], A[k : k + 2]) for k in range(parts)]

    def _arrive(self, slot: int, kinds: tuple | None, how: int, twist: bool, acceleration: bool, dt: float) -> int:
        """Pass a target to the compiled `arrive`; return a number of `TargetCodes`.

        Raises InvalidTarget if the kind of target has changed.
        """
        first = self.kinds is None
        if kinds is not None and not first and kinds != self.kinds:
            raise InvalidTarget(
                "a tracker takes targets of one kind, poses or positions, from the first on; `reset` begins anew"
            )
        if first and kinds is not None:
            self._posed = sum(1 << f for f, kind in enumerate(kinds) if kind != KIND.position)
        done = arrive(
            self.samples.block, self._given.block, self.stand, slot, how, self._posed, first, self._moved, twist, acceleration,
            dt,
        )  # fmt: skip
        self._moved = 0
        if done == GIVEN.fine:
            self.kinds = kinds
        return done

    def _as_it_is(self, target: Any) -> tuple[tuple | None, int] | None:
        """Copy a target given as arrays; return its kinds and GIVEN.doubtful (not yet checked), or None if it has another form."""
        if not self.robot.by_tip:
            kinds = (self._copy(0, target),)
            return None if kinds[0] is None or self.kinds not in (None, kinds) else (kinds, GIVEN.doubtful)
        if self.kinds is None:
            return None
        if isinstance(target, Mapping):
            if target.keys() != set(self.robot.tips):
                return None
            target = [target[tip] for tip in self.robot.tips]
        elif not isinstance(target, list | tuple | np.ndarray) or len(target) != self.tips:
            return None
        for f, one in enumerate(target):
            if self._copy(f, one) != self.kinds[f]:
                return None
        return self.kinds, GIVEN.doubtful

    def _copy(self, f: int, target: Any) -> int | None:
        """Copy the array of tip f's target; return its kind (KIND.pose or KIND.position), or None if it is no such array."""
        raw = target if type(target) is np.ndarray else getattr(target, "homogeneous", None)
        if type(raw) is not np.ndarray or raw.dtype is not FLOAT:
            return None
        kind = SHAPES.get(raw.shape)
        if kind == KIND.pose:
            self._poses[f][...] = raw
        elif kind == KIND.position:
            self._poses[f][:3, 3] = raw
        return kind

    def _read_in_full(self, target: Any) -> tuple[tuple | None, int]:
        """Check and correct a target of any form; return its kinds and GIVEN.fine, or None and GIVEN.refused if it is not finite.

        Raises InvalidTarget.
        """
        if self.robot.by_tip or is_by_name(target):
            values = target.values() if isinstance(target, Mapping) else target
            several = isinstance(target, Mapping | list | tuple | np.ndarray)
            if several and not all(_finite(one) for one in values if one is not None):
                return None, GIVEN.refused
            T, kinds, _ = read_target(self.robot, target)
        elif isinstance(target, AxisTarget):
            T, kinds = target.T_base_tip, (read_one(target)[1],)
        else:
            wanted = "a tracker takes a 4x4 pose or a position"
            raw = floats(as_array(target, self.robot.base), f"{wanted}, of NaN where there is none", InvalidTarget)
            if raw.shape not in ((3,), (4, 4)):
                raise InvalidTarget(f"{wanted} of 3 numbers, not shape {raw.shape}")
            if not np.isfinite(raw).all():
                return None, GIVEN.refused
            T, kind, _ = read_one(raw)
            kinds = (kind,)
        self._given.T[0] = T.reshape(self.tips, 4, 4)
        return kinds, GIVEN.fine

    def _motion(self, value: Any, name: str) -> np.ndarray:
        """Return a twist or acceleration as (m,), with zeros for angular parts that are left out.

        Raises InvalidTarget.
        """
        if isinstance(value, Mapping):
            self.robot.check_tips(value)
            value = np.concatenate(
                [self._of_tip(value.get(tip, np.zeros(6)), f"{name} of {tip}") for tip in self.robot.tips]
            )
        wanted = f"{name} must have 6 values" if self.tips == 1 else f"{name} must have 6 values for each tip"
        array = floats(value, wanted, InvalidTarget).reshape(-1)
        if array.shape == (3,) and self.tips == 1 and self.kinds != (KIND.pose,):
            return np.concatenate([array, np.zeros(3)])
        if array.shape != (6 * self.tips,):
            raise InvalidTarget(f"{wanted}, not shape {np.shape(value)}")
        return array

    def _of_tip(self, value: Any, name: str) -> np.ndarray:
        """Return a twist or acceleration of one tip as (6,), with a zero angular part if it is left out.

        Raises InvalidTarget.
        """
        array = floats(value, f"{name} must have 6 values, or 3", InvalidTarget)
        if array.shape not in ((3,), (6,)):
            raise InvalidTarget(f"{name} must have 6 values, or 3, not shape {array.shape}")
        return np.concatenate([array, np.zeros(6 - len(array))])


def _finite(one: Any) -> bool:
    """Return whether all numbers of a tip's target are finite; True if it is not a target at all, which is refused later."""
    try:
        return bool(np.isfinite(np.asarray(getattr(one, "T_base_tip", as_array(one)), dtype=float)).all())
    except (TypeError, ValueError):
        return True
