"""Limits of position, speed and acceleration: the box of next rates, the brake, and the braking path."""

import math

import numpy as np
import pytest
from braking import brake
from scipy.interpolate import CubicHermiteSpline

from ik_toolkit.kernel import clearance
from ik_toolkit.servo import viability
from ik_toolkit.servo.viability import BIT

GAMMAS = (1.0, 0.5, 0.75, 0.3)


@pytest.mark.parametrize("gamma", GAMMAS)
def test_the_highest_rate_leaves_the_way_to_rest(gamma):
    rng = np.random.default_rng(1)
    kinds = set()
    for _ in range(300):
        a, late = rng.uniform(0.2, 5.0), rng.uniform(0.02, 0.3)
        h, v, distance = rng.uniform(0.005, late), rng.normal() * 0.5, 10.0 ** rng.uniform(-4.0, 0.5)
        w = viability.approach(distance, v, gamma, h, a, late)
        left = distance - h * ((1.0 - gamma) * v + gamma * w)
        if w <= 0.0:
            assert left == pytest.approx(0.0, abs=1e-12) or distance - h * (1.0 - gamma) * v > 0.0
            kinds.add("back")
        else:
            assert viability.stopping(w, gamma, a, late) == pytest.approx(left, rel=1e-9, abs=1e-14)
            kinds.add("slow" if w <= 0.5 * a * late else "fast")
    assert kinds >= {"slow", "fast"}
    assert viability.approach(np.inf, 1.0, gamma, 0.1, 1.0, 0.1) == np.inf
    assert viability.approach(0.3, 0.0, gamma, 0.1, np.inf, 0.1) == pytest.approx(
        0.3 / (gamma * 0.1 + (0 if gamma == 1 else 0.05 + max(0.5 - gamma, 0) * 0.1))
    )
    assert viability.approach(-0.2, 0.0, gamma, 0.1, 1.0, 0.1) == pytest.approx(-0.2 / (gamma * 0.1))
    assert viability.approach(-0.2, 0.0, gamma, 0.0, 1.0, 0.1) == 0.0


def allowed(w, q, v, lower, upper, speed, a, gamma, h, late, slack=0.0):
    """Whether a next rate keeps every limit, by the parabola sampled finely, and can still brake."""
    bend = 2.0 * gamma if 0.5 < gamma < 1.0 else 1.0
    left = w - v
    end = w if bend == 1.0 else bend * w - (bend - 1.0) * v  # rate in which the parabola ends
    fine = abs(left) * bend <= a * h + slack and abs(w) <= speed + slack and abs(end) <= speed + slack
    there = q + h * ((1.0 - gamma) * v + gamma * w)
    for way, rate in ((upper - there, w), (there - lower, -w)):
        if way < viability.stopping(max(rate, 0.0), gamma, a / bend, late) - slack:
            fine = False
    return fine


@pytest.mark.parametrize("gamma", GAMMAS)
def test_the_box_is_what_the_limits_allow(gamma):
    rng = np.random.default_rng(3)
    reasons = set()
    for _ in range(400):
        lower, upper, speed, a = (
            -rng.uniform(0.2, 2.0),
            rng.uniform(0.2, 2.0),
            rng.uniform(0.3, 2.0),
            rng.uniform(1.0, 8.0),
        )
        late = rng.uniform(0.01, 0.1)
        h = rng.uniform(0.2, 1.0) * late
        q, v = rng.uniform(lower, upper), rng.uniform(-speed, speed)
        args = q, v, lower, upper, speed, a, gamma, h, late
        bend = 2.0 * gamma if 0.5 < gamma < 1.0 else 1.0
        if not any(allowed(w, *args) for w in (max(v - a * h / bend, 0.0), min(v + a * h / bend, 0.0))):
            continue
        low, top, why_low, why_top = viability.joint_box(*args)
        assert low <= top and not why_top & BIT.recovering and not why_low & BIT.recovering
        for w in (low, top, 0.5 * (low + top)):
            assert allowed(w, *args, slack=1e-9)
        for w, why, sign in ((top, why_top, 1.0), (low, why_low, -1.0)):
            assert not allowed(w + sign * 1e-6, *args, slack=1e-10)
            reasons.add(int(why))
            beyond = w + sign * 1e-6
            if why == BIT.acceleration:
                assert abs(beyond - v) * bend > a * h
            elif why == BIT.velocity:
                assert max(abs(beyond), abs(bend * beyond - (bend - 1.0) * v)) > speed
            elif why == BIT.position:
                wide = (beyond, q, v, -9.0, 9.0, *args[4:])
                assert allowed(*wide)
    assert reasons >= {BIT.acceleration, BIT.velocity, BIT.position}


