"""ROS messages, configurations by name and dicts of joints: every call takes them, or says why not."""

import json
from types import SimpleNamespace as Message

import numpy as np
import pinocchio as pin
import pytest
import robots

import ik_toolkit as ik
from ik_toolkit.errors import ConfigurationNotFound, InvalidConfiguration, InvalidTarget
from ik_toolkit.servo.step import StepStatus


@pytest.fixture(scope="module")
def arm():
    return robots.load("hydrolek_7w")


def fields(names, values):
    return Message(**dict(zip(names, (float(x) for x in values), strict=True)))


def message(M, first="position", second="orientation"):
    turn = pin.Quaternion(M.rotation).coeffs()
    return Message(**{first: fields("xyz", M.translation), second: fields("xyzw", turn)})


TRANSFORM = ("translation", "rotation")


def plain(one):
    """A message as a dict of plain numbers, as JSON has it."""
    if isinstance(one, list):
        return [plain(value) for value in one]
    return {name: plain(value) for name, value in vars(one).items()} if isinstance(one, Message) else one


BOTH = pytest.mark.parametrize("form", [lambda x: x, plain], ids=["object", "dict"])


def test_poses_in_every_form_are_the_same_target(arm):
    M = arm.fk(arm.random_q(np.random.default_rng(1)))
    pose, transform = message(M), message(M, "translation", "rotation")
    header = Message(frame_id=arm.base)
    forms = (
        pose,
        transform,
        Message(header=header, pose=pose),
        Message(header=Message(frame_id="/" + arm.base), transform=transform, child_frame_id="tool"),
        Message(header=Message(frame_id=""), pose=pose),
    )
    expected = ik.solve(arm, M)
    for form in forms:
        assert np.abs(ik.solve(arm, form).q - expected.q).max() < 1e-6
        assert np.abs(np.subtract(arm.errors(arm.home, form), arm.errors(arm.home, M))).max() < 1e-9
    batch = ik.solve_batch(arm, list(forms))
    assert batch.success.all() and ik.solve_path(arm, [pose, pose]).success
    for point in (pose.position, Message(header=header, point=pose.position)):
        assert ik.solve(arm, point).position_only


def test_plain_dicts_are_the_same_targets_in_every_call(arm):
    """As rosbridge sends them: JSON objects with the fields of the messages."""
    M = arm.fk(arm.random_q(np.random.default_rng(1)))
    pose = message(M)
    header = Message(frame_id="/" + arm.base, stamp=Message(sec=0, nanosec=0))
    objects = (pose, Message(header=header, pose=pose), Message(header=header, transform=message(M, *TRANSFORM)))
    for one in (*objects, pose.position, Message(header=header, point=pose.position)):
        given = plain(one)
        assert json.loads(json.dumps(given)) == given
        expected = ik.solve(arm, one)
        assert np.array_equal(ik.solve(arm, given).q, expected.q)
        assert np.array_equal(ik.Solver(arm)(given).q, ik.Solver(arm)(one).q)
        assert np.array_equal(ik.solve_all(arm, given).q, ik.solve_all(arm, one).q)
        assert np.array_equal(ik.solve_batch(arm, [given, given]).q, ik.solve_batch(arm, [one, one]).q)
        assert np.array_equal(ik.solve_path(arm, [given, given]).q, ik.solve_path(arm, [one, one]).q)
        assert arm.errors(arm.home, given) == arm.errors(arm.home, one)
        steps = [ik.Tracker(arm, q0="home").update(form, 0.01) for form in (one, given)]
        assert np.array_equal(steps[0].q, steps[1].q) and steps[1].status == steps[0].status
        line = ik.line(arm.fk(arm.home), given, duration=1.0) if expected.orientation_error is not None else None
        assert line is None or np.allclose(line.at(np.array([1.0]))[0][0], M.homogeneous)
    assert np.allclose(ik.approach(plain(objects[1]), 0.1), ik.approach(M, 0.1))


@BOTH
def test_a_message_of_many_poses_is_a_batch_and_a_path(arm, form):
    """geometry_msgs/PoseArray and nav_msgs/Path."""
    poses = [message(arm.fk(q)) for q in np.linspace(arm.home, arm.home + 0.05, 3)]
    header = Message(frame_id=arm.base)
    array = Message(header=header, poses=poses)
    path = Message(header=Message(frame_id=""), poses=[Message(header=header, pose=pose) for pose in poses])
    for one in (array, path):
        assert np.array_equal(ik.solve_batch(arm, form(one)).q, ik.solve_batch(arm, poses).q)
        assert np.array_equal(ik.solve_path(arm, form(one)).q, ik.solve_path(arm, poses).q)
    bare = form(Message(poses=poses))
    assert np.array_equal(ik.solve_batch(arm, bare).q, ik.solve_batch(arm, poses).q)
    with pytest.raises(InvalidTarget, match="one pose is needed, and this message has a list of them"):
        ik.solve(arm, bare)
    assert len(ik.solve_batch(arm, plain(Message(poses=[])))) == 0
    for one in (
        Message(header=Message(frame_id="map"), poses=poses),
        Message(header=header, poses=[Message(header=Message(frame_id="map"), pose=poses[0])]),
    ):
        for call in (ik.solve_batch, ik.solve_path):
            with pytest.raises(InvalidTarget, match="frame 'map', and the robot's base is"):
                call(arm, form(one))


