"""Errors in order of priority: the first level in tolerance, the next at a minimum, and words that say so."""

import numpy as np
import pinocchio as pin
import pytest
from constrained import many
from robots import few_joints, have_data
from serial_arms import drawn

import ik_toolkit as ik
from ik_toolkit.errors import InvalidOption
from ik_toolkit.servo.step import StepStatus

FIRST = {"position": (slice(0, 3), slice(3, 6)), "orientation": (slice(3, 6), slice(0, 3))}


def turned(robot, rng, most):
    """A pose of a random configuration, turned about a random axis by up to `most` rad."""
    T = robot.fk(robot.random_q(rng)).homogeneous.copy()
    axis = rng.normal(size=3)
    T[:3, :3] = pin.exp3(axis / np.linalg.norm(axis) * rng.uniform(0.1, most)) @ T[:3, :3]
    return T


def errors(robot, q, T):
    """Errors (6,): position over reach, then 2 sin(angle/2) times the axis, whose squares the solver minimises."""
    now = robot.fk(q).homogeneous
    turn = pin.log3(now[:3, :3] @ T[:3, :3].T)
    angle = np.linalg.norm(turn)
    return np.concatenate([(now[:3, 3] - T[:3, 3]) / robot.reach, turn * (2 * np.sin(angle / 2) / max(angle, 1e-300))])


def steepest(robot, q, T, first):
    """Norm of the second level's gradient along which neither the first level nor a limit keeps it from falling."""
    h, unit = 1e-6, robot.chain.unit
    J = np.array(
        [(errors(robot, q + h * unit * e, T) - errors(robot, q - h * unit * e, T)) / (2 * h) for e in np.eye(robot.n)]
    )
    one, two = FIRST[first]
    g, A = J[:, two] @ errors(robot, q, T)[two], J[:, one]
    low, high, held = q <= robot.lower + 1e-12, q >= robot.upper - 1e-12, np.zeros(robot.n, dtype=bool)
    for _ in range(2 * robot.n):
        z = g + A @ np.linalg.lstsq(A[~held], -g[~held], rcond=1e-4)[0]
        outwards = (low & (z > 0)) | (high & (z < 0))
        if (outwards == held).all():
            break
        held = outwards
    return float(np.linalg.norm(z[~held]))


def five_joints():
    """The HydroLek with one joint locked."""
    arm = ik.Robot.load("hydrolek_7w")
    return arm.locked({arm.joint_names[3]: 0.3})


@pytest.mark.parametrize("slides", [False, True])
def test_a_position_in_a_corner_of_the_limits_is_met_and_blames_no_limit(slides):
    """With most joints at a limit, the multipliers of the position are only known once joints are released."""
    robot, rng = few_joints(3, 23, slides), np.random.default_rng(3)
    for _ in range(60):
        q = np.where(rng.random(3) < 0.6, np.where(rng.random(3) < 0.5, robot.lower, robot.upper), robot.random_q(rng))
        M = robot.fk(q)
        T = pin.SE3(pin.exp3(rng.normal(size=3)) @ M.rotation, M.translation).homogeneous
        found = ik.solve(robot, T, priority="position")
        assert found.success and found.position_error <= 1e-6 and "reached; orientation" in found.message, found.message
        other = ik.solve(robot, T, priority="position", q0=q)  # the planted corner meets the position, so it is a bound
        assert other.success and other.orientation_error <= robot.errors(q, T)[1] + 1e-6


@pytest.mark.parametrize("first", ["position", "orientation"])
@pytest.mark.parametrize("make", [
    five_joints, lambda: ik.Robot.load("hydrolek_7w"), lambda: ik.Robot.load("palletizer"), lambda: few_joints(3, 1),
    lambda: few_joints(4, 2), lambda: few_joints(5, 3), lambda: few_joints(5, 4, slides=True),
])  # fmt: skip
def test_first_level_in_tolerance_and_second_at_a_minimum(make, first):
    robot, rng = make(), np.random.default_rng(3)
    solver, reached = ik.Solver(robot, priority=first), 0
    for _ in range(many(40)):
        T = turned(robot, rng, 0.6)
        result = solver(T)
        if result.success:
            reached += 1
            assert np.linalg.norm(errors(robot, result.q, T)[FIRST[first][0]]) <= 1e-6 * max(1.0, 1.0 / robot.reach)
            assert steepest(robot, result.q, T, first) < 1e-5
            assert result.orientation_error == pytest.approx(robot.errors(result.q, T)[1], abs=1e-12)
            assert (result.q >= robot.lower).all() and (result.q <= robot.upper).all()
    assert reached == many(40) or first == "orientation"


