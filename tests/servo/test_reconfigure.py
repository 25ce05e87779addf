"""A target that only another posture reaches: the arm goes there inside all limits, and only then."""

import numpy as np
import pytest
from references import accelerations, keeps_limits, least_time

import ik_toolkit as ik
from ik_toolkit.errors import InvalidOption
from ik_toolkit.motion.reference import exp
from ik_toolkit.servo.reconfigure import gap
from ik_toolkit.servo.step import StepStatus

DT = 0.01
REST = 4.0  # [s]


def turned(T0, degrees, rate):
    """T0 (4, 4) turned about the tool's axis at up to a rate [rad/s], from rest to rest, then standing."""
    full = np.radians(degrees)
    x = np.clip(
        np.arange(1, round(1.9 * abs(full) / rate / DT) + 1 + round(REST / DT)) * DT * rate / (1.9 * abs(full)),
        0.0,
        1.0,
    )
    T = np.repeat(T0[None], len(x), axis=0)
    T[:, :3, :3] = T0[:3, :3] @ exp(np.outer(full * x**3 * (10.0 - 15.0 * x + 6.0 * x * x), [0.0, 0.0, 1.0]))
    return T


def follow(robot, targets, tip=None, **options):
    """Steps of a tracker at rest at home; acceleration limits, and for a tree the targets of one tip, the others held."""
    tracker = ik.Tracker(robot, q0=robot.home, acceleration_limits=accelerations(robot), **options)
    others = {} if tip is None else {name: T.homogeneous for name, T in robot.fk(robot.home).items() if name != tip}
    return [tracker.update(T if tip is None else {**others, tip: T}, DT) for T in targets]


def joints(robot, steps):
    """Joint values (N + 1, n) from home on."""
    return np.array([robot.home, *(step.q for step in steps)])


def time_back(robot, steps, begin):
    """Time [s] from sample `begin` until the tip stays within 1 mm and 5 mrad, and the least the joints need for that way."""
    off = [k for k, s in enumerate(steps) if s.position_error > 1e-3 or (s.orientation_error or 0.0) > 5e-3]
    Q, back = joints(robot, steps), max(begin, off[-1] + 2 if off else 0)
    return (back - begin) * DT, least_time(robot, Q[back] - Q[begin], accelerations(robot))


@pytest.mark.parametrize(
    ("name", "method", "degrees"), [("panda", "cv", 720.0), ("hydrolek_7w", "aad", -720.0), ("ur5", "cv", 720.0)]
)
def test_a_tool_turned_twice_is_followed(name, method, degrees):
    robot = ik.Robot.load(name)
    targets = turned(robot.fk(robot.home).homogeneous, degrees, 2.0)
    steps = follow(robot, targets, method=method)
    assert any(s.status is StepStatus.RECONFIGURING for s in steps)
    seconds, bound = time_back(robot, steps, len(targets) - round(REST / DT))
    assert seconds <= 1.3 * bound + DT and steps[-1].position_error < 1e-4 and steps[-1].orientation_error < 5e-4
    assert keeps_limits(robot, joints(robot, steps), DT, accelerations(robot))


def test_switched_off_it_stays_and_says_so(panda):
    targets = turned(panda.fk(panda.home).homogeneous, 400.0, 2.0)
    steps = follow(panda, targets, reconfigure=False)
    assert steps[-1].orientation_error > 0.1 and steps[-1].status is StepStatus.AT_LIMIT
    assert not any(s.status is StepStatus.RECONFIGURING for s in steps)
    for on_limit in ("leave", "clip"):
        other = follow(panda, targets, on_limit=on_limit)
        assert not any(s.status is StepStatus.RECONFIGURING for s in other), on_limit
    with pytest.raises(InvalidOption, match="reconfigure is True or False"):
        ik.Tracker(panda, reconfigure="no")


def test_the_reason_names_the_joint_that_ended_the_last_posture(arm):
    steps = follow(arm, turned(arm.fk(arm.home).homogeneous, 720.0, 2.0))
    reasons = {s.reason for s in steps if s.status is StepStatus.RECONFIGURING}
    assert any("another posture" in one and "wrist_roll" in one for one in reasons), reasons


