"""Several tips at once: kinematics against Pinocchio, the contract of the solver, shared joints, errors, the command line."""

import copy
import json
import pickle
import re

import numpy as np
import pinocchio as pin
import pytest
import robots

import ik_toolkit as ik
from ik_toolkit import cli, errors
from ik_toolkit.robot.library import find
from ik_toolkit.robot.pose import matrix_quat
from ik_toolkit.robot.tree import Tree


def mixed(size=1.0):
    """URDF of a torso that turns and lifts and two arms with followers, slides and an endless joint; lengths times `size`."""

    def arm(side, y, kinds):
        text, parent = "", "chest"
        for k, (kind, axis, mimic) in enumerate(kinds):
            xyz = f"{0.1 * size} {y * size if k == 0 else 0.0} {0.15 * size}"
            limits = (-0.2 * size, 0.3 * size) if kind == "prismatic" else (-1.6, 1.8)
            name = f"{side}{k}"
            text += robots.joint(name, kind, parent, f"{name}_link", axis, xyz, f"{0.1 * k} 0.2 0", limits, mimic)
            parent = f"{name}_link"
        return text + robots.joint(f"{side}_end", "fixed", parent, f"{side}_tip", xyz=f"0 0 {0.1 * size}")

    left = [
        ("revolute", "0 0 1", ""),
        ("revolute", "0 1 0", ""),
        ("prismatic", "1 0 0", f'<mimic joint="turn" multiplier="{0.05 * size}" offset="{0.02 * size}"/>'),
        ("prismatic", "1 0 0", ""),
        ("revolute", "1 0 0", ""),
        ("continuous", "0 1 0", ""),
        ("revolute", "0 0 1", ""),
    ]
    right = [
        ("revolute", "0 1 0", ""),
        ("revolute", "0 0 1", ""),
        ("revolute", "0 1 0", f'<mimic joint="lift" multiplier="{0.8 / size}" offset="0.1"/>'),
        ("revolute", "1 0 0", ""),
        ("revolute", "0 1 0", ""),
        ("revolute", "1 0 0", ""),
        ("revolute", "0 0 1", ""),
    ]
    torso = robots.joint("turn", "revolute", "base", "turning", limits=(-2.0, 2.0), xyz=f"0 0 {0.2 * size}")
    torso += robots.joint("lift", "prismatic", "turning", "chest", limits=(0.0, 0.4 * size), xyz=f"0 0 {0.2 * size}")
    return f'<robot name="mixed"><link name="base"/>{torso}{arm("left", 0.2, left)}{arm("right", -0.2, right)}</robot>'


TREES = {
    "brokk_hydrolek": ["left_tip", "right_tip"],
    "mixed": ["left_tip", "right_tip"],
    "talos": ["gripper_left_base_link", "gripper_right_base_link"],
}


def tree_of(name):
    if name == "talos" and not robots.have_data():
        pytest.skip("example-robot-data is not installed")
    return ik.Tree.load(mixed() if name == "mixed" else name, tips=TREES[name])


@pytest.fixture(scope="module", params=TREES)
def tree(request):
    return tree_of(request.param)


@pytest.fixture(scope="module")
def brokk():
    return tree_of("brokk_hydrolek")


def poses(tree, q):
    return [T.homogeneous for T in tree.fk(q).values()]


def direct(tree, q):
    """Poses of the tips by Pinocchio from the model's full configuration alone."""
    data = tree.model.createData()
    pin.framesForwardKinematics(tree.model, data, tree.to_pinocchio(q))
    base = data.oMf[tree.model.getFrameId(tree.base)]
    return [base.actInv(data.oMf[tree.model.getFrameId(tip)]).homogeneous for tip in tree.tips]


# ------------------------------------------------------------------------------------------------------------ the robot
def test_kinematics_equal_pinocchio(tree):
    rng = np.random.default_rng(4)
    Q = np.array([tree.random_q(rng) for _ in range(100)])
    T, J = tree.chain.forward(Q, jacobian=True)
    assert T.shape == (100, 2, 4, 4) and J.shape == (100, 12, tree.n)
    for k, q in enumerate(Q):
        assert np.abs(T[k] - poses(tree, q)).max() < 1e-12
        assert np.abs(T[k] - direct(tree, q)).max() < 1e-12
        assert np.abs(J[k] - tree.jacobian(q)).max() < 1e-12


