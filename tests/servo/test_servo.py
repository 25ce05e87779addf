"""The constrained step in a control loop and along a path: what yields when limits bind, and what stays as published."""

import numpy as np
import pinocchio as pin
import pytest
from references import Q0, line_of, most_turns, panda_reference

import ik_toolkit as ik
from ik_toolkit.errors import InvalidConfiguration, InvalidOption
from ik_toolkit.servo import viability
from ik_toolkit.servo.step import StepStatus


@pytest.mark.parametrize("method", ["cv", "av", "ca", "aa", "aad"])
def test_published_forms_are_themselves_where_nothing_binds(panda, method):
    ref = panda_reference(panda, True, 1.0)
    wanted = ik.track(panda, ref, method, q0=Q0, on_limit="clip")
    for on_limit in ("slow", "leave"):
        run = ik.track(panda, ref, method, q0=Q0, on_limit=on_limit)
        assert np.array_equal(run.q, wanted.q) and np.array_equal(run.rate, wanted.rate)
        assert np.array_equal(run.clock, run.t) and (run.sigma == 1.0).all() and (run.pace == -1).all()
        assert run.status.name == "COMPLETED"


@pytest.mark.parametrize("method", ["cv", "aad"])
@pytest.mark.parametrize("acceleration", [None, 15.0])
def test_time_gives_way_before_the_path(panda, method, acceleration):
    """A line at four times the feasible speed: by default slower on the line; on time but off the line if requested."""
    ref = line_of(panda, Q0, (0.0, 0.5, 0.0), 0.25)
    run = ik.track(panda, ref, method, dt=0.005, q0=Q0, acceleration_limits=acceleration, settle=0.0)
    assert run.status.name == "SLOWED" and run.success, run.message
    assert run.position_error.max() < 1e-3 and run.clock[-1] == pytest.approx(0.25)
    across = run.xyz - run.xyz[0]
    assert np.abs(across[:, [0, 2]]).max() < 1e-3
    assert (np.diff(run.clock) >= 0.0).all() and (run.sigma >= 0.0).all() and (run.sigma <= 1.0).all()
    assert np.cumsum(run.sigma) * run.dt == pytest.approx(run.clock[1:], abs=1e-12)
    # Where no joint is named the clock is slower for the tolerance, as a run before was off there.
    assert run.pace_joint in run.message and (run.pace[run.sigma < 0.9] >= 0).mean() > 0.7
    speed = np.abs(np.diff(run.q, axis=0)) / run.dt
    assert (speed <= panda.velocity_limits * (1.0 + 1e-9)).all()
    leaving = ik.track(panda, ref, method, dt=0.005, q0=Q0, acceleration_limits=acceleration, on_limit="leave")
    assert leaving.t[-1] == pytest.approx(0.25) and leaving.position_error.max() > 0.01
    assert (leaving.sigma == 1.0).all()


def test_a_run_ends_after_the_stretch_it_is_allowed(panda):
    ref = line_of(panda, Q0, (0.0, 0.5, 0.0), 0.1)
    run = ik.track(panda, ref, dt=0.005, q0=Q0, max_stretch=1.5)
    assert run.t[-1] == pytest.approx(0.15) and run.clock[-1] < 0.1
    assert run.status.name == "LOST" and "panda_joint" in run.message
    assert ik.track(panda, ref, dt=0.005, q0=Q0, max_stretch=1e99).status.name == "SLOWED"
    for wrong, said in ((0.9, "at least 1, not 0.9"), ("long", "a number, not 'long'"), (np.nan, "")):
        with pytest.raises(InvalidOption, match=f"max_stretch must be {said}"):
            ik.track(panda, ref, max_stretch=wrong)
    for wrong, said in (("slwo", "on_limit.*slow"), ("direct", r"no on_limit 'direct'; 'direct' is for ik\.Tracker\.")):
        with pytest.raises(InvalidOption, match=said):
            ik.track(panda, ref, on_limit=wrong)


