"""The fewest reconfigurations of paths: by an enumeration that shares only the robot's dimensions with the toolkit, or planted.

A planted path is a smooth joint motion of the arm within its limits, given as poses: no reconfiguration is needed.
"""

from collections.abc import Callable
from functools import partial
from itertools import pairwise
from time import process_time
from typing import Any

import numpy as np
from path_problems import DATA

import ik_toolkit as ik

STEP = np.radians(7.0)
FINER = 10  # poses enumerated for each pose the toolkit gets: near a fold a branch moves far from pose to pose
GRID = np.radians(0.5)
TURN = 2.0 * np.pi
SMALL, SLIDE = np.radians(2.0), 0.0057  # [rad], [m] largest step of a joint from pose to pose of a planted path
REACH = 2.0  # [rad] distance of a line's ends in each joint: few lines between arbitrary poses stay in reach
Solutions = Callable[[np.ndarray], np.ndarray]


def fewest(layers: list[np.ndarray], step: float = STEP) -> int | None:
    """Fewest reconfigurations through layers of solutions (K, n), moves of at most `step` per joint; None if a layer is empty."""
    if not all(len(layer) for layer in layers):
        return None
    counts = np.zeros(len(layers[0]), dtype=int)
    for before, layer in pairwise(layers):
        to, of = np.nonzero(np.abs(layer[:, None, 0] - before[None, :, 0]) <= step)
        near = (np.abs(layer[to] - before[of]) <= step).all(axis=1)
        reached = np.full(len(layer), counts.min() + 1)
        np.minimum.at(reached, to[near], counts[of[near]])
        counts = reached
    return int(counts.min())


# ------------------------------------------------------------------------------------------------------------ planar 3R
def planar(robot: Any) -> tuple[np.ndarray, Solutions, Callable[[np.ndarray], np.ndarray]]:
    """Link lengths of planar_3r, its two solutions of (x, y, angle), and the pose (4, 4) of one."""
    p = [robot.fk(q).translation for q in np.eye(3) * np.pi]  # half a turn of a joint mirrors everything beyond it
    reach = robot.fk(np.zeros(3)).translation[0]
    joints = [0.5 * (reach + one[0]) for one in p]
    l1, l2, l3 = np.diff([*joints, reach])

    def solve(target: np.ndarray) -> np.ndarray:
        """Legal solutions (K, 3) of targets (x, y, angle), one (3,) or many (M, 3)."""
        x, y, angle = np.atleast_2d(target).T
        x, y = x - joints[0] - l3 * np.cos(angle), y - l3 * np.sin(angle)
        with np.errstate(invalid="ignore"):
            elbow = np.arccos((x * x + y * y - l1 * l1 - l2 * l2) / (2.0 * l1 * l2))
            elbow = np.concatenate([elbow, -elbow])
            x, y, angle = np.tile(x, 2), np.tile(y, 2), np.tile(angle, 2)
            shoulder = np.arctan2(y, x) - np.arctan2(l2 * np.sin(elbow), l1 + l2 * np.cos(elbow))
            q = np.column_stack([shoulder, elbow, angle - shoulder - elbow])
            q -= TURN * np.rint(q / TURN)
            return q[(q >= robot.lower).all(axis=1) & (q <= robot.upper).all(axis=1)]

    def pose(target: np.ndarray) -> np.ndarray:
        T = robot.fk(np.zeros(3)).homogeneous
        c, s = np.cos(target[2]), np.sin(target[2])
        T[:2, 3] = target[:2]
        T[:3, :3] = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ T[:3, :3]
        return T

    return np.array([l1, l2, l3]), solve, pose


def planar_targets(robot: Any, rng: np.random.Generator, count: int) -> np.ndarray:
    """(x, y, angle) (count, 3) along a random curve between configurations."""
    ends = np.array([robot.random_q(rng) for _ in range(3)])
    flat = np.array([[*robot.fk(q).translation[:2], q.sum()] for q in ends])
    s = np.linspace(0.0, 1.0, count)[:, None]
    return (1 - s) ** 2 * flat[0] + 2 * s * (1 - s) * flat[1] + s * s * flat[2]


def compare_planar_poses(paths: int, seed: int) -> dict[str, Any]:
    """Planar 3R with its full planar pose: two branches."""
    robot = ik.Robot.load("planar_3r")
    _, solve, pose = planar(robot)
    rng = np.random.default_rng(seed)
    pairs = []
    while len(pairs) < paths:
        targets = planar_targets(robot, rng, 100 * FINER + 1)
        if not all(len(solve(target)) for target in targets[::50]):
            continue
        least = fewest([solve(target) for target in targets])
        if least is not None:
            poses = np.array([pose(target) for target in targets[::FINER]])
            pairs.append((least, *found(robot, poses, len(pairs))))
    return summary(pairs)


