"""The directions in which the tip can hardly move: their singular vectors, the way along them, a task without them."""

import math

import numpy as np
import pytest

from ik_toolkit.servo import laws, singular_step


def test_modes_are_the_singular_vectors():
    rng = np.random.default_rng(10)
    for n in (4, 7):
        J = rng.normal(size=(n, 6))
        W, U, sigma = np.empty((6, n)), np.empty((6, 6)), np.empty(6)
        singular_step.modes(J, np.zeros((6, 6)), W, U, sigma)
        np.testing.assert_allclose(W.T @ U, J, atol=1e-12)
        np.testing.assert_allclose(U @ U.T, np.eye(6), atol=1e-12)
        np.testing.assert_allclose(np.linalg.norm(W, axis=1), sigma, atol=1e-12)
        np.testing.assert_allclose(np.sort(sigma)[::-1][: min(n, 6)], np.linalg.svd(J, compute_uv=False), atol=1e-12)
        vector, e = rng.normal(size=6), rng.normal(size=6)
        small = 0.05 * e / np.linalg.norm(e)
        assert singular_step.mode_moved(U[1], small, vector, e, 0.1) == pytest.approx(U[1] @ (vector - small))
        assert singular_step.mode_moved(U[1], 3.0 * small, vector, e, 0.1) == pytest.approx(0.1 * U[1] @ e)
        v = np.empty(n)
        k = int(np.argmax(sigma))
        assert singular_step.mode_direction(W, sigma, k, np.zeros(n), 0.0, v)
        np.testing.assert_allclose(v, W[k] / sigma[k])


def test_directions_that_move_nothing():
    rng = np.random.default_rng(11)
    n = 5
    U, _ = np.linalg.qr(rng.normal(size=(n, n)))
    W = np.zeros((6, n))
    sigma = np.array([2.0, 0.0, 1e-3, 1.0, 0.5, 0.0])
    for place, c in zip((0, 2, 3, 4), range(4), strict=True):
        W[place] = sigma[place] * U[:, c]
    away, v = rng.normal(size=n), np.empty(n)
    assert singular_step.lost_direction(W, sigma, away, v)
    np.testing.assert_allclose(v, U[:, 4] * np.sign(U[:, 4] @ away), atol=1e-10)
    assert not singular_step.lost_direction(W, sigma, np.zeros(n), v) and not v.any()
    # what rounding leaves is no direction
    assert not singular_step.lost_direction(W, sigma, W.T @ np.ones(6), v) and not v.any()
    assert singular_step.mode_direction(W, sigma, 1, away, 1.0, v)
    np.testing.assert_allclose(v, U[:, 4] * np.sign(U[:, 4] @ away), atol=1e-10)
    assert not singular_step.mode_direction(W, sigma, 1, away, 0.0, v) and not v.any()
    rate, x = rng.normal(size=n), np.empty(n)
    along = U[:, 2].copy()
    own = along @ rate
    beside = 0.1 * (rate - own * along)
    for part, want in (
        (singular_step.ALONG, along),
        (singular_step.BESIDE, beside),
        (singular_step.BOTH, along + beside),
    ):
        assert singular_step.mode_probe(along, rate, part, 0.1, x) == pytest.approx(own)
        np.testing.assert_allclose(x, want, atol=1e-14)