def test_plain_dicts_for_several_tips():
    tree = robots.load("two_arms")
    P = tree.fk(tree.random_q(np.random.default_rng(5)))
    given = {tip: plain(message(P[tip])) for tip in tree.tips}
    expected = ik.solve(tree, {tip: message(P[tip]) for tip in tree.tips})
    assert np.array_equal(ik.solve(tree, given).q, expected.q)
    assert np.array_equal(ik.solve(tree, list(given.values())).q, expected.q)
    batch = ik.solve_batch(tree, {tip: [one] for tip, one in given.items()})
    assert np.array_equal(batch.q, ik.solve_batch(tree, [list(given.values())]).q)
    steps = [ik.Tracker(tree, q0="home").update(form, 0.01) for form in (given, P)]
    assert steps[0].status == steps[1].status and np.abs(steps[0].q - steps[1].q).max() < 1e-9
    for call in (ik.solve, lambda robot, one: ik.Tracker(robot).update(one, 0.01)):
        with pytest.raises(InvalidTarget, match=r"takes one target for each of .*, not a single one"):
            call(tree, given[tree.tips[0]])


@BOTH
def test_another_frame_is_refused_by_name(arm, form):
    stamped = form(Message(header=Message(frame_id="map"), pose=message(arm.fk(arm.home))))
    for call in (
        lambda: ik.solve(arm, stamped),
        lambda: ik.solve_batch(arm, [stamped]),
        lambda: ik.solve_path(arm, [stamped]),
        lambda: ik.Tracker(arm).update(stamped, 0.01),
        lambda: arm.errors(arm.home, stamped),
    ):
        with pytest.raises(InvalidTarget, match=rf"frame 'map', and the robot's base is '{arm.base}'"):
            call()
    for call in (ik.solve_batch, ik.solve_path):
        with pytest.raises(InvalidTarget, match="targets must be many, and this is one ROS message; give a list"):
            call(arm, stamped)


@BOTH
def test_messages_that_hold_no_pose_are_refused(arm, form):
    good = message(arm.fk(arm.home))
    for wrong in (
        Message(position=good.position, orientation=fields("xyzw", (0, 0, 0, 0))),
        Message(position=Message(x="a", y=0.0, z=0.0), orientation=good.orientation),
        Message(position=Message(x="0.5", y=0.0, z=0.0), orientation=good.orientation),
        Message(position=good.position),
        Message(position=[0.5, 0.0, 0.3], orientation=[0.0, 0.0, 0.0, 1.0]),
        good.orientation,
    ):
        for call in (ik.solve, lambda arm, one: ik.solve_batch(arm, [one]), lambda arm, one: ik.solve_path(arm, [one])):
            with pytest.raises(InvalidTarget):
                call(arm, form(wrong))
    for call in (ik.solve, lambda arm, one: ik.solve_batch(arm, [one])):
        said = r"a dict has the fields of a ROS message, position \(x, y, z\) and orient"
        with pytest.raises(InvalidTarget, match=said):
            call(arm, plain(Message(position=good.position)))


@BOTH
@pytest.mark.parametrize("none", [np.nan, None])  # JSON has no NaN; rosbridge writes null
def test_a_tracker_goes_on_after_a_message_with_nan(arm, form, none):
    tracker, good = ik.Tracker(arm, q0="home"), form(message(arm.fk(arm.home)))
    nothing = message(arm.fk(arm.home))
    nothing.position.x = none
    nothing = form(nothing)
    with pytest.raises(InvalidTarget, match="not finite"):
        ik.solve(arm, nothing)
    assert tracker.update(good, 0.01).status == StepStatus.OK
    step = tracker.update(nothing, 0.01)
    assert step.status != StepStatus.OK and np.abs(step.q - arm.home).max() < 1e-9
    assert tracker.update(good, 0.01).status == StepStatus.OK


def test_a_start_by_joint_or_by_name(arm):
    q = arm.random_q(np.random.default_rng(2))
    M, values = arm.fk(q), dict(zip(arm.joint_names, q, strict=True))
    expected = ik.solve(arm, M, q0=q)
    backwards = dict(reversed(values.items()))
    more = backwards | {"gripper": 0.04}
    state = Message(name=list(more), position=list(more.values()), velocity=[], effort=[])
    for start in (values, backwards, more, state, plain(state)):
        result = ik.solve(arm, M, q0=start)
        assert np.array_equal(result.q, expected.q)
        assert ("gripper ignored" in result.notice) == (start is not values and start is not backwards)
        assert np.array_equal(ik.solve_batch(arm, [M], q0=start).q, ik.solve_batch(arm, [M], q0=q).q)
        each = ik.solve_batch(arm, [M, M], q0=[start, start])
        assert np.array_equal(each.q, ik.solve_batch(arm, [M, M], q0=[q, q]).q)
        assert np.array_equal(ik.Tracker(arm, q0=start).q, q)
        assert np.array_equal(arm.fk(start).homogeneous, M.homogeneous)
    assert np.array_equal(ik.solve(arm, M, q0="home").q, ik.solve(arm, M, q0=arm.home).q)
    with pytest.raises(ConfigurationNotFound, match=r"'hom'\. Did you mean 'home'"):
        ik.solve(arm, M, q0="hom")


