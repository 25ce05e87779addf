"""The bound between poses against dense sampling: never exceeded, on robots with every kind of joint."""

import functools

import numpy as np
import pinocchio as pin
import pytest
import robots
import trees
from motions import followed, moved, plan_for, tips
from serial_arms import drawn

import ik_toolkit as ik
from ik_toolkit.kernel.counted_error import AXIS, KIND
from ik_toolkit.paths.continuity import bounds, check, densify, interpolate_poses
from ik_toolkit.solvers.task import all_errors

STRETCHES, SAMPLES = 5, 25
COUNTS = {
    "pose": {},
    "position": {},
    "free turn": {"free_turn": (0.0, 0.6, 0.8)},
    "axis": {},
    "mask in the base": {"mask": (1.0, 0.0, 0.5, 1.0, 1.0, 1.0)},
    "mask in the tip": {"mask": (1.0, 1.0, 0.0, 1.0, 1.0, 1.0), "frame": "tip"},
    "mask in the target": {"mask": (1.0, 0.0, 1.0, 1.0, 0.0, 1.0), "frame": "target"},
    "slack": {"slack": (0.0, 0.0, 0.02, 0.0, 0.1, 0.0), "frame": "target"},
}


@functools.cache
def loaded(name):
    if name in ("continuous", "mimic"):
        return ik.Robot.load(
            robots.CONTINUOUS if name == "continuous" else trees.mixed(),
            tip=None if name == "continuous" else "left_tip",
        )
    if name == "two arms":
        return ik.Tree.load(trees.mixed(), tips=["left_tip", "right_tip"])
    return ik.Robot.load(name)


def kinds_of(robot, what):
    kind = {"position": KIND.position, "axis": (AXIS, (0.0, 0.0, 1.0))}.get(what, KIND.pose)
    return (kind,) * len(robot.tips)


def free_part(T, what, rng):
    """A target that the pose T (4, 4) meets as far as it counts."""
    T = T.copy()
    if what in ("free turn", "axis"):
        axis = np.array([0.0, 0.6, 0.8] if what == "free turn" else [0.0, 0.0, 1.0])
        T[:3, :3] = T[:3, :3] @ pin.exp3(rng.uniform(-1.0, 1.0) * axis)
    elif what == "position":
        T[:3, :3] = pin.exp3(rng.uniform(-2.0, 2.0, 3))
    elif what == "mask in the base":
        T[1, 3] += rng.uniform(-0.1, 0.1)
    elif what == "mask in the tip":
        T[:3, 3] += T[:3, 2] * rng.uniform(-0.1, 0.1)
    elif what == "mask in the target":
        T[:3, :3] = T[:3, :3] @ pin.exp3(np.array([0.0, rng.uniform(-0.3, 0.3), 0.0]))
        T[:3, 3] += T[:3, 1] * rng.uniform(-0.1, 0.1)
    elif what == "slack":
        T[:3, :3] = T[:3, :3] @ pin.exp3(np.array([0.0, rng.uniform(-0.1, 0.1), 0.0]))
        T[:3, 3] += T[:3, 2] * rng.uniform(-0.02, 0.02)
    return T


def sampled(robot, plan, kinds, a, b, T):
    """Largest counted errors [m], [rad] of the tips between two configurations."""
    worst = [0.0, 0.0]
    for share in np.linspace(0.0, 1.0, SAMPLES):
        goal = interpolate_poses(T, np.array([share]), kinds)[0]
        for _, position, angle in all_errors(robot, a + share * (b - a), goal, kinds, plan.options):
            worst = [max(worst[0], position), max(worst[1], angle or 0.0)]
    return worst


@pytest.mark.parametrize("what", COUNTS)
@pytest.mark.parametrize("name", ["hydrolek_7w", "continuous", "mimic", "planar_3r", "two arms"])
def test_no_sample_between_two_poses_leaves_the_bound(name, what):
    robot = loaded(name)
    plan, kinds = plan_for(robot, **COUNTS[what]), kinds_of(robot, what)
    rng = np.random.default_rng([7, len(name), len(what)])
    for size in rng.choice([0.02, 0.1, 0.4], STRETCHES):
        a = robot.random_q(rng)
        b = np.clip(a + rng.uniform(-size, size, robot.n), robot.lower, robot.upper)
        T = np.array([[free_part(pose, what, rng) for pose in row] for row in tips(robot, (a, b))])
        deviation, turn = bounds(plan, kinds, np.array([a, b]), np.arange(2.0), T)
        position, angle = sampled(robot, plan, kinds, a, b, T)
        assert position <= deviation[0] + 1e-9
        assert angle <= turn[0] + 1e-7


def test_the_bounds_of_a_motion_are_those_of_its_segments():
    robot = loaded("hydrolek_7w")
    plan, kinds, rng = plan_for(robot), (KIND.pose,), np.random.default_rng(2)
    Q = robot.home + np.cumsum(rng.uniform(-0.1, 0.1, (6, robot.n)), axis=0)
    T = np.array([[robot.fk(q).homogeneous] for q in Q])
    apart = [bounds(plan, kinds, Q[k : k + 2], np.arange(2.0), T[k : k + 2]) for k in range(5)]
    np.testing.assert_allclose(bounds(plan, kinds, Q, np.arange(6.0), T), np.hstack(apart), rtol=1e-9)


