"""Kinematics and results checked by the second FK (second_fk.py), independent of the kernel and of Pinocchio."""

import itertools
import math
import os
import subprocess
import sys

import numpy as np
import pinocchio as pin
import pytest
import robots
import second_fk
from robots import tie
from second_fk import RPY_LITERALS, SecondFK, pose_errors, random_case, turn_about

import ik_toolkit as ik
from ik_toolkit.errors import ModelError
from ik_toolkit.show.panel.session import Session

OFF = 1e-9  # of the robot's size [m], and [rad]


def arm(**changes):
    """A 7-joint arm; changes: keywords of `robots.joint` by joint number."""
    axes = ("0 0 1", "0 1 0", "0 0 1", "0 1 0", "0 0 1", "0 1 0", "0 0 1")
    joints = [dict(kind="revolute", axis=axis, xyz="0 0 0.2" if i else "0 0 0.1") for i, axis in enumerate(axes)]
    for name, keywords in changes.items():
        joints[int(name[1:])].update(keywords)
    return robots.urdf(*joints, dict(kind="fixed", xyz="0.05 0 0.1"))


# A revolute joint that follows a slide by 20 rad/m, a slide that follows a revolute one, and the literals of the report.
PINION = robots.urdf(
    dict(kind="prismatic", axis="1 0 0", limits=(0.0, 0.6)),
    dict(kind="revolute", axis="0 1 0", xyz="0.1 0 0.2"),
    dict(kind="revolute", axis="0 0 1", limits=(-1.0, 13.0), mimic=tie("j0", 20, 0.5)),
    dict(kind="revolute", axis="0 1 0", xyz="0.3 0 0"),
    dict(kind="prismatic", limits=(-9.0, 9.0), mimic=tie("j1", -0.4, 3.3)),
    dict(kind="fixed", xyz="0.2 0 0.1"),
)
HARD = {
    "mimic_pi": arm(j5=dict(mimic=tie("j3", 1, 3.14159265), limits=(-9.0, 9.0))),
    "mimic_far": arm(j6=dict(mimic=tie("j1", -7.5, -40), limits=(-99.0, 99.0))),
    "pinion": PINION,
    "parallel": arm(j3=dict(axis="-1 0 0"), j4=dict(rpy="-1.5707963267948966 0 1.57079632679")),
    "near_minus_z": arm(j2=dict(axis="0.0000015 0 -1")),
    "endless_leader": robots.urdf(
        dict(kind="continuous"),
        dict(kind="continuous", axis="0 1 0", xyz="0.1 0 0.3", mimic=tie("j0", 0.5, 1)),
        dict(kind="revolute", axis="1 0 0", xyz="0 0 0.3"),
        dict(kind="revolute", xyz="0.2 0 0", limits=(-9.0, 9.0), mimic=tie("j0", -1.5)),
        dict(kind="fixed", xyz="0.2 0 0.1"),
    ),
}


def off(poses, judge, Q, names, reach):
    """Largest error of poses (N, 4, 4) at Q (N, n): position over the robot's size, angle."""
    position, angle = pose_errors(poses, judge.fk(Q, names))
    return max(position.max() / max(reach, judge.largest_offset()), angle.max())


def check_kinematics(robot, judge, seed, count=8):
    """FK, Jacobian and limits of a loaded robot, and the compiled kernel, against the second FK at random q."""
    rng, names = np.random.default_rng(seed), robot.joint_names
    Q = np.array([robot.random_q(rng) for _ in range(count)])
    assert off(np.array([robot.fk(q).homogeneous for q in Q]), judge, Q, names, robot.reach) < OFF
    T, J = robot.chain.forward(Q, jacobian=True)
    assert off(T, judge, Q, names, robot.reach) < OFF
    size = max(1.0, robot.reach)
    exact = judge.jacobian(Q, names)
    for columns in (J, np.array([robot.jacobian(q) for q in Q])):
        assert (np.abs(columns - exact) / np.maximum(1.0, np.abs(exact).max(axis=1, keepdims=True))).max() < OFF * size
    lower, upper = judge.limits(names)
    assert np.allclose(robot.lower, lower, rtol=1e-12, atol=1e-12) and np.allclose(
        robot.upper, upper, rtol=1e-12, atol=1e-12
    )
    assert not judge.outside(Q, names).any()


