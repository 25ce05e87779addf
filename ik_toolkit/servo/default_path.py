"""A path that a robot can follow: where it starts, how large it is and which way it goes, found by trying."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import whole
from ..motion import shapes
from ..motion.reference import Reference, Samples, law_of, on_path, split
from ..robot.joints import Joints
from ..robot.pose import length
from ..validate import one_of, positive
from .path_reach import DENSE, References, pace, trace
from .result import POSITION_TOLERANCE

LENGTHS = (0.2, 0.15, 0.1, 0.075, 0.05, 0.03, 0.02, 0.01, 0.005, 0.002)  # [m] of a line; radii are half of them
SMALL = 0.15  # of the largest: below it another start or a free orientation is tried first
LARGEST = 0.25  # of the reach: longer lines are not tried
SPARE = 1.15  # times the size must be in reach as well: no path ends at the very edge
ROOM = 0.01  # of a joint's range kept from its limits where possible
EVEN = 10.0  # joint turn [rad] over tip way [reaches]: more is close to a singular configuration
COARSE = 10  # least number of poses tested while trying
DURATION = 10.0  # [s]
SPEED = 0.5  # of a joint's limit: what the path asks for at most
# Of the tolerance: how far a step straight ahead may leave the path, as the first one of `cv` does. It turns the tip as well;
# with 0.8 an arm (talos_arm at 2 Hz) kept its position, and its orientation to 0.126 degrees only.
STRAIGHT = 0.4
INSIDE = 0.1  # of a joint's range: how far from its limits the second start stands
RANK = 1e-6  # of the largest singular value: smaller ones are rounding
DRAWN, BEST = 64, 3  # random starts, and how many of them are tried
AXIS_NAMES = ("x", "y", "z", "-x", "-y", "-z")
BASE_AXES = np.vstack([np.eye(3), -np.eye(3)])


@dataclass(frozen=True)
class Placed:
    """A path and how it was chosen: start q0 (n,), size [m], axis (3,) by tip, whether the orientation is free."""

    reference: References
    q0: np.ndarray
    size: float
    axis: np.ndarray
    position_only: bool
    words: str


def eight(
    center: Any, radius: float, normal: Any, *, turns: float = 1.0, duration: float, law: str = "constant"
) -> Reference:
    """Figure of eight about a centre (pose or position) in the plane across `normal`: `radius` [m] to each side."""
    p, R0 = split(center)
    u, w = shapes.plane(normal)
    k = 2.0 * np.pi * turns

    def path(s: np.ndarray) -> Samples:
        a = k * s[:, None]
        place = p + radius * (np.sin(a) * u + 0.5 * np.sin(2.0 * a) * w)
        speed = k * radius * (np.cos(a) * u + np.cos(2.0 * a) * w)
        return place, speed, -k * k * radius * (np.sin(a) * u + 2.0 * np.sin(2.0 * a) * w)

    return on_path(path, law_of(law), duration, R0, "eight")


def draw(
    kind: str,
    at: Any,
    size: float,
    axis: Any = None,
    *,
    duration: float = DURATION,
    law: str | None = None,
    turns: float = 0.0,
) -> Reference:
    """Path of a kind (line, circle, eight) from where the tip stands (pose or position); size: its length or radius [m].

    axis: direction of a line (default base x), normal of the others (base z). turns: of circle and eight (0: one), rounds of a
    line (0: one way). law: default constant speed, of a line minimum-jerk.
    """
    if one_of(kind, KINDS, "path") == "line":
        d = np.array((1.0, 0.0, 0.0) if axis is None else axis, dtype=float)
        end = np.array(at, dtype=float)
        (end if end.ndim == 1 else end[:3, 3])[:] += size * d / np.linalg.norm(d)
        return shapes.line(
            at, end, duration=duration, law=law or "minimum-jerk", rounds=whole(turns, "rounds of a line", 0)
        )
    normal = (0.0, 0.0, 1.0) if axis is None else axis
    rest: dict[str, Any] = {"turns": turns or 1.0, "duration": duration, "law": law or "constant"}
    return shapes.circle(at, size, normal=normal, **rest) if kind == "circle" else eight(at, size, normal, **rest)


KINDS = ("circle", "line", "eight")


def place(
    robot: Joints,
    kind: str = "circle",
    *,
    q0: Any = None,
    axis: Any = None,
    position_only: bool = False,
    duration: float | None = None,
    law: str | None = None,
    turns: float = 0.0,
    dt: float = 0.01,
    position_tolerance: float = POSITION_TOLERANCE,
    **counts: Any,
) -> Placed:
    """Path of a kind that the robot can follow, each tip its own, at half of the joints' speed limits at most.

    dt [s]: time between samples; where they are few, the path is slow enough to be followed within position_tolerance [m].

    Whatever is not given is chosen, the first that works: the orientation kept, from home, large, along or about a base axis.
    Where nothing works (no joint can move) the path is a line without length. counts: what counts, as for `ik.solve`; a tip
    that is given relative to another keeps its pose in that one's frame.
    """
    relative = counts.get("relative_to") or {}
    starts = [*_starts(robot)] if q0 is None else [robot.check_q(q0, "q0")]
    for with_ease, free, start, size, way in _candidates(robot, kind, starts, axis, position_only):
        trial = paths(robot, start, kind, SPARE * size, way, free, relative)
        way_there = trace(robot, trial, start, fewest=COARSE, **counts)
        if way_there is not None and (not with_ease or _is_easy(robot, *way_there)):
            break
    else:
        kind, start, size, way, free = "line", starts[0], 0.0, BASE_AXES[0], True
    rest: dict[str, Any] = {"law": law, "turns": turns}
    seconds = duration
    if seconds is None:
        way_there = trace(robot, paths(robot, start, kind, size, way, free, relative, **rest), start, **counts)
        share = 0.0 if way_there is None else pace(robot, *way_there)[0]
        seconds = max(DURATION, float(np.ceil(DURATION * share / SPEED)))
        bend = _acceleration(paths(robot, start, kind, size, way, free, relative, duration=seconds, **rest))
        allowed = STRAIGHT * positive(position_tolerance, "position_tolerance [m]")
        missed = 0.5 * positive(dt, "dt [s]") ** 2 * bend / allowed
        seconds = max(seconds, float(np.ceil(seconds * np.sqrt(missed))))
    reference = paths(robot, start, kind, size, way, free, relative, duration=seconds, **rest)
    return Placed(reference, start, size, way, free, _words(robot, kind, size, way, free, seconds, start))


def _acceleration(reference: References) -> float:
    """Largest acceleration [m/s^2] of a tip along the path."""
    each = reference.values() if isinstance(reference, Mapping) else [reference]
    return max(
        float(np.linalg.norm(one.at(np.linspace(0.0, one.duration, DENSE))[2][:, :3], axis=1).max()) for one in each
    )


def _words(robot: Joints, kind: str, size: float, way: np.ndarray, free: bool, seconds: float, q: np.ndarray) -> str:
    """The choice, in words."""
    if not size:
        why = "" if (robot.upper > robot.lower).any() else ", as no joint can move"
        return f"no path was found that {robot.name} can follow{why}: it holds still for {seconds:g} s"
    along = next((name for name, axis in zip(AXIS_NAMES, BASE_AXES, strict=True) if np.array_equal(axis, way)), "")
    along = along or f"({' '.join(f'{x:.4g}' for x in way + 0.0)})"
    what = {
        "line": f"line of {length(size)} along {along}",
        "circle": f"circle of radius {length(size)} about {along}",
        "eight": f"figure of eight, {length(size)} to each side, about {along}",
    }[kind]
    where = "home" if np.array_equal(q, robot.home) else f"q0 = {' '.join(f'{x:.4g}' for x in q + 0.0)}"
    turn = "orientation free" if free else "orientation kept"
    return f"{what}{' for each tip' * robot.by_tip}, {turn}, from {where}, in {seconds:g} s"


def _is_easy(robot: Any, t: np.ndarray, q: np.ndarray) -> bool:
    """Whether the path keeps clear of limits and of singular configurations."""
    span = robot.upper - robot.lower
    bounded = np.isfinite(span) & (span > 0.0)
    gaps = np.minimum(q - robot.lower, robot.upper - q)[:, bounded] / span[bounded]
    T: Any = [robot.fk(one) for one in q]
    places = np.array(
        [[T_k[tip].translation for tip in robot.tips] if robot.by_tip else [T_k.translation] for T_k in T]
    )
    moved = np.linalg.norm(np.diff(places, axis=0), axis=2).max(axis=1) / robot.reach
    turned = np.abs(np.diff(q, axis=0) / robot.chain.unit).max(axis=1)
    return bool(gaps.min(initial=1.0) >= ROOM and (turned <= EVEN * moved).all())


def paths(
    robot: Any, q: Any, kind: str, size: float, axis: Any, free: bool, relative: Mapping[str, str], **rest: Any
) -> References:
    """The path from where the tips stand at q, by tip for a tree; a tip relative to another keeps its pose in its frame."""
    T: Any = robot.fk(q)
    if not robot.by_tip:
        return _drawn(T.homogeneous, kind, size, axis, free, rest)
    made = {}
    for tip in robot.tips:
        held = tip in relative and relative[tip] in T
        at = T[relative[tip]].actInv(T[tip]) if held else T[tip]
        made[tip] = _drawn(at.homogeneous, "line" if held else kind, 0.0 if held else size, axis, free, rest)
    return made


def _drawn(at: np.ndarray, kind: str, size: float, axis: Any, free: bool, rest: Mapping[str, Any]) -> Reference:
    return draw(kind, at[:3, 3].copy() if free else at, size, axis, **rest)


def _candidates(
    robot: Joints, kind: str, starts: list[np.ndarray], axis: Any, position_only: bool
) -> Iterator[tuple[bool, bool, np.ndarray, float, np.ndarray]]:
    """Ways to try, best first: whether to keep clear of limits, whether the orientation is free, start, size, axis."""
    share = 1.0 if kind == "line" else 0.5
    sizes = share * np.array(LENGTHS)
    sizes = sizes[sizes <= max(LARGEST * share * robot.reach, sizes[-1])]
    small = sizes < SMALL * sizes[0]
    for with_ease in (True, False):
        for few in (~small, small):
            for free in (True,) if position_only else (False, True):
                for start in starts:
                    ways = _axes(robot, kind, start, free) if axis is None else [np.array(axis, dtype=float)]
                    for size in sizes[few]:
                        for way in ways:
                            yield with_ease, free, start, float(size), way


def _starts(robot: Joints) -> Iterator[np.ndarray]:
    """Home, home away from the limits, and the random configurations in which the tips move most freely."""
    yield robot.home
    span = np.where(np.isfinite(robot.upper - robot.lower), robot.upper - robot.lower, 0.0)
    low, high = robot.lower + INSIDE * span, robot.upper - INSIDE * span
    inside = np.clip(robot.home, low, high)
    if not np.array_equal(inside, robot.home):
        yield inside
    drawn = np.clip(robot.random_q(np.random.default_rng(0), DRAWN), low, high)
    freedom = [min(float(s[1]) for _, s in _freedom(robot, q, True)) for q in drawn]
    yield from drawn[np.argsort(-np.array(freedom), kind="stable")[:BEST]]


def _axes(robot: Joints, kind: str, q: np.ndarray, free: bool) -> list[np.ndarray]:
    """Directions of a line, or normals: those of the base, then what the joints can do at q."""
    ways = list(BASE_AXES if kind == "line" else BASE_AXES[2::-1])
    for U, _ in _freedom(robot, q, free):
        ways += [U[:, 0], -U[:, 0]] if kind == "line" else [U[:, 2]]
    return ways


def _freedom(robot: Joints, q: np.ndarray, free: bool) -> list[tuple[np.ndarray, np.ndarray]]:
    """Directions (3, 3), a column each, in which each tip moves with its orientation kept or free, and how freely (3,)."""
    found = []
    for arm, place in zip(robot.arms, robot.places, strict=True):
        J = arm.jacobian(q[place])
        moves = np.eye(arm.n)
        if not free:
            _, s, Vt = np.linalg.svd(J[3:])
            moves = Vt[int((s > RANK * max(1.0, s.max(initial=0.0))).sum()) :].T
        U, s, _ = np.linalg.svd(np.hstack([J[:3] @ moves, np.zeros((3, 3))]))  # zeros: three values, however few joints
        found.append((U, s[:3]))
    return found
