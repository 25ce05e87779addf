"""Poses in between, solutions carried along poses, and the program over tracks of them."""

import numpy as np
import pinocchio as pin
import pytest
import random_arms as arms

from ik_toolkit.kernel.counted_error import KIND
from ik_toolkit.kernel.records import Orders, Task
from ik_toolkit.paths import continuation, shortest_path

ORDERS = Orders(**{**dict.fromkeys(Orders._fields, 0.0), "tol_p": 1e-9, "tol_r": 1e-9, "limits": 1.0})


def test_poses_between_poses():
    rng = np.random.default_rng(8)
    for angle in (0.0, 1e-13, 1e-6, 0.7, 2.5, 3.1):
        axis = rng.normal(size=3)
        axis *= angle / np.linalg.norm(axis)
        A, B = np.eye(4), np.eye(4)
        A[:3, :3], A[:3, 3], B[:3, 3] = pin.exp3(rng.normal(size=3)), rng.normal(size=3), rng.normal(size=3)
        B[:3, :3] = pin.exp3(axis) @ A[:3, :3]
        out = np.empty(16)
        for s in (0.0, 0.25, 0.8, 1.0):
            continuation.blend(A.ravel(), B.ravel(), s, out)
            got = out.reshape(4, 4)
            np.testing.assert_allclose(got[:3, 3], A[:3, 3] + s * (B[:3, 3] - A[:3, 3]), atol=1e-15)
            np.testing.assert_allclose(got[:3, :3], pin.exp3(s * axis) @ A[:3, :3], atol=1e-9 if angle > 3 else 1e-12)
            np.testing.assert_array_equal(got[3], [0, 0, 0, 1])
    q, old, most = np.array([0.1, -0.2]), np.zeros(2), np.array([0.1, 0.2])
    assert continuation.within(q, old, most) and not continuation.within(q * 1.0001, old, most)
    assert not continuation.within(np.array([np.nan, 0.0]), old, most) and not continuation.within(
        -q * 1.0001, old, most
    )


def test_solutions_are_carried_along_poses():
    rng = np.random.default_rng(9)
    chain, rows, base, tip = arms.arm(rng, "tttttt")
    q = 0.5 * rng.uniform(chain.lower, chain.upper)
    n, N = chain.n, 7
    goals = q + np.linspace(-0.12, 0.12, N)[:, None] * rng.normal(size=n)
    T = np.array([arms.fk(rows, base, tip, g)[0] for g in goals])
    bounds = np.array([np.full(n, -9.0), np.full(n, 9.0), np.ones(n)])
    pack = np.array([*ORDERS._replace(tol_p=1e-8, tol_r=1e-8), *Task(float(KIND.pose)), *np.ones(n)])

    def carried(most, deviation=(1e-2, 1e-2), broken=None):
        Q, span = np.full((N, 2, n), np.nan), np.full((2, 2), -1)
        poses = T.copy()
        if broken is not None:
            poses[broken, :3, 3] += 9.0
        starts = goals[[3, 0]].copy(), np.array([3, 0]), np.array([1, 0])
        allowed = bounds, np.full(n, most), np.array(deviation)
        continuation.carry_along(chain.rows, chain.ends, poses, pack, *allowed, *starts, Q, span)
        return Q, span

    Q, span = carried(0.5)
    assert span.tolist() == [[0, N - 1], [0, N - 1]]
    np.testing.assert_allclose(Q[:, 1], goals, atol=1e-6)
    np.testing.assert_allclose(Q[:, 0], goals, atol=1e-6)
    Q, span = carried(0.5, broken=5)
    assert span.tolist() == [[0, 4], [0, 4]] and np.isnan(Q[5:]).all()
    Q, span = carried(1e-7)
    assert span.tolist() == [[0, 0], [3, 3]]
    np.testing.assert_array_equal(Q[3, 1], goals[3])
    finer, again = carried(0.04)[1], carried(0.5, (1e-4, 1e-4))  # smaller steps in between lead to the same
    assert finer.tolist() == [[0, N - 1], [0, N - 1]]
    np.testing.assert_allclose(again[0][:, 1], goals, atol=1e-6)
    for deviation in ((1e-12, 1.0), (1.0, 1e-12)):
        assert carried(0.5, deviation)[1].tolist() == [[0, 0], [3, 3]]


