"""References: where the tip should be at time t, with exact velocity and acceleration.

All in the robot's base axes. A reference made from a pose (4, 4) asks for position and orientation; one made from a
position (3,) leaves the orientation free.
"""

import csv
import itertools
import math
import os
import zipfile
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InvalidOption, InvalidTarget, MissingExtra, floats, near_match
from ..robot.pose import check_target, quat_matrix
from .inputs import number, one_of, positive

Samples = tuple[np.ndarray, np.ndarray, np.ndarray]  # values, first and second derivatives
MAX_STEPS = 1e7
SHORTEST = 1e-100  # [s] between points of a spline: third powers of that, and of its inverse, are still numbers
RADIAN_AS_METRES = 0.25  # weight of a rotation against a distance when waypoints share out the time


class Reference:
    """A moving target.

    function(t) with t (N,) [s] returns T_base_tip (N, 4, 4) [m], twist (N, 6) and acceleration (N, 6): linear velocity
    (acceleration) of the tip point, then angular velocity (acceleration), base axes. With position_only the rotation of T
    is ignored and the angular parts should be zero. duration [s] is how long a run lasts.
    """

    def __init__(
        self,
        function: Callable[[np.ndarray], Samples],
        duration: float,
        *,
        position_only: bool = False,
        name: str = "custom",
    ) -> None:
        """Wrap a function of time. Raises InvalidOption when it is none, or the duration is not a positive number."""
        if not callable(function):
            raise InvalidOption(f"a reference is made from a function of time, not {type(function).__name__}")
        self.duration = positive(duration, "duration [s]")
        self.function = function
        self.position_only = position_only
        self.name = name

    def at(self, t: Any) -> Samples:
        """Pose, twist and acceleration at t [s]: (4, 4), (6,), (6,) for a number, with a leading N for an array (N,)."""
        times = np.atleast_1d(floats(t, "t must be times [s]", InvalidOption))
        if times.ndim > 1 or not np.isfinite(times).all():
            raise InvalidOption(f"t must be a finite number or an array (N,) of them [s], not {repr(t)[:60]}")
        n = len(times)
        wanted = f"reference '{self.name}' must give arrays ({n}, 4, 4), ({n}, 6), ({n}, 6) for {n} times"
        made = self.function(times)
        if not (isinstance(made, tuple | list) and len(made) == 3):
            raise InvalidTarget(f"{wanted}, not {type(made).__name__}")
        T, V, A = (floats(part, wanted, InvalidTarget) for part in made)
        if (T.shape, V.shape, A.shape) != ((n, 4, 4), (n, 6), (n, 6)):
            raise InvalidTarget(f"{wanted}, not {T.shape}, {V.shape}, {A.shape}")
        return (T, V, A) if np.ndim(t) else (T[0], V[0], A[0])

    def target(self, t: float) -> np.ndarray:
        """Target at t as the solvers take it: (4, 4), or (3,) when the orientation is free."""
        T = self.at(number(t, "t [s]"))[0]
        return T[:3, 3].copy() if self.position_only else T

    def times(self, dt: float) -> np.ndarray:
        """Sample times 0, dt, ... up to the duration [s]. Raises InvalidOption beyond ten million of them."""
        steps = self.duration / positive(dt, "dt [s]")
        if steps > MAX_STEPS:
            raise InvalidOption(
                f"dt = {dt:g} s makes {steps:.3g} steps of {self.duration:g} s; at most {MAX_STEPS:g} are taken"
            )
        return np.arange(math.floor(steps + 1e-9) + 1) * dt

    def __repr__(self) -> str:
        """One line: kind, duration and what is asked for."""
        return f"Reference({self.name}, {self.duration:g} s, {'position' if self.position_only else 'pose'})"


# ------------------------------------------------------------------------------------------------ time laws
def _constant(x: np.ndarray) -> Samples:
    return x, np.ones_like(x), np.zeros_like(x)


def _minimum_jerk(x: np.ndarray) -> Samples:
    """Rest to rest with the least integral of squared jerk (Flash and Hogan, 1985)."""
    x = np.clip(x, 0.0, 1.0)
    return x**3 * (10 - 15 * x + 6 * x * x), 30 * x * x * (1 - x) ** 2, 60 * x * (1 - x) * (1 - 2 * x)


