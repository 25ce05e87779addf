"""Targets as they arrive in a control loop: read, checked, with the motion from one to the next, and whether they stand."""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from ..compile.array_view import flat, view
from ..compile.jit import cached, inline, inner
from ..copying import CopiesViews
from ..errors import InvalidTarget, floats
from ..kernel.algebra import M3, V3, put3
from ..kernel.checks import rigid
from ..kernel.counted_error import POSE, POSITION
from ..kernel.kinematics import angle_ratio, rotation_error
from ..kernel.records import copy
from ..motion.reference import exp, log
from ..robot.pose import AxisTarget, as_array
from ..solvers.task import read_one, read_target
from .workspace import Samples, new_samples, samples_of

TIGHT = 1e-9  # of a rotation accepted as it is: far stricter than the full check, outside the kernel, which corrects or refuses
READ, CHECK, REFUSED = range(3)  # a target that was read in full, one that is to be checked here, one that is no target
TAKEN, DOUBTFUL, HELD = range(3)  # taken; to be read in full; not finite, so the last target stays
STILL = 2e-3  # [m, or of a rotation] by which a target that stands may move in WAIT: 20 mm/s, or 0.014 rad/s
WAIT = 0.1  # [s]
RESTS = 5e-4  # [m/s, or of a rotation] up to which it is at rest: where its motion turns back it is that slow for a moment only
JUMP = 0.05  # [m, or of a rotation] from one target to the next by which it leaps: a fast hand moves by a fifth of it


class Stand(NamedTuple):
    """Whether a target stands. Before its first motion it counts as having leapt."""

    seconds: int  # [s] for which it has been where it is, give or take STILL
    leapt: int  # 1: it came there at once
    still: int  # 1: it hardly moved from the last sample to this one, or only trembles as measured targets do
    rest: int  # [s] for which it has been at rest; one that trembles, as measured ones do, never is
    known: int  # 1: what follows is known, F poses: where it is


STAND = Stand._make(range(len(Stand._fields)))  # places in the array


@inner
def finite(A):
    """Whether all numbers of A (K,) are."""
    total = 0.0
    for k in range(A.shape[0]):
        total += abs(A[k])
    return total < math.inf


@inline
def axes_of(T):
    """Axes of a pose (4, 4)."""
    return M3(V3(T[0, 0], T[1, 0], T[2, 0]), V3(T[0, 1], T[1, 1], T[2, 1]), V3(T[0, 2], T[1, 2], T[2, 2]))


@inner
def turn_left(T0, T1):
    """Rotation vector, in base axes, that brings the rotation of T0 (4, 4) to that of T1."""
    angular = rotation_error(axes_of(T0), axes_of(T1))
    return angular * angle_ratio(angular.square())


@inner
def replace(T, V, A, source, place):
    """One sample becomes another."""
    copy(flat(T[source]), flat(T[place]))
    copy(V[source], V[place])
    copy(A[source], A[place])


@inner
def difference(T0, T1, dt, V, first):
    """Twist from one pose to another in dt, to V[first:]; of no turn it is exactly zero."""
    put3(V, first, V3(T1[0, 3] - T0[0, 3], T1[1, 3] - T0[1, 3], T1[2, 3] - T0[2, 3]) * (1.0 / dt))
    turned = False
    for r in range(3):
        for c in range(3):
            turned = turned or T0[r, c] != T1[r, c]
    put3(V, first + 3, turn_left(T0, T1) * (1.0 / dt) if turned else V3(0.0, 0.0, 0.0))


@inner
def gap(A, B, first):
    """How far numbers A (K,) are from those of B from `first` on, as one number."""
    total = 0.0
    for k in range(A.shape[0]):
        total += (A[k] - B[first + k]) ** 2
    return math.sqrt(total)


@inner
def look(T, stand, dt):
    """See whether targets T (2, F, 4, 4), dt [s] apart, stand; stand (5 + 16 F,) as of `Stand`."""
    at, first, now = STAND, len(STAND), flat(T[1])
    moved, most = gap(now, flat(T[0]), 0), STILL * dt / WAIT
    if stand[at.known] == 0.0 or moved > JUMP or gap(now, stand, first) > STILL:
        stand[at.leapt] = 1.0 if moved > JUMP or (stand[at.leapt] != 0.0 and moved <= most) else 0.0
        stand[at.seconds], stand[at.known] = 0.0, 1.0
        for k in range(now.shape[0]):
            stand[first + k] = now[k]
    else:
        stand[at.seconds] += dt
    stand[at.rest] = stand[at.rest] + dt if moved <= RESTS * dt else 0.0
    stand[at.still] = 1.0 if moved <= most or stand[at.seconds] >= WAIT else 0.0


