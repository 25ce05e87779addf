"""The public solve call: defaults, options, messages, singular and unreachable targets."""

import math
import threading

import numpy as np
import pytest
import robots
from hypothesis import given, settings
from hypothesis import strategies as st

import ik_toolkit as ik
from ik_toolkit import errors
from ik_toolkit.robot.pose import AxisTarget

WELL_KNOWN = ["panda", "ur5", "kinova"] if robots.have_data() else []


@pytest.mark.parametrize(
    "name", ["hydrolek_7w", "inspection_7dof", "continuous_mix", "mimic_mix", "slides_mix", *WELL_KNOWN]
)
def test_lm_solves_nearly_every_reachable_pose_from_nothing(name):
    robot = robots.load(name)
    _, T = robots.sample(robot, 2000, seed=21)
    batch = ik.solve_batch(robot, T, "lm")
    assert batch.success.mean() >= 0.999
    assert (batch.q >= robot.lower).all() and (batch.q <= robot.upper).all()
    for k in range(0, 2000, 50):
        position, orientation = robot.errors(batch.q[k], T[k])
        assert not batch.success[k] or (position <= 1e-6 and orientation <= 1e-6)


def test_names_classes_and_instances_mean_the_same():
    robot = robots.load("hydrolek_7w")
    T = robot.fk(robot.home + 0.05)
    by_name = ik.solve(robot, T, "dls", damping=0.1)
    assert by_name.q.tobytes() == ik.solve(robot, T, ik.DLS(damping=0.1)).q.tobytes()
    assert by_name.q.tobytes() == ik.solve(robot, T, ik.DLS, damping=0.1).q.tobytes()
    assert by_name.q.tobytes() != ik.solve(robot, T, "dls", damping=0.5).q.tobytes()


def test_a_solver_may_solve_while_it_is_bound():
    class Careful(ik.LM):
        def loop(self, robot):
            assert ik.solve(robot, (0.9, 0.9, 0.0)).success and ik.solve_batch(robot, [(0.9, 0.9, 0.0)]).success.all()
            return ik.LM(*self).loop(robot)

    robot, found = ik.Robot.load("planar_2r"), []
    for call in (ik.solve, lambda *given: ik.solve_batch(given[0], [given[1]], given[2])[0]):
        for _ in range(2):  # The second call takes the solver that the first has made.
            work = threading.Thread(
                target=lambda call=call: found.append(call(robot, (1.0, 1.0, 0.0), Careful())), daemon=True
            )
            work.start()
            work.join(60.0)
    assert len(found) == 4 and all(result.success for result in found)


def test_the_first_argument_is_a_robot():
    with pytest.raises(errors.InvalidOption, match="Robot"):
        ik.solve("hydrolek_7w", (1, 0, 0))
    with pytest.raises(errors.InvalidOption, match="Robot"):
        ik.Solver("hydrolek_7w", "lm")


@pytest.mark.parametrize("name", ["cartesian_pp", "slides_mix"])
def test_without_limits_a_slide_has_no_reach_bound(name):
    robot = robots.load(name)
    q = robot.upper + 0.7 * robot.reach
    result = ik.solve(robot, robot.fk(q).translation, "lm", q0=q - 0.01, limits=False)
    assert result.success
    assert not ik.solve(robot, robot.fk(q).translation, "lm", q0=robot.upper).success
    assert ik.solve(robots.load("planar_2r"), (3.0, 0.0, 0.0), "lm", limits=False).status == ik.Status.UNREACHABLE


@pytest.mark.parametrize("digits", [6, 7, 8])
def test_a_rotation_of_few_digits_is_no_reason_to_fail_the_check(digits):
    robot, rng = robots.load("hydrolek_7w"), np.random.default_rng(5)
    targets = np.array([robot.fk(robot.random_q(rng)).homogeneous for _ in range(20)])
    targets[:, :3, :3] = targets[:, :3, :3].round(digits)
    given = targets.copy()
    results = [ik.solve(robot, T, tolerance=1e-9) for T in targets]
    assert [result.status.name for result in results] == ["CONVERGED"] * 20
    many = ik.solve_batch(robot, targets, tolerance=1e-9, check=1.0)
    assert many.success.all() and np.array_equal(targets, given)


def test_a_start_beyond_all_digits_is_refused():
    robot = robots.load("continuous_mix")  # whose continuous joints no limit clamps
    T, q0 = robot.fk(robot.home).homogeneous, np.full(robot.n, 1e16)
    for call in (ik.solve, ik.Solver(robot, "lm"), ik.solve_batch, ik.solve_all):
        arguments = (T,) if isinstance(call, ik.Solver) else (robot, T[None] if call is ik.solve_batch else T)
        with pytest.raises(errors.InvalidConfiguration, match="too large a number"):
            call(*arguments, q0=q0)
    assert ik.solve(robot, T, q0=1e8 * np.ones(robot.n)).success


