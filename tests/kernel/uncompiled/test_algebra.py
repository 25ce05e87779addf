"""Vectors, matrices and small solves of the kernel against numpy."""

import math

import numpy as np
import pinocchio as pin
import pytest

from ik_toolkit.kernel import algebra, kinematics, linalg
from ik_toolkit.kernel.algebra import M3, V3, Blocks, Sym3


def m3(A):
    return M3(*(V3(*A[:, k]) for k in range(3)))


def matrix(m):
    return np.column_stack([m.x, m.y, m.z])


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


def test_blocks_of_a_damped_step():
    rng = np.random.default_rng(1)
    J, w, e = rng.normal(size=(5, 6)), rng.uniform(0.2, 2.0, 5), rng.normal(size=6)
    full, blocks = 0.3 * np.eye(6), algebra.diagonal(0.3)
    for i in range(5):
        u, v = V3(*J[i, :3]), V3(*J[i, 3:])
        blocks = blocks.with_column(u * w[i], v * w[i], u, v)
        full += w[i] * np.outer(J[i], J[i])
    np.testing.assert_allclose(symmetric(blocks.P), full[:3, :3])
    np.testing.assert_allclose(matrix(blocks.Q), full[3:, :3])
    np.testing.assert_allclose(symmetric(blocks.S), full[3:, 3:])
    assert isinstance(blocks, Blocks)
    np.testing.assert_allclose(
        np.concatenate(blocks.solve(V3(*e[:3]), V3(*e[3:]))), np.linalg.solve(full, e), rtol=1e-10
    )


def test_places_in_memory():
    A = np.arange(20.0)
    assert algebra.at3(A, 2) == (2.0, 3.0, 4.0)
    m = algebra.rotation_at(A, 4)
    np.testing.assert_array_equal(matrix(m), A[4:13].reshape(3, 3))
    out = np.zeros(20)
    algebra.put_axes(out, 5, m)
    algebra.put3(out, 1, V3(7.0, 8.0, 9.0))
    np.testing.assert_array_equal(out, [0, 7, 8, 9, 0, *A[4:13], 0, 0, 0, 0, 0, 0])


def test_rotations_left_and_their_measures():
    rng = np.random.default_rng(2)
    for angle in (0.0, 1e-9, 1e-5, 3e-4, 0.4, 1.5, 2.2, 3.0, math.pi - 1e-4, math.pi - 3e-5, math.pi - 1e-6):
        for _ in range(6):
            axis = rng.normal(size=3)
            axis /= np.linalg.norm(axis)
            now = pin.exp3(rng.normal(size=3))
            goal = pin.exp3(angle * axis) @ now
            sine, one = algebra.rotation_left(m3(now), m3(goal))
            np.testing.assert_allclose(sine, math.sin(angle) * axis, atol=1e-14)
            assert one == pytest.approx(1.0 + math.cos(angle), abs=1e-14)
            e = kinematics.rotation_error(m3(now), m3(goal))
            np.testing.assert_allclose(e, 2.0 * math.sin(0.5 * angle) * axis, atol=1e-14 if angle < 2.0 else 1e-11)
            assert kinematics.angle_ratio(e.square()) == pytest.approx(
                0.5 * angle / math.sin(0.5 * angle) if angle else 1.0
            )
            steep = 1e-7 if angle > 3.1 else 1e-12
            assert kinematics.rotation_angle(e.square()) == pytest.approx(angle, abs=steep, rel=1e-12)
            assert algebra.chord(angle) == pytest.approx((2.0 * math.sin(0.5 * angle)) ** 2, rel=1e-15)
    assert algebra.chord(math.pi) == algebra.chord(4.0) == 9.0
    for x in (1e-5, 9e-5, 1.1e-4, 1e-3):  # half the error; series and arcsine agree beyond where one hands over
        assert kinematics.angle_ratio(4.0 * x * x) == pytest.approx(1.0 + x * x / 6.0 + 3.0 * x**4 / 40.0, rel=1e-15)
    assert (
        kinematics.angle_ratio(5.0) == pytest.approx(math.pi / math.sqrt(5.0))
        and kinematics.rotation_angle(5.0) == math.pi
    )


def test_half_turns_about_every_axis():
    rng = np.random.default_rng(3)
    for axis in [*np.eye(3), *-np.eye(3), [1, 1, 0], [0, 1, 1], [1, 0, 1], [1, 1, 1], *rng.normal(size=(8, 3))]:
        axis = np.array(axis) / np.linalg.norm(axis)
        now = pin.exp3(rng.normal(size=3))
        for off in (0.0, 1e-9, 1e-6, 5e-5, -5e-5):
            goal = pin.exp3((math.pi - off) * axis) @ now
            e = np.array(kinematics.rotation_error(m3(now), m3(goal)))
            side = 1.0 if off > 0.0 else -1.0 if off < 0.0 else np.sign(e @ axis)
            np.testing.assert_allclose(e, 2.0 * side * axis, atol=1e-8)


