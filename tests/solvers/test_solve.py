"""The public solve call: defaults, options, messages, singular and unreachable targets."""

import math
import pickle

import numpy as np
import pytest
import robots
from hypothesis import given, settings
from hypothesis import strategies as st

import ik_toolkit as ik
from ik_toolkit import errors
from ik_toolkit.robot.pose import AxisTarget
from ik_toolkit.solvers.registry import find_row


@pytest.mark.parametrize("name", ["hydrolek_7w", "inspection_7dof", "continuous_mix", "mimic_mix", "slides_mix"])
def test_lm_solves_nearly_every_reachable_pose_from_nothing(name):
    robot = robots.load(name)
    _, T = robots.sample(robot, 2000, seed=21)
    batch = ik.solve_batch(robot, T, "lm")
    assert batch.success.mean() >= 0.999
    for k in range(0, 2000, 50):
        position, orientation = robot.errors(batch.q[k], T[k])
        assert not batch.success[k] or (position <= 1e-6 and orientation <= 1e-6)


@pytest.mark.skipif(not robots.have_data(), reason="example-robot-data is not installed")
@pytest.mark.parametrize("name", ["panda", "ur5", "kinova"])
def test_lm_on_well_known_arms(name):
    robot = robots.load(name)
    _, T = robots.sample(robot, 2000, seed=22)
    batch = ik.solve_batch(robot, T, "lm")
    assert batch.success.mean() >= 0.999
    assert (batch.q >= robot.lower).all() and (batch.q <= robot.upper).all()


def test_names_classes_and_instances_mean_the_same():
    robot = robots.load("hydrolek_7w")
    T = robot.fk(robot.home + 0.05)
    by_name = ik.solve(robot, T, "dls", damping=0.1)
    assert by_name.q.tobytes() == ik.solve(robot, T, ik.DLS(damping=0.1)).q.tobytes()
    assert by_name.q.tobytes() == ik.solve(robot, T, ik.DLS, damping=0.1).q.tobytes()
    assert by_name.q.tobytes() != ik.solve(robot, T, "dls", damping=0.5).q.tobytes()


@pytest.mark.parametrize(
    ("arguments", "error", "match"),
    [
        (dict(target="nonsense"), errors.InvalidTarget, "nonsense"),
        (dict(solver="lmm"), errors.UnknownSolver, "Did you mean 'lm'"),
        (dict(solver="LM"), errors.UnknownSolver, "Did you mean 'lm'"),
        (dict(solver="State-Space"), errors.UnknownSolver, "Did you mean 'state-space'"),
        (dict(solver=int), errors.UnknownSolver, "not the class int"),
        (dict(solver=1), errors.UnknownSolver, "a name, a rule class or an instance of one, not 1. Available: lm,"),
        (dict(TOLERANCE=1e-3), errors.InvalidOption, "Did you mean 'tolerance'"),
        (dict(tolerence=1e-3), errors.InvalidOption, "Did you mean 'tolerance'"),
        (dict(tolerance="small"), errors.InvalidOption, "tolerance must be a number"),
        (dict(tolerance=-1), errors.InvalidOption, "finite and at least 1e-14"),
        (dict(tolerance=math.nan), errors.InvalidOption, "finite and at least 1e-14"),
        (dict(max_iterations=2.5), errors.InvalidOption, "whole number"),
        (dict(max_iterations=10**9), errors.InvalidOption, "at most"),
        (dict(restarts=-1), errors.InvalidOption, "restarts"),
        (dict(q0=[0, 0]), errors.InvalidConfiguration, "6 values"),
        (dict(q0=[9] * 6, q0_outside="refuse"), errors.InvalidConfiguration, "azimuth_yaw"),
        (dict(q0_outside="ignore"), errors.InvalidOption, "clamp"),
        (dict(solver="dls", dampng=1), errors.InvalidOption, "dampng"),
        (dict(solver="dls", damping=math.nan), errors.InvalidOption, "NaN"),
        (dict(mask=(1, 1, 1)), errors.InvalidOption, "six"),
        (dict(joint_weights=(1, 1)), errors.InvalidOption, "6 values"),
        (dict(mask=("x",) * 6), errors.InvalidOption, "mask must be numbers"),
        (dict(joint_weights="ab"), errors.InvalidOption, "joint_weights must be numbers"),
        (dict(objective=["mid-range"]), errors.InvalidOption, "objective must be one of"),
        (dict(limits="no"), errors.InvalidOption, "limits must be True, False, a dict from joint names"),
        (dict(seed=10**400), errors.InvalidOption, "seed"),
        (dict(solver="lm", damping=[1, 2]), errors.InvalidOption, r"finite numbers, not damping=\[1, 2\]"),
        (dict(solver=ik.LM(damping=None)), errors.InvalidOption, "parameters of solver 'lm'"),
        (dict(solver=ik.PID(kp="fast")), errors.InvalidOption, "kp='fast'"),
        (dict(solver=ik.PID(starts="home")), errors.InvalidOption, "starts must be numbers"),
        (dict(solver="newton", target=(0.5, 0, 0)), errors.InvalidOption, "as many task rows"),
    ],
)
def test_mistakes_are_named(arguments, error, match):
    robot = robots.load("hydrolek_7w")
    target = arguments.pop("target", robot.fk(robot.home))
    with pytest.raises(error, match=match) as caught:
        ik.solve(robot, target, **arguments)
    assert isinstance(caught.value, ik.IKError)


