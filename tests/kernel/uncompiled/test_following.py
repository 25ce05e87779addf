"""Secondary wishes, the reference's clock, and rates that cannot be followed."""

from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest

from ik_toolkit.kernel.algebra import V3
from ik_toolkit.servo import laws, null_space_motion, time_scaling
from ik_toolkit.servo.laws import CV, STATE, Law


def law(code=CV, **values):
    return Law(**{**dict.fromkeys(Law._fields, 0.0), "code": code, "gamma": 1.0, **values})


# ------------------------------------------------------------------------------------------------------------- wishes
def mirror(n):
    return np.eye(3) - 2.0 * np.outer(n, n)


def test_rotations_are_mirrored():
    rng = np.random.default_rng(3)
    n = rng.normal(size=3)
    n /= np.linalg.norm(n)
    flip, y, J = np.array([[0.0, 0, 0], n]), rng.normal(size=12), rng.normal(size=(4, 12))
    got, K = y.copy(), J.copy()
    null_space_motion.reflect(flip, got)
    np.testing.assert_allclose(got, [*y[:9], *mirror(n) @ y[9:]], atol=1e-15)
    e = y.copy()
    null_space_motion.lay_aside(flip, K, e)
    np.testing.assert_allclose(e, [*got[:11], 0.0], atol=1e-15)
    np.testing.assert_allclose(K, np.column_stack([J[:, :9], (J[:, 9:] @ mirror(n))[:, :2], np.zeros(4)]), atol=1e-15)
    for axis in np.eye(3):  # any one place says that a turn is free
        e, K = np.ones(6), np.ones((1, 6))
        null_space_motion.lay_aside(axis[None], K, e)
        assert e[5] == K[0, 5] == 0.0 and not np.any(e[:5] == 0.0)


def test_errors_with_slack_become_half_planes():
    rng = np.random.default_rng(4)
    J, (e, f, ahead, a), slack, h = (
        rng.normal(size=(3, 4)),
        rng.normal(size=(4, 4)),
        np.array([0.0, 0.2, 0.0, 1.5]),
        0.1,
    )
    e[1], e[3] = 0.1, -1.5 * (1.0 + 5e-4)  # what may be rounding is no part of the task
    old, left, weight = J.copy(), [v.copy() for v in (e, f, ahead, a)], np.ones(4)
    A, b = np.zeros((6, 3)), np.zeros(6)
    assert null_space_motion.slack_rows(slack, bench(weight, J, e, f, ahead, a, A, b), 1, h, pressed(0.05)) == 5
    x = rng.normal(size=3)
    for k, row in ((1, 1), (3, 3)):
        grow = left[1][k] - old[:, k] @ x  # d/dt of the error at these rates
        for place, sign in ((row, 1.0), (row + 1, -1.0)):
            room = slack[k] - sign * left[0][k]
            assert b[place] - A[place] @ x == pytest.approx(0.5 * room / h - sign * grow)
        assert not J[:, k].any() and [v[k] for v in (e, f, ahead, a)] == [0.0] * 4
    for k in (0, 2):
        np.testing.assert_array_equal(J[:, k], old[:, k])
        assert [v[k] for v in (e, f, ahead, a)] == [v[k] for v in left]
    assert not A[0].any() and not A[5].any() and weight.tolist() == [1.0, 0.0, 1.0, 0.0]


def bench(*arrays):
    return SimpleNamespace(**dict(zip(("weight", "J", "e", "f", "ahead", "a", "planes", "edges"), arrays, strict=True)))


def pressed(seconds):
    """State in which half-planes of slacks could not be kept."""
    state = np.zeros(len(STATE))
    state[STATE.pressed] = seconds
    return state


def test_errors_are_brought_back_by_half_planes_where_these_can_be_kept():
    slack, state = np.array([0.2, 0.2]), pressed(0.0)
    for over, count in ((0.009, 4), (0.011, 2)):
        J, v = np.ones((3, 2)), np.zeros((4, 2))
        v[0] = 0.2 + over, 0.1
        planes = np.zeros((4, 3)), np.zeros(4)
        assert null_space_motion.slack_rows(slack, bench(np.ones(2), J, *v, *planes), 0, 0.1, state) == count
        assert J[:, 0].any() == (count == 2)
    assert state[STATE.pressed] == null_space_motion.PRESSED
    null_space_motion.slack_rows(slack, bench(np.ones(2), J, *np.zeros((4, 2)), *planes), 0, 0.03, state)
    assert state[STATE.pressed] == pytest.approx(null_space_motion.PRESSED - 0.03)


