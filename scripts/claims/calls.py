"""Claims about single solves and loops: failure messages are true, and `follow` keeps its bound."""

import numpy as np
import pinocchio as pin
from common import Outcome, claim, inspection, uniform, unit

import ik_toolkit as ik


@claim("failures")
def failures(count: int, seed: int) -> Outcome:
    """A failed closed form returns a legal configuration no worse than that of `lm`, with matching errors and message."""
    rng = np.random.default_rng(seed)
    cases = broken = 0
    for robot in (inspection(), inspection(float(rng.uniform(0.05, 0.4)))):
        scale = robot.chain.scale
        for q in uniform(robot, max(count // 500, 2), rng):
            T = robot.fk(q).homogeneous
            T[:3, 3] *= rng.uniform(0.2, 1.6, 3)
            result, search = ik.solve(robot, T), ik.solve(robot, T, "lm")
            if result.success:
                continue
            cases += 1
            position, rotation = robot.errors(result.q, T)
            size, other = (
                (r.position_error / scale) ** 2 + 4.0 * np.sin(0.5 * r.orientation_error) ** 2 for r in (result, search)
            )
            said = f"{1000 * position:.3g} mm" in result.message or f"{position:.3g} m" in result.message
            right = abs(position - result.position_error) < 1e-9 and abs(rotation - result.orientation_error) < 1e-7
            broken += (
                search.success or size > other * (1 + 1e-9) or robot.outside(result.q) != [] or not (said and right)
            )
    return Outcome(cases, broken)


LOOP_ROBOTS = ("hydrolek_7w", "inspection_7dof", "panda", "ur5", "xarm7", "kinova")


@claim("loops")
def loops(count: int, seed: int) -> Outcome:
    """A loop that moves the target by 1 mrad or 1 mm per call: with follow no joint jumps, without it every jump is reported."""
    rng = np.random.default_rng(seed)
    calls, broken, words = 0, 0, ""
    while calls < count:
        robot = ik.Robot.load(LOOP_ROBOTS[int(rng.integers(len(LOOP_ROBOTS)))])
        following, plain = ik.Solver(robot, follow=True), ik.Solver(robot, "lm")
        q = uniform(robot, 1, rng)[0]
        T = robot.fk(q)
        step = pin.exp6(
            np.concatenate([1e-3 * unit(rng), np.zeros(3)] if rng.random() < 0.5 else [np.zeros(3), 1e-3 * unit(rng)])
        )
        size = np.where(np.array(robot.joint_kinds) == "prismatic", robot.reach, 1.0)
        for _ in range(min(1000, count)):
            T = T * step
            calls += 1
            near, free = following(T.homogeneous, q0=q), plain(T.homogeneous, q0=q)
            far = (np.abs(near.q - q) / size).max() > 0.5
            silent = (np.abs(free.q - q) / size).max() > 0.5 and free.attempt > 0 and not free.notice
            position, orientation = robot.errors(near.q, T.homogeneous)
            false = near.success and max(position, orientation) > 1e-6
            if far or silent or false:
                broken, words = broken + 1, f"{robot.name} from q={q.tolist()}: {near.status.name}, {free.notice!r}"
            if not near.success:
                break
            q = near.q
    return Outcome(calls, broken, words)
