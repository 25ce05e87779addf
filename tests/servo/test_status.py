"""Status and message of a run, on hand-made arrays."""

import json

import numpy as np
import pytest
from references import line_of

import ik_toolkit as ik
from ik_toolkit.servo import loop, viability
from ik_toolkit.servo.result import TrackResult, figures, verdict

JOINTS = ("shoulder", "elbow")


def made(error, *, turn=None, sigma=None, pace=None, limited=None, end=None, dt=0.1, settle=0.0, stop=loop.STOP.fine):
    """A run with these position errors [m] at its samples, judged at 1 mm and 0.1 deg."""
    error = np.asarray(error, dtype=float)
    steps = len(error) - 1
    t = np.arange(steps + 1) * dt
    clock = None if sigma is None else np.concatenate([[0.0], np.cumsum(sigma) * dt])
    q = np.outer(t, [0.1, -0.2])
    run = TrackResult(
        robot="arm", method="cv", options={}, dt=dt, joint_names=JOINTS, t=t, q=q, rate=np.zeros_like(q),
        xyz=np.zeros((steps + 1, 3)), target_xyz=np.zeros((steps + 1, 3)), position_error=error,
        orientation_error=None if turn is None else np.asarray(turn, dtype=float),
        limited=np.zeros((steps, 2), np.uint8) if limited is None else np.asarray(limited, np.uint8),
        damped=np.zeros(steps, bool), between_position=None, between_orientation=None, elapsed=0.0, gain_check=None,
        position_tolerance=1e-3, orientation_tolerance=float(np.radians(0.1)), settle=settle, clock=clock,
        sigma=None if sigma is None else np.asarray(sigma, dtype=float),
        pace=None if pace is None else np.asarray(pace), **({} if end is None else {"end": end}),
    )  # fmt: skip
    run.figures = figures(run, np.full(2, 0.5))
    run.status, run.message = verdict(run, stop, steps)
    return run


def test_completed_is_inside_all_the_time_and_on_time():
    run = made([0.0, 9e-4, 1e-3, 0.0])
    assert run.status.name == "COMPLETED" and run.success and "error at most 1 mm at every sample" in run.message
    assert run.added_time == 0.0 and run.pace_joint is None and np.array_equal(run.clock, run.t)
    exact = made([0.0] * 11, sigma=[1.0] * 10, pace=[-1] * 10)  # a sum of 0.1 s is not the product
    assert exact.status.name == "COMPLETED" and exact.to_dict()["added_time"] == 0.0
    assert made([0.0]).figures["peak_speed"] == [0.0, 0.0]
    assert repr(exact) == f"TrackResult(COMPLETED, {exact.message})"


def test_slowed_says_how_much_longer_and_which_joint_set_the_pace():
    """The one that took most from the clock, and not the one that held it back in most steps."""
    limited = np.zeros((6, 2))
    limited[2:4, 1] = viability.BIT.velocity
    run = made([1e-4] * 7, sigma=[0.95, 0.95, 0.25, 0.25, 0.6, 1], pace=[0, 0, 1, 1, 0, -1], limited=limited)
    assert run.status.name == "SLOWED" and run.success
    assert "0.2 s longer than its 0.4 s, limited by elbow (speed limit)" in run.message
    assert run.figures["slowed_time"] == pytest.approx(0.5) and run.figures["slowest"] == 0.25
    assert run.figures["added_time"] == pytest.approx(0.2)
    data = json.loads(json.dumps(run.to_dict()))
    assert data["pace_joint"] == "elbow" and data["clock"] == pytest.approx(0.4) and data["success"]
    assert data["duration"] == pytest.approx(0.6)


def test_left_says_how_far_and_when():
    run = made([0.0, 0.0, 0.012, 0.03, 0.002, 0.0, 1e-4])
    assert run.status.name == "LEFT" and not run.success
    assert "up to 30 mm from the reference, worst at t = 0.3 s (tolerance 1 mm)" in run.message
    assert "out of tolerance in 3 of 7 samples, from t = 0.2 s to 0.4 s, within it again at the end" in run.message
    slowly = made([0.0, 0.01, 0.0], sigma=[0.5, 1.0], pace=[0, -1])
    assert slowly.status.name == "LEFT" and "took 0.05 s longer" in slowly.message and "shoulder" in slowly.message


@pytest.mark.parametrize(
    ("error", "turn"), [([0.0, 0.0, 0.002], None), ([0.0] * 3, [0.0, 0.0, 0.01]), ([0.01] * 3, [0.1] * 3)]
)
def test_lost_is_outside_at_the_end(error, turn):
    run = made(error, turn=turn)
    assert run.status.name == "LOST" and not run.success and "to the end" in run.message
    if turn is not None:
        assert "and 0.1 deg)" in run.message


def test_a_run_that_does_not_reach_the_end_is_lost_and_names_the_joint():
    limited = np.zeros((5, 2))
    limited[2:, 0] = viability.BIT.position
    run = made([1e-4] * 6, sigma=[1, 1, 0, 0, 0], pace=[-1, -1, 0, 0, 0], limited=limited, end=0.5)
    assert run.status.name == "LOST" and not run.success
    assert "reached 0.2 of 0.5 s of the reference in 0.5 s, limited by shoulder (position limit)" in run.message
    off = made([0.0, 0.0, 0.01, 0.01], sigma=[1, 1, 0], pace=[-1, -1, 1], end=1.0)
    assert off.status.name == "LOST" and "limited by elbow" in off.message and "10 mm from the reference" in off.message
    nearly = made([0.0] * 4, sigma=[1, 1, 0.5], pace=[-1, -1, 1], end=0.3)
    assert nearly.status.name == "LOST" and "reached 0.25 of 0.3 s" in nearly.message


def test_a_reference_of_one_sample_that_was_given_up_is_lost():
    robot = ik.Robot.load("hydrolek_7w")
    line = line_of(robot, robot.home, (-0.1, 0.1, 0.0), 0.015, "constant")
    run = ik.track(robot, line, dt=0.01, acceleration_limits=2.0)
    assert run.clock[-1] < 0.9 * run.end
    assert run.status.name == "LOST" and not run.success and f"of {run.end:.4g} s of the reference" in run.message


def test_errors_before_the_arm_has_settled_do_not_count():
    assert made([0.01, 0.01, 0.0, 0.0], settle=0.15).status.name == "COMPLETED"
    assert made([0.01, 0.01, 0.0, 0.0], settle=0.05).status.name == "LEFT"


def test_a_stop_of_the_loop_comes_first():
    assert made([0.0, 9.0], stop=loop.STOP.runaway).status.name == "DIVERGED"
    assert made([0.0, 0.0], stop=loop.STOP.not_finite).status.name == "NOT_FINITE"