def compare_planar_positions(paths: int, seed: int) -> dict[str, Any]:
    """Planar 3R with positions only: one redundant joint; the grid has a solution every half degree of the tip angle."""
    robot = ik.Robot.load("planar_3r")
    _, solve, _ = planar(robot)
    rng = np.random.default_rng(seed)
    angles = np.arange(-np.pi, np.pi, GRID)
    pairs = []
    while len(pairs) < paths:
        targets = planar_targets(robot, rng, 100)
        ones = np.ones_like(angles)
        layers = [solve(np.column_stack([x * ones, y * ones, angles])) for x, y, _ in targets]
        least = fewest(layers)
        if least is not None:
            points = np.column_stack([targets[:, :2], np.full(len(targets), robot.fk(np.zeros(3)).translation[2])])
            pairs.append((least, *found(robot, points, len(pairs))))
    return summary(pairs)


# ----------------------------------------------------------------------------------------------------------------- UR5
D1, A2, A3, D4, D5, D6 = 0.089159, -0.425, -0.39225, 0.10915, 0.09465, 0.0823  # m, of the UR5 (Denavit-Hartenberg)
HALF = np.pi / 2
ROWS = [(0.0, D1, HALF), (A2, 0.0, 0.0), (A3, 0.0, 0.0), (0.0, D4, HALF), (0.0, D5, -HALF), (0.0, D6, 0.0)]


def link(a: float, d: float, alpha: float, theta: float) -> np.ndarray:
    """Denavit-Hartenberg matrix."""
    c, s, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
    return np.array([[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1.0]])


def forward(q: np.ndarray) -> np.ndarray:
    """Pose of the flange by the D-H table."""
    T = np.eye(4)
    for row, angle in zip(ROWS, q, strict=True):
        T = T @ link(*row, angle)
    return T


def ur5(robot: Any) -> Solutions:
    """Every solution (K, 6) of a pose inside the limits, on every turn, by textbook geometry."""
    zero = np.zeros(6)
    frames = []
    for turn in (0.0, np.pi):  # the table's base may be rotated relative to the robot's
        base = link(0.0, 0.0, 0.0, turn)
        tool = np.linalg.inv(base @ forward(zero)) @ robot.fk(zero).homogeneous
        q = np.array([0.3, -1.0, 0.8, -0.4, 0.9, 0.2])
        if np.abs(base @ forward(q) @ tool - robot.fk(q).homogeneous).max() < 1e-4:
            frames.append((np.linalg.inv(base), np.linalg.inv(tool)))
    (back, off) = frames[0]

    def solve(T: np.ndarray) -> np.ndarray:
        F = back @ T @ off
        wrist = F[:3, 3] - D6 * F[:3, 2]
        found = []
        reach = np.hypot(wrist[0], wrist[1])
        if reach < D4:
            return np.empty((0, 6))
        for sign in (1, -1):
            t1 = np.arctan2(wrist[1], wrist[0]) + sign * np.arccos(D4 / reach) + HALF
            cosine = (F[0, 3] * np.sin(t1) - F[1, 3] * np.cos(t1) - D4) / D6
            if abs(cosine) > 1.0 + 1e-9:
                continue
            for t5 in (np.arccos(np.clip(cosine, -1, 1)), -np.arccos(np.clip(cosine, -1, 1))):
                sine = np.sin(t5)
                if abs(sine) < 1e-9:
                    continue
                y = (-F[0, 1] * np.sin(t1) + F[1, 1] * np.cos(t1)) / sine
                x = (F[0, 0] * np.sin(t1) - F[1, 0] * np.cos(t1)) / sine
                t6 = np.arctan2(y, x)
                arm = np.linalg.inv(link(*ROWS[0], t1)) @ F
                arm = arm @ np.linalg.inv(link(*ROWS[4], t5) @ link(*ROWS[5], t6))
                x, y = arm[:2, 3]
                cosine3 = (x * x + y * y - A2 * A2 - A3 * A3) / (2 * A2 * A3)
                if abs(cosine3) > 1.0:
                    continue
                for t3 in (np.arccos(cosine3), -np.arccos(cosine3)):
                    t2 = np.arctan2(y, x) - np.arctan2(A3 * np.sin(t3), A2 + A3 * np.cos(t3))
                    t4 = np.arctan2(arm[1, 0], arm[0, 0]) - t2 - t3
                    found.append([t1, t2, t3, t4, t5, t6])
        every = [turned for q in found for turned in turns(np.array(q), robot)]
        return np.array(every).reshape(-1, 6)

    return solve


