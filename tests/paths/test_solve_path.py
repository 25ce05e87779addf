"""Whole paths: one motion through every pose if there is one, and the message if there is none."""

import re
from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest
from motions import between, folding
from robots import MIMIC, have_data, planar_pose
from serial_arms import away, drawn, urdf

import ik_toolkit as ik
from ik_toolkit.errors import InvalidOption
from ik_toolkit.paths.exact_branches import solutions
from ik_toolkit.paths.result import PathStatus


@pytest.fixture(scope="module")
def arm():
    return ik.Robot.load("hydrolek_7w")


@pytest.fixture(scope="module")
def flat():
    return ik.Robot.load("planar_3r")


def test_one_motion_where_there_is_one(arm):
    rng = np.random.default_rng(4)
    a, b = arm.random_q(rng), arm.random_q(rng)
    T = between(arm, a, b, 60)
    made = ik.solve_path(arm, T, seed=1)
    assert made.status == PathStatus.FOLLOWED and made.success
    assert made.lower_bound == 0 and not made.reconfigurations
    errors = np.array([arm.errors(q, one) for q, one in zip(made.q, T, strict=True)])
    assert errors.max() <= 1e-6
    assert (made.q >= arm.lower).all() and (made.q <= arm.upper).all()
    assert made.largest_step[0] <= made.max_step[0]
    assert made.deviation[0] <= made.path_tolerance[0]
    assert (made.q == ik.solve_path(arm, T, seed=1, threads=1).q).all(), "the same for any number of threads"


@pytest.mark.skipif(not have_data(), reason="needs example-robot-data")
def test_poses_far_apart_are_followed_on_the_way_between_them():
    """A tip goes 0.6 m and 96 deg from one pose to the other: searched at these alone, most seeds saw no motion."""
    robot = ik.Robot.load("kinova")
    ends = [[0.88, 2.17, 5.48, 1.02, 3.40, -2.81], [-0.27, 2.48, 4.81, 1.13, 3.04, -2.52]]
    T = np.array([robot.fk(q).homogeneous for q in ends])
    for seed in range(3):
        made = ik.solve_path(robot, T, slack=(0.002, 0.002, 0.002, 0.05, 0.05, 0.05), seed=seed)
        assert made.status == PathStatus.FOLLOWED
        assert made.q.shape == (2, robot.n) and made.targets.shape == (2, 1, 4, 4)
        assert (made.at[[0, -1]] == [0, 1]).all() and (np.diff(made.at) > 0).all()
        assert (made.curve[[0, -1]] == made.q).all() and made.largest_step[0] <= made.max_step[0] * (1.0 + 1e-9)


def test_a_break_between_poses_far_apart_lies_between_those_given(flat):
    """Five poses of the curve below, on which no branch is legal all along."""
    made = ik.solve_path(flat, folding(5))
    assert made.status == PathStatus.RECONFIGURES and [one.index for one in made.reconfigurations] == [1]
    assert made.lower_bound == 1 and not made.unreachable and len(made.q) == 5
    assert [(made.at[piece.start], made.at[piece.stop - 1]) for piece in made.pieces] == [(0.0, 1.0), (2.0, 4.0)]
    assert np.isfinite(made.curve).all() and len(made.continuity.deviation) == len(made.curve) - 1
    assert made.deviation[0] <= made.path_tolerance[0]


def test_fewest_reconfigurations_of_a_branch_that_ends(flat):
    T = folding(101)
    made = ik.solve_path(flat, T)
    assert made.status == PathStatus.RECONFIGURES and len(made.reconfigurations) == 1
    at = made.reconfigurations[0].index
    assert np.sign(made.q[at, 1]) != np.sign(made.q[at + 1, 1])
    assert made.lower_bound == 1 and "provably the fewest" in made.message
    none = ik.solve_path(flat, T, reconfigurations="none")
    assert none.status == PathStatus.INCOMPLETE and not none.success
    ends = int(np.flatnonzero(np.isfinite(none.q[:, 0]))[-1])
    assert np.isnan(none.q[ends + 1 :]).all() and none.message == (
        f"with no reconfiguration the path found ends at pose {ends} of 101: pose {ends + 1} cannot be passed, and the whole "
        f"path needs 1; from the start {100 * none.fraction:.3g} % of its length can be followed in one motion; allow them "
        "(reconfigurations='fewest'), or relax the targets (free_turn, slack, mask, priority)"
    )
    assert ends >= at, "the best partial path is as long as it can be"
    assert ik.solve_path(flat, T, reconfigurations=0).message == none.message
    assert ik.solve_path(flat, T, reconfigurations=1).success


