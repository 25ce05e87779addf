"""Tracking on robots: dJ/dt, the published accuracy, limits, the control-loop interface, results and the command."""

import json
import warnings

import numpy as np
import pinocchio as pin
import pytest
from folders import read_data
from hypothesis import given, settings
from hypothesis import strategies as some
from robots import have_data

import ik_toolkit as ik
from ik_toolkit.cli import main
from ik_toolkit.errors import IKError, InvalidConfiguration, InvalidOption, InvalidTarget
from ik_toolkit.kernel import motion
from ik_toolkit.kernel.algebra import at3
from ik_toolkit.kernel.jit import cached
from ik_toolkit.kernel.kinematics import fk, room
from ik_toolkit.kernel.problem import fill
from ik_toolkit.kernel.records import TASK
from ik_toolkit.papers import patko_2019 as paper
from ik_toolkit.robot.robot import Robot
from ik_toolkit.tracking.methods import make_method, simulate
from ik_toolkit.tracking.reference import Reference, circle, line
from ik_toolkit.tracking.track import StepStatus, Tracker, track

ORACLE = read_data("tracking")
Q0 = np.array([0.0, -np.pi / 4, 0.0, -3 * np.pi / 4, 0.0, np.pi / 2, np.pi / 4])
MIMIC = """<robot name="mimic"><link name="b"/><link name="l1"/><link name="l2"/><link name="l3"/><link name="tip"/>
<joint name="a" type="revolute"><parent link="b"/><child link="l1"/><origin xyz="0.1 0 0.3" rpy="0.2 0.4 0"/><axis xyz="0 0.6 0.8"/>
<limit lower="-2" upper="2" velocity="2" effort="1"/></joint>
<joint name="s" type="prismatic"><parent link="l1"/><child link="l2"/><origin xyz="0.2 0.1 0" rpy="0 0.5 0"/><axis xyz="1 0 0"/>
<limit lower="-0.5" upper="0.5" velocity="1" effort="1"/></joint>
<joint name="f" type="revolute"><parent link="l2"/><child link="l3"/><origin xyz="0 0.3 0.1"/><axis xyz="0 1 0"/>
<limit lower="-2" upper="2" velocity="2" effort="1"/><mimic joint="a" multiplier="-0.7" offset="0.3"/></joint>
<joint name="w" type="continuous"><parent link="l3"/><child link="tip"/><origin xyz="0.3 0 0" rpy="0.1 0 0.2"/>
<axis xyz="0.8 0 0.6"/><limit velocity="3" effort="1"/></joint></robot>"""
METHODS = paper.METHODS
DATA = pytest.mark.skipif(not have_data(), reason="example-robot-data is not installed (extra 'robots')")


@pytest.fixture(scope="module")
def panda():
    return Robot.load("panda")


@pytest.fixture(scope="module")
def planar():
    return Robot.load("planar_2r")


def panda_reference(robot, pose, duration=12.6):
    """Circle of 0.1 m from the tip at Q0, 1 rad/s, world xy; the pose also tilts by 0.3 sin t about y."""
    T0 = robot.fk(Q0).homogeneous

    def function(t):
        T, V, A = np.tile(np.eye(4), (len(t), 1, 1)), np.zeros((len(t), 6)), np.zeros((len(t), 6))
        T[:, :3, 3] = T0[:3, 3] + 0.1 * np.stack([np.cos(t) - 1, np.sin(t), 0 * t], 1)
        V[:, 0], V[:, 1] = -0.1 * np.sin(t), 0.1 * np.cos(t)
        A[:, 0], A[:, 1] = -0.1 * np.cos(t), -0.1 * np.sin(t)
        T[:, :3, :3] = T0[:3, :3]
        if pose:
            T[:, :3, :3] = [pin.exp3(np.array([0.0, 0.3 * np.sin(x), 0.0])) @ T0[:3, :3] for x in t]
            V[:, 4], A[:, 4] = 0.3 * np.cos(t), -0.3 * np.sin(t)
        return T, V, A

    return Reference(function, duration, position_only=not pose)


# ------------------------------------------------------------------------------------------------ rate of the Jacobian
@cached
def _rate(rows, ends, q, x, y, out):
    n = q.shape[0]
    size, angles = room(rows.shape[0])
    joints, trig, J = np.empty(size), np.zeros(angles), np.empty((n, 6))
    now = fk(rows, q, joints, trig)
    tip = now.point + now.axes.times(at3(ends, 21))
    fill(rows, np.zeros(TASK), np.empty(0), joints, tip, J, 0)
    motion.jacobian_rate(rows, joints, J, tip, x, y, out)


