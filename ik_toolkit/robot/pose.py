"""Poses: build them from user input and reject anything that is not one."""

import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, overload

import numpy as np

from ..errors import DOUBTED, FEW_TURNS, IKError, InvalidTarget, doubt_angles, doubt_lengths, floats
from ..kernel.checks import RIGID
from .ros import listed_poses, read_pose
from .rotation import finite_numbers, nearest_rotation, quat_matrix, rpy_matrix, turn_onto

LAST = (0.0, 0.0, 0.0, 1.0)  # The last row of every homogeneous transform.
# A rotation matrix is projected to the nearest rotation if its singular values differ from 1 by at most this.
PROJECT_WITHIN = 1e-2
AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
AXES |= {f"-{name}": tuple(-x for x in axis) for name, axis in AXES.items()}
FORMS = "a 4x4 pose, a pin.SE3, a ROS pose or a position of 3 numbers"


@dataclass(frozen=True, eq=False)
class AxisTarget:
    """A position with one tip axis along a direction: five of the six degrees of freedom; rotation about the axis is free.

    Args:
        T_base_tip: One pose (4, 4) [m] that satisfies the target.
        axis: Vector (3,) in the tip frame, which is normalised.

    Raises:
        InvalidTarget: T_base_tip is not a pose, or the axis is zero.
    """

    T_base_tip: np.ndarray
    axis: tuple[float, float, float]

    def __post_init__(self) -> None:
        """Validate pose and axis, and store copies."""
        T, _ = check_target(self.T_base_tip)
        if T.ndim == 1:
            raise InvalidTarget("the T_base_tip of an AxisTarget is a 4x4 pose, not a position")
        object.__setattr__(self, "T_base_tip", T)
        object.__setattr__(self, "axis", tuple(_unit(self.axis, "axis").tolist()))


def _unit(value: Any, name: str) -> np.ndarray:
    vector = finite_numbers(named_axis(value, name, InvalidTarget), 3, name)
    length = float(np.linalg.norm(vector))
    if not length > 1e-9:
        raise InvalidTarget(f"{name} must not be the zero vector")
    return vector / length


def _near_unit(quat: Any, name: str) -> np.ndarray:
    """Return a quaternion (4,) of length 1 within PROJECT_WITHIN; a warning names one that has lost more than its last digits."""
    q = finite_numbers(quat, 4, name)
    length = math.hypot(*q.tolist())  # np.linalg.norm would square the numbers, which overflows for 1e200.
    if not abs(length - 1.0) <= PROJECT_WITHIN:
        mend = f"normalise it if it is right otherwise, in the order {', '.join(name[-4:])}"
        raise InvalidTarget(f"{name} has length {length:.4g}: not a rotation, which has length 1; {mend}")
    # The length of a quaternion written with four digits is off by at most 1e-4, so only larger deviations are reported.
    if abs(length - 1.0) > 1e-3 and name not in DOUBTED:
        DOUBTED.add(name)
        logging.getLogger("ik_toolkit").warning("%s has length %.4g and was normalised", name, length)
    return q


def named_axis(value: Any, name: str, error: type[IKError]) -> Any:
    """Return the unit vector (3,) for the text 'x', 'y', 'z', '-x', '-y' or '-z'; return a value that is no text unchanged.

    For any other text it raises an exception of the class `error`; `name` is that of the argument, for the message.
    """
    if not isinstance(value, str):
        return value
    if value.strip().lower() not in AXES:
        raise error(f"{name} must be {', '.join(AXES)} or three numbers, not {value!r:.60}")
    return AXES[value.strip().lower()]


Numbers = Sequence[float] | np.ndarray
Matrix = np.ndarray[tuple[Literal[4], Literal[4]], np.dtype[np.float64]]
Position = np.ndarray[tuple[Literal[3]], np.dtype[np.float64]]