@cached
def arrive(samples, given, stand, slot, how, posed, first, moved, twist, acceleration, dt):
    """Write the target of `given`, samples of length 1, into the last sample (slot 0) or the next (1) of `samples`.

    Blocks as of workspace.py; stand (5 + 16 F,) as of `Stand`, of the next. how: READ, CHECK or REFUSED; posed: bit f says that
    tip f has an orientation. first: any target may have come before; moved: the next target has become the last one; twist,
    acceleration: whether they are given, else the last two targets give a twist, in dt [s], and the acceleration is 0. Returns
    TAKEN, DOUBTFUL or HELD.
    """
    (_, T, V, A), (_, Ts, Vs, As) = samples_of(view(samples)), samples_of(view(given))
    if moved:
        replace(T, V, A, 1, 0)
    held = how == REFUSED or (twist and not finite(Vs[0])) or (acceleration and not finite(As[0]))
    for f in range(T.shape[1]):
        if not abs(Ts[0, f, 0, 3]) + abs(Ts[0, f, 1, 3]) + abs(Ts[0, f, 2, 3]) < math.inf:
            held = True
        elif how == CHECK and (posed >> f) & 1 and not rigid(Ts[0, f], TIGHT):
            return DOUBTFUL
    if held:
        copy(flat(T[0]), flat(T[1]))
        for k in range(V.shape[1]):
            V[1, k] = A[1, k] = 0.0
        return HELD
    for f in range(T.shape[1]):
        for r in range(4):
            for c in range(0 if (posed >> f) & 1 else 3, 4):
                T[slot, f, r, c] = Ts[0, f, r, c]
    if first and slot == 1:
        copy(flat(T[1]), flat(T[0]))
    for k in range(V.shape[1]):
        V[slot, k] = Vs[0, k] if twist else 0.0
        A[slot, k] = As[0, k] if acceleration else 0.0
    if slot == 1 and not twist:
        for f in range(T.shape[1]):
            difference(T[0, f], T[1, f], dt, V[1], 6 * f)
    if first and slot == 1:
        copy(V[1], V[0])
        copy(A[1], A[0])
    if slot == 1:
        look(T, stand, dt)
    return TAKEN


FLOAT = np.dtype(np.float64)
RECENT = 10  # targets: where steps take 0.5 to 1.5 times their mean, ca brings errors to 0.59 a step, with gains of each to 0.99
KIND = {(4, 4): POSE, (3,): POSITION}  # of an array, by its shape


