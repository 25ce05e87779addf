"""Limits, full turns, the reach of the wrist, random numbers and the table of starts."""

import math

import numpy as np
import pytest

from ik_toolkit.kernel import checks, limits, starts
from ik_toolkit.kernel.records import POINTS, WHAT, Ends, Task

TAU = 2.0 * math.pi


def ends_of(lower, upper, turns, unit=None, bounds=(1.0, 0.0, 1.0, 0.0, 0.0, 0.0), scale=1.0, tool=(0.0, 0.0, 0.0)):
    n = len(lower)
    points = [*np.eye(3).ravel(), 0, 0, 0, *np.eye(3).ravel(), *tool]
    unit = np.ones(n) if unit is None else unit
    middle = [*lower, *upper, *turns, *unit, *np.arange(n), *np.arange(n) + 0.5, *-np.ones(n)]
    return Ends(np.array([*points, *middle, scale, *bounds], float), n)


def test_joints_at_a_limit_are_held():
    ends = ends_of([-1.0] * 5, [1.0] * 5, [0.0] * 5)
    w = np.array([1.0, 2.0, 3.0, 0.0, 5.0])
    assert limits.hold(np.array([-1.0, 1.0, 1.0, 1.0, 0.0]), np.array([-0.1, 0.1, -0.1, 0.1, 9.0]), w, ends)
    np.testing.assert_array_equal(w, [0.0, 0.0, 3.0, 0.0, 5.0])
    assert not limits.hold(np.array([-1.0, 1.0, -1.0, 1.0, 0.0]), np.array([-0.1, 0.1, 0.1, 0.1, 9.0]), w, ends)
    assert not limits.hold(np.array([-1.0, 1.0]), np.zeros(2), np.ones(2), ends)


def test_the_wrist_must_be_reached_too():
    ends = ends_of([0.0], [1.0], [0.0], None, (3.0, 0.0, 1.0, 0.3, 0.0, 0.0), 1.0, (0.0, 0.4, 0.3))
    half = np.diag([-1.0, -1.0, 1.0])
    goal = np.array([*half.ravel(), 1.2, 0.1, 0.2, 0, 0, 0])  # the wrist is at (1.2, 0.5, -0.1)
    out = math.sqrt(1.2**2 + 0.5**2 + 0.1**2) - 1.0
    for angle in (0.0, 0.1, 0.4, 1.9):
        assert checks.beyond(goal, ends, np.array(Task(0.0)), 0.0, angle) == pytest.approx(
            max(out - 0.5 * angle, 0.0), abs=2e-9
        )
    assert checks.beyond(goal, ends, np.array(Task(0.0)), 0.05, 0.1) == pytest.approx(out - 0.1, abs=2e-9)
    assert checks.beyond(goal, ends, np.array(Task(0.0)), 0.0, 2.1) == 0.0
    free = np.array(Task(3.0, free=1.0, ax=0.0, ay=0.0, az=1.0))  # only what of the tool is along z counts
    out = math.sqrt(1.2**2 + 0.1**2 + 0.1**2) - 1.0 - 0.4
    assert checks.beyond(goal, ends, free, 0.0, 0.0) == pytest.approx(max(out, 0.0), abs=2e-9)
    goal[9] = 1.9
    out = math.sqrt(1.9**2 + 0.1**2 + 0.1**2) - 1.0 - 0.4
    assert checks.beyond(goal, ends, free, 0.0, 0.0) == pytest.approx(out, abs=2e-9)
    none = np.array(Task(3.0, w1=0.0))
    assert checks.beyond(goal, ends, none, 0.0, 0.0) == 0.0
    assert WHAT.kind == 0 and POINTS == 24


def xorshift(x):
    """xorshift64* in whole numbers."""
    mask = 2**64 - 1
    x ^= x >> 12
    x ^= (x << 25) & mask
    x ^= x >> 27
    return x, ((x * 2685821657736338717) & mask) >> 11


def test_random_numbers_are_those_of_xorshift64star():
    state = np.empty(1, np.uint64)
    for seed in (0, 1, 12345, 2**63):
        starts.seed_sequence(state, seed)
        x = 88172645463325252 ^ ((seed * 0x9E3779B97F4A7C15) % 2**64)
        assert int(state[0]) == x
        for _ in range(20):
            x, number = xorshift(x)
            assert starts.rnd(state) == number / 2**53
            assert int(state[0]) == x
    rng = np.random.default_rng(0)
    for a, b in rng.integers(0, 2**63, (50, 2)):
        assert (
            int(starts.product_64(np.uint64(2 * int(a) + 1), np.uint64(2 * int(b) + 1)))
            == (2 * int(a) + 1) * (2 * int(b) + 1) % 2**64
        )


