"""Secondary wishes, and slack as half-planes."""

from types import SimpleNamespace

import numpy as np
import pytest

from ik_toolkit.servo import null_space_motion
from ik_toolkit.servo.workspace import STATE


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
    null_space_motion.mirror_free_rows(flip, K, e)
    np.testing.assert_allclose(e, [*got[:11], 0.0], atol=1e-15)
    np.testing.assert_allclose(K, np.column_stack([J[:, :9], (J[:, 9:] @ mirror(n))[:, :2], np.zeros(4)]), atol=1e-15)
    for axis in np.eye(3):  # any one place says that a turn is free
        e, K = np.ones(6), np.ones((1, 6))
        null_space_motion.mirror_free_rows(axis[None], K, e)
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
    assert state[STATE.pressed] == null_space_motion.SLACK.pressed
    null_space_motion.slack_rows(slack, bench(np.ones(2), J, *np.zeros((4, 2)), *planes), 0, 0.03, state)
    assert state[STATE.pressed] == pytest.approx(null_space_motion.SLACK.pressed - 0.03)


def test_what_of_an_error_is_beyond_its_slack_is_one_to_close():
    rng = np.random.default_rng(5)
    for sign in (1.0, -1.0):
        J, (e, f, ahead, a), weight = rng.normal(size=(3, 2)), rng.normal(size=(4, 2)), np.ones(2)
        e[1] = sign * 0.3
        old, left = J.copy(), [v.copy() for v in (e, f, ahead, a)]
        slack, planes, state = np.array([0.0, 0.2]), (np.zeros((2, 3)), np.zeros(2)), pressed(0.05)
        assert null_space_motion.slack_rows(slack, bench(weight, J, e, f, ahead, a, *planes), 0, 0.1, state) == 0
        # for as long as it is outside, and somewhat longer
        assert state[STATE.pressed] == null_space_motion.SLACK.pressed
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
        null_space_motion.scale_secondary(out, x, low, top)
        np.testing.assert_allclose(out, scale * np.array(g), rtol=1e-14)
    out = np.array([0.1, 0.0, 0.0])
    null_space_motion.scale_secondary(out, np.array([1.5, 0.0, 0.0]), low, top)
    np.testing.assert_array_equal(out, 0.0)
    out = np.array([-0.1, 0.0, 0.0])
    null_space_motion.scale_secondary(out, np.array([-1.5, 0.0, 0.0]), low, top)
    np.testing.assert_array_equal(out, 0.0)