def check_answers(robot, judge, T, q, success):
    """Every success is inside the limits and the default tolerances, by the second FK."""
    assert success.any()
    position, angle = pose_errors(judge.fk(q, robot.joint_names), T)
    assert (position[success] <= 1e-6 * (1 + 1e-9)).all() and (angle[success] <= 1e-6 * (1 + 1e-9)).all()
    assert not judge.outside(q, robot.joint_names).any()


@pytest.mark.parametrize("name", HARD)
def test_literal_cases(name):
    robot, judge = ik.Robot.load(HARD[name]), SecondFK(HARD[name])
    check_kinematics(robot, judge, 1, count=200)
    rng = np.random.default_rng(2)
    T = judge.fk(np.array([robot.random_q(rng) for _ in range(300)]), robot.joint_names)
    batch = ik.solve_batch(robot, T)
    assert batch.success.mean() > 0.99
    check_answers(robot, judge, T, batch.q, batch.success)
    bound = ik.Solver(robot)
    for solve in (bound, lambda target: ik.solve(robot, target)):
        results = [solve(target) for target in T[:10]]
        check_answers(robot, judge, T[:10], np.array([r.q for r in results]), np.array([r.success for r in results]))


@pytest.mark.parametrize("each", [15, pytest.param(1, marks=pytest.mark.slow)])
def test_every_rpy_that_people_write(each):
    """All 2,197 triples, or each fifteenth, 40 to a robot: axes parallel, square or opposite but for the literals' last digits."""
    rng = np.random.default_rng(3)
    triples = [" ".join(rpy) for rpy in itertools.product(RPY_LITERALS, repeat=3)]
    assert len(triples) == 2197
    triples = triples[::each]  # 13 literals: a step of fifteen meets each of them at each place
    for start in range(0, len(triples), 40):
        axes = rng.choice(["0 0 1", "1 0 0", "0 -1 0", "0 0 -1"], 40)
        text = robots.urdf(
            *(
                dict(kind="revolute", rpy=rpy, axis=axis, xyz="0.1 0.05 0.2")
                for rpy, axis in zip(triples[start : start + 40], axes, strict=False)
            )
        )
        check_kinematics(ik.Robot.load(text), SecondFK(text), start, count=2)


@pytest.mark.parametrize("count", [15, pytest.param(80, marks=pytest.mark.slow)])
def test_random_robots(count):
    """Random robots that scripts/break/robots.py generates."""
    refused = 0
    for seed in range(count):
        case = random_case(np.random.default_rng([11, seed]))
        try:
            robot = ik.Robot.load(case.text, base=case.base, tip=case.tip, locked=case.locked)
        except ModelError as error:
            assert "not in the kinematic tree" in str(error)  # Pinocchio wants a leader before its followers
            refused += 1
            continue
        check_kinematics(robot if case.tool is None else robot.with_tool(case.tool), case.judge(), seed, count=5)
    assert refused < count / 10


def test_random_robots_in_batches():
    for seed in range(6):
        case = random_case(np.random.default_rng([12, seed]), most=9)
        robot, judge = ik.Robot.load(case.text, base=case.base, tip=case.tip, locked=case.locked), case.judge()
        robot = robot if case.tool is None else robot.with_tool(case.tool)
        rng = np.random.default_rng(seed)
        T = judge.fk(np.array([robot.random_q(rng) for _ in range(200)]), robot.joint_names)
        batch = ik.solve_batch(robot, T, position_tolerance=1e-6 * robot.reach, orientation_tolerance=1e-6)
        position, angle = pose_errors(judge.fk(batch.q, robot.joint_names), T)
        assert (position[batch.success] <= 1e-6 * robot.reach * (1 + 1e-6)).all()
        assert (angle[batch.success] <= 1e-6 * (1 + 1e-6)).all()
        assert not judge.outside(batch.q, robot.joint_names).any()


SIDES = (
    robots.joint("left", "revolute", "root", "l1", axis="0 1 0"),
    robots.joint("left_follower", "revolute", "l1", "l2", limits=(-9, 9), mimic=tie("left", 2, 4)),
    robots.joint("left_free", "revolute", "l2", "left_hand", axis="1 0 0"),
    robots.joint("right", "revolute", "root", "r1", axis="1 1 0", xyz="0 0.3 0"),
    robots.joint("right_follower", "prismatic", "r1", "r2", limits=(-9, 9), mimic=tie("left", -0.3)),
    robots.joint("right_tip", "revolute", "r2", "right_hand", xyz="0.1 0 0.1"),
)
BRANCHES = robots.branches(*SIDES, root="root")