def jacobian_rate(robot, q, x, y):
    """(dJ/dt along x) y by the kernel, base axes, metres."""
    chain, out = robot.chain, np.empty(6)
    ends = chain.ends
    _rate(chain.rows, ends, q / chain.unit, x / chain.unit, y / chain.unit, out)
    base = ends[:9].reshape(3, 3)
    return np.concatenate([base @ out[:3] * chain.scale, base @ out[3:]])


@pytest.mark.parametrize("name", ["panda", "hydrolek_7w", "inspection_7dof", "planar_2r", "cartesian_pp"])
def test_jacobian_rate_is_pinocchios(name):
    robot = Robot.load(name)
    model, data = robot.model, robot.model.createData()
    path = [model.joints[model.getJointId(j)].idx_v for j in robot.joint_names]
    frame = model.getFrameId(robot.tip, pin.FrameType.BODY)
    rng = np.random.default_rng(3)
    for _ in range(20):
        q, x, y = robot.random_q(rng), rng.normal(size=robot.n), rng.normal(size=robot.n)
        v = np.zeros(model.nv)
        v[path] = x
        full = robot.to_pinocchio(q)
        pin.computeJointJacobiansTimeVariation(model, data, full, v)
        pin.updateFramePlacements(model, data)
        dJ = pin.getFrameJacobianTimeVariation(model, data, frame, pin.LOCAL_WORLD_ALIGNED)[:, path]
        assert jacobian_rate(robot, q, x, y) == pytest.approx(dJ @ y, abs=1e-12)
        pin.forwardKinematics(model, data, full, v, np.zeros(model.nv))
        a = pin.getFrameClassicalAcceleration(model, data, frame, pin.LOCAL_WORLD_ALIGNED).vector
        assert jacobian_rate(robot, q, x, x) == pytest.approx(a, abs=1e-12)


def test_jacobian_rate_with_mimic_slide_base_and_tool():
    """Against differences of Pinocchio's Jacobian, on what the direct comparison cannot take."""
    tool = pin.SE3(pin.exp3(np.array([0.2, 0.1, -0.4])), np.array([0.1, 0.2, 0.05])).homogeneous
    robots = (
        Robot.load(MIMIC),
        Robot.load(MIMIC).with_tool(tool),
        Robot.load("brokk_hydrolek", tip="left_tip"),
        Robot.load("inspection_7dof", base="link_1"),
    )
    rng = np.random.default_rng(4)
    for robot in robots:
        for _ in range(5):
            q, x, y = robot.random_q(rng), rng.normal(size=robot.n), rng.normal(size=robot.n)
            h = 1e-5
            dJ = (robot.jacobian(q + h * x) - robot.jacobian(q - h * x)) / (2 * h)
            assert jacobian_rate(robot, q, x, y) == pytest.approx(dJ @ y, abs=1e-7)


# ------------------------------------------------------------------------------------------------ accuracy
PANDA_ROWS = {
    "cv_fixed_gain": ("cv", lambda h: {"kappa": 5.5}, 2),
    "cv_scaled_gain": ("cv", lambda h: {}, 3),
    "av": ("av", lambda h: {}, 2),
    "ca_fixed_gain": ("ca", lambda h: {"kp": 110.0, "kd": 6.5}, 2),
    "ca_scaled_gain": ("ca", lambda h: {"kp": 1.6 / h**2, "kd": 0.8 / h}, 3),
    "aa1": ("aa", lambda h: {"reading": 1}, 3),
    "aa2": ("aa", lambda h: {}, 3),
    "aa3": ("aa", lambda h: {"reading": 3}, 3),
    "aad": ("aad", lambda h: {"gamma": 1.0}, 3),
}


