"""The constrained step where the task cannot be met: damped by what is left, so that joints come to rest, and what is wished."""

import numpy as np
import pytest
from constrained import Step, many, planar, problem, some_rows
from scipy.optimize import lsq_linear

from ik_toolkit.servo.constrained_step import CAUTION, MODE, OUTCOME


def test_a_residual_damps_the_motion():
    """All joints alike, however slow they are: a slow one that does what is left to do is not held back."""
    rng = np.random.default_rng(10)
    for _ in range(many(100)):
        J, v, low, high = problem(rng, 7)
        speeds = 10.0 ** rng.uniform(-2.0, 0.5, 7)
        strict = Step(J, low, high, scale=speeds)
        strict(3.0 * v, np.zeros(7))
        eased = Step(J, low, high, step=0.01, scale=speeds)
        x = eased(3.0 * v, np.zeros(7))
        assert eased.status == strict.status
        miss = (3.0 * v - J.T @ strict.x)[J.any(axis=0)]  # what no joint moves is not asked for
        square = CAUTION.bend * 0.01 * np.linalg.norm(miss) if strict.status == OUTCOME.short else 0.0
        C, d = np.vstack([J.T, np.sqrt(square) * np.eye(7)]), np.append(3.0 * v, np.zeros(7))
        best = lsq_linear(C, d, (low, high), method="bvls", tol=1e-15)
        np.testing.assert_allclose(np.sum((C @ x - d) ** 2), 2.0 * best.cost, rtol=1e-9, atol=1e-12)


def test_a_task_is_damped_from_the_first_where_that_is_asked_for():
    rng = np.random.default_rng(13)
    for _ in range(many(100)):
        J, v, low, high = problem(rng, 7)
        A, b = some_rows(rng, low, high)
        mu, weight = 10.0 ** rng.uniform(-6.0, 1.0), rng.random(6)
        x = Step(J, low, high, weight=weight, mu=mu)(3.0 * v, np.zeros(7))
        C = np.vstack([weight[:, None] * J.T, np.sqrt(mu) * np.eye(7)])
        d = np.append(3.0 * weight * v, np.zeros(7))
        best = lsq_linear(C, d, (low, high), method="bvls", tol=1e-15)
        np.testing.assert_allclose(np.sum((C @ x - d) ** 2), 2.0 * best.cost, rtol=1e-9, atol=1e-12)
        y = Step(J, low, high, (A, b), weight=weight, mu=mu)(3.0 * v, np.zeros(7))
        assert (A @ y <= b + 1e-9).all() and np.sum((C @ y - d) ** 2) >= 2.0 * best.cost * (1.0 - 1e-9)
        if (A @ x <= b).all():
            np.testing.assert_allclose(y, x, atol=1e-9)


def test_a_damped_task_stays_damped_where_half_planes_contradict():
    rng = np.random.default_rng(14)
    J, v, *_ = problem(rng, 7)
    wide, row = np.full(7, 100.0), np.eye(7)[:1]
    sizes = []
    for mu in (1.0, 100.0):
        step = Step(J, -wide, wide, (np.vstack([row, -row]), np.array([-0.01, -0.01])), mu=mu)
        x = step(3.0 * v, np.zeros(7))
        sizes.append(np.linalg.norm(x))
        assert abs(x[0]) < 0.01
    assert sizes[1] < 0.2 * sizes[0]  # undamped, both were the same


@pytest.mark.parametrize("mode", [MODE.leave, MODE.direct])
def test_the_arm_comes_to_rest_at_the_edge_of_its_ranges(mode):
    """Three links, joints at their limits, a target far out: the closest pose is reached, and then nothing moves."""
    h, gain = 0.01, 20.0
    lower, upper = np.array([-1.0, 0.3, -0.2]), np.array([1.0, 1.5, 2.0])
    rng = np.random.default_rng(11)
    for _ in range(many(4)):
        q, target = rng.uniform(lower, upper), rng.uniform(-4.0, 4.0, 2)
        step, rates = Step(np.zeros((3, 2)), np.zeros(3), np.zeros(3), mode=mode, step=h), []
        for _ in range(1500):
            a = np.cumsum(q)
            e = target - [np.cos(a).sum(), np.sin(a).sum()]
            step.J[:] = planar(q)
            step.low[:], step.high[:] = np.maximum(-2.0, (lower - q) / h), np.minimum(2.0, (upper - q) / h)
            rates.append(step(gain * e, np.linalg.pinv(step.J.T) @ (gain * e)))
            q = np.clip(q + h * rates[-1], lower, upper)
        slope = planar(q) @ e
        uphill = np.where(q <= lower, np.minimum(slope, 0.0), np.where(q >= upper, np.maximum(slope, 0.0), 0.0))
        assert np.abs(np.array(rates[-100:])).max() < 1e-2
        assert np.abs(slope - uphill).max() < 1e-2 * (1.0 + np.linalg.norm(e))