@pytest.mark.parametrize("base", ["chest", "turning", "left3_link"])
def test_any_base_also_with_followers_of_joints_below_it(base):
    """Joints between the root and the base move base and tips alike, so only their followers on the paths count."""
    tree = ik.Tree.load(mixed(), tips=TREES["mixed"], base=base)
    if base == "chest":
        assert {"turn", "lift"} <= set(tree.joint_names)
    q = tree.random_q(np.random.default_rng(9))
    T, J = tree.chain.forward(q, jacobian=True)
    assert np.abs(T[0] - direct(tree, q)).max() < 1e-12 and np.abs(T[0] - poses(tree, q)).max() < 1e-12
    assert np.abs(J[0] - tree.jacobian(q)).max() < 1e-12
    assert ik.solve(tree, poses(tree, q)).success


def test_jacobian_by_finite_differences(tree):
    q, h = tree.random_q(np.random.default_rng(8)), 1e-6
    J = tree.jacobian(q)
    for i in range(tree.n):
        step = h * np.eye(tree.n)[i]
        for f, (a, b) in enumerate(zip(direct(tree, q - step), direct(tree, q + step), strict=True)):
            linear = (b[:3, 3] - a[:3, 3]) / (2 * h)
            angular = a[:3, :3] @ pin.log3(a[:3, :3].T @ b[:3, :3]) / (2 * h)
            assert np.allclose(J[6 * f : 6 * f + 6, i], np.concatenate([linear, angular]), atol=2e-9)


@pytest.mark.parametrize("tips", [["left_tip"], ["left3_link", "left_tip"], ["left1_link", "right_tip", "left_tip"]])
def test_any_number_of_tips_also_on_one_path(tips):
    tree = ik.Tree.load(mixed(), tips=tips)
    scales = {arm.chain.scale for arm in tree.arms}
    assert tree.chain.scale == max(scales) and len(scales) == (2 if "left1_link" in tips else 1)
    rng = np.random.default_rng(10)
    solved = 0
    for _ in range(30):
        q = tree.random_q(rng)
        T, J = tree.chain.forward(q, jacobian=True)
        assert np.abs(T[0] - direct(tree, q)).max() < 1e-12 and np.abs(J[0] - tree.jacobian(q)).max() < 1e-12
        solved += ik.solve(tree, poses(tree, q)).success
    assert solved == 30


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
        assert np.allclose(tree.from_pinocchio(tree.to_pinocchio(q)), q, atol=1e-12)
    assert tree.check_q(tree.home) is not tree.home
    with pytest.raises(errors.InvalidConfiguration, match=f"{tree.n} values"):
        tree.fk(np.zeros(tree.n + 1))
    copy = pickle.loads(pickle.dumps(tree))
    assert copy.joint_names == tree.joint_names and np.array_equal(copy.home, tree.home)
    assert ik.solve(copy, poses(tree, q)).q.tobytes() == ik.solve(tree, poses(tree, q)).q.tobytes()
    assert all(word in repr(tree) + tree._repr_html_() for word in tree.tips)


def test_limits_of_a_shared_joint_are_those_of_both_paths():
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
        assert max(arm.upper[0] for arm in tight.arms) == 2.0


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
    with pytest.raises(errors.FrameNotFound, match=r"2 tips.*ik\.Tree\.load.*left_tip, right_tip"):
        ik.Robot.load("brokk_hydrolek")
    whole = ik.Tree.load("brokk_hydrolek")
    assert whole.tips == brokk.tips and whole.home.tolist() == brokk.home.tolist()
    with pytest.raises(errors.FrameNotFound, match="its paths end at: left_tip, right_tip"):
        ik.Tree.load(mixed())
    with pytest.raises(errors.FrameNotFound, match=r"robot 'planar_2r'.*its paths end at"):
        ik.Tree.load("planar_2r")
    for tips in ("left_tip", {"left_tip", "right_tip"}, 3):
        with pytest.raises(errors.InvalidOption, match=r"list of frame names.*ik\.Robot\.load\(source, tip=\)"):
            ik.Tree.load("brokk_hydrolek", tips)
    with pytest.raises(errors.InvalidOption, match="name of one frame, not 3"):
        ik.Tree.load("brokk_hydrolek", ["left_tip", 3])
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


