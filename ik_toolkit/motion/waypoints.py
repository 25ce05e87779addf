"""References through given poses: from waypoints, and from files of poses over time."""

import itertools
import os
from collections.abc import Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InvalidOption, InvalidTarget, MissingExtra, floats
from ..robot.pose_files import read_poses
from ..validate import one_of, positive
from .reference import Reference, Samples, exp, log, minimum_jerk, split, still

# [s] Least time between two points of a spline: scipy computes 1 / time^3, which overflows for shorter times.
SHORTEST = 1e-100
# [m/rad] length of travel that counts as much as a rotation of 1 rad when a duration is divided among waypoints
RADIAN_AS_METRES = 0.25


def waypoints(
    targets: Sequence[Any],
    *,
    duration: float | None = None,
    times: Sequence[float] | None = None,
    law: str = "minimum-jerk",
) -> Reference:
    """Make a moving target (Reference) through poses or positions in order. Either times or duration is given.

    Args:
        targets: At least two poses (4, 4), or positions (3,), base frame [m].
        duration: Time for the whole motion [s], divided in proportion to distance, where 1 rad counts as 0.25 m.
        times: When each target is reached [s], increasing.
        law: "minimum-jerk" moves in straight lines and stops at each target; "spline" passes through them along a cubic
            spline (with twice differentiable rotations) that is at rest in position at both ends, and needs scipy.

    Returns:
        The reference, whose times begin at 0.

    Raises:
        InvalidTarget: There are too few targets, two are the same, they are of different kinds, or times do not fit.
        InvalidOption: Both or neither of times and duration are given, or there is no such law.
        MissingExtra: scipy is not installed.
    """
    if not isinstance(targets, Iterable) or getattr(targets, "ndim", 1) == 0:
        raise InvalidTarget(f"waypoints are a list of poses or positions, not {type(targets).__name__}")
    pairs = [split(target) for target in targets]
    if len(pairs) < 2:
        raise InvalidTarget(f"waypoints need at least 2 targets, not {len(pairs)}")
    if len({R is None for _, R in pairs}) > 1:
        raise InvalidTarget("waypoints must be all poses or all positions")
    P = np.array([p for p, _ in pairs])
    R = None if pairs[0][1] is None else np.array([R for _, R in pairs])
    turns = np.zeros((len(P) - 1, 3)) if R is None else np.array([log(a.T @ b) for a, b in itertools.pairwise(R)])
    if (times is None) == (duration is None):
        raise InvalidOption("waypoints need either times= or duration=")
    if times is None:
        share = np.linalg.norm(np.diff(P, axis=0), axis=1) + RADIAN_AS_METRES * np.linalg.norm(turns, axis=1)
        if not (share > 1e-12).all():
            raise InvalidTarget(f"waypoints {int(np.argmin(share))} and {int(np.argmin(share)) + 1} are the same")
        t = np.concatenate([[0.0], np.cumsum(share)]) / share.sum() * positive(duration, "duration [s]")
    else:
        t = _check_times(floats(times, "times must be numbers [s]", InvalidTarget), len(P))
    if one_of(law, ("minimum-jerk", "spline"), "waypoint law") == "spline":
        return _spline(t, P, R, "clamped", "waypoints")
    return Reference(partial(_legs, t, P, R, turns), float(t[-1]), position_only=R is None, name="waypoints")


def _legs(t: np.ndarray, P: np.ndarray, R: np.ndarray | None, turns: np.ndarray, now: np.ndarray) -> Samples:
    """Sample a motion that stops at each target: straight lines with minimum jerk between them.

    t (K,) [s]: times of the targets; P (K, 3): their positions; R (K, 3, 3): their rotations, None if free; turns
    (K - 1, 3): the rotation vectors from each target to the next, in the axes of the first of the two; now (N,) [s]: the
    times to sample at.
    """
    leg = np.clip(np.searchsorted(t, now, side="right") - 1, 0, len(t) - 2)
    length = np.diff(t)[leg]
    s, s1, s2 = (x[:, None] for x in minimum_jerk((now - t[leg]) / length))
    s1, s2 = s1 / length[:, None], s2 / length[:, None] ** 2
    T, V, A = still(len(now), None)
    d = np.diff(P, axis=0)[leg]
    T[:, :3, 3] = P[leg] + s * d
    V[:, :3], A[:, :3] = d * s1, d * s2
    if R is not None:
        w = np.einsum("nij,nj->ni", R[leg], turns[leg])
        T[:, :3, :3] = R[leg] @ exp(s * turns[leg])
        V[:, 3:], A[:, 3:] = w * s1, w * s2
    return T, V, A


