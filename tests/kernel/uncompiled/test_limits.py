"""Ends of a chain, the neighbourhood of a start, random numbers and the table of starts."""

import numpy as np

from ik_toolkit.kernel import limits, seeds
from ik_toolkit.kernel.records import Ends


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
        seeds.sow(state, seed)
        x = 88172645463325252 ^ ((seed * 0x9E3779B97F4A7C15) % 2**64)
        assert int(state[0]) == x
        for _ in range(20):
            x, number = xorshift(x)
            assert seeds.rnd(state) == number / 2**53
            assert int(state[0]) == x
    rng = np.random.default_rng(0)
    for a, b in rng.integers(0, 2**63, (50, 2)):
        assert (
            int(seeds.product(np.uint64(2 * int(a) + 1), np.uint64(2 * int(b) + 1)))
            == (2 * int(a) + 1) * (2 * int(b) + 1) % 2**64
        )


def test_the_nearest_entries_of_a_table():
    rng = np.random.default_rng(1)
    count = 64
    T, R = rng.normal(size=(count, 3)), np.array([np.linalg.qr(rng.normal(size=(3, 3)))[0] for _ in range(count)])
    feat = np.zeros((13, count + seeds.PAD), np.float32)
    feat[:3, :count], feat[3:12, :count] = -2.0 * T.T, -2.0 * 0.05 * R.reshape(count, 9).T
    feat[12, :count] = (T**2).sum(1)
    for wp, wr in ((1.0, 1.0), (1.0, 0.0), (0.0, 1.0)):
        goal = np.array([*R[5].ravel(), *rng.normal(size=3)])
        score, val = np.empty(count, np.float32), np.empty(8, np.float32)
        best = np.empty(8, np.int64)
        seeds.nearest(feat, goal, wp, wr, score, val, best)
        want = wp * (((T - goal[9:]) ** 2).sum(1) - goal[9:] @ goal[9:]) - wr * 0.1 * (R.reshape(count, 9) @ goal[:9])
        np.testing.assert_allclose(score, want, atol=1e-5)
        groups = {int(g): int(g + 8 * np.argmin(want[g::8])) for g in range(8)}
        assert sorted(best) == sorted(groups.values())
        assert np.all(np.diff(want[best]) >= -1e-6)
        np.testing.assert_allclose(val, want[best], atol=1e-5)