def test_a_tip_left_out_misses_nothing(brokk):
    """By the kernel's own reckoning, as by Pinocchio's: of single solves, batches and their largest errors."""
    rng = np.random.default_rng(61)
    T = np.array([poses(brokk, brokk.random_q(rng)) for _ in range(6)])
    for f, tip in enumerate(brokk.tips):
        other = brokk.tips[1 - f]
        many = ik.solve_batch(brokk, {tip: T[:, f]}, check=0.0)
        assert many.success.all() and many.position_error.max() <= 1e-6 and not many.position_errors[other].any()
        for check in (False, True):
            for target in T[:, f]:
                result = ik.Solver(brokk, check=check)({tip: target})
                assert result.position_errors[other] == 0.0 and result.orientation_errors[other] is None
                assert result.success and result.position_error <= 1e-6


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


# ----------------------------------------------------------------------------------------------------------- the solver
def test_reachable_targets_are_solved(tree):
    rng = np.random.default_rng(20)
    solver = ik.Solver(tree)
    solved = 0
    for _ in range(500):
        T = poses(tree, tree.random_q(rng))
        result = solver(np.array(T))
        solved += result.success
        assert tree.outside(result.q) == []
        if result.success:
            for actual, target in zip(direct(tree, result.q), T, strict=True):
                assert np.linalg.norm(actual[:3, 3] - target[:3, 3]) <= 1e-6
                assert np.linalg.norm(pin.log3(actual[:3, :3].T @ target[:3, :3])) <= 1e-6
    assert solved >= 0.99 * 500


def test_contract(tree):
    rng = np.random.default_rng(21)
    solver = ik.Solver(tree, check=False)
    for k in range(25):
        q = tree.random_q(rng)
        T = poses(tree, q)
        before = [x.copy() for x in T]
        start = np.clip(q + rng.uniform(-0.3, 0.3, tree.n), tree.lower, tree.upper)
        kept = start.copy()
        options = dict(q0=start) if k % 2 else {}
        result = solver(T, **options)
        assert all((a == b).all() for a, b in zip(T, before, strict=True)) and (start == kept).all()
        measured = tree.errors(result.q, T)
        assert np.allclose(list(result.position_errors.values()), [e[0] for e in measured], atol=1e-9)
        assert np.allclose(list(result.orientation_errors.values()), [e[1] for e in measured], atol=1e-7)
        assert result.position_error == max(result.position_errors.values())
        assert result.orientation_error == max(result.orientation_errors.values())
        assert result.success == (result.position_error <= 1e-6 and result.orientation_error <= 1e-6)
        again = solver(dict(zip(reversed(tree.tips), reversed(T), strict=True)), **options)
        assert again.q.tobytes() == result.q.tobytes()
        assert (again.iterations, again.fk_evaluations) == (result.iterations, result.fk_evaluations)
        assert result.fk_evaluations > result.iterations >= 0 and result.limited_joints == tuple(
            tree.at_limits(result.q)
        )
        assert len(result.message) > 10 and json.dumps(result.to_dict())


def test_returns_at_once_at_a_solved_start(tree):
    q = tree.random_q(np.random.default_rng(22))
    result = ik.solve(tree, poses(tree, q), q0=q)
    assert result.success and result.iterations == 0 and result.restarts == 0 and result.fk_evaluations == 1
    assert np.allclose(result.q, q, atol=1e-15)