def test_it_goes_through_joints_that_were_measured_late(panda):
    """The joints follow 20 ms late, and the target still is reached."""
    targets = turned(panda.fk(panda.home).homogeneous, 720.0, 2.0)
    tracker = ik.Tracker(panda, kappa=20.0, q0=panda.home, acceleration_limits=accelerations(panda))
    Q, statuses = [panda.home] * 3, set()
    for T in targets:
        step = tracker.update(T, DT, q=Q[-3])
        Q.append(step.q)
        statuses.add(step.status)
    assert StepStatus.RECONFIGURING in statuses and StepStatus.JUMPED not in statuses
    assert step.position_error < 1e-4 and keeps_limits(panda, np.array(Q[2:]), DT, accelerations(panda))


def test_nothing_is_touched_on_the_way(panda):
    """A wall beside the arm, into which it would swing on its way."""
    pose = np.eye(4)
    pose[:3, 3] = 0.3, -0.2, 0.5
    model = ik.CollisionModel(panda).add_box([1.5, 0.02, 1.5], pose, name="wall")
    targets = turned(panda.fk(panda.home).homogeneous, 720.0, 3.0)
    assert any(model.collides(q) for q in joints(panda, follow(panda, targets))[::5])
    steps = follow(panda, targets, avoid_collisions=model)
    assert not any(model.collides(q) for q in joints(panda, steps)) and steps[-1].position_error < 1e-4
    assert any(s.status is StepStatus.RECONFIGURING for s in steps)
    assert keeps_limits(panda, joints(panda, steps), DT, accelerations(panda))


def test_the_last_step_of_the_way_may_be_blocked(panda):
    """The target is known all the same: `update` raised ValueError when the arm was stuck there afterwards."""
    tracker, T = ik.Tracker(panda, q0=panda.home), panda.fk(panda.home).homogeneous[None]
    tracker.update(T[0], DT)
    way = tracker._ways[-1]
    way.goal, way._place = tracker.stepper.q + 1e-5, T
    assert (
        way.go(tracker.stepper.q, tracker.stepper.rate, T, 1.0, DT, DT, tracker.stepper.limits, tracker._code)
        and way.goal is None
    )
    way.blocked()
    assert gap(T, way._vain) == 0.0


def test_an_elbow_keeps_its_side(arm):
    elbow = {"elbow_pitch": float(np.sign(arm.home[arm.joint_names.index("elbow_pitch")]))}
    steps = follow(arm, turned(arm.fk(arm.home).homogeneous, 720.0, 2.0), elbow=elbow)
    side = joints(arm, steps)[:, arm.joint_names.index("elbow_pitch")] * elbow["elbow_pitch"]
    assert (side >= -1e-12).all()


@pytest.mark.parametrize("side", [1, -1])
def test_a_posture_on_the_other_side_does_not_turn_an_elbow_over(side):
    arm, q0 = ik.Robot.load("planar_3r"), side * np.array([0.1, 0.2, -0.6])
    tracker = ik.Tracker(arm, q0=q0, posture=-q0, elbow={"joint_2": side})
    assert min(side * tracker.update(arm.fk(q0).translation, 0.05).q[1] for _ in range(50)) >= -1e-12


def test_out_of_all_reach_nothing_changes(panda, arm):
    """Half a metre out of reach and back: the same commands, to the last bit, as without."""
    for robot in (panda, arm):
        T0 = robot.fk(robot.home).homogeneous
        way = np.concatenate([np.linspace(0.0, 1.0, 150), np.ones(250), np.linspace(1.0, 0.0, 150)])
        targets = np.repeat(T0[None], len(way), axis=0)
        targets[:, 0, 3] += 0.8 * robot.reach * way
        with_it, without = (follow(robot, targets, reconfigure=on) for on in (True, False))
        assert np.array_equal(joints(robot, with_it), joints(robot, without)), robot.name
        assert with_it[390].status is StepStatus.AT_LIMIT


def test_a_locked_joint_is_left_alone(panda):
    tracker = ik.Tracker(panda, q0=panda.home)
    tracker.change_limits(speed={"panda_joint3": 0.0})
    for T in turned(panda.fk(panda.home).homogeneous, 360.0, 2.0):
        assert tracker.update(T, DT).status is not StepStatus.RECONFIGURING