def test_poses_out_of_reach_are_named(flat):
    made = ik.solve_path(flat, np.array([planar_pose(x, 0.0, 0.0) for x in np.linspace(5.5, 6.5, 41)]))
    assert made.status == PathStatus.INCOMPLETE
    assert [one.index for one in made.unreachable] == list(range(21, 41))
    words = "beyond reach by .*m with its orientation kept "  # another orientation may put the wrist, and so the tip, nearer
    assert all(one.proven and re.match(words, one.reason) for one in made.unreachable)
    assert np.isfinite(made.q[:21]).all() and np.isnan(made.q[21:]).all()


def test_what_is_reached_without_a_reconfiguration_is_counted(flat):
    """A branch ends on the way, and the last poses are out of reach: both are said, and only rows that are there count."""
    T = folding(101)
    T[98:, 0, 3] += 9.0
    lost = ik.solve_path(flat, T)
    assert lost.message == (
        f"{np.isfinite(lost.q[:, 0]).sum()} of 101 poses reached; not pose 98 and 2 more: {lost.unreachable[0].reason}; from the "
        f"start {100 * lost.fraction:.3g} % of its length can be followed in one motion; move the poses inside the reach"
    )
    made = ik.solve_path(flat, T, reconfigurations="none")
    there = np.isfinite(made.q[:, 0])
    assert made.status == PathStatus.INCOMPLETE and not there[97]
    assert made.message.startswith(f"{there.sum()} of 101 poses reached; not pose 98 and 2 more: beyond reach")
    assert f"with no reconfiguration the path found ends at pose {np.flatnonzero(there)[-1]} of 101" in made.message


# ------------------------------------------------------------------------------------------- poses that are far apart
def test_poses_are_reached_where_those_in_between_are_not(arm):
    """Five joints cannot keep to the straight way between full poses: the motion that keeps nearest it leads through them."""
    five = arm.locked({"forearm_roll": 0.4})
    T = between(five, five.lower * 0.8 + five.upper * 0.2, five.lower * 0.2 + five.upper * 0.8, 12)
    made = ik.solve_path(five, T, seed=1)
    assert made.status == PathStatus.FOLLOWED and made.deviation[0] > made.path_tolerance[0]
    errors = np.array([five.errors(q, one) for q, one in zip(made.q, T, strict=True)])
    assert errors.max() <= 1e-6
    T[3:7, 2, 3] += 3.0
    left = ik.solve_path(five, T, seed=1)
    assert left.status == PathStatus.INCOMPLETE and [one.index for one in left.unreachable] == [3, 4, 5, 6]


@pytest.mark.parametrize("last", [(-0.6, 3.6), (-3.6, 0.6)])
@pytest.mark.parametrize("degrees", [(0, 180), (0, 180, 0), (0, 180.000001), (0, 180, 0, 180)])
def test_half_a_turn_is_made_the_way_that_limits_allow(last, degrees):
    joints = [((0, 0, 0), (-1.0, 1.0)), ((1, 0, 0), (-1.0, 1.0)), ((1, 0, 0), last)]
    text = urdf([("revolute", at, (0, 0, 0), (0, 0, 1), *limits) for at, limits in joints], ((0, 0, 0), (0, 0, 0)))
    robot = ik.Robot.load(text, tip="tip")
    made = ik.solve_path(robot, np.array([planar_pose(1.8, 0.1, np.radians(x)) for x in degrees]))
    assert made.status == PathStatus.FOLLOWED and made.deviation[0] <= made.path_tolerance[0]
    assert made.position_error.max() <= 1e-6 and made.orientation_error.max() <= 1e-6
    assert made.length[0] < 3.2 * (len(degrees) - 1)