def test_the_first_argument_is_a_robot():
    with pytest.raises(errors.InvalidOption, match="Robot"):
        ik.solve("hydrolek_7w", (1, 0, 0))
    with pytest.raises(errors.InvalidOption, match="Robot"):
        ik.Solver("hydrolek_7w", "lm")


def test_q0_outside_the_limits_is_clamped_with_a_notice():
    robot = robots.load("hydrolek_7w")
    result = ik.solve(robot, robot.fk(robot.home), q0=robot.upper + 1.0)
    assert "clamped" in result.notice and "azimuth_yaw" in result.notice
    assert result.success


def test_unreachable_says_by_how_much():
    robot = robots.load("planar_2r")
    lm = ik.solve(robot, (3.0, 0.0, 0.0), "lm")
    assert lm.status == ik.Status.UNREACHABLE
    assert "by 1 m" in lm.message
    assert lm.position_error == pytest.approx(1.0, abs=1e-6)
    pose = ik.solve(robots.load("hydrolek_7w"), ik.pose((5, 0, 0), rpy=(0, 0, 0)))
    assert pose.status == ik.Status.UNREACHABLE and "beyond reach" in pose.message


def test_a_target_outside_the_limits_is_never_called_unreachable_without_proof():
    robot = robots.load("hydrolek_7w")
    result = ik.solve(robot, (-0.8, 0.0, 0.0))  # behind the arm: inside the reach bound, outside the joint ranges
    assert not result.success
    assert result.status in (ik.Status.LIMIT_BLOCKED, ik.Status.STALLED)
    assert "closest" in result.message


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


@pytest.mark.parametrize("solver", ["lm", "dls"])
def test_a_used_up_budget_is_called_that(solver):
    robot = robots.load("hydrolek_7w")
    target = robot.fk(robot.lower * 0.3 + robot.upper * 0.7)
    spent = ik.solve(robot, target, solver, max_evaluations=3)
    assert spent.status == ik.Status.ITERATION_LIMIT
    assert "the limit of 3 evaluations was reached after 1 start;" in spent.message
    assert "minimum" not in spent.message and "max_evaluations" in spent.message
    assert "allowed" not in ik.solve(robot, target, solver, max_evaluations=1000).message


def test_singular_planar_arm():
    """A straight planar 3R asked for a point on its own line: J'e = 0, so Jacobian methods stand still (Burrell 2016, 6.4)."""
    robot = robots.load("planar_3r")
    straight, target = np.zeros(3), np.array([5.0, 0.0, 0.0])
    for name in ("transpose", "pinv", "dls"):
        result = ik.solve(robot, target, name, q0=straight)
        assert result.status in (ik.Status.SINGULAR, ik.Status.STALLED)
        assert (result.q == 0).all() and "J'e = 0" in result.message
    assert ik.solve(robot, target, "lm", q0=straight).success
    B = np.array([[2.0, -2.0, 0], [-1.0, 0.0, 0], [1.0, -2.0, 0]])
    rule = ik.StateSpace(A=-0.5 * np.eye(3), B=B, C=-0.05 * np.eye(3))
    result = ik.solve(robot, target, rule, q0=straight, tolerance=0.02)
    assert result.success
    assert np.degrees(result.q) == pytest.approx([47.593, -60.0, -18.715], abs=2e-3)
    assert result.iterations in (125, 126, 127)


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


def test_masks_free_what_they_name():
    robot = robots.load("hydrolek_7w")
    T = robot.fk(robot.home + 0.1).homogeneous
    moved = T.copy()
    moved[2, 3] += 30.0  # height is free
    result = ik.solve(robot, moved, mask=(1, 1, 0, 0, 0, 0))
    assert result.success
    assert np.abs(robot.fk(result.q).translation - moved[:3, 3])[:2].max() < 1e-6
    tip = ik.solve(robot, T, mask=(1, 1, 1, 1, 1, 0), frame="tip", q0=robot.home)
    assert tip.success
    R = T[:3, :3].T @ robot.fk(tip.q).rotation
    assert abs(R[2, 2] - 1.0) < 1e-10  # tip z axes agree, the turn about z is free