@pytest.mark.parametrize(("base", "tip"), [("left_hand", "right_hand"), ("l1", "right_hand"), ("r1", "right_hand")])
def test_a_base_on_a_branch_moves_with_what_it_shares(base, tip):
    """Joints between the base and the shared link hold still, unless they lead or follow a joint of the path."""
    robot, judge = ik.Robot.load(BRANCHES, base=base, tip=tip), SecondFK(BRANCHES, base, tip)
    assert "left" in robot.joint_names and "left_free" not in robot.joint_names
    check_kinematics(robot, judge, 4, count=50)


@pytest.mark.parametrize("multiplier", ["0.5", "-3", "1.000003"])
def test_a_follower_whose_leader_lies_above_the_base(multiplier):
    """The leader moves nothing else, so it counts as the joint itself only when the multiplier is 1 to the last digits."""
    text = robots.urdf(
        dict(kind="revolute", limits=(-7.0, 7.0)),
        dict(kind="revolute", axis="0 1 0", limits=(-30, 30), mimic=tie("j0", multiplier)),
        dict(kind="revolute", axis="1 0 0", xyz="0 0 0.3", limits=(-3.2, 3.2)),
        dict(kind="revolute", axis="0 1 0", xyz="0 0 0.3"),
        dict(kind="fixed", xyz="0.1 0 0.2"),
    )
    robot, judge = ik.Robot.load(text, base="l1"), SecondFK(text, "l1")
    check_kinematics(robot, judge, 5, count=50)
    rng = np.random.default_rng(5)
    T = judge.fk(np.array([robot.random_q(rng) for _ in range(300)]), robot.joint_names)
    q0 = np.array([robot.random_q(rng) for _ in range(300)])
    batch = ik.solve_batch(robot, T, q0=q0)
    check_answers(robot, judge, T, batch.q, batch.success)


def test_a_follower_of_multiplier_zero_stands_still():
    text = arm(j2=dict(mimic=tie("j0", 0, 0.4)))
    robot = ik.Robot.load(text)
    assert robot.n == 6
    check_kinematics(robot, SecondFK(text), 6)


def test_limits_of_a_follower_hold_to_the_last_digit():
    """At the limits a follower gives its leader, the follower's own value, as rounded, is inside its own."""
    rng = np.random.default_rng(7)
    for _ in range(100):
        ratio, offset, low = rng.normal() * 3, rng.normal() * 2, rng.normal()
        high = low + rng.choice([0.0, 0.5])
        follower = dict(kind="revolute", limits=(low, high), mimic=tie("j0", ratio, offset), axis="0 1 0")
        robot = ik.Robot.load(robots.urdf(dict(kind="continuous"), follower))
        if high > low:
            ends = ratio * np.array([robot.lower[0], robot.upper[0]]) + offset
            assert low <= ends.min() and ends.max() <= high
        assert robot.lower[0] <= robot.upper[0]


def test_a_zero_range_that_is_written_with_a_minus():
    text = robots.urdf(dict(kind="revolute", limits=("0", "-0.0")), dict(kind="revolute", axis="0 1 0"))
    robot = ik.Robot.load(text)
    assert robot.random_q(np.random.default_rng(0))[0] == 0.0
    assert ik.solve(robot, robot.fk([0.0, 0.5])).success
    if robots.have_data():  # its finger leads a follower whose limits are 0 and -0.0
        pr2 = ik.Robot.load("pr2", tip="l_gripper_r_parallel_link")
        assert pr2.outside(pr2.random_q(np.random.default_rng(0))) == []


