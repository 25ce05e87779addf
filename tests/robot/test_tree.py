"""Several tips of one model: kinematics against Pinocchio, shared joints, loading."""

import copy
import pickle

import numpy as np
import pytest
import robots
from random_trees import random_tree
from refusals import refuses
from second_fk import SecondFK, pose_errors
from trees import TREES, direct, mixed, poses, tree_of

import ik_toolkit as ik
from ik_toolkit import errors
from ik_toolkit.errors import ModelError
from ik_toolkit.robot.library import find
from ik_toolkit.robot.robot import Robot
from ik_toolkit.robot.tree import Tree


@pytest.fixture(scope="module", params=TREES)
def tree(request):
    return tree_of(request.param)


@pytest.fixture(scope="module")
def brokk():
    return tree_of("brokk_hydrolek")


def check_kinematics(tree, Q):
    """Poses and Jacobians of the kernel are Pinocchio's."""
    T, J = tree.chain.forward(Q, jacobian=True)
    for k, q in enumerate(Q):
        assert np.abs(T[k] - poses(tree, q)).max() < 1e-12
        assert np.abs(T[k] - direct(tree, q)).max() < 1e-12
        assert np.abs(J[k] - tree.jacobian(q)).max() < 1e-12


def test_kinematics_equal_pinocchio(tree):
    Q = tree.random_q(np.random.default_rng(4), 100)
    T, J = tree.chain.forward(Q, jacobian=True)
    assert T.shape == (100, 2, 4, 4) and J.shape == (100, 12, tree.n)
    check_kinematics(tree, Q)


@pytest.mark.parametrize("base", ["chest", "turning", "left3_link"])
def test_any_base_also_with_followers_of_joints_below_it(base):
    """Joints between the root and the base move base and tips alike, so only their followers on the paths count."""
    tree = ik.Tree.load(mixed(), tips=TREES["mixed"], base=base)
    if base == "chest":
        assert {"turn", "lift"} <= set(tree.joint_names)
    Q = tree.random_q(np.random.default_rng(9), 2)
    check_kinematics(tree, Q)
    assert ik.solve(tree, poses(tree, Q[0])).success


def test_manipulability_is_yoshikawas(tree):
    for robot in (tree, *tree.arms, tree.arms[0].locked({tree.arms[0].joint_names[0]: 0.1})):
        for q in robot.random_q(np.random.default_rng(3), 4):
            rows = robot.jacobian(q).reshape(-1, 6, robot.n)
            counted = {"pose": range(6), "position": range(3), "orientation": range(3, 6), (4, 0): (4, 0)}
            for name, which in counted.items():
                J = rows[:, list(which)].reshape(-1, robot.n)
                wanted = np.sqrt(np.linalg.det(J @ J.T)) if len(J) <= robot.n else 0.0
                assert abs(robot.manipulability(q, name) - wanted) <= 1e-12 + 1e-9 * wanted
    for wrong in ("positions", (0, 0), (), (6,), 1.5, None):
        with pytest.raises(errors.InvalidOption, match="'position'"):
            tree.manipulability(tree.home, wrong)
    with pytest.raises(errors.InvalidConfiguration):
        tree.manipulability(tree.home[:-1])


@pytest.mark.parametrize("tips", [["left_tip"], ["left3_link", "left_tip"], ["left1_link", "right_tip", "left_tip"]])
def test_any_number_of_tips_also_on_one_path(tips):
    tree = ik.Tree.load(mixed(), tips=tips)
    scales = {arm.chain.scale for arm in tree.arms}
    assert tree.chain.scale == max(scales) and len(scales) == (2 if "left1_link" in tips else 1)
    Q = tree.random_q(np.random.default_rng(10), 30)
    check_kinematics(tree, Q)
    assert all(ik.solve(tree, poses(tree, q)).success for q in Q)


