"""Reachability and placement: speed, missed and false answers, against more attempts, geometry and other searches.

python scripts/benchmarks/reach.py [--parts random dense proofs planar place] [--share 0.1] [--scenes 10] [-o reach.json]

Shares of the million answers of each map are computed (--share) and the seconds given for a million: wall time on all cores, and
processor time, which other load on the machine changes less.
"""

import time
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
    """planar_2r by the law of cosines at 401 x 401 cells, border left out; planar_3r by 36,000 angles at 61 x 61."""
    rows, limit = {}, np.radians(150.0)
    found = ik.reachability(ik.Robot.load("planar_2r"), ((-2.05, -2.05, 0), (2.05, 2.05, 0)), resolution=4.1 / 401)
    x, y, _ = found.grid.centres().T
    want, sure = two_links(x, y, limit, 0.0), two_links(x, y, limit, 4e-6) == two_links(x, y, limit, -4e-6)
    wrong = int((found.reached.ravel() != want)[sure].sum())
    rows["planar_2r"] = {"cells": len(x), "left out": int((~sure).sum()), "wrong": wrong, **found.counts()}
    found = ik.reachability(ik.Robot.load("planar_3r"), ((-6.1, -6.1, 0), (6.1, 6.1, 0)), resolution=0.2, audit="full")
    x, y, _ = found.grid.centres().T
    want, limit = np.zeros(len(x), bool), np.pi / 3.0
    for turn in np.linspace(-np.pi, np.pi, 36_000):  # of the last link
        u, v = (x - 2.0 * np.cos(turn)) / 2.0, (y - 2.0 * np.sin(turn)) / 2.0
        want |= two_links(u, v, limit, 0.0, turn)
    yes = found.reached.ravel()
    rows["planar_3r"] = {"cells": len(x), "false yeses": false_yeses(ik.Robot.load("planar_3r"), found)}
    rows["planar_3r"] |= {"missed": int((want & ~yes).sum()), "beyond the angles": int((yes & ~want).sum())}
    return rows


def two_links(x: np.ndarray, y: np.ndarray, limit: float, slack: float, turn: float | None = None) -> np.ndarray:
    """Whether two links of 1, joints within +-limit [rad], reach points; a third joint then turns to `turn` within its own."""
    c, found = (x * x + y * y - 2.0) / 2.0, np.zeros(np.shape(x), bool)
    bend = np.arccos(np.clip(c, -1.0, 1.0))
    for q2 in (bend, -bend):
        q1 = np.arctan2(y, x) - np.arctan2(np.sin(q2), 1.0 + np.cos(q2))
        q1 = (q1 + np.pi) % (2.0 * np.pi) - np.pi
        good = (np.abs(q1) <= limit + slack) & (np.abs(q2) <= limit + slack) & (np.abs(c) <= 1.0 + 2.0 * slack)
        if turn is not None:
            good &= np.abs((turn - q1 - q2 + np.pi) % (2.0 * np.pi) - np.pi) <= limit
        found |= good
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


def counted(robot: Any, bases: np.ndarray, W: np.ndarray) -> np.ndarray:
    """Return how many poses are reached from each base, with ten attempts each."""
    counts = []
    for base in bases:
        counts.append(int(ik.solve_batch(robot, in_base(base[None], W)[0], "lm", restarts=9, check=0.0).success.sum()))
    return np.array(counts)


def another(robot: Any, W: np.ndarray, start: np.ndarray, rounds: int, seed: int) -> int:
    """Return what CMA-ES (extra `tune`) finds from the best random base, counting every pose; the second optimiser."""
    import cma

    scale = np.array([robot.reach / 3.0, robot.reach / 3.0, 0.5])
    quiet = {"seed": seed + 1, "verbose": -9, "popsize": 16, "maxiter": rounds}
    search = cma.CMAEvolutionStrategy(start[:3] / scale, 0.3, quiet)
    while not search.stop():
        asked = search.ask()
        bases = np.column_stack([np.array(asked) * scale, np.full(len(asked), start[3])])
        search.tell(asked, [-float(x) for x in counted(robot, bases, W)])
    return int(-search.result.fbest)


def placement(share: float, scenes: int) -> list[dict[str, Any]]:
    """Scenes of a sheet for the HydroLek, two with obstacles: our best beside random bases and CMA-ES."""
    robot, rows = ik.Robot.load("hydrolek_7w"), []
    for scene in range(scenes):
        W, rng = sheet(robot, scene, 1.2, 0.9), np.random.default_rng(scene)
        more: dict[str, Any] = {}
        if scene >= scenes - 2 and scenes > 2:
            box = ik.CollisionModel(robot).add_box((0.3, 0.3, 1.5), (*W[:, :2, 3].mean(axis=0), -0.4))
            more = {"avoid_collisions": box}
        began = clocks()
        found = ik.place(robot, W, count=3, **more)
        row = {"scene": scene, "obstacle": bool(more), "seconds": (clocks() - began).tolist(), "found": found[0].count}
        if not more:
            edge = np.array([W[:, :2, 3].min(axis=0) - robot.reach, W[:, :2, 3].max(axis=0) + robot.reach])
            some = int(2000 * share) if share < 1.0 else 2000
            bases = np.column_stack(
                [rng.uniform(edge[0], edge[1], (some, 2)), rng.uniform(-np.pi, np.pi, some), np.zeros(some)]
            )
            counts = counted(robot, bases, W)
            row |= {"random bases": some, "best random": int(counts.max())}
            row |= {"CMA-ES": another(robot, W, bases[counts.argmax()], 40, scene)}
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
