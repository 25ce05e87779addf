"""What counts: mask, slack, free turn and frame, and targets relative to another tip, against independent arithmetic."""

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

import ik_toolkit as ik
from ik_toolkit import errors

AXES = ("base", "tip", "target")


@pytest.fixture(scope="module")
def arm():
    return ik.Robot.load("panda")


def counted(tip, target, mask=None, slack=None, free_turn=None, frame="base"):
    """Norms of what counts of two (4, 4) poses, written from the definition with scipy's rotations."""
    left = Rotation.from_matrix(target[:3, :3] @ tip[:3, :3].T)
    if free_turn is not None:  # of all turns about where the axis is wanted, the one that leaves the smallest rotation
        axis = target[:3, :3] @ free_turn / np.linalg.norm(free_turn)
        *v, w = left.as_quat()
        left = Rotation.from_rotvec(-2.0 * np.arctan2(axis @ v, w) * axis) * left
    axes = {"base": np.eye(3), "tip": tip[:3, :3], "target": target[:3, :3]}[frame].T
    e = np.concatenate([axes @ (target[:3, 3] - tip[:3, 3]), axes @ left.as_rotvec()])
    width = np.zeros(6) if slack is None else np.asarray(slack)
    e = np.sign(e) * np.maximum(np.abs(e) - width, 0.0) * (1.0 if mask is None else np.asarray(mask))
    return np.linalg.norm(e[:3]), np.linalg.norm(e[3:])


def beside(tip, e, frame, turn):
    """A target (4, 4) at which a tip pose has the error e (6,), and which is turned about its own axes by `turn` (3,)."""
    R = np.eye(3) if frame == "base" else tip[:3, :3]
    target = tip.copy()
    target[:3, :3] = pin.exp3(R @ e[3:]) @ tip[:3, :3] @ pin.exp3(turn)
    target[:3, 3] += (target[:3, :3] if frame == "target" else R) @ e[:3]
    return target


def some_options(rng):
    """Options of what counts, at random."""
    mask = rng.choice([0.0, 0.5, 1.0, 2.0], 6, p=[0.2, 0.2, 0.4, 0.2])
    if not mask.any():
        mask[rng.integers(6)] = 1.0
    slack = np.where(rng.random(6) < 0.4, 0.0, rng.uniform(0.0, [0.1] * 3 + [0.5] * 3))
    options = {"frame": str(rng.choice(AXES))}
    options |= {"mask": mask} if rng.random() < 0.5 else {}
    options |= {"slack": slack} if rng.random() < 0.7 else {}
    options |= {"free_turn": rng.normal(size=3)} if rng.random() < 0.4 else {}
    return options


@pytest.mark.parametrize("seed", range(4))
def test_answers_are_inside_by_the_definition(arm, seed):
    """The target is within slack, so a solution exists; scipy checks whether the result is one."""
    rng = np.random.default_rng(seed)
    for _ in range(25):
        options = some_options(rng)
        tip = arm.fk(arm.random_q(rng)).homogeneous
        e, turn = rng.uniform(-1.0, 1.0, 6) * options.get("slack", 0.0), np.zeros(3)
        if "free_turn" in options:
            e[3:], turn = 0.0, rng.uniform(-3.0, 3.0) * options["free_turn"] / np.linalg.norm(options["free_turn"])
        target = beside(tip, e, options["frame"], turn)
        assert max(counted(tip, target, **options)) < 1e-12
        result = ik.solve(arm, target, **options)
        assert result.success and result.solver == "lm", (result, options)
        position, angle = counted(arm.fk(result.q).homogeneous, target, **options)
        assert position <= 1.001e-6 and angle <= 1.001e-6
        assert result.position_error == pytest.approx(position, abs=1e-12)
        assert result.orientation_error == pytest.approx(angle, abs=1e-12)


