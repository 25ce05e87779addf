"""Claims about closed forms and solution lists: no solvable target is rejected, no branch is missing."""

import numpy as np
from common import Outcome, claim, drawn, inspection, lost, together, uniform

import ik_toolkit as ik

SHOULDER, ELBOW = "arm_pitch", "elbow_pitch"


@claim("level-arms")
def level_arms(count: int, seed: int) -> Outcome:
    """No target of a legal configuration with a level arm (one angle is free there) is lost, lift free or locked."""
    rng = np.random.default_rng(seed)
    return together(
        *(
            lost(robot, drawn(robot, count // 2, rng, **{SHOULDER: 0.0}))
            for robot in (inspection(), inspection(float(rng.uniform(0.05, 0.4))))
        )
    )


@claim("straight-elbows")
def straight_elbows(count: int, seed: int) -> Outcome:
    """No target of a legal configuration with a straight elbow is lost, with the arm level too, lift free or locked."""
    rng = np.random.default_rng(seed)
    robots = (inspection(), inspection(float(rng.uniform(0.05, 0.4))))
    cases = ({ELBOW: 0.0}, {ELBOW: 0.0, SHOULDER: 0.0})
    return together(*(lost(robot, drawn(robot, count // 4, rng, **at)) for robot in robots for at in cases))


@claim("limit-corners")
def limit_corners(count: int, seed: int) -> Outcome:
    """No target of a configuration with 2 to 5 joints at their limits is lost, lift free or locked."""
    rng = np.random.default_rng(seed)
    outcomes = []
    for robot in (inspection(), inspection(float(rng.uniform(0.05, 0.4)))):
        Q = uniform(robot, count // 2, rng)
        ends = np.where(rng.random(Q.shape) < 0.5, robot.lower, robot.upper)
        rank = np.argsort(rng.random(Q.shape), axis=1)
        Q = np.where(rank < rng.integers(2, 6, (len(Q), 1)), ends, Q)
        outcomes.append(lost(robot, Q))
    return together(*outcomes)


@claim("loose-tolerances")
def loose_tolerances(count: int, seed: int) -> Outcome:
    """No target less than the tolerance away from a legal configuration, joints at limits among them, is called impossible."""
    rng = np.random.default_rng(seed)
    outcomes = []
    for robot in (inspection(), inspection(float(rng.uniform(0.05, 0.4))), ik.Robot.load("planar_2r")):
        planar = robot.n == 2
        for tolerance in (1e-4, 1e-3, 1e-2):
            Q = uniform(robot, count // 9, rng)
            ends = np.where(rng.random(Q.shape) < 0.5, robot.lower, robot.upper)
            Q = np.where(rng.random(Q.shape) < 0.3, ends, Q)
            move = rng.normal(size=(len(Q), 3)) * (1.0, 1.0, 0.0 if planar else 1.0)
            move *= 0.9 * tolerance / np.linalg.norm(move, axis=1, keepdims=True)
            outcomes.append(lost(robot, Q, planar, move, tolerance=tolerance))
    return together(*outcomes)


def folding(rng: np.random.Generator) -> ik.Robot:
    """A planar arm with equal links that folds onto its base, with random limits."""
    low, high = rng.uniform(-3.0, -0.5), rng.uniform(0.5, 3.0)
    limits = (
        f'<limit lower="{low}" upper="{high}" effort="1" velocity="1"/>',
        '<limit lower="-4" upper="4" effort="1" velocity="1"/>',
    )
    joints = "".join(
        f'<link name="l{k + 1}"/><joint name="j{k}" type="revolute"><parent link="l{k}"/><child link="l{k + 1}"/>'
        f'<origin xyz="{0.5 * k} 0 0"/><axis xyz="0 0 1"/>{limit}</joint>'
        for k, limit in enumerate(limits)
    )
    tip = '<link name="tip"/><joint name="end" type="fixed"><parent link="l2"/><child link="tip"/><origin xyz="0.5 0 0"/></joint>'
    return ik.Robot.load(f'<robot name="folding"><link name="l0"/>{joints}{tip}</robot>', tip="tip")


@claim("planar")
def planar(count: int, seed: int) -> Outcome:
    """A planar arm loses no target: equal links, on the base, stretched out, at its limits."""
    rng = np.random.default_rng(seed)
    outcomes = []
    for robot in (folding(rng), ik.Robot.load("planar_2r")):
        elbow = robot.joint_names[1]
        half = np.pi if robot.upper[1] > np.pi else robot.upper[1]
        for value in (0.0, half, float(robot.lower[1])):
            outcomes.append(lost(robot, drawn(robot, count // 6, rng, **{elbow: value}), True))
    return together(*outcomes)


def members(rng: np.random.Generator) -> list[tuple[ik.Robot, np.ndarray, bool]]:
    """Robots, configurations on a family of solutions, and whether the target is a position."""
    locked, arm = inspection(float(rng.uniform(0.05, 0.4))), inspection()
    cases = [(locked, drawn(locked, 1, rng, **{SHOULDER: 0.0})[0], False), (arm, drawn(arm, 1, rng)[0], False)]
    fold = folding(rng)
    cases.append((fold, drawn(fold, 1, rng, j1=np.pi)[0], True))
    try:
        ur5 = ik.Robot.load("ur5", tip="tool0")
        q = uniform(ur5, 1, rng)[0]
        q[4] = 0.0
        cases.append((ur5, q, False))
    except ik.IKError:
        pass  # example-robot-data is not installed
    return cases


@claim("families")
def families(count: int, seed: int) -> Outcome:
    """Where a family of solutions exists `solve_all` is never complete, says so, and lists at most `count`."""
    rng = np.random.default_rng(seed)
    cases = broken = 0
    words = ""
    for _ in range(max(count // 5000, 1)):
        for robot, q, position in members(rng):
            T = robot.fk(q)
            found = ik.solve_all(robot, T.translation if position else T, starts=200, count=16)
            cases += 1
            if found.complete or not found.families or not 0 < len(found) <= 16:
                broken += 1
                words = f"last: {robot.name} q={q.tolist()}: {found}"
    return Outcome(cases, broken, words)


def nearest(Q: np.ndarray, q: np.ndarray) -> float:
    """Largest joint difference of the row of Q nearest q, angles modulo turns."""
    apart = np.abs(Q - q)
    return float(np.minimum(apart, np.abs(2 * np.pi - apart)).max(axis=1, initial=0.0).min(initial=np.inf))


@claim("recall")
def recall(count: int, seed: int) -> Outcome:
    """`solve_all` lists the configuration a target was made from, at generic and singular poses; complete lists miss nothing.

    6R: by our closed form, and by starts; what starts find must be in any list that is called complete. A list from starts
    alone, which claims nothing, may miss one case in a hundred: nearly level arms with a straight elbow are doubly singular.
    """
    rng = np.random.default_rng(seed)
    locked = inspection(float(rng.uniform(0.05, 0.4)))
    robots = [(locked, "auto", count // 500, ({}, {ELBOW: 0.0})), (locked, "lm", count // 5000, ({}, {ELBOW: 0.0}))]
    try:
        panda = ik.Robot.load("panda", tip="panda_hand_tcp").locked({"panda_joint5": float(rng.uniform(-1.0, 1.0))})
        robots.append((panda, "auto", count // 5000, ({},)))
        robots.append((ik.Robot.load("ur5", tip="tool0"), "auto", count // 5000, ({}, {"elbow_joint": 0.0})))
    except ik.IKError:
        pass  # example-robot-data is not installed
    cases = broken = missed = 0
    words = ""
    for robot, solver, number, poses in robots:
        for values in poses:
            for q in drawn(robot, max(number, 2), rng, **values):
                found = ik.solve_all(robot, robot.fk(q), solver, starts=1000)
                wrong = nearest(found.q, q) > 2e-3
                if found.complete:
                    other = ik.solve_all(robot, robot.fk(q), "lm", starts=50)
                    # For a nearly level, straight arm, solutions within 1e-9 spread over 0.01 rad; other branches are farther away.
                    wrong |= any(nearest(found.q, x) > 0.05 for x in other)
                cases += 1
                broken += wrong and found.complete
                missed += wrong and not found.complete
                words = f"last: {robot.name} q={q.tolist()}: {found}" if wrong else words
    return Outcome(cases, broken + missed * (missed > 0.01 * cases), f"{missed} missed by starts alone; {words}")