def test_both_tips_of_a_tree_make_half_a_turn():
    tree = ik.Tree.load("brokk_hydrolek")
    q = np.linspace(tree.home, tree.home, 2)
    spun = [tree.joint_names.index(name) for name in tree.joint_names if name.endswith("wrist_roll")]
    q[1, spun] += np.pi
    made = ik.solve_path(tree, {tip: np.array([tree.fk(x)[tip].homogeneous for x in q]) for tip in tree.tips})
    assert len(spun) == 2 and made.status == PathStatus.FOLLOWED


@pytest.mark.parametrize("step", [0.1, 0.02])
def test_a_short_max_step_inserts_more_poses(arm, step):
    rng = np.random.default_rng(4)
    a, b = arm.random_q(rng), arm.random_q(rng)
    made = ik.solve_path(arm, between(arm, a, a + 0.4 * (b - a), 3), max_step=np.radians(step))
    assert made.status == PathStatus.FOLLOWED
    assert made.largest_step[0] <= np.radians(step) * (1.0 + 1e-9) and made.largest_step[1] <= np.radians(step)


def test_a_max_step_that_is_far_too_small_is_refused(arm):
    with pytest.raises(InvalidOption, match=r"max_step = \(1e-08 rad, 1e-08 m\) is too small: steps of this path"):
        ik.solve_path(arm, between(arm, arm.home, arm.home + 0.1, 5), max_step=1e-8)


def test_a_path_begins_and_ends_where_it_is_asked_to(arm):
    rng = np.random.default_rng(11)
    a, b = arm.random_q(rng), arm.random_q(rng)
    T = between(arm, a, b, 50)
    made = ik.solve_path(arm, T, q0=a, q_end=b, free_turn=(0.0, 0.0, 1.0))
    assert made.success
    assert np.abs(made.q[0] - a).max() < 1e-5 and np.abs(made.q[-1] - b).max() < 1e-5


@pytest.mark.parametrize("turn", [-1, 1])
def test_a_path_with_a_gap_ends_on_the_turn_that_is_asked_for(turn):
    joints = [("revolute", (x, 0, 0), (0, 0, 0), (0, 0, 1), -most, most) for x, most in ((0.0, 9.0), (0.4, 2.5))]
    robot = drawn(joints, (0.3, 0, 0))
    Q = np.linspace([0.3, 0.8], [0.8, 1.0], 12)
    points = np.array([robot.fk(q).translation for q in Q])
    points[6] = 2.0, 0.0, 0.0  # out of reach
    made = ik.solve_path(robot, points, q_end=Q[-1] + [turn * 2 * np.pi, 0.0])
    np.testing.assert_allclose(made.q[-1] - Q[-1], [turn * 2 * np.pi, 0.0], atol=1e-5)


def test_poses_that_are_reached_roughly_are_still_one_motion(arm):
    """The tolerance between poses is never tighter than the one at the poses."""
    made = ik.solve_path(arm, between(arm, arm.home, arm.home + 0.2, 20), position_tolerance=2e-3)
    assert made.status == PathStatus.FOLLOWED
    assert made.path_tolerance == (4e-3, np.radians(1.0)) and made.deviation[0] <= 4e-3


# ------------------------------------------------------------------------------------------------------------- redundant
LINK = """
<link name="l{k}"><collision><origin xyz="0.15 0 0"/><geometry><box size="0.26 0.05 0.05"/></geometry></collision></link>
<joint name="j{k}" type="revolute"><parent link="{parent}"/><child link="l{k}"/><origin xyz="{x} 0 0"/><axis xyz="0 0 1"/>
<limit lower="-2.4" upper="2.4" effort="1" velocity="1"/></joint>"""


def chained(count):
    """`count` revolute joints in a plane, links with collision shapes."""
    links = "".join(LINK.format(k=k, parent=f"l{k - 1}" if k else "base", x=0.3 * (k > 0)) for k in range(count))
    tip = f'<link name="tip"/><joint name="t" type="fixed"><parent link="l{count - 1}"/><child link="tip"/>'
    tip += '<origin xyz="0.3 0 0"/></joint>'
    return ik.Robot.load(f'<robot name="snake"><link name="base"/>{links}{tip}</robot>', tip="tip")


@pytest.fixture(scope="module")
def snake():
    return chained(5)