def test_the_columns_are_the_derivative(arm):
    """Newton's convergence, three times as many digits a step: with any other matrix the error falls by a factor."""
    rng = np.random.default_rng(3)
    fast = 0
    for k in range(30):
        q = arm.home + rng.uniform(-0.4, 0.4, arm.n)
        far = pin.SE3(pin.exp3(rng.normal(size=3)), rng.uniform(-0.1, 0.1, 3)).homogeneous
        T = arm.fk(q).homogeneous @ far  # what is free stays far from zero
        mask = np.array([1, 1, 0, 1, 1, 0]) if k % 3 else None
        slack = None if k % 3 == 1 else [0, 0.02, 0, 0.1, 0, 0]
        axis = rng.normal(size=3) if k % 2 else None
        given = {"mask": mask, "slack": slack, "free_turn": axis, "frame": AXES[k % 3]}
        result = ik.solve(
            arm, T, "dls", q0=q, damping=1e-6, history=True, tolerance=1e-13, restarts=0, max_iterations=60, **given
        )
        if not result.success or result.iterations > 20:
            continue
        e = np.hypot(result.history["position_error"], result.history["orientation_error"])
        fast += result.iterations <= 12 and (e[-1] <= 1e-13 or e[-1] < 50 * e[-2] ** 2 + 1e-13)
    assert fast >= 20


def test_the_answer_stops_at_the_edge_of_the_slack(arm):
    """From outside the box the search goes no further than its edge, and inside it nothing moves."""
    q = arm.home
    T = arm.fk(q).homogeneous
    T[2, 3] += 0.05
    result = ik.solve(arm, T, "lm", q0=q, slack=[0, 0, 0.02, 0, 0, 0])
    assert result.success and result.attempt == 0
    assert T[2, 3] - arm.fk(result.q).translation[2] == pytest.approx(0.02, abs=2e-6)
    still = ik.solve(arm, T, "lm", q0=q, slack=[0, 0, 0.06, 0, 0, 0])
    assert still.success and still.iterations == 0 and np.array_equal(still.q, q)


def test_infinite_slack_and_half_a_turn_free_what_a_mask_frees(arm):
    rng = np.random.default_rng(8)
    for frame in AXES:
        far = pin.SE3(pin.exp3(np.array([0.3, 0.2, 2.9])), np.array([0.1, 0.0, 9.0]))
        T = (arm.fk(arm.random_q(rng)) * far).homogeneous
        freed = {"slack": [0, 0, np.inf, 0, 0, np.pi], "frame": frame}
        if frame == "base":
            T[2, 3] = 50.0
        result = ik.solve(arm, T, "lm", restarts=300, **freed)
        assert result.status != ik.Status.UNREACHABLE
        masked = ik.solve(arm, T, "lm", restarts=300, mask=[1, 1, 0, 1, 1, 0], frame=frame)
        assert masked.success == result.success and masked.status != ik.Status.UNREACHABLE


def test_a_free_turn_is_what_an_axis_target_asks_for(arm):
    rng = np.random.default_rng(5)
    for _ in range(20):
        axis, direction = rng.normal(size=3), rng.normal(size=3)
        xyz = arm.fk(arm.random_q(rng)).translation
        target = ik.pose(xyz, axis=axis, direction=direction)
        one = ik.solve(arm, target)
        other = ik.solve(arm, target.T_base_tip, free_turn=axis)
        assert one.success == other.success
        if one.success:
            assert one.q == pytest.approx(other.q, abs=1e-9)
            now = arm.fk(one.q).rotation @ axis / np.linalg.norm(axis)
            assert np.linalg.norm(np.cross(now, direction / np.linalg.norm(direction))) < 2e-6
            assert now @ direction > 0.0
    with pytest.raises(errors.InvalidOption, match="free_turn"):
        ik.solve(arm, target, free_turn=axis)


def test_unreachable_is_a_proof_with_slack_too(arm):
    """A target 10 cm out of reach is not, with 11 cm of slack; and a weight of 0 proves nothing."""
    far = ik.solve(arm, [9.0, 0.0, 0.333])
    assert far.status == ik.Status.UNREACHABLE
    bound = 9.0 - float(far.message.split("by ")[1].split(" m ")[0])
    T = arm.fk(arm.home).homogeneous
    T[:3, 3] = [bound + 0.1, 0.0, 0.333]
    position = [1, 1, 1, 0, 0, 0]
    tight = ik.solve(arm, T, mask=position, slack=[0.09, 0, 0, 0, 0, 0], restarts=3)
    assert tight.status == ik.Status.UNREACHABLE and "by 10" in tight.message
    assert ik.solve(arm, T, mask=position, slack=[0.11, 0, 0, 0, 0, 0], restarts=3).status != ik.Status.UNREACHABLE
    assert ik.solve(arm, T, mask=[0, 1, 1, 0, 0, 0], restarts=3).status != ik.Status.UNREACHABLE
    heavy = ik.solve(arm, T, mask=[1e-6, 1, 1, 0, 0, 0], position_tolerance=1e-6)  # 1 m on x is 1e-6 of error
    assert heavy.status != ik.Status.UNREACHABLE