def test_q_is_the_union_of_the_paths_and_shared_joints_come_once(tree):
    left, right = tree.arms
    shared = set(left.joint_names) & set(right.joint_names)
    assert shared and tree.n == left.n + right.n - len(shared)
    assert tree.joint_names == left.joint_names + tuple(j for j in right.joint_names if j not in shared)
    for k, joint in enumerate(tree.joint_names):
        moves = np.abs(tree.jacobian(tree.random_q(np.random.default_rng(1)))[:, k]).reshape(2, 6).max(axis=1) > 1e-9
        assert moves.tolist() == [joint in left.joint_names, joint in right.joint_names]
        assert tree.chain.ends[:, k - tree.n].tolist() == [float(x) for x in moves]


def test_brokk_home_is_the_listed_one_joint_by_joint(brokk):
    home = find("brokk_hydrolek").home
    assert brokk.home.tolist() == list(home)
    turned = ik.Tree.load("brokk_hydrolek", tips=["right_tip", "left_tip"])
    assert turned.joint_names[0] == "turret" and turned.joint_names[1].startswith("right")
    assert dict(zip(turned.joint_names, turned.home, strict=True)) == dict(zip(brokk.joint_names, home, strict=True))


def test_configurations_as_of_a_robot(tree):
    rng = np.random.default_rng(2)
    for _ in range(50):
        q = tree.random_q(rng)
        assert tree.outside(q) == []
        assert np.allclose(tree.q_from_pinocchio(tree.to_pinocchio(q)), q, atol=1e-12)
    assert tree.check_q(tree.home) is not tree.home
    with pytest.raises(errors.InvalidConfiguration, match=f"{tree.n} values"):
        tree.fk(np.zeros(tree.n + 1))
    copy = pickle.loads(pickle.dumps(tree))
    assert copy.joint_names == tree.joint_names and np.array_equal(copy.home, tree.home)
    assert ik.solve(copy, poses(tree, q)).q.tobytes() == ik.solve(tree, poses(tree, q)).q.tobytes()
    assert all(word in repr(tree) + tree._repr_html_() for word in tree.tips)
    assert f"{tree.base} → " in tree._repr_html_()


def test_limits_of_a_shared_joint_are_those_of_all_its_followers():
    tree = tree_of("mixed")
    lift, left = tree.joint_names.index("lift"), tree.arms[0]
    # the right arm's follower (0.8 lift + 0.1 within -1.6..1.8) allows more than the lift itself: the lift's own limit stays
    assert tree.upper[lift] == 0.4 == left.upper[1]
    turn = tree.joint_names.index("turn")
    # the left arm's follower (0.05 turn + 0.02 within -0.2..0.3) too; make it the tighter one and the tree must follow
    assert tree.upper[turn] == 2.0
    for tips in (TREES["mixed"], TREES["mixed"][::-1]):
        tight = ik.Tree.load(mixed().replace('multiplier="0.05"', 'multiplier="0.2"'), tips=tips)
        assert tight.upper[turn] == pytest.approx((0.3 - 0.02) / 0.2)
        assert tight.lower[turn] == pytest.approx((-0.2 - 0.02) / 0.2)
        assert {arm.upper[0] for arm in tight.arms} == {tight.upper[turn]}  # a follower off the path counts too


def test_a_joint_that_one_path_follows_never_jumps_a_turn():
    text = mixed().replace('lower="-2.0" upper="2.0"', 'lower="-4.0" upper="4.0"')
    for tips in (TREES["mixed"], TREES["mixed"][::-1]):
        tree = ik.Tree.load(text, tips=tips)
        turn = tree.joint_names.index("turn")
        assert sorted(arm.chain.turns[0] for arm in tree.arms) == [0.0, 1.0]
        assert tree.chain.ends[0, 24 + 2 * tree.n + turn] == 0.0


def test_tools_and_locked_joints():
    left, right = tree_of("mixed").arms
    tool = ik.pose((0.05, 0.0, 0.1), rpy=(0.2, 0.0, 0.3))
    tree = Tree([left.with_tool(tool), right]).locked({"lift": 0.25})
    assert "lift" not in tree.joint_names and tree.n == left.n + right.n - 3
    q = tree.random_q(np.random.default_rng(3))
    full = direct(tree, q)
    assert np.allclose(poses(tree, q)[0], full[0] @ tool, atol=1e-12)
    assert np.allclose(poses(tree, q)[1], full[1], atol=1e-12)
    assert ik.solve(tree, poses(tree, q), q0=q + 0.01).success