def test_what_was_lost_is_forgotten_where_the_target_is_reached_freely(arm):
    tracker, away = ik.Tracker(arm), arm.fk(arm.home).homogeneous
    tracker.update(away, DT)
    away[:3, 3] += (0.0, 0.0, 3.0)  # out of reach
    while not tracker._behind:
        tracker.update(away, DT)
    way = tracker._ways[-1]
    way._lost = 1.0
    back = arm.fk(tracker.q)
    for _ in range(30):
        tracker.update(back, DT)
    assert way._lost == 0.0 and not tracker._behind


@pytest.mark.parametrize("search", [True, False], ids=["during a search", "on the way"])
def test_a_joint_that_is_locked_meanwhile_ends_it(panda, search):
    tracker = ik.Tracker(panda, q0=panda.home)
    other = tracker._ways[-1]
    target = panda.fk(panda.home).homogeneous
    turn = exp(np.array([[0.0, 0.0, 0.02]]))[0]
    for _ in range(1000):
        target[:3, :3] = target[:3, :3] @ turn
        tracker.update(target, DT)
        if other._left if search else other.goal is not None:
            break
    assert other._left if search else other.goal is not None
    tracker.change_limits(speed={"panda_joint3": 0.0})
    for _ in range(30):
        target[:3, :3] = target[:3, :3] @ turn
        step = tracker.update(target, DT)
        assert step.status is not StepStatus.RECONFIGURING
    assert other.goal is None and not other._left


@pytest.mark.parametrize("what", ["posture", "leap"])
def test_a_joint_that_is_outside_its_limits_on_the_way_is_named(arm, what):
    robot = arm
    tracker = ik.Tracker(robot, q0=robot.home, acceleration_limits=accelerations(robot))
    targets = turned(robot.fk(robot.home).homogeneous, 360.0, 2.0)
    if what == "leap":
        targets[:] = robot.fk(robot.home + 0.3).homogeneous
    for T in targets:
        tracker.update(T, DT)
        way = next((way for way in tracker._ways if way.goal is not None), None)
        if way is not None and np.abs(tracker.stepper.rate).max() > 0.5:
            break
    joint = int(np.argmax(np.abs(tracker.stepper.rate)))
    side = "lower" if tracker.stepper.rate[joint] > 0.0 else "upper"
    beyond = tracker.q[joint] + np.sign(tracker.stepper.rate[joint]) * 0.02  # the joint goes on to its goal, inside
    tracker.change_limits(**{side: {robot.joint_names[joint]: beyond}})
    step = tracker.update(T, DT)
    assert way.goal is not None and step._outcome.way is not None
    assert step.status is StepStatus.RECOVERING and f"moving back: {robot.joint_names[joint]}" in step.reason
    for _ in range(100):
        step = tracker.update(T, DT)
    inside = step.q[joint] >= beyond - 1e-12 if side == "lower" else step.q[joint] <= beyond + 1e-12
    assert inside and step.status is not StepStatus.RECOVERING


def test_after_a_reset_a_tracker_does_as_a_new_one(panda):
    """Another search would draw other starts, or wait for the pause after one in vain, and end in another posture."""
    targets = turned(panda.fk(panda.home).homogeneous, 720.0, 3.0)[:900]
    away = targets[0].copy()
    away[:3, 3] += (2.0, 0.0, 0.0)
    new, used = (ik.Tracker(panda, q0=panda.home) for _ in range(2))
    first = [new.update(T, DT).q for T in targets]
    for T in [*targets, *[away] * 200]:
        used.update(T, DT)
    used.reset(panda.home)
    assert np.array_equal(first, [used.update(T, DT).q for T in targets])


def test_a_target_that_turns_back_does_not_stand(panda):
    """Turned beyond what this posture reaches and back: near its turning point it stood for 0.1 s, and the arm swung away."""
    phase = 0.6 * DT * np.arange(1, 1047)  # one period
    T0 = panda.fk(panda.home).homogeneous
    targets = np.repeat(T0[None], len(phase), axis=0)
    targets[:, :3, :3] = T0[:3, :3] @ exp(np.outer(3.7 * (1.0 - np.cos(phase)) / 2.0, [0.0, 0.0, 1.0]))
    steps = follow(panda, targets)
    assert not any(s.status is StepStatus.RECONFIGURING for s in steps)
    assert 0.3 < max(s.orientation_error for s in steps) < 0.7
