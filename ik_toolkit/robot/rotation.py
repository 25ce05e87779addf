"""Rotations: matrices from angles and quaternions, and back."""

import math
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np

from ..errors import InvalidOption, InvalidTarget, floats


def turn_onto(axis: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Return a rotation (3, 3) that turns the unit vector `axis` (3,) onto the unit vector `direction` (3,)."""
    cos = float(axis @ direction)
    # The formula below divides by 1 + cos, which is inexact near 180 degrees. Beyond 90 degrees the rotation is therefore made of
    # two reflections: one that takes `axis` to a third vector, and one that takes this to `direction`.
    if cos < 0.0:
        between = np.eye(3)[int(np.argmin(np.maximum(np.abs(axis), np.abs(direction))))]
        u, v = axis - between, direction - between
        return (np.eye(3) - 2.0 * np.outer(v, v) / (v @ v)) @ (np.eye(3) - 2.0 * np.outer(u, u) / (u @ u))
    K = np.outer(direction, axis) - np.outer(axis, direction)  # The skew-symmetric matrix of axis x direction.
    return np.eye(3) + K + K @ K / (1.0 + cos)


def nearest_rotation(R: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the rotation (3, 3) nearest to R and the largest deviation of R's singular values from 1."""
    U, S, Vt = np.linalg.svd(R)
    D = np.diag([1.0, 1.0, math.copysign(1.0, float(np.linalg.det(U @ Vt)))])
    return U @ D @ Vt, float(np.abs(S * np.diag(D) - 1.0).max())


def finite_numbers(value: Any, size: int, name: str) -> np.ndarray:
    """Return `value` as an array (size,) of finite numbers. Raises InvalidTarget, which names the argument `name`."""
    wanted = f"{name} must be {size} numbers" if size > 1 else f"{name} must be a number"
    array = floats(value, wanted, InvalidTarget)
    if array.shape != (size,):
        raise InvalidTarget(f"{wanted}, not an array of shape {array.shape}")
    if not np.isfinite(array).all():
        raise InvalidTarget(f"{name} must be finite numbers: {array.tolist()}")
    return array


def angles_between(A: np.ndarray, B: np.ndarray) -> np.ndarray:
    """Return the angles (N,) [rad] of the rotations that turn the matrices A (N, 3, 3) into the matrices B (N, 3, 3)."""
    chord = np.linalg.norm(A - B, axis=(1, 2)) / np.sqrt(8.0)
    return 2.0 * np.arcsin(np.minimum(chord, 1.0))


def rpy_matrix(rpy: Sequence[float] | np.ndarray) -> np.ndarray:
    """Return the rotation (3, 3) of roll, pitch, yaw [rad] as URDF means them: Rz(yaw) Ry(pitch) Rx(roll)."""
    (sr, sp, sy), (cr, cp, cy) = np.sin(rpy), np.cos(rpy)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def euler_axes(order: Any) -> str:
    """Check a sequence of Euler axes, such as "zyx" or "ZYX", and return it in lower case.

    Each rotation is about an axis that the previous ones have turned (intrinsic). Raises InvalidOption.
    """
    axes = str(order).lower()
    if (
        str(order) not in (axes, axes.upper())
        or len(axes) != 3
        or not {*axes} <= {*"xyz"}
        or axes[1] in (axes[0], axes[2])
    ):
        raise InvalidOption(
            "euler names three axes of which no two neighbours are the same, such as zyx or zyz (or ZYX, which is the same: they "
            f"move with the body; for fixed axes give the reverse order), not {order!r:.20}"
        )
    return axes


def euler_matrix(order: str, angles: np.ndarray) -> np.ndarray:
    """Return the rotation matrices (N, 3, 3) of intrinsic Euler angles (N, 3) [rad] about the axes in `order`, such as "zyx".

    The order "zyx" with the angles (yaw, pitch, roll) is roll, pitch and yaw of URDF.
    """
    made = np.tile(np.eye(3), (len(angles), 1, 1))
    for axis, angle in zip(order, angles.T, strict=True):
        i, j = ("xyz".index(axis) + 1) % 3, ("xyz".index(axis) + 2) % 3
        R = np.tile(np.eye(3), (len(angles), 1, 1))
        R[:, i, i], R[:, j, j], R[:, j, i], R[:, i, j] = np.cos(angle), np.cos(angle), np.sin(angle), -np.sin(angle)
        made = made @ R
    return made


def rotation_columns(names: Sequence[str]) -> list[str]:
    """Return those of the lower-case column names that other programs use for rotations, such as "euler_x" or "alpha"."""
    parts = ("roll", "pitch", "yaw", "rot", "rpy", "quat", "euler", "orient")
    lines = "w p r, u v w, rx ry rz, alpha beta gamma, phi theta psi, qx qy qz qw, q0 q1 q2 q3, q1 q2 q3 q4, i j k w"
    groups = [line.split() for line in lines.split(", ")]
    found = [name for name in names if any(part in name for part in parts)]
    return found + next((group for group in groups if {*group} <= {*names}), [])


def matrix_rpy(R: np.ndarray) -> np.ndarray:
    """Return roll, pitch, yaw [rad] (URDF) of a rotation (3, 3), with yaw = 0 if pitch is +-90 degrees.

    The roll is found from Rz(yaw)^T R, so the three angles reproduce R to rounding, however near pitch is to 90 degrees.
    """
    cos_pitch = math.hypot(R[0, 0], R[1, 0])
    # If the cosine of the pitch is as small as rounding errors, the yaw would consist of them, so it is set to 0.
    yaw = math.atan2(R[1, 0], R[0, 0]) if cos_pitch > 1e-15 else 0.0
    s, c = math.sin(yaw), math.cos(yaw)
    roll = math.atan2(s * R[0, 2] - c * R[1, 2], c * R[1, 1] - s * R[0, 1])
    return np.array([roll, math.atan2(-R[2, 0], cos_pitch), yaw])


def quat_matrix(quat: Sequence[float] | np.ndarray, order: Literal["xyzw", "wxyz"] = "xyzw") -> np.ndarray:
    """Return the rotation (3, 3) of a quaternion (4,) with its numbers in the order `order`; its length need not be 1."""
    q = finite_numbers(quat, 4, f"quat_{order}")
    length = math.sqrt(float(q @ q))
    if not length > 1e-6:
        raise InvalidTarget(f"quat_{order} has length {length:.3g}: not a rotation")
    import pinocchio as pin  # imported here so that reading tables and files stays fast

    return pin.Quaternion(np.roll(q / length, -1 if order == "wxyz" else 0)).matrix()


def matrix_quat(R: np.ndarray) -> np.ndarray:
    """Return the unit quaternion (4,) x, y, z, w, with w >= 0, of a rotation (3, 3)."""
    import pinocchio as pin  # imported here so that reading tables and files stays fast

    q = np.array(pin.Quaternion(np.asarray(R)).coeffs())
    return q if q[3] >= 0 else -q