@pytest.mark.parametrize("row", PANDA_ROWS)
@pytest.mark.parametrize("pose", [True, False], ids=["pose", "position"])
def test_panda_errors_and_orders(panda, row, pose):
    """Settled errors of a redundant arm against the oracle; the order in h needs all three changes for redundancy."""
    method, options, order = PANDA_ROWS[row]
    tables = ORACLE["panda"]
    wanted = tables["pose_exact_position_m" if pose else "pos_exact_position_m"][row]
    got, turned = [], []
    for h in wanted["h"]:
        run = track(panda, panda_reference(panda, pose), method, dt=h, q0=Q0, limits=False, **options(h))
        assert not run.damped.any()
        got.append(run.figures["position"]["settled_max"])
        turned.append(run.figures["orientation"]["settled_max"] if pose else 0.0)
    assert got == pytest.approx(wanted["max"], rel=0.01)
    if pose:
        assert turned == pytest.approx(tables["pose_exact_rotation_rad"][row]["max"], rel=0.01)
    assert np.log2(got[-2] / got[-1]) == pytest.approx(order, abs=0.1)


@pytest.mark.parametrize("key", METHODS)
def test_rr_absolute_and_relative_angles(planar, key):
    """The paper's RR arm (absolute angles) and the URDF arm (relative) move the tip along the same path."""
    case, gains = paper.CASES["RR"], paper.SETS["RR good"]
    steps = 40 if key in ("aa1", "aa2") else case.steps  # these diverge, and rounding grows with them
    absolute = paper.run(case, gains, key, case.offset, steps=steps)
    q = absolute.q[0]
    rate = absolute.rate[0]
    ref = circle(center=(1.0, 0.6, 0.0), radius=0.35, turns=steps * 0.2 * 0.5 / (2 * np.pi), duration=steps * 0.2)
    method, options = METHODS[key]
    gain = {"cv": {"kappa": gains.kappa}, "ca": {"kp": gains.kp, "kd": gains.kd}}.get(key, {})
    start, first = (q[0], q[1] - q[0]), (rate[0], rate[1] - rate[0])
    relative = track(planar, ref, method, dt=0.2, q0=start, rate0=first, limits=False, damping=0.0, **options, **gain)
    tip = np.array([case.system.position(x) for x in absolute.q])
    assert relative.xyz[:, :2] == pytest.approx(tip, abs=1e-12)
    assert np.abs(relative.xyz[:, 2]).max() < 1e-15


def test_slides_track_as_the_published_pp_arm():
    case, gains = paper.CASES["PP"], paper.SETS["PP good"]
    robot = Robot.load("cartesian_pp")
    ref = circle(center=(1.0, 1.0, 0.0), radius=0.3, turns=10.0, duration=20 * np.pi)
    for key in ("cv", "ca"):
        options = {"kappa": gains.kappa} if key == "cv" else {"kp": gains.kp, "kd": gains.kd}
        run = track(robot, ref, key, dt=gains.h, limits=False, **options)
        wanted = ORACLE["runs"]["PP"][f"PP_stable|exact|{key}"]
        assert run.figures["position"]["settled_max"] == pytest.approx(wanted["max"], rel=0.005)
    av = track(robot, ref, "av", dt=gains.h, limits=False)
    assert av.position_error[2:].max() < 1e-15
    assert case.steps == 1000


def test_null_motion_is_damped(panda):
    """Without damping a null-space kick grows on the acceleration level; with 2 1/s it fades."""
    J = panda.jacobian(Q0)[:3]
    null = np.eye(7) - np.linalg.pinv(J) @ J
    ref = panda_reference(panda, False, 31.4)
    rate = np.linalg.pinv(J) @ ref.at(0.0)[1][:3] + null @ (0.3 * np.eye(7)[2])
    gains = {"kp": 110.0, "kd": 6.5}
    loose = track(panda, ref, "ca", dt=0.05, q0=Q0, rate0=rate, limits=False, null_damping=0.0, damping=0.0, **gains)
    tame = track(panda, ref, "ca", dt=0.05, q0=Q0, rate0=rate, limits=False, damping=0.0, **gains)
    assert max(loose.figures["peak_speed"]) > 5.0
    assert max(tame.figures["peak_speed"]) < 0.6
    assert tame.figures["position"]["settled_max"] == pytest.approx(5.60465e-6, rel=0.02)


# ------------------------------------------------------------------------------------------------ ends of runs
def test_runs_that_diverge_end_with_a_sentence(planar, panda):
    ref = circle(center=(1.0, 0.6, 0.0), radius=0.35, turns=10, duration=40 * np.pi)
    run = track(planar, ref, "aa", reading=1, dt=0.2, limits=False, damping=0.0)
    assert run.status.name in ("DIVERGED", "NOT_FINITE") and not run.success
    assert len(run.t) < 631 and "aad" in run.message
    assert len(run.q) == len(run.xyz) == len(run.position_error) == len(run.t) == len(run.limited) + 1
    for array in (run.q, run.rate, run.xyz, run.position_error, run.between_position):
        assert np.isfinite(array).all()
    with pytest.warns(UserWarning, match="unstable at rest.*Try kp"):
        run = track(panda, panda_reference(panda, True), "ca", dt=0.01, kp=30000.0, kd=20.0, q0=Q0, limits=False)
    assert run.status.name == "DIVERGED" and "Try kp" in run.message and np.isfinite(run.q).all()
    assert json.loads(json.dumps(run.to_dict()))["success"] is False


