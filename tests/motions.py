"""Path results shared by tests, made without a search."""

import numpy as np
from robots import planar_pose

import ik_toolkit as ik
from ik_toolkit.kernel.counted_error import KIND
from ik_toolkit.paths.continuity import check, densify, settle_on_targets
from ik_toolkit.paths.result import PathResult, PathStatus, Reconfiguration
from ik_toolkit.solvers.options import make_options
from ik_toolkit.solvers.plan import Plan
from ik_toolkit.solvers.registry import find_row


def plan_for(robot, **options):
    """The default solver bound to a robot."""
    row = find_row("lm")
    return Plan(robot, row, row.load()(), make_options(options))


def tips(robot, q):
    """Poses (N, F, 4, 4) of the tips at q (N, n)."""
    return np.array(
        [[arm.fk(row[at]).homogeneous for arm, at in zip(robot.arms, robot.places, strict=True)] for row in q]
    )


def as_result(robot, q, breaks=(), collision=None, kind=KIND.pose, **options):
    """PathResult of the motion q (N, n) itself: its poses are those it passes."""
    plan, kinds, T = plan_for(robot, **options), (kind,) * len(robot.tips), tips(robot, q)
    step, tolerance = (np.radians(7.0), 0.02), (1e-3, np.radians(1.0))
    curve, at, cut = densify(plan, kinds, q, T, list(breaks), step, tolerance)
    proof = check(plan, kinds, curve, at, T, cut, collision)
    status = PathStatus.RECONFIGURES if len(breaks) else PathStatus.FOLLOWED
    return PathResult(
        robot=robot, targets=T, kinds=kinds, options=plan.options, q=q, status=status, message="made for a test",
        position_error=np.zeros(len(q)), orientation_error=np.zeros(len(q)), curve=curve, at=at, continuity=proof,
        reconfigurations=tuple(Reconfiguration(k, q[k + 1] - q[k]) for k in breaks), collision=collision,
    )  # fmt: skip


def wave(robot, count=40, size=0.3, seed=0):
    """Smooth joint motion (N, n) about home, inside the limits."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0.0, 1.0, count)[:, None]
    turns, shift = rng.uniform(0.3, 1.2, robot.n), rng.uniform(0.0, 6.0, robot.n)
    room = np.minimum(robot.upper - robot.home, robot.home - robot.lower)
    reach = np.minimum(size * np.where(robot.slides, 0.2, 1.0), 0.9 * room)
    return robot.home + reach * np.sin(turns * 6.0 * t + shift)


def load(name):
    """A shipped robot."""
    return ik.Robot.load(name)


def between(robot, a, b, count):
    """Poses (count, 4, 4) of a motion that is linear in the joints."""
    return np.array([robot.fk(q).homogeneous for q in np.linspace(a, b, count)])


def moved(T, by):
    """A pose (4, 4) moved by each of (N, 3)."""
    poses = np.repeat(T[None], len(by), axis=0)
    poses[:, :3, 3] += by
    return poses


def folding(count):
    """Poses (count, 4, 4) for planar_3r: no branch is legal all along, one change does (scripts/benchmarks/path_truth.py)."""
    s = np.linspace(0.0, 1.0, count)[:, None]
    curve = (1 - s) ** 2 * [5.06, -0.36, -0.82] + 2 * s * (1 - s) * [5.78, -1.06, -0.45] + s * s * [5.02, -1.58, 0.28]
    return np.array([planar_pose(*one) for one in curve])


def followed(plan, kind, T):
    """Joints (N, n) along poses (N, 1, 4, 4) of a tip, each solved from the last, the first from home."""
    q, rows = plan.robot.home[None], []
    for pose in T:
        q, good = settle_on_targets(plan, (kind,), q, pose[None])
        assert good.all()
        rows.append(q[0])
    return np.array(rows)
