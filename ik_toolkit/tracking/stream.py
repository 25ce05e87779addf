"""Targets as they arrive in a control loop: read, checked, with the motion between two of them."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from ..errors import InvalidTarget, floats
from ..kernel.task import POSE, POSITION
from ..robot.pose import AxisTarget
from ..solvers.task import read_one, read_target
from .reference import exp, log

FLOAT = np.dtype(np.float64)
TIGHT = 1e-9  # of a rotation accepted as it is: far stricter than the check of a target
HALF_TURN = -1.9  # twice the cosine of 2.8 rad


class Stream:
    """The last target and the next: T (2, F, 4, 4), V and A (2, m) twist and acceleration, base axes; kinds, one a tip."""

    def __init__(self, robot: Any) -> None:
        """Room for the tips of a robot."""
        self.robot = robot
        self.tips = len(robot.tips)
        self.kinds: tuple | None = None
        self.T = np.zeros((2, self.tips, 4, 4))
        self.T[:] = np.eye(4)
        self.V, self.A = np.zeros((2, 6 * self.tips)), np.zeros((2, 6 * self.tips))

    def forget(self) -> None:
        """Any target may come next."""
        self.kinds = None

    def take(self, slot: int, target: Any, twist: Any, acceleration: Any, dt: float = 0.0) -> bool:
        """Write a target into slot 0 (now) or 1 (end of step); False when it is not finite (the last one is kept)."""
        first = self.kinds is None
        T, V, A = self.T, self.V, self.A
        raw = target if type(target) is np.ndarray else getattr(target, "homogeneous", target)
        plain = type(raw) is np.ndarray and raw.dtype is FLOAT
        if plain and raw.shape == (4, 4) and self.tips == 1 and self.kinds in (None, (POSE,)) and rigid(raw):
            pose, kinds = raw, (POSE,)
        elif (
            plain
            and raw.shape == (3,)
            and self.tips == 1
            and self.kinds in (None, (POSITION,))
            and np.isfinite(raw).all()
        ):
            pose, kinds = None, (POSITION,)
        else:
            pose, kinds = self._read(target)
        v = None if twist is None else self._motion(twist, "twist")
        a = None if acceleration is None else self._motion(acceleration, "acceleration")
        if kinds is not None and self.kinds not in (None, kinds):
            raise InvalidTarget(
                "a tracker takes targets of one kind, poses or positions, from the first on; `reset` begins anew"
            )
        if (
            kinds is None
            or (v is not None and not np.isfinite(v).all())
            or (a is not None and not np.isfinite(a).all())
        ):
            V[1], A[1] = 0.0, 0.0
            T[1] = T[0]
            return False
        self.kinds = kinds
        if pose is None:
            T[slot, 0, :3, 3] = raw
        else:
            T[slot] = pose
        if first and slot == 1:
            T[0] = T[1]
        if v is not None:
            V[slot] = v
        elif slot == 1:
            self._difference(dt)
        else:
            V[slot] = 0.0
        A[slot] = 0.0 if a is None else a
        if first and slot == 1:
            V[0] = 0.0 if v is None else V[1]
            A[0] = A[1]
        return True

    def step_on(self) -> None:
        """The next target becomes the last one."""
        self.T[0], self.V[0], self.A[0] = self.T[1], self.V[1], self.A[1]

    def divided(self, parts: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The motion from the last target to the next in equal parts: T (parts + 1, F, 4, 4), V, A (parts + 1, m)."""
        f = np.linspace(0.0, 1.0, parts + 1)
        T = np.repeat(self.T[:1], parts + 1, axis=0)
        for k in range(self.tips):
            T[:, k, :3, 3] += f[:, None] * (self.T[1, k, :3, 3] - self.T[0, k, :3, 3])
            turn = log(self.T[1, k, :3, :3] @ self.T[0, k, :3, :3].T)
            T[:, k, :3, :3] = exp(f[:, None] * turn) @ self.T[0, k, :3, :3]
        T[-1] = self.T[1]
        return T, *(one[0] + f[:, None] * (one[1] - one[0]) for one in (self.V, self.A))

    def _difference(self, dt: float) -> None:
        """Twist from the last target to the next."""
        V = []
        for f in range(self.tips):
            old, new = self.T[:, f].tolist()  # Python numbers: making arrays of three takes longer than adding them
            V += [(new[k][3] - old[k][3]) / dt for k in range(3)]
            if self.kinds is not None and self.kinds[f] != POSITION:
                V += [angle / dt for angle in turn_between(old, new)]
            else:
                V += [0.0, 0.0, 0.0]
        self.V[1] = V

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
            value = np.concatenate([np.resize(value.get(tip, np.zeros(6)), 6) for tip in self.robot.tips])
        wanted = f"{name} must have 6 values" if self.tips == 1 else f"{name} must have 6 values for each tip"
        array = floats(value, wanted, InvalidTarget).reshape(-1)
        if array.shape == (3,) and self.tips == 1 and self.kinds != (POSE,):
            return np.concatenate([array, np.zeros(3)])
        if array.shape != (6 * self.tips,):
            raise InvalidTarget(f"{wanted}, not shape {np.shape(value)}")
        return array


def _finite(one: Any) -> bool:
    """Whether all numbers of a tip's target are finite; anything that is not a target is left to its reader."""
    try:
        return bool(
            np.isfinite(np.asarray(getattr(one, "homogeneous", getattr(one, "T_base_tip", one)), dtype=float)).all()
        )
    except (TypeError, ValueError):
        return True


def rigid(T: np.ndarray) -> bool:
    """Whether (4, 4) numbers are a pose: the full `check_target`, which corrects or refuses, costs ten times as much."""
    (a, b, c, x), (d, e, f, y), (g, h, i, z), last = T.tolist()
    # One by one: `max` of numbers may miss a NaN among them.
    return (
        last == [0.0, 0.0, 0.0, 1.0]
        and abs(a * a + b * b + c * c - 1.0) < TIGHT
        and abs(d * d + e * e + f * f - 1.0) < TIGHT
        and abs(a * d + b * e + c * f) < TIGHT
        and abs(b * f - c * e - g) < TIGHT
        and abs(c * d - a * f - h) < TIGHT
        and abs(a * e - b * d - i) < TIGHT
        and abs(x) + abs(y) + abs(z) < math.inf
    )


def turn_between(old: list, new: list) -> tuple[float, ...]:
    """Rotation vector [rad], base axes, from one pose to another, rows of numbers: the same as `log` in a fifth of the time."""
    (a, b, c, _), (d, e, f, _), (g, h, i, _), _ = old
    (u, v, w, _), (n, o, p, _), (q, r, s, _), _ = new
    # Of new old': twice the sine of the angle along its axis, and twice its cosine. In pairs, so that no turn gives exactly zero.
    x = (q * d - n * g) + (r * e - o * h) + (s * f - p * i)
    y = (u * g - q * a) + (v * h - r * b) + (w * i - s * c)
    z = (n * a - u * d) + (o * b - v * e) + (p * c - w * f)
    cosine = u * a + v * b + w * c + n * d + o * e + p * f + q * g + r * h + s * i - 1.0
    if cosine < HALF_TURN:  # there the sine no longer gives the axis
        return tuple(log(np.array(new)[:3, :3] @ np.array(old)[:3, :3].T))
    sine = math.sqrt(x * x + y * y + z * z)
    ratio = math.atan2(sine, cosine) / sine if sine > 0.0 else 0.5
    return ratio * x, ratio * y, ratio * z