def test_what_of_an_error_is_beyond_its_slack_is_one_to_close():
    rng = np.random.default_rng(5)
    for sign in (1.0, -1.0):
        J, (e, f, ahead, a), weight = rng.normal(size=(3, 2)), rng.normal(size=(4, 2)), np.ones(2)
        e[1] = sign * 0.3
        old, left = J.copy(), [v.copy() for v in (e, f, ahead, a)]
        slack, planes, state = np.array([0.0, 0.2]), (np.zeros((2, 3)), np.zeros(2)), pressed(0.05)
        assert null_space_motion.slack_rows(slack, bench(weight, J, e, f, ahead, a, *planes), 0, 0.1, state) == 0
        assert state[STATE.pressed] == null_space_motion.PRESSED  # for as long as it is outside, and somewhat longer
        left[0][1] -= sign * 0.2
        left[2][1] -= sign * 0.2
        np.testing.assert_array_equal(J, old)
        np.testing.assert_array_equal([e, f, ahead, a], left)
        assert weight.tolist() == [1.0, 1.0]


def test_joints_are_led_away_from_their_limits():
    limits = np.array([[-1.0, -1.0, -1.0, -np.inf, 2.0, -1.0], [3.0, 3.0, 3.0, 1.0, 2.0, 3.0]])
    q, g = np.array([2.9, -0.8, 1.0, 0.9, 2.0, 2.4]), np.full(6, 0.5)
    null_space_motion.away_from_limits(q, limits, 2.0, g)
    edge = 0.15 * 4.0
    push = [-2.0 * edge * (1 - 0.1 / edge) ** 2, 2.0 * edge * (1 - 0.2 / edge) ** 2, 0.0, 0.0, 0.0, 0.0]
    np.testing.assert_allclose(g, 0.5 + np.array(push), rtol=1e-12)


def test_wishes_keep_half_of_the_room():
    x, low, top = np.array([0.0, 0.0, 0.5]), np.full(3, -1.0), np.full(3, 1.0)
    for g, scale in (([0.4, -0.4, 0.2], 1.0), ([2.0, 0.0, 0.0], 0.25), ([0.0, -1.0, 0.0], 0.5), ([0.0, 0.1, 0.5], 0.5),
                     ([0.0, 0.0, -3.0], 0.25)):  # fmt: skip
        out = np.array(g)
        null_space_motion.clip_wish(out, x, low, top)
        np.testing.assert_allclose(out, scale * np.array(g), rtol=1e-14)
    out = np.array([0.1, 0.0, 0.0])
    null_space_motion.clip_wish(out, np.array([1.5, 0.0, 0.0]), low, top)
    np.testing.assert_array_equal(out, 0.0)
    out = np.array([-0.1, 0.0, 0.0])
    null_space_motion.clip_wish(out, np.array([-1.5, 0.0, 0.0]), low, top)
    np.testing.assert_array_equal(out, 0.0)


def test_wishes_go_into_the_null_space():
    rng = np.random.default_rng(5)
    J, g = rng.normal(size=(7, 6)), rng.normal(size=7)
    G, y, t, part, out = np.zeros((7, 7)), np.empty(7), np.empty(6), np.empty(7), g.copy()
    laws.factor(J, 6, 0.0, G, y)
    null_space_motion.into_null_space(J, 6, G, y, t, out, part)
    np.testing.assert_allclose(out, g - np.linalg.pinv(J.T) @ (J.T @ g), atol=1e-10)