@pytest.mark.parametrize("method", ["cv", "av", "ca", "aad"])
def test_beyond_the_reach_the_arm_waits_at_its_edge(planar, method):
    """No error beyond the least there is, no chatter, and the elbow comes back on its side."""
    ref = ik.line((1.2, 0, 0), (2.1, 0, 0), duration=12.6, rounds=1)
    run = ik.track(planar, ref, method, dt=0.02, on_limit="leave")
    least = np.maximum(np.linalg.norm(run.target_xyz, axis=1) - 2.0, 0.0)
    late = {"cv": 2e-3, "av": 2e-3}.get(method, 4e-3)  # at its speed limit the elbow falls behind by 1.4 mm, or 3.1 mm
    assert (run.position_error <= least + late).all()  # where only half of a step is taken at the new rate
    assert most_turns(run.q, np.ones(2), run.dt) <= 3
    assert np.sign(run.q[0, 1]) == np.sign(run.q[-1, 1]) and run.position_error[-20:].max() < 1e-3


@pytest.mark.parametrize(
    ("name", "method", "q0", "place", "turn"),
    [
        ("panda", "cv", (-0.96, -1.007, 1.982, -0.727, 0.876, 2.865, 2.22), (-0.397, -0.867, 1.031), (1.8, 2.243, -0.837)),
        ("panda", "aad", (-1.272, -1.356, -2.514, -1.355, -1.611, 2.914, -2.047), (-0.313, -0.434, 1.039), (1.762, -1.41, -0.777)),
        ("panda", "cv", (-1.888, -1.035, -1.13, -0.323, -2.473, 0.663, -1.747), (-0.523, 0.796, 0.653), (0.439, 1.307, -0.941)),
        ("kinova", "cv", (-0.895, 1.436, 2.55, 0.481, 1.777, -1.379), (1.098, -0.44, -0.95), (0.347, -1.361, -1.363)),
    ],
)  # fmt: skip
def test_with_acceleration_limits_too_the_arm_comes_to_rest(name, method, q0, place, turn):
    """Joints swung for ever at a tenth of their speed limits and more. When the target comes back, the tip follows at once."""
    robot = ik.Robot.load(name)
    target = pin.SE3(pin.exp3(np.array(turn)), np.array(place)).homogeneous
    tracker = ik.Tracker(robot, method, q0=q0, acceleration_limits=10.0, reconfigure=False)
    steps = [tracker.update(target, 0.01) for _ in range(1500)]
    assert np.abs([step.rate / robot.velocity_limits for step in steps[-100:]]).max() < 0.01
    errors = [np.hypot(step.position_error, 0.2 * step.orientation_error) for step in steps]
    assert errors[-1] < min(errors) + 3e-3
    start = robot.fk(tracker.q).homogeneous
    for t in 0.01 * np.arange(1, 31):  # from where the tip is, towards the base
        target[:3, 3], target[:3, :3] = start[:3, 3] * (1.0 - 0.1 * t * t), start[:3, :3]
        step = tracker.update(target, 0.01)
    assert step.position_error < 0.5 * np.linalg.norm(start[:3, 3] - target[:3, 3])


def test_a_path_out_of_reach_is_left_as_little_as_possible(panda):
    """The line that made three joints flip between their speed limits every sample."""
    ref = line_of(panda, Q0, (0.4, 0.0, 0.3), 4.0)
    run = ik.track(panda, ref, q0=Q0, on_limit="leave")
    assert most_turns(run.q[-150:], np.ones(7), run.dt) == 0  # all beyond the reach