def test_no_single_attempt_finds_better_than_the_search():
    robot, rng = five_joints(), np.random.default_rng(4)
    worse = 0
    for _ in range(20):
        T = turned(robot, rng, 0.4)
        found = ik.solve(robot, T, priority="position")
        Q0 = np.array([robot.random_q(rng) for _ in range(60)])
        others = ik.solve_batch(robot, np.repeat(T[None], 60, 0), q0=Q0, priority="position", restarts=0)
        worse += found.orientation_error > 1.01 * others.orientation_error[others.success].min() + 1e-4
    assert worse <= 1


def test_palletizer_is_off_by_the_tilt_of_the_target():
    """A tool that stays level can turn about the vertical only, so the least angle left is the target's tilt."""
    robot, rng = ik.Robot.load("palletizer"), np.random.default_rng(5)
    for _ in range(15):
        T = turned(robot, rng, 0.5)
        result = ik.solve(robot, T, priority="position")
        level = robot.fk(robot.home).homogeneous[:3, 2]
        tilt = np.arccos(np.clip(T[:3, 2] @ level, -1.0, 1.0))
        # The spin's own limits (+-3.1 rad) leave a gap of 0.08 rad, which a target may ask for.
        assert result.orientation_error == pytest.approx(tilt, abs=1e-6) or result.limited_joints


@pytest.mark.parametrize(("name", "least"), [("inspection_7dof", 1.0), *([("panda", 0.99)] if have_data() else [])])
def test_a_redundant_arm_loses_no_pose_that_it_can_reach(name, least):
    robot, rng = ik.Robot.load(name), np.random.default_rng(6)
    T = np.array([robot.fk(robot.random_q(rng)).homogeneous for _ in range(200)])
    done = ik.solve_batch(robot, T, priority="position")
    assert done.success.all() and (done.orientation_error <= 1e-6).mean() >= least


def test_out_of_reach_the_position_is_nearest_and_says_so():
    robot = ik.Robot.load("planar_2r")
    T = np.eye(4)
    T[:3, 3] = 3.0, 1.0, 0.0
    result = ik.solve(robot, T, priority="position")
    assert result.status == ik.Status.UNREACHABLE and not result.success
    assert result.position_error == pytest.approx(np.hypot(3.0, 1.0) - 2.0, abs=1e-9)
    T[2, 3] = 0.2  # above the plane in which the arm moves, above its reach
    T[:2, 3] = 1.0, 0.5
    lifted = ik.solve(robot, T, priority="position")
    assert not lifted.success and lifted.position_error == pytest.approx(0.2, abs=1e-9)


def test_words_name_what_is_reached_and_what_is_left():
    robot, rng = five_joints(), np.random.default_rng(7)
    T = turned(robot, rng, 0.5)
    result = ik.solve(robot, T, priority="position")
    assert result.message.startswith("position reached; orientation ") and "(5 joints; " in result.message
    assert result.message.endswith("agree)")
    position, orientation = result.level_errors
    assert position == {"position": result.position_error}
    assert orientation == {"orientation": result.orientation_error}
    assert result.to_dict()["level_errors"] == [position, orientation]
    plain = ik.solve(robot, T)
    assert not plain.success and "5 joints" in plain.message and "(priority)" in plain.message
    assert len(plain.level_errors) == 1
    met = ik.solve(robot, robot.fk(robot.home), priority="position")
    assert met.message.startswith("converged in ")


def test_batch_gives_the_same_as_single_solves():
    robot, rng = five_joints(), np.random.default_rng(9)
    T = np.array([turned(robot, rng, 0.4) for _ in range(30)])
    solver = ik.Solver(robot, priority="position")
    one = ik.solve_batch(robot, T, priority="position", threads=1)
    two = ik.solve_batch(robot, T, priority="position", threads=2)
    assert one.q.tobytes() == two.q.tobytes() == np.array([solver(t).q for t in T]).tobytes()
    assert one[0].message == solver(T[0]).message


def test_solve_all_lists_local_minima_the_least_first():
    robot, rng = five_joints(), np.random.default_rng(10)
    found = ik.solve_all(robot, turned(robot, rng, 0.5), priority="position", starts=100)
    assert len(found) and not found.complete and "local minim" in found.message
    assert (np.diff(found.orientation_error) >= -1e-9).all() and found.position_error.max() <= 1e-6


def nearly_along(robot):
    """Directions near the home of an arm, which its tip nearly has there: function of two shifts [m] that returns a target."""
    q = robot.home
    place = robot.fk(q).translation
    away = robot.fk(q).rotation @ np.array([0.5, 0.3, 0.8])
    return lambda x, y: ik.pose(xyz=place + np.array([0.0, x, y]), direction=away)


