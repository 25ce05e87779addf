"""Limits, full turns, allowed steps, and why an attempt stalls."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from ik_toolkit.kernel import checks, limits, starts
from ik_toolkit.kernel.records import POINTS, WHAT, Ends, Task

TAU = 2.0 * math.pi


def ends_of(lower, upper, turns, unit=None, bounds=(1.0, 0.0, 1.0, 0.0, 0.0, 0.0), scale=1.0, tool=(0.0, 0.0, 0.0)):
    n = len(lower)
    points = [*np.eye(3).ravel(), 0, 0, 0, *np.eye(3).ravel(), *tool]
    middle = [
        *lower,
        *upper,
        *turns,
        *(np.ones(n) if unit is None else unit),
        *np.arange(n),
        *np.arange(n) + 0.5,
        *-np.ones(n),
    ]
    return Ends(np.array([*points, *middle, scale, *bounds], float), n)


def test_places_of_the_ends():
    ends = ends_of([1, 2], [3, 4], [0, 1], [5, 6], (11, 12, 13, 14, 15, 16), 8.0)
    assert [ends.lower(1), ends.upper(1), ends.turns(1), ends.unit(1), ends.low(1), ends.span(1), ends.home(1)] == [
        2, 4, 1, 6, 1, 1.5, -1,
    ]  # fmt: skip
    assert [ends.lower(0), ends.upper(0), ends.turns(0), ends.unit(0), ends.low(0), ends.span(0), ends.home(0)] == [
        1, 3, 0, 5, 0, 0.5, -1,
    ]  # fmt: skip
    assert ends.scale() == 8.0 and [ends.bound(k) for k in range(6)] == [11, 12, 13, 14, 15, 16]
    ends.confine(1, -7.0, 7.0)
    assert (ends.lower(1), ends.upper(1), ends.turns(1)) == (-7.0, 7.0, 0.0) and ends.lower(0) == 1


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


def test_the_neighbourhood_of_a_start():
    rows = np.zeros((4, 10))
    rows[:, 8], rows[:, 9] = [0, 1, 2, 1], [1.0, 0.0, 1.0, 0.0]
    q0 = np.array([0.9, 2.0, 3.0])
    for bounded in (True, False):
        ends = ends_of([-1.0, 0.0, -9.0], [1.0, 0.6, 3.1], [0.0, 0.0, 2.0], [1.0, 4.0, 1.0])
        near = Ends(ends.flat.copy(), 3)
        limits.neighbourhood(q0, rows, 0.3, 0.8, bounded, ends, near)
        np.testing.assert_allclose([near.lower(0), near.lower(1), near.lower(2)], [0.6, 0.3, 2.7], rtol=1e-14)
        np.testing.assert_allclose(
            [near.upper(0), near.upper(1), near.upper(2)], [1.0, 0.6, 3.3] if bounded else [1.2, 0.7, 3.3], rtol=1e-14
        )
        for i, unit in enumerate((1.0, 4.0, 1.0)):
            assert near.turns(i) == 0.0
            width = (0.8 / unit) if i == 1 else 0.3
            assert q0[i] / unit - near.lower(i) <= width and near.upper(i) - q0[i] / unit <= width
    low = Ends(ends.flat.copy(), 3)
    limits.neighbourhood(np.array([-0.9, 0.1, 0.0]), rows, 0.3, 0.8, True, ends, low)
    np.testing.assert_allclose([low.lower(0), low.lower(1), low.lower(2)], [-1.0, 0.0, -0.3], rtol=1e-14)


def test_joints_at_a_limit_are_held():
    ends = ends_of([-1.0] * 5, [1.0] * 5, [0.0] * 5)
    w = np.array([1.0, 2.0, 3.0, 0.0, 5.0])
    assert limits.hold(np.array([-1.0, 1.0, 1.0, 1.0, 0.0]), np.array([-0.1, 0.1, -0.1, 0.1, 9.0]), w, ends)
    np.testing.assert_array_equal(w, [0.0, 0.0, 3.0, 0.0, 5.0])
    assert not limits.hold(np.array([-1.0, 1.0, -1.0, 1.0, 0.0]), np.array([-0.1, 0.1, 0.1, 0.1, 9.0]), w, ends)
    assert not limits.hold(np.array([-1.0, 1.0]), np.zeros(2), np.ones(2), ends)


def test_steps_end_inside_the_limits():
    ends = ends_of([-1.0, -4.0, -4.0, -np.inf, -1.0, -2.0], [1.0, 3.0, 3.0, 3.0, 1.0, np.inf], [0, 1, 1, 1, 0, 1])
    q = np.array([0.5, 2.5, -3.5, 2.0, 1.2, -1.9])
    old = q.copy()
    moved, far = limits.integrate(q, np.array([0.9, 1.0, -1.0, 2.0, 0.0, -0.5]), True, ends)
    np.testing.assert_allclose(q, [1.0, 3.5 - TAU, -4.5 + TAU, 4.0 - TAU, 1.2, -2.4 + TAU], atol=1e-15)
    assert moved == np.abs(q - old).max() and far == np.abs(q).max()
    q = np.array([0.5, 0.0])
    assert limits.integrate(q, np.array([2.0, -9.0]), False, ends) == (9.0, 9.0)
    np.testing.assert_array_equal(q, [2.5, -9.0])
    q = np.array([-0.5, 0.0])
    assert limits.integrate(q, np.array([-2.0, 0.0]), True, ends) == (0.5, 1.0) and q[0] == -1.0
    assert math.isnan(limits.integrate(np.zeros(2), np.array([np.nan, 1.0]), True, ends)[1])
    assert limits.middle(-np.inf, 3.0) == 3.0 - math.pi and limits.middle(-2.0, np.inf) == math.pi - 2.0
    assert limits.middle(-2.0, 3.0) == 0.5


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


def standing(q, slopes, J=None, ee=1.0):
    """A problem that stands at q with these slopes."""
    J = np.ones((len(q), 6)) if J is None else J
    return SimpleNamespace(desk=SimpleNamespace(q=np.array(q), J=J), slope=lambda _, i: slopes[i]), SimpleNamespace(
        ee=ee
    )


def test_who_holds_the_neighbourhood_back():
    ends = ends_of([-1.0, -1.0, -9.0], [1.0, 1.0, 9.0], [0.0, 0.0, 2.0])
    near = ends_of([-0.5, -1.0, -9.0], [0.5, 1.0, 9.0], [0.0] * 3)
    for q, slopes, bounded, who in (
        ([-0.5, 0.0, 0.0], [-1.0, 5.0, 0.0], True, 0), ([-0.5, 0.0, 0.0], [1.0, 5.0, 0.0], True, -1),
        ([0.5, 0.0, 0.0], [1.0, 5.0, 0.0], True, 0), ([0.0, 1.0, 0.0], [1.0, 5.0, 0.0], True, -1),
        ([0.0, 1.0, 0.0], [1.0, 5.0, 0.0], False, 1), ([0.0, -1.0, 0.0], [1.0, -5.0, 0.0], False, 1),
        ([0.0, -1.0, 0.0], [1.0, -5.0, 0.0], True, -1), ([0.5, 0.0, 9.0], [1.0, 0.0, 2.0], True, 2),
        ([0.5, 0.0, 9.0], [3.0, 0.0, 2.0], True, 0), ([0.5, 0.0, -9.0], [1.0, 0.0, -2.0], True, 2),
        ([0.5, 0.0, 9.0], [0.0, 0.0, 0.0], True, -1),
    ):  # fmt: skip
        p, look = standing(q, slopes)
        assert limits.held_back(p, look, near, ends, bounded) == who, (q, slopes)


def test_why_an_attempt_stands_still():
    near = ends_of([-1.0, -1.0], [1.0, 1.0], [0.0, 0.0])
    for q, slopes, boxed, why in (
        ([0.0, 0.0], [1.0, 1.0], True, checks.CODE.stalled), ([-1.0, 1.0], [-1.0, 1.0], True, checks.CODE.limit_blocked),
        ([1.0, -1.0], [1.0, -1.0], True, checks.CODE.limit_blocked), ([1.0, -1.0], [-1.0, 1.0], True, checks.CODE.stalled),
        ([-1.0, 1.0], [-1.0, 1.0], False, checks.CODE.stalled), ([-1.0, 0.0], [-1.0, 0.009], True, checks.CODE.limit_blocked),
        ([-1.0, 0.0], [-1.0, 0.011], True, checks.CODE.stalled), ([0.0, 0.0], [0.0, 0.0], True, checks.CODE.singular),
        ([0.0, 0.0], [0.0, 3.0e-8], True, checks.CODE.singular), ([0.0, 0.0], [0.0, 4.0e-8], True, checks.CODE.stalled),
    ):  # fmt: skip
        p, look = standing(q, slopes)  # 1e-16 of 12 entries of 1: slopes below 3.46e-8 are rounding
        assert checks.standstill(p, look, near, boxed) == why, (q, slopes)


def test_poses_that_are_rigid():
    rng = np.random.default_rng(0)
    for _ in range(5):
        R, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        R *= np.linalg.det(R)
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = R, rng.normal(size=3)
        assert checks.rigid(T, 1e-6) and checks.is_rigid(T)
        for r in range(4):
            for c in range(4):
                bad = T.copy()
                bad[r, c] = np.nan
                assert not checks.rigid(bad, 1e-6)
                off = T.copy()
                off[r, c] += 2e-6 if r < 3 and c < 3 else 0.0
                skew = np.abs(off[:3, :3].T @ off[:3, :3] - np.eye(3)).max()
                assert checks.rigid(off, 1e-6) == (skew < 1e-6) or abs(skew - 1e-6) < 1e-12
            bad = T.copy()
            bad[3, r] += 3e-9
            assert not checks.rigid(bad, 1e-6)
            bad = T.copy()
            bad[3, r] -= 5e-10
            assert checks.rigid(bad, 1e-6)
        mirrored = T.copy()
        mirrored[:3, 0] *= -1.0
        assert not checks.rigid(mirrored, 1e-6)
        far = T.copy()
        far[rng.integers(3), 3] = -2e100
        assert not checks.rigid(far, 1e-6)
        far[:3, 3] = 0.3e100
        assert checks.rigid(far, 1e-6)
    for k in range(3):  # each column doubled, each pair of columns the same
        T = np.eye(4)
        T[k, k] = 1.0 + 0.7e-6
        assert not checks.rigid(T, 1e-6)
        T[k, k] = 1.0 + 0.3e-6
        assert checks.rigid(T, 1e-6)


def test_rings_and_targets_beyond():
    rng = np.random.default_rng(1)
    from ik_toolkit.kernel.algebra import V3

    for _ in range(200):
        reach, low, high = rng.uniform(0.5, 2.0), *np.sort(rng.normal(size=2))
        hole = rng.uniform(0.0, reach)
        p = rng.normal(size=3) * 1.5
        ends = ends_of([0.0], [1.0], [0.0], None, (reach, hole, reach, hole, low, high))
        far = max(math.dist(p, (0, 0, z)) for z in (low, high))
        near = math.dist(p, (0, 0, np.clip(p[2], low, high)))
        want = max(near - reach, hole - far) - 0.01
        assert checks.ring(V3(*p), reach, hole, ends, 0.01) == pytest.approx(want, rel=1e-12, abs=1e-14)
        goal = np.array([*np.eye(3).ravel(), *p, *p])
        task = np.array(Task(0.0))
        excess = checks.beyond(goal, ends, task, 0.001, 0.1)
        assert excess == pytest.approx(max(0.0, want + 0.01 - 0.001), abs=3e-9)
        if 0.0 < excess and near > reach:  # then the goal is moved to the edge
            checks.edge(goal, ends, near - reach)
            at = goal[9:12]
            foot = np.array([0, 0, np.clip(p[2], low, high)])
            assert np.linalg.norm(at - foot) == pytest.approx(reach)
            np.testing.assert_allclose(np.cross(at - foot, p - foot), 0.0, atol=1e-12)
            assert (at - foot) @ (p - foot) > 0.0


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


def test_a_goal_inside_the_hole_moves_outwards():
    ends = ends_of([0.0], [1.0], [0.0], None, (2.0, 0.8, 2.0, 0.8, -0.1, 0.2))
    goal = np.array([*np.eye(3).ravel(), 0.3, 0.4, 0.1, 0, 0, 0])
    checks.edge(goal, ends, 0.3)
    np.testing.assert_allclose(goal[9:12], [0.48, 0.64, 0.1], atol=1e-15)
    goal = np.array([*np.eye(3).ravel(), 3.0, 4.0, 0.7, 0, 0, 0])
    checks.edge(goal, ends, 1.0)
    out = np.array([3.0, 4.0, 0.5])
    np.testing.assert_allclose(goal[9:12], [0, 0, 0.2] + out * (1.0 - 1.0 / np.linalg.norm(out)), atol=1e-15)


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