def test_singular_planar_arm():
    """A straight planar 3R asked for a point on its own line: J'e = 0, so Jacobian methods stand still (Burrell 2016, 6.4)."""
    robot = robots.load("planar_3r")
    straight, target = np.zeros(3), np.array([5.0, 0.0, 0.0])
    for name in ("transpose", "pinv", "dls"):
        result = ik.solve(robot, target, name, q0=straight)
        assert result.status in (ik.Status.SINGULAR, ik.Status.STALLED)
        assert (result.q == 0).all() and "J'e = 0" in result.message
    assert ik.solve(robot, target, "lm", q0=straight).success


@pytest.mark.parametrize("angle", [math.pi, math.pi - 1e-9, math.pi - 1e-3])
def test_half_a_turn_away(angle):
    robot = robots.load("slides_mix")
    rng = np.random.default_rng(0)
    for _ in range(10):
        q = robot.random_q(rng)
        T = robot.fk(q).homogeneous
        T[:3, :3] = T[:3, :3] @ ik.pose(rpy=(angle, 0, 0))[:3, :3]
        for name in ("lm", "dls", "transpose", "pinv"):
            result = ik.solve(robot, T, name, q0=q)
            position, orientation = robot.errors(result.q, T)
            assert result.success == (position <= 1e-6 and orientation <= 1e-6)
            if name == "lm":
                assert result.iterations > 0


def test_endless_joints_come_back_at_the_turn_nearest_q0():
    robot = robots.load("continuous_mix")
    q = robot.random_q(np.random.default_rng(0))
    q0 = q.copy()
    turns = np.array([3, 0, -2, 0, 1000, 0]) * 2 * np.pi
    result = ik.solve(robot, robot.fk(q), "lm", q0=q0 + turns + 0.02)
    assert result.success
    assert np.abs(result.q - (q + turns)).max() < 0.1


@pytest.mark.parametrize("solver", ["lm", "dls", "pid", "state-space"])
def test_a_held_joint_stays_in_every_start(solver):
    robot, rng, again = robots.load("inspection_7dof"), np.random.default_rng(3), 0
    weights = (1, 0, 1, 1, 1, 1, 0)
    Q, Q0 = (np.array([robot.random_q(rng) for _ in range(8)]) for _ in range(2))
    Q[:, [1, 6]] = Q0[:, [1, 6]]
    targets = np.array([robot.fk(q).translation for q in Q])
    options = dict(joint_weights=weights, restarts=20)
    for q0, target in zip(Q0, targets, strict=True):
        for more in (dict(q0=q0), dict(closest=q0), dict(q0=q0, objective="mid-range")):
            result = ik.solve(robot, target, solver, **more, **options)
            assert np.allclose(result.q[[1, 6]], q0[[1, 6]], rtol=0, atol=1e-12)
        assert result.success or solver != "lm"
        again += ik.solve(robot, target, solver, q0=q0, **options).attempt > 0
    assert again > 0  # the first attempt starts at q0 anyway; the others start from a table and at random
    home = ik.solve(robot, robot.fk(robot.home), solver, joint_weights=weights)
    assert np.allclose(home.q[[1, 6]], robot.home[[1, 6]], rtol=0, atol=1e-12)
    many = ik.solve_batch(robot, targets, solver, q0=Q0, **options)
    assert np.allclose(many.q[:, [1, 6]], Q0[:, [1, 6]], rtol=0, atol=1e-12)
    every = ik.solve_all(robot, targets[0], solver, q0=Q0[0], joint_weights=weights, starts=50)
    assert np.allclose(every.q[:, [1, 6]], Q0[0, [1, 6]], rtol=0, atol=1e-12)


def test_a_start_given_again_finds_the_same():
    """What a bound solver keeps of the last start, where joints are held, must not depend on the one in between."""
    robot, rng, held = robots.load("inspection_7dof"), np.random.default_rng(6), [1, 6]
    solver = ik.Solver(robot, "lm", joint_weights=(1, 0, 1, 1, 1, 1, 0), restarts=30)
    Q, Q0 = (np.array([robot.random_q(rng) for _ in range(6)]) for _ in range(2))
    Q[:, held] = Q0[:, held]
    points = [robot.fk(q) for q in Q]
    first = [solver(point, q0=q0).q for point, q0 in zip(points, Q0, strict=True)]
    assert np.allclose(np.array(first)[:, held], Q0[:, held], rtol=0, atol=1e-12)
    back = [solver(point, q0=q0).q for point, q0 in zip(points[::-1], Q0[::-1], strict=True)][::-1]
    assert np.array_equal(first, back)


