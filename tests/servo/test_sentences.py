"""What a run and a step say: the figures in the words are those of the result."""

import re

import numpy as np
import pytest
import robots
from references import line_of

import ik_toolkit as ik
from ik_toolkit.servo.result import TrackStatus
from ik_toolkit.text import length

Q = np.array([0.3, 0.9])


def line(robot, duration, move=(-0.2, 0.1, 0.0)):
    return line_of(robot, Q, move, duration, free=True)


def between(run, judged):
    """The sentence on the error inside the steps."""
    worst = run.between_position[judged[:-1]].max()
    return (
        f" Between samples: at most {length(float(worst))}."
        if worst > 1.01 * run.position_error[judged].max()
        else " No more between samples."
    )


def test_runs_that_follow(planar):
    whole = ik.track(planar, line(planar, 1.0), "cv", q0=Q)
    every = np.ones(len(whole.t), dtype=bool)
    told = f"followed the reference: error at most {length(whole.position_error.max())} at every sample."
    assert whole.status == TrackStatus.COMPLETED and whole.message == told + between(whole, every)
    slow = ik.track(planar, line(planar, 0.4), "cv", q0=Q, position_tolerance=1e-5)
    took = f"{slow.added_time:.3g} s longer than its 0.4 s, to keep within its tolerance"
    told = f"followed the reference, {took}: error at most {length(slow.position_error.max())} at every sample."
    assert slow.status == TrackStatus.SLOWED and slow.success and slow.message.startswith(told)
    late = ik.track(planar, line(planar, 1.0), "cv", q0=Q + 0.02, settle=0.5, on_limit="leave")
    judged = late.t >= 0.5
    told = f"followed the reference: error at most {length(late.position_error[judged].max())} at every sample after 0.5 s."
    assert late.message.startswith(told) and late.message.endswith(between(late, judged))


def test_runs_that_leave(planar):
    run = ik.track(planar, line(planar, 1.0), "cv", q0=Q + 0.02)
    out = run.position_error > 1e-3
    assert run.status == TrackStatus.LEFT and (run.outside() == out).all() and out[0] and not out[-1]
    worst = int(np.argmax(run.position_error))
    first, last = run.t[out][[0, -1]]
    told = (
        f"up to {length(run.position_error[worst])} from the reference, worst at t = {run.t[worst]:.4g} s (tolerance 1 mm); out of "
        f"tolerance in {out.sum()} of {len(run.t)} samples, from t = {first:.4g} s to {last:.4g} s, within it again at the end"
    )
    assert run.message.startswith(told) and "It begins off the reference: start nearer" in run.message
    # Beyond its reach at the end.
    away = ik.track(planar, line(planar, 2.0, (2.0, 0.0, 0.0)), "cv", q0=Q, on_limit="leave")
    assert away.status == TrackStatus.LOST and " s to the end" in away.message
    pose = robots.load("hydrolek_7w")
    turned = ik.line(pose.fk(pose.home), pose.fk(pose.home + 0.1), duration=1.0)
    off = ik.track(pose, turned, "cv", q0=pose.home + 0.01, on_limit="leave", orientation_tolerance=1e-3)
    k = int(np.argmax(np.maximum(off.position_error / 1e-3, off.orientation_error / 1e-3)))
    angle = np.degrees(off.orientation_error.max())
    assert off.message.startswith(
        f"up to {length(off.position_error.max())} and {angle:.3g} deg from the reference, worst at t = {off.t[k]:.4g} s "
        f"(tolerance 1 mm and {np.degrees(1e-3):.3g} deg); "
    )


@pytest.mark.parametrize(
    ("start", "target", "options", "status", "reason"),
    [
        (Q, None, {}, "OK", ""),
        ((0.3, 2.7), None, {}, "RECOVERING", "outside its limits, moving back: joint_2; .*"),
        (Q, (np.nan, 0.0, 0.0), {}, "HELD", "the target is not finite: braking and holding"),
        (Q, (-1.0, 1.0, 0.0), {}, "LIMITED", "speed limit on joint_2"),
        (Q, (-1.0, 1.0, 0.0), dict(acceleration_limits=1.0), "LIMITED", "acceleration limit on joint_1, joint_2"),
        (Q, (-1.0, 1.0, 0.0), dict(limits=False), "JUMPED", r"joint joint_2 moved .* in one step"),
    ],
)
def test_steps(planar, start, target, options, status, reason):
    target = planar.fk(Q).translation if target is None else target
    step = ik.Tracker(planar, q0=start, **options).update(target, 0.01)
    assert step.status.name == status and re.fullmatch(reason, step.reason)
    told = f", {step.reason}" if reason else ""
    assert repr(step) == f"Step({status}, {step.position_error:.3g} m{told})"
    unknown = status == "HELD"  # There has been no target yet.
    assert np.isnan([step.position_error, step.orientation_error]).all() if unknown else step.orientation_error is None
    assert step.between is None
    if status == "JUMPED":
        assert f"moved {step.q[1] - start[1]:.3g} in" in step.reason


@pytest.mark.parametrize(("method", "most", "dt"), [("cv", 1.0, 0.01), ("ca", 5.0, 0.002), ("aad", 2.0, 0.002)])
def test_a_joint_outside_its_limits_recovers_in_every_step(planar, method, most, dt):
    """In some of these steps rounding leaves a joint only one rate."""
    tracker = ik.Tracker(planar, method, q0=[0.3, planar.upper[1] + 0.5], acceleration_limits=most)
    while (step := tracker.update(planar.fk(Q).translation, dt)).q[1] > planar.upper[1] + 1e-9:
        assert step.status is ik.StepStatus.RECOVERING