# -------------------------------------------------------------------------------------------------------------- clock
def test_cubics_meet_both_ends():
    rng = np.random.default_rng(6)
    a, b, u, v = (V3(*rng.normal(size=3)) for _ in range(4))
    np.testing.assert_allclose(np.concatenate(time_scaling.cubic(a, b, u, v, 0.0)), [*a, *u])
    np.testing.assert_allclose(np.concatenate(time_scaling.cubic(a, b, u, v, 1.0)), [*b, *v], atol=1e-14)
    for f in (0.2, 0.7):
        s = np.array([2 * f**3 - 3 * f**2 + 1, 3 * f**2 - 2 * f**3, f**3 - 2 * f**2 + f, f**3 - f**2])
        d = np.array([6 * f**2 - 6 * f, 6 * f - 6 * f**2, 3 * f**2 - 4 * f + 1, 3 * f**2 - 2 * f])
        value, slope = time_scaling.cubic(a, b, u, v, f)
        np.testing.assert_allclose(value, s @ np.array([a, b, u, v]), atol=1e-14)
        np.testing.assert_allclose(slope, d @ np.array([a, b, u, v]), atol=1e-14)


def test_turns_of_a_reference():
    rng = np.random.default_rng(7)
    for size in (0.0, 1e-6, 0.9e-4, 1.1e-4, 0.3, 3.0):
        r = rng.normal(size=3)
        r *= size / np.linalg.norm(r)
        T0, T1 = np.eye(4), np.eye(4)
        T0[:3, :3] = pin.exp3(rng.normal(size=3))
        time_scaling.turned(T0, V3(*r), T1)
        np.testing.assert_allclose(T1[:3, :3], pin.exp3(r) @ T0[:3, :3], rtol=0.0, atol=1e-14)
        np.testing.assert_allclose(time_scaling.turn_left(T0, T1), r, atol=1e-12)


def samples(rng, N, F):
    T, V, A = np.zeros((N, F, 4, 4)), rng.normal(size=(N, 6 * F)), rng.normal(size=(N, 6 * F))
    for j in range(N):
        for k in range(F):
            T[j, k] = pin.SE3(pin.exp3(0.5 * rng.normal(size=3)), rng.normal(size=3)).homogeneous
    return T, V, A


def test_references_between_samples():
    rng = np.random.default_rng(8)
    h, F = 0.1, 2
    T, V, A = samples(rng, 4, F)

    def at(s):
        out = np.full((F, 4, 4), 7.0), np.full(6 * F, 7.0), np.full(6 * F, 7.0)
        time_scaling.reference(T, V, A, s, h, *out)
        return out

    for s in (0.0, 2.0, 3.0, 3.6, 8.0):
        j = min(int(s), 3)
        for got, want in zip(at(s), (T[j], V[j], A[j]), strict=True):
            np.testing.assert_array_equal(got, want)
    for j in range(3):
        near, far = at(j + 1e-9), at(j + 1 - 1e-9)
        for k, (got, want) in enumerate(
            zip((*near, *far), (T[j], V[j], A[j], T[j + 1], V[j + 1], A[j + 1]), strict=True)
        ):
            if k != 4:
                np.testing.assert_allclose(got, want, atol=1e-6)
        # the turn's own rate is that of the rotation vector, from the first sample on
        np.testing.assert_allclose(far[1].reshape(F, 6)[:, :3], V[j + 1].reshape(F, 6)[:, :3], atol=1e-6)
        np.testing.assert_allclose(far[1], V[j + 1], atol=1e-6)
        f, d = 0.4, 1e-6
        pose, twist, acceleration = at(j + f)
        one, other = at(j + f - d)[0], at(j + f + d)[0]
        np.testing.assert_allclose(acceleration, A[j] + f * (A[j + 1] - A[j]), rtol=1e-12)
        for k in range(F):
            speed = (other[k, :3, 3] - one[k, :3, 3]) / (2 * d * h)
            np.testing.assert_allclose(twist[6 * k : 6 * k + 3], speed, atol=1e-6)
            np.testing.assert_array_equal(pose[k, 3], [0, 0, 0, 1])
            start = pin.log3(T[j + 1, k, :3, :3] @ T[j, k, :3, :3].T)
            r, w = time_scaling.cubic(
                V3(0, 0, 0),
                V3(*start),
                V3(*(V[j, 6 * k + 3 : 6 * k + 6] * h)),
                V3(*(V[j + 1, 6 * k + 3 : 6 * k + 6] * h)),
                f,
            )
            np.testing.assert_allclose(pose[k, :3, :3], pin.exp3(np.array(r)) @ T[j, k, :3, :3], atol=1e-13)
            np.testing.assert_allclose(twist[6 * k + 3 : 6 * k + 6], np.array(w) / h, rtol=1e-12)


