"""The one time law, against toppra and on paths whose law is known."""

import logging

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from ik_toolkit.motion.time_law import coordinate_at, smoothed, time_law, times_of


def spline(rng, n, knots=8):
    """A smooth path of n joints over s in 0..1."""
    return CubicSpline(np.linspace(0.0, 1.0, knots), np.cumsum(rng.normal(size=(knots, n)), axis=0))


def by_toppra(path, s, speed, acceleration):
    """Duration that toppra finds from rest to rest, with the accelerations bounded at both ends of an interval."""
    import toppra
    import toppra.algorithm
    import toppra.constraint

    logging.getLogger("toppra").setLevel(logging.CRITICAL)
    both = toppra.constraint.DiscretizationType.Interpolation
    limits = [np.stack([-limit, limit], axis=1) for limit in (speed, acceleration)]
    constraints = [
        toppra.constraint.JointVelocityConstraint(limits[0]),
        toppra.constraint.JointAccelerationConstraint(limits[1], discretization_scheme=both),
    ]
    curve = toppra.SplineInterpolator(np.linspace(0.0, 1.0, 8), path(np.linspace(0.0, 1.0, 8)), bc_type="not-a-knot")
    rate = toppra.algorithm.TOPPRA(constraints, curve, gridpoints=s, solver_wrapper="seidel").compute_parameterization(
        0, 0
    )
    return times_of(s, rate[1])[-1]


@pytest.mark.parametrize("n", [1, 3, 7])
def test_the_law_is_that_of_toppra_and_keeps_its_limits(n):
    rng = np.random.default_rng(n)
    for _ in range(5):
        path, s = spline(rng, n), np.linspace(0.0, 1.0, 301)
        speed, acceleration = rng.uniform(0.5, 2.0, n), rng.uniform(0.5, 4.0, n)
        slope, bend = path(s, 1), path(s, 2)
        rate, joint = time_law(slope, bend, s, speed, acceleration, start=0.0, end=0.0)
        times = times_of(s, rate)
        assert times[-1] == pytest.approx(by_toppra(path, s, speed, acceleration), rel=5e-3)
        assert (np.abs(slope) * rate[:, None] <= speed * (1 + 1e-12)).all()
        gain = 0.5 * np.diff(rate**2) / np.diff(s)
        for at in (0, 1):
            found = np.abs(bend[at : 300 + at] * rate[at : 300 + at, None] ** 2 + slope[at : 300 + at] * gain[:, None])
            assert (found <= acceleration * (1 + 1e-9)).all()
        assert (joint[1:-1] >= 0).all() and joint.max() < n


def test_from_rest_to_rest_along_a_line():
    """Full acceleration, full speed, full braking; the joint that is slowest for its way sets them."""
    s, one = np.linspace(0.0, 1.0, 1601), np.ones((1601, 1))  # full speed is reached at a grid point
    slope = np.hstack([one, 2.0 * one])
    rate, joint = time_law(slope, 0.0 * slope, s, np.array([9.0, 1.0]), np.array([9.0, 4.0]), start=0.0, end=0.0)
    times = times_of(s, rate)
    assert times[-1] == pytest.approx(0.25 + 2.0) and rate.max() == pytest.approx(0.5) and set(joint[1:-1]) == {1}
    t = np.linspace(0.0, 2.0, 777)
    at, speed, gain = coordinate_at(t, times, s, rate)
    np.testing.assert_allclose(at, np.where(t < 0.25, t * t, 0.0625 + 0.5 * (t - 0.25)), atol=1e-12)
    np.testing.assert_allclose(speed, np.minimum(2.0 * t, 0.5), atol=1e-9)
    assert np.abs(gain).max() == pytest.approx(2.0) and coordinate_at(times[-1:], times, s, rate)[0] == 1.0


def test_no_faster_than_asked_and_no_joint_is_blamed_for_it():
    s = np.linspace(0.0, 1.0, 101)
    slope = np.full((101, 1), 0.5)
    slope[60:80] = 4.0  # a joint that is too fast there
    rate, joint = time_law(slope, 0.0 * slope, s, np.ones(1), np.full(1, np.inf), top=1.0, gain=2.0)
    assert rate[0] == 1.0 and rate[70] == 0.25 and (joint[:20] == -1).all() and (joint[60:80] == 0).all()
    assert (np.diff(rate**2) <= 2.0 * 2.0 * np.diff(s) + 1e-12).all() and joint[58] == 0
    still, _ = time_law(slope, 0.0 * slope, s, np.ones(1), np.full(1, np.inf), top=1.0, gain=2.0, start=0.0)
    assert still[0] == 0.0 and still[5] == pytest.approx(np.sqrt(2 * 2.0 * 0.05))


def test_smoothing_keeps_straight_lines_and_both_ends_exactly():
    values = np.linspace(0.1, 0.7, 1001)
    assert np.allclose(smoothed(values), values, rtol=0.0, atol=1e-12)
    rough = values + 0.01 * np.random.default_rng(0).normal(size=1001)
    made = smoothed(rough)
    assert (made[[0, -1]] == rough[[0, -1]]).all() and np.abs(np.diff(made, 2)).max() < np.abs(np.diff(rough, 2)).max()
