"""Timed joint motions, evaluated at any time, sampled at a fixed rate, exported for controllers, or read from files."""

import json
import logging
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..errors import InvalidConfiguration, InvalidOption, InvalidTarget
from ..files import as_path, check_arrays, read_json, why_unread, write_table, write_whole
from ..robot.joints import Joints
from ..robot.pose_files import read_columns
from ..robot.robot import Robot
from ..robot.ros import joint_trajectory
from ..style import BAD, GOOD
from ..text import TextTable, how_many
from .reference import Reference, Samples, read_times
from .time_law import coordinate_at

# [s] step of the central difference by which the rate of change dJ/dt of the Jacobian is computed along a motion
DIFFERENCE = 1e-5


class Piece(NamedTuple):
    """A piece of a trajectory: a curve q(s) of the joints, and its time law from rest to rest."""

    # (M,) knots, values of the path coordinate s between which q(s) is a cubic polynomial; two are equal where a pose repeats
    knots: np.ndarray
    coefficients: np.ndarray  # (4, M-1, n) coefficients of the cubic polynomials in s - knot, highest power first
    s: np.ndarray  # (G,) values of s at the grid points of the time law
    speed: np.ndarray  # (G,) ds/dt [1/s] at the grid points of the time law; linear in time between them
    t: np.ndarray  # (G,) time [s] at the grid points of the time law, from 0
    at: np.ndarray  # (M,) position of each knot on the path (3.5: halfway from pose 3 to pose 4); NaN in a free motion

    @property
    def duration(self) -> float:
        """Duration of the piece [s]."""
        return float(self.t[-1])

    def slower(self, factor: float) -> "Piece":
        """Return a piece with the same curve q(s) that takes `factor` times as long."""
        return self._replace(speed=self.speed / factor, t=self.t * factor)

    def curve(self, s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return joint values q (N, n) [rad or m] and their derivatives dq/ds and d2q/ds2 (N, n), at s (N,)."""
        last = np.searchsorted(self.knots, self.knots[-1]) - 1
        k = np.clip(np.searchsorted(self.knots, s, side="right") - 1, 0, last)
        x = (s - self.knots[k])[:, None]
        a, b, c, d = self.coefficients[:, k]
        return ((a * x + b) * x + c) * x + d, (3.0 * a * x + 2.0 * b) * x + c, 6.0 * a * x + 2.0 * b

    def sample(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Evaluate the piece at times t (N,) [s] from its start.

        Returns:
            Joint values, rates and accelerations (N, n), and the position of each sample on the path (N,), as in `at`.
        """
        s, rate, gain = coordinate_at(np.clip(t, 0.0, self.t[-1]), self.t, self.s, self.speed)
        rate, gain = rate[:, None], gain[:, None]
        q, slope, bend = self.curve(s)
        return q, slope * rate, bend * rate**2 + slope * gain, np.interp(s, self.knots, self.at)


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A motion in time of n joints, sampled at N times (read-only).

    t (N,) [s] from 0, spaced by 1 / rate except for the last; q, dq, ddq (N, n) [rad or m, per s, per s^2]; place (N,): position on
    the path (3.5: halfway from pose 3 to pose 4), NaN while the robot changes from one branch of solutions to another; success;
    message: a sentence, which says why if the motion ends early. velocity, acceleration (n,): the joint limits, which hold at every
    instant, not only at the samples. deviation (m, rad): bound on how far a tip leaves the interpolated poses while it is on the
    path; clearance [m]: proven least distance of any two parts during the whole motion (0: not proven; None: collisions were not
    checked). pieces: the motion itself, each piece from rest to rest. robot: the robot that moves; collision: the CollisionModel it
    keeps clear of, or None. stops: the positions on the path at which the robot stops because no smooth curve was found there.
    slower: the ranges of positions (from, to) on the path where joint limits keep the tip below the requested tip speed, which it
    does not exceed in free motions either.
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
    stops: tuple[float, ...] = ()
    slower: tuple[tuple[float, float], ...] = ()

    @property
    def duration(self) -> float:
        """Duration of the motion [s]."""
        return float(self.t[-1])

    def at(self, t: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Evaluate the motion; before 0 and after the end the joints are at rest.

        Args:
            t: A time [s], or an array (N,) of times.

        Returns:
            Joint values, rates and accelerations: (n,) for one time, (N, n) for several.

        Raises:
            InvalidOption: t is not finite or has the wrong shape.
        """
        q, dq, ddq, _ = sample(self.pieces, read_times(t))
        return (q, dq, ddq) if np.ndim(t) else (q[0], dq[0], ddq[0])

    def to_csv(self, path: str | Path) -> Path:
        """Write a CSV file with one row for each sample: t, then q_, dq_ and ddq_ of each joint. Returns its path."""
        file = as_path(path, "path")
        names = self.robot.joint_names
        head = ["t", *(f"{kind}_{joint}" for kind in ("q", "dq", "ddq") for joint in names)]
        write_table(file, head, np.hstack([self.t[:, None], self.q, self.dq, self.ddq]).tolist())
        return file

    def to_ros(self) -> dict[str, Any]:
        """Return the fields of a ROS trajectory_msgs/JointTrajectory, as a dict, with one point for each sample.

        The function set_message_fields of rosidl_runtime_py makes a message of them.
        """
        names, base = self.robot.joint_names, self.robot.arms[0].base
        return joint_trajectory(names, base, self.t, self.q, self.dq, self.ddq)

    def to_json(self, path: str | Path) -> Path:
        """Write the fields of `to_ros` to a JSON file. Returns its path."""
        file = as_path(path, "path")
        write_whole(file, json.dumps(self.to_ros(), allow_nan=False) + "\n")
        return file

    def to_reference(self, tip: str | None = None) -> Reference:
        """Return the motion of a tip as a moving target (Reference), which `ik.track` follows.

        Args:
            tip: Name of the tip; needed only if the robot has several.

        Raises:
            FrameNotFound: The robot has no such tip.
            InvalidOption: The tip must be chosen, or the trajectory does not move.
        """
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

    def _repr_html_(self) -> str:
        """Return a table for notebooks: how far and how fast each joint moves."""
        speed, gain = (np.abs(rate).max(axis=0, initial=0.0) for rate in (self.dq, self.ddq))
        columns = (self.q[0], self.q[-1], speed, self.velocity, gain, self.acceleration)
        rows = zip(self.robot.joint_names, *columns, strict=True)
        head = ("joint", "from", "to", "largest speed", "limit", "largest acceleration", "limit")
        units = "Joint values in rad or m, speeds per s, accelerations per s^2."
        how = "ik.plot(trajectory) draws them over time, ik.view(robot, trajectory) shows the motion."
        color = GOOD if self.success else BAD
        return TextTable(f"{self.duration:.4g} s", self.message, head, rows, units, how, color=color, most=40).html()

    def __repr__(self) -> str:
        """Return a line with the number of samples, the duration and the number of joints."""
        return f"Trajectory({len(self.t)} samples, {self.duration:.4g} s, {how_many(self.q.shape[1], 'joint')})"


def _motion_of(arm: Robot, columns: Any, pieces: Any, t: np.ndarray) -> Samples:
    """Return poses, twists and accelerations of one tip at t (N,) [s]; columns: indices of its joints in q."""
    q, dq, ddq, _ = sample(pieces, t)
    return tip_motion(arm, q[:, columns], dq[:, columns], ddq[:, columns])


def tip_motion(arm: Robot, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> Samples:
    """Return poses (N, 4, 4), twists and accelerations (N, 6) in base axes of an arm's tip for a given joint motion.

    q, dq, ddq (N, n): joint values, rates and accelerations. The acceleration is J ddq + (dJ/dt) dq.
    """
    T, J = arm.chain.forward(q, jacobian=True)
    ahead, behind = (arm.chain.forward(q + h * dq, jacobian=True)[1] for h in (DIFFERENCE, -DIFFERENCE))
    drift = np.einsum("tij,tj->ti", ahead - behind, dq) / (2.0 * DIFFERENCE)
    return T, np.einsum("tij,tj->ti", J, dq), np.einsum("tij,tj->ti", J, ddq) + drift


def sample(pieces: tuple[Piece, ...], t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Evaluate consecutive pieces at times t (N,) [s] from the start of the first.

    Returns:
        Joint values, rates and accelerations (N, n), and the position of each sample on the path (N,), as in `Piece.at`.
    """
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


def read_motion(robot: Joints, file: str | Path) -> tuple[np.ndarray | None, np.ndarray]:
    """Read times (N,) [s] or None, and joint values (N, n) [rad or m], from a file of `ik path` or `ik track`.

    Raises InvalidConfiguration for a file that cannot be read, or whose joints are not the robot's.
    """
    path = Path(file)
    try:
        names, values, t = _joint_table(path)
        _check_table(names, values, t)
    except InvalidConfiguration:
        raise
    except InvalidTarget as error:  # The message of `read_columns` already names the file.
        raise InvalidConfiguration(f"cannot read the motion: {error}") from None
    except Exception as error:  # Damaged files raise errors of many types (zip, zlib, npy, json, csv).
        raise InvalidConfiguration(f"cannot read the motion in '{path.name}': {why_unread(error)}") from None
    if missing := [joint for joint in robot.joint_names if joint not in names]:
        raise InvalidConfiguration(
            f"'{path.name}' has no values of joint {', '.join(missing)}; it has {', '.join(names)}"
        )
    Q = values[:, [names.index(joint) for joint in robot.joint_names]]
    keep = np.isfinite(Q).all(axis=1)
    if not keep.any():
        raise InvalidConfiguration(f"'{path.name}' has no row in which every joint has a value")
    if not keep.all():
        what = "'%s': %d of %d rows lack joint values and are left out"
        logging.getLogger("ik_toolkit").warning(what, path.name, int((~keep).sum()), len(Q))
    return None if t is None else t[keep], Q[keep]


def _check_table(names: Any, values: np.ndarray, t: np.ndarray | None) -> None:
    """Raise ValueError, saying why, unless each row has a value for every name and the times are finite and do not go back."""
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise ValueError("its joint_names are not a list of names")
    if not len(values):
        raise ValueError("it has no rows")
    if values.ndim != 2 or values.shape[1] != len(names):
        raise ValueError(f"its rows do not have one value for each of the {len(names)} joint_names")
    if t is not None and (t.shape != values.shape[:1] or not np.isfinite(t).all()):
        raise ValueError("its rows do not have one finite time each")
    if t is not None and (back := np.flatnonzero(np.diff(t) < 0.0)).size:
        raise ValueError(f"its times go back, first after row {back[0] + 1}")


def _joint_table(path: Path) -> tuple[list[str], np.ndarray, np.ndarray | None]:
    """Return names of joints, their values (N, K), NaN where there are none, and times (N,) [s] or None."""
    suffix = path.suffix.lower()
    if not path.stat().st_size:
        raise ValueError("it is empty")
    if suffix == ".npz":
        check_arrays(path, ("joint_names", "curve", "q", "t"), ("joint_names",), InvalidConfiguration)
        with np.load(path, allow_pickle=False) as arrays:
            names = arrays["joint_names"].tolist() if "joint_names" in arrays else []
            if "curve" in arrays:
                return names, arrays["curve"], None
            if "q" not in arrays or "t" not in arrays:
                raise ValueError("it has neither 'curve', as ik path writes it, nor 't' and 'q', as ik track does")
            return names, arrays["q"], arrays["t"]
    if suffix == ".json":
        content = read_json(path, InvalidConfiguration)
        if not isinstance(content, dict):
            raise ValueError("it is no object with joint_names, as ik path writes it")
        if "points" not in content:
            return content["joint_names"], np.array(content["curve"], dtype=float), None
        stamps = [point["time_from_start"] for point in content["points"]]
        t = np.array([stamp["sec"] + 1e-9 * stamp["nanosec"] for stamp in stamps])
        return content["joint_names"], np.array([point["positions"] for point in content["points"]], dtype=float), t
    if suffix != ".csv":
        raise ValueError("the file must be .csv, .npz or .json")
    head, values = read_columns(path, gaps=True)
    if head[0] != "t":
        return head, values, None
    # The column of times is no joint, though a joint may be named t.
    return [name.removeprefix("q_") for name in head[1:]], values[:, 1:], values[:, 0]