def best_path(Q, state, most, endless, steep, begin, toll, blocked, near=True):
    """Counts and costs of the cheapest way to each state by trying all pairs of each layer (Bellman)."""
    N, K, n = Q.shape
    counts, costs = np.zeros((N, K)), np.zeros((N, K))
    alive = state != shortest_path.DEAD
    last = -1
    for t in range(N):
        for b in np.flatnonzero(alive[t]):
            if last < 0:
                ways = [(begin[0, b], begin[1, b])]
            else:
                came = [a for a in np.flatnonzero(alive[last])]
                first = min((counts[last, a], costs[last, a]) for a in came)
                ways = [(first[0] + 1, first[1] + shortest_path.LEAP)]
                for a in came if last == t - 1 else ():
                    if any((e == (t, a, b)).all() for e in blocked):
                        continue
                    d = Q[t, b].astype(float) - Q[last, a].astype(float)
                    d = np.abs(
                        np.where((endless > 0) & (np.abs(d) > np.pi), d - 2 * np.pi * np.rint(d / (2 * np.pi)), d)
                    )
                    if a != b and np.any(d > most):
                        continue
                    extra = shortest_path.LONG if np.any(d > most) else 0.0
                    ways.append((counts[last, a], costs[last, a] + (d + steep * d * d).sum() + extra))
            counts[t, b], costs[t, b] = min(ways)
            costs[t, b] += toll[t, b]
            counts[t, b] += (1 << 20) * (state[t, b] == shortest_path.TOUCHING)
        if alive[t].any():
            last = t
    return counts, costs


@pytest.mark.parametrize("seed", range(12))
def test_the_program_over_tracks(seed):
    rng = np.random.default_rng(seed)
    N, K, n = 7, 9, 2
    endless = np.array([float(seed % 2), 0.0])
    Q = (rng.uniform(-0.4, 0.4, (1, K, n)) + 0.2 * rng.normal(size=(N, K, n))).astype(np.float32)
    if endless[0]:
        Q[..., 0] += np.float32(np.pi)
        Q[..., 0] -= np.float32(2 * np.pi) * np.rint(Q[..., 0] / (2 * np.pi)).astype(np.float32)
    state = rng.choice(
        [shortest_path.DEAD, shortest_path.UNTESTED, shortest_path.FREE, shortest_path.TOUCHING],
        (N, K),
        p=[0.3, 0.2, 0.4, 0.1],
    )
    if seed % 3 == 0:
        state[3] = shortest_path.DEAD
    most, steep = np.array([0.35, 0.3]), np.array([0.5, 0.3])
    begin = np.array([rng.integers(0, 2, K), rng.random(K)], float)
    toll = np.where(rng.random((N, K)) < 0.3, rng.random((N, K)), 0.0)
    blocked = np.array(
        sorted([t, a, b] for t in range(1, N) for a in range(K) for b in range(K) if rng.random() < 0.15)
    ).reshape(-1, 3)
    counts, costs = np.zeros((N, K), int), np.zeros((N, K))
    parents, prior = np.full((N, K), 99), shortest_path.layers_before(state)
    order = shortest_path.sorted_tracks(Q[..., 0], endless[0])
    args = (Q, state, prior, most, endless, steep, begin, toll, blocked, 0, order)
    shortest_path.link_layers(*args, 0, counts, costs, parents)
    wanted, paid = best_path(Q, state, most, endless, steep, begin, toll, blocked)
    alive = state != shortest_path.DEAD
    np.testing.assert_array_equal(counts[alive], wanted[alive])
    np.testing.assert_allclose(costs[alive], paid[alive], rtol=1e-12)
    layers = np.flatnonzero(alive.any(axis=1))
    for t in range(N):
        before = layers[layers < t]
        assert prior[t] == (before[-1] if len(before) else -1)
        for b in range(K):
            if not alive[t, b] or prior[t] < 0:
                assert parents[t, b] == shortest_path.NONE
                continue
            k = parents[t, b]
            a = k if k >= 0 else -2 - k
            again = counts[prior[t], a] + (k < 0) + (1 << 20) * (state[t, b] == shortest_path.TOUCHING)
            assert alive[prior[t], a] and counts[t, b] == again
    for first in (1, 4):  # what stands is gone on from
        more = [v.copy() for v in (counts, costs, parents)]
        for v in more:
            v[first:] = 77
        shortest_path.link_layers(*args, first, *more)
        for one, other in zip(more, (counts, costs, parents), strict=True):
            np.testing.assert_array_equal(one[first:][alive[first:]], other[first:][alive[first:]])