LAWS = {"constant": _constant, "minimum-jerk": _minimum_jerk}


def _law(name: str) -> Callable[[np.ndarray], Samples]:
    return LAWS[one_of(name, LAWS, "time law")]


def _on_path(
    path: Callable[[np.ndarray], Samples],
    law: Callable[[np.ndarray], Samples],
    duration: float,
    R0: np.ndarray | None,
    name: str,
    turn: np.ndarray | None = None,
) -> Reference:
    """Reference along path(s), s in 0..1, with s = law(t / duration); turn: rotation vector in the frame R0, times s."""
    duration = positive(duration, "duration [s]")

    def function(t: np.ndarray) -> Samples:
        s, s1, s2 = law(t / duration)
        s1, s2 = (s1 / duration)[:, None], (s2 / duration**2)[:, None]
        p, p1, p2 = path(s)
        T, V, A = _still(len(t), R0)
        T[:, :3, 3] = p
        V[:, :3] = p1 * s1
        A[:, :3] = p2 * s1**2 + p1 * s2
        if turn is not None and R0 is not None:
            T[:, :3, :3] = R0 @ _exp(s[:, None] * turn)
            V[:, 3:] = (R0 @ turn) * s1
            A[:, 3:] = (R0 @ turn) * s2
        return T, V, A

    return Reference(function, duration, position_only=R0 is None, name=name)


def _still(count: int, R0: np.ndarray | None) -> Samples:
    T = np.zeros((count, 4, 4))
    T[:, :3, :3] = np.eye(3) if R0 is None else R0
    T[:, 3, 3] = 1.0
    return T, np.zeros((count, 6)), np.zeros((count, 6))


def _exp(w: np.ndarray) -> np.ndarray:
    """Rotations (N, 3, 3) of rotation vectors (N, 3)."""
    angle = np.linalg.norm(w, axis=1)[:, None, None]
    K = np.zeros((len(w), 3, 3))
    K[:, 0, 1], K[:, 0, 2], K[:, 1, 2] = -w[:, 2], w[:, 1], -w[:, 0]
    K -= np.swapaxes(K, 1, 2)
    half = np.sinc(angle / (2 * np.pi))  # sin(x/2) / (x/2)
    return np.eye(3) + np.sinc(angle / np.pi) * K + 0.5 * half * half * (K @ K)


def _log(R: np.ndarray) -> np.ndarray:
    """Rotation vector (3,) of a rotation (3, 3)."""
    import pinocchio as pin

    return pin.log3(np.asarray(R))


def _split(target: Any) -> tuple[np.ndarray, np.ndarray | None]:
    T, _ = check_target(target)
    return (T, None) if T.ndim == 1 else (T[:3, 3].copy(), T[:3, :3].copy())


# ------------------------------------------------------------------------------------------------ shapes
def line(start: Any, end: Any, *, duration: float, law: str = "constant", rounds: int = 0) -> Reference:
    """Straight line from start to end (both poses or both positions, base frame [m]), the orientation turning about one axis.

    law: "constant" speed or "minimum-jerk" (rest to rest). rounds > 0 goes there and back that many times, with s =
    (1 - cos) / 2, so the line is retraced and the speed is zero at both ends; law is then not used. Raises InvalidTarget,
    InvalidOption.
    """
    (p0, R0), (p1, R1) = _split(start), _split(end)
    if (R0 is None) != (R1 is None):
        raise InvalidTarget("a line needs two poses or two positions, not one of each")
    turn = _log(R0.T @ R1) if R0 is not None and R1 is not None else None
    d = p1 - p0

    def path(s: np.ndarray) -> Samples:
        return p0 + s[:, None] * d, np.broadcast_to(d, (len(s), 3)), np.zeros((len(s), 3))

    def there_and_back(x: np.ndarray) -> Samples:
        k = 2 * np.pi * rounds
        return 0.5 * (1 - np.cos(k * x)), 0.5 * k * np.sin(k * x), 0.5 * k * k * np.cos(k * x)

    times = number(rounds, "rounds")
    if times < 0 or not times.is_integer():
        raise InvalidOption(f"rounds must be 0 or a whole number above, not {times:g}")
    return _on_path(path, there_and_back if rounds else _law(law), duration, R0, "line", turn)