def test_loading_says_what_it_needs(brokk):
    """No call returns a type that depends on a value: a list of tips is for Tree.load, one tip for Robot.load."""
    for load in (ik.Robot.load, lambda source, tip: ik.Robot(ik.Robot.load(source, tip="left_tip").model, tip=tip)):
        for tip in (["left_tip", "right_tip"], ["left_tip"], ("left_tip",)):
            with pytest.raises(errors.InvalidOption, match=r"ik\.Tree\.load\(source, tips=\[\.\.\.\]\)"):
                load("brokk_hydrolek", tip=tip)
    whole = ik.Tree.load("brokk_hydrolek")
    assert whole.tips == brokk.tips and whole.home.tolist() == brokk.home.tolist()
    refuses(
        errors.FrameNotFound,
        (lambda: ik.Robot.load("brokk_hydrolek"), r"2 tips.*ik\.Tree\.load.*left_tip, right_tip"),
        (lambda: ik.Tree.load(mixed()), "its paths end at: left_tip, right_tip"),
        (lambda: ik.Tree.load("planar_2r"), "robot 'planar_2r'.*its paths end at"),
    )
    no_list = r"list of frame names.*ik\.Robot\.load\(source, tip=\)"
    refuses(
        errors.InvalidOption,
        (lambda: ik.Tree.load("brokk_hydrolek", "left_tip"), no_list),
        (lambda: ik.Tree.load("brokk_hydrolek", {"left_tip", "right_tip"}), no_list),
        (lambda: ik.Tree.load("brokk_hydrolek", 3), no_list),
        (lambda: ik.Tree.load("brokk_hydrolek", ["left_tip", 3]), "name of one frame, not 3"),
    )
    with pytest.raises(errors.JointNotFound, match="turet"):
        ik.Tree.load("brokk_hydrolek", locked={"turet": 0.0})


def test_a_known_home_is_kept_by_locked_copies(brokk):
    home = dict(zip(brokk.joint_names, brokk.home, strict=True))
    for locked in ({"turret": 0.3}, {"right_elbow": -0.4}, {joint: 0.1 for joint in brokk.arms[0].joint_names[:2]}):
        locked = {joint: value for joint, value in locked.items() if joint in home}
        made = ik.Tree.load("brokk_hydrolek", locked=locked)
        assert made.locked_joints == locked and made.n == brokk.n - len(locked)
        assert dict(zip(made.joint_names, made.home, strict=True)) == {j: x for j, x in home.items() if j not in locked}
        assert brokk.locked(locked).home.tolist() == made.home.tolist()


def test_a_joint_cannot_be_locked_for_one_tip_only(brokk):
    left, right = brokk.arms
    with pytest.raises(errors.ModelError, match="'turret' is locked for one tip"):
        Tree([left.locked({"turret": 0.0}), right])
    free = next(joint for joint in right.joint_names if joint not in left.joint_names)
    assert Tree([left.locked({free: 0.0}), right.locked({free: 0.0})]).n == brokk.n - 1


@pytest.mark.parametrize("name", ["brokk_hydrolek", "mixed"])
def test_a_robot_and_a_tree_answer_alike(name):
    tree = tree_of(name)
    q = tree.random_q(np.random.default_rng(4))
    for robot in (tree, *tree.arms):
        values = q if robot is tree else q[tree.places[tree.arms.index(robot)]]
        assert robot.tips == tuple(arm.tip for arm in robot.arms) and len(robot.places) == len(robot.tips)
        assert robot.reach == max(arm.reach for arm in robot.arms)
        for arm, place in zip(robot.arms, robot.places, strict=True):
            assert arm.joint_names == tuple(robot.joint_names[i] for i in place)
            seen = direct(tree, q)[tree.tips.index(arm.tip)]
            assert np.allclose(arm.fk(values[place]).homogeneous, seen, atol=1e-12)
        assert robot.urdf and robot.package_dirs is not None and robot.locked_joints == {}


