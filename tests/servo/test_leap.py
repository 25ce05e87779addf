"""A target that leaps and then stands: reached as fast as limits allow, straight where that costs little."""

import math

import numpy as np
import pytest
from references import accelerations, keeps_limits, least_time
from robots import have_data

import ik_toolkit as ik
from ik_toolkit.errors import InvalidOption
from ik_toolkit.servo.step import StepStatus

DT = 0.01


def pairs(robot, count, seed=0, sizes=(0.2, 0.6)):
    """Joint values, and others that far away [rad] in every joint: starts and goals."""
    rng = np.random.default_rng(seed)
    low, high = np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi)
    room = 0.1 * (high - low)
    for _ in range(count):
        q = rng.uniform(low + room, high - room)
        yield q, np.clip(q + rng.uniform(*sizes, robot.n) * rng.choice([-1, 1], robot.n), low, high)


def follow(robot, q0, target, seconds, accelerate=False, method="cv", **options):
    """Steps at the start's own pose, then towards a target that stands."""
    limits = accelerations(robot) if accelerate else None
    tracker = ik.Tracker(robot, method, q0=q0, rate0=np.zeros(robot.n), acceleration_limits=limits, **options)
    return [tracker.update(robot.fk(q0) if k == 0 else target, DT) for k in range(round(seconds / DT))]


def time_back(robot, q0, steps, accelerate):
    """Time [s] until the error stays within 1 mm (angles at 0.2 m), and the least that the joints need for the way they went."""
    error = [math.hypot(s.position_error, 0.2 * (s.orientation_error or 0.0)) for s in steps[1:]]
    back = max((k for k, e in enumerate(error) if e > 1e-3), default=-1) + 1
    assert back < len(error), "not reached"
    return (back + 1) * DT, least_time(robot, steps[back + 1].q - q0, accelerations(robot) if accelerate else None)


def off_the_line(robot, q0, steps):
    """Farthest distance [m] of the tip from the line between its places at the start and at the end."""
    p = np.array([robot.fk(q).translation for q in [q0, *(s.q for s in steps)]])
    along = (p[-1] - p[0]) / np.linalg.norm(p[-1] - p[0])
    return np.linalg.norm(np.cross(p - p[0], along), axis=1).max()


@pytest.mark.parametrize(("method", "accelerate"), [("cv", False), ("cv", True), ("aad", True), ("ca", True)])
@pytest.mark.parametrize("name", ["panda", "ur5", "hydrolek_7w", "kinova"])
def test_back_within_the_joints_own_time(name, method, accelerate):
    robot = ik.Robot.load(name)
    for q0, q1 in pairs(robot, 2):
        steps = follow(robot, q0, robot.fk(q1), 4.0, accelerate, method)
        seconds, bound = time_back(robot, q0, steps, accelerate)
        assert seconds <= 1.3 * bound + DT, (q0, seconds, bound)
        most = accelerations(robot) if accelerate and method == "cv" else np.inf
        assert keeps_limits(robot, np.array([q0, *(s.q for s in steps)]), DT, most)
        assert steps[-1].position_error < 1e-5


@pytest.mark.parametrize(("name", "accelerate"), [("planar_3r", True), ("z1", False), ("talos_arm", True)])
def test_back_where_the_solver_does_not_get_from_here(name, accelerate):
    """Goals with a joint near its limit: feedback ends there and needs up to three times as long."""
    robot = ik.Robot.load(name)
    rng = np.random.default_rng(5)
    low, high = np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi)
    for q0, q1 in pairs(robot, 6, seed=6, sizes=(0.3, 1.0)):
        i = rng.integers(robot.n)
        q1[i] = rng.choice([low[i] + 1e-3, high[i] - 1e-3])
        steps = follow(robot, q0, robot.fk(q1), 8.0, accelerate)
        seconds, bound = time_back(robot, q0, steps, accelerate)
        assert seconds <= 1.3 * bound + 2.0 * DT, (q0, seconds, bound)


@pytest.mark.parametrize("dt", [0.002, 0.01])
def test_a_measured_target_trembles(panda, dt):
    """By 0.1 mm from sample to sample: it stands all the same, which is seen after 0.1 s."""
    rng = np.random.default_rng(1)
    for q0, q1 in pairs(panda, 2, seed=2, sizes=(0.4, 0.8)):
        tracker = ik.Tracker(panda, q0=q0, rate0=np.zeros(7), acceleration_limits=accelerations(panda))
        tracker.update(panda.fk(q0), dt)
        T, taken = panda.fk(q1).homogeneous, 0.0
        for _ in range(round(3.0 / dt)):
            taken += dt
            shaken = T.copy()
            shaken[:3, 3] += rng.normal(scale=1e-4, size=3)
            step = tracker.update(shaken, dt)
            if step.position_error < 1e-3:
                break
        bound = least_time(panda, step.q - q0, accelerations(panda))
        assert taken <= 1.3 * bound + 0.1 + dt, (taken, bound)


@pytest.mark.parametrize("accelerate", [False, True])
def test_straight_where_that_costs_little(panda, accelerate):
    """And, where somebody wants that, wherever there is a straight way."""
    chosen = []
    for q0, q1 in pairs(panda, 6, seed=4, sizes=(0.05, 0.25)):
        ways = {}
        for most in (None, math.inf, 1e-3):  # None: the default of 1.2
            steps = follow(panda, q0, panda.fk(q1), 4.0, accelerate, **({} if most is None else {"straight": most}))
            straight = {"going straight" in s.reason for s in steps if s.reason.startswith("the target jumped")}
            ways[most] = off_the_line(panda, q0, steps)
            if True in straight:
                assert len(straight) == 1
                length = np.linalg.norm(panda.fk(q1).translation - panda.fk(q0).translation)
                assert ways[most] < 0.01 * length + 1e-3
            chosen.append((most, True in straight))
        assert ways[math.inf] <= ways[1e-3] + 1e-9
    for most, least, largest in ((None, 1, 5), (math.inf, 5, 6), (1e-3, 0, 0)):
        assert least <= sum(was for m, was in chosen if m == most) <= largest, most