@overload
def pose(xyz: Numbers | None = None, *, direction: Numbers, axis: Numbers | None = ...) -> AxisTarget: ...
@overload
def pose(xyz: Numbers | None = None, *, rpy: Numbers) -> Matrix: ...
@overload
def pose(xyz: Numbers | None = None, *, quat_xyzw: Numbers) -> Matrix: ...
@overload
def pose(xyz: Numbers | None = None, *, quat_wxyz: Numbers) -> Matrix: ...
@overload
def pose(xyz: Numbers | None = None, *, rotation: Any) -> Matrix: ...
@overload
def pose(xyz: Numbers | None = None) -> Position: ...
@overload
def pose(
    xyz: Numbers | None = None,
    *,
    rpy: Numbers | None = None,
    quat_xyzw: Numbers | None = None,
    quat_wxyz: Numbers | None = None,
    rotation: Any = None,
    axis: Numbers | None = ...,
    direction: Numbers | None = None,
) -> AxisTarget | Matrix | Position: ...
def pose(
    xyz: Numbers | None = None,
    *,
    rpy: Numbers | None = None,
    quat_xyzw: Numbers | None = None,
    quat_wxyz: Numbers | None = None,
    rotation: Any = None,
    axis: Numbers | None = None,
    direction: Numbers | None = None,
) -> AxisTarget | np.ndarray:
    """Make a target from a position and, if the orientation counts, a rotation or direction.

    Args:
        xyz: Position [m] of the tip in the base frame, by default the origin.
        rpy: Roll, pitch and yaw [rad] in URDF's order: Rz(yaw) Ry(pitch) Rx(roll).
        quat_xyzw: Quaternion with the scalar last. If its length differs from 1 by at most 1 %, it is normalised, above 0.1 % with
            a warning.
        quat_wxyz: The same with the scalar first.
        rotation: Rotation matrix (3, 3), T_base_tip.
        axis: Axis (3,) in the tip frame that points along `direction`, by default z.
        direction: Direction (3,) in the base frame; rotation about it is free.

    Returns:
        T_base_tip (4, 4), an AxisTarget if a direction is given, or the position (3,) if no rotation is given.

    Raises:
        InvalidTarget: A value is not finite, of the wrong size or not a rotation, several rotations are given, or an axis
            without a direction.
    """
    turned = sum(part is not None for part in (rpy, quat_xyzw, quat_wxyz, rotation))
    if direction is not None:
        if turned:
            raise InvalidTarget(
                "a direction leaves the rotation about it free; do not also give rpy, a quaternion or rotation"
            )
        tip_axis = _unit((0.0, 0.0, 1.0) if axis is None else axis, "axis")
        T = np.eye(4)
        T[:3, :3] = turn_onto(tip_axis, _unit(direction, "direction"))
        T[:3, 3] = finite_numbers((0.0, 0.0, 0.0) if xyz is None else xyz, 3, "xyz")
        return AxisTarget(T, tuple(tip_axis.tolist()))
    if axis is not None:
        raise InvalidTarget(
            "axis is the axis of the tip that points along a direction; give direction= too, or omit axis"
        )
    if turned > 1:
        raise InvalidTarget("give one of rpy, quat_xyzw, quat_wxyz and rotation, not several")
    position = finite_numbers((0.0, 0.0, 0.0) if xyz is None else xyz, 3, "xyz")
    if rpy is not None:
        angles = finite_numbers(rpy, 3, "rpy")
        if np.abs(angles).max() > FEW_TURNS:
            doubt_angles("rpy", {"": float(angles[np.abs(angles).argmax()])})
        R = rpy_matrix(angles)
    elif quat_xyzw is not None:
        R = quat_matrix(_near_unit(quat_xyzw, "quat_xyzw"))
    elif quat_wxyz is not None:
        R = quat_matrix(_near_unit(quat_wxyz, "quat_wxyz"), "wxyz")
    elif rotation is not None:
        R = floats(rotation, "rotation must be 3x3 numbers", InvalidTarget)
        if R.shape != (3, 3):
            raise InvalidTarget(f"rotation must be 3x3 numbers, not an array of shape {R.shape}")
    else:
        return position
    T = np.eye(4)
    T[:3, :3] = R
    T[:3, 3] = position
    return corrected(T)


@overload
def approach(target: AxisTarget, distance: float, axis: Numbers | str | None = None) -> AxisTarget: ...
@overload
def approach(target: Any, distance: float, axis: Numbers | str | None = None) -> Matrix: ...
def approach(target: Any, distance: float, axis: Numbers | str | None = None) -> AxisTarget | np.ndarray:
    """Return the pose before (or behind) a target, backed off along a tip axis: where a straight approach begins.

    Args:
        target: T_base_tip (4, 4), a pin.SE3 or ROS pose, or an AxisTarget.
        distance: how far [m] the tip is backed off against the direction of the axis; negative: beyond the target.
        axis: of the tip, "x", "y", "z", "-x", "-y", "-z" or three numbers; default that of an AxisTarget, else z. A tip whose
            z points up, such as the palletizer's, backs off from what is below it with "-z".

    Returns:
        A target of the same kind: an AxisTarget, or T_base_tip (4, 4).

    Raises:
        InvalidTarget: no pose (a position has no axes), a distance that is not a finite number, or a zero axis.
    """
    free = isinstance(target, AxisTarget)
    T = target.T_base_tip.copy() if free else check_target(target)[0]
    if T.ndim == 1:
        raise InvalidTarget("a position has no tip axis to back off along; give a pose, or ik.pose(xyz, direction=...)")
    step = finite_numbers([distance], 1, "distance")[0] * _unit(
        (target.axis if free else "z") if axis is None else axis, "axis"
    )
    T[:3, 3] -= T[:3, :3] @ step
    return AxisTarget(T, target.axis) if free else T


