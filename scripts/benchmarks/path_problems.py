"""The problems of path.py: three from CppFlow, figures drawn for the Fetch arm, a cut along a pipe, two arms.

The figures replace those of TORM, whose files are not available here: circle, s, square, "hello" and rotations in place, with our
own size and position. Their lengths cannot be compared with TORM's.
"""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

import ik_toolkit as ik

DATA = Path(__file__).parent / "data"
KNOWN = {"panda__1cube": 8.49, "panda__2cubes": 12.63}  # rad: TORM's lengths
STEP, DEGREES = 0.008, 1.7  # m, deg from pose to pose in our figures, as in the given problems
PLACE = (0.73, -0.05, 0.8)  # m, centre of the figures for the Fetch arm: reachable on all sides
HANDS = (0.1, 0.05, 0.03)  # m, amplitude of each hand of the two arms along x, y and z; they reach little farther


@dataclass
class Problem:
    """Robot or Tree, poses (N, 4, 4) or (N, F, 4, 4), collision model and options; axis (3,): tip axis of a free rotation."""

    robot: Any
    T: np.ndarray
    model: Any
    options: dict[str, Any] = field(default_factory=dict)
    axis: np.ndarray | None = None
    known: float | None = None


def problem(name: str) -> Problem:
    """The problem of that name."""
    return MADE[name]() if name in MADE else given(name)


def names() -> list[str]:
    """Names of all problems."""
    return [*json.loads((DATA / "path_problems.json").read_text(encoding="utf-8"))["problems"], *MADE]


def given(name: str) -> Problem:
    """A problem in data/path_problems.json."""
    one = json.loads((DATA / "path_problems.json").read_text(encoding="utf-8"))["problems"][name]
    robot = ik.Robot.load("panda", tip="panda_hand") if one["robot"] == "panda" else fetch_arm()
    T = np.tile(np.eye(4), (len(one["poses"]), 1, 1))
    T[:, :3] = one["poses"]
    model = ik.CollisionModel(robot)
    for box in one["boxes"]:
        model.add_box(box["size"], box["xyz"])
    return Problem(robot, T, model, known=KNOWN.get(name))


def fetch_arm() -> ik.Robot:
    """The Fetch arm of the problems, with its torso locked."""
    return ik.Robot.load(DATA / "fetch.urdf", base="base_link", tip="gripper_link", locked={"torso_lift_joint": 0.0})


# --------------------------------------------------------------------------------------------------------------- figures
def arc(x: float, y: float, radius: float, begin: float, end: float) -> list[tuple[float, float]]:
    """Points of a circle from one angle [deg] to another."""
    a = np.radians(np.linspace(begin, end, 60))
    return list(zip(x + radius * np.cos(a), y + radius * np.sin(a), strict=True))


def hello() -> list[tuple[float, float]]:
    """The word, two units high; the pen stays on the wall."""
    h = [(0, 0), (0, 2), (0, 0.8), *arc(0.4, 0.8, 0.4, 180, 0), (0.8, 0)]
    e = [(1.1, 0.5), (1.9, 0.5), *arc(1.5, 0.5, 0.4, 0, 315)]
    return [*h, *e, (2.2, 0), (2.2, 2), (2.2, 0), (2.6, 0), (2.6, 2), (2.6, 0), *arc(3.4, 0.45, 0.45, 270, -90)]


FIGURES = {  # points (y to the right, z up), and width [m]
    "circle": (arc(0, 0, 1, 0, 360), 0.4),
    "s": ([*arc(0, 1, 1, 0, 270), *arc(0, -1, 1, 90, -180)], 0.22),
    "square": ([(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)], 0.35),
    "hello": (hello(), 0.8),
}


def drawn(name: str) -> Problem:
    """A figure on a wall before the Fetch arm."""
    points, width = FIGURES[name]
    flat = np.array(points, dtype=float)
    flat = (flat - 0.5 * (flat.max(axis=0) + flat.min(axis=0))) * (width / np.ptp(flat[:, 0]))
    way = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(flat, axis=0), axis=1)))
    at = np.linspace(0.0, way[-1], int(np.ceil(way[-1] / STEP)) + 1)
    T = np.tile(ik.pose(xyz=PLACE, rpy=(0, 0, 0)), (len(at), 1, 1))
    T[:, 1, 3] -= np.interp(at, way, flat[:, 0])
    T[:, 2, 3] += np.interp(at, way, flat[:, 1])
    robot = fetch_arm()
    return Problem(robot, T, ik.CollisionModel(robot))


def rotations() -> Problem:
    """The Fetch arm turns its hand in place: about y and z, 45 deg either way."""
    way = np.concatenate([np.arange(0, 45, DEGREES), np.arange(45, -45, -DEGREES), np.arange(-45, 0, DEGREES)])
    turns = [(0.0, np.radians(a), 0.0) for a in way] + [(0.0, 0.0, np.radians(a)) for a in way]
    T = np.array([ik.pose(xyz=PLACE, rpy=rpy) for rpy in turns])
    robot = fetch_arm()
    return Problem(robot, T, ik.CollisionModel(robot))


# ------------------------------------------------------------------------------------------------------ pipe and two arms
def pipe() -> Problem:
    """HydroLek's saw once round a 5 cm pipe, its axis along the pipe, rotation about it free."""
    robot = ik.Robot.load("hydrolek_7w")
    centre, angle = np.array([1.01, -0.13, 0.10]), np.linspace(0.0, 2.0 * np.pi, 121)
    T = np.tile(ik.pose(xyz=centre, direction=(1, 0, 0)).T_base_tip, (len(angle), 1, 1))
    T[:, 1, 3] += 0.12 * np.cos(angle)
    T[:, 2, 3] += 0.12 * np.sin(angle)
    around = ik.pose(xyz=centre + np.array([0.25, 0.0, 0.0]), rpy=(0, np.pi / 2, 0))
    model = ik.CollisionModel(robot).add_cylinder(0.05, 0.6, around, name="pipe")
    return Problem(robot, T, model, {"free_turn": (0, 0, 1)}, np.array([0.0, 0.0, 1.0]))


def two_arms(together: bool) -> Problem:
    """Brokk's two HydroLeks: each hand on its own loop, or both on the same, as if holding a box between them."""
    robot = ik.Tree.load("brokk_hydrolek", tips=["left_tip", "right_tip"])
    start = robot.fk(robot.home)
    angle = np.linspace(0.0, 2.0 * np.pi, 151)
    loop = 0.5 * np.column_stack([np.cos(angle) - 1.0, np.sin(angle), np.sin(2.0 * angle)]) * HANDS
    T = np.array([[start[tip].homogeneous] * len(angle) for tip in robot.tips]).swapaxes(0, 1).copy()
    T[:, 0, :3, 3] += loop
    T[:, 1, :3, 3] += loop if together else loop * [1.0, -1.0, 1.0]
    return Problem(robot, T, ik.CollisionModel(robot))


MADE = {
    **{f"fetch_arm {name}": lambda name=name: drawn(name) for name in FIGURES},
    "fetch_arm rotations": rotations,
    "hydrolek pipe": pipe,
    "brokk, each hand its own": lambda: two_arms(False),
    "brokk, a box in both hands": lambda: two_arms(True),
}  # fmt: skip
