"""Seven revolute joints: the curves of solutions of a pose, and where they end."""

import numpy as np
import pytest
import robots
from serial_arms import away

import ik_toolkit as ik
from ik_toolkit.solvers.every import on_self_motions
from ik_toolkit.solvers.self_motion import END, self_motions

LENGTHS = ("0 0 0.3", "0 0 0.05", "0.06 0 0.35", "0 0.04 0", "-0.05 0 0.3", "0 0 0", "0.08 0 0.05")


def seven(reach=2.6, limits=None):
    """An arm of seven joints, whose axes turn by right angles, with short offsets."""
    axes = ("0 0 1", "0 1 0", "0 0 1", "0 1 0", "0 0 1", "0 1 0", "0 0 1")
    limits = limits or [(-reach, reach)] * 7
    joints = (
        dict(kind="revolute", axis=a, xyz=x, limits=both) for a, x, both in zip(axes, LENGTHS, limits, strict=True)
    )
    return ik.Robot.load(robots.urdf(*joints))


@pytest.mark.parametrize("reach", [2.6, 3.13])  # the second leaves a gap that is thinner than a step
def test_every_point_of_a_curve_is_a_solution_and_its_ends_are_where_limits_are_met(reach):
    robot, rng, ends = seven(reach), np.random.default_rng(1), 0
    plan = ik.Solver(robot).plan
    for _ in range(8):
        q = robot.random_q(rng)
        T = robot.fk(q).homogeneous
        curves = self_motions(plan, T)
        assert min(away(curve.points, q).min() for curve in curves) < 0.06  # it passes by where the pose was made
        for curve in curves:
            reached = robot.chain.forward(curve.points)[0].reshape(-1, 4, 4)
            assert np.abs(reached - T).max() < 1e-9
            assert (curve.points >= robot.lower - 1e-9).all() and (curve.points <= robot.upper + 1e-9).all()
            assert np.abs(np.diff(curve.points, axis=0)).max() < 0.12  # one piece
            for (kind, joint), x in zip(curve.ends, (curve.points[0], curve.points[-1]), strict=True):
                if kind == END.limit:
                    ends += 1
                    assert min(x[joint] - robot.lower[joint], robot.upper[joint] - x[joint]) < 1e-8
                else:
                    assert kind == END.closed and away(curve.points[-1], curve.points[0]) < 1e-5
    assert ends > 10


def test_slices_twice_as_many_find_as_many_curves():
    robot, rng = seven(), np.random.default_rng(2)
    plan = ik.Solver(robot).plan
    for _ in range(4):
        T = robot.fk(robot.random_q(rng)).homogeneous
        assert len(self_motions(plan, T)) == len(self_motions(plan, T, 128)) > 0


def test_no_start_of_a_search_finds_a_solution_off_the_curves():
    robot, rng = seven(), np.random.default_rng(3)
    plan, T = ik.Solver(robot).plan, robot.fk(robot.random_q(rng)).homogeneous
    points = np.vstack([curve.points for curve in self_motions(plan, T)])
    found = ik.solve_all(robot, T, "lm", starts=300, count=300)
    assert len(found) > 50 and max(away(points, q).min() for q in found.q) < 0.06


def test_a_range_is_exact_at_folds_and_limits():
    """The largest value of a joint on a curve, where it turns back, is no less than any that a fine search finds."""
    robot, rng = seven(), np.random.default_rng(4)
    plan, T = ik.Solver(robot).plan, robot.fk(robot.random_q(rng)).homogeneous
    for curve in self_motions(plan, T):
        for i in range(7):
            at = int(np.argmax(curve.points[:, i]))
            if not 0 < at < len(curve.points) - 1:
                continue
            J = robot.chain.forward(curve.points[at : at + 1], jacobian=True)[1][0]
            others = np.linalg.svd(np.delete(J, i, axis=1))[1]
            assert others[-1] < 1e-4  # the six other joints are singular: a fold


