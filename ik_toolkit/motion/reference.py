"""References: where a tip should be at time t, with exact velocity and acceleration, in the robot's base axes.

A reference made from poses (4, 4) asks for position and orientation; one made from positions (3,) leaves the
orientation free.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin

from ..copying import Holds
from ..errors import InvalidOption, InvalidTarget, floats
from ..kernel.checks import RIGID
from ..kernel.counted_error import KIND
from ..robot.pose import PROJECT_WITHIN, corrected
from ..validate import number, one_of, positive, switch

# N samples of a path coordinate s and its first and second derivatives, or of poses (N, 4, 4), twists (N, 6) and accelerations (N,
# 6)
Samples = tuple[np.ndarray, np.ndarray, np.ndarray]
MAX_STEPS = 1e7  # largest number of samples of a moving target; that many already take over 1 GB of memory


class Reference(Holds):
    """A moving target for one tip. Its attributes are the arguments that it was made from.

    Args:
        function: Takes times t (N,) [s]; returns poses T_base_tip (N, 4, 4) [m], twists (N, 6) [m/s, rad/s] and
            accelerations (N, 6) [m/s^2, rad/s^2], each with the linear part of the tip point first, then the angular
            part, in base axes.
        duration: How long a run lasts [s].
        position_only: Leave the orientation free. The rotation of T is then ignored, and the angular parts should be
            zero.
        name: A short name for messages.

    Raises:
        InvalidOption: function cannot be called, duration is not a positive number below 1e100, or position_only not True or False.
    """

    FUNCTION = "function"

    def __init__(
        self,
        function: Callable[[np.ndarray], Samples],
        duration: float,
        *,
        position_only: bool = False,
        name: str = "custom",
    ) -> None:
        """Wrap a function of time; the arguments are described in the docstring of the class."""
        if not callable(function):
            raise InvalidOption(f"a reference is made from a function of time, not {type(function).__name__}")
        self.duration = positive(duration, "duration [s]")
        self.function = function
        self.position_only = switch(position_only, "position_only")
        self.name = name

    def at(self, t: Any) -> Samples:
        """Evaluate the reference.

        Args:
            t: A time [s], or an array (N,) of times.

        Returns:
            The pose T_base_tip (4, 4) [m], twist (6,) [m/s, rad/s] and acceleration (6,) [m/s^2, rad/s^2], linear part
                first, in base axes. For an array of times each has a leading N.

        Raises:
            InvalidOption: t is not finite or has the wrong shape.
            InvalidTarget: The reference's function returned arrays of the wrong shape.
        """
        times = read_times(t)
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
        """Return the target at t [s] as solvers take it: a pose (4, 4) [m], or position (3,) if orientation is free."""
        T = self.at(number(t, "t [s]"))[0]
        return T[:3, 3].copy() if self.position_only else T

    def times(self, dt: float) -> np.ndarray:
        """Return the sample times 0, dt, ... up to the duration (N,) [s].

        Raises:
            InvalidOption: dt [s] is not positive, or makes more than ten million samples.
        """
        steps = self.duration / positive(dt, "dt [s]")
        if steps > MAX_STEPS:
            raise InvalidOption(
                f"dt = {dt:g} s makes {steps:.3g} steps of {self.duration:g} s; at most {MAX_STEPS:g} are taken"
            )
        return np.arange(math.floor(steps + 1e-9) + 1) * dt

    def __repr__(self) -> str:
        """Return a line with the name, the duration and whether poses or positions are asked for."""
        return f"Reference({self.name}, {self.duration:g} s, {'position' if self.position_only else 'pose'})"


def read_times(t: Any) -> np.ndarray:
    """Return one time or several [s] as an array (N,). Raises InvalidOption if they are not finite or have the wrong shape."""
    times = np.atleast_1d(floats(t, "t must be times [s]", InvalidOption))
    if times.ndim > 1 or not np.isfinite(times).all():
        raise InvalidOption(f"t must be a finite number or an array (N,) of them [s], not {repr(t)[:60]}")
    return times


def checked(reference: Reference, times: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sample a reference and check that every sample is a valid target.

    Args:
        reference: The reference to sample.
        times: Times (N,) [s].

    Returns:
        Poses (N, 4, 4) [m], twists (N, 6) and accelerations (N, 6), as from `Reference.at`.

    Raises:
        InvalidTarget: A sample is not finite, or is not a rigid transform; the message names its time.
    """
    T, V, A = reference.at(times)
    used = T[:, :3, 3] if reference.position_only else T.reshape(len(T), 16)
    bad = ~(np.abs(np.hstack([used, V, A])) < RIGID.far).all(axis=1)
    what = f"is not finite, or beyond {RIGID.far:g},"
    # Each pose must be a rigid transform, to the same accuracy as a single target in `check_target`.
    if not (bad.any() or reference.position_only):
        R = T[:, :3, :3]
        bad = np.abs(T[:, 3] - (0.0, 0.0, 0.0, 1.0)).max(axis=1) > 1e-9
        # Wherever a singular value of R differs from 1 by PROJECT_WITHIN, an entry of R^T R - I exceeds a third of PROJECT_WITHIN.
        # Testing that first avoids the singular value decomposition for most samples.
        doubtful = np.abs(R.transpose(0, 2, 1) @ R - np.eye(3)).max(axis=(1, 2)) > PROJECT_WITHIN / 3.0
        bad[doubtful] |= np.abs(np.linalg.svd(R[doubtful], compute_uv=False) - 1.0).max(axis=1) > PROJECT_WITHIN
        bad |= np.linalg.det(R) < 0.0
        what = "is no pose (a rotation, a position and the last row 0 0 0 1)"
    if bad.any():
        raise InvalidTarget(f"reference '{reference.name}' {what} at t = {times[int(np.argmax(bad))]:g} s")
    return T, V, A