def circle(
    start: Any = None,
    radius: float = 0.1,
    *,
    center: Any = None,
    normal: Sequence[float] = (0.0, 0.0, 1.0),
    turns: float = 1.0,
    duration: float = 10.0,
    law: str = "constant",
) -> Reference:
    """Circle of `radius` [m] about `normal` (base axes), counter-clockwise for turns > 0, at a fixed orientation.

    Give start (the tip's first pose or position; the centre lies `radius` back along the base x axis laid into the plane,
    y where x is the normal) or center (the start is then `radius` ahead of it). Raises InvalidTarget, InvalidOption.
    """
    if (start is None) == (center is None):
        raise InvalidOption("a circle needs either start= or center=")
    radius = positive(radius, "radius [m]")
    p, R0 = _split(start if center is None else center)
    u, w = _plane(normal)
    c = p - radius * u if center is None else p
    k = 2 * np.pi * number(turns, "turns")

    def path(s: np.ndarray) -> Samples:
        x, y = radius * np.cos(k * s)[:, None] * u, radius * np.sin(k * s)[:, None] * w
        x1, y1 = radius * np.sin(k * s)[:, None] * u, radius * np.cos(k * s)[:, None] * w
        return c + x + y, k * (y1 - x1), -k * k * (x + y)

    return _on_path(path, _law(law), duration, R0, "circle")


