"""Load random, realistically written robots and check each with an FK that shares nothing with ours.

Usage: python scripts/break/robots.py [--kind urdf|tree|mjcf] [--seed N] [--count N].
urdf: one path, judged by tests/second_fk.py. It is wrong when the tip pose or the Jacobian of the compiled kernel or of
`Robot.fk` and `Robot.jacobian` is off by more than 1e-9 (lengths over its size), or a limit differs from the URDF's.
tree: two or three tips, the base anywhere, followers on all branches; wrong too when a target that the judge's FK gives at a
legal q ends as UNREACHABLE, or an answer is not at its target or outside the limits of a joint or follower.
mjcf: limited balls, chained equalities and tendons, judged by MuJoCo in the same way.
Exit code 1 if one is wrong or anything but a ModelError is raised; rejected robots are listed by reason.
"""

import argparse
import collections
import faulthandler
import logging
import re
import sys
import traceback
from pathlib import Path

import numpy as np

import ik_toolkit as ik
from ik_toolkit.errors import ModelError

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))
from random_trees import TreeCase, random_tree
from second_fk import Case, SecondFK, pose_errors, random_case

WRONG = 1e-9  # error that counts as wrong, over the robot's size or [rad]
MOST = 1e6  # [rad or m] limits beyond are brought down to this, with a note
TURNS = 31.0  # five turns of a continuous joint [rad]


def load(case: Case) -> ik.Robot:
    """The robot of a case."""
    robot = ik.Robot.load(case.text, base=case.base, tip=case.tip, locked=case.locked)
    return robot if case.tool is None else robot.with_tool(case.tool)


def configurations(robot: ik.Robot | ik.Tree, rng: np.random.Generator, count: int) -> np.ndarray:
    """Legal q (count, n): uniform, continuous joints over five turns, a quarter of the values at a limit."""
    far = np.where(np.array(robot.joint_kinds) == "prismatic", robot.reach, TURNS)
    low = np.where(np.isfinite(robot.lower), robot.lower, -far)
    high = np.where(np.isfinite(robot.upper), robot.upper, far)
    Q = (low + (high - low) * rng.random((count, robot.n))).clip(robot.lower, robot.upper)
    edge = np.where(rng.random(Q.shape) < 0.5, low, high)
    return np.where(rng.random(Q.shape) < 0.25, edge, Q)


def worst(robot: ik.Robot, judge: SecondFK, rng: np.random.Generator) -> dict[str, float]:
    """Largest errors of a robot: kernel and Pinocchio, pose and Jacobian, each over the robot's size."""
    Q, names = configurations(robot, rng, 16), robot.joint_names
    T, J = judge.fk(Q, names), judge.jacobian(Q, names)
    size = max(robot.reach, judge.largest_offset())
    poses, columns = robot.chain.forward(Q, jacobian=True)
    mine = np.array([robot.fk(q).homogeneous for q in Q]), np.array([robot.jacobian(q) for q in Q])
    found = {}
    for who, pose, jacobian in (("kernel", poses, columns), ("Robot", *mine)):
        position, angle = pose_errors(pose, T)
        found[f"{who} pose"] = max(position.max() / size, angle.max())
        off = jacobian - J
        off[:, :3] /= size
        found[f"{who} Jacobian"] = (np.abs(off) / scales(J, size)).max()
    return found


def scales(J: np.ndarray, size: float) -> np.ndarray:
    """Scale (N, 1, n) of each Jacobian column, at least 1: a mimic multiplier of 1000 scales its rounding error, too."""
    parts = np.concatenate([np.abs(J[:, :3]) / size, np.abs(J[:, 3:])], axis=1)
    return np.maximum(1.0, parts.max(axis=(0, 1))[None, None])


def limits_differ(robot: ik.Robot, judge: SecondFK, Q: np.ndarray) -> bool:
    """Whether the limits differ from those in the text (up to rounding for followers), or a legal q violates one."""
    near = dict(rtol=1e-12, atol=1e-12 * robot.reach)
    given = [np.where(np.isinf(x), x, x.clip(-MOST, MOST)) for x in judge.limits(robot.joint_names)]
    same = np.allclose(robot.lower, given[0], **near) and np.allclose(robot.upper, given[1], **near)
    return not same or bool(judge.outside(Q, robot.joint_names).any())


def check_urdf(rng: np.random.Generator) -> dict[str, float]:
    """Largest errors of a random robot with one tip; wrong limits count as an infinite one."""
    case = random_case(rng)
    robot = load(case)
    judge = case.judge()
    errors = worst(robot, judge, rng)
    if limits_differ(robot, judge, configurations(robot, rng, 16)):
        errors["limits"] = np.inf
    return errors


