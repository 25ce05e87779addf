"""Preferences: each has a test that fails if the preference is ignored."""

import tracemalloc

import numpy as np
import pinocchio as pin
import pytest
import robots

import ik_toolkit as ik


def manipulability(robot, q):
    J = robot.jacobian(q)
    return np.sqrt(np.linalg.det(J @ J.T))


def mid_range(robot, q):
    span = robot.upper - robot.lower
    return 0.5 * np.sum(((q - 0.5 * (robot.lower + robot.upper)) / span) ** 2)


def null_step(robot, q, size):
    """q moved along the self-motion of a 7-joint arm by about `size`, and brought back onto the pose."""
    direction = np.linalg.svd(robot.jacobian(q))[2][-1]
    moved = ik.solve(robot, robot.fk(q), "dls", q0=q + size * direction, tolerance=1e-10)
    return moved.q if moved.success else None


@pytest.mark.parametrize(
    ("objective", "cost"), [("mid-range", mid_range), ("manipulability", lambda r, q: -np.log(manipulability(r, q)))]
)
def test_objectives_reach_a_minimum_of_the_self_motion(objective, cost):
    robot = robots.load("inspection_7dof")
    _, T = robots.sample(robot, 12, seed=31)
    better, still = 0, 0
    for target in T:
        plain = ik.solve(robot, target, "lm")
        result = ik.solve(robot, target, "lm", objective=objective)
        assert result.success and robot.outside(result.q) == []
        assert robot.errors(result.q, target)[0] <= 1e-6
        before, after = cost(robot, plain.q), cost(robot, result.q)
        assert after <= before + 1e-9
        better += after < before - 1e-3
        if not result.limited_joints:
            for size in (-0.02, 0.02):
                other = null_step(robot, result.q, size)
                if other is not None and robot.outside(other) == []:
                    assert cost(robot, other) > after - 1e-5
                    still += 1
    assert better >= 8 and still >= 6


@pytest.mark.parametrize(
    ("robot", "options"),
    [(robots.few_joints(6, 2), {}), ("inspection_7dof", {}), ("so101", {"free_turn": "z"}), ("panda", {})],
)
def test_an_answer_near_a_reference_is_no_farther_than_one_without(robot, options):
    """Whichever solver 'auto' takes for the robot: the elimination, a closed form or the search."""
    robot = robots.load(robot) if isinstance(robot, str) else robot
    Q = robot.random_q(np.random.default_rng(1), 60)
    for q, q0 in zip(Q[::2], Q[1::2], strict=True):
        plain, near = (ik.solve(robot, robot.fk(q), q0=q0, objective=what, **options) for what in (None, "reference"))
        far = [np.linalg.norm((one.q - q0) / robot.chain.unit) for one in (plain, near)]
        assert near.status is plain.status and (not plain.success or far[1] <= far[0] * (1.0 + 1e-12))


@pytest.mark.parametrize(
    ("name", "rows", "weights"),
    [("planar_3r", 2, (0.2, 1.0, 5.0)), ("inspection_7dof", 6, (1.0, 0.3, 2.0, 1.0, 0.5, 1.0, 4.0))],
)
def test_reference_objective_ends_where_no_self_motion_is_nearer(name, rows, weights):
    """At the end the gradient of the weighted distance has no part along the self-motion, unless a limit is in the way."""
    robot, seen = robots.load(name), 0
    for q in robots.sample(robot, 40, seed=34)[0]:
        q0 = 0.5 * (q + robot.home)
        target = robot.fk(q).translation if rows < 6 else robot.fk(q)
        found = ik.solve(robot, target, "lm", q0=q0, objective="reference", joint_weights=weights)
        if found.success and not found.limited_joints:
            J = robot.jacobian(found.q)[:rows] * robot.chain.unit
            along = np.linalg.svd(J)[2][-1]  # the direction of the self-motion
            assert abs(along @ ((found.q - q0) / robot.chain.unit / weights)) < 1e-3
            seen += 1
    assert seen > 10


def test_closest_is_nearest_among_all_branches():
    robot = robots.load("locked")  # six joints: isolated solutions, all known from the closed form
    Q, T = robots.sample(robot, 40, seed=33)
    rng = np.random.default_rng(0)
    nearest, ignored, moved = 0, 0, 0
    for target in T:
        every = ik.solve_all(robot, target)
        reference = robot.random_q(rng)
        best = min(np.linalg.norm(q - reference) for q in every)
        found = ik.solve(robot, target, "lm", closest=reference)
        assert found.success
        nearest += np.linalg.norm(found.q - reference) < best + 1e-3
        ignored += np.linalg.norm(ik.solve(robot, target, "lm").q - reference) < best + 1e-3
        home, near, plain = (ik.solve(robot, target, "lm", closest=to).q for to in (robot.home, True, False))
        assert np.allclose(near, home, atol=1e-9)
        moved += np.abs(plain - home).max() > 0.1
    assert nearest >= 36 and moved > 5
    assert ignored < nearest - 5


