"""Rotations, orthogonal columns and linear systems of the kernel against numpy."""

import math

import numpy as np
import pinocchio as pin
import pytest

from ik_toolkit.kernel import algebra, kinematics, linalg
from ik_toolkit.kernel.algebra import M3, V3


def m3(A):
    return M3(*(V3(*A[:, k]) for k in range(3)))


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