def test_errors_over_their_tolerance():
    E = np.array([0.3, 0.4, 0.0, 0.0, 0.6, 0.8, 0.0, 0.0, 2.0, 0.1, 0.0, 0.0])
    assert time_scaling.too_far(E, 1.0, 1.0) == 2.0 and time_scaling.too_far(E[:6], 0.1, 1.0) == pytest.approx(5.0)
    assert time_scaling.too_far(E[:6], 1.0, 0.1) == pytest.approx(10.0) and time_scaling.too_far(
        E, 1.0, 0.05
    ) == pytest.approx(20.0)


def clocked(**values):
    state = np.zeros(len(STATE))
    for name, value in values.items():
        state[getattr(STATE, name)] = value
    return state


def test_the_clock_waits_until_the_error_is_small_again():
    state = clocked(sigma=0.5)
    assert time_scaling.next_rate(state, 0.9, 0.8, 0.1) == 0.8 and state[STATE.waiting] == 0.0
    assert time_scaling.next_rate(clocked(sigma=0.5), 0.9, 2.0, 0.1) == 1.0
    assert time_scaling.next_rate(clocked(sigma=0.5), 0.9, 1.0, 0.01) == pytest.approx(0.6)
    assert time_scaling.next_rate(clocked(sigma=0.5), 0.9, 0.0, 0.01) == pytest.approx(0.4)
    assert time_scaling.next_rate(state, 1.0, 0.8, 1.0) == 0.8
    assert time_scaling.next_rate(state, 1.1, 0.8, 1.0) == 0.0 and state[STATE.waiting] == 1.0
    assert time_scaling.next_rate(state, 0.5, 0.8, 1.0) == 0.0 and state[STATE.waiting] == 1.0
    assert time_scaling.next_rate(state, 0.49, 0.8, 1.0) == 0.8 and state[STATE.waiting] == 0.0


def test_where_waiting_does_not_help_the_run_goes_on():
    state = clocked(sigma=0.5, waiting=1.0, least=5.0)
    h = 0.125
    assert time_scaling.next_rate(state, 2.0, 1.0, h) == 0.0  # nearer than ever
    assert state[STATE.idle] == 0.0 and state[STATE.least] == 2.0
    for k in range(8):
        time_scaling.next_rate(state, 1.99, 1.0, h)
        assert state[STATE.idle] == (k + 1) * h and state[STATE.leaving] == 0.0 and state[STATE.least] == 2.0
    state[STATE.sigma] = 0.0
    assert time_scaling.next_rate(state, 1.99, 1.0, h) == 1.0
    assert state[STATE.leaving] == 1.0 and state[STATE.idle] == 0.0
    assert (
        time_scaling.next_rate(state, 1.5, 1.0, h) == 1.0 and state[STATE.leaving] == 2.0 and state[STATE.idle] == 0.0
    )
    assert time_scaling.next_rate(state, 0.6, 1.0, h) == 1.0 and state[STATE.leaving] == 2.0
    time_scaling.next_rate(state, 0.4, 1.0, h)
    assert state[STATE.leaving] == 0.0 and state[STATE.waiting] == 0.0
    state = clocked(leaving=1.0, idle=0.99, least=1.0, sigma=0.0)  # and back
    time_scaling.next_rate(state, 0.7 * 1.5, 1.0, h)
    assert state[STATE.leaving] == 2.0 and state[STATE.idle] == 0.0
    state = clocked(leaving=1.0, idle=0.99, least=0.8, sigma=0.0)
    time_scaling.next_rate(state, 0.8, 1.0, h)
    assert state[STATE.leaving] == 0.0 and state[STATE.idle] == 0.0
    state = clocked(sigma=0.0009, least=0.1)  # stands still without waiting
    time_scaling.next_rate(state, 0.3, 1.0, h)
    assert state[STATE.idle] == h
    state = clocked(sigma=0.0011, least=0.1)
    time_scaling.next_rate(state, 0.3, 1.0, h)
    assert state[STATE.idle] == 0.0 and state[STATE.least] == 0.3


