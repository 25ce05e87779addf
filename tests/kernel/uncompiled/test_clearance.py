"""How fast pairs of parts approach, and how far they are certainly free along a braking path."""

import math

import numpy as np
import pinocchio as pin
import pytest
from braking import brake

from ik_toolkit.kernel import clearance


def scene(rng, E=4, S=3, n=5):
    """Joints, spheres and which joints move them: a chain carries spheres 0 and 1, the last stands."""
    V = rng.normal(size=(E, 6))
    V[1, 3:] = 0.0  # a slide
    coordinates = rng.permutation(n)[:E]
    middle, radius = rng.normal(size=(S, 3)), rng.uniform(0.05, 0.3, S)
    a, b = np.array([0, 1, 0]), np.array([2, 2, 1])
    by_a = np.array([[1, 1, 1, 1], [1, 1, 0, 0], [0, 0, 1, 1]], bool)[:, :E]
    by_b = np.array([[0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 1]], bool)[:, :E]
    by_a[2, 3] = False
    return clearance.Bodies(V, coordinates, middle, radius, a, b, by_a, by_b)


def test_half_planes_let_pairs_brake():
    rng = np.random.default_rng(1)
    V, coordinates, _, _, _, _, by_a, by_b = parts = scene(rng)
    n, slope, step, share, flat = 5, 4.0, 0.05, 0.2, 1e-6
    for gap in ([0.3, 0.02, 1.0], [-0.1, 0.5, 0.001], [0.0, 0.2, 9.0]):
        ks, points = np.array([2, 0, 1]), rng.normal(size=(3, 2, 3))
        gap, rate, deceleration = np.array(gap), rng.normal(size=n), rng.uniform(0.5, 3.0, n)
        if gap[0] == 0.0:
            by_a[1], by_b[1] = False, False  # this pair moves with no joint
        A, b, order = np.full((3, n), 9.0), np.full(3, 9.0), np.full(3, -9)
        for h in (step, 0.5):
            facing, rules = clearance.NearPairs(ks, points, gap), clearance.Approach(slope, h, share, flat)
            count = clearance.rows(parts, facing, rate, deceleration, rules, clearance.HalfPlanes(A, b, order))
            want = []
            for r, k in enumerate(ks):
                first, second = points[r]
                normal = (second - first) / np.linalg.norm(second - first)
                row = np.zeros(n)
                for e in range(4):
                    side, point = (1.0, first) if by_a[k, e] else (-1.0, second) if by_b[k, e] else (0.0, first)
                    row[coordinates[e]] += side * normal @ (V[e, :3] + np.cross(V[e, 3:], point))
                size = np.abs(row)
                bound = gap[r] * min(slope, 0.5 / h)
                if gap[r] > 0.0 and size.max() > 0.0:
                    strong = size > share * size.max()
                    bound = min(bound, math.sqrt(2.0 * (size * deceleration)[strong].min() * gap[r]))
                if size.max() > flat:
                    want.append((bound - row @ rate, r, row, bound))
            want.sort(key=lambda w: w[0])
            assert count == len(want)
            np.testing.assert_array_equal(order[:count], [w[1] for w in want])
            np.testing.assert_allclose(A[:count], [w[2] for w in want], rtol=1e-12, atol=1e-14)
            np.testing.assert_allclose(b[:count], [w[3] for w in want], rtol=1e-12)
    planes = clearance.HalfPlanes(A[:1], b[:1], order)
    few = clearance.rows(parts, facing, rate, deceleration, rules._replace(step=step), planes)
    assert few == 1 and order[0] == want[0][1]


def straight(speed, pieces, h, n=1):
    """A path of even motion: rows of joint values, rates, and how far joints have gone."""
    Q = np.outer(np.arange(pieces + 1) * h, np.full(n, speed))
    return Q, np.full((pieces + 1, n), speed), np.abs(Q)


def test_a_slide_is_free_until_it_has_used_up_its_distance():
    h, pieces = 0.1, 6
    V, middle, radius = np.array([[1.0, 0, 0, 0, 0, 0]]), np.zeros((2, 3)), np.array([0.2, 0.3])
    a, b, ks, coordinates = np.array([0, 1, 0]), np.array([1, 0, 1]), np.array([0, 1, 2]), np.array([0])
    by_a, by_b = np.array([[True], [False], [False]]), np.array([[False], [True], [True]])
    levers = np.ones((3, 1))
    Q, R, L = straight(1.0, pieces, h)
    parts = clearance.Bodies(V, coordinates, middle, radius, a, b, by_a, by_b)
    path = clearance.BrakingPath(Q, R, L, 1.0, h)
    flat = np.zeros((3, 3))  # not convex: the length of the way counts, whichever way it leads
    for start in (0.0, 1.5):
        out, near = np.empty(3), start + 1.7
        normals = np.array([[1.0, 0, 0], [1.0, 0, 0], [-1.0, 0, 0]])
        toward = clearance.Separation(ks, normals, np.full(3, 0.17))
        clearance.free_until(parts, toward, levers, path, start, out)
        assert near - 1 / 32 <= out[0] <= near  # the first towards the second
        assert out[1] == pieces and near - 1 / 32 <= out[2] <= near  # the second along its normal, and against it
        clearance.free_until(parts, toward._replace(normals=flat), levers, path, start, out)
        assert np.all((near - 1 / 32 <= out) & (out <= near))
        clearance.free_until(parts, clearance.Separation(ks, flat, np.full(3, 9.0)), levers, path, start, out)
        np.testing.assert_array_equal(out, pieces)


