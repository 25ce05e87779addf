"""The contract on arms of one to five joints, whose full poses are those they draw themselves."""

import numpy as np
import pytest
from robots import few_joints

import ik_toolkit as ik
from ik_toolkit.solvers.registry import BY_NAME
from ik_toolkit.testing import CLAUSES, Case

# Of the rules that differ by a line of a step only some; transpose and state-space take seconds here.
CASES = [("lm", count) for count in (1, 2, 3, 4, 5)] + [
    (name, count) for name in ("dls", "ccd", "pid") for count in (1, 4)
]


@pytest.mark.parametrize("kind", ["pose", "position"])
@pytest.mark.parametrize(("name", "count"), CASES)
def test_every_clause_holds(name, count, kind):
    case = Case(name, few_joints(count, 30 + count), kind, seed=3)
    if not getattr(BY_NAME[name], kind) or not case.fits():
        return
    for clause in CLAUSES.values():
        clause(case)


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5])
def test_every_call_takes_what_the_arm_draws(count):
    robot = few_joints(count, 30 + count)
    Q = robot.random_q(np.random.default_rng(0), 20)
    poses = np.array([robot.fk(q).homogeneous for q in Q])
    bound = ik.Solver(robot)
    for T in (poses, poses[:, :3, 3]):
        many = ik.solve_batch(robot, T)
        assert many.success.all() and not any(robot.outside(q) for q in many.q)
        for q, one in zip(Q, T, strict=True):
            for found in (ik.solve(robot, one), bound(one), ik.solve(robot, one, q0=q)):
                assert found.success and robot.errors(found.q, one)[0] <= 1e-6
        listed = ik.solve_all(robot, T[0])
        assert len(listed) and all(robot.errors(q, T[0])[0] <= 1e-6 for q in listed.q)
    listed = ik.solve_all(robot, poses[0]).q
    assert np.abs(listed - Q[0]).max(axis=1).min() < 1e-4  # the drawn one is among them

    way = np.linspace(robot.home, robot.home + 0.1, 51)
    tracker = ik.Tracker(robot, q0=robot.home)
    for q in [*way, *[way[-1]] * 100]:
        step = tracker.update(robot.fk(q), 0.01)
    assert step.position_error < 1e-4 and step.orientation_error < 1e-3
    line = ik.waypoints([robot.fk(q).translation for q in way[::10]], duration=1.0)
    run = ik.track(robot, line, q0=robot.home)
    assert np.isfinite(run.q).all() and not any(robot.outside(q) for q in run.q)