def test_slopes_of_the_square_of_the_rate():
    assert time_scaling.slope_range(1.0, 0.5, 2.0, 3.0, 4.0) == ((-4.0 - 1.5) / 2.0, (4.0 - 1.5) / 2.0)
    assert time_scaling.slope_range(1.0, 0.5, -2.0, 3.0, 4.0) == ((4.0 - 1.5) / -2.0, (-4.0 - 1.5) / -2.0)
    assert time_scaling.slope_range(1.0, 0.5, 0.9e-12, 3.0, 4.0) == (-np.inf, np.inf)
    assert time_scaling.slope_range(1.0, 0.5, 1.1e-12, 3.0, 4.0)[1] < np.inf


def controllable(Q, limits, h, cap, z_end=1.0):
    """Largest squares of the clock's rate by trying every one of a fine grid, from the end."""
    N, grid = len(Q) - 1, np.linspace(0.0, 1.0, 20001)
    ahead, found = z_end, np.empty(N + 1)
    for k in range(N, -1, -1):
        a = min(k, N - 1)
        speeds = [np.abs(Q[a + 1] - Q[a]) / h] + ([np.abs(Q[a] - Q[a - 1]) / h] if a > 0 else [])
        top = cap[k] ** 2
        with np.errstate(divide="ignore"):
            top = min(top, ((0.98 * limits[2] / np.max(speeds, axis=0)) ** 2).min())
        if k < N:
            v = (Q[k + 1] - Q[k]) / h
            before = (Q[k] - Q[k - 1]) / h if k > 0 else v
            c = (v - before) / h
            z = np.append(grid[grid <= top], top)
            low, high = np.full(len(z), -10.0), np.full(len(z), 10.0)
            for i in np.flatnonzero(np.isfinite(limits[3])):
                ends = np.array([(-0.98 * limits[3, i] - c[i] * z) / v[i], (0.98 * limits[3, i] - c[i] * z) / v[i]])
                low, high = np.maximum(low, ends.min(0)), np.minimum(high, ends.max(0))
            top = z[low <= np.minimum(high, 0.5 * (ahead - z) / h)].max()
        ahead = found[k] = top
    return np.sqrt(found)


def test_the_look_ahead_finds_the_fastest_clock():
    rng = np.random.default_rng(9)
    slower = 0
    for trial in range(6):
        h, N, n = 0.05, 14, 3
        Q = np.cumsum(rng.normal(size=(N + 1, n)) * 0.02, axis=0) + 0.05 * np.arange(N + 1)[:, None]
        limits = np.array([np.full(n, -9.0), np.full(n, 9.0), rng.uniform(0.8, 2.0, n), rng.uniform(6.0, 40.0, n)])
        if trial == 4:
            limits[3] = np.inf
        if trial == 5:
            limits[2] = np.inf
        given = np.where(rng.random(N + 1) < 0.2, 0.5, 1.0)
        cap, joint = given.copy(), np.full(N + 1, -5.0)
        time_scaling.look_ahead(Q, limits, h, cap, joint)
        want = controllable(Q, limits, h, given)
        np.testing.assert_allclose(cap, want, atol=3e-4)
        slower += np.sum(want < given - 1e-3)
        assert set(joint) <= {-1.0, 0.0, 1.0, 2.0}
        assert np.all((joint >= 0) | (cap >= given - 1e-9))
    assert slower > 10
    Q = np.zeros((4, 2))
    cap, joint = np.ones(4), np.zeros(4)
    time_scaling.look_ahead(Q, np.ones((4, 2)), 0.1, cap, joint)
    np.testing.assert_array_equal(cap, 1.0)
    np.testing.assert_array_equal(joint, -1.0)
    Q[:, 1] = [0.0, 0.2, 0.4, 0.6]  # twice as fast as it may be: 0.98 of 1 of 2
    time_scaling.look_ahead(Q, np.array([[-9.0] * 2, [9.0] * 2, [1.0] * 2, [np.inf] * 2]), 0.1, cap, joint)
    np.testing.assert_allclose(cap, 0.49)
    np.testing.assert_array_equal(joint, 1.0)
