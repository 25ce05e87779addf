"""Reachability and placement: speed, missed and false answers, against more attempts, geometry and other searches.

python scripts/benchmarks/reach.py [--parts random dense proofs planar place] [--share 0.1] [--scenes 10] [-o reach.json]

Shares of the million answers of each map are computed (--share) and the seconds given for a million: wall time on all cores, and
processor time, which other load on the machine changes less.
"""

import time
from collections.abc import Iterator
from typing import Any

import numpy as np
from common import load_average, machine, parser, write

import ik_toolkit as ik
from ik_toolkit.study.benchmark import wilson
from ik_toolkit.study.place_search import base_poses, in_base

BIG, TRUTH = 1_000_000, 20_000  # answers of a map, and how many are tried again with many attempts
CYLINDER = 0.9, -0.3, 1.2  # radius, lower and upper end [m]
PARTS = ("random", "dense", "proofs", "planar", "place")


def clocks() -> np.ndarray:
    """Return wall time and processor time of all threads [s]."""
    return np.array([time.perf_counter(), time.process_time()])


def rotations(rng: np.random.Generator, count: int) -> np.ndarray:
    """Return uniform random rotations (count, 3, 3)."""
    Q, R = np.linalg.qr(rng.normal(size=(count, 3, 3)))
    Q = Q * np.sign(np.einsum("nii->ni", R))[:, None]
    return Q * np.linalg.det(Q)[:, None, None]


def in_cylinder(rng: np.random.Generator, count: int) -> np.ndarray:
    """Return random poses (count, 4, 4) in the cylinder."""
    radius, low, high = CYLINDER
    r, turn = radius * np.sqrt(rng.random(count)), 2.0 * np.pi * rng.random(count)
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, :3, :3] = rotations(rng, count)
    T[:, :3, 3] = np.column_stack([r * np.cos(turn), r * np.sin(turn), rng.uniform(low, high, count)])
    return T


def false_yeses(robot: Any, found: Any) -> int:
    """Return how many of the configurations of a map Pinocchio does not confirm: tolerances, limits."""
    T, grid = found.grid.targets(np.arange(0, found.grid.answers, found.grid.turns)), found.grid
    wrong = 0
    for k in np.flatnonzero(found.reached.ravel()):
        at = robot.fk(found.q[k]).homogeneous
        wanted = T[k] if T.ndim == 3 else None
        off = np.linalg.norm(at[:3, 3] - (T[k] if wanted is None else T[k][:3, 3]))
        turned = 0.0
        if wanted is not None:
            R = grid.rotations if grid.rotations is not None else wanted[None, :3, :3]
            turned = min(np.linalg.norm(at[:3, :3] - one) for one in R)
        wrong += not (off < 1.1e-6 and turned < 1.5e-6 and not robot.outside(found.q[k]))
    return wrong


def judged(robot: Any, T: np.ndarray, found: Any, seconds: np.ndarray, **more: Any) -> dict[str, Any]:
    """Try a sample of the noes of loose answers again with 1,000 attempts, and say what was missed."""
    yes, rng = (found.states == 1).ravel(), np.random.default_rng(99)
    noes = np.flatnonzero((found.states >= 3).ravel())
    again = np.sort(rng.permutation(noes)[:TRUTH])
    late = int(ik.solve_batch(robot, T[again], "lm", restarts=999, seed=7).success.sum()) if len(again) else 0
    proofs = np.sort(rng.permutation(np.flatnonzero((found.states == 2).ravel()))[:TRUTH])
    broken = int(ik.solve_batch(robot, T[proofs], "lm", restarts=99, seed=8).success.sum()) if len(proofs) else 0
    low, high = wilson(late, len(again)) if len(again) else (0.0, 0.0)
    share = len(noes) / len(yes)
    row = {
        "answers": len(yes), "seconds of a million": (seconds / len(yes) * BIG).tolist(),
        "yes": float(yes.mean()), "unknown": share,
        "noes tried again": len(again), "late yeses": late, "missed of all": [share * low, share * high],
        "proofs tried": len(proofs), "false proofs": broken, "false yeses": false_yeses(robot, found),
    }  # fmt: skip
    return row | more


def random_poses(share: float) -> dict[str, Any]:
    """The Panda at random poses of a cylinder."""
    robot, T = ik.Robot.load("panda"), in_cylinder(np.random.default_rng(5), int(share * BIG))
    ik.reachability(robot, T[:64], audit=0)
    began = clocks()
    found = ik.reachability(robot, T, audit=0)
    return judged(robot, T, found, clocks() - began)


def dense(share: float) -> dict[str, Any]:
    """The Panda on a grid of 2.5 cm."""
    robot, rng = ik.Robot.load("panda"), np.random.default_rng(1)
    region, R = ((0.0, -0.15, -0.3), (0.9, 0.15, 1.2)), rotations(rng, max(1, round(share * BIG / 25_920)))
    ik.reachability(robot, region, resolution=0.15, orientations=R[:1], audit=0)
    began = clocks()
    found = ik.reachability(robot, region, resolution=0.025, orientations=R, audit=0)
    seconds = clocks() - began
    return judged(robot, found.grid.targets(np.arange(found.grid.answers)), found, seconds)