def test_no_sample_of_a_tip_carried_by_another_leaves_the_bound():
    tree = loaded("two arms")
    plan, kinds = plan_for(tree, relative_to={"right_tip": "left_tip"}), kinds_of(tree, "pose")
    rng = np.random.default_rng(5)
    for size in rng.choice([0.02, 0.1, 0.4], STRETCHES):
        a = tree.random_q(rng)
        b = np.clip(a + rng.uniform(-size, size, tree.n), tree.lower, tree.upper)
        T = []
        for q in (a, b):
            left, right = tree.fk(q).values()
            T.append([left.homogeneous, left.actInv(right).homogeneous])
        deviation, turn = bounds(plan, kinds, np.array([a, b]), np.arange(2.0), np.array(T))
        position, angle = sampled(tree, plan, kinds, a, b, np.array(T))
        assert position <= deviation[0] + 1e-9
        assert angle <= turn[0] + 1e-7


def test_the_bound_is_near_what_is_found():
    """A bound that is far off would split paths for nothing: over poses it is within three times, in the middle of many."""
    robot = loaded("hydrolek_7w")
    plan, rng = plan_for(robot), np.random.default_rng(3)
    ratios = []
    for _ in range(30):
        a = robot.random_q(rng)
        b = np.clip(a + rng.uniform(-0.05, 0.05, robot.n), robot.lower, robot.upper)
        T = np.array([[robot.fk(q).homogeneous] for q in (a, b)])
        deviation, _ = bounds(plan, (KIND.pose,), np.array([a, b]), np.arange(2.0), T)
        ratios.append((deviation[0] - plan.options.position_tolerance) / sampled(robot, plan, (KIND.pose,), a, b, T)[0])
    assert np.median(ratios) < 3.0


@pytest.mark.parametrize("what", COUNTS)
def test_where_nothing_moves_the_bound_is_the_tolerance(what):
    robot = loaded("hydrolek_7w")
    plan, kinds = plan_for(robot, **COUNTS[what]), kinds_of(robot, what)
    T = np.array([[robot.fk(robot.home).homogeneous]] * 2)
    deviation, turn = bounds(plan, kinds, np.array([robot.home] * 2), np.arange(2.0), T)
    assert deviation[0] == pytest.approx(plan.options.position_tolerance)
    assert turn[0] == pytest.approx(plan.options.orientation_tolerance if what != "position" else 0.0)


def test_poses_are_inserted_until_steps_and_bounds_hold():
    robot = loaded("hydrolek_7w")
    plan = plan_for(robot)
    T = moved(robot.fk(robot.home).homogeneous, np.outer(np.linspace(0.0, -0.15, 4), [0.0, 0.0, 1.0]))[:, None]
    q = followed(plan, KIND.pose, T)
    step, tolerance = (np.radians(1.0), 0.02), (2e-5, np.radians(0.05))
    curve, at, cut = densify(plan, (KIND.pose,), q, T, [1], step, tolerance)
    assert cut.sum() == 1 and at[np.flatnonzero(cut)[0]] == 1.0  # nothing is inserted where the motion breaks
    np.testing.assert_array_equal(curve[at == np.round(at)], q)
    moves = np.abs(np.diff(curve, axis=0))[~cut]
    assert len(curve) > 10 and moves.max() <= step[0] * (1.0 + 1e-6)
    proof = check(plan, (KIND.pose,), curve, at, T, cut)
    assert proof.largest[0] <= tolerance[0] and proof.largest[1] <= tolerance[1]
    assert np.isnan(proof.deviation[cut]).all()
    for row, place in zip(curve, at, strict=True):
        position, angle = robot.errors(row, interpolate_poses(T, np.array([place]), (KIND.pose,))[0, 0])
        assert position <= 1e-6 and angle <= 1e-6


def test_a_stretch_that_no_motion_follows_stays_and_says_so():
    """Two branches of a planar arm meet the same poses; between them no joint motion stays on the path."""
    robot = ik.Robot.load("planar_3r")
    plan = plan_for(robot)
    q = np.array([[0.5, 0.9, 0.0], [0.5, -0.9, 0.0]])
    T = np.array([[robot.fk(row).homogeneous] for row in q])
    T[1, 0] = T[0, 0]
    curve, at, cut = densify(plan, (KIND.position,), q, T, [], (0.12, 0.02), (1e-3, 0.02))
    assert len(curve) == 2 and not cut.any()
    assert check(plan, (KIND.position,), curve, at, T, cut).largest[0] > 1e-3


def test_a_joint_that_leaps_by_more_than_a_turn_is_a_reconfiguration():
    """The bound between its two rows is half a turn (and no product of zero and infinity, which pytest makes an error)."""
    robot = drawn([("revolute", (0, 0, 0), (0, 0, 0), (0, 0, 1), -3.3, 3.3)], (0, 0, 0))
    made = ik.solve_path(robot, [robot.fk([-3.2]), robot.fk([3.2])], q0=[-3.2], q_end=[3.2])
    assert made.status.name == "RECONFIGURES" and made.q.ravel() == pytest.approx([-3.2, 3.2])
