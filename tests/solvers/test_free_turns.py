"""All solutions where three or five revolute joints are left by a target with free rotations."""

import numpy as np
import pytest
import robots

import ik_toolkit as ik

PLACES = ("0 0 .1", ".05 0 .1", "0 0 .3", "0 .02 .3", ".1 0 .1")
TURNS = ("0 0 0", ".3 .2 .4", "1 0 0", ".2 .3 .5", ".2 .9 .1")


def arm(count, turned=True, tool=".15 .05 .2"):
    """An arm of `count` revolute joints in different directions, with a tool."""
    axes = ("0 0 1", "0 1 0", "0 1 .3" if turned else "0 1 0", "0 1 0", "1 0 0")
    joints = [
        dict(kind="revolute", axis=axes[k], xyz=PLACES[k], rpy=TURNS[k] if turned else "0 0 0", limits=(-3, 3))
        for k in range(count)
    ]
    return ik.Robot.load(robots.urdf(*joints, dict(kind="fixed", xyz=tool, rpy=".4 .2 .1" if turned else "0 0 0")))


def pointed(T):
    return ik.pose(T[:3, 3], direction=T[:3, 2]), {}


def turned(T):
    return T, {"free_turn": "z"}


def placed(T):
    return T[:3, 3].copy(), {}


@pytest.mark.parametrize("turned_axes", [True, False])
@pytest.mark.parametrize(("joints", "make"), [(5, pointed), (5, turned), (3, placed)])
def test_every_solution_is_listed_within_limits_and_certified(joints, make, turned_axes):
    robot, complete = arm(joints, turned_axes), 0
    for q in robots.sample(robot, 12, seed=1)[0]:
        target, options = make(robot.fk(q).homogeneous)
        found = ik.solve_all(robot, target, q0=q, **options)
        assert np.abs(found.q - q).max(axis=1).min() < 1e-4
        assert (found.q >= robot.lower).all() and (found.q <= robot.upper).all()
        assert (np.diff(found.distance) >= 0.0).all()
        assert (found.position_error < 1e-6).all() and found.complete == (found.solver == "elimination")
        complete += found.complete
        if found.complete:
            assert found.certificate.status == "CERTAIN" and found.certificate.solutions >= len(found)
    assert complete >= 11
    searched = ik.solve_all(robot, target, "lm", starts=400, **options)
    assert not searched.complete
    assert all(np.abs(found.q - one).max(axis=1).min() < 1e-3 for one in searched.q)


def test_no_solution_within_limits_is_certified_too():
    robot, none = arm(5), 0
    tight = robot.narrowed({name: (-0.6, 0.6) for name in robot.joint_names})
    for q in np.random.default_rng(2).uniform(-3, 3, (10, 5)):
        target, _ = pointed(robot.fk(q).homogeneous)
        found = ik.solve_all(tight, target)
        none += found.complete and not len(found)
        assert not len(found) or (np.abs(found.q) <= 0.6 + 1e-9).all()
    assert none >= 5


def test_a_turn_that_the_last_joint_makes_is_a_family():
    robot = arm(5, turned=False, tool=".15 0 0")  # the tip is on the axis of joint 5
    T = robot.fk(robots.sample(robot, 1, seed=3)[0][0]).homogeneous
    found = ik.solve_all(robot, ik.pose(T[:3, 3], direction=T[:3, 0], axis=(1, 0, 0)), starts=100)
    assert len(found) and not found.complete and found.solver == "lm"


def test_planar_arms_and_other_parts_are_searched_as_before():
    planar = robots.load("planar_3r")
    found = ik.solve_all(planar, planar.fk(planar.home).homogeneous[:3, 3], starts=50)
    assert found.solver == "lm" and not found.complete and found.families
    five = arm(5)
    target, _ = pointed(five.fk(five.home).homogeneous)
    assert ik.solve_all(five, target, slack=(1e-3,) * 6, starts=50).solver == "lm"
    assert ik.solve_all(five, target, "lm", starts=50).solver == "lm"