def test_the_way_along_a_mode_solves_its_quadratic():
    rng = np.random.default_rng(12)
    least = 1e-6
    for _ in range(300):
        sigma, b, E, own = rng.uniform(0.0, 0.3), rng.normal(), 0.1 * rng.normal(), rng.normal() * 0.1
        side, home = rng.choice([-1.0, -0.05, 0.0, 0.05, 1.0]), rng.random() < 0.3
        y, D = singular_step.way_along(sigma, b, E, own, side, home, 0.01)
        assert D == pytest.approx(sigma**2 + 2.0 * b * E)
        middle = -sigma / b
        if D > 0.0:
            half = math.sqrt(D) / abs(b)
            heading = own - middle
            if abs(side) > 0.1 and (home or abs(heading) < 0.1 * half):
                heading = side
            root = middle + math.copysign(half, heading)
            assert sigma * root + 0.5 * b * root**2 == pytest.approx(E, abs=1e-12)
            assert y == pytest.approx((D * root + least * own) / (D + least), rel=1e-9, abs=1e-12)
        else:  # the vertex is as near as it gets
            assert y == pytest.approx((-0.5 * D * middle + least * own) / (-0.5 * D + least), rel=1e-9, abs=1e-12)
    flat = 0.04 - 2.0 * singular_step.WEAK.flat * 0.03
    y, D = singular_step.way_along(0.2, 0.0, 0.03, 0.4, 1.0, False, 0.01)
    assert D == pytest.approx(flat) and y == pytest.approx((flat * 0.15 + least * 0.4 * 0.9) / (flat + least))
    # What it moves the tip by is next to nothing: no way to go fast.
    y, D = singular_step.way_along(1e-4, 0.0, 0.03, 0.0, 1.0, False, 0.01)
    assert D < 0.0 and 0.0 < y < 1e-4 / singular_step.WEAK.flat
    y, D = singular_step.way_along(0.0, 0.0, 0.0, 0.4, 1.0, False, 0.01)
    assert D == 0.0 and y == pytest.approx(0.36)
    assert singular_step.way_along(0.0, 0.0, 0.03, 0.4, 1.0, False, 0.2)[0] == 0.0
    assert singular_step.way_along(0.2, 0.9e-3, 0.03, 0.0, 0.0, False, 0.01)[1] == pytest.approx(flat)


@pytest.mark.parametrize("n", [4, 7])
def test_lost_directions_are_taken_out(n):
    rng = np.random.default_rng(n)
    J, f = rng.normal(size=(n, 6)), rng.normal(size=6)
    W, U, sigma = np.empty((6, n)), np.empty((6, 6)), np.empty(6)
    singular_step.modes(J, np.zeros((6, 6)), W, U, sigma)
    lost = np.zeros(6)
    taken = np.argsort(sigma)[::-1][[1, 3]]
    lost[taken] = 1.0
    V = W / np.where(sigma > 1e-9, sigma, 1.0)[:, None]
    K, g, k = J.copy(), f.copy(), max(n, 6)
    G, y, out, b = np.zeros((k, k)), np.empty(k), np.empty(n), rng.normal(size=6)
    assert singular_step.take_out(K, W, U, V, lost, g, G) == 2
    P = np.eye(6) - U[taken].T @ U[taken]
    np.testing.assert_allclose(K, J @ P, atol=1e-12)
    np.testing.assert_allclose(g, P @ f, atol=1e-12)
    laws.apply(K, 6, G, P @ b, y, out)
    np.testing.assert_allclose(out, np.linalg.pinv((J @ P).T, 1e-9) @ P @ b, atol=1e-8)
    same, ask = K.copy(), P @ b
    singular_step.by_modes(same, W, U, np.zeros(6), ask, y)  # nothing is lost: nothing changes
    np.testing.assert_array_equal(np.vstack([*same, ask]), np.vstack([*K, P @ b]))
    singular_step.by_modes(same, W, U, lost, ask, y)  # the same task in rows that do not depend on each other
    assert not same[:, taken].any() and not ask[taken].any()
    np.testing.assert_allclose(same.T @ same - np.diag(np.diag(same.T @ same)), 0.0, atol=1e-12)
    for one, other in ((same, K), (ask, P @ b)):
        np.testing.assert_allclose(one @ U, other, atol=1e-12)
    x, xk = rng.normal(size=n), rng.normal(size=6)
    for speeds in (0.0, 1.0):
        moved = x.copy()
        singular_step.along_lost(V, lost, xk, moved, speeds)
        want = x - V[taken].T @ (V[taken] @ x) + speeds * V[taken].T @ xk[taken]
        np.testing.assert_allclose(moved, want, atol=1e-12)
