"""Whether a path was followed: every sample counts, after the time to settle."""

import json

import numpy as np
import pytest
from references import Q0, panda_reference
from robots import have_data

import ik_toolkit as ik
from ik_toolkit.errors import InvalidOption

DATA = pytest.mark.skipif(not have_data(), reason="example-robot-data is not installed (extra 'robots')")


@pytest.mark.parametrize("name", ["hydrolek_7w", pytest.param("kinova", marks=DATA)])
def test_a_miss_in_the_middle_is_no_success(name, run):
    """Both circles are met again before their last tenth, and the runs were called COMPLETED for it."""
    code, out, _ = run("track", name, "--radius", "0.1", "--json")
    data = json.loads(out)
    assert code == 1 and data["status"] in ("LEFT", "LOST") and not data["success"] and data["samples_outside"] > 100
    assert data["figures"]["position"]["max"] > 0.01 and data["position_tolerance"] == 0.001
    assert "tolerance 1 mm and 0.1 deg" in data["message"] and "between samples" in data["message"].lower()


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
    run = ik.track(panda, ref, "cv", dt=0.01, q0=start, on_limit="leave")
    assert run.status.name == "LEFT" and judged(run, panda, ref) > 1.0
    assert run.outside()[0] and not run.outside()[50:].any()
    assert f"out of tolerance in {run.outside().sum()} of 201 samples" in run.message and "t = 0 s" in run.message
    assert "It begins off the reference: start nearer, or give it time to settle" in run.message
    late = ik.track(panda, ref, "cv", dt=0.01, q0=start, settle=0.02, on_limit="leave")
    assert late.status.name == "LEFT" and not late.outside()[late.t < 0.02].any() and late.outside()[2]
    assert "samples after 0.02 s" in late.message and "It begins off the reference" not in late.message
    later = ik.track(panda, ref, "cv", dt=0.01, q0=start, settle=0.5, on_limit="leave")
    assert later.success and judged(later, panda, ref, settle=0.5) <= 1.0 and "after 0.5 s" in later.message
    assert later.to_dict()["settle"] == 0.5 and later.to_dict()["samples_outside"] == 0
    worst = float(run.position_error.max())
    turn = float(run.orientation_error.max())
    for position, orientation, good in (
        (worst, turn, True),
        (np.nextafter(worst, 0.0), turn, False),
        (worst, np.nextafter(turn, 0.0), False),
    ):
        again = ik.track(
            panda, ref, "cv", dt=0.01, q0=start, position_tolerance=position, orientation_tolerance=orientation, on_limit="leave"
        )  # fmt: skip
        assert again.success is good, (position, orientation)


def test_an_arm_that_starts_at_rest_has_half_a_second(planar):
    """The circle moves from the first moment: with a limit on the acceleration the arm has to catch up."""
    q0 = np.array([0.3, 0.9])
    ref = ik.circle(planar.fk(q0).translation, 0.2, duration=4.0)
    late = {"acceleration_limits": 8.0, "on_limit": "leave"}
    run = ik.track(planar, ref, "cv", dt=0.01, q0=q0, **late)
    assert run.settle == 0.5 and run.success and run.position_error.max() > 1e-3
    assert ik.track(planar, ref, "cv", dt=0.01, q0=q0, settle=0.0, **late).status.name == "LEFT"
    assert ik.track(planar, ref, "cv", dt=0.01, q0=q0, acceleration_limits=8.0, settle=0.0).status.name == "SLOWED"
    assert ik.track(planar, ref, "cv", dt=0.01, q0=q0, rate0=np.zeros(2)).settle == 0.5
    moving = ik.track(planar, ref, "cv", dt=0.01, q0=q0)
    assert moving.settle == 0.0 and moving.success and judged(moving, planar, ref) <= 1.0
    short = ik.circle(planar.fk(q0).translation, 0.02, duration=0.4)
    assert ik.track(planar, short, "cv", dt=0.01, q0=q0, acceleration_limits=8.0).settle == pytest.approx(0.2)
    for settle in (-0.1, 4.0, np.nan, "soon"):
        with pytest.raises(InvalidOption, match="settle"):
            ik.track(planar, ref, dt=0.01, q0=q0, settle=settle)
    for option in ("position_tolerance", "orientation_tolerance"):
        for value in (0.0, -1.0, np.nan, np.inf, "small", None):
            with pytest.raises(InvalidOption, match=option):
                ik.track(planar, ref, dt=0.01, q0=q0, **{option: value})


def test_the_verdict_of_the_command(run):
    words = "track planar_2r --q0 0.3 0.9 --duration 2 --acceleration 8 --radius 0.1 --position-only".split()
    code, out, _ = run(*words, "--json")
    assert code == 0 and json.loads(out)["settle"] == 0.5
    code, out, _ = run(*words, "--settle", "0")
    assert code == 0 and "SLOWED" in out
    code, _, err = run(*words, "--position-tolerance", "1e-9")
    assert code == 1 and "1 nm" in err
