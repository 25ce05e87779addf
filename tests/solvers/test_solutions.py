"""Lists of solutions: `complete` is never wrong, families are reported, branches have names."""

import importlib.util

import numpy as np
import pytest
import robots
from serial_arms import away

import ik_toolkit as ik

needs_eaik = pytest.mark.skipif(importlib.util.find_spec("eaik") is None, reason="EAIK is not installed")
needs_data = pytest.mark.skipif(not robots.have_data(), reason="example-robot-data is not installed")


def test_a_level_arm_is_a_family():
    robot = robots.load("locked")
    rng = np.random.default_rng(0)
    for _ in range(10):
        q = robot.random_q(rng)
        q[robot.joint_names.index("arm_pitch")] = 0.0
        found = ik.solve_all(robot, robot.fk(q), count=20)
        assert not found.complete and 1 < len(found) <= 20
        assert all(not robot.outside(x) for x in found) and found.position_error.max() < 1e-6
        inside = [f for f in found.families if f.joints == ("column_yaw", "arm_yaw") and f.lower <= q[0] <= f.upper]
        assert inside and "is free" in inside[0].message
        for x in np.linspace(inside[0].lower, inside[0].upper, 7):  # the range is legal from end to end
            assert np.abs(found.q[:, 0] - x).min() < 2.0
        other = ik.solve_all(robot, robot.fk(q), "lm", starts=100, count=20)
        assert not other.complete and len(other) <= 20 and {"column_yaw", "arm_yaw"} <= set(other.families[0].joints)
    plain = ik.solve_all(robot, robot.fk(robot.home + 0.1))
    assert plain.complete and plain.families == ()


@pytest.mark.parametrize("limits", [(-5.0, 5.0), (-1.0, 2.0), (4.0, 12.0), (-6.0, -2.5), (-6.28, 6.28), (-3.5, 3.5)])
def test_folded_links_are_a_family_of_every_angle_within_limits(limits):
    """Two equal links folded onto the base: the first may have any angle within one turn, the one about home if several fit."""
    joints = [dict(kind="revolute", limits=limits), dict(kind="revolute", xyz="0.5 0 0", limits=(-3.2, 3.2))]
    robot = ik.Robot.load(robots.urdf(*joints, dict(kind="fixed", xyz="0.5 0 0"), name="folding"))
    middle, half = np.mean(limits), min(0.5 * (limits[1] - limits[0]), np.pi)
    low, high = middle - half, middle + half
    found = ik.solve_all(robot, [0.0, 0.0, 0.2], count=9)
    (family,) = found.families
    assert found.solver == "planar-2r" and not found.complete and family.joints == ("j0",)
    assert (family.lower, family.upper) == pytest.approx((low, high))
    step = 2 * half / (len(found) - 1)  # of two ends that are a turn apart one is listed
    assert len(found) <= 9 and found.q[:, 0].min() < low + 1.1 * step and found.q[:, 0].max() > high - 1.1 * step
    assert half == np.pi or (len(found), found.q[:, 0].min(), found.q[:, 0].max()) == (9, *limits)
    assert f"j0 is free from {low:.6g} to {high:.6g} rad" in found.message
    for q0 in np.linspace(*limits, 4):
        (family,) = ik.solve_all(robot, [0.0, 0.0, 0.2], q0=[q0, 0.0], count=9).families
        assert limits[0] <= family.lower <= q0 <= family.upper <= limits[1]
        assert family.upper - family.lower == pytest.approx(2 * half)


@needs_data
def test_a_wrist_that_leaves_an_angle_free_is_a_family_and_a_straight_elbow_is_none():
    robot = robots.load("ur5")
    q = np.array([0.3, -1.2, 1.4, -0.5, 0.0, 0.8])
    found = ik.solve_all(robot, robot.fk(q), starts=300, count=24)
    assert not found.complete and len(found) <= 24
    assert set(found.families[0].joints) >= {"shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_3_joint"}
    assert found.families[0].joints[0] == "wrist_3_joint"  # It may turn as far as its limits let it.
    assert (found.families[0].lower, found.families[0].upper) == (robot.lower[5], robot.upper[5])
    for x in np.linspace(-3.0, 3.0, 5):
        values = {"shoulder_pan_joint": (0.3, 0.01), "wrist_2_joint": (0.0, 0.01), "wrist_3_joint": (x, 1e-9)}
        box = {name: (value - off, value + off) for name, (value, off) in values.items()}
        assert ik.solve(robot, robot.fk(q), "lm", limits=box, restarts=60).success
    q = np.array([0.3, -1.2, 0.0, -0.5, 0.9, 0.8])
    found = ik.solve_all(robot, robot.fk(q), starts=300)
    assert found.families == () and away(found.q, q).min() < 1e-3