def proofs(share: float) -> dict[str, Any]:
    """Arms that the elimination or a closed form decides: a half of random poses, a half of planted ones."""
    rows = {}
    for name in ("ur5", "hydrolek_7w", "inspection_7dof"):
        robot, rng = ik.Robot.load(name), np.random.default_rng(2)
        half = int(0.5 * share * BIG)
        planted = robot.chain.forward(robot.random_q(rng, half))[0]
        T = np.concatenate([planted, planted])
        T[half:, :3, 3] *= rng.uniform(0.7, 1.1, (half, 1))  # a half is moved: in and out of reach
        ik.reachability(robot, T[:64], audit=0)
        began = clocks()
        found = ik.reachability(robot, T, audit=0)
        seconds = clocks() - began
        rows[name] = judged(robot, T, found, seconds, planted_lost=int((found.states[:half] != 1).sum()))
    return rows


def planar(_: float) -> dict[str, Any]:
    """planar_2r by the law of cosines and planar_3r by its limit curves, at 401 x 401 cells; cells on the border are left out."""
    rows = {}
    for name, side, judge in (("planar_2r", 4.1, two_links), ("planar_3r", 12.2, three_links)):
        robot = ik.Robot.load(name)
        half = 0.5 * side
        found = ik.reachability(robot, ((-half, -half, 0), (half, half, 0)), resolution=side / 401, audit=0)
        p = found.grid.centres()[:, :2] @ (1.0, 1.0j)
        want, sure = judge(p, 0.0), judge(p, 4e-6) == judge(p, -4e-6)
        wrong = int((found.reached.ravel() != want)[sure].sum())
        rows[name] = {"cells": len(p), "left out": int((~sure).sum()), "wrong": wrong, **found.counts()}
        rows[name]["false yeses"] = false_yeses(robot, found)
    return rows