@pytest.mark.parametrize("method", ["cv", "aad"])
def test_joints_do_not_chatter_where_the_target_is_too_fast_and_too_far(method):
    """A slow eight out of a nearly stretched arm, without acceleration limits: limits and lost directions take turns."""
    robot, dt = ik.Robot.load("xarm7"), 0.01
    tracker, Q = ik.Tracker(robot, method, q0=robot.home), [robot.home]
    start = robot.fk(robot.home).translation
    for t in dt * np.arange(1, 601):
        phase, grown = 2.0 * np.pi * 0.3 * t, min(t, 1.0)
        way = grown * np.array([0.35 * np.sin(0.5 * phase), 0.08 * np.sin(phase), 0.04 * np.sin(2.0 * phase)])
        Q.append(tracker.update(pin.SE3(robot.fk(robot.home).rotation, start + way), dt).q)
    assert most_turns(np.array(Q), robot.velocity_limits) <= 3


def test_a_measured_arm_is_followed_from_where_it_is(panda):
    """A constant difference between joints and commands is taken out; too large a one restarts the tracker."""
    goal = panda.fk(Q0).homogeneous
    tracker, sag = ik.Tracker(panda, "cv", q0=Q0), np.array([0.02, -0.02, 0.01, 0.03, -0.01, 0.02, 0.01])
    joints = [Q0 + sag] * 3
    for _ in range(200):
        step = tracker.update(goal, 0.01, q=joints[-3])
        joints.append(step.q + sag)
    assert np.abs(panda.fk(joints[-1]).homogeneous - goal).max() < 1e-6 and step.position_error < 1e-6
    tracker.reset(Q0)
    step = tracker.update(goal, 0.01, q=Q0)
    step = tracker.update(goal, 0.01, q=step.q + 0.06)
    assert step.status is StepStatus.FOLLOWING_ERROR and "measured" in step.reason
    there = step.q + 0.3
    assert tracker.update(goal, 0.01, q=there).status is StepStatus.FOLLOWING_ERROR
    step = tracker.update(goal, 0.01, q=there)
    assert step.status is StepStatus.JUMPED and "restarted" in step.reason
    assert (np.abs(step.q - there) <= panda.velocity_limits * 0.01 * (1 + 1e-9)).all()
    assert tracker.update(goal, 0.01, q=Q0).status is not StepStatus.JUMPED  # measured before the jump
    tracker.reset(there)
    tracker.update(goal, 0.01, q=there - 0.3)
    step = tracker.update(np.full((4, 4), np.nan), 0.01, q=there - 0.3)
    assert step.status is StepStatus.HELD and "restarted" in step.reason and "target is not finite" in step.reason
    with pytest.raises(InvalidConfiguration, match="q"):
        tracker.update(goal, 0.01, q=np.zeros(3))


def test_a_joint_outside_its_limits_comes_back(panda):
    q = Q0.copy()
    q[3] = 0.1  # upper limit -0.07
    tracker = ik.Tracker(panda, "cv", q0=q, reconfigure=False)  # another posture reaches the goal, too
    goal = panda.fk(q).homogeneous
    places = [q[3]]
    for _ in range(200):
        step = tracker.update(goal, 0.01)
        places.append(step.q[3])
    assert (np.diff(places) <= 0.0).all() and places[-1] <= panda.upper[3]
    tracker.reset(q)
    step = tracker.update(goal, 0.01)
    assert step.status is StepStatus.RECOVERING and "panda_joint4" in step.reason


def test_a_joint_locked_on_the_way_stays(panda):
    tracker = ik.Tracker(panda, "cv", q0=Q0, acceleration_limits=10.0)
    ref = panda_reference(panda, False, 3.0)
    for k in range(100):
        step = tracker.update(ref.target(0.01 * (k + 1)), 0.01)
    tracker.change_limits(speed={"panda_joint4": 0.0})
    before = step.rate[3]
    seen = []
    for k in range(100, 240):
        step = tracker.update(ref.target(0.01 * (k + 1)), 0.01)
        seen.append(step.q[3])
        assert abs(step.rate[3]) <= max(abs(before) - 0.1 * (k - 99), 0.0) + 1e-12
    assert np.ptp(seen[50:]) == 0.0 and step.position_error < 1e-4  # six joints are enough for a position