def test_what_is_kept_with_a_robot_stays_with_it(brokk):
    for robot in (brokk, brokk.arms[0]):
        robot.memo["mine"] = 1
        tool = np.eye(4)
        for other in (robot.with_tool(tool), robot.locked({}), copy.copy(robot), pickle.loads(pickle.dumps(robot))):
            assert "mine" not in other.memo and other.memo is not robot.memo
        assert robot.memo.pop("mine") == 1


def test_tools_by_tip(brokk):
    q, tool = brokk.random_q(np.random.default_rng(5)), ik.pose((0.05, 0.0, 0.1), rpy=(0.2, 0.0, 0.3))
    bare = poses(brokk, q)
    for given, moved in ((tool, (True, True)), ({"right_tip": tool}, (False, True)), ({}, (False, False))):
        tree = brokk.with_tool(given)
        assert tree.home.tolist() == brokk.home.tolist()
        for T, before, hand in zip(poses(tree, q), bare, moved, strict=True):
            assert np.allclose(T, before @ tool if hand else before, atol=1e-12)
    with pytest.raises(errors.FrameNotFound, match="Did you mean 'right_tip'"):
        brokk.with_tool({"rigt_tip": tool})
    with pytest.raises(errors.InvalidTarget):
        brokk.with_tool({"right_tip": 2.0 * tool})


def test_errors_take_targets_in_order_or_by_tip(brokk):
    beside = brokk.fk(brokk.home + 0.01)
    found = brokk.errors(brokk.home.tolist(), beside)
    assert found == brokk.errors(brokk.home, [beside[tip].homogeneous for tip in brokk.tips])
    assert found == [
        arm.errors(brokk.home[at], beside[arm.tip]) for arm, at in zip(brokk.arms, brokk.places, strict=True)
    ]
    left = brokk.tips[0]
    for bad in ([beside[left]], {left: beside[left]}, None, "here", 3, np.zeros((2, 2))):
        with pytest.raises(errors.InvalidTarget):
            brokk.errors(brokk.home, bad)
    with pytest.raises(errors.FrameNotFound, match=left):
        brokk.errors(brokk.home, {**beside, "lefttip": beside[left]})
    with pytest.raises(errors.InvalidConfiguration):
        brokk.errors(brokk.home[1:], beside)


def branched(ratio=0.5, limits=(-1.5, 1.5)):
    """Two arms on a torso; the second joint of the left one follows the first of the right one."""
    parts = [robots.joint("torso", "revolute", "root", "chest", "0 0 1", "0 0 0.3")]
    for side in "lr":
        parent = "chest"
        for k, axis in enumerate(("0 1 0", "1 0 0", "0 1 0", "0 0 1")):
            name = f"{side}{k}"
            mine = (limits, robots.tie("r0", ratio, 0.1)) if name == "l1" else ((-1.5, 1.5), "")
            parts.append(
                robots.joint(name, "revolute", parent, f"{name}_link", axis, "0.2 0.1 0.1", "0.1 0.2 0", *mine)
            )
            parent = f"{name}_link"
    return robots.branches(*parts, root="root", name="branched")