def test_positions_and_poses_may_be_mixed(tree):
    rng = np.random.default_rng(23)
    left, right = tree.tips
    free = 0.0
    for _ in range(10):
        first, second = poses(tree, tree.random_q(rng))
        result = ik.solve(tree, {left: first[:3, 3], right: second})
        assert result.success
        assert result.orientation_errors[left] is None and result.orientation_errors[right] <= 1e-6
        free = max(free, np.abs(poses(tree, result.q)[0][:3, :3] - first[:3, :3]).max())
        result = ik.solve(tree, np.array([first[:3, 3], second[:3, 3]]))
        assert result.success and result.orientation_error is None and max(result.position_errors.values()) <= 1e-6
    assert free > 0.1


def test_a_shared_joint_is_moved_by_either_target(brokk):
    """With both arms held, only the turret is left: both tips must agree on it, and what only one arm wants is not met."""
    arms = {j: x for j, x in zip(brokk.joint_names, brokk.home, strict=True) if j != "turret"}
    turret = brokk.locked(arms)
    assert turret.joint_names == ("turret",)
    wanted = poses(turret, [0.4])
    result = ik.solve(turret, wanted)
    assert result.success and abs(result.q[0] - 0.4) < 1e-6
    torn = ik.solve(turret, [wanted[0], poses(turret, [-0.4])[1]])
    assert not torn.success
    assert abs(torn.q[0]) < 0.1  # the best for both is in the middle
    assert all(x > 1e-2 for x in torn.position_errors.values())
    # The right arm helps: its target is out of its own reach unless the turret turns, which the left arm must follow.
    first = brokk.home.copy()
    first[0] = 0.9
    fixed = brokk.locked({"turret": 0.0})
    assert not ik.solve(fixed, poses(brokk, first), restarts=20).success
    assert ik.solve(brokk, poses(brokk, first)).success


def test_unreachable_names_the_tip(tree):
    T = poses(tree, tree.home)
    T[1][:3, 3] = (50.0, 0.0, 0.0)
    result = ik.solve(tree, T)
    assert result.status == ik.Status.UNREACHABLE and not result.success
    left, right = tree.tips
    assert f"{right} by" in result.message and f"{left} by" not in result.message
    assert tree.outside(result.q) == [] and result.position_errors[right] > 40.0
    assert result.position_errors[left] < 1.0 and result.restarts <= 2
    with pytest.raises(ik.NotSolved, match="UNREACHABLE"):
        result.raise_for_status()


def test_without_limits_a_slide_has_no_reach_bound():
    links = "".join(f'<link name="{name}"/>' for name in ("base", "left", "right"))
    slides = "".join(
        f'<joint name="{tip}_slide" type="prismatic"><parent link="base"/><child link="{tip}"/><axis xyz="{axis}"/>'
        '<limit lower="0" upper="1" effort="1" velocity="1"/></joint>'
        for tip, axis in (("left", "1 0 0"), ("right", "0 1 0"))
    )
    tree = ik.Tree.load(f'<robot name="gantry">{links}{slides}</robot>', tips=["left", "right"])
    targets = [(3.0, 0.0, 0.0), (0.0, 0.5, 0.0)]
    assert ik.solve(tree, targets).status == ik.Status.UNREACHABLE
    result = ik.solve(tree, targets, limits=False)
    assert result.success and result.q == pytest.approx([3.0, 0.5])


def test_targets_that_exclude_each_other_end_with_a_status(brokk):
    T = poses(brokk, brokk.home)
    T[1][:3, 3] = T[0][:3, 3] + (0.0, 0.8, 0.0)  # the right hand beyond the left one
    result = ik.solve(brokk, T, restarts=10)
    assert result.status in (ik.Status.STALLED, ik.Status.LIMIT_BLOCKED)
    assert "right_tip" in result.message and brokk.outside(result.q) == []
    assert result.position_error == max(e[0] for e in brokk.errors(result.q, T))

    def size(q):
        return sum((p / brokk.chain.scale) ** 2 + (2 * np.sin(r / 2)) ** 2 for p, r in brokk.errors(q, T))

    tried = ik.solve(brokk, T, restarts=10, history=True).history["q"]
    assert size(result.q) <= min(size(q) for q in tried) + 1e-12