@pytest.mark.parametrize("method", ["cv", "aad"])
def test_the_other_joints_do_what_a_locked_one_would(panda, method):
    """With joint 2 locked they still reach every pose of this path, close to a singular pose of theirs but not of the arm's."""
    tracker = ik.Tracker(panda, method, q0=Q0)
    tracker.change_limits(speed={"panda_joint2": 0.0})
    target, errors = panda.fk(Q0).homogeneous, []
    start = target[:3, 3].copy()
    for k in range(200):
        target[:3, 3] = start + 0.5 * (1.0 - np.cos(np.pi * (k + 1) / 100)) * np.array([0.0, 0.1, 0.1])
        step = tracker.update(target, 0.01)
        errors.append(np.hypot(step.position_error, 0.2 * step.orientation_error))
    assert tracker.q[1] == Q0[1] and max(errors) < 5e-4


def test_a_long_step_is_taken_in_parts(panda):
    """After steps of 1 ms one of 50 ms: limits hold, and the tip gets as far as fifty short ones bring it."""
    ref = panda_reference(panda, True, 3.0)
    tracker = ik.Tracker(panda, "aad", q0=Q0, acceleration_limits=10.0)
    for k in range(20):
        tracker.update(ref.target(0.001 * (k + 1)), 0.001)
    before = tracker.q
    step = tracker.update(ref.target(0.07), 0.05)
    assert (np.abs(step.q - before) <= panda.velocity_limits * 0.05).all()
    assert step.position_error < 2e-3 and np.abs(step.rate).max() <= 10.0 * 0.07 + 1e-9


def test_joints_keep_off_their_limits_in_the_null_space(panda):
    """The tip does as before, and a joint near its limit leaves it."""
    q = Q0.copy()
    q[0] = panda.upper[0] - 0.1
    goal = panda.fk(q).homogeneous
    stay, go = (ik.Tracker(panda, "cv", q0=q, avoid_limits=avoid) for avoid in (False, True))
    errors = []
    for _ in range(200):
        step = go.update(goal, 0.01)
        errors.append(step.position_error)
        stay.update(goal, 0.01)
    assert max(errors) < 2e-6 and max(errors[1:]) < 5e-7  # the first step has none before to extrapolate
    assert np.abs(stay.q - q).max() < 1e-9
    assert panda.upper[0] - go.q[0] > 0.15


def test_wishes_beside_the_task(panda):
    goal, wanted = panda.fk(Q0).homogeneous, Q0 + 0.2
    for option in ({"posture": wanted}, {"cost": lambda q: 0.5 * float((q - wanted) @ (q - wanted))}):
        tracker = ik.Tracker(panda, "cv", q0=Q0, avoid_limits=False, **option)
        for _ in range(300):
            step = tracker.update(goal, 0.01)
            assert step.position_error < 1e-6
        J = panda.jacobian(tracker.q)
        null = np.eye(7) - np.linalg.pinv(J) @ J
        assert np.linalg.norm(null @ (wanted - tracker.q)) < 0.05 * np.linalg.norm(null @ (wanted - Q0))
    # Q0 is symmetric: no motion beside the task raises it there
    aside = Q0 + np.array([0.0, 0.0, 0.3, 0.0, 0.2, 0.0, 0.0])
    low = ik.Tracker(panda, "cv", q0=aside, avoid_limits=False, manipulability=1.0)
    for _ in range(100):
        assert low.update(panda.fk(aside).homogeneous, 0.01).position_error < 1e-6

    def volume(q):
        return np.prod(np.linalg.svd(panda.jacobian(q), compute_uv=False))

    assert volume(low.q) > volume(aside) + 1e-4  # rounding is 1e-16