@pytest.mark.parametrize("method", ["cv", "av", "ca", "aa", "aad"])
def test_out_of_reach_and_back(planar, method):
    """A target pulled 0.1 m out of reach and back. The exact inverse may fail, with finite arrays; damping brings it home."""
    ref = line((1.2, 0, 0), (2.1, 0, 0), duration=12.6, rounds=1)
    exact = track(planar, ref, method, dt=0.02, limits=False, damping=0.0)
    assert np.isfinite(exact.q).all() and np.isfinite(exact.position_error).all()
    for acceleration in (None, 20.0, 5.0):
        safe = track(planar, ref, method, dt=0.02, acceleration_limits=acceleration)
        assert safe.status.name == "LOST" and safe.damped.any() and safe.position_error[-60:].max() < 1e-3
        assert safe.position_error.max() > 0.0999  # out of reach is out of reach
        assert safe.position_error.max() < 0.2 or acceleration


def test_unreachable_is_lost_and_says_limits(planar):
    run = track(planar, circle(center=(3.0, 0, 0), radius=0.1, duration=2.0), "cv")
    assert run.status.name == "LOST" and "from the reference" in run.message
    assert run.to_dict()["status"] == "LOST"


# ------------------------------------------------------------------------------------------------ the verdict
@pytest.mark.parametrize("name", ["hydrolek_7w", pytest.param("kinova", marks=DATA)])
def test_a_miss_in_the_middle_is_no_success(name, capsys):
    """Both default tracks come back to the path before their last tenth, and were called COMPLETED for it."""
    assert main(["track", name, "--json"]) == 1
    data = json.loads(capsys.readouterr().out)
    assert data["status"] == "LOST" and not data["success"] and data["samples_outside"] > 100
    assert data["figures"]["position"]["max"] > 0.1 and data["position_tolerance"] == 0.001
    assert "1 mm and 0.1 deg are allowed" in data["message"] and "Between samples" in data["message"]


def judged(run, robot, reference, position=1e-3, orientation=np.radians(0.1), settle=0.0):
    """Verdict from q alone, by Pinocchio."""
    worst = 0.0
    for t, q in zip(run.t, run.q, strict=True):
        if t >= settle:
            p, o = robot.errors(q, reference.target(t))
            worst = max(worst, p / position, (o or 0.0) / orientation)
    return worst


def test_the_verdict_reads_every_sample(planar, panda):
    ref = panda_reference(panda, True, 2.0)
    start = Q0 + 0.01
    run = track(panda, ref, "cv", dt=0.01, q0=start)
    assert run.status.name == "LOST" and judged(run, panda, ref) > 1.0
    assert run.outside()[0] and not run.outside()[50:].any()
    assert f"outside in {run.outside().sum()} of 201 samples" in run.message and "t = 0 s" in run.message
    later = track(panda, ref, "cv", dt=0.01, q0=start, settle=0.5)
    assert later.success and judged(later, panda, ref, settle=0.5) <= 1.0 and "after 0.5 s" in later.message
    assert later.to_dict()["settle"] == 0.5 and later.to_dict()["samples_outside"] == 0
    worst = float(run.position_error.max())
    turn = float(run.orientation_error.max())
    for position, orientation, good in (
        (worst, turn, True),
        (np.nextafter(worst, 0.0), turn, False),
        (worst, np.nextafter(turn, 0.0), False),
    ):
        again = track(
            panda, ref, "cv", dt=0.01, q0=start, position_tolerance=position, orientation_tolerance=orientation
        )
        assert again.success is good, (position, orientation)