# ------------------------------------------------------------------------------------------------ time laws
def _constant(x: np.ndarray) -> Samples:
    """Return the time law of constant speed, s = x, and its two derivatives with respect to x (N,), the time over the duration."""
    return x, np.ones_like(x), np.zeros_like(x)


def minimum_jerk(x: np.ndarray) -> Samples:
    """Return the path coordinate s, from 0 to 1, of the minimum-jerk time law from rest to rest, and its derivatives by x.

    It has the least integral of squared jerk. x (N,) is the time divided by the duration; values outside 0 to 1 are clipped.
    Source: Flash and Hogan (1985).
    """
    x = np.clip(x, 0.0, 1.0)
    return x**3 * (10 - 15 * x + 6 * x * x), 30 * x * x * (1 - x) ** 2, 60 * x * (1 - x) * (1 - 2 * x)


LAWS = {"constant": _constant, "minimum-jerk": minimum_jerk}


def law_of(name: str) -> Callable[[np.ndarray], Samples]:
    """Return the time law, a function, called `name` ("constant" or "minimum-jerk"). Raises InvalidOption for other names."""
    return LAWS[one_of(name, LAWS, "time law")]


def on_path(
    path: Callable[[np.ndarray], Samples],
    law: Callable[[np.ndarray], Samples],
    duration: float,
    R0: np.ndarray | None,
    name: str,
    turn: np.ndarray | None = None,
) -> Reference:
    """Make a moving target (Reference) that runs along the curve path(s), where s = law(t / duration) rises from 0 to 1.

    Args:
        path: Takes s (N,); returns positions (N, 3) [m] in the base frame and their first and second derivatives with respect to s.
        law: Takes t / duration (N,); returns s (N,) and its first and second derivatives.
        duration: Time for the whole path [s].
        R0: Orientation (3, 3) at the start, or None to leave the orientation free.
        name: A short name for messages.
        turn: Rotation vector (3,) [rad], in the axes of R0, of the whole rotation; None keeps the orientation R0.

    Returns:
        The reference.
    """
    duration = positive(duration, "duration [s]")
    return Reference(partial(_along, path, law, duration, R0, turn), duration, position_only=R0 is None, name=name)