@pytest.mark.parametrize("count", [2, 5])
def test_limits_hold_to_the_last_bit(count):
    """A joint runs along its limit, and solutions are carried in single precision, in which 2.4 is more than 2.4."""
    robot = chained(count)
    a, b = np.full(count, 0.5), np.full(count, 1.0)
    a[0] = b[0] = robot.upper[0]
    points = between(robot, a, b, 30)[:, :3, 3]
    made = ik.solve_path(robot, points, q0=a, q_end=b)
    assert made.success and made.position_error.max() <= 1e-6
    for rows in (made.q, made.curve):
        assert (rows >= robot.lower).all() and (rows <= robot.upper).all()


def touches(model, q, between=8):
    """Whether a path q (N, n) touches anything, at its rows or at places between two of them."""
    dense = [a + s * (b - a) for a, b in pairwise(q) for s in np.arange(between) / between]
    return any(model.collides(x) for x in [*dense, q[-1]])


def test_a_redundant_arm_goes_round_an_obstacle(snake):
    points = np.column_stack([np.full(60, 0.7), np.linspace(-0.5, 0.5, 60), np.zeros(60)])
    free = ik.solve_path(snake, points)
    data = snake.model.createData()
    pin.framesForwardKinematics(snake.model, data, free.q[30])
    model = ik.CollisionModel(snake).add_box([0.1, 0.1, 0.5], data.oMf[snake.model.getFrameId("l2")].translation)
    assert touches(model, free.curve), "otherwise the box is in nobody's way"
    made = ik.solve_path(snake, points, avoid_collisions=model)
    assert made.status == PathStatus.FOLLOWED
    assert not touches(model, made.curve) and made.clearance > 0.0 and not made.continuity.unproven
    assert free.length[0] <= made.length[0] + 1e-6


def test_contact_is_said_where_nothing_else_is_found(snake):
    points = np.column_stack([np.linspace(0.5, 0.9, 20), np.zeros(20), np.zeros(20)])
    model = ik.CollisionModel(snake).add_box([0.1, 0.1, 0.1], [0.7, 0.0, 0.0])
    made = ik.solve_path(snake, points, avoid_collisions=model)
    assert made.status == PathStatus.COLLISION and not made.success and np.isfinite(made.q).all()
    assert "only in collision" in made.message and "box" in made.message


def test_refined_motions_are_no_longer_than_tracks_and_exact(snake):
    points = np.column_stack([np.linspace(0.4, 0.9, 40), 0.3 * np.sin(np.linspace(0, 6, 40)), np.zeros(40)])
    made = ik.solve_path(snake, points, seed=2)
    assert made.success and made.position_error.max() <= 1e-6 and made.orientation_error is None
    assert made.length[0] < 8.0  # a track of least motion alone takes some 9 rad
    assert made.deviation[0] <= made.path_tolerance[0]


@pytest.mark.parametrize("when", [0.0, 0.9])
def test_ctrl_c_keeps_the_best_path(snake, when):
    points = np.column_stack([np.full(30, 0.8), np.linspace(-0.3, 0.3, 30), np.zeros(30)])

    def stop(share, words):
        if share >= when:
            raise KeyboardInterrupt

    with pytest.raises(ik.PathInterrupted) as caught:
        ik.solve_path(snake, points, path_tolerance=(1e-3, 0.02), progress=stop)
    made = caught.value.result
    assert isinstance(caught.value, KeyboardInterrupt) and made.success
    assert made.path_tolerance == (1e-3, 0.02) and made.tolerance_given  # on which its `retime` depends


# ---------------------------------------------------------------------------------------------------------------- turns
@pytest.mark.skipif(not have_data(), reason="example-robot-data is not installed")
def test_every_solution_of_a_ur_is_known(request):
    robot = ik.Robot.load("ur5")
    q = robot.random_q(np.random.default_rng(0), 200)
    T = robot.chain.forward(q)[0]
    Q, sure = solutions(robot, T)
    d = Q - q[:, None]
    d -= 2 * np.pi * np.rint(d / (2 * np.pi))
    assert (np.nanmin(np.abs(d).max(axis=2), axis=1) < 1e-6).all() and sure.mean() > 0.98
    for k in range(0, 200, 40):
        found = ik.solve_all(robot, T[k], "lm")
        assert len(found) == np.isfinite(Q[k, :, 0]).sum()
    assert solutions(ik.Robot.load("hydrolek_7w"), T) is None