def test_the_nearest_entries_of_a_table():
    rng = np.random.default_rng(1)
    count = 64
    T, R = rng.normal(size=(count, 3)), np.array([np.linalg.qr(rng.normal(size=(3, 3)))[0] for _ in range(count)])
    feat = np.zeros((13, count + starts.PAD), np.float32)
    feat[:3, :count], feat[3:12, :count] = -2.0 * T.T, -2.0 * 0.05 * R.reshape(count, 9).T
    feat[12, :count] = (T**2).sum(1)
    for wp, wr in ((1.0, 1.0), (1.0, 0.0), (0.0, 1.0)):
        goal = np.array([*R[5].ravel(), *rng.normal(size=3)])
        score, val = np.empty(count, np.float32), np.empty(8, np.float32)
        best = np.empty(8, np.int64)
        starts.nearest_seeds(feat, goal, wp, wr, score, val, best)
        want = wp * (((T - goal[9:]) ** 2).sum(1) - goal[9:] @ goal[9:]) - wr * 0.1 * (R.reshape(count, 9) @ goal[:9])
        np.testing.assert_allclose(score, want, atol=1e-5)
        groups = {int(g): int(g + 8 * np.argmin(want[g::8])) for g in range(8)}
        assert sorted(best) == sorted(groups.values())
        assert np.all(np.diff(want[best]) >= -1e-6)
        np.testing.assert_allclose(val, want[best], atol=1e-5)


def test_turns_of_an_answer():
    ends = ends_of([-7.0, -31.0, -7.0, -1.0], [7.0, 31.0, 7.0, 1.0], [1.0, 2.0, 1.0, 0.0])
    assert limits.turn(6.0, 0.0, ends, 0) == 1.0 and limits.turn(13.0, 0.0, ends, 0) == 1.0
    assert limits.turn(-13.0, 0.0, ends, 0) == -1.0 and limits.turn(13.0, 0.0, ends, 1) == 2.0
    assert limits.turn(3.0, 0.0, ends, 0) == 0.0 and limits.turn(3.3, 6.5, ends, 0) == 0.0
    q = np.array([0.1, 0.2, 6.5, 0.5])
    assert limits.face(q, np.array([6.0, -12.0, 0.0, 9.0]), ends)
    np.testing.assert_allclose(q, [0.1 + TAU, 0.2 - 2 * TAU, 6.5 - TAU, 0.5], atol=1e-14)
    assert not limits.face(q, np.array([6.0, -12.0, 0.0, 9.0]), ends)
    edge = ends_of([-TAU], [1.0], [1.0])
    q = np.array([0.0])
    assert limits.face(q, np.array([-7.0]), edge) and q[0] == -TAU
    a, b, w = np.array([0.1, 0.2, 6.5, 0.5]), np.array([6.0, -12.0, 0.0, 0.1]), np.array([1.0, 2.0, 0.0, 4.0])
    parts = np.array([0.1 + TAU - 6.0, 0.2 - 2 * TAU + 12.0, 6.5 - TAU, 0.4])
    want = (parts**2 / np.array([1.0, 2.0, 1e-12, 4.0])).sum()
    assert limits.distance(a, b, w, ends) == pytest.approx(want, rel=1e-12)


def test_which_starts_are_taken():
    ends = ends_of([-1.0, -1.0], [1.0, 1.0], [0.0, 2.0], [1.0, 1.0])
    for q, bounded, fine in (
        ([0.0, 0.0], True, True), ([1.0, 5.0], True, True), ([-1.0, -5.0], True, True), ([1.1, 0.0], True, False),
        ([-1.1, 0.0], True, False), ([1.1, 0.0], False, True), ([0.0, np.nan], False, False), ([np.inf, 0.0], False, False),
        ([0.0, 0.9e9], True, True), ([0.0, 1e9], True, False), ([0.0, -1e9], False, False),
    ):  # fmt: skip
        assert limits.legal(np.array(q), ends, bounded) == fine
    scaled = ends_of([-1.0], [1.0], [0.0], [4.0])
    assert limits.legal(np.array([3.9]), scaled, True) and not limits.legal(np.array([4.1]), scaled, True)
    assert limits.legal(np.array([0.0]), ends_of([-1.0], [1.0], [1.0]), True)
    assert not limits.legal(np.array([2.0]), ends_of([-1.0], [1.0], [1.0]), True)