@pytest.mark.parametrize("n", [1, 3, 6, 8])
def test_damped_steps(n):
    rng = np.random.default_rng(n)
    J, w, e = rng.normal(size=(n, 6)), rng.uniform(0.1, 3.0, n), rng.normal(size=6)
    w[rng.random(n) < 0.3] = 0.0
    for damping in (1e-6, 0.1):
        dq = np.empty(n)
        linalg.damped(J, w, dq, V3(*e[:3]), V3(*e[3:]), damping)
        want = w * (J @ np.linalg.solve(J.T * w @ J + damping * np.eye(6), e))
        np.testing.assert_allclose(dq, want, rtol=1e-6, atol=1e-8)


def test_damped_steps_of_several_tips():
    rng = np.random.default_rng(5)
    n, F = 7, 3
    J, w, e = rng.normal(size=(n, 6 * F)), rng.uniform(0.1, 3.0, n), rng.normal(size=6 * F)
    moves = (rng.random((F, n)) < 0.7).astype(float)
    moves[1] = 0.0
    J *= np.repeat(moves, 6, axis=0).T
    w[2] = 0.0
    dq, A, y = np.empty(n), np.full((18, 18), 9.0), np.empty(18)
    linalg.damped_stack(J, moves, w, dq, e, 0.05, A, y)
    np.testing.assert_allclose(dq, w * (J @ np.linalg.solve(J.T * w @ J + 0.05 * np.eye(18), e)), rtol=1e-9, atol=1e-12)


def test_cholesky_of_a_part_and_with_lifted_pivots():
    rng = np.random.default_rng(6)
    B = rng.normal(size=(6, 6))
    S = B @ B.T
    A, y = S.copy(), rng.normal(size=6)
    x = y.copy()
    linalg.cholesky(A, 5, 0.0)
    L = np.linalg.cholesky(S[:5, :5])
    np.testing.assert_allclose(np.tril(A[:5, :5]), L + np.diag(1.0 / np.diag(L) - np.diag(L)), rtol=1e-10)
    np.testing.assert_array_equal(A[5], S[5])
    linalg.cholesky_solve(A, 5, x)
    np.testing.assert_allclose(x, [*np.linalg.solve(S[:5, :5], y[:5]), y[5]], rtol=1e-8)
    A = np.diag([4.0, 0.0, 9.0])
    linalg.cholesky(A, 3, 1e-8)
    np.testing.assert_allclose(np.diag(A), [1.0 / 2.0, 1e4, 1.0 / 3.0], rtol=1e-14)


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


def test_columns_of_rounding_end_the_turning(turns):
    """A Jacobian without full rank, of a locked joint say, took 40 sweeps: what rounding leaves is never orthogonal."""
    rng = np.random.default_rng(9)
    A = rng.normal(size=(7, 6))
    A[[1, 4]] = 0.0
    B, V = A.copy(), np.empty((6, 6))
    linalg.make_orthogonal(B, V, 6)
    assert len(turns) < 15 * 10
    np.testing.assert_allclose(
        np.sort(np.linalg.norm(B, axis=0)), np.linalg.svd(A, compute_uv=False)[::-1], atol=1e-14 * np.linalg.norm(A)
    )


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
    for n, rank in ((2, 1), (3, 2), (7, 2), (12, 6)):
        J, dq = rng.normal(size=(n, rank)) @ rng.normal(size=(rank, 6)), np.empty(n)
        linalg.pseudo_inverse_step(J.copy(), e, 1e-9, np.empty((6, 6)), dq, 6)
        np.testing.assert_allclose(dq, np.linalg.pinv(J.T, rcond=1e-9) @ e, atol=1e-9 * max(1.0, np.abs(dq).max()))
    dq = np.ones(2)
    linalg.pseudo_inverse_step(np.zeros((2, 6)), e, 1e-9, np.empty((6, 6)), dq, 6)
    np.testing.assert_array_equal(dq, 0.0)


def test_linear_systems_with_and_without_an_answer():
    rng = np.random.default_rng(9)
    for n in (1, 2, 4, 6):
        A, b = rng.normal(size=(7, 7)), rng.normal(size=7)
        A[0, 0] = 0.0 if n > 1 else 1.0
        x, y = b.copy(), np.linalg.solve(A[:n, :n], b[:n])
        assert linalg.lu_solve(A.copy(), x, n, n)
        np.testing.assert_allclose(x, [*y, *b[n:]], rtol=1e-9)
        more = rng.normal(size=(6, n)) @ A[:n, :n]  # Further equations that follow from the others change nothing.
        x = more @ y
        assert linalg.lu_solve(more.copy(), x, n, 6)
        np.testing.assert_allclose(x[:n], y, rtol=1e-8)
    for A in (np.ones((6, 3)), np.ones((3, 3)), np.zeros((2, 2))):
        assert not linalg.lu_solve(A, np.ones(len(A)), A.shape[1], len(A))
    for small, fine in ((1.5e-10, True), (0.7e-10, False)):
        assert linalg.lu_solve(np.diag([1.0, small, -2.0 / 2.0]), np.ones(3), 3, 3) == fine