def test_solve_all_names_the_curves_and_proves_nothing():
    robot, rng = seven(), np.random.default_rng(5)
    q = robot.random_q(rng)
    found = ik.solve_all(robot, robot.fk(q), q0=q)
    assert found.solver == "elimination" and not found.complete and len(found) > 5
    assert "64 slices" in found.message and "there may be others" in found.message
    assert found.distance[0] < 0.1 and (np.diff(found.distance) >= 0.0).all()
    family = found.families[0]
    lead = robot.joint_names.index(family.joints[0])
    assert robot.lower[lead] <= family.lower < family.upper <= robot.upper[lead]
    assert "limit of" in family.message or "closed" in family.message
    assert (found.q >= robot.lower).all() and (found.q <= robot.upper).all()
    searched = ik.solve_all(robot, robot.fk(q), "lm", starts=50)
    assert searched.solver == "lm"


def test_none_in_so_many_slices_is_no_proof():
    robot = seven()
    T = robot.fk(robot.home + 0.3).homogeneous
    T[0, 3] += 5.0
    found = ik.solve_all(robot, T, starts=20)
    assert not len(found) and not found.complete and not found.families and "none in 64 slices of" in found.message


@pytest.mark.parametrize(
    "options", [dict(free_turn="z"), dict(mask=(1, 1, 1, 1, 1, 0)), dict(joint_weights=(0, 1, 1, 1, 1, 1, 1))]
)
def test_other_targets_are_searched(options):
    robot = seven()
    plan = ik.Solver(robot, **options).plan
    assert on_self_motions(plan, robot.fk(robot.home).homogeneous[None], robot.home[None], 8) == (None, "")


def test_joints_that_reach_every_angle_end_no_curve():
    robot, rng = seven(limits=[(-7.0, 7.0)] * 7), np.random.default_rng(6)
    curves = self_motions(ik.Solver(robot).plan, robot.fk(rng.uniform(-3, 3, 7)).homogeneous)
    assert curves and all(curve.ends[0][0] == END.closed for curve in curves)


def test_joints_at_their_limits_may_leave_no_curve():
    robot, rng = seven(), np.random.default_rng(8)
    for _ in range(6):
        q = robot.random_q(rng)
        held = rng.permutation(7)[:3]
        q[held] = np.where(rng.random(3) < 0.5, robot.lower[held], robot.upper[held])
        found = ik.solve_all(robot, robot.fk(q), count=40)
        assert not found.complete and all(family.upper > family.lower for family in found.families)


def test_a_joint_that_stays_still_along_a_curve_does_not_keep_it_from_being_followed():
    """Where the first and the last three axes meet in a point each, the fourth joint does not move; the axes have any direction."""
    for seed in (5, 7, 9):
        rng = np.random.default_rng(seed)
        axes = [" ".join(map(str, axis)) for axis in rng.normal(size=(7, 3))]
        places = ["0 0 0"] * 7
        places[3], places[4] = (" ".join(map(str, place)) for place in rng.normal(0.0, 0.3, (2, 3)))
        joints = [dict(kind="revolute", axis=a, xyz=p, limits=(-2.9, 2.9)) for a, p in zip(axes, places, strict=True)]
        robot = ik.Robot.load(robots.urdf(*joints, dict(kind="fixed", xyz="0.1 0.05 0.2")))
        for q in rng.uniform(-2.9, 2.9, (3, 7)):
            T = robot.fk(q)
            assert ik.solve_all(robot, T, q0=q).distance[0] < 0.1  # a curve passes by where the pose was made
            for curve in self_motions(ik.Solver(robot).plan, T.homogeneous):
                assert (curve.upper - curve.lower).max() > 1e-3 and np.ptp(curve.points[:, 3]) < 1e-6


def test_a_range_beyond_the_limits_of_a_joint_with_full_turns_says_so():
    robot, rng, beyond = seven(reach=4.0), np.random.default_rng(8), 0
    for _ in range(4):
        for family in ik.solve_all(robot, robot.fk(robot.random_q(rng))).families:
            outside = family.lower < -4.0 or family.upper > 4.0
            assert outside == ("whole turns lead back" in family.message)
            beyond += outside
    assert beyond
