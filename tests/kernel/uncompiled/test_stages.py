"""The problems that the constrained step solves one after the other."""

import math

import numpy as np
import pytest
from random_arms import make_levels

from ik_toolkit.servo import constrained_step
from ik_toolkit.servo.constrained_step import DIRECT
from ik_toolkit.servo.equality_qp import HIGH, LOW, RHS, WANT


def loaded(rng, n=5, rows=3):
    J, weight = rng.normal(size=(n, 6)), rng.uniform(0.5, 2.0, 6)
    weight[4], J[:, 2] = 0.0, 0.0
    back, front, want = rng.normal(size=6), rng.normal(size=6), rng.normal(size=n)
    scale, low, high = rng.uniform(0.5, 2.0, n), -rng.random(n), rng.random(n)
    A, b = rng.normal(size=(rows, n)), rng.normal(size=rows)
    A[1] = 0.0
    s, task = make_levels(n + 7, rows + 7), np.zeros((rows + 7, 2))
    constrained_step.bound(scale, low, high, A, b, rows, 0.01, s.P, s.V, s.S)
    r = constrained_step.load(J, weight, back, front, want, scale, rows, 0.8, s.P, s.V, s.S, task)
    return J, weight, back, front, want, scale, low, high, A, b, s, task, r


def test_a_problem_in_scaled_unknowns():
    rng = np.random.default_rng(5)
    J, weight, back, front, want, scale, low, high, A, b, s, task, r = loaded(rng)
    n, rows = 5, 3
    np.testing.assert_allclose(s.V[[WANT, LOW, HIGH], :n], [want / scale, low / scale, high / scale])
    for k in (0, 2):
        size = np.linalg.norm(A[k] * scale)
        np.testing.assert_allclose(s.P[k, :n], A[k] * scale / size)
        assert s.S[RHS, k] == pytest.approx(b[k] / size + 0.01)
    assert not s.P[1, :n].any() and s.S[RHS, 1] == max(b[1], 0.0)
    counted = [0, 1, 3, 5]
    assert r == 4
    for place, c in enumerate(counted, rows):
        np.testing.assert_allclose(s.P[place, :n], weight[c] * J[:, c] * scale)
        np.testing.assert_allclose(task[place], [weight[c] * back[c], weight[c] * front[c]])
        assert s.S[RHS, place] == pytest.approx(weight[c] * (back[c] + 0.8 * front[c]))
    unit = constrained_step.add_clock(s.P, s.V, s.S, task, rows, r, n, 0.8)
    lengths = (s.P[rows : rows + r, :n] ** 2).sum(axis=1)
    assert unit == pytest.approx(1e-4 * math.sqrt(lengths.max() / (task[rows : rows + r, 1] ** 2).sum()))
    np.testing.assert_allclose(s.P[: rows + r, n], [0, 0, 0, *(unit * task[rows : rows + r, 1])])
    np.testing.assert_allclose(s.V[[WANT, LOW, HIGH], n], [0.0, 0.0, 0.8 / unit])
    task[:, 1] = 0.0
    assert constrained_step.add_clock(s.P, s.V, s.S, task, rows, r, n, 0.8) == 0.0


def test_leaving_the_direction_costs_more_than_falling_behind():
    rng = np.random.default_rng(6)
    *_, s, task, r = loaded(rng)
    rows, n = 3, 5
    C, d = s.P[rows : rows + r, :n].copy(), s.S[RHS, rows : rows + r].copy()
    most = np.linalg.norm(C, axis=0).sum()  # all joints at full speed
    for alpha, size in ((0.0, 0.5), (0.4, 0.5), (0.0, 16.0), (0.02, 16.0), (0.1, 16.0)):
        d *= size * most / np.linalg.norm(d)
        s.P[rows : rows + r, :n], s.S[RHS, rows : rows + r] = C, d
        constrained_step.aside(s.P, s.S, rows, r, n, alpha)
        more = max(size, 1.0)
        weight = 1.0 + (100.0 * math.sqrt(more) - 1.0) * min(alpha * more, 1.0)
        along = np.outer(d, d) / (d @ d)
        np.testing.assert_allclose(
            s.P[rows : rows + r, :n], (along + weight * (np.eye(r) - along)) @ C, rtol=1e-11, atol=1e-12
        )


def test_the_least_slack_is_a_problem_of_its_own():
    rng = np.random.default_rng(7)
    *_, s, task, r = loaded(rng)
    n, rows = 5, 3
    s.V[WANT, :n], s.state[:] = 5.0, 1
    constrained_step.slack(s.P, s.V, s.S, s.state, n, rows)
    np.testing.assert_array_equal(s.P[:rows, n], [-1.0, 0.0, -1.0])
    np.testing.assert_array_equal(s.P[rows, : n + 1], [0, 0, 0, 0, 0, 1])
    np.testing.assert_array_equal(s.V[WANT, :n], s.V[HIGH, :n])
    np.testing.assert_array_equal(s.V[[WANT, LOW, HIGH], n], [0.0, 0.0, np.inf])
    assert s.S[RHS, rows] == 0.0 and not s.state[:n].any() and not s.state[s.P.shape[1] : s.P.shape[1] + rows].any()
    assert s.state[n] == 1 and DIRECT == 2
    x, active, kept, push = np.empty(3), np.ones(3, np.int8), np.ones(2, np.int8), np.ones(4)
    constrained_step.as_wanted(np.arange(3.0), x, active, kept, push)
    np.testing.assert_array_equal(x, [0, 1, 2])
    assert not active.any() and not kept.any() and not push.any()
