"""Arms with fewer joints than a pose has directions: their own motions are followed, and what needs a jump is still found out."""

import numpy as np
import pinocchio as pin
import pytest
from motions import between, moved
from robots import few_joints, have_data, urdf

import ik_toolkit as ik
from ik_toolkit.kernel.counted_error import KIND
from ik_toolkit.motion.reference import interpolate_poses
from ik_toolkit.paths.result import PathStatus

POSES = 15


def drawn(robot, gap, seed):
    """A straight motion of the joints (POSES, n), the fastest of which moves by `gap` a step, and its poses."""
    rng = np.random.default_rng(seed)
    way = rng.normal(size=robot.n)
    Q = rng.uniform(-0.7, 0.7, robot.n) + np.arange(POSES)[:, None] * gap * way / np.abs(way).max()
    return Q, np.array([robot.fk(q).homogeneous for q in Q])


@pytest.mark.parametrize("slides", [False, True])
@pytest.mark.parametrize("count", [1, 2, 3, 4, 5])
def test_full_poses_that_the_arm_draws_itself_are_one_motion(count, slides):
    robot = few_joints(count, 20 + count, slides)
    for gap in (0.016, 0.1):
        Q, T = drawn(robot, gap, count)
        made = ik.solve_path(robot, T)
        assert made.status is PathStatus.FOLLOWED and not made.reconfigurations and made.lower_bound == 0
        assert np.abs(made.q - Q).max() < 1e-5  # the solutions of these arms are isolated
        assert made.position_error.max() <= 1e-6 and made.orientation_error.max() <= 1e-6
        step = np.abs(np.diff(made.curve, axis=0)) / np.where(robot.slides, made.max_step[1], made.max_step[0])
        assert step.max() <= 1.0 + 1e-9
        ordered = ik.solve_path(robot, T, priority="position")  # every level can be met, so none is given up
        assert ordered.success and np.abs(ordered.q - Q).max() < 1e-5 and "priority" not in ordered.message
        if gap < 0.1:
            assert made.deviation[0] < made.path_tolerance[0] and made.deviation[1] < made.path_tolerance[1]


def test_the_distance_from_the_interpolated_poses_is_bounded_and_told_apart():
    """Five joints, poses 0.1 rad apart: sampled finely, no error is above its bound, nor what is left beyond what is lacking."""
    robot = few_joints(5, 25)
    _, T = drawn(robot, 0.1, 5)
    made = ik.solve_path(robot, T)
    proof = made.continuity
    assert proof.lacking.max() > 0.0 and (proof.judged[0] <= made.path_tolerance[0]).all()
    assert (proof.judged[1] <= made.path_tolerance[1]).all()
    for k in range(len(made.curve) - 1):
        places = made.at[k] + np.linspace(0.0, 1.0, 5) * (made.at[k + 1] - made.at[k])
        goals = interpolate_poses(T[:, None], places, (KIND.pose,))[:, 0]
        rows = np.linspace(made.curve[k], made.curve[k + 1], 5)
        errors = np.array([robot.errors(q, goal) for q, goal in zip(rows, goals, strict=True)])
        assert errors[:, 0].max() <= proof.deviation[k] and errors[:, 1].max() <= proof.turn[k]


@pytest.mark.parametrize("count", [1, 2])
def test_positions_that_the_arm_draws_itself_are_one_motion(count):
    robot = few_joints(count, 20 + count)
    Q, T = drawn(robot, 0.05, count)
    made = ik.solve_path(robot, T[:, :3, 3])
    assert made.status is PathStatus.FOLLOWED and np.abs(made.q - Q).max() < 1e-5


def test_a_pose_before_one_that_is_not_reached_stays_in_the_motion():
    robot = few_joints(2, 22)
    T = drawn(robot, 0.2, 2)[1][:9]  # rows are inserted between them
    T[4, :3, 3] += 9.0
    made = ik.solve_path(robot, T)
    at_poses = made.curve[made.at == np.round(made.at)]
    assert np.isnan(made.q[:, 0]).sum() == 1 and np.array_equal(at_poses, made.q, equal_nan=True)
    assert [made.at[piece][[0, -1]].tolist() for piece in made.pieces] == [[0.0, 3.0], [5.0, 8.0]]


@pytest.mark.skipif(not have_data(), reason="needs example-robot-data")
def test_a_hobby_arm_follows_its_own_motion():
    robot = ik.Robot.load("so101")
    Q = np.linspace(0.3 * robot.lower, 0.2 * robot.upper, 40)
    made = ik.solve_path(robot, np.array([robot.fk(q).homogeneous for q in Q]))
    assert made.status is PathStatus.FOLLOWED and np.abs(made.q - Q).max() < 1e-5