def test_a_cold_start_is_near_and_on_the_turn_nearest_home(brokk):
    """Starts from the table, each arm's own joints chosen for its own target: few steps, few restarts."""
    rng = np.random.default_rng(24)
    results = [ik.solve(brokk, poses(brokk, brokk.random_q(rng))) for _ in range(200)]
    assert np.mean([result.iterations for result in results]) < 5.5
    assert np.mean([result.restarts for result in results]) < 0.1
    rolls = [k for k, joint in enumerate(brokk.joint_names) if joint.endswith("wrist_roll")]
    assert max(np.abs(result.q[rolls]).max() for result in results) <= np.pi + 1e-9
    assert brokk.upper[rolls].min() > 4.0


def test_a_success_that_pinocchio_does_not_confirm_is_none(brokk, monkeypatch):
    T = poses(brokk, brokk.home)
    assert ik.solve(brokk, T).success
    real = ik.Robot.errors
    monkeypatch.setattr(
        ik.Robot, "errors", lambda arm, q, T: (2e-6, 0.0) if arm.tip == "right_tip" else real(arm, q, T)
    )
    result = ik.solve(brokk, T)
    assert result.status == ik.Status.CHECK_FAILED and not result.success
    assert ik.Solver(brokk, check=False)(T).success


def test_budgets_history_and_seed(brokk):
    T = poses(brokk, brokk.random_q(np.random.default_rng(30)))
    for budget in (1, 3):
        result = ik.solve(brokk, T, max_iterations=budget, restarts=0, tolerance=1e-12)
        assert result.iterations <= budget and result.restarts == 0
    spent = ik.solve(brokk, T, max_evaluations=4, tolerance=1e-300)
    assert spent.fk_evaluations <= 5 and spent.status == ik.Status.ITERATION_LIMIT
    result = ik.solve(brokk, T, restarts=2, max_iterations=2, tolerance=1e-300)
    assert result.restarts == 2 and result.iterations == 6
    result = ik.solve(brokk, T, restarts=0, history=True, max_iterations=25)
    history = result.history
    assert len(history["q"]) == result.iterations + 1
    assert history["position_error"].min() <= result.position_error + 1e-14  # one is the kernel's, one Pinocchio's
    for q, position, angle in zip(history["q"], history["position_error"], history["orientation_error"], strict=True):
        measured = brokk.errors(q, T)
        assert abs(max(e[0] for e in measured) - position) < 1e-12
        assert abs(max(e[1] for e in measured) - angle) < 1e-7
        assert brokk.outside(q) == []
    impossible = [x.copy() for x in T]
    impossible[1][:3, 3] += (0.0, 0.5, 0.0)
    one, same, other = (ik.solve(brokk, impossible, restarts=30, seed=seed) for seed in (1, 1, 2))
    assert one.q.tobytes() == same.q.tobytes() and one.seed == 1
    assert one.iterations != other.iterations


def test_weights_and_limits(brokk):
    T = poses(brokk, brokk.random_q(np.random.default_rng(31)))
    near = np.clip(brokk.home + 0.03, brokk.lower, brokk.upper)
    weights = np.ones(brokk.n)
    weights[0] = 0.0
    held = ik.solve(brokk, [x[:3, 3] for x in poses(brokk, near)], q0=brokk.home, joint_weights=weights, restarts=0)
    assert held.success and held.q[0] == brokk.home[0]
    assert ik.solve(brokk, T, joint_weights=weights, restarts=5).q[0] == brokk.home[0]
    beyond = brokk.upper + 0.05
    assert not ik.solve(brokk, poses(brokk, beyond), restarts=5).success
    result = ik.solve(brokk, poses(brokk, beyond), q0=brokk.upper, limits=False, restarts=0)
    assert result.success and brokk.outside(result.q)
    with pytest.raises(errors.InvalidConfiguration, match="turret"):
        ik.solve(brokk, T, q0=np.concatenate([[3.0], brokk.home[1:]]), q0_outside="refuse")
    assert "clamped" in ik.solve(brokk, T, q0=np.concatenate([[3.0], brokk.home[1:]])).notice


