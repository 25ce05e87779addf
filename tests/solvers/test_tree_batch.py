"""Batches for several tips: target formats, identical bytes, row contents, rejected input."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pinocchio as pin
import pytest
import robots
import trees

import ik_toolkit as ik
from ik_toolkit.errors import FrameNotFound, InvalidTarget
from ik_toolkit.solvers.batch.solve_batch import solve_parts

TIPS = ["left_tip", "right_tip"]


@pytest.fixture(scope="module")
def tree(brokk):
    return brokk


def reachable(tree, count, seed=0):
    rng = np.random.default_rng(seed)
    return tree.chain.forward(np.array([tree.random_q(rng) for _ in range(count)]))[0]


def test_rows_are_those_of_single_solves_and_pinocchio_agrees(tree):
    T = reachable(tree, 60)
    T[7, 1, :3, 3] += 50.0
    many = ik.solve_batch(tree, T, check=1.0)
    solver = ik.Solver(tree)
    for k in range(len(T)):
        alone = solver(T[k])
        assert alone.q.tobytes() == many.q[k].tobytes() and alone.status == many.status[k]
        assert alone.position_errors == {tip: errors[k] for tip, errors in many.position_errors.items()}
        assert many[k].message == alone.message
    assert many.status[7] == ik.Status.UNREACHABLE and many.position_errors["left_tip"][7] < 1.0
    assert many[7].restarts <= 2 and "right_tip by" in many[7].message and "left_tip by" not in many[7].message
    good = np.delete(np.arange(len(T)), 7)
    assert many.success[good].all()
    for k in good:
        for tip, reached in tree.fk(many.q[k]).items():
            assert np.abs(reached.homogeneous - T[k, TIPS.index(tip)]).max() < 3e-6
    assert (many.q >= tree.lower).all() and (many.q <= tree.upper).all()


def test_any_form_and_any_cut_gives_the_same_bytes(tree):
    T = reachable(tree, 300, seed=1)
    whole = ik.solve_batch(tree, T, threads=1).table.tobytes()
    assert ik.solve_batch(tree, T, threads=3).table.tobytes() == whole
    assert ik.solve_batch(tree, {"right_tip": T[:, 1], "left_tip": T[:, 0]}).table.tobytes() == whole
    assert ik.solve_batch(tree, iter(np.split(T, 5))).table.tobytes() == whole
    assert ik.solve_batch(tree, [list(pair) for pair in T]).table.tobytes() == whole
    assert ik.solve_batch(tree, [dict(zip(TIPS, pair, strict=True)) for pair in T]).table.tobytes() == whole
    assert np.concatenate([part.table for part in solve_parts(tree, T)]).tobytes() == whole
    with ThreadPoolExecutor(2) as pool:
        assert ik.solve_batch(tree, T, executor=pool).table.tobytes() == whole


def test_positions_mixtures_and_free_tips(tree):
    T = reachable(tree, 40, seed=2)
    points = ik.solve_batch(tree, np.ascontiguousarray(T[:, :, :3, 3]))
    assert points.success.all() and points.orientation_error is None and points.position_only
    mixed = ik.solve_batch(tree, {"left_tip": T[:, 0], "right_tip": T[:, 1, :3, 3]})
    assert mixed.success.all() and mixed.orientation_errors["right_tip"] is None
    assert mixed.orientation_errors["left_tip"].max() < 1e-6
    one = ik.solve_batch(tree, {"right_tip": T[:, 1]})
    assert one.success.all() and one.orientation_errors["left_tip"] is None
    for q, pose in zip(one.q, T[:, 1], strict=True):
        assert np.abs(tree.fk(q)["right_tip"].homogeneous - pose).max() < 3e-6


def test_none_frees_a_tip_as_it_does_in_a_single_solve(tree):
    T = reachable(tree, 5)
    without = ik.solve_batch(tree, {"left_tip": T[:, 0]})
    for targets in ({"left_tip": T[:, 0], "right_tip": None}, iter([{"left_tip": T[:, 0], "right_tip": None}])):
        assert ik.solve_batch(tree, targets).q.tobytes() == without.q.tobytes()


def test_collisions_and_objective_are_those_of_single_solves(tree):
    T = reachable(tree, 12, seed=4)
    options = {"avoid_collisions": True, "restarts": 16}
    many = ik.solve_batch(tree, T, **options)
    for k in range(len(T)):
        alone = ik.solve(tree, T[k], **options)
        assert alone.status == many.status[k] and alone.q.tobytes() == many.q[k].tobytes()
        assert alone.collision == many[k].collision


@pytest.mark.parametrize(
    ("targets", "error", "words"),
    [
        (np.zeros((4, 3, 3)), InvalidTarget, r"targets of left_tip, right_tip must be numbers of shape \(N, 2, 4, 4\)"),
        (np.zeros((2, 4, 4)), InvalidTarget, r"\(N, 2, 4, 4\)"),
        ({"left": np.zeros((2, 3))}, FrameNotFound, "Did you mean 'left_tip'"),
        ({}, InvalidTarget, "a dict of targets needs at least one of left_tip, right_tip"),
        (
            {"left_tip": np.zeros((2, 3)), "right_tip": np.zeros((3, 3))},
            InvalidTarget,
            "same number of targets, not left_tip 2, right_tip 3",
        ),
        ([{"left_tip": [0, 0, 0]}, {"left": [0, 0, 0]}], FrameNotFound, "Did you mean 'left_tip'"),
        (
            [{"left_tip": [0, 0, 0]}, {"right_tip": [0, 0, 0]}],
            InvalidTarget,
            "target 1 is of right_tip and target 0 of left_tip",
        ),
        (
            {"left_tip": np.zeros((2, 5))},
            InvalidTarget,
            r"left_tip: targets must be numbers of shape \(N, 4, 4\) or \(N, 3\)",
        ),
        ({"left_tip": np.full((2, 3), np.nan)}, InvalidTarget, "target 0 of left_tip"),
        ({"left_tip": None, "right_tip": None}, InvalidTarget, "at least one of"),
        ({"left_tip": [[0.0, 0.0, "up"]]}, InvalidTarget, "left_tip: targets must be"),
        (iter([{"left_tip": "up"}]), InvalidTarget, "left_tip: targets must be"),
    ],
)
def test_what_is_no_batch_is_refused_by_name(tree, targets, error, words):
    with pytest.raises(error, match=words):
        ik.solve_batch(tree, targets)


def test_the_kind_of_the_targets_may_not_change(tree):
    T = reachable(tree, 4)
    with pytest.raises(InvalidTarget, match="either poses or positions"):
        ik.solve_batch(tree, iter([T, T[:, :, :3, 3]]))


@pytest.mark.skipif(not robots.have_data(), reason="example-robot-data is not installed")
@pytest.mark.parametrize("name", ["baxter", "tiago_dual"])
def test_robots_of_the_library(name):
    tree = ik.Tree.load(name)
    assert ik.solve_batch(tree, reachable(tree, 200, seed=7), check=0.2).success.mean() > 0.99


def test_raw_errors_are_what_is_left_before_anything_is_left_out(tree):
    T = reachable(tree, 1, seed=8)[0]
    result = ik.solve(tree, T, slack={"left_tip": [0.05, 0.05, 0.05, 0.2, 0.2, 0.2]}, restarts=0, q0=tree.home)
    assert set(result.raw_errors) == set(TIPS)
    for k, (tip, raw) in enumerate(result.raw_errors.items()):
        at = tree.fk(result.q)[tip].homogeneous
        assert np.allclose(raw[:3], T[k, :3, 3] - at[:3, 3], atol=1e-12)
        assert np.allclose(raw[3:], pin.log3(T[k, :3, :3] @ at[:3, :3].T), atol=1e-9)
    assert np.isnan(ik.solve(tree, {"left_tip": T[0]}).raw_errors["right_tip"]).all()
    arm = tree.arms[0]
    one = ik.solve(arm, T[0], mask=[1, 1, 1, 0, 0, 0])
    assert one.success and np.linalg.norm(one.raw_error[:3]) < 1e-6 < np.linalg.norm(one.raw_error[3:])


def test_every_solution_of_several_tips(tree):
    T = reachable(tree, 1, seed=9)[0]
    q0 = tree.random_q(np.random.default_rng(10))
    found = ik.solve_all(tree, T, q0=q0, starts=200, count=20)
    assert 1 < len(found) <= 20 and not found.complete
    assert (np.diff(found.distance) >= 0.0).all()
    for q in found:
        assert (q >= tree.lower).all() and (q <= tree.upper).all()
        for tip, reached in tree.fk(q).items():
            assert np.abs(reached.homogeneous - T[TIPS.index(tip)]).max() < 3e-6
    apart = [np.abs(a - b).max() for k, a in enumerate(found.q) for b in found.q[:k]]
    assert min(apart) > 1e-3
    many = ik.Solver(tree).all(np.array([T, T]), starts=50)
    assert len(many) == 2 and np.array_equal(many[0].q, many[1].q)


def test_follow_bounds_the_move_of_every_joint(tree):
    rng = np.random.default_rng(11)
    for _ in range(20):
        q0 = tree.random_q(rng)
        near = np.clip(q0 + rng.uniform(-0.1, 0.1, tree.n), tree.lower, tree.upper)
        result = ik.solve(tree, tree.chain.forward(near)[0][0], q0=q0, follow=0.3)
        assert result.success and np.abs((result.q - q0) / tree.chain.unit).max() <= 0.3 + 1e-12
        far = ik.solve(tree, tree.chain.forward(tree.random_q(rng))[0][0], q0=q0, follow=0.05)
        assert np.abs((far.q - q0) / tree.chain.unit).max() <= 0.05 + 1e-12
        assert far.success or far.status in (
            ik.Status.TOO_FAR,
            ik.Status.ITERATION_LIMIT,
            ik.Status.LIMIT_BLOCKED,
            ik.Status.STALLED,
        )


def test_a_slide_that_turns_a_follower_of_one_arm_counts_as_turning():
    """The lift of `mixed` turns a joint of the right arm only; the left arm comes first."""
    tree = ik.Tree.load(trees.mixed(), tips=TIPS)
    lift = tree.joint_names.index("lift")
    right = tree.arms[1]
    assert tree.joint_kinds[lift] == right.joint_kinds[right.joint_names.index("lift")] != "prismatic"
    target = tree.fk(tree.home)["right_tip"].translation + np.array([0.0, 0.0, 9.0])
    weights = np.zeros(tree.n)
    weights[lift] = 1.0
    given = {"q0": tree.home, "follow": 0.05, "joint_weights": weights, "slack": [9.0, 9.0, 0.0, 0.0, 0.0, 0.0]}
    result = ik.solve(tree, {"right_tip": target}, limits=False, **given)
    assert result.status == ik.Status.TOO_FAR and "lift reached the 0.05 rad it may move" in result.message
    assert abs(result.q[lift] - tree.home[lift]) == pytest.approx(0.05)


def test_closest_is_the_nearest_of_what_is_found(tree):
    rng = np.random.default_rng(12)
    nearer = 0
    for _ in range(10):
        T, q0 = reachable(tree, 1, seed=int(rng.integers(1 << 30)))[0], tree.random_q(rng)
        close, any_one = ik.solve(tree, T, closest=q0), ik.solve(tree, T, q0=q0)
        away = [np.linalg.norm((r.q - q0) / tree.chain.unit) for r in (close, any_one)]
        assert close.success and away[0] <= away[1] + 1e-9
        nearer += away[0] < away[1] - 1e-3
    assert nearer > 0


def test_a_row_of_a_batch_keeps_no_targets(tree):
    found = ik.solve_batch(tree, np.array([tree.chain.forward(tree.home)[0][0]]))
    raw = found[0].raw_errors
    assert set(raw) == set(TIPS) and all(one.shape == (6,) and np.isnan(one).all() for one in raw.values())