def test_what_needs_a_jump_is_found_out():
    """A pan and three parallel joints: the wrist allows the elbow up at the first poses only, and the elbow down at the last."""
    joints = [dict(kind="revolute", axis="0 0 1"), dict(kind="revolute", axis="0 1 0", xyz="0 0 0.2")]
    joints += [dict(kind="revolute", axis="0 1 0", xyz="0 0 0.3")] * 2
    robot = ik.Robot.load(urdf(*joints, dict(kind="fixed", xyz="0.1 0 0.1")))
    T = between(robot, [0.1, 0.0, 1.0, -0.5], [0.3, 0.9, 1.0, -0.9], 31)
    limits = {"j3": (-0.77, 0.31)}  # with the elbow up it turns from -0.5 to -0.9, with the elbow down from 0.5 to 0.1
    assert ik.solve_path(robot, T).status is PathStatus.FOLLOWED
    made = ik.solve_path(robot, T, limits=limits)
    assert made.status is PathStatus.RECONFIGURES and len(made.reconfigurations) == 1
    assert 14 <= made.reconfigurations[0].index <= 20
    assert made.lower_bound in (None, 0, 1) and np.abs(made.reconfigurations[0].move[2]) > 1.5
    assert not any(made.robot.outside(q) for q in made.curve)
    none = ik.solve_path(robot, T, limits=limits, reconfigurations="none")
    assert none.status is PathStatus.INCOMPLETE and 15 <= np.isfinite(none.q[:, 0]).sum() <= 21


def test_two_hands_follow_with_a_priority_and_keep_what_they_hold():
    tree = ik.Tree.load("brokk_hydrolek")
    (left, right), home = tree.tips, tree.fk(tree.home)
    held = home[left].actInv(home[right]).homogeneous
    T = moved(home[left].homogeneous, np.outer(np.linspace(0.0, 1.0, 8), [0.05, 0.1, 0.1]))
    T[:, :3, :3] = [
        pin.exp3(np.array([0.0, 0.0, turn])) @ one[:3, :3]
        for turn, one in zip(np.linspace(0.0, 0.3, 8), T, strict=True)
    ]
    poses = [{left: one, right: held} for one in T]
    options = dict(q0=tree.home, relative_to={right: left})
    assert not ik.solve_path(tree, poses, **options).success
    path = ik.solve_path(tree, poses, priority=[right, left], **options)
    assert path.status == PathStatus.FOLLOWED
    for q in path.q:
        now = tree.fk(q)
        np.testing.assert_allclose(now[left].actInv(now[right]).homogeneous, held, atol=2e-6)


@pytest.mark.parametrize("options", [{"mask": (1, 1, 1, 1, 1, 0), "frame": "tip"}, {"free_turn": "z"}])
@pytest.mark.parametrize("name", ["palletizer", "hydrolek_7w"])
def test_what_a_target_leaves_free_leads_to_no_lesser_pose(name, options):
    """Each pose of a path with a priority is a minimum: from there a single solve comes no nearer."""
    robot, rng = ik.Robot.load(name), np.random.default_rng(0)
    a = 0.6 * robot.random_q(rng) + 0.4 * robot.home
    b = 0.5 * (a + robot.random_q(rng))
    T = between(robot, a, b, 12)
    T[:, :3, :3] = pin.exp3(rng.uniform(-0.4, 0.4, 3)) @ T[:, :3, :3]
    path = ik.solve_path(robot, T, priority="position", **options)
    assert path.status == PathStatus.FOLLOWED and path.position_error.max() < 2e-6
    for q, one, error in zip(path.q, T, path.orientation_error, strict=True):
        single = ik.solve(robot, one, q0=q, restarts=0, priority="position", **options)
        assert single.success and error < 1.01 * single.orientation_error + 1e-4


@pytest.mark.parametrize(("seed", "off"), [(1, True), (8, False), (11, False)])
def test_poses_that_are_reached_to_their_tolerance_are_not_said_to_be_missed(seed, off):
    robot = ik.Robot.load("hydrolek_7w")
    T = [robot.fk(q) for q in robot.random_q(np.random.default_rng(seed), 2)]
    made = ik.solve_path(robot, T, priority="position")
    missed = max(*made.position_error, *made.orientation_error) > 1e-6
    assert made.success and missed == off == ("off the poses asked for" in made.message)


@pytest.mark.skipif(not have_data(), reason="needs example-robot-data")
def test_poses_that_are_nearest_at_a_singular_pose_are_kept():
    """There Newton's steps from a solution in tolerance, stored in single precision, ended 8 micrometres off."""
    robot, rng = ik.Robot.load("panda"), np.random.default_rng(1)
    a = 0.6 * robot.random_q(rng) + 0.4 * robot.home
    b = a + 0.5 * (robot.random_q(rng) - a)
    T = between(robot, a, b, 12)
    T[:, :3, :3] = pin.exp3(rng.uniform(-0.4, 0.4, 3)) @ T[:, :3, :3]
    path = ik.solve_path(robot, T, q0=a, priority="position")
    away = [robot.fk(q).translation - one[0, :3, 3] for q, one in zip(path.q, path.targets, strict=True)]
    assert path.status == PathStatus.FOLLOWED and np.linalg.norm(away, axis=1).max() < 1.001e-6