def _axes(T: np.ndarray, target: np.ndarray, frame: str) -> np.ndarray:
    """Return the rotation (3, 3) from base axes to the axes of `frame`."""
    if frame == "base" or (frame == "target" and target.ndim == 1):
        return np.eye(3)
    return (T if frame == "tip" else target)[:3, :3].T


def raw_error(T: np.ndarray, target: np.ndarray, frame: str = "base") -> np.ndarray:
    """Return the error (6,) of a tip pose T (4, 4) from a target (4, 4) or (3,): target - tip [m], then a rotation vector [rad].

    Both are along the axes of `frame`: 'base', 'tip' or 'target' (a position has no axes: 'base'). The rotation vector r solves
    exp(r) R = R_target in base axes; for a position it is NaN.
    """
    import pinocchio as pin

    axes = _axes(T, target, frame)
    e = np.full(6, np.nan)
    if target.ndim == 1:
        e[:3] = axes @ (target - T[:3, 3])
    else:
        e[:3] = axes @ (target[:3, 3] - T[:3, 3])
        e[3:] = axes @ pin.log3(target[:3, :3] @ T[:3, :3].T)
    return e


def errors(
    T: np.ndarray,
    target: np.ndarray,
    *,
    mask: Sequence[float] | None = None,
    slack: Sequence[float] | None = None,
    free_turn: Sequence[float] | None = None,
    frame: str = "base",
) -> tuple[np.ndarray, float, float | None]:
    """Return the error of a tip pose T (4, 4) from a target (4, 4) or (3,) as raw numbers (6,), and two norms of what counts of it.

    The raw error is target - T [m], then the rotation vector [rad] from T to the target. If the axis free_turn (3,) of the tip is
    given, rotation about it does not count: the rotation vector is then that of the smallest rotation that aligns this axis with
    that of the target. For the norms each error is reduced by its tolerance `slack` (6,) [m, rad] and multiplied by its weight
    `mask` (6,), along the axes of `frame` ('base', 'tip' or 'target'). The norms are in [m] and [rad]; the latter is None for a
    position.
    """
    raw = raw_error(T, target, frame)
    e = raw.copy()
    if free_turn is not None and target.ndim == 2:
        now, wanted = T[:3, :3] @ free_turn, target[:3, :3] @ free_turn
        across, cosine = np.cross(now, wanted), float(now @ wanted)
        if np.linalg.norm(across) < 1e-9 and cosine < 0.0:  # For opposite axes any perpendicular axis will do.
            across = np.cross(now, np.eye(3)[np.argmin(np.abs(now))])
            angle = math.pi
        else:
            angle = math.atan2(np.linalg.norm(across), cosine)
        sine = float(np.linalg.norm(across)) or 1.0
        e[3:] = _axes(T, target, frame) @ across * (angle / sine)
    if slack is not None:
        e = np.copysign(np.maximum(np.abs(e) - slack, 0.0), e)
    if mask is not None:
        e = e * mask
    return raw, math.hypot(*e[:3].tolist()), None if target.ndim == 1 else math.hypot(*e[3:].tolist())


def _near(position: np.ndarray) -> np.ndarray:
    if np.abs(position).max() >= RIGID.far:
        raise InvalidTarget(f"a target position must stay below {RIGID.far:g} m: {position.tolist()}")
    return position


def as_matrix(pose: Any, of: str = "target", reach: float = math.inf) -> np.ndarray:
    """Return a pose given as (4, 4), as pin.SE3 or as a position (3,) (then with the identity rotation) as an array (4, 4).

    of: name of the thing at this pose, for messages. reach: the arm's reach [m]; a pose many reaches away is warned of in the log.
    Raises InvalidTarget.
    """
    T = corrected(pose, of)
    doubt_lengths(f"the pose of a {of}", float(np.abs(T if T.ndim == 1 else T[:3, 3]).max()), reach)
    if T.ndim == 2:
        return T
    made = np.eye(4)
    made[:3, 3] = T
    return made