def _plane(normal: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors across `normal`, the first as near to base x as possible (y where x is the normal)."""
    n = check_target(normal)[0]
    if n.shape != (3,) or not np.linalg.norm(n) > 1e-12:
        raise InvalidOption(f"normal must be a direction of 3 numbers, not {normal!r}")
    n = n / np.linalg.norm(n)
    axis = np.array([1.0, 0.0, 0.0]) if abs(n[0]) < 0.99 else np.array([0.0, 1.0, 0.0])
    u = axis - (axis @ n) * n
    u /= np.linalg.norm(u)
    return u, np.cross(n, u)


def lissajous(
    center: Any,
    amplitudes: Sequence[float] = (0.1, 0.1, 0.0),
    *,
    cycles: Sequence[float] = (1.0, 2.0, 1.0),
    phases: Sequence[float] = (0.0, 0.0, 0.0),
    duration: float = 10.0,
    law: str = "constant",
) -> Reference:
    """Lissajous figure about `center` (pose or position): amplitude [m], cycles and phase [rad] along each base axis.

    The default is a figure of eight in the horizontal plane through the centre. Raises InvalidTarget, InvalidOption.
    """
    p, R0 = _split(center)
    amp, cyc, pha = (
        _three(x, name) for x, name in ((amplitudes, "amplitudes"), (cycles, "cycles"), (phases, "phases"))
    )
    k = 2 * np.pi * cyc

    def path(s: np.ndarray) -> Samples:
        angle = k * s[:, None] + pha
        return p + amp * np.sin(angle), amp * k * np.cos(angle), -amp * k * k * np.sin(angle)

    return _on_path(path, _law(law), duration, R0, "lissajous")


def _three(values: Sequence[float], name: str) -> np.ndarray:
    array = floats(values, f"{name} must be 3 numbers, one per base axis", InvalidOption)
    if array.shape != (3,) or not np.isfinite(array).all():
        raise InvalidOption(f"{name} must be 3 finite numbers, one per base axis, not {values!r}")
    return array


def waypoints(
    targets: Sequence[Any],
    *,
    duration: float | None = None,
    times: Sequence[float] | None = None,
    law: str = "minimum-jerk",
) -> Reference:
    """Through poses (or positions) in order: "minimum-jerk" stops at each on straight legs, "spline" passes without stopping.

    times [s], increasing from 0, one per target; or a duration, shared by distance (1 rad counts as 0.25 m). The spline
    (cubic, with C2 rotations) starts and ends at rest in position and needs scipy. Raises InvalidTarget, InvalidOption,
    MissingExtra.
    """
    if not isinstance(targets, Iterable):
        raise InvalidTarget(f"waypoints are a list of poses or positions, not {type(targets).__name__}")
    pairs = [_split(target) for target in targets]
    if len(pairs) < 2:
        raise InvalidTarget(f"waypoints need at least 2 targets, not {len(pairs)}")
    if len({R is None for _, R in pairs}) > 1:
        raise InvalidTarget("waypoints must be all poses or all positions")
    P = np.array([p for p, _ in pairs])
    R = None if pairs[0][1] is None else np.array([R for _, R in pairs])
    turns = np.zeros((len(P) - 1, 3)) if R is None else np.array([_log(a.T @ b) for a, b in itertools.pairwise(R)])
    if (times is None) == (duration is None):
        raise InvalidOption("waypoints need either times= or duration=")
    if times is None:
        share = np.linalg.norm(np.diff(P, axis=0), axis=1) + RADIAN_AS_METRES * np.linalg.norm(turns, axis=1)
        if not (share > 1e-12).all():
            raise InvalidTarget(f"waypoints {int(np.argmin(share))} and {int(np.argmin(share)) + 1} are the same")
        t = np.concatenate([[0.0], np.cumsum(share)]) / share.sum() * positive(duration, "duration [s]")
    else:
        t = _check_times(floats(times, "times must be numbers [s]", InvalidTarget), len(P), "times")
    if one_of(law, ("minimum-jerk", "spline"), "waypoint law") == "spline":
        return _spline(t, P, R, "clamped", "waypoints")

    def function(now: np.ndarray) -> Samples:
        leg = np.clip(np.searchsorted(t, now, side="right") - 1, 0, len(t) - 2)
        length = np.diff(t)[leg]
        s, s1, s2 = (x[:, None] for x in _minimum_jerk((now - t[leg]) / length))
        s1, s2 = s1 / length[:, None], s2 / length[:, None] ** 2
        T, V, A = _still(len(now), None)
        d = np.diff(P, axis=0)[leg]
        T[:, :3, 3] = P[leg] + s * d
        V[:, :3], A[:, :3] = d * s1, d * s2
        if R is not None:
            w = np.einsum("nij,nj->ni", R[leg], turns[leg])
            T[:, :3, :3] = R[leg] @ _exp(s * turns[leg])
            V[:, 3:], A[:, 3:] = w * s1, w * s2
        return T, V, A

    return Reference(function, float(t[-1]), position_only=R is None, name="waypoints")


def _check_times(t: np.ndarray, count: int, name: str) -> np.ndarray:
    if t.shape != (count,):
        raise InvalidTarget(f"{name} must be {count} numbers, one per pose, not an array of shape {t.shape}")
    if not np.isfinite(t).all():
        raise InvalidTarget(f"{name} has a value that is not finite (number {int(np.argmin(np.isfinite(t))) + 1})")
    if not (np.diff(t) > 0.0).all():
        i = int(np.argmin(np.diff(t)))
        raise InvalidTarget(f"{name} must increase: number {i + 2} is {t[i + 1]:g} after {t[i]:g}")
    return t - t[0]


def _spline(t: np.ndarray, P: np.ndarray, R: np.ndarray | None, ends: str, name: str) -> Reference:
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

    def function(now: np.ndarray) -> Samples:
        now = np.clip(now, 0.0, t[-1])
        T, V, A = _still(len(now), None)
        T[:, :3, 3], V[:, :3], A[:, :3] = position(now), position(now, 1), position(now, 2)
        if rotation is not None:
            T[:, :3, :3] = rotation(now).as_matrix()
            # scipy gives rate and acceleration in the axes of the moving frame
            V[:, 3:] = np.einsum("nij,nj->ni", T[:, :3, :3], rotation(now, 1))
            A[:, 3:] = np.einsum("nij,nj->ni", T[:, :3, :3], rotation(now, 2))
        return T, V, A

    return Reference(function, float(t[-1]), position_only=R is None, name=name)


# ------------------------------------------------------------------------------------------------ files
def reference_from_file(path: str | Path) -> Reference:
    """Read a reference from CSV (header t,x,y,z and optionally qx,qy,qz,qw) or NPZ (t, xyz, optionally quat_xyzw).

    Times [s] increase (the first becomes 0), positions in the base frame [m]; a cubic spline goes through the samples, so
    velocity and acceleration are those of the spline. Needs scipy. Raises InvalidTarget, with the row, for a bad file.
    """
    if not isinstance(path, str | os.PathLike):
        raise InvalidTarget(f"a reference file is named by a path, not {type(path).__name__}")
    file = Path(path)
    if not file.is_file():
        raise InvalidTarget(f"no reference file '{file}'")
    try:
        columns = _read_npz(file) if file.suffix.lower() == ".npz" else _read_csv(file)
    except (OSError, UnicodeDecodeError, EOFError, csv.Error, zipfile.BadZipFile) as error:
        raise InvalidTarget(f"cannot read '{file.name}': {error}") from None
    t, xyz, quat = columns
    if len(t) < 2:
        raise InvalidTarget(f"'{file.name}' has {len(t)} row(s); a path needs at least 2")
    t = _check_times(t, len(xyz), f"'{file.name}': t")
    for name, array in (("xyz", xyz), ("quat_xyzw", quat)):
        if array is not None and not np.isfinite(array).all():
            row = int(np.argmin(np.isfinite(array).all(axis=1)))
            raise InvalidTarget(f"'{file.name}': {name} of row {row + 1} is not finite")
    R = None
    if quat is not None:
        length = np.linalg.norm(quat, axis=1)
        if not (np.abs(length - 1.0) < 1e-2).all():
            row = int(np.argmax(np.abs(length - 1.0)))
            raise InvalidTarget(f"'{file.name}': quat_xyzw of row {row + 1} has length {length[row]:.4g}, not 1")
        R = np.array([quat_matrix(q) for q in quat])
    return _spline(t, xyz, R, "not-a-knot", file.name)


def _read_csv(file: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    with file.open(newline="", encoding="utf-8-sig") as stream:
        rows = [row for row in csv.reader(stream) if row and any(cell.strip() for cell in row)]
    if not rows:
        raise InvalidTarget(f"'{file.name}' is empty")
    header = [cell.strip().lower() for cell in rows[0]]
    missing = [name for name in ("t", "x", "y", "z") if name not in header]
    if missing:
        wanted = "the header must be t,x,y,z[,qx,qy,qz,qw]"
        raise InvalidTarget(f"'{file.name}' has no column {', '.join(missing)}; {wanted}, not {','.join(header)}")
    quat = [name for name in ("qx", "qy", "qz", "qw") if name in header]
    if quat and len(quat) < 4:
        raise InvalidTarget(f"'{file.name}' has only {', '.join(quat)} of the quaternion qx,qy,qz,qw")
    wanted = ["t", "x", "y", "z", *quat]
    values = np.empty((len(rows) - 1, len(wanted)))
    for i, row in enumerate(rows[1:]):
        for j, name in enumerate(wanted):
            try:
                values[i, j] = float(row[header.index(name)])
            except (ValueError, IndexError):
                raise InvalidTarget(f"'{file.name}': row {i + 1} has no number in column {name}") from None
    return values[:, 0], values[:, 1:4], values[:, 4:] if quat else None


def _read_npz(file: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    try:
        with file.open("rb") as stream, np.load(stream, allow_pickle=False) as data:
            found = {name: np.asarray(data[name], dtype=float) for name in ("t", "xyz", "quat_xyzw") if name in data}
            names = list(data)
    except (ValueError, TypeError) as error:
        raise InvalidTarget(f"cannot read '{file.name}': {error}") from None
    for name, width in (("t", None), ("xyz", 3)):
        if name not in found:
            raise InvalidTarget(f"'{file.name}' has no array '{name}'.{near_match(name, names)}")
        if width and (found[name].ndim != 2 or found[name].shape[1] != width):
            raise InvalidTarget(f"'{file.name}': {name} must have shape (N, {width}), not {found[name].shape}")
    quat = found.get("quat_xyzw")
    if quat is not None and quat.shape != (len(found["xyz"]), 4):
        raise InvalidTarget(f"'{file.name}': quat_xyzw must have shape ({len(found['xyz'])}, 4), not {quat.shape}")
    return found["t"], found["xyz"], quat