def test_a_direction_with_a_priority_lists_minima_too():
    joints = [("revolute", (0.0, 0.0, 0.3), (0, 0, 0), axis, -2.5, 2.5) for axis in np.eye(3)[[2, 1, 1, 0, 1]]]
    robot = drawn(joints, (0.1, 0.05, 0.2), (0.3, 0.0, 0.0))
    target = ik.pose(xyz=robot.fk(np.full(5, 1.0)).translation, direction=(0.2, 1.0, 0.3))
    for first in ("position", "orientation"):
        found = ik.solve_all(robot, target, priority=first, starts=50)
        assert len(found) and not found.complete and found.solver == "sqp"


def test_a_path_of_directions_with_a_priority_is_one_motion():
    robot = five_joints()
    at = nearly_along(robot)
    for count in (2, 12):
        poses = [at(x, 0.3 * x) for x in np.linspace(0.0, 0.06, count)]
        path = ik.solve_path(robot, poses, priority="position", reconfigurations="none")
        assert path.status == ik.PathStatus.FOLLOWED, path.message
        assert np.abs(np.diff(path.curve, axis=0)).max() < 0.15


def test_masks_slack_and_free_turns_count_within_their_level():
    robot, rng = five_joints(), np.random.default_rng(11)
    for _ in range(5):
        T = turned(robot, rng, 0.5)
        whole = ik.solve(robot, T, priority="position").orientation_error
        for counts in (
            {"free_turn": "z"},
            {"slack": (0, 0, 0, 0.1, 0.1, 0.1)},
            {"mask": (1, 1, 1, 1, 1, 0), "frame": "tip"},
        ):
            part = ik.solve(robot, T, priority="position", **counts)
            assert part.success and part.orientation_error <= 1.01 * whole + 1e-4


def test_a_frame_that_changes_no_error_changes_no_answer():
    """With equal weights of the position, the rotation errors along the axes of the tip are those along the target's."""
    robot, rng = five_joints(), np.random.default_rng(14)
    for _ in range(8):
        T = turned(robot, rng, 0.5)
        for counts in ({"free_turn": "z"}, {"mask": (1, 1, 1, 1, 1, 0)}):
            one = ik.solve(robot, T, priority="orientation", frame="tip", **counts)
            two = ik.solve(robot, T, priority="orientation", frame="target", **counts)
            assert one.status == two.status and one.position_error == pytest.approx(two.position_error, abs=1e-9)


def test_mistakes_are_named():
    robot, tree = ik.Robot.load("hydrolek_7w"), ik.Tree.load("brokk_hydrolek")
    T = robot.fk(robot.home)
    for value, words in (
        ("postion", "Did you mean 'position'"),
        ([], "priority must be"),
        (3, "priority must be"),
        ([3], "neither a tip nor a pair"),
        ("", "neither a tip nor a pair"),
        ([("tool", "place")], "neither 'position' nor 'orientation'"),
        ([("tool", "position"), "position"], "twice"),
    ):
        with pytest.raises(InvalidOption, match=words):
            ik.solve(robot, T, priority=value)
    with pytest.raises(InvalidOption, match="left_tip"):
        ik.solve(tree, tree.fk(tree.home), priority=[("left_tp", "position")])
    for options, words in (
        ({"solver": "pid"}, "takes no priority"),
        ({"closest": True}, "takes no closest"),
        ({"objective": "mid-range"}, "takes no objective"),
        ({"slack": (0.01, 0, 0, 0, 0, 0)}, "keeps no slack in a level that others come after"),
    ):
        with pytest.raises(InvalidOption, match=words):
            ik.solve(robot, T, q0=robot.home, priority="position", **options)


def test_without_a_priority_it_solves_as_lm_does():
    robot, rng = ik.Robot.load("hydrolek_7w"), np.random.default_rng(13)
    T = np.array([robot.fk(robot.random_q(rng)).homogeneous for _ in range(50)])
    done = ik.solve_batch(robot, T, solver="sqp")
    assert done.success.all() and done.position_error.max() <= 1e-6 and done.orientation_error.max() <= 1e-6


def test_a_path_leads_through_the_nearest_poses():
    robot = five_joints()
    q = np.linspace(robot.home, robot.home + 0.25, 25)
    T = np.array([robot.fk(x).homogeneous for x in q])
    T[:, :3, :3] = T[:, :3, :3] @ pin.exp3(np.array([0.1, 0.2, 0.0]))
    assert not ik.solve_path(robot, T).success
    path = ik.solve_path(robot, T, priority="position")
    assert path.status == ik.PathStatus.FOLLOWED and "off the poses asked for" in path.message
    assert np.nanmax(path.position_error) < 2e-6
    for row, target, error in zip(path.q, T, path.orientation_error, strict=True):
        assert error == pytest.approx(robot.errors(row, target)[1], abs=1e-9)
        assert error <= ik.solve(robot, target, q0=row, priority="position", restarts=0).orientation_error + 1e-4

    def stop(share, words):
        if share > 0.5:
            raise KeyboardInterrupt

    with pytest.raises(ik.PathInterrupted, match="off the poses asked for") as caught:
        ik.solve_path(robot, T, priority="position", progress=stop)
    part = caught.value.result
    row = int(np.flatnonzero(~np.isnan(part.q).any(axis=1))[-1])
    assert part.orientation_error[row] == pytest.approx(robot.errors(part.q[row], T[row])[1], abs=1e-9)