def test_an_arm_that_starts_at_rest_has_half_a_second(planar):
    """The circle moves from the first moment: with a limit on the acceleration the arm has to catch up."""
    q0 = np.array([0.3, 0.9])
    ref = circle(planar.fk(q0).translation, 0.2, duration=4.0)
    run = track(planar, ref, "cv", dt=0.01, q0=q0, acceleration_limits=8.0)
    assert run.settle == 0.5 and run.success and run.position_error.max() > 1e-3
    assert track(planar, ref, "cv", dt=0.01, q0=q0, acceleration_limits=8.0, settle=0.0).status.name == "LOST"
    assert track(planar, ref, "cv", dt=0.01, q0=q0, rate0=np.zeros(2)).settle == 0.5
    moving = track(planar, ref, "cv", dt=0.01, q0=q0)
    assert moving.settle == 0.0 and moving.success and judged(moving, planar, ref) <= 1.0
    short = circle(planar.fk(q0).translation, 0.02, duration=0.4)
    assert track(planar, short, "cv", dt=0.01, q0=q0, acceleration_limits=8.0).settle == pytest.approx(0.2)
    for settle in (-0.1, 4.0, np.nan, "soon"):
        with pytest.raises(InvalidOption, match="settle"):
            track(planar, ref, dt=0.01, q0=q0, settle=settle)
    for option in ("position_tolerance", "orientation_tolerance"):
        for value in (0.0, -1.0, np.nan, np.inf, "small", None):
            with pytest.raises(InvalidOption, match=option):
                track(planar, ref, dt=0.01, q0=q0, **{option: value})


def test_the_verdict_of_the_command(capsys):
    words = ["track", "planar_2r", "--q0", "0.3", "0.9", "--duration", "2", "--acceleration", "8", "--radius", "0.1"]
    words.append("--position-only")
    assert main([*words, "--json"]) == 0 and json.loads(capsys.readouterr().out)["settle"] == 0.5
    assert main([*words, "--settle", "0"]) == 1
    assert "LOST" in capsys.readouterr().err
    assert main([*words, "--tolerance-position", "1e-9"]) == 1
    assert "1 nm" in capsys.readouterr().err
    assert main([*words, "--tolerance-orientation", "0"]) == 2
    assert "orientation_tolerance" in capsys.readouterr().err


# ------------------------------------------------------------------------------------------------ limits
@settings(max_examples=300, deadline=None, derandomize=True)
@given(
    distance=some.floats(1e-9, 10.0),
    v=some.floats(-5.0, 5.0),
    gamma=some.sampled_from([0.5, 0.6, 1.0]),
    h=some.floats(1e-4, 0.1),
    a=some.floats(0.01, 500.0),
)
def test_fastest_rate_can_brake_in_time_and_is_the_fastest(distance, v, gamma, h, a):
    rate = motion.fastest(distance, v, gamma, h, a)

    def furthest(x):
        place, now = h * ((1 - gamma) * v + gamma * x), x
        while now > 0.0:
            after = max(now - a * h, 0.0)
            place, now = place + h * ((1 - gamma) * now + gamma * after), after
        return place

    if rate / (a * h) < 5000:
        assert furthest(rate) <= distance + 1e-9 * max(1.0, abs(v))
        assert furthest(rate + 1e-4 * (abs(rate) + a * h)) > distance


@settings(max_examples=80, deadline=None, derandomize=True)
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
    robot = LIMITED.setdefault(name, Robot.load(MIMIC if name == "mimic" else name))
    rng = np.random.default_rng(seed)
    point = rng.uniform(-1.2, 1.2, 3) * robot.reach
    start = pin.SE3(pin.exp3(rng.normal(size=3)), point).homogeneous if pose else point
    ref = circle(
        start, rng.uniform(0.05, 1.0) * robot.reach, normal=rng.normal(size=3), turns=rng.uniform(0.5, 4), duration=2.0
    )
    run = track(robot, ref, method, dt=dt, q0=robot.random_q(rng), acceleration_limits=acceleration)
    speed = np.diff(run.q, axis=0) / dt
    assert np.isfinite(run.q).all()
    assert (run.q >= robot.lower).all() and (run.q <= robot.upper).all()
    top = np.where(robot.velocity_limits > 0, robot.velocity_limits, np.inf)
    assert (np.abs(speed) <= top * (1 + 1e-9)).all()
    change = np.diff(np.vstack([np.zeros(robot.n), speed]), axis=0) / dt  # from rest
    assert np.abs(change).max() <= acceleration * (1 + 1e-6)
    assert run.status.name in ("COMPLETED", "LOST")


LIMITED: dict = {}