@pytest.mark.parametrize("rule", ["dls", "pinv", "transpose", "ccd", "pid"])
def test_every_rule_takes_them(arm, rule):
    q = arm.home + 0.1
    T = arm.fk(q).homogeneous
    options = {"slack": [0.01] * 3 + [0.1] * 3, "free_turn": [0, 0, 1], "frame": "tip", "tolerance": 1e-3}
    result = ik.solve(arm, T, rule, q0=arm.home, max_iterations=5000, **options)
    assert result.success and result.position_error <= 1e-3 and result.orientation_error <= 1e-3


def test_closest_follow_batch_and_all_take_them(arm):
    rng = np.random.default_rng(11)
    q = arm.home + rng.uniform(-0.2, 0.2, arm.n)
    T = arm.fk(q).homogeneous
    options = {"slack": [0.01, 0.01, 0.05, 0.1, 0.1, 0.0], "free_turn": [0, 0, 1], "frame": "target"}
    near = ik.solve(arm, T, closest=arm.home, **options)
    step = ik.solve(arm, T, q0=arm.home, follow=True, **options)
    assert near.success and step.success and np.abs(step.q - arm.home).max() <= 0.5
    many = ik.solve_batch(arm, np.array([T] * 3), check=1.0, **options)
    assert many.success.all()
    found = ik.solve_all(arm, T, starts=20, count=5, **options)
    assert len(found) and all(counted(arm.fk(x).homogeneous, T, **options)[0] < 1e-6 for x in found.q)


def test_closed_forms_refuse_and_auto_searches():
    robot = ik.Robot.load("inspection_7dof")
    T = robot.fk(robot.home).homogeneous
    for options in (
        {"slack": [0.1] * 6},
        {"free_turn": [0, 0, 1]},
        {"mask": [1, 1, 1, 1, 1, 0]},
        {"closest": robot.home},
    ):
        with pytest.raises(errors.InvalidOption, match="closed form"):
            ik.solve(robot, T, "inspection", **options)
        assert ik.solve(robot, T, **options).solver == "lm"


# ------------------------------------------------------------------------------------------------------------ several tips
def test_a_position_in_the_frame_of_the_target_has_raw_errors_in_the_base(arm, brokk):
    """`frame='target'` may be meant for the pose of the other tip; a position is then measured along the base's axes."""
    rng = np.random.default_rng(8)
    point = arm.fk(arm.random_q(rng)).translation
    result = ik.solve(arm, point, frame="target")
    assert result.success and np.abs(result.raw_error[:3] - (point - arm.fk(result.q).translation)).max() < 1e-12
    poses = brokk.fk(brokk.random_q(rng))
    target = {"left_tip": poses["left_tip"], "right_tip": poses["right_tip"].translation}
    result = ik.solve(brokk, target, frame="target", slack={"left_tip": (0.01, 0.0, 0.0, 0.0, 0.0, 0.0)})
    assert result.success
    left = target["right_tip"] - brokk.fk(result.q)["right_tip"].translation
    assert np.abs(result.raw_errors["right_tip"][:3] - left).max() < 1e-12
    assert ik.solve(brokk, {"left_tip": poses["left_tip"].translation}, frame="target").success


def test_each_tip_counts_what_its_options_say(brokk):
    rng = np.random.default_rng(2)
    for _ in range(20):
        T = {tip: pose.homogeneous for tip, pose in brokk.fk(brokk.random_q(rng)).items()}
        options = {"mask": {"left_tip": [1, 1, 1, 0, 0, 0]}, "slack": {"right_tip": [0.01, 0, 0, 0, 0.2, 0]}}
        options |= {"frame": {"right_tip": "tip"}, "free_turn": {"right_tip": [1, 0, 0]}}
        result = ik.solve(brokk, T, **options)
        assert result.success
        for tip, pose in brokk.fk(result.q).items():
            own = {name: by[tip] for name, by in options.items() if tip in by}
            position, angle = counted(pose.homogeneous, T[tip], **own)
            assert position <= 1.001e-6 and angle <= 1.001e-6
            assert result.position_errors[tip] == pytest.approx(position, abs=1e-12)
    with pytest.raises(errors.InvalidOption, match="Did you mean 'left_tip'"):
        ik.solve(brokk, T, mask={"left_tp": [1] * 6})