def test_who_cannot_hold_a_joint_says_so():
    robot = robots.load("planar_2r")
    for solver in ("newton", "planar-2r"):
        with pytest.raises(errors.InvalidOption, match="moves every joint"):
            ik.solve(robot, (1, 1, 0), solver, joint_weights=(1, 0))


@settings(max_examples=60, deadline=None)
@given(st.lists(st.floats(-3, 3), min_size=6, max_size=6), st.integers(0, 2**31 - 1))
def test_converged_never_with_an_error_above_the_tolerance(values, seed):
    robot = robots.load("hydrolek_7w")
    T = ik.pose(values[:3], rpy=values[3:])
    for target in (T, T[:3, 3]):
        result = ik.solve(robot, target, "lm", seed=seed, restarts=4, tolerance=1e-4)
        position, orientation = robot.errors(result.q, target)
        assert result.success == (position <= 1e-4 and (orientation or 0.0) <= 1e-4)
        assert robot.outside(result.q) == []


def test_a_result_shows_itself_and_passes_its_own_check():
    robot = robots.load("hydrolek_7w")
    result = ik.solve(robot, robot.fk(robot.home + 0.1))
    assert result.raise_for_status() is result
    assert "CONVERGED" in repr(result) and "azimuth_yaw" in result._repr_html_()


def test_a_failed_solve_returns_the_best_configuration_it_evaluated():
    robot = robots.load("hydrolek_7w")
    target = np.array([-0.8, -0.3, 0.4])  # behind the arm
    worse = 0
    for name in ("pinv", "dls", "state-space", "transpose", "lm"):
        result = ik.solve(robot, target, name, history=True, max_iterations=50, restarts=3)
        # It is inside the reach bound, outside the joint ranges: without proof nothing is called unreachable.
        assert not result.success and result.status != ik.Status.UNREACHABLE
        error = result.history["position_error"]
        assert result.position_error == pytest.approx(error.min(), abs=1e-12)
        worse += error[-1] > error.min() + 1e-6
    assert worse >= 2  # otherwise the last one would do


def test_an_answer_turned_to_the_start_is_the_last_row_of_the_history():
    robot = robots.load("hydrolek_7w")
    turned = 0
    for target in robots.sample(robot, 40, seed=12)[1]:
        result = ik.solve(robot, target, "lm", history=True)
        rows = result.history["q"]
        assert (rows == result.q).all(axis=1).any() and len(rows) == result.fk_evaluations
        turned += np.abs(rows[-1] - rows[-2]).max() > 6.0 if len(rows) > 1 else 0
    assert turned > 3


def test_joints_that_turn_about_one_oblique_axis_lose_no_target():
    """Their rotations are one direction in three: a step by the inverse of that block was rounding (10 % lost)."""
    turning = dict(kind="revolute", axis="1 2 3", xyz="0.3 0.2 0.1", limits=(-3.0, 3.0))
    rail = dict(kind="prismatic", axis="1 0 0", limits=(-2.0, 2.0))
    robot = ik.Robot.load(robots.urdf(rail, turning, turning, turning, dict(kind="fixed", xyz="0.2 0.1 0.3")))
    rng = np.random.default_rng(11)
    Q = np.array([robot.random_q(rng) for _ in range(200)])
    T = robot.chain.forward(Q)[0]
    assert ik.solve_batch(robot, T, "lm", check=1.0).success.all()
    near = np.clip(Q + 0.02, robot.lower, robot.upper)
    assert ik.solve_batch(robot, T, "lm", q0=near, restarts=0).success.all()
    one_by_one = ik.Solver(robot, "lm", restarts=0)
    assert all(one_by_one(T[k], near[k]).success for k in range(50))


@pytest.mark.parametrize("axis", [(-0.03, -0.22, -0.02), (0.6, 0.0, 0.8), (1.0, 1.0, 1.0)])
def test_a_planar_arm_points_any_axis_of_its_tip(axis):
    robot = ik.Robot.load("planar_3r")
    rng = np.random.default_rng(12)
    solver = ik.Solver(robot, "lm", restarts=0)
    for _ in range(50):
        q = robot.random_q(rng)
        target = AxisTarget(robot.fk(q).homogeneous, axis)
        assert solver(target, np.clip(q + 0.02, robot.lower, robot.upper)).success