def test_lengths_have_no_unit_in_the_kernel():
    """A machine four times as large takes the same steps to the same angles."""
    lift = r'<mimic joint="lift"[^>]*>'  # a slide that drives a turn is measured in metres
    small, large = (ik.Tree.load(re.sub(lift, "", mixed(size)), tips=TREES["mixed"]) for size in (1.0, 4.0))
    factor = np.where(np.array(small.joint_kinds) == "prismatic", 4.0, 1.0)
    rng = np.random.default_rng(33)
    for _ in range(10):
        q = small.random_q(rng)
        T = poses(small, q)
        scaled = [x.copy() for x in T]
        for x in scaled:
            x[:3, 3] *= 4.0
        a = ik.solve(small, T, position_tolerance=1e-6)
        b = ik.solve(large, scaled, position_tolerance=4e-6)
        assert a.success and a.iterations == b.iterations and a.restarts == b.restarts
        assert np.allclose(b.q, factor * a.q, atol=1e-7)


def test_an_endless_joint_comes_back_on_the_turn_nearest_the_start():
    tree = tree_of("mixed")
    k = tree.joint_kinds.index("continuous")
    q = tree.random_q(np.random.default_rng(34))
    start = q.copy()
    start[k] += 6.1  # almost a turn away: the same pose is nearer on the next turn
    result = ik.solve(tree, poses(tree, q), q0=start)
    assert result.success and abs(result.q[k] - start[k]) <= np.pi + 1e-9
    assert all(p <= 1e-6 for p in result.position_errors.values())


def test_nearly_rigid_targets_are_projected_and_said(brokk):
    T = np.array(poses(brokk, brokk.home))
    T[1, :3, :3] *= 1.0 + 1e-4
    result = ik.solve(brokk, T)
    assert result.success and result.notice.startswith("right_tip:")


@pytest.mark.parametrize(
    ("targets", "kind", "words"),
    [
        (lambda T: {}, errors.InvalidTarget, "at least one of left_tip, right_tip"),
        (lambda T: {"left_tip": T[0], "rigt_tip": T[1]}, errors.FrameNotFound, "Did you mean 'right_tip'"),
        (lambda T: [T[0]], errors.InvalidTarget, "got 1"),
        (lambda T: [*T, T[0]], errors.InvalidTarget, "got 3"),
        (lambda T: T[0], errors.InvalidTarget, "not a single one"),
        (lambda T: pin.SE3(T[0]), errors.InvalidTarget, "not a single one"),
        (lambda T: 3.0, errors.InvalidTarget, "left_tip, right_tip"),
        (lambda T: [T[0], np.full(3, np.nan)], errors.InvalidTarget, "right_tip: .*finite"),
        (lambda T: [T[0], 2.0 * T[1]], errors.InvalidTarget, "right_tip: "),
        (lambda T: np.array([T[0], np.full((4, 4), np.nan)]), errors.InvalidTarget, "right_tip: "),
        (lambda T: [T[0], "there"], errors.InvalidTarget, "right_tip: "),
    ],
)
def test_bad_targets_are_refused_by_name(brokk, targets, kind, words):
    with pytest.raises(kind, match=words):
        ik.solve(brokk, targets(poses(brokk, brokk.home)))


def test_what_several_tips_cannot_do_is_said(brokk):
    T = poses(brokk, brokk.home)
    with pytest.raises(errors.FrameNotFound, match="Did you mean 'left_tip'"):
        ik.Tree.load("brokk_hydrolek", tips=["left_tp", "right_tip"])
    with pytest.raises(errors.FrameNotFound, match="once only"):
        ik.Tree.load("brokk_hydrolek", tips=["left_tip", "left_tip"])
    with pytest.raises(errors.FrameNotFound, match="at least one"):
        ik.Tree.load("brokk_hydrolek", tips=[])
    with pytest.raises(errors.ModelError, match="one model"):
        Tree([brokk.arms[0], ik.Robot.load("hydrolek_7w")])
    for rule in ("newton", "state-space"):
        with pytest.raises(errors.UnknownSolver, match="one tip; for several use 'lm'"):
            ik.solve(brokk, T, rule)
    with pytest.raises(errors.InvalidOption, match="one tip"):
        ik.track(brokk, ik.line([0, 0, 0], [1, 0, 0], duration=1.0))


