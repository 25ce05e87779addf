"""The published methods: errors and orders, and how diverging runs and runs beyond reach end."""

import json

import numpy as np
import pytest
import robots
from folders import read_data
from references import Q0, panda_reference

import ik_toolkit as ik
from ik_toolkit.papers.patko_2019 import cases
from ik_toolkit.servo.methods import System, simulate

ORACLE = read_data("tracking")
METHODS = cases.METHODS
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
    null = {} if method in ("cv", "av") else {"null_damping": 2.0}  # [1/s] the oracle's
    tables = ORACLE["panda"]
    wanted = tables["pose_exact_position_m" if pose else "pos_exact_position_m"][row]
    got, turned = [], []
    for h in wanted["h"]:
        run = ik.track(panda, panda_reference(panda, pose), method, dt=h, q0=Q0, limits=False, **options(h), **null)
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
    case, gains = cases.CASES["RR"], cases.SETS["RR good"]
    steps = 40 if key in ("aa1", "aa2") else case.steps  # these diverge, and rounding grows with them
    absolute = cases.run(case, gains, key, case.offset, steps=steps)
    q = absolute.q[0]
    rate = absolute.rate[0]
    ref = ik.circle(center=(1.0, 0.6, 0.0), radius=0.35, turns=steps * 0.2 * 0.5 / (2 * np.pi), duration=steps * 0.2)
    method, options = METHODS[key]
    gain = {"cv": {"kappa": gains.kappa}, "ca": {"kp": gains.kp, "kd": gains.kd}}.get(key, {})
    start, first = (q[0], q[1] - q[0]), (rate[0], rate[1] - rate[0])
    relative = ik.track(
        planar, ref, method, dt=0.2, q0=start, rate0=first, limits=False, damping=0.0, **options, **gain
    )
    tip = np.array([case.system.position(x) for x in absolute.q])
    assert relative.xyz[:, :2] == pytest.approx(tip, abs=1e-12)
    assert np.abs(relative.xyz[:, 2]).max() < 1e-15


def test_slides_track_as_the_published_pp_arm():
    case, gains = cases.CASES["PP"], cases.SETS["PP good"]
    robot = ik.Robot.load("cartesian_pp")
    ref = ik.circle(center=(1.0, 1.0, 0.0), radius=0.3, turns=10.0, duration=20 * np.pi)
    for key in ("cv", "ca"):
        options = {"kappa": gains.kappa} if key == "cv" else {"kp": gains.kp, "kd": gains.kd}
        run = ik.track(robot, ref, key, dt=gains.h, limits=False, **options)
        wanted = ORACLE["runs"]["PP"][f"PP_stable|exact|{key}"]
        assert run.figures["position"]["settled_max"] == pytest.approx(wanted["max"], rel=0.005)
    av = ik.track(robot, ref, "av", dt=gains.h, limits=False)
    assert av.position_error[2:].max() < 1e-15
    assert case.steps == 1000


def test_null_motion_is_damped(panda):
    """Without damping a null-space kick grows on the acceleration level; with 2 1/s, or the default, it fades."""
    J = panda.jacobian(Q0)[:3]
    null = np.eye(7) - np.linalg.pinv(J) @ J
    ref = panda_reference(panda, False, 31.4)
    rate = np.linalg.pinv(J) @ ref.at(0.0)[1][:3] + null @ (0.3 * np.eye(7)[2])
    gains = {"kp": 110.0, "kd": 6.5}
    loose, tame, usual = (
        ik.track(panda, ref, "ca", dt=0.05, q0=Q0, rate0=rate, limits=False, damping=0.0, **how, **gains)
        for how in ({"null_damping": 0.0}, {"null_damping": 2.0}, {})
    )
    assert max(loose.figures["peak_speed"]) > 5.0
    assert max(tame.figures["peak_speed"]) < 0.6 and max(usual.figures["peak_speed"]) < 0.6
    assert tame.figures["position"]["settled_max"] == pytest.approx(5.60465e-6, rel=0.02)


# ------------------------------------------------------------------------------------------------ ends of runs
def test_runs_that_diverge_end_with_a_sentence(planar, panda):
    ref = ik.circle(center=(1.0, 0.6, 0.0), radius=0.35, turns=10, duration=40 * np.pi)
    first, second = cases.rr_inverse(ref.target(0.0)[:2])
    run = ik.track(planar, ref, "aa", reading=1, dt=0.2, q0=(first, second - first), limits=False, damping=0.0)
    assert run.status.name in ("DIVERGED", "NOT_FINITE") and not run.success
    assert len(run.t) < 631 and "aad" in run.message
    assert len(run.q) == len(run.xyz) == len(run.position_error) == len(run.t) == len(run.limited) + 1
    for array in (run.q, run.rate, run.xyz, run.position_error, run.between_position):
        assert np.isfinite(array).all()
    with pytest.warns(UserWarning, match="unstable at rest.*Try kp"):
        run = ik.track(panda, panda_reference(panda, True), "ca", dt=0.01, kp=30000.0, kd=20.0, q0=Q0, limits=False)
    assert run.status.name == "DIVERGED" and np.isfinite(run.q).all()
    said = f"ca moved joints without bound after {len(run.t) - 1} of 1260 steps (t = {run.t[-1]:.4g} s)"
    assert run.message == f"{said}. {run.gain_check.message}"
    assert json.loads(json.dumps(run.to_dict()))["success"] is False