def test_a_tree_whose_arms_share_leaders():
    """A coordinate turns one arm and slides the other; another is a slide that turns what follows it by 20 rad/m."""
    text = robots.branches(
        *SIDES,
        robots.joint("lift", "prismatic", "left_hand", "lifted", limits=(-0.2, 0.4)),
        robots.joint("pinion", "revolute", "right_hand", "pinned", limits=(-9, 9), mimic=tie("lift", 20)),
        robots.joint("end", "fixed", "pinned", "right_end", xyz="0.2 0.1 0"),
        root="root",
    )
    tips = ["lifted", "right_end"]
    tree = ik.Tree.load(text, tips=tips)
    rng = np.random.default_rng(8)
    Q = np.array([tree.random_q(rng) for _ in range(50)])
    poses, stack = tree.chain.forward(Q, jacobian=True)
    for f, tip in enumerate(tips):
        judge = SecondFK(text, tip=tip)
        exact, T = judge.jacobian(Q, tree.joint_names), judge.fk(Q, tree.joint_names)
        for found in (poses[:, f], np.array([tree.fk(q)[tip].homogeneous for q in Q])):
            assert max(error.max() for error in pose_errors(found, T)) < OFF
        for columns in (stack[:, 6 * f : 6 * f + 6], np.array([tree.jacobian(q)[6 * f : 6 * f + 6] for q in Q])):
            assert np.abs(columns - exact).max() < 20 * OFF


def test_one_degree_of_freedom_has_a_jacobian(tmp_path):
    text = robots.urdf(dict(kind="revolute"), dict(kind="fixed", xyz="0.3 0 0"))
    (tmp_path / "one.urdf").write_text(text)
    assert len(Session(str(tmp_path / "one.urdf")).axes()) == 1  # what the panel shows of it
    robot = ik.Robot.load(text)
    assert np.allclose(robot.jacobian([0.2])[:, 0], [-0.3 * math.sin(0.2), 0.3 * math.cos(0.2), 0, 0, 0, 1])
    assert ik.solve(robot, robot.fk([0.2]).translation).success


def test_a_chain_that_differs_from_pinocchio_is_refused():
    """What Pinocchio computes and what was read from the joints is compared when a robot is loaded."""

    class Skewed(ik.Robot):
        def _kinematics(self, q):
            T, J = super()._kinematics(q)
            return T * pin.SE3(np.eye(3), np.array([2e-9, 0.0, 0.0])), J

    with pytest.raises(ModelError, match="please report"):
        Skewed(pin.buildModelFromXML(arm(), True))


def test_loading_compiles_nothing(tmp_path):
    """A robot is loaded, its home found and its starts tabulated without the compiler, which takes seconds."""
    code = (
        "import numba.core.compiler as c\n"
        "def refuse(*_, **__): raise SystemExit('compiled')\n"
        "c.compile_extra = c.compile_ir = refuse\n"
        "import ik_toolkit as ik\n"
        "ik.Robot.load('hydrolek_7w').with_tool(ik.pose((0, 0, 0.1)))\n"
        "ik.Tree.load('brokk_hydrolek', tips=['left_tip', 'right_tip'])\n"
    )
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_a_follower_that_loses_its_digits_is_refused():
    """At ten million radians the last digit of an angle is 2e-9: no kernel can hold such a robot to 1e-9."""
    follower = dict(kind="revolute", axis="0 1 0", xyz="0.1 0 0.2", limits=(-1e9, 1e9))
    for multiplier, loads in (("1e5", True), ("1e8", False)):
        text = robots.urdf(dict(kind="revolute"), {**follower, "mimic": tie("j0", multiplier)}, dict(kind="revolute"))
        if loads:
            check_kinematics(ik.Robot.load(text), SecondFK(text), 9)
        else:
            with pytest.raises(ModelError, match="please report"):
                ik.Robot.load(text)


def test_the_second_fk_itself():
    """Two joints by hand: the second FK itself is right."""
    text = robots.urdf(
        dict(kind="revolute", xyz="0 0 1", rpy="0 0 1.5707963267948966"),
        dict(kind="prismatic", axis="2 0 0", xyz="0.5 0 0", mimic=tie("j0", 3, 0.25)),
    )
    T = SecondFK(text).fk([[0.3]], ["j0"])[0]
    angle = math.pi / 2 + 0.3
    reach = 0.5 + 3 * 0.3 + 0.25
    assert np.allclose(T[:3, 3], [reach * math.cos(angle), reach * math.sin(angle), 1.0])
    assert np.allclose(T[:3, :3], turn_about(np.array([0.0, 0.0, 1.0]), angle))
    for exact in (0.0, 1e-9, 1.0, math.pi - 1e-9, math.pi):
        R = turn_about(np.array([0.6, 0.0, -0.8]), exact)
        assert second_fk.angles_between(np.eye(3)[None], R[None])[0] == pytest.approx(exact, abs=1e-15)
