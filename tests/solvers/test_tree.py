"""Several tips at once: kinematics against Pinocchio, shared joints, errors."""

import re

import numpy as np
import pinocchio as pin
import pytest
import robots
from trees import TREES, direct, mixed, poses, tree_of

import ik_toolkit as ik
from ik_toolkit import errors
from ik_toolkit.robot.tree import Tree


@pytest.fixture(scope="module", params=TREES)
def tree(request):
    return tree_of(request.param)


def test_reachable_targets_are_solved(tree):
    rng = np.random.default_rng(20)
    solver = ik.Solver(tree)
    solved = 0
    for _ in range(150):
        T = poses(tree, tree.random_q(rng))
        result = solver(np.array(T))
        solved += result.success
        assert tree.outside(result.q) == []
        if result.success:
            for actual, target in zip(direct(tree, result.q), T, strict=True):
                assert np.linalg.norm(actual[:3, 3] - target[:3, 3]) <= 1e-6
                assert np.linalg.norm(pin.log3(actual[:3, :3].T @ target[:3, :3])) <= 1e-6
    assert solved >= 0.99 * 150


def test_tips_may_be_given_in_any_order(tree):
    """What every answer keeps is in the contract tests, on two arms."""
    rng = np.random.default_rng(21)
    solver = ik.Solver(tree, check=False)
    for _ in range(5):
        q = tree.random_q(rng)
        T = poses(tree, q)
        assert np.allclose(solver(T, q0=q).q, q, rtol=0, atol=1e-15)  # nothing moves where nothing is left to do
        result = solver(T)
        measured = np.array(tree.errors(result.q, T))
        assert np.allclose(list(result.position_errors.values()), measured[:, 0], atol=1e-9)
        assert np.allclose(list(result.orientation_errors.values()), measured[:, 1], atol=1e-7)
        again = solver(dict(zip(reversed(tree.tips), reversed(T), strict=True)))
        assert again.q.tobytes() == result.q.tobytes() and again.fk_evaluations == result.fk_evaluations


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
                assert result.to_dict()["tips"][other] == {"position_error": None, "orientation_error": None}
                assert result.success and result.position_error <= 1e-6


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


def test_without_limits_a_slide_has_no_reach_bound():
    slides = "".join(
        robots.joint(f"{tip}_slide", "prismatic", "base", tip, axis, xyz="0 0 0", limits=(0, 1))
        for tip, axis in (("left", "1 0 0"), ("right", "0 1 0"))
    )
    tree = ik.Tree.load(f'<robot name="gantry"><link name="base"/>{slides}</robot>', tips=["left", "right"])
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
        return sum((p / brokk.reach) ** 2 + r**2 for p, r in brokk.errors(q, T))

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
    real = ik.Robot._errors
    monkeypatch.setattr(
        ik.Robot, "_errors", lambda arm, q, T: (2e-6, 0.0) if arm.tip == "right_tip" else real(arm, q, T)
    )
    result = ik.solve(brokk, T)
    assert result.status == ik.Status.CHECK_FAILED and not result.success
    assert ik.Solver(brokk, check=False)(T).success


def test_the_history_has_the_largest_errors_of_any_tip_and_the_seed_changes_the_search(brokk):
    """What a budget of evaluations and iterations allows is in the contract tests, on two arms."""
    T = poses(brokk, brokk.random_q(np.random.default_rng(30)))
    history = ik.solve(brokk, T, restarts=0, history=True, max_iterations=25).history
    for q, position, angle in zip(history["q"], history["position_error"], history["orientation_error"], strict=True):
        measured = brokk.errors(q, T)
        assert abs(max(e[0] for e in measured) - position) < 1e-12
        assert abs(max(e[1] for e in measured) - angle) < 1e-7
    impossible = [x.copy() for x in T]
    impossible[1][:3, 3] += (0.0, 0.5, 0.0)
    one, same, other = (ik.solve(brokk, impossible, restarts=30, seed=seed) for seed in (1, 1, 2))
    assert one.q.tobytes() == same.q.tobytes() and one.seed == 1
    assert one.iterations != other.iterations


def test_limits_and_starts_outside_them(brokk):
    beyond = brokk.upper + 0.05
    assert not ik.solve(brokk, poses(brokk, beyond), restarts=5).success
    result = ik.solve(brokk, poses(brokk, beyond), q0=brokk.upper, limits=False, restarts=0)
    assert result.success and brokk.outside(result.q)
    outside = np.concatenate([[3.0], brokk.home[1:]])
    with pytest.raises(errors.InvalidConfiguration, match="turret"):
        ik.solve(brokk, poses(brokk, brokk.home), q0=outside, q0_outside="refuse")
    assert "clamped" in ik.solve(brokk, poses(brokk, brokk.home), q0=outside).notice


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


EACH = "takes one target for each of left_tip, right_tip"


@pytest.mark.parametrize(
    ("targets", "kind", "words"),
    [
        (lambda T: {"left_tip": None}, errors.InvalidTarget, "give a target for at least one of left_tip, right_tip"),
        (lambda T: {"left_tip": T[0], "rigt_tip": T[1]}, errors.FrameNotFound, "Did you mean 'right_tip'"),
        (lambda T: [T[0]], errors.InvalidTarget, "got 1"),
        (lambda T: [*T, T[0]], errors.InvalidTarget, rf"{EACH}; got 3 \(a dict may leave tips out: they are free\)"),
        (lambda T: T[0], errors.InvalidTarget, rf"{EACH} \(a dict, or a list in this order\), not a single one"),
        (lambda T: T[0][:3, 3], errors.InvalidTarget, "not a single one"),
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
    with pytest.raises(errors.FrameNotFound, match="only once"):
        ik.Tree.load("brokk_hydrolek", tips=["left_tip", "left_tip"])
    with pytest.raises(errors.FrameNotFound, match="at least one"):
        ik.Tree.load("brokk_hydrolek", tips=[])
    with pytest.raises(errors.ModelError, match="one model"):
        Tree([brokk.arms[0], ik.Robot.load("hydrolek_7w")])
    for rule in ("newton", "state-space"):
        with pytest.raises(errors.UnknownSolver, match="one tip; for several use 'lm'"):
            ik.solve(brokk, T, rule)
    with pytest.raises(errors.InvalidTarget, match="a dict of References, one for each of left_tip, right_tip"):
        ik.track(brokk, ik.line([0, 0, 0], [1, 0, 0], duration=1.0))