@pytest.mark.parametrize("method", ["cv", "av", "ca", "aa", "aad"])
def test_out_of_reach_and_back(planar, method):
    """A target moved 0.1 m out of reach and back. The exact inverse may fail with finite arrays; with damping it recovers."""
    ref = ik.line((1.2, 0, 0), (2.1, 0, 0), duration=12.6, rounds=1)
    exact = ik.track(planar, ref, method, dt=0.02, limits=False, damping=0.0)
    assert np.isfinite(exact.q).all() and np.isfinite(exact.position_error).all()
    for acceleration in (None, 20.0, 5.0):
        safe = ik.track(planar, ref, method, dt=0.02, acceleration_limits=acceleration)
        assert safe.status.name == "LEFT" and safe.damped.any() and safe.position_error[-60:].max() < 1e-3
        assert safe.position_error.max() > 0.0999  # out of reach is out of reach
        assert safe.position_error.max() < 0.2 or acceleration


def test_simulate_stops_at_the_edge_of_the_domain():
    case = cases.CASES["1-DoF"]
    with np.errstate(all="ignore"):
        run = simulate(case.system, case.path, "ca", 0.12, 1870, (case.path(0)[0] + 0.3 - 0.2) ** 2, kp=110.0, kd=6.5)
    assert run.stopped and np.isfinite(run.q).all() and np.isfinite(run.error).all()


@pytest.mark.parametrize("method", ["cv", "aad"])
def test_weights_of_a_mask_count_while_the_target_moves(method):
    """Five joints cannot keep the orientation of a target that moves sideways: the less it counts, the nearer the position."""
    robot, errors = ik.Robot.load("so101"), []
    q0 = np.array([0.1, -0.6, 0.9, 0.5, 0.1])
    for weight in (1.0, 0.05):
        tracker, target = ik.Tracker(robot, method, q0=q0, mask=(1, 1, 1, *[weight] * 3)), robot.fk(q0).homogeneous
        for _ in range(200):
            target[1, 3] += 0.0005
            step = tracker.update(target, 0.02)
        errors.append(step.position_error)
    assert errors[1] < 0.005 < errors[0]


def test_simulate_stops_when_a_single_joint_runs_away():
    """Two slides: the target of the first leaps, the second stands still."""
    system = System(lambda q: q.copy(), lambda q: np.eye(2), lambda q, rate, _: np.zeros(2))

    def path(t):
        return np.array([9.0 if t > 0.5 else 0.0, 0.0]), np.zeros(2), np.zeros(2)

    run = simulate(system, path, "cv", 0.1, 20, np.zeros(2), rate0=np.zeros(2), kappa=5.0, runaway=1.0)
    assert "moves a joint by more than 1" in run.stopped and 0.4 < run.t[-1] < 0.7
    assert not simulate(system, path, "cv", 0.1, 20, np.zeros(2), rate0=np.zeros(2), kappa=5.0, runaway=20.0).stopped


def test_errors_between_samples_end_with_those_at_the_samples():
    case = cases.CASES["RR"]
    run = simulate(case.system, case.path, "cv", 0.01, 50, case.start(case.path(0.0)[0]), kappa=20.0)
    between = run.between(case.system, lambda t: case.path(t)[0], np.array([0.0, 0.5, 1.0]))
    np.testing.assert_allclose(between[:, 0], np.linalg.norm(run.error[:-1], axis=1), atol=1e-12)
    np.testing.assert_allclose(between[:, 2], np.linalg.norm(run.error[1:], axis=1), atol=1e-12)


@pytest.mark.parametrize("name, radius", [("planar_3r", 0.3), ("so100", 0.03)])
@pytest.mark.parametrize("method", ["cv", "ca", "aad"])
def test_few_joints_that_are_enough_for_a_position(name, radius, method):
    """An arm of fewer than six joints may be redundant for a position: J'J is then singular, and JJ' is used."""
    arm = robots.load(name)
    q = np.array([0.5, -0.8, -0.5]) if name == "planar_3r" else arm.home
    path = ik.circle(start=arm.fk(q).translation, radius=radius, duration=5.0)
    plain = ik.track(arm, path, method, q0=q, dt=0.02, damping=0.0, limits=False)
    assert plain.success
    damped = ik.track(arm, path, method, q0=q, dt=0.02, limits=False)  # The default damps near singular poses alone.
    assert damped.position_error.max() < 2.0 * plain.position_error.max() + 1e-9