def test_what_it_says(panda):
    q0, q1 = next(pairs(panda, 1))
    steps = follow(panda, q0, panda.fk(q1), 2.0, straight=1e-3)
    jumped = [s for s in steps if s.reason.startswith("the target jumped")]
    assert len(jumped) > 5 and all(s.status is StepStatus.LIMITED for s in jumped)
    assert "in joint space, as a straight line would take" in jumped[0].reason
    assert steps[-1].status is StepStatus.OK and steps[-1].reason == ""
    for wrong in (0.0, -1.0, math.nan, "yes", np.array([1.2, 1.2])):
        with pytest.raises(InvalidOption, match="straight"):
            ik.Tracker(panda, straight=wrong)


@pytest.mark.parametrize(
    ("method", "gains"), [("cv", {"kappa": 2.0}), ("av", {"share": 0.02}), ("aad", {"share": 0.02})]
)
def test_gains_that_somebody_chose_stay(panda, method, gains):
    """Gentle feedback is what was asked for: the error falls by exp(-kappa t), not as fast as limits allow."""
    q1 = panda.home + 0.1
    steps = follow(panda, panda.home, panda.fk(q1), 1.0, method=method, **gains)
    error = np.array([s.position_error for s in steps])
    assert not any("jumped" in s.reason for s in steps)
    assert not any("slowly" in s.reason for s in steps)
    assert error[80] == pytest.approx(error[30] * (1.0 - 2.0 * DT) ** 50, rel=0.02)


def test_a_target_that_goes_on_ends_it(panda):
    """The target moves on while the arm is under way: followed again, inside all limits."""
    q0, q1 = next(pairs(panda, 1))
    T = panda.fk(q1).homogeneous
    tracker = ik.Tracker(panda, q0=q0, rate0=np.zeros(7), acceleration_limits=accelerations(panda))
    tracker.update(panda.fk(q0), DT)
    Q = [q0, tracker.q]
    for k in range(300):
        T[0, 3] -= 0.0005 if 5 < k < 200 else 0.0
        step = tracker.update(T, DT)
        Q.append(step.q)
        assert not ("jumped" in step.reason and 10 < k < 200)
    assert step.position_error < 1e-4
    assert keeps_limits(panda, np.array(Q), DT, accelerations(panda))


def test_nothing_is_touched(panda):
    """A wall between start and goal: slid along, never touched."""
    pose = np.eye(4)
    pose[:3, 3] = 0.55, 0.0, 0.6
    model = ik.CollisionModel(panda).add_box([0.3, 0.02, 0.6], pose, name="wall")
    q0, q1 = panda.home.copy(), panda.home.copy()
    q0[0], q1[0] = -0.6, 0.6
    free = follow(panda, q0, panda.fk(q1), 3.0)
    assert any(model.collides(s.q) for s in free)
    steps = follow(panda, q0, panda.fk(q1), 3.0, avoid_collisions=model)
    assert not any(model.collides(s.q) for s in steps)
    assert steps[-1].status is not StepStatus.OK or steps[-1].position_error < 1e-3


def test_two_arms():
    """One tip's target leaps; the other's stays, and its tip ends there."""
    robot = ik.Tree.load("brokk_hydrolek")
    home, tip, q1 = robot.fk(robot.home), robot.tips[0], robot.home.copy()
    q1[robot.places[0]] += 0.2
    tracker = ik.Tracker(robot, q0=robot.home, rate0=np.zeros(robot.n), acceleration_limits=accelerations(robot))
    steps = [tracker.update(home | {tip: robot.fk(q1)[tip]} if k else home, DT) for k in range(400)]
    assert any("jumped" in s.reason for s in steps) and steps[-1].position_error < 1e-4
    seconds, bound = time_back(robot, robot.home, steps, accelerate=True)
    assert seconds <= 1.3 * bound + DT


@pytest.mark.skipif(not have_data(), reason="needs example-robot-data")
@pytest.mark.parametrize(
    ("on_limit", "method"), [("direct", "cv"), ("direct", "aad"), ("leave", "cv"), ("leave", "aad")]
)
def test_a_slow_joint_is_spared_where_others_reach_the_target(on_limit, method):
    """The PR2's torso rises by 13 mm a second: its arms reach the targets in a sixth of a second without it."""
    robot, rng = ik.Tree.load("pr2"), np.random.default_rng(1)
    assert robot.joint_names[0] == "torso_lift_joint" and robot.velocity_limits[0] < 0.02
    speed = np.where(robot.velocity_limits > 0.0, robot.velocity_limits, 1.0)
    for _ in range(3):
        goal = robot.home + np.append(0.0, rng.uniform(-0.4, 0.4, robot.n - 1))
        targets = robot.fk(np.clip(goal, robot.lower, robot.upper))
        tracker = ik.Tracker(robot, method, acceleration_limits=5.0 * speed, on_limit=on_limit)
        steps = [tracker.update(targets, DT) for _ in range(200)]
        assert max(s.position_error for s in steps[-20:]) < 1e-3