def arrays(rng, n=4):
    limits = np.array(
        [-rng.uniform(0.5, 2.0, n), rng.uniform(0.5, 2.0, n), rng.uniform(0.5, 1.5, n), rng.uniform(1.0, 4.0, n)]
    )
    return limits, rng.uniform(0.3 * limits[0], 0.3 * limits[1]), rng.uniform(-0.4, 0.4, n)


def test_how_far_a_joint_has_gone():
    f = np.linspace(0.0, 1.0, 20001)
    for start, change in ((1.0, 0.5), (1.0, -1.5), (-1.0, 3.0), (0.4, 0.0), (0.0, 1.0), (0.5, -0.5), (1.0, -4.0)):
        for part in (1.0, 0.35):
            there = part * f
            want = np.abs(np.diff(start * there + 0.5 * change * there**2)).sum()
            assert clearance.travelled(start, change, part) == pytest.approx(want, abs=1e-7)


@pytest.mark.parametrize("gamma", [1.0, 0.5, 0.75])
def test_the_full_brake_and_the_way_along_it(gamma):
    rng = np.random.default_rng(5)
    limits, q, rate = arrays(rng)
    h, late = 0.02, 0.03
    for first in (0, 2):
        Q, R, L = np.zeros((200, 4)), np.zeros((200, 4)), np.full((200, 4), np.nan)
        Q[0], R[0] = q, rate
        for k in range(first):
            Q[k + 1], R[k + 1] = Q[k], R[k]
            viability.move(Q[k + 1], R[k + 1], R[k] * 0.9, gamma, h)
        end = brake(first, gamma, h, late, limits, Q, R, L)
        assert end > first and not R[end].any() and R[end - 1].any()
        now, speed, code = Q[first].copy(), R[first].copy(), np.empty(4, np.uint8)
        for k in range(first, end):
            np.testing.assert_array_equal(Q[k], now)
            np.testing.assert_array_equal(R[k], speed)
            viability.advance(now, speed, np.zeros(4), gamma, h, late, limits, code)
        got, gone, before, walked = np.empty(4), np.empty(4), q.copy(), np.zeros(4)
        for u in np.linspace(0.0, end, 40 * end + 1):
            clearance.along(Q, R, L, gamma, h, u, got, gone)
            walked += np.abs(got - before)
            before = got.copy()
            np.testing.assert_allclose(gone, walked, atol=2e-5)
        np.testing.assert_allclose(got, Q[end], atol=1e-13)
        for k in range(end):  # the ends and, halfway, what the rates say
            clearance.along(Q, R, L, gamma, h, float(k), got, gone)
            np.testing.assert_allclose(got, Q[k], atol=1e-14)
            np.testing.assert_allclose(gone, L[k], atol=1e-14)
            clearance.along(Q, R, L, gamma, h, k + 0.5, got, gone)
            middle = 0.5 * (Q[k] + Q[k + 1])
            if gamma != 1.0:
                middle = Q[k] + 0.5 * h * R[k] + 0.25 * (Q[k + 1] - Q[k] - h * R[k])
            np.testing.assert_allclose(got, middle, atol=1e-14)
    Q, R, L = np.zeros((3, 4)), np.zeros((3, 4)), np.zeros((3, 4))
    assert brake(0, gamma, h, late, limits, Q, R, L) == 1  # at rest already
    R[0] = 5.0
    assert brake(0, gamma, h, late, limits, Q, R, L) == -1
    assert math.isfinite(Q.sum())