@needs_eaik
@needs_data
def test_answers_of_eaik_are_finished_and_completed_by_starts():
    rng = np.random.default_rng(1)
    arms = [(robots.load("ur5"), {"elbow_joint": 0.0}), (robots.load("panda").locked({"panda_joint5": 0.3}), {})]
    for robot, values in arms:
        for _ in range(8):
            q = robot.random_q(rng)
            q = np.clip(q, -2.5, 2.5) if values else q
            for name, value in values.items():
                q[robot.joint_names.index(name)] = value
            found = ik.solve_all(robot, robot.fk(q), "eaik", starts=100)
            assert not found.complete and away(found.q, q).min() < 1e-3
            assert set(found.found_by) <= {"eaik", "lm"} and "eaik" in found.found_by
            assert ik.solve(robot, robot.fk(q), "eaik").success


def test_a_bound_list_is_that_of_solve_all_and_names_its_branches():
    robot = robots.load("locked")
    solver = ik.Solver(robot, limits=False)
    _, T = robots.sample(robot, 20, seed=4)
    for pose in T:
        found = solver.all(pose)
        assert np.array_equal(found.q, ik.solve_all(robot, pose, limits=False).q)
        assert found.complete and len({tuple(signs) for signs in found.branches.tolist()}) == len(found) == 8
        elbow = robot.joint_names.index("elbow_pitch")
        assert (np.sign(np.sin(found.q[:, elbow])) == found.branches[:, 1]).all()
    many = solver.all(T)
    assert len(many) == 20 and many.complete.all() and many.q.shape == (160, 6) and many.branches.shape == (160, 3)
    assert (np.bincount(many.target) == 8).all() and np.array_equal(many[3].q, solver.all(T[3]).q)
    assert np.array_equal(many.branches, np.concatenate([one.branches for one in many]))
    planar = ik.Solver(ik.Robot.load("planar_2r"))
    both = planar.all(np.array([[0.9, 0.9, 0.0], [0.5, 1.0, 0.0]]))
    assert both.branches.tolist() == [[0, 1, 0], [0, -1, 0]] * 2 or both.branches[:, 1].sum() == 0
    assert both.orientation_error is None
    rough = T[0].round(5)
    assert len(solver.all(rough)) == 8 and "projected" in solver.all(rough).message


def test_a_shoulder_on_the_sixth_or_seventh_axis_is_a_family():
    robot = robots.load("locked")
    rng = np.random.default_rng(0)
    yaw, elbow = (robot.joint_names.index(name) for name in ("forearm_yaw", "elbow_pitch"))
    for leading, values in (
        ("elbow_pitch", {yaw: np.pi / 2}),
        ("wrist_pitch", {yaw: np.arccos(180 / 290), elbow: np.pi}),
    ):
        for _ in range(5):
            q = rng.uniform(-3.0, 3.0, 6)
            q[list(values)] = list(values.values())
            found = ik.solve_all(robot, robot.fk(q), limits=False, count=16)
            assert not found.complete and 1 < len(found) <= 16 and found.families[0].joints[0] == leading
            assert len({*found.families[0].joints}) == 4


@pytest.mark.parametrize("limits", [(-6.0, 2.0), (-2.0, 6.0), (-6.2, -0.1)])
def test_each_joint_is_on_the_turn_that_its_limits_allow(limits):
    joints = [dict(kind="revolute", limits=limits, xyz="0.5 0 0")] * 2
    robot = ik.Robot.load(robots.urdf(*joints, dict(kind="fixed", xyz="0.4 0 0")))
    rng = np.random.default_rng(5)
    for q in robot.random_q(rng, 20):
        T = robot.fk(q).translation
        for q0 in robot.random_q(rng, 3):
            found = ik.solve_all(robot, T, q0=q0)
            assert len(found) and not any(robot.outside(one) for one in found.q)
            assert max(np.linalg.norm(robot.fk(one).translation - T) for one in found.q) < 1e-4


def test_one_solution_or_none_is_no_family():
    robot = robots.load("planar_2r")
    for x, number in ((9.0, 0), (2.0, 1)):  # out of reach, stretched
        found = ik.solve_all(robot, np.array([x, 0.0, 0.0]))
        assert len(found) == number and found.complete and found.families == ()


def test_no_more_than_asked_for_are_listed():
    robot, rng = ik.Robot.load("planar_3r"), np.random.default_rng(12)
    for _ in range(5):
        found = ik.solve_all(robot, robot.fk(robot.random_q(rng)), count=1)
        assert len(found) == 1 and not found.complete


