"""The Denavit-Hartenberg table of a robot: the one it was made from, or one read off its joint axes (classic)."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from ...errors import IKError
from ...robot.formats.dh import DHRow, DHTable, dh_fk, read_dh_table
from ...robot.library import shipped_robots
from ..closed_form.geometry import across, angle_about, read_screws
from .layout import Block, Sentence, Table, Variable, decimals, digits

# Two joint axes count as parallel if the sine of the angle between them is below SAME, and as meeting if their distance over the
# reach is.
SAME = 1e-7
AGREES = 1e-6  # [rad, or length / reach] largest difference allowed between table and robot


def dh_of(robot: Any) -> DHTable | None:
    """Return the Denavit-Hartenberg table of a robot, a row for each joint: from the robot's own table file or its joint axes.

    Returns None if neither reproduces the robot's kinematics, as with mimic joints, or axes that are not quite parallel.
    """
    entry = shipped_robots().get(robot.name)
    if entry is not None and entry.dh_file is not None:
        table = read_dh_table(entry.dh_file)
        if [row.name for row in table.rows] == list(robot.joint_names) and _agrees(table, robot):
            return table
    table = _from_axes(robot)
    return table if table is not None and _agrees(table, robot) else None


def _agrees(table: DHTable, robot: Any) -> bool:
    """Return whether the table's transforms multiply to the robot's forward kinematics."""
    rng = np.random.default_rng(0)
    for _ in range(3):
        q = robot.random_q(rng)
        try:
            off = np.abs(dh_fk(table, q) - robot.fk(q).homogeneous)
        except IKError:
            return False
        if off[:3, 3].max() > AGREES * robot.reach or off[:3, :3].max() > AGREES:
            return False
    return True


def dh_blocks(arm: Any, table: DHTable | None, q: np.ndarray) -> Iterator[Block]:
    """Yield the D-H table of an arm at q (n,), in mm and degrees, for display; in each row the joint's variable is marked."""
    if table is None:
        why = "axes that are parallel but for rounding lead to rows too long to compute with"
        yield Sentence(f"None: {why if arm.chain.plain else 'a joint that drives others has no row of its own'}.")
        return
    rows, places = [], decimals(arm.reach)
    for row, x in zip(table.rows, q, strict=True):
        slides = row.type == "prismatic"
        theta, d = row.theta + (0.0 if slides else x), row.d + (x if slides else 0.0)
        cells = [digits(theta, "rad", 0), digits(d, "m", places)]
        cells[slides] = Variable(cells[slides])
        cells += [digits(row.a, "m", places), f"{round(math.degrees(row.alpha), 6) + 0.0:g}"]
        rows.append((row.name, *cells))
    yield Table(("joint", "theta", "d", "a", "alpha"), rows)
    ends = {"before row 1, from the base's frame": table.base, "after the last row, to the tip's frame": table.tool}
    frames = [words for words, T in ends.items() if not np.allclose(T, np.eye(4), atol=1e-9)]
    constant = f" A constant transform stands {' and '.join(frames)}." if frames else ""
    said = "convention; joint variables are marked, with their present values"
    yield Sentence(f"{table.convention.capitalize()} {said}.{constant}")


def _from_axes(robot: Any) -> DHTable | None:
    """Read a classic table off the joint axes at q = 0.

    Where the rules leave a frame free, it is chosen as close to the previous frame as possible.
    """
    screws = read_screws(robot.chain)
    if isinstance(screws, str):
        return None
    n, near = robot.n, SAME * robot.reach
    # Frame 0 is the base frame if its z axis is the axis of joint 1.
    # Otherwise its origin is the point of that axis nearest the base's origin.
    z = screws.axis[0]
    point = screws.point[0] if screws.turns[0] else np.zeros(3)
    frame = np.eye(4)
    if np.linalg.norm(across(z, point)) > near or np.linalg.norm(z - frame[:3, 2]) > SAME:
        frame = _frame(z, _normal(z, frame[:3, 0]), across(z, point))
    base, rows = frame.copy(), []
    for i in range(n):
        before, z, x, origin = frame, frame[:3, 2], frame[:3, 0], frame[:3, 3]
        if i + 1 == n:
            frame = _last(screws.T, z, x, origin, near)
        else:
            after = screws.axis[i + 1]
            onto = screws.point[i + 1] if screws.turns[i + 1] else origin
            frame = _next(z, x, origin, after, onto, near)
        step = frame[:3, 3] - origin
        theta, alpha = angle_about(z, before[:3, 0], frame[:3, 0]), angle_about(frame[:3, 0], z, frame[:3, 2])
        theta, d, a, alpha = map(_clean, (theta, float(z @ step), float(frame[:3, 0] @ step), alpha))
        name, kind = robot.joint_names[i], "revolute" if screws.turns[i] else "prismatic"
        rows.append(DHRow(name, kind, theta, d, a, alpha, float(robot.lower[i]), float(robot.upper[i])))
    return DHTable(robot.name, "classic", tuple(rows), base, np.linalg.inv(frame) @ screws.T)


def _clean(value: float) -> float:
    """Return zero for a remainder of rounding, and any other value unchanged."""
    return 0.0 if abs(value) < 1e-12 else value


def _frame(z: np.ndarray, x: np.ndarray, origin: np.ndarray) -> np.ndarray:
    # x is made exactly perpendicular to z, because a large d in the next row of the table would multiply any rounding error.
    x = across(z, x)
    x = x / np.linalg.norm(x)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = np.column_stack([x, np.cross(z, x), z]), origin
    return T


def _normal(z: np.ndarray, like: np.ndarray) -> np.ndarray:
    """Return the unit vector perpendicular to z that is as close to `like` as possible."""
    side = across(z, like)
    if np.linalg.norm(side) < SAME:
        side = across(z, np.eye(3)[int(np.argmin(np.abs(z)))])
    return side / np.linalg.norm(side)


def _next(
    z: np.ndarray, x: np.ndarray, origin: np.ndarray, after: np.ndarray, point: np.ndarray, near: float
) -> np.ndarray:
    """Return the frame on the axis `after` through `point` whose x axis is the common normal from the axis z through `origin`."""
    # the cross product of z and the next joint axis, exact even if the two are nearly parallel, because the next axis loses its
    # part along z first
    normal = np.cross(z, after - math.copysign(1.0, z @ after) * z)
    length = float(np.linalg.norm(normal))
    if length < SAME:
        foot = across(z, point - origin)
        far = float(np.linalg.norm(foot))
        return _frame(after, foot / far if far > near else x, origin + (foot if far > near else 0.0))
    # The common normal of two joint axes meets them at origin + s z and point + t after; s and t follow from the difference of
    # these points being a multiple of the normal.
    s, t, gap = np.linalg.solve(np.column_stack([z, -after, normal]), point - origin)
    normal = normal / length
    meets = abs(gap) * length <= near
    sign = (1.0 if normal @ x >= -SAME else -1.0) if meets else math.copysign(1.0, gap)
    return _frame(after, sign * normal, origin + s * z if meets else point + t * after)


def _last(T: np.ndarray, z: np.ndarray, x: np.ndarray, origin: np.ndarray, near: float) -> np.ndarray:
    """Return the tip's own frame if one D-H row leads to it, otherwise a frame on the last axis at the point nearest the tip."""
    step = T[:3, 3] - origin
    if abs(T[:3, 0] @ z) < SAME and abs(np.cross(z, T[:3, 0]) @ step) < near:
        return T
    return _frame(z, x, origin + z * (z @ step))