def elbows(p: np.ndarray, a: complex, b: complex, slack: float) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield the angles (q, r) of both elbows of links a and b that reach points p = a e^iq + b e^i(q + r); NaN out of reach."""
    c = (np.abs(p) ** 2 - abs(a) ** 2 - abs(b) ** 2) / (2.0 * abs(a) * abs(b))
    bend = np.arccos(np.where(np.abs(c) <= 1.0 + 2.0 * slack, np.clip(c, -1.0, 1.0), np.nan))
    for r in (bend, -bend):
        yield np.angle(p) - np.angle(abs(a) + abs(b) * np.exp(1j * r)) - np.angle(a), r + np.angle(a) - np.angle(b)


def within(limit: float, *angles: np.ndarray) -> np.ndarray:
    """Whether all angles are within +-limit [rad], after whole turns."""
    return np.all([np.abs((q + np.pi) % (2.0 * np.pi) - np.pi) <= limit for q in angles], axis=0)


def two_links(p: np.ndarray, slack: float) -> np.ndarray:
    """Whether planar_2r (links of 1 m, joints within 150 deg) reaches points p, with limits wider by `slack` [rad]."""
    return np.any([within(np.radians(150.0) + slack, q, r) for q, r in elbows(p, 1.0, 1.0, slack)], axis=0)


def three_links(p: np.ndarray, slack: float) -> np.ndarray:
    """Whether planar_3r (links of 2 m, joints within 60 deg) reaches points p, with limits wider by `slack` [rad].

    The tip keeps its place while the last link turns, until a joint meets a limit or the first two links are in line, where their
    branches meet: a point is reached if, and only if, it is reached in such a configuration.
    """
    limit = np.pi / 3.0 + slack
    found = np.zeros(len(p), bool)
    for t in (limit, -limit, 0.0):
        bent, turn = 2.0 + 2.0 * np.exp(1j * t), np.exp(-1j * t)
        for q, r in elbows(p * turn - 2.0, 2.0, 2.0, slack):
            found |= within(limit, q, r)  # the first joint is held at t
        for q, r in elbows(p, bent, 2.0 / turn, slack):
            found |= within(limit, q, r)  # the second
        for q, r in elbows(p, 2.0, bent, slack):
            found |= within(limit, q, r)  # the third
    return found


def sheet(robot: Any, scene: int, wide: float, tall: float) -> np.ndarray:
    """Return 800 poses (800, 4, 4) along three edges of a sheet somewhere on the floor, where the arm can work."""
    rng = np.random.default_rng(40 + scene)
    low, high = np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi)
    C = robot.fk(0.5 * (low + high) + 0.15 * (high - low) * rng.uniform(-1.0, 1.0, robot.n)).homogeneous
    side = np.array([-C[1, 3], C[0, 3], 0.0]) / np.hypot(C[0, 3], C[1, 3])
    parts = []
    for edge, (count, turn) in enumerate(((267, 25.0), (266, 0.0), (267, -25.0))):
        s = np.linspace(-0.5, 0.5, count)[:, None]
        top = s * wide * side + (0.0, 0.0, 0.5 * tall)
        X = np.tile(base_poses(np.array([[0.0, 0.0, np.radians(turn), 0.0]]))[0] @ C, (count, 1, 1))
        X[:, :3, 3] = C[:3, 3] + (
            top if edge == 1 else s * (0.0, 0.0, tall) + side * wide * (0.5 if edge == 2 else -0.5)
        )
        parts.append(X)
    place = np.array([[*rng.uniform(-3.0, 3.0, 2), rng.uniform(-np.pi, np.pi), 0.0]])
    return base_poses(place)[0] @ np.concatenate(parts)


def counted(robot: Any, bases: np.ndarray, W: np.ndarray, box: Any = None) -> np.ndarray:
    """Return how many poses are reached from each base, with ten attempts each; box: sides and pose of an obstacle."""
    counts, asked = [], {"restarts": 9, "check": 0.0}
    for base in bases:
        if box is not None:
            at = np.linalg.inv(base_poses(base[None])[0]) @ box[1]
            asked["avoid_collisions"] = ik.CollisionModel(robot).add_box(box[0], at)
        counts.append(int(ik.solve_batch(robot, in_base(base[None], W)[0], "lm", **asked).success.sum()))
    return np.array(counts)


def another(robot: Any, W: np.ndarray, start: np.ndarray, rounds: int, seed: int, box: Any) -> int:
    """Return what CMA-ES (extra `tune`) finds from the best random base, counting every pose; the second optimiser."""
    import cma

    scale = np.array([robot.reach / 3.0, robot.reach / 3.0, 0.5])
    quiet = {"seed": seed + 1, "verbose": -9, "popsize": 16, "maxiter": rounds}
    search = cma.CMAEvolutionStrategy(start[:3] / scale, 0.3, quiet)
    while not search.stop():
        asked = search.ask()
        bases = np.column_stack([np.array(asked) * scale, np.full(len(asked), start[3])])
        search.tell(asked, [-float(x) for x in counted(robot, bases, W, box)])
    return int(-search.result.fbest)


def placement(share: float, scenes: int) -> list[dict[str, Any]]:
    """Scenes of a sheet for the HydroLek, two with obstacles: our best beside random bases and CMA-ES."""
    robot, rows, some = ik.Robot.load("hydrolek_7w"), [], max(1, int(2000 * share))
    for scene in range(scenes):
        W, rng, box = sheet(robot, scene, 1.2, 0.9), np.random.default_rng(scene), None
        more: dict[str, Any] = {}
        if scene >= scenes - 2 and scenes > 2:
            box = (0.3, 0.3, 1.5), ik.pose((*W[:, :2, 3].mean(axis=0), -0.4), rpy=(0, 0, 0))
            more = {"avoid_collisions": ik.CollisionModel(robot).add_box(*box)}
        began = clocks()
        found = ik.place(robot, W, count=3, **more)
        row = {"scene": scene, "obstacle": bool(more), "seconds": (clocks() - began).tolist(), "found": found[0].count}
        edge = np.array([W[:, :2, 3].min(axis=0) - robot.reach, W[:, :2, 3].max(axis=0) + robot.reach])
        bases = np.column_stack(
            [rng.uniform(edge[0], edge[1], (some, 2)), rng.uniform(-np.pi, np.pi, some), np.zeros(some)]
        )
        counts = counted(robot, bases, W)
        if box is not None:  # An obstacle adds no pose, so that other bases cannot reach more than ours.
            best = counts >= min(found[0].count, counts.max())
            bases, counts = bases[best], counted(robot, bases[best], W, box)
        row |= {"random bases": some, "best random": int(counts.max())}
        row |= {"CMA-ES": another(robot, W, bases[counts.argmax()], 40, scene, box)}
        print(row, flush=True)
        rows.append(row)
    return rows


def main() -> None:
    """Measure the parts asked for, print and write them."""
    made = parser(__doc__ or "", "reach.json")
    made.add_argument("--parts", nargs="+", default=PARTS, choices=PARTS)
    made.add_argument("--share", type=float, default=1.0, help="share of a million answers, and of 2,000 random bases")
    made.add_argument("--scenes", type=int, default=10)
    asked = made.parse_args()
    run = {"random": random_poses, "dense": dense, "proofs": proofs, "planar": planar}
    results: dict[str, Any] = {"machine": machine(), "load": load_average(), "share": asked.share}
    for part in asked.parts:
        results[part] = placement(asked.share, asked.scenes) if part == "place" else run[part](asked.share)
        print(part, results[part], flush=True)
    write(asked.output, results)


if __name__ == "__main__":
    main()