def test_poses_that_few_joints_reach_are_reached():
    """Attempts with all errors at once come first; without them 8 of these 400 poses end at another minimum."""
    robot, rng = ik.Robot.load("planar_3r"), np.random.default_rng(15)
    T = np.array([robot.fk(robot.random_q(rng)).homogeneous for _ in range(400)])
    assert ik.solve_batch(robot, T, priority="position").orientation_error.max() <= 1e-5


def test_a_pose_in_reach_is_reached_or_another_minimum_is_found():
    """Where the motion left hardly turns the tip, the gradient is small before the error is: 13 of these stopped 0.1 mrad off."""
    yaw, pitch = np.eye(3)[2], np.eye(3)[1]
    joints = [
        ("revolute", (0, 0, 0.077), (0, 0, 0), yaw, -3.1, 3.1), ("revolute", (0, 0, 0), (0, 0, 0), pitch, -1.9, 1.5),
        ("revolute", (0.024, 0, 0.128), (0, 0, 0), pitch, -1.9, 1.5), ("revolute", (0.124, 0, 0), (0, 0, 0), pitch, -1.7, 2.0),
    ]  # fmt: skip
    robot, rng = drawn(joints, (0.126, 0, 0)), np.random.default_rng(16)
    T = np.array([robot.fk(robot.random_q(rng)).homogeneous for _ in range(300)])
    done = ik.solve_batch(robot, T, priority="position")
    near = done.orientation_error < 1e-3
    assert done.success.all() and near.mean() > 0.99 and done.orientation_error[near].max() <= 1e-6


def test_a_tracker_keeps_the_position_and_calls_it_ok():
    robot = five_joints()
    tracker = ik.Tracker(robot, q0=robot.home, priority="position")
    T = robot.fk(robot.home).homogeneous.copy()
    for k in range(400):
        T[:3, 3] += 25e-6 * np.array([0.6, 0.8, 0.0])  # 25 mm/s, with an orientation that five joints cannot keep
        T[:3, :3] = pin.exp3(np.array([0.0, 0.0, 2e-4])) @ T[:3, :3]
        step = tracker.update(T.copy(), 1e-3)
        if k > 50 and step.status is StepStatus.OK:
            assert step.position_error < 1e-4
    assert step.status is StepStatus.OK and step.orientation_error > 1e-3


@pytest.mark.skipif(not have_data(), reason="needs example-robot-data")
def test_an_arm_of_five_joints_from_another_package():
    arm, rng = ik.Robot.load("so101"), np.random.default_rng(12)
    done = ik.solve_batch(arm, np.array([turned(arm, rng, 0.3) for _ in range(200)]), priority="position")
    assert done.success.all() and done.position_error.max() <= 1e-6


def test_a_path_whose_poses_can_all_be_met_misses_no_level():
    """Beside a singular pose the minimum of a lower level leaves the whole pose; the path must not follow it."""
    arm, rng = ik.Robot.load("ur5"), np.random.default_rng(21)
    first, last = [(arm.random_q(rng), arm.random_q(rng)) for _ in range(4)][-1]
    poses = np.array([arm.fk(first + s * (last - first)).homogeneous for s in np.linspace(0.0, 0.3, 8)])
    plain = ik.solve_path(arm, poses)
    for priority in ("position", "orientation"):
        ordered = ik.solve_path(arm, poses, priority=priority)
        assert plain.success and ordered.success
        assert len(ordered.reconfigurations) == len(plain.reconfigurations)
        assert ordered.position_error.max() < 1e-6 and ordered.orientation_error.max() < 1e-6


def test_a_tool_axis_off_by_rounding_is_no_failure():
    """The SO-101's tool axis and its roll are a few microradians apart, which the free turn can almost but not quite use."""
    robot, rng, met = ik.Robot.load("so101"), np.random.default_rng(0), 0
    for _ in range(60):
        target = ik.pose(robot.fk(robot.random_q(rng)).translation, direction=(0, 0, -1))
        result = ik.solve(robot, target, priority="position")
        if result.orientation_error < 1e-4:
            met += 1
            assert result.success and result.orientation_error < 1e-5, result.message
    assert met > 5