def test_levers_grow_with_what_later_joints_can_do():
    rng = np.random.default_rng(0)
    V, coordinates, middle, radius, a, b, by_a, by_b = parts = scene(rng)
    way, out, spread = rng.uniform(0.0, 1.0, 5), np.full((3, 4), 9.0), np.full(3, 9.0)
    clearance.levers(parts, way, out, spread)
    want, total = np.zeros((3, 4)), np.zeros(3)
    for p in range(3):
        for s, moved in ((a[p], by_a[p]), (b[p], by_b[p])):
            far = 0.0
            for e in reversed(np.flatnonzero(moved)):
                turn = np.linalg.norm(V[e, 3:])
                lever = np.linalg.norm(V[e, :3] + np.cross(V[e, 3:], middle[s])) + turn * (radius[s] + far)
                far += lever * way[coordinates[e]]
                want[p, e] += lever
            total[p] += far
    np.testing.assert_allclose(out, want, rtol=1e-13)
    np.testing.assert_allclose(spread, total, rtol=1e-13)


@pytest.mark.parametrize("gamma", [1.0, 0.5])
def test_nothing_comes_closer_than_it_may_where_it_is_called_free(gamma):
    rng = np.random.default_rng(3)
    h, late, n = 0.05, 0.05, 3
    tight = 0
    for trial in range(12):
        axes, points = rng.normal(size=(n, 3)), rng.normal(size=(n, 3)) * 0.3
        axes /= np.linalg.norm(axes, axis=1)[:, None]
        V = np.column_stack([-np.cross(axes, points), axes])
        coordinates = np.arange(n)
        middle, radius = rng.normal(size=(2, 3)) * 0.5, np.array([0.2, 0.15])
        limits = np.array([np.full(n, -9.0), np.full(n, 9.0), np.full(n, 2.0), np.full(n, 3.0)])
        Q, R, L = np.zeros((80, n)), np.zeros((80, n)), np.zeros((80, n))
        R[0] = rng.uniform(-1.0, 1.0, n)
        last = brake(0, gamma, h, late, limits, Q, R, L)
        Q, R, L = Q[: last + 1], R[: last + 1], L[: last + 1]
        a, b, ks = np.array([0]), np.array([1]), np.array([0])
        by_a, by_b = np.array([[True, True, False]]), np.array([[False, False, True]])
        if trial % 3 == 0:
            by_a, by_b = by_b, by_a
        out, spread, until = np.empty((1, n)), np.empty(1), np.empty(1)
        parts = clearance.Bodies(V, coordinates, middle, radius, a, b, by_a, by_b)
        clearance.levers(parts, L[-1], out, spread)
        normal = rng.normal(size=3)
        normal /= np.linalg.norm(normal)
        distance = rng.choice([0.02, 0.1, 0.3])
        pairs = clearance.Separation(ks, normal[None], np.array([distance]))
        clearance.free_until(parts, pairs, out, clearance.BrakingPath(Q, R, L, gamma, h), 0.0, until)
        tight += 0.0 < until[0] < last
        worst = {}
        for u in np.linspace(0.0, last, 4 * last + 1):
            q, length = np.empty(n), np.empty(n)
            clearance.along(Q, R, L, gamma, h, u, q, length)
            closer = 0.0
            for s, moved, sign in ((0, by_a[0], 1.0), (1, by_b[0], -1.0)):
                M = pin.SE3.Identity()
                for e in np.flatnonzero(moved):
                    turned = pin.exp3(axes[e] * q[e])
                    M = M * pin.SE3(turned, points[e] - turned @ points[e])
                centre = M.act(middle[s]) - middle[s]
                swing = np.linalg.norm(normal @ M.rotation - normal) * radius[s]  # of the sphere's own points
                closer += sign * normal @ centre + swing
            worst[u] = closer
        assert all(closer < distance for u, closer in worst.items() if u <= until[0])
        reached = [u for u, closer in worst.items() if closer >= distance]
        assert not reached or until[0] >= 0.4 * min(reached) - 0.5  # and not far below what is found
    assert tight > 2