def test_the_first_two_axes_need_not_be_perpendicular_for_a_solution_to_be_known():
    """They are only in the arms on sale."""
    places = (0, 0, 0.1), (0.1, 0.05, 0.3), (0, 0.05, 0.4), (0.1, 0, 0.35), (0, 0.1, 0.05), (0, 0, 0)
    axes = (0.3, 0.4, 1), (0, 1, 0), (0, 1, 0), (0, 1, 0), (0.3, 0.2, 1), (1, 0, 0)
    robot = drawn([("revolute", *at, -3.1, 3.1) for at in zip(places, [(0, 0, 0)] * 6, axes, strict=True)], (0.1, 0, 0))
    q = robot.random_q(np.random.default_rng(0), 50)
    Q, sure = solutions(robot, robot.chain.forward(q)[0])
    assert sure.all() and np.nanmin(away(Q, q[:, None]), axis=1).max() < 1e-9


@pytest.mark.slow
@pytest.mark.skipif(not have_data(), reason="example-robot-data is not installed")
def test_a_tool_that_spins_takes_as_few_changes_as_there_can_be():
    robot = ik.Robot.load("ur5")
    start = robot.fk([0.4, -1.2, 1.5, -0.6, 1.1, 0.0])
    for total, least in ((600.0, 0), (900.0, 1), (1500.0, 2)):
        spun = [
            start * pin.SE3(pin.exp3(np.array([0.0, 0.0, x])), np.zeros(3))
            for x in np.radians(np.arange(0.0, total + 1.0, 2.5))  # closer than poses are inserted
        ]
        made = ik.solve_path(robot, np.array([T.homogeneous for T in spun]))
        assert made.success and len(made.reconfigurations) == least == made.lower_bound


# ---------------------------------------------------------------------------------------------------------------- trees
def test_both_tips_of_a_tree_follow_their_own_paths():
    tree = ik.Tree.load("brokk_hydrolek")
    rng = np.random.default_rng(3)
    a = tree.random_q(rng)
    Q = np.linspace(a, a + 0.2 * (tree.random_q(rng) - a), 40)
    poses = {tip: np.array([tree.fk(q)[tip].homogeneous for q in Q]) for tip in tree.tips}
    made = ik.solve_path(tree, poses)
    assert made.status == PathStatus.FOLLOWED
    for q, k in zip(made.q, range(40), strict=True):
        for tip, T in tree.fk(q).items():
            assert np.abs(T.homogeneous - poses[tip][k]).max() < 5e-6


def test_a_tip_follows_another_that_follows_its_path():
    """What is relative to a moving tip is reached in that one's frame, and between the poses, too."""
    tree = ik.Tree.load("brokk_hydrolek")
    rng = np.random.default_rng(5)
    a = tree.random_q(rng)
    left, right = tree.tips
    tips = [tree.fk(q) for q in np.linspace(a, a + 0.2 * (tree.random_q(rng) - a), 30)]
    poses = {left: [T[left] for T in tips], right: [T[left].actInv(T[right]) for T in tips]}
    poses = {tip: np.array([T.homogeneous for T in of]) for tip, of in poses.items()}
    made = ik.solve_path(tree, poses, relative_to={right: left})
    assert made.status == PathStatus.FOLLOWED
    for q, k in zip(made.curve, made.at, strict=True):
        if k == int(k):
            T = tree.fk(q)
            assert np.abs(T[left].homogeneous - poses[left][int(k)]).max() < 5e-6
            assert np.abs(T[left].actInv(T[right]).homogeneous - poses[right][int(k)]).max() < 5e-6


def test_joints_that_mimic_others_move_with_them():
    robot = ik.Robot.load(MIMIC, tip="l8")
    rng = np.random.default_rng(1)
    a = robot.random_q(rng)
    T = between(robot, a, a + 0.5 * (robot.random_q(rng) - a), 30)
    made = ik.solve_path(robot, T)
    assert made.status == PathStatus.FOLLOWED
    assert max(robot.errors(q, one)[0] for q, one in zip(made.q, T, strict=True)) < 1e-6
