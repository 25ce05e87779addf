"""A joint motion in time: exact at every instant, sampled at a rate, and exported for controllers."""

import json
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..errors import InvalidOption, floats
from ..files import as_path, write_table, write_whole
from ..robot.robot import Robot
from ..robot.ros import joint_trajectory
from .reference import Reference, Samples
from .time_law import coordinate_at

DIFFERENCE = 1e-5  # [s] step of the central difference of a Jacobian along the motion: its error is quadratic in it


class Piece(NamedTuple):
    """A curve and its time law, from rest to rest.

    knots (M,) and coefficients (4, M-1, n): cubics in s, highest power first, from knot to knot. s, speed, t (G,): path
    coordinate, its rate and the time [s] at the grid points of the time law; ds/dt has a constant derivative between them.
    at (M,): place of each knot among the poses of the path, NaN in a free motion.
    """

    knots: np.ndarray
    coefficients: np.ndarray
    s: np.ndarray
    speed: np.ndarray
    t: np.ndarray
    at: np.ndarray

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return float(self.t[-1])

    def slower(self, factor: float) -> "Piece":
        """The same curve in `factor` times the time."""
        return self._replace(speed=self.speed / factor, t=self.t * factor)

    def curve(self, s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Joint values (N, n) and their first and second derivatives with respect to s, at s (N,)."""
        k = np.clip(np.searchsorted(self.knots, s, side="right") - 1, 0, len(self.knots) - 2)
        x = (s - self.knots[k])[:, None]
        a, b, c, d = self.coefficients[:, k]
        return ((a * x + b) * x + c) * x + d, (3.0 * a * x + 2.0 * b) * x + c, 6.0 * a * x + 2.0 * b

    def sample(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Joint values, rates and accelerations (N, n) at times t (N,) [s] from its start, and the place among the poses (N,)."""
        s, rate, gain = coordinate_at(np.clip(t, 0.0, self.t[-1]), self.t, self.s, self.speed)
        rate, gain = rate[:, None], gain[:, None]
        q, slope, bend = self.curve(s)
        return q, slope * rate, bend * rate**2 + slope * gain, np.interp(s, self.knots, self.at)


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A motion in time of n joints, sampled at N times (read-only).

    t (N,) [s] from 0, spaced by 1 / rate except for the last; q, dq, ddq (N, n) [rad or m, per s, per s^2]; place (N,) among the
    poses of the path, NaN while the robot changes from one branch of solutions to another; success; message: a sentence, which
    says why if the motion ends early. velocity, acceleration (n,): the limits, which hold at every instant, see `at`. deviation
    (m, rad): bound on how far a tip leaves the interpolated poses; clearance [m] as in PathResult. pieces: the motion itself,
    each from rest to rest. robot: the robot that moves; collision: the CollisionModel it keeps clear of, or None.
    """

    robot: Any
    t: np.ndarray
    q: np.ndarray
    dq: np.ndarray
    ddq: np.ndarray
    place: np.ndarray
    success: bool
    message: str
    velocity: np.ndarray
    acceleration: np.ndarray
    deviation: tuple[float, float]
    clearance: float | None
    pieces: tuple[Piece, ...]
    collision: Any = field(default=None, repr=False)

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return float(self.t[-1])

    def at(self, t: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """q, dq, ddq at any t [s]: (n,) for a number, (N, n) for an array (N,); at rest before 0 and after the end."""
        times = np.atleast_1d(floats(t, "t must be times [s]", InvalidOption))
        if times.ndim > 1 or not np.isfinite(times).all():
            raise InvalidOption(f"t must be a finite number or an array (N,) of them [s], not {repr(t)[:60]}")
        q, dq, ddq, _ = sample(self.pieces, times)
        return (q, dq, ddq) if np.ndim(t) else (q[0], dq[0], ddq[0])

    def to_csv(self, path: str | Path) -> Path:
        """Write one row per sample: t, then q_, dq_ and ddq_ of each joint."""
        file = as_path(path, "path")
        names = self.robot.joint_names
        head = ["t", *(f"{kind}_{joint}" for kind in ("q", "dq", "ddq") for joint in names)]
        write_table(file, head, np.hstack([self.t[:, None], self.q, self.dq, self.ddq]).tolist())
        return file

    def to_ros(self) -> dict[str, Any]:
        """Fields of a ROS trajectory_msgs/JointTrajectory, one point per sample; for rosidl_runtime_py's set_message_fields."""
        names, base = self.robot.joint_names, self.robot.arms[0].base
        return joint_trajectory(names, base, self.t, self.q, self.dq, self.ddq)

    def to_json(self, path: str | Path) -> Path:
        """Write the fields of `to_ros` as JSON."""
        file = as_path(path, "path")
        write_whole(file, json.dumps(self.to_ros(), allow_nan=False) + "\n")
        return file

    def to_reference(self, tip: str | None = None) -> Reference:
        """The motion of a tip as a `Reference` for `ik.track`. tip: which of several. Raises FrameNotFound, InvalidOption."""
        tips = self.robot.tips
        if tip is None and len(tips) > 1:
            raise InvalidOption(f"to_reference is for one tip; choose one with tip=: {', '.join(tips)}")
        if tip is not None:
            self.robot.check_tips([tip])
        if not self.duration > 0.0:
            raise InvalidOption("the trajectory has no motion, so there is no reference to follow")
        f = 0 if tip is None else tips.index(tip)
        function = partial(_motion_of, self.robot.arms[f], self.robot.places[f], self.pieces)
        return Reference(function, self.duration, name=f"trajectory of {tips[f]}")


def _motion_of(arm: Robot, columns: Any, pieces: Any, t: np.ndarray) -> Samples:
    """Motion of the tip of an arm, whose joints are these columns."""
    q, dq, ddq, _ = sample(pieces, t)
    return tip_motion(arm, q[:, columns], dq[:, columns], ddq[:, columns])


def tip_motion(arm: Robot, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> Samples:
    """Motion of the tip of an arm whose joints (N, n) move as given."""
    T, J = arm.chain.forward(q, jacobian=True)
    ahead, behind = (arm.chain.forward(q + h * dq, jacobian=True)[1] for h in (DIFFERENCE, -DIFFERENCE))
    drift = np.einsum("tij,tj->ti", ahead - behind, dq) / (2.0 * DIFFERENCE)
    return T, np.einsum("tij,tj->ti", J, dq), np.einsum("tij,tj->ti", J, ddq) + drift

    def __repr__(self) -> str:
        """One line."""
        return f"Trajectory({len(self.t)} samples, {self.duration:.4g} s, {self.q.shape[1]} joints)"


def sample(pieces: tuple[Piece, ...], t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Joint values, rates, accelerations (N, n) and places (N,) of consecutive pieces at t (N,) [s]."""
    starts = np.cumsum([0.0, *(piece.duration for piece in pieces)])
    owner = np.clip(np.searchsorted(starts, t, side="right") - 1, 0, len(pieces) - 1)
    n = pieces[0].coefficients.shape[2]
    q, dq, ddq, place = np.empty((len(t), n)), np.empty((len(t), n)), np.empty((len(t), n)), np.empty(len(t))
    for k in np.unique(owner):
        mine = owner == k
        q[mine], dq[mine], ddq[mine], place[mine] = pieces[k].sample(t[mine] - starts[k])
    outside = (t < 0.0) | (t > starts[-1])
    dq[outside], ddq[outside] = 0.0, 0.0
    return q, dq, ddq, place