FORMS = {
    "position": {},
    "mask": {"mask": [1, 1, 1, 1, 0, 0]},
    "mask of the tip": {"mask": [1, 1, 1, 1, 0, 0], "frame": "tip"},
    "slack": {"slack": [0.02, 0, 0, 0, 0, 0.1]},
    "free turn": {"free_turn": [0, 0.6, 0.8]},
    "axis": {},
}


@pytest.mark.parametrize("form", FORMS)
def test_what_counts(panda, form):
    goal = panda.fk(Q0).homogeneous
    goal[:3, 3] += (0.05, 0.03, -0.04)
    goal[:3, :3] = pin.exp3(np.array([0.1, 0.2, -0.1])) @ goal[:3, :3]
    target = {"position": goal[:3, 3], "axis": ik.pose(goal[:3, 3], direction=(0, 0, -1))}.get(form, goal)
    tracker = ik.Tracker(panda, "cv", q0=Q0, **FORMS[form])
    for _ in range(80):
        step = tracker.update(target, 0.01)
    assert step.position_error < 1e-5 and (step.orientation_error or 0.0) < 1e-5
    check = ik.solve(panda, target, q0=tracker.q, tolerance=1e-4, follow=0.01, **FORMS[form])
    assert check.success and np.abs(check.q - tracker.q).max() < 1e-3


MASKS = {"base": [1, 1, 1, 1, 0, 0], "tip": [1, 0, 0, 1, 1, 1], "target": [1, 0, 0, 1, 1, 1]}


@pytest.mark.parametrize("frame", MASKS)
def test_a_target_that_moves_and_turns_is_followed_in_what_counts(panda, frame):
    """Where the rest of the error has grown large, the target's motion does not count as the tip's would."""
    worst = []
    for counts in ({}, {"mask": MASKS[frame], "frame": frame}):
        tracker, errors = ik.Tracker(panda, "cv", q0=Q0, **counts), []
        for k in range(300):
            way = 1.0 - np.cos(0.015 * (k + 1))
            step = tracker.update(panda.fk(Q0 + way * np.array([0.3, 0.2, -0.3, 0.3, 0.3, 0.3, 0.4])), 0.01)
            errors.append((step.position_error, step.orientation_error))
        worst.append(np.array(errors[100:]).max(axis=0))
    assert (worst[1] < 2.0 * worst[0]).all(), worst


def test_several_tips():
    tree = ik.Tree.load("brokk_hydrolek", tips=["left_tip", "right_tip"])
    start, down = tree.fk(tree.home), pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.05]))
    refs = {tip: ik.line(T, down * T, duration=2.0, law="minimum-jerk") for tip, T in start.items()}
    run = ik.track(tree, refs, "cv")
    assert run.success and run.xyz.shape == (201, 2, 3)
    at = tree.fk(run.q[-1])
    for tip in tree.tips:
        assert np.abs(at[tip].homogeneous - refs[tip].target(2.0)).max() < 1e-4
    between = start["left_tip"].actInv(start["right_tip"]).homogeneous
    tracker = ik.Tracker(tree, "cv", relative_to={"right_tip": "left_tip"})
    for k in range(100):
        step = tracker.update({"left_tip": refs["left_tip"].target(0.02 * (k + 1)), "right_tip": between}, 0.02)
    at = tree.fk(step.q)
    held = at["left_tip"].actInv(at["right_tip"]).homogeneous
    assert np.abs(held - between).max() < 1e-3 and step.status is StepStatus.OK
    assert not (viability.BIT.held & step._outcome.code).any()


def test_a_slowed_run_ends_without_a_jump(panda):
    """The clock reaches the end in whole steps: a short last one used to be taken at the previous speed."""
    run = ik.track(panda, panda_reference(panda, True, 1.0), q0=Q0, acceleration_limits=10.0)
    assert run.status.name == "SLOWED" and run.clock[-1] == 1.0 and run.position_error[-20:].max() < 1e-6