def _check_times(t: np.ndarray, count: int) -> np.ndarray:
    """Return times t (count,) [s] shifted to begin at 0; raise InvalidTarget unless they are finite and increase."""
    if t.shape != (count,):
        raise InvalidTarget(f"times must be {count} numbers, one per pose, not an array of shape {t.shape}")
    if not np.isfinite(t).all():
        raise InvalidTarget(f"times has a value that is not finite (number {int(np.argmin(np.isfinite(t))) + 1})")
    if not (np.diff(t) > 0.0).all():
        i = int(np.argmin(np.diff(t)))
        raise InvalidTarget(f"times must increase: number {i + 2} is {t[i + 1]:g} after {t[i]:g}")
    return t - t[0]


def _spline(t: np.ndarray, P: np.ndarray, R: np.ndarray | None, ends: str, name: str) -> Reference:
    """Make a spline reference through positions P (K, 3) and rotations R (K, 3, 3) (None: free) at times t (K,) [s].

    ends: scipy's end condition of the position, "clamped" (at rest) or "not-a-knot". Raises MissingExtra without scipy,
    InvalidTarget if the times are too close or too far apart.
    """
    try:
        from scipy.interpolate import CubicSpline
        from scipy.spatial.transform import Rotation, RotationSpline
    except ImportError:
        raise MissingExtra("scipy", "tune") from None
    if not SHORTEST < np.diff(t).min() <= np.diff(t).max() < 1.0 / SHORTEST:
        raise InvalidTarget(
            f"{name}: times less than {SHORTEST:g} s or more than {1 / SHORTEST:g} s apart make no curve"
        )
    position = CubicSpline(t, P, bc_type=ends if len(t) > 3 or ends == "clamped" else "natural")
    rotation = None if R is None else RotationSpline(t, Rotation.from_matrix(R))
    function = partial(_smooth, position, rotation, float(t[-1]))
    return Reference(function, float(t[-1]), position_only=R is None, name=name)


def _smooth(position: Any, rotation: Any, end: float, now: np.ndarray) -> Samples:
    """Sample splines of the position and of the rotation (None if it is free) at the times `now` (N,) [s]."""
    now = np.clip(now, 0.0, end)
    T, V, A = still(len(now), None)
    T[:, :3, 3], V[:, :3], A[:, :3] = position(now), position(now, 1), position(now, 2)
    if rotation is not None:
        T[:, :3, :3] = rotation(now).as_matrix()
        # RotationSpline returns angular rate and acceleration in the moving frame, so they are rotated into base axes.
        V[:, 3:] = np.einsum("nij,nj->ni", T[:, :3, :3], rotation(now, 1))
        A[:, 3:] = np.einsum("nij,nj->ni", T[:, :3, :3], rotation(now, 2))
    return T, V, A


def reference_from_file(path: str | Path) -> Reference:
    """Read a moving target (Reference) from a CSV or NPZ file of poses over time. Needs scipy.

    A CSV file has a header with the names t [s], x, y, z [m] and, for poses, qx, qy, qz, qw or roll, pitch, yaw [rad].
    An NPZ file has arrays t (N,), xyz (N, 3) and, for poses, quat_xyzw (N, 4). Poses are in the base frame. A cubic
    spline goes through the samples; velocity and acceleration are those of the spline.

    Args:
        path: The file.

    Returns:
        The reference; the first time of the file becomes 0.

    Raises:
        InvalidTarget: The file cannot be used; the message names the line.
        MissingExtra: scipy is not installed.
    """
    if not isinstance(path, str | os.PathLike):
        raise InvalidTarget(f"a reference file is named by a path, not {type(path).__name__}")
    file = Path(path)
    blocks = list(read_poses(file, "reference", times=True)[1])
    count = sum(len(block.poses) for block in blocks)
    if count < 2:
        raise InvalidTarget(f"'{file.name}' has {count} row(s); a path needs at least 2")
    poses = np.concatenate([block.poses for block in blocks])
    t = np.concatenate([block.t for block in blocks if block.t is not None])
    xyz = poses if poses.ndim == 2 else poses[:, :3, 3]
    return _spline(t - t[0], xyz, None if poses.ndim == 2 else poses[:, :3, :3], "not-a-knot", file.name)