def turns(q: np.ndarray, robot: Any) -> np.ndarray:
    """Every legal full turn of the joints of q (n,)."""
    choices = []
    for x, low, high in zip(q, robot.lower, robot.upper, strict=True):
        first, last = int(np.ceil((low - x) / TURN)), int(np.floor((high - x) / TURN))
        choices.append(x + TURN * np.arange(first, last + 1))
    return np.stack(np.meshgrid(*choices, indexing="ij"), axis=-1).reshape(-1, len(q))


def compare_ur5(paths: int, seed: int) -> dict[str, Any]:
    """UR5, straight lines with a rotation about one axis between random poses, all branches and turns."""
    import pinocchio as pin

    robot = ik.Robot.load("ur5")
    solve = ur5(robot)
    rng = np.random.default_rng(seed)
    pairs = []
    while len(pairs) < paths:
        q = robot.random_q(rng)
        a, b = robot.fk(q), robot.fk(np.clip(q + rng.uniform(-REACH, REACH, 6), robot.lower, robot.upper))
        poses = np.array([pin.SE3.Interpolate(a, b, float(s)).homogeneous for s in np.linspace(0.0, 1.0, 1501)])
        if not all(len(solve(T)) for T in poses[::50]):
            continue
        least = fewest([solve(T) for T in poses])
        if least is not None:
            pairs.append((least, *found(robot, poses[:: FINER // 2], len(pairs))))
    return summary(pairs)


# ------------------------------------------------------------------------------------------------------------- planted
def planted(robot: Any, rng: np.random.Generator) -> np.ndarray:
    """Poses (N, 4, 4) of a cubic Bezier curve between two random configurations, with two more as control points."""
    controls = robot.random_q(rng, 4)
    s = np.linspace(0.0, 1.0, 2001)[:, None]
    q = np.hstack([(1 - s) ** 3, 3 * s * (1 - s) ** 2, 3 * s * s * (1 - s), s**3]) @ controls
    moves = np.abs(np.diff(q, axis=0)) / np.where(robot.slides, SLIDE, SMALL)
    way = np.append(0.0, np.cumsum(moves.max(axis=1)))
    at = np.interp(np.linspace(0.0, way[-1], int(np.ceil(way[-1])) + 1), way, s[:, 0])[:, None]
    q = np.hstack([(1 - at) ** 3, 3 * at * (1 - at) ** 2, 3 * at * at * (1 - at), at**3]) @ controls
    return np.array([robot.fk(one).homogeneous for one in q])


def compare_planted(load: Callable[[], Any], paths: int, seed: int) -> dict[str, Any]:
    """Planted paths of one arm."""
    robot = load()
    ik.solve_path(robot, planted(robot, np.random.default_rng(seed))[:20])  # compiles, or loads kernels
    return summary([(0, *found(robot, planted(robot, np.random.default_rng([seed, k])), k)) for k in range(paths)])


def found(robot: Any, poses: np.ndarray, seed: int) -> tuple[int | None, float]:
    """Number of reconfigurations of the toolkit's path, None if it has none, and the processor time [s]."""
    began = process_time()
    made = ik.solve_path(robot, poses, seed=seed)
    return len(made.reconfigurations) if made.success else None, process_time() - began


def summary(pairs: list[tuple[int, int | None, float]]) -> dict[str, Any]:
    """How often the toolkit's number equals the true least, is above it (or there is no path), or below it; times [s]."""
    counts = [-1 if made is None else int(np.sign(least - made)) for least, made, _ in pairs]
    said = {"equal": counts.count(0), "more": counts.count(-1), "fewer": counts.count(1)}
    times = [one[2] for one in pairs]
    return {"paths": len(pairs), **said, "processor": float(np.median(times)), "longest": max(times), "pairs": pairs}


PLANTED = {
    **{name: partial(ik.Robot.load, name) for name in ("panda", "ur5", "hydrolek_7w")},
    "fetch arm on its lift": partial(ik.Robot.load, DATA / "fetch.urdf", base="base_link", tip="gripper_link"),
}  # fmt: skip
COMPARED = {
    "planar 3R, poses": compare_planar_poses, "planar 3R, positions": compare_planar_positions, "ur5": compare_ur5,
    **{f"{name}, planted": partial(compare_planted, load) for name, load in PLANTED.items()},
}  # fmt: skip
