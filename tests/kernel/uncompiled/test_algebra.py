"""Vectors, matrices and small solves of the kernel against numpy."""

import math

import numpy as np
import pytest

from ik_toolkit.kernel import linalg
from ik_toolkit.kernel.algebra import M3, V3, Sym3


def m3(A):
    return M3(*(V3(*A[:, k]) for k in range(3)))


def symmetric(s):
    return np.array([[s.xx, s.xy, s.xz], [s.xy, s.yy, s.yz], [s.xz, s.yz, s.zz]])


def test_vectors_and_matrices():
    rng = np.random.default_rng(0)
    a, b, A, S = rng.normal(size=3), rng.normal(size=3), rng.normal(size=(3, 3)), rng.normal(size=(3, 3))
    S = S @ S.T + np.eye(3)
    u, v, s = V3(*a), V3(*b), Sym3(S[0, 0], S[0, 1], S[0, 2], S[1, 1], S[1, 2], S[2, 2])
    for one, other in (
        (u + v, a + b), (u - v, a - b), (-u, -a), (u * 3.0, 3.0 * a), (u.dot(v), a @ b), (u.cross(v), np.cross(a, b)),
        (u.square(), a @ a), (m3(A).times(u), A @ a), (m3(A).across(u), A.T @ a), (s.times(u), S @ a),
        (s.determinant(), np.linalg.det(S)), (symmetric(s.plus(u, u * 2.0)), S + 2.0 * np.outer(a, a)),
    ):  # fmt: skip
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-14)
    f = s.factors()
    np.testing.assert_allclose(f.back(f.scaled(f.forward(u))), np.linalg.solve(S, a), rtol=1e-10)
    L = np.array([[1.0, 0.0, 0.0], [f.l10, 1.0, 0.0], [f.l20, f.l21, 1.0]])
    np.testing.assert_allclose(L @ np.diag(1.0 / np.array(f.pivots)) @ L.T, S, rtol=1e-12)


def test_cholesky_of_a_part_and_with_lifted_pivots():
    rng = np.random.default_rng(6)
    B = rng.normal(size=(6, 6))
    S = B @ B.T
    A, y = S.copy(), rng.normal(size=6)
    x = y.copy()
    linalg.cholesky(A, 5, 0.0)
    np.testing.assert_allclose(np.tril(A[:5, :5]), np.linalg.cholesky(S[:5, :5]), rtol=1e-10)
    np.testing.assert_array_equal(A[5], S[5])
    linalg.cholesky_solve(A, 5, x)
    np.testing.assert_allclose(x, [*np.linalg.solve(S[:5, :5], y[:5]), y[5]], rtol=1e-8)
    A = np.diag([4.0, 0.0, 9.0])
    linalg.cholesky(A, 3, 1e-8)
    np.testing.assert_allclose(np.diag(A), [2.0, 1e-4, 3.0], rtol=1e-14)


def test_columns_made_orthogonal():
    rng = np.random.default_rng(7)
    for A in (rng.normal(size=(7, 6)), rng.normal(size=(4, 6)), np.ones((5, 3)), np.diag([3.0, 2.0, 1.0])):
        B, V = A.copy(), np.full((A.shape[1], A.shape[1]), 5.0)
        linalg.make_orthogonal(B, V, A.shape[1])
        np.testing.assert_allclose(V.T @ V, np.eye(len(V)), atol=1e-13)
        np.testing.assert_allclose(A @ V, B, atol=1e-13)
        G = B.T @ B
        size = np.sqrt(np.diag(G))
        long = size > linalg.NOISE * size.max()  # the others are rounding
        off = np.abs(G - np.diag(np.diag(G)))[np.ix_(long, long)]
        assert np.all(off <= 2e-15 * np.outer(size, size)[np.ix_(long, long)] + 1e-30)
        some = np.linalg.svd(A, compute_uv=False)
        np.testing.assert_allclose(np.sort(size)[::-1][: len(some)], some, atol=1e-13)
    c, s = linalg.jacobi(3.0, 1.0, 0.7)
    R = np.array([[c, s], [-s, c]])
    np.testing.assert_allclose(
        R.T @ np.array([[3.0, 0.7], [0.7, 1.0]]) @ R,
        np.diag(np.linalg.eigvalsh([[3, 0.7], [0.7, 1]])[::-1]),
        atol=1e-14,
    )
    c, s = linalg.jacobi(2.0, 2.0, 0.7)
    assert c == pytest.approx(math.sqrt(0.5)) and s == pytest.approx(math.sqrt(0.5))


def test_pseudo_inverses_leave_out_small_values():
    rng = np.random.default_rng(8)
    U, _ = np.linalg.qr(rng.normal(size=(7, 6)))
    V, _ = np.linalg.qr(rng.normal(size=(6, 6)))
    e = rng.normal(size=6)
    values = np.array([3.0, 2.0, 1.0, 0.5, 1e-2, 1e-5])
    J = U * values @ V.T
    for rcond, keep in ((1e-9, 6), (1e-4, 5), (1e-2, 4), (0.3, 3)):
        dq, A = np.empty(7), J.copy()
        linalg.pseudo_inverse_step(A, e, rcond, np.empty((6, 6)), dq, 6)
        np.testing.assert_allclose(dq, U[:, :keep] / values[:keep] @ V[:, :keep].T @ e, rtol=1e-9, atol=1e-9)
    dq = np.ones(2)
    linalg.pseudo_inverse_step(np.zeros((2, 6)), e, 1e-9, np.empty((6, 6)), dq, 6)
    np.testing.assert_array_equal(dq, 0.0)


def test_linear_systems_with_and_without_an_answer():
    rng = np.random.default_rng(9)
    for n in (1, 2, 4, 6):
        A, b = rng.normal(size=(7, 7)), rng.normal(size=7)
        A[0, 0] = 0.0 if n > 1 else 1.0
        x = b.copy()
        assert linalg.lu_solve(A.copy(), x, n)
        np.testing.assert_allclose(x, [*np.linalg.solve(A[:n, :n], b[:n]), *b[n:]], rtol=1e-9)
    for small, fine in ((1.5e-10, True), (0.7e-10, False)):
        assert linalg.lu_solve(np.diag([1.0, small, -2.0 / 2.0]), np.ones(3), 3) == fine