def test_a_free_turn_about_a_joint_and_slack_leave_infinitely_many():
    arm = ik.Robot.load("hydrolek_7w").locked({"wrist_pitch": -0.7})
    target = arm.fk(arm.home)
    turned = ik.solve_all(arm, target, "lm", starts=40, free_turn=(0, 0, 1))
    assert turned.families[0].joints == ("wrist_roll",) and "infinitely many" in turned.message
    assert ik.solve_all(arm, target, "lm", starts=40, free_turn=(1, 0, 0)).families == ()
    six = ik.Robot.load("hydrolek_7w")
    for frame in ("base", "tip", "target"):
        half = {"mask": (1, 1, 1, 1, 1, 0.5), "frame": frame, "starts": 40}
        assert ik.solve_all(six, target, **half).families == ()
        assert ik.solve_all(six, target, slack=(0.01, 0, 0, 0, 0, 0), **half).families


def test_what_solve_finds_is_listed_also_between_the_samples_of_a_family():
    arm, rng = ik.Robot.load("inspection_7dof"), np.random.default_rng(1)
    column = arm.joint_names.index("column_yaw")
    for q in arm.random_q(rng, 20):
        near = np.clip(q[column] + [-0.05, 0.05], arm.lower[column], arm.upper[column])
        found = ik.solve_all(arm, arm.fk(q), limits={"column_yaw": near})
        if ik.solve(arm, arm.fk(q), limits={"column_yaw": near}).success:
            assert len(found) and not found.complete and found.position_error.max() < 1e-6


def test_a_part_of_a_list_is_not_complete_and_a_list_that_was_cut_says_so():
    arm = ik.Robot.load("hydrolek_7w")
    every = ik.solve_all(arm, arm.fk(arm.home), limits=False)
    assert every.complete and every.keep(np.argsort(every.q[:, 0])).complete and not every.keep([0]).complete
    cut = ik.solve_all(arm, arm.fk(arm.home), limits=False, count=2)
    assert len(cut) == 2 and not cut.complete and "the 2 nearest are listed" in cut.message
    assert ik.solve_all(arm, arm.fk(arm.home), limits=False, count=len(every)).message == every.message
    both = ik.Solver(arm).all([arm.fk(arm.home), arm.fk(arm.home + 0.1)])
    assert len(both) == 2 and both[1].complete and np.allclose(both[1].q[0], arm.home + 0.1, atol=1e-5)


@pytest.mark.parametrize(("ratio", "limits"), [(1, True), (2, False), (-1, False)])
def test_solutions_that_are_turns_apart_are_listed_once_with_mimic_joints_and_for_several_tips(ratio, limits):
    wide, up, on = (-7.0, 7.0), "0 1 0", "0.4 0 0"
    arm = [
        robots.joint("a", "revolute", "o", "l1", limits=wide),
        robots.joint("b", "revolute", "l1", "l2", up, on, limits=(-15.0, 15.0), mimic=robots.tie("a", ratio)),
        robots.joint("c", "revolute", "l2", "l3", up, on, limits=wide),
        robots.joint("d", "fixed", "l3", "hand", xyz=on),
        robots.joint("e", "revolute", "l1", "l4", "1 0 0", limits=wide),
        robots.joint("f", "fixed", "l4", "foot"),
    ]
    text = robots.branches(*arm)
    for robot in (ik.Robot.load(text, tip="hand"), ik.Tree.load(text, tips=["hand", "foot"])):
        q = np.array([1.0, 1.1, 1.2])[: robot.n]
        found = ik.solve_all(robot, robot.fk(q), starts=300, limits=limits)
        assert len(found) == 1 and np.allclose(found.q[0], q, atol=1e-6)
        if limits:
            turned = ik.solve_all(robot, robot.fk(q), starts=300, all_turns=True)
            assert len(turned) == 2**robot.n and len(np.unique(np.round(turned.q, 6), axis=0)) == len(turned)


@pytest.mark.parametrize(("kind", "ratio"), [("prismatic", 1.0), ("revolute", 0.5)])
def test_a_joint_is_not_turned_where_what_it_moves_does_not_turn_with_it(kind, ratio):
    """A screw lifts its nut, and a gear of half the angle is on the other side after a turn."""
    arm = [
        robots.joint("a", "revolute", "o", "l1", limits=(-7.0, 7.0)),
        robots.joint("b", kind, "l1", "l2", xyz="0.3 0 0", limits=(-9.0, 9.0), mimic=robots.tie("a", ratio)),
        robots.joint("c", "revolute", "l2", "l3", "0 1 0", "0.4 0 0", limits=(-7.0, 7.0)),
        robots.joint("d", "fixed", "l3", "hand", xyz="0.4 0 0"),
    ]
    robot = ik.Robot.load(robots.branches(*arm), tip="hand")
    q = np.array([1.0, 1.1])
    found = ik.solve_all(robot, robot.fk(q), starts=300, all_turns=True)
    assert np.abs(found.q - q).max(axis=1).min() < 1e-6 and len(found) == 2  # c may make a full turn
    assert found.message.endswith("2 on all full turns")  # so none had to be left out by the check with Pinocchio
    for row in found.q:
        np.testing.assert_allclose(robot.fk(row).homogeneous, robot.fk(q).homogeneous, atol=1e-5)