def test_a_large_error_is_closed_without_swinging(panda):
    """164 mm off, at 1 kHz, with acceleration limits: the one-step methods would swing for ever if only clipped."""
    start = Q0 + 3 * np.array([0.05, -0.05, 0.05, 0.05, -0.05, 0.05, 0.05])
    a = [15, 7.5, 10, 12.5, 15, 20, 20]
    for method in ("cv", "av", "ca", "aad"):
        run = track(panda, panda_reference(panda, True, 3.0), method, dt=0.001, q0=start, acceleration_limits=a)
        assert run.position_error[0] > 0.16
        assert run.position_error[600:].max() < 1e-6


def test_limit_options_are_checked(panda):
    ref = panda_reference(panda, True, 1.0)
    with pytest.raises(InvalidOption, match="limits=True"):
        track(panda, ref, limits=False, acceleration_limits=1.0)
    with pytest.raises(InvalidOption, match="7 numbers"):
        track(panda, ref, acceleration_limits=[1.0, 2.0])
    with pytest.raises(InvalidOption, match="positive"):
        track(panda, ref, acceleration_limits=-1.0)
    with pytest.raises(InvalidConfiguration, match="panda_joint4"):
        track(panda, ref, q0=[0, 0, 0, 3.0, 0, 1, 0])


# ------------------------------------------------------------------------------------------------ the control loop
@pytest.mark.parametrize("method", ["cv", "ca", "aad", "state-space"])
def test_updates_equal_a_run(panda, method):
    ref = panda_reference(panda, True, 1.0)
    run = track(panda, ref, method, dt=0.01, q0=Q0, acceleration_limits=10.0)
    T, V, A = ref.at(run.t)
    tracker = Tracker(panda, method, q0=Q0, acceleration_limits=10.0)
    tracker.reset(Q0, T[0], V[0], A[0])
    for i in range(1, len(run.t)):
        step = tracker.update(T[i], 0.01, V[i], A[i])
        assert np.array_equal(step.q, run.q[i])
    assert step.position_error == run.position_error[-1]
    assert step.orientation_error == pytest.approx(run.orientation_error[-1])


def test_step_statuses(panda):
    tracker = Tracker(panda, "cv", q0=Q0, acceleration_limits=20.0)
    T = panda.fk(Q0).homogeneous
    assert tracker.update(T, 0.01).status is StepStatus.OK
    far = T.copy()
    far[:3, 3] += (0.1, 0.1, 0.0)
    tracker.update(far, 0.01)
    step = tracker.update(far, 0.01)
    assert step.status is StepStatus.LIMITED and "acceleration limit held back panda_joint" in step.reason
    broken = T.copy()
    broken[0, 3] = np.nan
    speeds = []
    for _ in range(40):
        step = tracker.update(broken, 0.01)
        speeds.append(np.abs(step.rate).max())
        assert step.status is StepStatus.HELD and "target is not finite" in step.reason and np.isfinite(step.q).all()
    assert speeds[-1] == 0.0 and speeds[0] > 0.0
    for _ in range(200):
        step = tracker.update(far, 0.01)
    assert step.status is StepStatus.OK and step.reason == "" and step.position_error < 1e-6
    free = Tracker(panda, "av", q0=Q0, limits=False)
    step = free.update(panda.fk(-Q0).homogeneous, 0.01)
    assert step.status is StepStatus.JUMPED and "in one step" in step.reason


def test_updates_without_twist_and_with_uneven_steps(panda):
    """A stream of bare targets: the twist comes from the last two, and the step length may vary."""
    ref = panda_reference(panda, True, 6.0)
    tracker = Tracker(panda, "cv", q0=Q0)
    rng = np.random.default_rng(0)
    t, worst = 0.0, 0.0
    while t < 5.0:
        dt = rng.uniform(0.005, 0.015)
        t += dt
        step = tracker.update(ref.target(t), dt)
        worst = max(worst, step.position_error if t > 1.0 else 0.0)
    assert 0.0 < worst < 1e-4  # a target moves up to 1.5 mm in a step
    held = Tracker(panda, "cv", q0=Q0)
    assert held.update(np.full(3, np.nan), 0.01).status is StepStatus.HELD
    assert held.update(panda.fk(Q0).translation, 0.01).status is StepStatus.OK


