"""From when on a run is judged: an arm that begins off its reference has time to get there, if that is asked for."""

import numpy as np
import pytest
import robots

import ik_toolkit as ik
from ik_toolkit.errors import InvalidOption
from ik_toolkit.servo.result import TrackStatus

DURATION = 2.0


@pytest.fixture(scope="module")
def arm():
    return robots.load("panda" if robots.have_data() else "hydrolek_7w")


@pytest.fixture(scope="module")
def line(arm):
    start = arm.fk(arm.home).translation
    return ik.line(start, start + np.array([0.0, 0.05, 0.02]), duration=DURATION)


def test_what_happens_before_it_is_not_judged(arm, line):
    off = arm.home + 0.02
    judged = ik.track(arm, line, "cv", q0=off, settle=1.0, on_limit="leave")
    assert judged.position_error[0] > 1e-3 and judged.settle == 1.0
    assert judged.status == TrackStatus.COMPLETED and judged.success and "at every sample after 1 s" in judged.message
    assert not judged.outside()[judged.t < 1.0].any()
    at_once = ik.track(arm, line, "cv", q0=off, on_limit="leave")
    assert at_once.status == TrackStatus.LEFT and not at_once.success and at_once.settle == 0.0
    assert at_once.outside()[0] and not at_once.outside()[-1]
    assert "give it time to settle" in at_once.message and " after " not in at_once.message.split(";")[1]
    late = ik.track(arm, line, "cv", q0=off, settle=0.02, on_limit="leave")
    assert late.status == TrackStatus.LEFT and not late.outside()[late.t < 0.02].any() and late.outside()[2]
    assert "samples after 0.02 s" in late.message and "It begins off the reference" not in late.message


def test_an_arm_at_rest_has_half_a_second_by_default(arm, line):
    for given, settle in (({"rate0": np.zeros(arm.n)}, 0.5), ({"acceleration_limits": 20.0}, 0.5), ({}, 0.0)):
        assert ik.track(arm, line, "cv", **given).settle == settle
    short = ik.line(arm.fk(arm.home).translation, arm.fk(arm.home).translation + 0.01, duration=0.4)
    assert ik.track(arm, short, "cv", rate0=np.zeros(arm.n)).settle == 0.2  # half of a run shorter than a second


@pytest.mark.parametrize("settle", [-0.1, DURATION, 5.0, float("nan"), "soon"])
def test_it_lies_inside_the_run(arm, line, settle):
    with pytest.raises(InvalidOption, match="settle"):
        ik.track(arm, line, "cv", settle=settle)
