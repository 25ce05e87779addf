"""References along simple shapes: a line, a circle and a Lissajous figure."""

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from ..errors import InvalidOption, InvalidTarget, floats, whole
from ..robot.pose import check_target
from ..validate import number, positive
from .reference import Reference, Samples, law_of, log, on_path, split


def line(start: Any, end: Any, *, duration: float, law: str = "constant", rounds: int = 0) -> Reference:
    """Make a moving target (Reference) along a straight line; its orientation turns in proportion about one fixed axis.

    Args:
        start: First pose (4, 4) or position (3,), base frame [m].
        end: Last pose or position, of the same kind.
        duration: Time for the whole motion [s].
        law: "constant" speed, or "minimum-jerk" from rest to rest.
        rounds: 0 moves once from start to end. Any other number goes there and back that many times with the time law
            (1 - cos) / 2, which is at rest at both ends; `law` is then not used.

    Returns:
        The reference.

    Raises:
        InvalidTarget: start or end is neither a pose nor a position, or they are of different kinds.
        InvalidOption: There is no such law, or duration or rounds is out of range.
    """
    (p0, R0), (p1, R1) = split(start), split(end)
    if (R0 is None) != (R1 is None):
        raise InvalidTarget("a line needs two poses or two positions, not one of each")
    turn = log(R0.T @ R1) if R0 is not None and R1 is not None else None
    d = p1 - p0
    rounds = whole(rounds, "rounds", 0)
    pace = partial(_there_and_back, 2 * np.pi * rounds) if rounds else law_of(law)
    return on_path(partial(_straight, p0, d), pace, duration, R0, "line", turn)


def _straight(p: np.ndarray, d: np.ndarray, s: np.ndarray) -> Samples:
    """Return the points p + s d (N, 3) of a straight line at s (N,), and their first two derivatives with respect to s."""
    return p + s[:, None] * d, np.broadcast_to(d, (len(s), 3)), np.zeros((len(s), 3))


def _there_and_back(k: float, x: np.ndarray) -> Samples:
    """Return the time law (1 - cos(k x)) / 2 at x (N,) and its two derivatives; k is 2 pi times the round trips."""
    return 0.5 * (1 - np.cos(k * x)), 0.5 * k * np.sin(k * x), 0.5 * k * k * np.cos(k * x)


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
    """Make a moving target (Reference) along a circle, at a fixed orientation.

    Give either start or center. If center is given, the motion starts at distance `radius` from it, in the direction of
    the base x axis projected into the plane of the circle (of the y axis if x is the normal).

    Args:
        start: First pose (4, 4) or position (3,) of the tip, base frame [m].
        radius: Radius of the circle [m].
        center: Centre of the circle, as a pose or position, base frame [m].
        normal: Normal (3,) of the plane of the circle, base axes.
        turns: Number of turns, counter-clockwise about the normal if positive.
        duration: Time for all turns [s].
        law: "constant" speed, or "minimum-jerk" from rest to rest.

    Returns:
        The reference.

    Raises:
        InvalidTarget: start or center is neither a pose nor a position.
        InvalidOption: Both or neither of start and center are given, there is no such law, or a number is out of range.
    """
    if (start is None) == (center is None):
        raise InvalidOption("a circle needs either start= or center=")
    radius = positive(radius, "radius [m]")
    p, R0 = split(start if center is None else center)
    u, w = plane(normal)
    c = p - radius * u if center is None else p
    k = 2 * np.pi * number(turns, "turns")
    return on_path(partial(_round, c, radius, u, w, k), law_of(law), duration, R0, "circle")


def _round(c: np.ndarray, radius: float, u: np.ndarray, w: np.ndarray, k: float, s: np.ndarray) -> Samples:
    """Return the points (N, 3) of a circle about c at the angles k s [rad], s (N,), and two derivatives with respect to s.

    u and w (3,) are orthogonal unit vectors in the plane of the circle; the angle is measured from u towards w.
    """
    x, y = radius * np.cos(k * s)[:, None] * u, radius * np.sin(k * s)[:, None] * w
    x1, y1 = radius * np.sin(k * s)[:, None] * u, radius * np.cos(k * s)[:, None] * w
    return c + x + y, k * (y1 - x1), -k * k * (x + y)


def plane(normal: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """Return two unit vectors (3,) orthogonal to `normal` and to each other.

    The first is the base x axis projected into the plane normal to `normal` (the base y axis if x is nearly the normal). The second
    makes them right-handed with the normal. Raises InvalidOption if the normal is zero or no vector (3,).
    """
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
    """Make a moving target (Reference) along a Lissajous figure, at a fixed orientation.

    Along each base axis the tip is amplitude * sin(2 pi cycles s + phase) from the centre, where s goes from 0 to 1.
    The default is a figure of eight in the horizontal plane through the centre.

    Args:
        center: Centre of the figure, as a pose (4, 4) or position (3,), base frame [m].
        amplitudes: (3,) amplitudes along the base axes [m].
        cycles: (3,) numbers of periods along the base axes.
        phases: (3,) phases along the base axes at the start [rad].
        duration: Time for the whole figure [s].
        law: "constant" speed of s, or "minimum-jerk" from rest to rest.

    Returns:
        The reference.

    Raises:
        InvalidTarget: center is neither a pose nor a position.
        InvalidOption: There is no such law, or a number is out of range.
    """
    p, R0 = split(center)
    amp, cyc, pha = (
        _three(x, name) for x, name in ((amplitudes, "amplitudes"), (cycles, "cycles"), (phases, "phases"))
    )
    return on_path(partial(_swinging, p, amp, 2 * np.pi * cyc, pha), law_of(law), duration, R0, "lissajous")


def _swinging(p: np.ndarray, amp: np.ndarray, k: np.ndarray, phase: np.ndarray, s: np.ndarray) -> Samples:
    """Return the points p + amp sin(k s + phase) (N, 3) of a Lissajous figure, and their first two derivatives."""
    angle = k * s[:, None] + phase
    return p + amp * np.sin(angle), amp * k * np.cos(angle), -amp * k * k * np.sin(angle)


def _three(values: Sequence[float], name: str) -> np.ndarray:
    """Return three finite numbers as an array (3,); raise InvalidOption, which calls them `name`, for anything else."""
    array = floats(values, f"{name} must be 3 numbers, one per base axis", InvalidOption)
    if array.shape != (3,) or not np.isfinite(array).all():
        raise InvalidOption(f"{name} must be 3 finite numbers, one per base axis, not {values!r}")
    return array