def _along(
    path: Callable, law: Callable, duration: float, R0: np.ndarray | None, turn: np.ndarray | None, t: np.ndarray
) -> Samples:
    """Sample the reference of `on_path` at the times t (N,) [s]: poses, twists and accelerations in base axes."""
    s, s1, s2 = law(t / duration)
    s1, s2 = (s1 / duration)[:, None], (s2 / duration**2)[:, None]
    p, p1, p2 = path(s)
    T, V, A = still(len(t), R0)
    T[:, :3, 3] = p
    V[:, :3] = p1 * s1
    A[:, :3] = p2 * s1**2 + p1 * s2
    if turn is not None and R0 is not None:
        T[:, :3, :3] = R0 @ exp(s[:, None] * turn)
        V[:, 3:] = (R0 @ turn) * s1
        A[:, 3:] = (R0 @ turn) * s2
    return T, V, A


def still(count: int, R0: np.ndarray | None) -> Samples:
    """Return poses (count, 4, 4), twists and accelerations of a tip that rests at the origin with rotation R0 (None: identity).

    The twists and accelerations, both (count, 6), are 0. A caller fills in what moves. R0: (3, 3).
    """
    T = np.zeros((count, 4, 4))
    T[:, :3, :3] = np.eye(3) if R0 is None else R0
    T[:, 3, 3] = 1.0
    return T, np.zeros((count, 6)), np.zeros((count, 6))


def exp(w: np.ndarray) -> np.ndarray:
    """Return the rotation matrices (N, 3, 3) of rotation vectors (N, 3) [rad], by Rodrigues' formula."""
    angle = np.linalg.norm(w, axis=1)[:, None, None]
    K = np.zeros((len(w), 3, 3))
    K[:, 0, 1], K[:, 0, 2], K[:, 1, 2] = -w[:, 2], w[:, 1], -w[:, 0]
    K -= np.swapaxes(K, 1, 2)
    half = np.sinc(angle / (2 * np.pi))  # np.sinc(x) is sin(pi x) / (pi x), so this is sin(angle/2) / (angle/2).
    return np.eye(3) + np.sinc(angle / np.pi) * K + 0.5 * half * half * (K @ K)


def log(R: np.ndarray) -> np.ndarray:
    """Return the rotation vector (3,) [rad] of a rotation matrix (3, 3)."""
    return pin.log3(np.asarray(R))


def split(target: Any) -> tuple[np.ndarray, np.ndarray | None]:
    """Return the position (3,) [m] and rotation (3, 3) of a target; the rotation is None if the target is a position.

    Raises:
        InvalidTarget: The target is neither a pose nor a position.
    """
    T = corrected(target)
    return (T, None) if T.ndim == 1 else (T[:3, 3].copy(), T[:3, :3].copy())


def interpolate_poses(T: np.ndarray, at: np.ndarray, kinds: tuple) -> np.ndarray:
    """Return interpolated poses (M, F, 4, 4) at positions `at` (M,) on the path through the poses T (N, F, 4, 4).

    F is the number of tips. Position 3.5 is halfway from pose 3 to pose 4: on the straight line, with the rotation interpolated
    about a fixed axis. `kinds` has the kind of target (KIND) of each tip; a tip whose orientation is free keeps the rotation of the
    pose before.
    """
    k = np.minimum(at.astype(int), max(len(T) - 2, 0))
    share = at - k
    made = T[k].copy()
    if len(T) < 2:
        return made
    made[..., :3, 3] += share[:, None, None] * (T[k + 1][..., :3, 3] - T[k][..., :3, 3])
    for f, kind in enumerate(kinds):
        if kind in (KIND.position, KIND.free):
            continue
        between = np.flatnonzero(share > 0.0)
        gaps, which = np.unique(k[between], return_inverse=True)
        turns = np.array([pin.log3(T[j, f, :3, :3].T @ T[j + 1, f, :3, :3]) for j in gaps.tolist()]).reshape(-1, 3)
        made[between, f, :3, :3] = T[k[between], f, :3, :3] @ exp(share[between, None] * turns[which])
    return made