def test_a_follower_on_the_branch_of_the_base_moves_all_tips():
    """Base on the left hand: l1, between it and the torso, follows a joint of the right arm and so moves the other tips too."""
    text = branched()
    tree = Tree.load(text, base="l3_link", tips=["chest", "root", "r3_link"])
    assert tree.joint_names == ("r0", "r1", "r2", "r3")
    assert [arm.joint_names for arm in tree.arms] == [("r0",), ("r0",), ("r0", "r1", "r2", "r3")]
    assert Tree(tree.arms[:2]).joint_names == ("r0",)  # also without the arm on whose path it is
    Q = tree.random_q(np.random.default_rng(0), 10)
    for tip in tree.tips:
        his = SecondFK(text, "l3_link", tip).fk(Q, tree.joint_names)
        mine = np.array([tree.fk(q)[tip].homogeneous for q in Q])
        assert np.abs(mine - his).max() < 1e-12
    many = ik.solve_batch(
        tree, {tip: np.array([tree.fk(q)[tip].homogeneous for q in Q]) for tip in tree.tips}, check=1.0
    )
    assert many.success.all()
    again = pickle.loads(pickle.dumps(tree))
    assert again.joint_names == tree.joint_names and np.array_equal(again.home, tree.home)
    held = tree.locked({"r1": 0.3})
    assert held.joint_names == ("r0", "r2", "r3") and np.array_equal(held.lower, tree.lower[[0, 2, 3]])
    turned = Tree.load(text, base="l3_link", tips=["r3_link", "chest"])
    assert turned.joint_names == tree.joint_names
    with pytest.raises(ModelError, match="no moving joint between base 'l3_link' and tip 'chest'"):
        Robot.load(text, base="l3_link", tip="chest")


def test_limits_and_speeds_of_a_follower_off_the_path_count():
    text = branched(ratio=2.0, limits=(-0.9, 1.1))
    arm = Robot.load(text, tip="r3_link")
    assert arm.lower[1] == pytest.approx(-0.5) and arm.upper[1] == pytest.approx(0.5)  # (l1 - 0.1) / 2
    plain = Robot.load(branched(ratio=0.1), tip="r3_link").velocity_limits[1]
    assert arm.velocity_limits[1] == 0.5 * plain


def test_random_trees_agree_with_the_second_fk():
    """The same trees as scripts/break/robots.py --kind tree tries by the hundred."""
    tried = 0
    for seed in range(20):
        case = random_tree(rng := np.random.default_rng([3, seed]))
        try:
            tree = Tree.load(case.text, base=case.base, tips=case.tips)
        except ModelError:
            continue
        tried += 1
        Q = tree.random_q(rng, 4)
        for tip, judge in zip(case.tips, case.judges(), strict=True):
            mine = np.array([tree.fk(q)[tip].homogeneous for q in Q])
            position, angle = pose_errors(mine, judge.fk(Q, tree.joint_names))
            assert position.max() < 1e-11 * max(tree.reach, judge.largest_offset()) and angle.max() < 1e-11
            assert not judge.outside(Q, tree.joint_names).any()
            exact, f = judge.jacobian(Q, tree.joint_names), 6 * tree.tips.index(tip)
            for J in (tree.chain.forward(Q, jacobian=True)[1], np.array([tree.jacobian(q) for q in Q])):
                off = np.abs(J[:, f : f + 6] - exact) / np.maximum(1.0, np.abs(exact).max(axis=1, keepdims=True))
                assert off.max() < 1e-9 * max(1.0, tree.reach)
    assert tried > 15


def test_a_tree_of_one_tip_is_solved_as_its_robot_is():
    """Only its targets and poses go by tip: closed forms, proofs and bytes are the robot's."""
    robot = Robot.load("inspection_7dof")
    tree, tip, q = Tree([robot]), robot.tip, robot.random_q(np.random.default_rng(4))
    T = robot.fk(q).homogeneous
    assert np.array_equal(tree.fk(q)[tip].homogeneous, T)
    alone, named = ik.solve(robot, T), ik.solve(tree, {tip: T})
    assert (alone.solver, alone.q.tobytes()) == (named.solver, named.q.tobytes()) and named.solver == "inspection"
    assert np.array_equal(ik.solve_all(tree, [T]).q, ik.solve_all(robot, T).q)
    rows = ik.solve_batch(tree, np.array([[T], [T]]), "lm").q
    assert np.array_equal(rows, ik.solve_batch(robot, np.array([T, T]), "lm").q)
    with pytest.raises(errors.InvalidTarget, match="not a single one"):
        ik.solve(tree, T)
    assert np.array_equal(ik.solve(Tree([robot], q), {tip: T}, "lm", restarts=0).q, q)
