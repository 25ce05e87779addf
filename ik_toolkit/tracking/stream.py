"""Targets as they arrive in a control loop: read, checked, with the motion between two of them."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..copying import Blocks
from ..errors import InvalidTarget, floats
from ..kernel.arrival import CHECK, DOUBTFUL, READ, REFUSED, STAND, TAKEN, arrive
from ..kernel.session import Samples, new_samples
from ..kernel.task import POSE, POSITION
from ..robot.pose import AxisTarget
from ..solvers.task import read_one, read_target
from .reference import exp, log

FLOAT = np.dtype(np.float64)
RECENT = 10  # targets: where steps take 0.5 to 1.5 times their mean, ca brings errors to 0.59 a step, with gains of each to 0.99
KIND = {(4, 4): POSE, (3,): POSITION}  # of an array, by its shape


class Stream(Blocks):
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
            one.T[:], one.caps[0], one.caps[1] = np.eye(4), 1.0, -1.0
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
        raw = floats(getattr(target, "homogeneous", target), "a tracker takes a 4x4 pose or a position", InvalidTarget)
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
        return bool(
            np.isfinite(np.asarray(getattr(one, "homogeneous", getattr(one, "T_base_tip", one)), dtype=float)).all()
        )
    except (TypeError, ValueError):
        return True


def samples_from(T: np.ndarray, V: np.ndarray, A: np.ndarray) -> Samples:
    """Samples of targets T (N, F, 4, 4), V, A (N, m), at which the clock may run as fast as time."""
    made = new_samples(*T.shape[:2])
    made.T[:], made.V[:], made.A[:], made.caps[0], made.caps[1] = T, V, A, 1.0, -1.0
    return made