def test_closest_keeps_a_solved_reference():
    robot = robots.load("hydrolek_7w")
    q = robot.random_q(np.random.default_rng(3))
    result = ik.solve(robot, robot.fk(q), closest=q)
    assert np.allclose(result.q, q, atol=1e-6)


@pytest.mark.parametrize("name", ["hydrolek_7w", "inspection_7dof", "slides_mix"])
@pytest.mark.parametrize("solver", ["lm", "dls", "transpose"])
def test_axis_targets_leave_the_turn_free(name, solver):
    robot = robots.load(name)
    rng = np.random.default_rng(8)
    axis = np.array([0.3, -0.5, 0.8])
    turned, tried = 0, 0
    for _ in range(8):
        q = robot.random_q(rng)
        T = robot.fk(q)
        target = ik.pose(T.translation, axis=axis, direction=T.rotation @ axis)
        result = ik.solve(robot, target, solver, q0=np.clip(q + 0.1, robot.lower, robot.upper), tolerance=1e-5)
        if solver == "lm":
            assert result.success
        if result.success:
            at = robot.fk(result.q)
            assert np.linalg.norm(at.translation - T.translation) <= 1e-5
            unit = axis / np.linalg.norm(axis)
            assert np.arccos(min(1.0, unit @ at.rotation.T @ T.rotation @ unit)) <= 1.1e-5
            turned += np.linalg.norm(pin.log3(at.rotation.T @ T.rotation)) > 1e-3
            tried += 1
    assert tried >= 4 and turned >= tried // 2  # a full-pose solver would not have turned


def test_ever_new_axes_do_not_fill_the_memory():
    """A bound solver keeps what it prepared for a kind of target, and every axis is a kind of its own."""
    robot = robots.load("hydrolek_7w")
    solver, T = ik.Solver(robot, "lm"), robot.fk(robot.home)

    def solve_some(count, rng):
        for axis in rng.normal(size=(count, 3)):
            assert solver(ik.pose(T.translation, axis=axis, direction=T.rotation @ axis), robot.home).success

    solve_some(100, np.random.default_rng(1))
    tracemalloc.start()
    try:
        solve_some(500, np.random.default_rng(2))
        grown, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert grown < 150_000  # 64 kinds kept at about 1 kB each; 500 of them were over 400 kB


def test_opposite_axis_is_left():
    robot = robots.load("hydrolek_7w")
    T = robot.fk(robot.home)
    target = ik.pose(T.translation, direction=-T.rotation[:, 2])
    result = ik.solve(robot, target, "dls", q0=robot.home, limits=False, max_iterations=200)
    assert result.iterations > 0 and result.orientation_error < 3.0


@pytest.mark.parametrize("mask", [(1, 1, 1, 0, 0, 0), (1, 1, 0, 0, 0, 1), (0, 0, 0, 1, 1, 1), (1, 0, 1, 1, 0, 1)])
@pytest.mark.parametrize("frame", ["base", "tip"])
def test_masks_count_only_what_they_name(mask, frame):
    robot = robots.load("inspection_7dof")
    _, T = robots.sample(robot, 10, seed=34)
    free = 0
    for target in T:
        result = ik.solve(robot, target, mask=mask, frame=frame)
        assert result.success
        at = robot.fk(result.q)
        R = np.eye(3) if frame == "base" else at.rotation.T
        e = np.concatenate([R @ (target[:3, 3] - at.translation), R @ pin.log3(target[:3, :3] @ at.rotation.T)])
        w = np.array(mask)
        assert np.linalg.norm((w * e)[:3]) <= 1e-6 and np.linalg.norm((w * e)[3:]) <= 1e-6
        free += np.abs((1 - w) * e).max() > 1e-3
    assert free >= 8


def test_weights_of_a_mask_scale_the_error():
    robot = robots.load("hydrolek_7w")
    T = robot.fk(robot.home + 0.1).homogeneous
    loose = ik.solve(robot, T, "lm", mask=(1e-3, 1e-3, 1e-3, 0, 0, 0), q0=robot.home, tolerance=1e-5)
    assert loose.success
    assert 1e-5 < np.linalg.norm(robot.fk(loose.q).translation - T[:3, 3]) <= 1.01e-2


def test_joint_weights_share_the_motion():
    robot = robots.load("inspection_7dof")
    q = robot.home.copy()
    target = robot.fk(q + 0.05)
    free = ik.solve(robot, target, "lm", q0=q, restarts=0)
    heavy = ik.solve(robot, target, "lm", q0=q, restarts=0, joint_weights=(1, 1e-6, 1, 1, 1, 1, 1))
    assert heavy.success and free.success
    assert abs(heavy.q[1] - q[1]) < 0.01 * abs(free.q[1] - q[1]) + 1e-9