# ----------------------------------------------------------------------------------------------------- the command line
@pytest.fixture
def run(capsys):
    def call(*arguments):
        code = cli.main([str(argument) for argument in arguments])
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return call


def options_of(targets):
    words = []
    for tip, T in targets.items():
        numbers = [*T[:3, 3], *matrix_quat(T[:3, :3])] if T.ndim == 2 else T
        words += ["--target", f"{tip}:" + ",".join(f"{x:.12f}" for x in numbers)]
    return words


def test_command_line_solves_both_tips(run, brokk):
    T = dict(zip(brokk.tips, poses(brokk, brokk.random_q(np.random.default_rng(40))), strict=True))
    code, out, _ = run("solve", "brokk_hydrolek", *options_of(T), "--json")
    answer = json.loads(out)
    assert code == 0 and answer["success"] and answer["joint_names"] == list(brokk.joint_names)
    assert set(answer["tips"]) == set(brokk.tips) and set(answer["target"]) == set(brokk.tips)
    for actual, target in zip(direct(brokk, answer["q"]), T.values(), strict=True):
        assert np.abs(actual - target).max() < 3e-6
    turned = run("solve", "brokk_hydrolek", *options_of(dict(reversed(T.items()))), "--json")
    assert json.loads(turned[1])["q"] == answer["q"]
    code, out, _ = run("solve", "brokk_hydrolek", *options_of(T))
    assert code == 0 and "at left_tip" in out and "turret" in out


def test_command_line_takes_positions_starts_and_locked_joints(run, brokk):
    q = brokk.home.copy()
    q[0] = 0.3
    T = dict(zip(brokk.tips, poses(brokk, q), strict=True))
    T["right_tip"] = T["right_tip"][:3, 3]
    start = ",".join(str(x) for x in q)
    code, out, _ = run("solve", "brokk_hydrolek", *options_of(T), "--q0", start, "--json", "--tolerance", "1e-5")
    answer = json.loads(out)
    assert code == 0 and answer["iterations"] == 0
    assert answer["tips"]["right_tip"]["orientation_error"] is None
    code, out, _ = run("solve", "brokk_hydrolek", *options_of(T), "--lock", "turret=0.3", "--json")
    assert code == 0 and "turret" not in json.loads(out)["joint_names"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--target", "left_tip:9,0,0", "--target", "right_tip:1,0,1"], "left_tip by"),
        (["--target", "left_tp:1,0,1", "--target", "right_tip:1,0,1"], "Did you mean 'left_tip'"),
        (["--target", "left_tip:1,0"], "TIP:X,Y,Z"),
        (["--target", "left_tip"], "TIP:X,Y,Z"),
        (["--target", "left_tip:1,0,1", "--target", "left_tip:1,0,1"], "twice"),
        (["--target", "left_tip:1,0,1,0,0,0,0"], "quat_xyzw has length 0"),
        (["--target", "left_tip:nan,0,1"], "finite"),
        (["--target", "left_tip:1,0,1", "--xyz", "1", "0", "0"], "leave out --xyz"),
        (["--target", "left_tip:1,0,1", "-s", "state-space"], "for several use 'lm'"),
        (["--target", "left_tip:1,0,1", "--all"], "--all is for one tip"),
        (["--target", "left_tip:1,0,1", "--mask", "1", "1", "1", "1", "0", "0"], "must be 0"),
    ],
)
def test_command_line_refuses_in_one_sentence(run, words, message):
    code, out, err = run("solve", "brokk_hydrolek", *words)
    assert code == (1 if "9,0,0" in words[1] else 2) and message in err and "Traceback" not in err
