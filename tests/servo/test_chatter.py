"""No chatter: no joint turns back more than three times in a tenth of a second at 5 % of its speed limit or more."""

import numpy as np
import pinocchio as pin
import pytest
from references import most_turns
from robots import have_data, load

import ik_toolkit as ik

DT = 0.01  # s


def stream(robot, seed, place):
    """Targets (400, 3) around a place, in reaches from the base, and a start: slow swings of up to a quarter of the reach."""
    rng = np.random.default_rng(seed)
    q0 = robot.random_q(rng)
    start, way = robot.fk(q0).translation, rng.normal(size=3)
    size, tempo, phase = rng.choice([0.03, 0.1, 0.25]), rng.uniform(0.1, 1.5, 3), rng.uniform(0.0, 2.0 * np.pi, 3)
    t = DT * np.arange(400)[:, None]
    share = np.minimum(t, 1.0) ** 2 * (3.0 - 2.0 * np.minimum(t, 1.0))
    swings = size * robot.reach * share * np.sin(2.0 * np.pi * tempo * t + phase)
    return q0, start + share * (place * robot.reach * way / np.linalg.norm(way) - start) + swings


@pytest.mark.parametrize("method", ["cv", "aad"])
@pytest.mark.parametrize("name", ["hydrolek_7w", "inspection_7dof", "planar_3r", "panda", "ur5"])
def test_none_where_limits_and_the_edge_of_reach_take_turns(name, method):
    robot = ik.Robot.load(name)
    for seed in range(6):
        q0, targets = stream(robot, seed, (0.6, 0.95, 1.3)[seed % 3])
        tracker = ik.Tracker(robot, method, q0=q0)
        Q = np.array([q0, *(tracker.update(target, DT).q for target in targets)])
        assert most_turns(Q, robot.velocity_limits) <= 3, seed


def before_a_box(seed):
    """A Panda, joint values free of contact, and poses of the tip there and inside a box."""
    robot, rng = load("panda"), np.random.default_rng(seed)
    while True:
        q0, q1 = robot.random_q(rng), robot.random_q(rng)
        begin, end = (pin.SE3(robot.fk(q).homogeneous) for q in (q0, q1))
        size = tuple(robot.reach * rng.uniform(0.1, 0.6, 3))
        model = ik.CollisionModel(robot).add_box(size, end.homogeneous, "box")
        if not model.collides(q0):
            return robot, model, q0, begin, end


@pytest.mark.skipif(not have_data(), reason="needs example-robot-data")
@pytest.mark.parametrize("seed", [6, 9])
def test_none_before_a_box(seed):
    """The nearest points of an edge along a face leap from end to end: joints turned back in every sample."""
    robot, model, q0, begin, end = before_a_box(seed)
    tracker, Q = ik.Tracker(robot, "cv", q0=q0, avoid_collisions=model), [q0]
    for k in range(600):
        target = pin.SE3.Interpolate(begin, end, min(k / 200, 1.0))
        target.translation += [0.02 * np.sin(0.01 * k), 0.0, 0.0]
        Q.append(tracker.update(target.translation, DT).q)
    assert most_turns(np.array(Q), robot.velocity_limits) <= 3


@pytest.mark.skipif(not have_data(), reason="needs example-robot-data")
def test_none_among_boxes_where_steps_are_refused():
    """The turns of steps in place of refused ones count as well: joints of a UR5 turned back four times."""
    robot, rng = load("ur5"), np.random.default_rng(1009)
    T, model = robot.fk(robot.home), ik.CollisionModel(robot)
    while len(model.obstacles) < 4:
        middle, size = T.translation + rng.uniform(-0.4, 0.4, 3), rng.uniform(0.05, 0.2, 3)
        if not ik.CollisionModel(robot).add_box(size, middle).collides(robot.home):
            model.add_box(size, middle, f"box{len(model.obstacles)}")
    phase, tempo = rng.uniform(0, 6, 6)[:3], rng.uniform(0.5, 3)
    tracker, Q = ik.Tracker(robot, "ca", avoid_collisions=model), [robot.home]
    for k in range(800):
        target = T.homogeneous
        target[:3, 3] += 0.3 * (np.sin(k * DT * tempo * np.array([1.1, 1.7, 0.8]) + phase) - np.sin(phase))
        Q.append(tracker.update(target, DT).q)
    assert most_turns(np.array(Q), robot.velocity_limits) <= 3


@pytest.mark.slow
@pytest.mark.skipif(not have_data(), reason="needs example-robot-data")
def test_none_before_a_box_where_the_clock_waits():
    robot, model, q0, begin, end = before_a_box(9)
    reference = ik.line(begin.homogeneous, end.homogeneous, duration=2.0, law="minimum-jerk")
    run = ik.track(robot, reference, q0=q0, avoid_collisions=model)
    assert run.status.name == "LOST" and most_turns(run.q, robot.velocity_limits) <= 3


@pytest.mark.parametrize("method", ["cv", "aad"])
def test_a_fast_vibration_is_followed_again_after_a_limit_was_met(method):
    """What calms a swing hinders the joints, too: it went on for ever."""
    robot = ik.Robot.load("inspection_7dof")
    q0 = 0.5 * (robot.lower + robot.upper) + 0.4
    target, errors = robot.fk(np.clip(q0, robot.lower + 0.1, robot.upper - 0.1)).homogeneous, []
    tracker = ik.Tracker(robot, method, q0=np.clip(q0, robot.lower + 0.1, robot.upper - 0.1))
    for k in range(1, 400):
        now = target.copy()
        now[:3, 3] += 0.0005 * min(k / 60, 1.0) * np.sin(2.0 * np.pi * 12.0 * 0.005 * k)
        now[2, 3] += 0.2 * (k == 100)
        errors.append(tracker.update(now, 0.005).position_error)
    assert max(errors[99:110]) > 0.05 and max(errors[300:]) < 1e-4