def test_a_tip_left_out_is_free_and_its_joints_stay(brokk):
    rng = np.random.default_rng(6)
    left, right = brokk.places
    alone = np.setdiff1d(left, right)
    for _ in range(30):
        T = brokk.fk(brokk.random_q(rng))["right_tip"]
        result = ik.solve(brokk, {"right_tip": T})
        assert result.success and np.array_equal(result.q[alone], brokk.home[alone])
        q0 = brokk.random_q(rng)
        result = ik.solve(brokk, {"right_tip": T.translation}, q0=q0)
        assert result.success and result.q[alone] == pytest.approx(q0[alone], abs=1e-15)
        assert result.orientation_error is None
    with pytest.raises(errors.InvalidTarget, match="at least one"):
        ik.solve(brokk, {})


@pytest.mark.parametrize("of", ["left_tip", "right_tip"])
@pytest.mark.parametrize("free", [False, True])
def test_targets_relative_to_the_other_tip(brokk, of, free):
    rng = np.random.default_rng(9)
    other = next(tip for tip in brokk.tips if tip != of)
    for k in range(20):
        T = {tip: pose.homogeneous for tip, pose in brokk.fk(brokk.random_q(rng)).items()}
        wanted = np.linalg.inv(T[other]) @ T[of]
        targets = {of: wanted} if free else {of: wanted, other: T[other]}
        options = {"slack": {of: [0.01, 0, 0, 0, 0, 0.1]}, "frame": {of: AXES[k % 3]}} if k % 2 else {}
        result = ik.solve(brokk, targets, relative_to={of: other}, **options)
        assert result.success
        poses = {tip: pose.homogeneous for tip, pose in brokk.fk(result.q).items()}
        own = {name: by[of] for name, by in options.items()}
        position, angle = counted(poses[of], poses[other] @ wanted, **own)
        assert position <= 1.001e-6 and angle <= 1.001e-6
        assert result.position_errors[of] == pytest.approx(position, abs=1e-12)
    position = ik.solve(brokk, {of: wanted[:3, 3]}, relative_to={of: other})
    poses = brokk.fk(position.q)
    assert position.success and np.linalg.norm((poses[other].inverse() * poses[of]).translation - wanted[:3, 3]) <= 1e-6


def test_relative_targets_out_of_the_base_s_reach_are_not_called_unreachable(brokk):
    """1 m from the other tip, but further from the base than the arm is long when read as a pose in the base."""
    T = brokk.fk(brokk.home)
    far = (T["left_tip"].inverse() * T["right_tip"]).homogeneous
    far[:3, 3] += 40.0
    result = ik.solve(brokk, {"right_tip": far}, relative_to={"right_tip": "left_tip"}, restarts=5)
    assert not result.success and result.status != ik.Status.UNREACHABLE


def test_chains_of_relative_targets_and_circles():
    names = ["left_tip", "right_tip"]
    brokk = ik.Tree.load("brokk_hydrolek", tips=names)
    T = brokk.fk(brokk.home)
    for circle in ({"left_tip": "left_tip"}, {"left_tip": "right_tip", "right_tip": "left_tip"}):
        with pytest.raises(errors.InvalidOption, match=r"circular: .*_tip -> .*_tip"):
            ik.solve(brokk, list(T.values()), relative_to=circle)
    with pytest.raises(errors.InvalidOption, match="Did you mean 'left_tip'"):
        ik.solve(brokk, list(T.values()), relative_to={"right_tip": "left_tp"})


@pytest.mark.parametrize(
    "options", [{"mask": (1,) * 6}, {"slack": np.zeros(6)}, {"mask": np.ones(6), "slack": (0,) * 6}]
)
def test_what_leaves_nothing_out_changes_nothing(options):
    """It took another way of the same errors: no closed form, no proof that a list is complete, and other joint rates."""
    robot = ik.Robot.load("inspection_7dof")
    T = robot.fk(robot.home + 0.1).homogeneous
    assert ik.solve(robot, T, **options).solver == ik.solve(robot, T).solver == "inspection"
    trackers = [ik.Tracker(robot, q0=robot.home, **given) for given in ({}, options)]
    plain, other = ([tracker.update(T, 0.01).q for _ in range(20)] for tracker in trackers)
    assert np.array_equal(plain, other)