def test_a_start_that_lacks_a_joint_is_refused(arm):
    M, values = arm.fk(arm.home), dict(zip(arm.joint_names, arm.home, strict=True))
    last = arm.joint_names[-1]
    renamed = {(joint + "s" if joint == last else joint): x for joint, x in values.items()}
    with pytest.raises(InvalidConfiguration, match=f"q0 has no value for joint {last}, but names {last}s, not in"):
        ik.solve(arm, M, q0=renamed)
    with pytest.raises(InvalidConfiguration, match=rf"q0 of target 1 has no value for joint {last}"):
        ik.solve_batch(arm, [M, M], q0=[values, renamed])
    for form in (lambda x: x, plain):
        with pytest.raises(InvalidConfiguration, match="2 names and 1 positions"):
            ik.solve(arm, M, q0=form(Message(name=["a", "b"], position=[0.0])))
        with pytest.raises(InvalidConfiguration, match="names joint a more than once"):
            ik.solve(arm, M, q0=form(Message(name=["a", "a"], position=[0.0, 0.0])))


def test_axes_by_name(arm):
    T = arm.fk(arm.home).homogeneous
    for name, axis in (("x", (1, 0, 0)), ("-z", (0, 0, -1)), (" Y ", (0, 1, 0))):
        assert np.array_equal(ik.solve(arm, T, free_turn=name).q, ik.solve(arm, T, free_turn=axis).q)
        assert ik.pose(T[:3, 3], direction=name, axis=name).axis == axis
    with pytest.raises(ik.IKError, match="free_turn must be x, y, z, -x, -y, -z or three numbers, not 'w'"):
        ik.solve(arm, T, free_turn="w")


def test_lists_of_axis_targets(arm):
    poses = [arm.fk(q) for q in arm.random_q(np.random.default_rng(3), 4)]
    targets = [ik.pose(M.translation, direction=M.rotation[:, 2]) for M in poses]
    batch = ik.solve_batch(arm, targets)
    assert batch.success.all() and ik.solve_batch(arm, np.array(targets, dtype=object)).success.all()
    assert ik.place(arm, targets, ((0, 0), (0, 0)), yaw=0).poses.shape == (4, 4, 4)
    for q, M in zip(batch.q, poses, strict=True):
        assert np.abs(arm.fk(q).translation - M.translation).max() < 1e-5
        assert np.abs(arm.fk(q).rotation[:, 2] - M.rotation[:, 2]).max() < 1e-5
    line = [ik.pose(poses[0].translation + np.array([0, 0, z]), direction=poses[0].rotation[:, 2]) for z in (0.0, 0.01)]
    assert ik.solve_path(arm, line).success
    for mixed in ([targets[0], poses[1]], [targets[0], ik.pose((1, 0, 0), direction="x", axis="y")]):
        with pytest.raises(InvalidTarget, match="the targets of one call share the tip axis"):
            ik.solve_batch(arm, mixed)
    with pytest.raises(ik.IKError, match="leave free_turn out"):
        ik.solve_batch(arm, targets, free_turn="z")


def test_axis_targets_of_several_tips():
    tree = robots.load("two_arms")
    P = [tree.fk(q) for q in tree.random_q(np.random.default_rng(4), 3)]
    first, second = tree.tips
    pointed = [ik.pose(M[first].translation, direction=M[first].rotation[:, 2]) for M in P]
    for targets in (
        [[one, M[second]] for one, M in zip(pointed, P, strict=True)],
        {first: pointed, second: [M[second] for M in P]},
        {first: pointed},
    ):
        assert ik.solve_batch(tree, targets).success.all()


def test_approach_backs_off_along_the_axis(arm):
    M = arm.fk(arm.home)
    for axis, column in ((None, 2), ("x", 0), ((0, 2, 0), 1)):
        T = ik.approach(M, 0.1, axis)
        assert np.allclose(T[:3, 3], M.translation - 0.1 * M.rotation[:, column]) and np.allclose(T[:3, :3], M.rotation)
    pointed = ik.pose((1.0, 0.0, 0.2), direction="-z", axis="y")
    before = ik.approach(pointed, 0.25)
    assert before.axis == pointed.axis and np.allclose(before.T_base_tip[:3, 3], (1.0, 0.0, 0.45))
    for wrong in (((1.0, 0.0, 0.0), 0.1), (M, np.nan), (M, 0.1, (0, 0, 0))):
        with pytest.raises(InvalidTarget):
            ik.approach(*wrong)
    with pytest.raises(InvalidTarget, match="distance must be a number, not"):
        ik.approach(M, "far")
