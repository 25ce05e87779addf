"""Limits on position, speed and acceleration hold at every sample."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as some
from references import MIMIC, Q0, keeps_limits, panda_reference
from robots import have_data, load

import ik_toolkit as ik
from ik_toolkit.errors import InvalidOption
from ik_toolkit.servo import viability
from ik_toolkit.servo.stepper import LIMIT_NAMES, changed_limits, limit_rows


def motions(count, steps, seed):
    """Joints driven at random, in steps of any length, against every kind of limit: q, rate, next q, next rate, h, gamma.

    What they are told to do is the worst for some of the time: as fast as allowed, this way and that.
    """
    rng = np.random.default_rng(seed)
    for gamma in (1.0, 0.5, 0.6, 0.55, 0.8, 0.3):
        late = 10.0 ** rng.uniform(-3.0, -0.5)
        limits = np.empty((4, count))
        limits[0] = rng.uniform(-3.0, 1.0, count)
        limits[1] = limits[0] + rng.choice([1e-3, 0.1, 1.0, 5.0], count)
        limits[2] = rng.choice([0.1, 1.0, 3.0, 20.0, np.inf], count)
        limits[3] = rng.choice([0.1, 1.0, 10.0, 100.0, np.inf], count)
        q, rate, code = rng.uniform(limits[0], limits[1]), np.zeros(count), np.zeros(count, np.uint8)
        side = np.ones(count)
        for _ in range(steps):
            h = late * rng.choice([0.01, 0.04, 0.2, 0.5, 1.0, rng.uniform(0.01, 1.0)])
            side[rng.random(count) < 0.05] *= -1.0
            x = np.where(rng.random(count) < 0.7, side * 1e9, rng.normal(size=count))
            before = q.copy(), rate.copy()
            viability.advance(q, rate, x, gamma, h, late, limits, code)
            assert not (code & viability.BIT.recovering).any()
            yield limits, *before, q, rate, h, gamma


def extremes(q, v, after, h, gamma):
    """Lowest and highest place, highest speed and acceleration [per the change of the rate] on the way of a step."""
    d = after - q
    if gamma == 1.0:
        return np.minimum(q, after), np.maximum(q, after), np.abs(d / h)
    bend = d - h * v
    with np.errstate(divide="ignore", invalid="ignore"):
        f = np.where(bend != 0.0, -h * v / (2.0 * bend), 0.0)
    turn = q + np.where((f > 0.0) & (f < 1.0), f * (h * v + f * bend), 0.0)
    return np.minimum(np.minimum(q, after), turn), np.maximum(np.maximum(q, after), turn), np.abs(2.0 * d / h - v)


@pytest.mark.parametrize("seed", range(3))
def test_limits_hold_in_steps_of_any_length_and_between_them(seed):
    """With dt drawn anew each time, position and speed along the polynomial that is executed, and its acceleration."""
    for limits, q, v, after, w, h, gamma in motions(300, 60, seed):
        low, high, speed = extremes(q, v, after, h, gamma)
        assert (after >= limits[0]).all() and (after <= limits[1]).all()
        assert (low >= limits[0] - 1e-12).all() and (high <= limits[1] + 1e-12).all()
        assert (speed <= limits[2] * (1.0 + 1e-9)).all()
        bend = (after - q - h * v) * 2.0 / h if gamma != 1.0 else w - v
        assert (np.abs(bend) <= limits[3] * h * (1.0 + 1e-9) + 1e-14 / h).all()  # rounding of q


def test_a_joint_outside_its_limits_comes_back_without_turning_round():
    limits = np.array([[-1.0] * 4, [1.0] * 4, [2.0] * 4, [np.inf, 5.0, 5.0, np.inf]])
    for gamma in (1.0, 0.5, 0.6):
        q, rate, code = np.array([1.3, 1.3, -1.2, 1.0 + 1e-9]), np.zeros(4), np.zeros(4, np.uint8)
        outside = [np.abs(q)]
        for _ in range(600):
            viability.advance(q, rate, np.array([9.0, 9.0, -9.0, 9.0]), gamma, 0.01, 0.05, limits, code)
            assert ((code & viability.BIT.recovering) > 0)[outside[-1] > 1.0 + 1e-12].all()
            outside.append(np.abs(q))
        excess = np.maximum(np.array(outside) - 1.0, 0.0)
        assert (np.diff(excess, axis=0) <= 0.0).all() and (excess[-1] <= 1e-12).all()
        assert (np.abs(rate) <= 0.2).all() and not (code & viability.BIT.recovering).any()


@pytest.mark.parametrize("gamma", [1.0, 0.5, 0.6, 0.8])
@pytest.mark.parametrize("speed", [0.0, 0.01])
def test_a_joint_that_may_hardly_move_any_more_comes_to_rest(gamma, speed):
    """One that moves slower than it can brake in a step swung to and fro for ever."""
    limits = np.array([[-9.0] * 4, [9.0] * 4, [speed] * 4, [4.0] * 4])
    q, rate, code = np.zeros(4), np.array([1.0, -1.0, 0.03, -0.03]), np.zeros(4, np.uint8)
    for _ in range(60):
        viability.advance(q, rate, np.zeros(4), gamma, 0.01, 0.05, limits, code)
    assert (rate == 0.0).all() and np.abs(q[2:]).max() <= 0.03 * 0.01


def test_a_limit_that_falls_below_the_speed_is_met_with_full_deceleration():
    limits = np.array([[-9.0], [9.0], [1.0], [4.0]])
    q, rate, code = np.zeros(1), np.array([2.0]), np.zeros(1, np.uint8)
    for k in range(30):
        viability.advance(q, rate, np.array([9.0]), 1.0, 0.01, 0.05, limits, code)
        assert rate[0] == pytest.approx(max(2.0 - 0.04 * (k + 1), 1.0), abs=1e-12)
        assert bool(code[0] & viability.BIT.recovering) == (k < 24)


@settings(max_examples=16, deadline=None, derandomize=True)
@given(
    name=some.sampled_from(["panda", "planar_2r", "hydrolek_7w", "inspection_7dof", "mimic"]),
    method=some.sampled_from(["cv", "av", "ca", "aa", "aad", "dls"]),
    dt=some.sampled_from([0.001, 0.01, 0.04]),
    acceleration=some.floats(1.0, 40.0),
    pose=some.booleans(),
    seed=some.integers(0, 10_000),
)
def test_limits_hold_at_every_sample(name, method, dt, acceleration, pose, seed):
    """Paths anywhere, mostly out of reach or through singularities: position, speed and acceleration stay inside."""
    robot = load(MIMIC if name == "mimic" else name)
    rng = np.random.default_rng(seed)
    point = rng.uniform(-1.2, 1.2, 3) * robot.reach
    start = pin.SE3(pin.exp3(rng.normal(size=3)), point).homogeneous if pose else point
    radius, normal, turns = rng.uniform(0.05, 1.0) * robot.reach, rng.normal(size=3), rng.uniform(0.5, 4)
    duration = min(2.0, 500.0 * dt)  # as fast as in two seconds; a lost run takes ten times as long
    ref = ik.circle(start, radius, normal=normal, turns=turns * duration / 2.0, duration=duration)
    run = ik.track(robot, ref, method, dt=dt, q0=robot.random_q(rng), acceleration_limits=acceleration)
    assert keeps_limits(robot, run.q, dt, acceleration * (1 + 1e-6))
    assert run.status.name in ("COMPLETED", "SLOWED", "LEFT", "LOST")


def test_a_large_error_is_closed_without_swinging(panda):
    """164 mm off, at 1 kHz, with acceleration limits: the one-step methods would swing for ever if only clipped."""
    start = Q0 + 3 * np.array([0.05, -0.05, 0.05, 0.05, -0.05, 0.05, 0.05])
    a = [15, 7.5, 10, 12.5, 15, 20, 20]
    for method in ("cv", "av", "ca", "aad"):
        ref = panda_reference(panda, True, 3.0)
        run = ik.track(panda, ref, method, dt=0.001, q0=start, acceleration_limits=a, on_limit="leave")
        assert run.position_error[0] > 0.16
        assert run.position_error[600:].max() < 1e-6


def test_limit_options_are_checked(panda):
    for options, words in (
        (dict(limits=False, acceleration_limits=1.0), "limits=True"),
        (dict(acceleration_limits=[1.0, 2.0]), "7 numbers"),
        (dict(acceleration_limits=-1.0), "positive"),
    ):
        with pytest.raises(InvalidOption, match=words):
            ik.track(panda, panda_reference(panda, True, 1.0), **options)


def test_limits_are_in_the_units_of_the_loop_and_change_only_where_they_are_given():
    """A slide counts in reaches there: what goes in as metres comes back as metres."""
    arm = ik.Robot.load("inspection_7dof")
    unit = np.where(np.array(arm.joint_kinds) == "prismatic", arm.chain.scale, 1.0)
    assert (unit != 1.0).any()
    acceleration = np.linspace(1.0, 2.0, arm.n)
    rows = limit_rows(arm, True, acceleration)
    speed = np.where(np.array(arm.velocity_limits) > 0.0, arm.velocity_limits, np.inf)
    np.testing.assert_allclose(rows * unit, [arm.lower, arm.upper, speed, acceleration], rtol=1e-12)
    kept = rows.copy()
    changed = changed_limits(arm, rows, {"lower": None, "upper": None, "speed": {"lift": 0.05}, "acceleration": 3.0})
    lift = arm.joint_names.index("lift")
    wanted = kept * unit
    wanted[2, lift], wanted[3] = 0.05, 3.0
    np.testing.assert_allclose(changed * unit, wanted, rtol=1e-12)
    at_start, turn = arm.lower + 0.01, arm.joint_names[-1]
    np.testing.assert_allclose(  # an array and a joint by name: the others keep what they had
        changed_limits(arm, rows, {**dict.fromkeys(LIMIT_NAMES), "lower": at_start, "upper": {turn: 0.4}})[:2] * unit,
        [at_start, np.where(np.array(arm.joint_names) == turn, 0.4, arm.upper)], rtol=1e-12,
    )  # fmt: skip
    assert np.array_equal(rows, kept)  # a refused change must leave nothing behind
    same = {"lower": arm.home, "upper": arm.home, "speed": 0.0, "acceleration": None}
    locked = changed_limits(arm, rows, same)  # a joint may be locked where it stands
    np.testing.assert_allclose(locked[:2] * unit, [arm.home, arm.home], rtol=1e-12)


@pytest.mark.parametrize(
    ("method", "second", "cubic", "jump"), [("ca", 1, 1, 0), ("aa", 1, 1, 0), ("aad", 5 / 6, 4 / 3, 1 / 6)]
)
def test_accelerations_between_samples_are_what_the_guide_says(method, second, cubic, jump):
    """Second differences of q, a cubic through q and rate, and a parabola from q and rate to the next q, in full steps."""
    robot, h, most = ik.Robot.load("hydrolek_7w"), 0.01, 2.0
    tracker = ik.Tracker(robot, method, acceleration_limits=most)
    target, Q, V = robot.fk(robot.home).homogeneous, [robot.home], [np.zeros(robot.n)]
    for k in range(200):
        target[:3, 3] += 0.01 * np.array([np.sin(k / 7), np.cos(k / 5), np.sin(k / 3)])
        step = tracker.update(target, h)
        Q.append(step.q)
        V.append(step.rate)
    mean, before, after = np.diff(Q, axis=0) / h, np.array(V[:-1]), np.array(V[1:])
    ends = 6.0 * mean - 4.0 * before - 2.0 * after, 6.0 * mean - 2.0 * before - 4.0 * after
    unit = most * h
    assert np.abs(np.diff(mean, axis=0)).max() == pytest.approx(second * unit)
    assert np.abs(ends).max() == pytest.approx(cubic * unit)
    assert np.abs(2.0 * (mean - before)).max() == pytest.approx(unit)
    assert np.abs(2.0 * mean - before - after).max() == pytest.approx(jump * unit, rel=1e-6, abs=1e-12)


@pytest.mark.skipif(not have_data(), reason="needs example-robot-data")
@pytest.mark.parametrize(("method", "acceleration", "most"), [("cv", None, 0.1), ("aad", None, 0.2), ("cv", 10.0, 0.3)])
def test_a_target_too_fast_for_the_joints_is_followed_straight(method, acceleration, most):
    """Along lines of 120 mm at 6 m/s, beside a tracker that leaves them as little as it can in time."""
    robot, rng, off = load("panda"), np.random.default_rng(5), {"direct": [], "leave": []}
    for _ in range(12):
        q0, way = robot.home + rng.uniform(-0.3, 0.3, robot.n), rng.normal(size=3)
        way /= np.linalg.norm(way)
        for mode, found in off.items():
            tracker = ik.Tracker(robot, method, q0=q0, acceleration_limits=acceleration, on_limit=mode)
            start, target, tips = robot.fk(q0).translation, robot.fk(q0).homogeneous, []
            for k in range(1, 40):
                target[:3, 3] = start + (min(0.06 * k, 0.12) + 1e-6 * k) * way  # it moves on, so that it is no leap
                tips.append(robot.fk(tracker.update(target, 0.01).q).translation - start)
            found.append(np.linalg.norm(np.cross(tips, way), axis=1).max())
    assert np.median(off["direct"]) < most * np.median(off["leave"])


LAZY = """<robot name="lazy"><link name="base"/><link name="arm"/><link name="hand"/><link name="tip"/>
<joint name="lift" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 -1 0"/>
<limit lower="-3" upper="3" velocity="0.1" effort="1"/></joint>
<joint name="turn" type="continuous"><parent link="arm"/><child link="hand"/>
<origin xyz="0.5 0 0"/><axis xyz="0 -0.000001 1"/></joint>
<joint name="end" type="fixed"><parent link="hand"/><child link="tip"/><origin xyz="0.5 0 0"/></joint></robot>"""


@pytest.mark.parametrize("on_limit", ["direct", "leave"])
@pytest.mark.parametrize("method", ["cv", "av", "ca", "aa", "aad"])
def test_a_joint_without_limits_does_not_spin_for_one_that_is_too_slow(method, on_limit):
    """The lift is too slow for the target; the other joint can raise the tip by 0.5 um a radian and has no limit at all."""
    robot = ik.Robot.load(LAZY, tip="tip")
    tracker = ik.Tracker(robot, method, q0=[0.0, 0.0], on_limit=on_limit, mask=[0, 0, 1, 0, 0, 0])
    for k in range(20):
        step = tracker.update([1.0, 0.0, 0.004 * k], 0.01)
    assert step.status is ik.StepStatus.LIMITED and step.reason == "speed limit on lift"
    assert step.q[0] > 0.017 and abs(step.q[1]) < 1e-4


@pytest.mark.parametrize("method", ["cv", "ca"])
def test_a_sliding_joint_without_limits_goes_as_far_in_a_step_as_its_target(method):
    """The bound of half a turn is not for it: pi in its unit of length is some metres."""
    model = pin.Model()
    for name, joint in (("rail", pin.JointModelPX()), ("a", pin.JointModelRZ()), ("b", pin.JointModelRZ())):
        place = pin.SE3(np.eye(3), np.array([0.3, 0.0, 0.0]))
        model.addJointFrame(model.addJoint(model.njoints - 1, joint, place, name))
    model.addFrame(pin.Frame("tip", 3, 0, place, pin.FrameType.OP_FRAME))
    model.lowerPositionLimit[:], model.upperPositionLimit[:], model.velocityLimit[:] = -np.inf, np.inf, np.inf
    robot = ik.Robot(model=model, tip="tip")
    start = robot.fk(robot.home).translation
    run = ik.track(
        robot, ik.line(start, start + np.array([100.0, 0.0, 0.0]), duration=10.0), method, dt=1.0, q0=robot.home
    )
    assert run.success and run.position_error.max() < 1e-6