def test_mistakes_in_the_loop_are_typed(panda):
    tracker = Tracker(panda, q0=Q0)
    with pytest.raises(InvalidTarget, match="not shape"):
        tracker.update(np.zeros(4), 0.01)
    with pytest.raises(InvalidTarget, match="axis target"):
        tracker.update(ik.pose(np.zeros(3), direction=(0, 0, 1)), 0.01)
    for target in ("home", None, {"tip": np.eye(4)}, [[1, 2], [3]], object()):
        with pytest.raises(InvalidTarget, match="4x4 pose or a position"):
            tracker.update(target, 0.01)
    tracker.update(panda.fk(Q0), 0.01)
    for target in (panda.fk(Q0).homogeneous.T.copy(), np.diag([1.0, 1.0, -1.0, 1.0]), np.diag([2.0, 0.5, 1.0, 1.0])):
        with pytest.raises(InvalidTarget, match=r"last row|rotation"):
            tracker.update(target, 0.01)
    with pytest.raises(InvalidTarget, match="one kind"):
        tracker.update(np.zeros(3), 0.01)
    with pytest.raises(InvalidTarget, match="twist"):
        tracker.update(panda.fk(Q0), 0.01, twist=np.zeros(2))
    with pytest.raises(InvalidTarget, match="acceleration must have 6 values"):
        tracker.update(panda.fk(Q0), 0.01, acceleration="fast")
    for dt in (0.0, -1.0, np.nan, np.inf, None, "slow", [0.01]):
        with pytest.raises(InvalidOption, match="dt"):
            tracker.update(panda.fk(Q0), dt)
    for bad, words in (("cw", "Did you mean 'cv'"), ("newton", "no tracking method")):
        with pytest.raises(InvalidOption, match=words):
            Tracker(panda, bad)
    with pytest.raises(InvalidOption, match=r"has no option 'kapa'.*kappa"):
        Tracker(panda, "cv", kapa=3.0)
    with pytest.raises(InvalidOption, match="both kp and kd"):
        track(panda, panda_reference(panda, True, 1.0), "ca", kp=3.0)
    for option in ({"reading": 4}, {"null_damping": -1.0}, {"damping": float("nan")}):
        with pytest.raises(InvalidOption):
            make_method("aa", **option)
    with pytest.raises(InvalidOption, match="longer than the reference"):
        track(panda, panda_reference(panda, True, 1.0), dt=2.0)


# ------------------------------------------------------------------------------------------------ rules, files, command
def test_solver_rules_as_trackers(panda):
    ref = panda_reference(panda, True, 6.0)
    for rule, position, orientation in (
        ("dls", 2e-5, 1e-5),
        ("lm", 2e-6, 2e-6),
        ("pid", 0.01, 0.1),
        ("state-space", 0.01, 0.02),
    ):
        run = track(panda, ref, rule, dt=0.005, q0=Q0)
        assert run.gain_check is None and len(run.t) == 1201
        assert run.figures["position"]["settled_max"] < position
        assert run.figures["orientation"]["settled_max"] < orientation
    with pytest.raises(InvalidOption, match="no option 'dampling'"):
        track(panda, ref, "dls", dampling=1.0)


def test_saved_files(panda, tmp_path):
    run = track(panda, panda_reference(panda, True, 1.0), "aad", dt=0.01, q0=Q0)
    with np.load(run.save(tmp_path / "run.npz")) as data:
        assert np.array_equal(data["q"], run.q) and list(data["joint_names"]) == list(panda.joint_names)
        assert np.array_equal(data["orientation_error"], run.orientation_error)
    rows = run.save(tmp_path / "run.csv").read_text().splitlines()
    assert len(rows) == 102 and rows[0].startswith("t,q_panda_joint1") and rows[0].endswith("orientation_error")
    assert np.array_equal([float(x) for x in rows[-1].split(",")][1:8], run.q[-1])
    with pytest.raises(InvalidOption, match=r"npz or \.csv"):
        run.save(tmp_path / "run.txt")
    assert run.figures["position"]["between_settled_max"] >= 0.0