def check_tree(rng: np.random.Generator) -> dict[str, float]:
    """Largest errors of a random tree, and of its answers."""
    case: TreeCase = random_tree(rng)
    tree = ik.Tree.load(case.text, base=case.base, tips=case.tips)
    Q, names, judges = configurations(tree, rng, 8), tree.joint_names, case.judges()
    size = max([tree.reach, *(judge.largest_offset() for judge in judges)])
    poses = np.array([[T.homogeneous for T in tree.fk(q).values()] for q in Q])
    targets = np.stack([judge.fk(Q, names) for judge in judges], axis=1)
    J = np.concatenate([judge.jacobian(Q, names) for judge in judges])
    mine = np.concatenate(np.split(np.array([tree.jacobian(q) for q in Q]), len(judges), axis=1))
    off = mine - J
    off[:, :3] /= size
    position, angle = pose_errors(poses.reshape(-1, 4, 4), targets.reshape(-1, 4, 4))
    found = {"Tree pose": max(position.max() / size, angle.max())}
    found["Tree Jacobian"] = float((np.abs(off) / scales(J, size)).max())
    many = ik.solve_batch(tree, targets)
    found["UNREACHABLE"] = np.inf if (many.status == ik.Status.UNREACHABLE).any() else 0.0
    for f, judge in enumerate(judges):
        solved = many.q[many.success]
        if len(solved):
            p, r = pose_errors(judge.fk(solved, names), targets[many.success, f])
            found["answers"] = np.inf if (p > 1.001e-6).any() or (r > 1.001e-6).any() else 0.0
        found["limits"] = np.inf if any(one.outside(many.q, names).any() for one in judges) else 0.0
    return found


def check_mjcf(rng: np.random.Generator) -> dict[str, float]:
    """Largest errors of a random MJCF model, and of its answers."""
    from mjcf_models import Judge, random_mjcf  # needs mujoco

    text = random_mjcf(rng)
    judge, robot = Judge(text), ik.Robot.load(text, tip="tip")
    found = {"MJCF pose": 0.0, "constraints": 0.0}
    # Equalities that contradict each other beside the path concern no answer.
    impossible = any("contradicts" in note or "would be held" in note for note in robot.notes)
    for q in robot.random_q(rng, 6):
        judge.put(robot.joint_names, q)
        T, site = robot.fk(q), judge.data.site("tip")
        off = max(np.abs(T.translation - site.xpos).max(), np.abs(T.rotation.ravel() - site.xmat).max())
        found["MJCF pose"] = max(found["MJCF pose"], float(off))
        answer = ik.solve(robot, T)
        if answer.status == ik.Status.UNREACHABLE:
            found["UNREACHABLE"] = np.inf
        if answer.success and not impossible:
            judge.put(robot.joint_names, answer.q, answer.notice)
            allowed = 1e-5 if robot.constraints else WRONG  # constraints hold within the tolerances
            found["constraints"] = max(found["constraints"], judge.broken() * WRONG / allowed)
    return found


CHECKS = {"urdf": check_urdf, "tree": check_tree, "mjcf": check_mjcf}


def main(kind: str, seed: int, count: int) -> int:
    """Try `count` robots; return the exit code."""
    refused: collections.Counter[str] = collections.Counter()
    most: collections.Counter[str] = collections.Counter()
    wrong, crashes, tried = [], [], 0
    for i in range(count):
        try:
            errors = CHECKS[kind](np.random.default_rng([seed, i]))
        except ModelError as error:
            refused[re.sub(r"'[^']*'|-?\d+(\.\d+)?(e[+-]\d+)?", "*", str(error))] += 1
            continue
        except Exception:
            crashes.append((i, traceback.format_exc(limit=-1).strip().splitlines()[-1]))
            continue
        tried += 1
        for name, error in errors.items():
            most[name] = max(most[name], error)
            if not error <= WRONG:
                wrong.append((i, f"{name} off by {error:.2g}"))
    print(
        f"{kind}, seed {seed}: {count} random robots, {tried} loaded, {sum(refused.values())} refused, {len(crashes)} crashes"
    )
    for reason, times in refused.most_common():
        print(f"  refused {times}: {reason}")
    for name, error in most.items():
        print(f"  largest error, {name}: {error:.2g}")
    print(f"wrong: {len({i for i, _ in wrong})}")
    for i, what in [*wrong, *crashes][:20]:
        print(f"  robot {i}: {what}")
    return 1 if wrong or crashes else 0


if __name__ == "__main__":
    faulthandler.enable()  # reports where the process crashed
    logging.getLogger("ik_toolkit").setLevel(logging.ERROR)
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kind", choices=CHECKS, default="urdf")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--count", type=int, default=2400)
    arguments = parser.parse_args()
    sys.exit(main(arguments.kind, arguments.seed, arguments.count))