def as_array(target: Any, base: str = "") -> Any:
    """Convert a pin.SE3 or a ROS message (or a dict of its fields, see `ros.read_pose`) to an array; return other values unchanged.

    Raises InvalidTarget, also for a dict with other fields.
    """
    if isinstance(target, np.ndarray | list | tuple):
        return target
    if hasattr(target, "homogeneous"):
        return target.homogeneous
    found = read_pose(target, base)
    if found is None and listed_poses(target) is not None:
        raise InvalidTarget(
            "one pose is needed, and this message has a list of them: give it to solve_batch or solve_path"
        )
    if found is None and isinstance(target, Mapping):
        raise InvalidTarget(
            "a pose that is a dict has the fields of a ROS message, position (x, y, z) and orientation (x, y, z, w), not "
            f"{' '.join(repr(target).split())[:120]}"
        )
    if found is None:
        return target
    position, quat = found
    if quat is None:
        return position
    if not np.isfinite([*position, *quat]).all():
        # A message with NaN has no usable pose. It becomes a pose of NaN, which a tracker skips, rather than an error.
        return np.full((4, 4), np.nan)
    return pose(position, quat_xyzw=quat)


def row_hint(shape: tuple[int, ...]) -> str:
    """Return advice on how to give a pose that was given as 6 or 7 numbers, for the end of an error message.

    shape: shape of the array that was given; for any other shape the text is ''.
    """
    given = {6: "rpy", 7: "quat_xyzw"}.get(shape[-1] if shape else 0)
    return f"; the numbers of a row go into ik.pose(xyz=, {given}=)" if given else ""


def check_target(target: Any, base: str = "", of: str = "target") -> tuple[np.ndarray, str]:
    """Validate a target; return it as float64 (4, 4) or (3,), and a sentence on the correction made, or ''.

    Accepts a (4, 4) array, a (3,) position, anything with a `homogeneous` attribute (pin.SE3) and ROS messages, whose frame
    must be `base` where both are given. A rotation matrix whose singular values are within 1e-2 of 1 is projected to the nearest
    rotation, and the sentence says so. of: name of the thing at this pose, for messages. Raises InvalidTarget for anything else.
    """
    needed = f"{'a target' if of == 'target' else f'the pose of a {of}'} must be {FORMS}"
    T = floats(as_array(target, base), needed, InvalidTarget)
    if T.shape == (3,):
        return _near(finite_numbers(T, 3, f"{of} position")), ""
    if T.shape != (4, 4):
        hint = row_hint(T.shape)
        if T.shape[1:] in ((4, 4), (3,)) and of == "target":
            hint = "; solve_batch takes many targets, solve_path gives one motion through them"
        raise InvalidTarget(f"{needed}, not an array of shape {T.shape}{hint}")
    if not np.isfinite(T).all():
        raise InvalidTarget(f"the {of} pose has entries that are not finite numbers")
    if np.abs(T[3] - LAST).max() > RIGID.last_row:
        hint = "; the pose looks transposed" if np.abs(T[:, 3] - LAST).max() <= RIGID.last_row else ""
        raise InvalidTarget(f"the last row of a pose must be 0 0 0 1, not {T[3].tolist()}{hint}")
    T[3] = LAST
    _near(T[:3, 3])
    R, off = nearest_rotation(T[:3, :3])
    if off > PROJECT_WITHIN or np.linalg.det(T[:3, :3]) < 0.0:
        size = np.linalg.det(T[:3, :3])
        why = f"a singular value is off 1 by {off:.3g}, and only deviations up to {PROJECT_WITHIN:g} are projected to a rotation"
        if size < 0.0:
            why = "it mirrors, as left-handed axes do; turn one of its axes round"
        raise InvalidTarget(f"the {of}'s rotation is not rigid (determinant {size:.4g}): {why}")
    notice = ""
    if off > 1e-6:
        notice = f"the {of}'s rotation was off by {off:.2g} and was projected to the nearest rotation"
    if off > 1e-12:
        T[:3, :3] = R
    return T, notice


def corrected(target: Any, of: str = "target") -> np.ndarray:
    """Validate a target (pose, position or ROS message); return it as (4, 4) or (3,), and log a correction that was made to it."""
    T, notice = check_target(target, of=of)
    if notice:
        logging.getLogger("ik_toolkit").warning("%s", notice)
    return T