def test_joint_weights_hold_a_joint():
    robot = robots.load("inspection_7dof")
    weights = [1, 0, 1, 1, 1, 1, 1]
    q = robot.home + 0.05
    q[1] = robot.home[1]
    result = ik.solve(robot, robot.fk(q), "lm", joint_weights=weights, restarts=0, q0=robot.home)
    assert result.success and result.q[1] == robot.home[1]


@pytest.mark.parametrize("solver", ["lm", "dls", "pid", "state-space"])
def test_a_held_joint_stays_in_every_start(solver):
    robot, rng = robots.load("inspection_7dof"), np.random.default_rng(3)
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
    home = ik.solve(robot, robot.fk(robot.home), solver, joint_weights=weights)
    assert np.allclose(home.q[[1, 6]], robot.home[[1, 6]], rtol=0, atol=1e-12)
    many = ik.solve_batch(robot, targets, solver, q0=Q0, **options)
    assert np.allclose(many.q[:, [1, 6]], Q0[:, [1, 6]], rtol=0, atol=1e-12)
    every = ik.solve_all(robot, targets[0], solver, q0=Q0[0], joint_weights=weights, starts=50)
    assert np.allclose(every.q[:, [1, 6]], Q0[0, [1, 6]], rtol=0, atol=1e-12)


def test_who_cannot_hold_a_joint_says_so():
    robot = robots.load("planar_2r")
    for solver in ("newton", "planar-2r"):
        with pytest.raises(errors.InvalidOption, match="moves every joint"):
            ik.solve(robot, (1, 1, 0), solver, joint_weights=(1, 0))


def test_bound_solver_and_options_survive_pickling():
    robot = robots.load("hydrolek_7w")
    solver = ik.Solver(robot, "lm", tolerance=1e-5, seed=4)
    T = robot.fk(robot.home + 0.1).homogeneous
    copy = pickle.loads(pickle.dumps(solver))
    assert copy(T).q.tobytes() == solver(T).q.tobytes()
    assert copy.options == solver.options


def test_read_only_and_foreign_arrays_are_targets_too():
    robot = robots.load("hydrolek_7w")
    T = robot.fk(robot.home + 0.1).homogeneous
    expected = ik.solve(robot, T).q.tobytes()
    frozen = T.copy()
    frozen.setflags(write=False)
    for same in (frozen, np.asfortranarray(T), T.tolist(), T.astype(np.longdouble)):
        assert ik.solve(robot, same).q.tobytes() == expected


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


def test_registry_finds_rows():
    assert find_row("lm").load() is ik.LM
    assert find_row(ik.PID).name == "pid"
    assert find_row(ik.CCD()).name == "ccd"


def test_result_is_plain_data():
    robot = robots.load("hydrolek_7w")
    result = ik.solve(robot, robot.fk(robot.home + 0.1))
    plain = result.to_dict()
    assert plain["success"] is True and plain["status"] == "CONVERGED" and len(plain["q"]) == 6
    assert result.raise_for_status() is result
    assert "CONVERGED" in repr(result) and "azimuth_yaw" in result._repr_html_()


def test_a_failed_solve_returns_the_best_configuration_it_evaluated():
    robot = robots.load("hydrolek_7w")
    target = np.array([-0.8, -0.3, 0.4])  # behind the arm
    worse = 0
    for name in ("pinv", "dls", "state-space", "transpose", "lm"):
        result = ik.solve(robot, target, name, history=True, max_iterations=50, restarts=3)
        assert not result.success
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


@pytest.mark.parametrize("solver", ["lm", "dls", "planar-2r"])
def test_a_start_that_is_not_legal_is_seen_wherever_it_comes_from(solver):
    robot = robots.load("planar_2r")
    target = robot.fk(robot.home).translation
    bound = ik.Solver(robot, solver)
    for bad in (np.array([np.nan, 0.0]), np.array([np.inf, 0.0]), [0.0, None], np.zeros(3)):
        with pytest.raises(errors.InvalidConfiguration):
            bound(target, q0=bad)
    for outside in (np.array([9.0, 0.0]), [9.0, 0.0]):
        result = bound(target, q0=outside)
        assert "clamped" in result.notice and result.success
    assert bound(target, q0=np.array([1.0, 0.9])).notice == ""


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