def test_command(capsys, tmp_path):
    plot, file = tmp_path / "cut.png", tmp_path / "cut.npz"
    cut = [
        "track",
        "hydrolek_7w",
        "--path",
        "line",
        "--length",
        "0.3",
        "--axis",
        "0",
        "0",
        "-1",
        "--rate",
        "200",
        "-m",
        "ca",
    ]
    assert main([*cut, "--plot", str(plot), "-o", str(file)]) == 0
    out = capsys.readouterr()
    assert "COMPLETED" in out.out and "shoulder_pitch" in out.out
    assert plot.stat().st_size > 20_000 and file.is_file()
    assert main([*cut, "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["success"] and data["figures"]["position"]["max"] < 1e-6 and data["stability"]["verdict"] == "stable"


def test_command_warns_and_refuses(capsys):
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # the command shows the warning itself
        code = main(
            ["track", "panda", "-m", "ca", "--kp", "30000", "--kd", "20", "--duration", "3", "--no-limits", "--json"]
        )
    out = capsys.readouterr()
    assert code == 1 and "unstable" in out.err and "Try kp" in out.err
    assert json.loads(out.out)["status"] == "DIVERGED"
    for arguments, words in (
        (["--path", "circel"], "Did you mean 'circle'"),
        (["-m", "cw"], "Did you mean 'cv'"),
        (["--rate", "0"], "--rate"),
        (["-o", "run.txt"], ".npz or .csv"),
        (["--path", "missing.csv"], "no reference file"),
        (["-p", "gamma=x"], "takes a number"),
    ):
        assert main(["track", "panda", *arguments]) == 2
        assert words in capsys.readouterr().err


def test_wrong_inputs_of_a_run_are_typed(panda, planar):
    ref = panda_reference(panda, True, 1.0)
    tree = ik.Tree.load("brokk_hydrolek", tips=["left_tip", "right_tip"])
    for robot in (tree, None, "panda"):
        with pytest.raises(InvalidOption, match="robot with one tip"):
            track(robot, ref)
        with pytest.raises(InvalidOption, match="robot with one tip"):
            Tracker(robot)
    for wrong in (np.eye(4), None, "circle", panda):
        with pytest.raises(InvalidTarget, match="follows a Reference"):
            track(panda, wrong)
    for option, value in (
        ("dt", 0.0),
        ("dt", -0.01),
        ("dt", np.nan),
        ("dt", None),
        ("dt", "fast"),
        ("limits", 3),
        ("limits", "no"),
        ("method", None),
        ("method", ["cv"]),
        ("method", 7),
        ("acceleration_limits", np.nan),
        ("acceleration_limits", "high"),
        ("kappa", "high"),
        ("kappa", None),
    ):
        with pytest.raises(IKError, match=r"."):
            track(panda, ref, **{option: value})
    for option in ("q0", "rate0"):
        for value in (np.zeros(3), np.full(7, np.nan), "home", np.zeros((7, 1))):
            with pytest.raises(InvalidConfiguration, match=option):
                track(panda, ref, **{option: value})
    for jump in (0.0, -1.0, np.nan, "far"):
        with pytest.raises(InvalidOption, match="jump"):
            Tracker(panda, jump=jump)

    def broken(change, **options):
        def function(t):
            T, V, A = (np.array(part) for part in ref.at(t))
            return change(T, V, A, t > 0.5)

        return Reference(function, 1.0, name="mine", **options)

    def at(part, value):
        def change(T, V, A, late):
            (T, V, A)[part][late] = value
            return T, V, A

        return change

    mirror = np.diag([1.0, 1.0, -1.0, 1.0])
    for change in (at(0, np.nan), at(1, np.inf), at(2, np.nan), at(0, 0.0), at(0, mirror), at(0, 1.5 * np.eye(4))):
        with pytest.raises(InvalidTarget, match=r"reference 'mine' is n.* at t = 0.51 s"):
            track(panda, broken(change), q0=Q0)
    for change in (
        lambda T, V, A, late: (T, V),
        lambda T, V, A, late: None,
        lambda T, V, A, late: (T, V, "no"),
        lambda T, V, A, late: (T[:1], V, A),
        lambda T, V, A, late: (T[:, :3], V, A),
    ):
        with pytest.raises(InvalidTarget, match="reference 'mine' must give"):
            track(panda, broken(change), q0=Q0)
    with pytest.raises(InvalidOption, match="function of time"):
        Reference(None, 1.0)
    for duration in (0.0, -1.0, np.nan, "long", None):
        with pytest.raises(InvalidOption, match="duration"):
            Reference(ref.function, duration)


def test_simulate_stops_at_the_edge_of_the_domain():
    case = paper.CASES["1-DoF"]
    with np.errstate(all="ignore"):
        run = simulate(case.system, case.path, "ca", 0.12, 1870, (case.path(0)[0] + 0.3 - 0.2) ** 2, kp=110.0, kd=6.5)
    assert run.stopped and np.isfinite(run.q).all() and np.isfinite(run.error).all()