class Stream(CopiesViews):
    """The last target and the next, `samples`; whether that stands, `stand`; kinds, one a tip.

    pace: the longest of the last times between them [s]; unseen [s]: since a step to them was last looked at, by the tracker.
    """

    VIEWS = ("_poses",)
    SHARED = ("robot",)

    def __init__(self, robot: Any) -> None:
        """Room for the tips of a robot."""
        self.robot = robot
        self.tips = len(robot.tips)
        self.kinds: tuple | None = None
        self.samples, self._given, self._last = (new_samples(count, self.tips) for count in (2, 1, 1))
        for one in (self.samples, self._given, self._last):
            one.T[:] = np.eye(4)
        self.stand = np.zeros(len(STAND) + 16 * self.tips)  # see `arrival.Stand`
        self._cut()
        self.unseen = 0.0
        self._posed = 0  # bit f: tip f has an orientation
        self._moved = 0
        self.pace, self._second, self._count = 0.0, 0.0, 0  # [s], the longest since that one, targets since it

    def _cut(self) -> None:
        """Take the views of a target that is given."""
        self._poses = list(self._given.T[0])

    def forget(self) -> None:
        """Any target may come next."""
        self.kinds = None
        self.pace = 0.0

    def look_anew(self) -> None:
        """Where the target stands is not known: when it does, it counts as having leapt there."""
        self.stand[:] = 0.0
        self.stand[STAND.leapt] = 1.0
        self.unseen = 0.0

    def take(self, slot: int, target: Any, twist: Any, acceleration: Any, dt: float = 0.0) -> bool:
        """Write a target into sample 0 (now) or 1 (end of step); False when it is not finite (the last one is kept)."""
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
        if done == DOUBTFUL:
            kinds, how = self._read_in_full(target)
            done = self._arrive(slot, kinds, how, twist is not None, acceleration is not None, dt)
        return done == TAKEN

    def _keep_pace(self, dt: float) -> None:
        """Forget the longest time between targets after a while."""
        self._second, self._count = max(self._second, dt), self._count + 1
        if self._count >= RECENT:
            self.pace, self._second, self._count = self._second, 0.0, 0

    def step_on(self) -> None:
        """The next target becomes the last one (when the one after it arrives)."""
        self._moved = 1

    def divided(self, parts: int) -> list[Samples]:
        """The motion from the last target to the next in equal parts."""
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

    def last_of(self, samples: Samples) -> Samples:
        """The last of some samples alone; it holds until the next call."""
        last = self._last
        last.T[0], last.V[0], last.A[0] = samples.T[-1], samples.V[-1], samples.A[-1]
        return last

    def _arrive(self, slot: int, kinds: tuple | None, how: int, twist: bool, acceleration: bool, dt: float) -> int:
        """Hand a target that was read, or is to be checked, to the kernel."""
        first = self.kinds is None
        if kinds is not None and not first and kinds != self.kinds:
            raise InvalidTarget(
                "a tracker takes targets of one kind, poses or positions, from the first on; `reset` begins anew"
            )
        if first and kinds is not None:
            self._posed = sum(1 << f for f, kind in enumerate(kinds) if kind != POSITION)
        done = arrive(
            self.samples.block, self._given.block, self.stand, slot, how, self._posed, first, self._moved, twist, acceleration,
            dt,
        )  # fmt: skip
        self._moved = 0
        if done == TAKEN:
            self.kinds = kinds
        return done

    def _as_it_is(self, target: Any) -> tuple[tuple | None, int] | None:
        """Copy a target that is made of arrays, and leave its check to the kernel; None where that cannot be done."""
        if not self.robot.by_tip:
            kind = self._copy(0, target)
            return None if kind is None else ((kind,), CHECK)
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
        return self.kinds, CHECK

    def _copy(self, f: int, target: Any) -> int | None:
        """Copy the numbers of a tip's target; returns its kind, None where it has to be read in full."""
        raw = target if type(target) is np.ndarray else getattr(target, "homogeneous", None)
        if type(raw) is not np.ndarray or raw.dtype is not FLOAT:
            return None
        kind = KIND.get(raw.shape)
        if kind == POSE:
            self._poses[f][...] = raw
        elif kind == POSITION:
            self._poses[f][:3, 3] = raw
        return kind

    def _read_in_full(self, target: Any) -> tuple[tuple | None, int]:
        """Read and correct a target; no kinds where a number is not finite. Raises InvalidTarget."""
        T, kinds = self._read(target)
        if T is None:
            return None, REFUSED
        self._given.T[0] = T
        return kinds, READ

    def _read(self, target: Any) -> tuple[np.ndarray | None, tuple | None]:
        """Poses (F, 4, 4) and kinds; no kinds where a number is not finite. Raises InvalidTarget."""
        if self.robot.by_tip:
            values = target.values() if isinstance(target, Mapping) else target
            several = isinstance(target, Mapping | list | tuple | np.ndarray)
            if several and not all(_finite(one) for one in values if one is not None):
                return None, None
            T, kinds, _ = read_target(self.robot, target)
            return T.reshape(self.tips, 4, 4), kinds
        if isinstance(target, AxisTarget):
            return target.T_base_tip[None], ((read_one(target)[1]),)
        raw = floats(as_array(target, self.robot.base), "a tracker takes a 4x4 pose or a position", InvalidTarget)
        if raw.shape not in ((3,), (4, 4)):
            raise InvalidTarget(f"a tracker takes a 4x4 pose or a position of 3 numbers, not shape {raw.shape}")
        if not np.isfinite(raw).all():
            return None, None
        T, kind, _ = read_one(raw)
        return T[None], (kind,)

    def _motion(self, value: Any, name: str) -> np.ndarray:
        """A twist or acceleration (m,), its angular part 0 where it is left out."""
        if isinstance(value, Mapping):
            self.robot.check_tips(value)
            value = np.concatenate(
                [self._of_tip(value.get(tip, np.zeros(6)), f"{name} of {tip}") for tip in self.robot.tips]
            )
        wanted = f"{name} must have 6 values" if self.tips == 1 else f"{name} must have 6 values for each tip"
        array = floats(value, wanted, InvalidTarget).reshape(-1)
        if array.shape == (3,) and self.tips == 1 and self.kinds != (POSE,):
            return np.concatenate([array, np.zeros(3)])
        if array.shape != (6 * self.tips,):
            raise InvalidTarget(f"{wanted}, not shape {np.shape(value)}")
        return array

    def _of_tip(self, value: Any, name: str) -> np.ndarray:
        """A twist or acceleration (6,) of one tip, its angular part 0 where it is left out."""
        array = floats(value, f"{name} must have 6 values, or 3", InvalidTarget)
        if array.shape not in ((3,), (6,)):
            raise InvalidTarget(f"{name} must have 6 values, or 3, not shape {array.shape}")
        return np.concatenate([array, np.zeros(6 - len(array))])


def _finite(one: Any) -> bool:
    """Whether all numbers of a tip's target are finite; anything that is not a target is left to its reader."""
    try:
        return bool(np.isfinite(np.asarray(getattr(one, "T_base_tip", as_array(one)), dtype=float)).all())
    except (TypeError, ValueError):
        return True


def samples_from(T: np.ndarray, V: np.ndarray, A: np.ndarray) -> Samples:
    """Samples of targets T (N, F, 4, 4), V, A (N, m)."""
    made = new_samples(*T.shape[:2])
    made.T[:], made.V[:], made.A[:] = T, V, A
    return made
