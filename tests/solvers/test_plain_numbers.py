"""What `to_dict` and `to_ros` write is what the attributes say, name by name."""

import numpy as np
import pytest
import robots

import ik_toolkit as ik
from ik_toolkit import text

SAME = (
    "message", "solver", "position_error", "orientation_error", "iterations", "restarts", "attempt", "fk_evaluations",
    "elapsed", "seed", "notice", "collision",
)  # fmt: skip


def agrees(told, result):
    assert {name: told[name] for name in SAME} == {name: getattr(result, name) for name in SAME}
    assert told["clearance"] == pytest.approx(result.clearance, abs=1e-5)  # measured anew
    assert told["q"] == result.q.tolist() and told["limited_joints"] == list(result.limited_joints)
    assert told["success"] is result.success and told["status"] == result.status.name
    assert told["robot"] == result.robot.name and told["joint_names"] == list(result.robot.joint_names)


def test_of_a_solve():
    robot, rng = robots.load("hydrolek_7w"), np.random.default_rng(2)
    model = ik.CollisionModel(robot).add_sphere(0.05, (2.5, 0.0, 0.0), name="ball")
    for q in robot.random_q(rng, 4):
        result = ik.solve(robot, robot.fk(q), "lm", seed=7, q0=robot.home, restarts=40, avoid_collisions=model)
        agrees(result.to_dict(), result)
        assert "tips" not in result.to_dict()
        state = result.to_ros()
        assert state["name"] == list(robot.joint_names) and state["position"] == result.q.tolist()
        assert state["velocity"] == [] == state["effort"] and set(state["header"]) == {"stamp", "frame_id"}
    edge = ik.solve(robot, robot.fk(robot.lower), "lm", q0=robot.lower + 0.01)
    told = edge.to_dict()
    assert set(told["limited_joints"]) == {
        j for j, x, a in zip(robot.joint_names, edge.q, robot.lower, strict=True) if x <= a
    }
    away = ik.solve(robot, (9.0, 0.0, 0.0), "lm")
    assert away.to_dict()["success"] is False and away.to_dict()["orientation_error"] is None


def test_of_several_tips():
    tree = robots.load("two_arms")
    first, second = tree.tips
    T = tree.fk(tree.home)
    result = ik.solve(tree, {first: T[first].translation, second: None}, q0=tree.home)
    told = result.to_dict()
    agrees(told, result)
    assert told["tips"][second] == {"position_error": None, "orientation_error": None}
    assert told["tips"][first] == {"position_error": result.position_errors[first], "orientation_error": None}


def test_of_all_solutions():
    robot = robots.load("planar_2r")
    found = ik.solve_all(robot, robot.fk([0.3, 0.9]).translation, q0=[0.3, 0.9])
    told = found.to_dict()
    assert told["success"] is True and told["complete"] is found.complete is True
    for name in ("message", "solver"):
        assert told[name] == getattr(found, name)
    assert told["robot"] == "planar_2r" and told["joint_names"] == list(robot.joint_names)
    for name in ("distance", "position_error", "branches"):
        assert told[name] == getattr(found, name).tolist()
    assert told["solutions"] == found.q.tolist() and len(found) == 2 and told["orientation_error"] is None
    assert told["found_by"] == list(found.found_by) and told["families"] == [one._asdict() for one in found.families]
    one = found.keep(np.array([False, True]))
    assert len(one) == 1 and (one[0] == found[1]).all() and one.distance[0] == found.distance[1] > 0.0
    assert not one.complete and one.message == found.message and one.solver == found.solver
    assert found.keep(np.array([True, True])).complete
    assert (one.branches[0] == found.branches[1]).all() and one.found_by == found.found_by[1:]
    assert one.position_error[0] == found.position_error[1] and one.families == found.families
    none = ik.solve_all(robot, (9.0, 0.0, 0.0))
    assert none.to_dict()["success"] is False and none.to_dict()["solutions"] == []


def test_of_batches():
    robot, rng = robots.load("hydrolek_7w"), np.random.default_rng(3)
    T = np.array([robot.fk(q).homogeneous for q in robot.random_q(rng, 5)])
    T[3, 0, 3] += 9.0
    many = ik.solve_batch(robot, T, "lm")
    told = many.to_dict()
    for name in ("q", "position_error", "orientation_error", "success", "status", "iterations", "fk_evaluations"):
        assert np.array_equal(told[name], getattr(many, name)), name
    assert many.counts() == {name: n for name, n in many.counts().items() if n} and sum(many.counts().values()) == 5
    assert many.success.tolist() == [True, True, True, False, True] and many[3].status.name in many.counts()
    positions = ik.solve_batch(robot, T[:, :3, 3], "lm")
    assert "orientation_error" not in positions.to_dict() and positions.orientation_error is None
    tree = robots.load("two_arms")
    poses = [tree.fk(q) for q in tree.random_q(rng, 3)]
    each = {tip: np.array([pose[tip].homogeneous for pose in poses]) for tip in tree.tips}
    both = ik.solve_batch(tree, each)
    told = both.to_dict()
    for tip in tree.tips:
        assert np.array_equal(told[f"{tip}.position_error"], both.position_errors[tip])
        assert np.array_equal(told[f"{tip}.orientation_error"], both.orientation_errors[tip])


def test_of_explanations():
    pytest.importorskip("sympy", reason="the extra 'explain' is not installed")
    robot = robots.load("planar_2r")
    made = ik.solve(robot, robot.fk([0.3, 0.9]).translation).explain()
    told, worked = made.to_dict(), made.worked
    assert told["closed_form"] == made.form == "planar-2r" and told["why"] == made.why and told["chosen"] == made.chosen
    assert len(told["branches"]) == len(worked.branches) == 2
    for one, branch, error in zip(told["branches"], worked.branches, made.errors, strict=True):
        assert one["label"] == branch.label != "" and one["q"] == branch.q.tolist()
        assert one["outside"] == list(branch.outside)
        assert one["steps"] == [step.to_dict() for step in branch.steps] and one["steps"]
        assert (one["position_error"], one["orientation_error"]) == tuple(error)
    assert told["given"] == [step.to_dict() for step in worked.steps if step.formula is None] != []
    assert told["steps"] == [step.to_dict() for step in worked.steps if step.formula is not None]
    assert told["free"] is None
    table = told["dh"]["tool"]
    assert set(table) == {"convention", "rows", "base", "tool"} and len(table["rows"]) >= 2
    assert set(table["rows"][0]) == {"name", "type", "theta", "d", "a", "alpha"} and np.shape(table["base"]) == (4, 4)
    assert told["iterations"] == text.plain(made.iterations._asdict())
    searched = ik.solve(robots.load("hydrolek_7w"), (1.0, 0.1, 0.2), "lm").explain()
    told, steps = searched.to_dict(), searched.iterations
    assert told["branches"] == [] == told["given"] == told["steps"] and told["closed_form"] is None and told["why"]
    assert told["iterations"] == text.plain(steps._asdict()) != {} and told["chosen"] is None