@pytest.mark.parametrize("gamma", [1.0, 0.5, 0.75])
@pytest.mark.parametrize("a", [math.inf, 8.0])
def test_joints_travel_to_a_goal_in_the_least_time(gamma, a):
    """Inside their limits, without passing it, in little more time than the slowest needs; without inertia on a straight line."""
    rng, h, late = np.random.default_rng(5), 0.01, 0.02
    for _ in range(5):
        goal, speed = rng.uniform(-2.0, 2.0, 4), np.array([1.0, 2.0, 0.5, np.inf])
        limits = np.array([np.full(4, -2.5), np.full(4, 2.5), speed, np.full(4, a)])
        usual = np.where(speed < np.inf, speed, viability.UNLIMITED)
        q, rate, code, steps = np.zeros(4), np.zeros(4), np.zeros(4, np.uint8), 0
        least = (np.abs(goal) / usual + usual / a).max()
        while np.abs(q - goal).max() > 1e-3:
            was = rate.copy()
            left = viability.travel(q, rate, goal, *viability.UNKNOWN, 0.0, gamma, h, late, limits, code)
            assert left == pytest.approx((np.abs(goal - q) / usual).max())
            assert (np.abs(rate) <= speed * (1.0 + 1e-12)).all() and (np.abs(rate - was) <= a * h * (1.0 + 1e-12)).all()
            assert ((q - goal) * np.sign(goal) <= 1e-12).all()
            if a == math.inf and gamma == 1.0:
                assert np.allclose(q, goal * (q @ goal) / (goal @ goal), atol=1e-12)
            steps += 1
            assert steps < 1000
        assert steps * h <= 1.05 * least + 0.15


@pytest.mark.parametrize("gamma", [1.0, 0.5, 0.75])
@pytest.mark.parametrize("a", [math.inf, 8.0])
def test_joints_travel_along_a_known_motion(gamma, a):
    """At each moment where it says, then to the goal; what is missing at the start is made up for."""
    h, limits = 0.01, np.array([np.full(2, -2.5), np.full(2, 2.5), np.full(2, 2.0), np.full(2, a)])
    times, points = np.array([0.0, 0.5, 1.0]), np.array([[0.0, 0.0], [0.3, -0.1], [0.5, 0.2]])
    rates = np.array([[0.0, 0.0], [0.6, 0.2], [0.0, 0.0]])
    want = CubicHermiteSpline(times, points, rates)
    q, rate, goal = np.array([0.01, -0.01]), np.zeros(2), points[-1]
    for k in range(1, 110):
        left = viability.travel(q, rate, goal, times, points, rates, k * h, gamma, h, h, limits, np.zeros(2, np.uint8))
        if 30 <= k < 100:
            assert np.abs(q - want(k * h)).max() < (1e-12 if a == math.inf and gamma == 1.0 else 1e-3)
    assert left < 1e-6 and np.abs(q - goal).max() < 1e-6


def test_towards_and_back_inside():
    for gamma in GAMMAS:
        assert viability.towards(0.4, 0.1, 2.0, gamma, 0.01, 1.0, 0.02) == viability.approach(
            0.4, 0.1, gamma, 0.01, 1.0, 0.02
        )
        assert viability.towards(-0.4, 0.1, 2.0, gamma, 0.01, 1.0, 0.02) == -0.1
        assert viability.towards(-0.4, 0.1, 0.5, gamma, 0.01, 1.0, 0.02) == -0.05
        assert viability.towards(-1e-4, 0.0, 2.0, gamma, 0.01, 1.0, 0.02) == -viability.approach(
            1e-4, 0.0, gamma, 0.01, 1.0, 0.02
        )
        assert viability.towards(-1e-9, -1.0, 2.0, gamma, 0.01, 1.0, 0.02) == -max(
            viability.approach(1e-9, 1.0, gamma, 0.01, 1.0, 0.02), 0.0
        )
