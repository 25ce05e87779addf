"""Steps of errors with priorities, and joints held at limits by mistake, on hand-made numbers against numpy."""

from types import SimpleNamespace

import numpy as np
import pytest

from ik_toolkit.kernel.closest import held_wrongly
from ik_toolkit.kernel.levels import (
    QUADRATIC,
    StepTables,
    down_level,
    multipliers,
    onto_constraint,
    size_of_level,
    step_by_levels,
)
from ik_toolkit.kernel.search import AT_MINIMUM


class Box:
    """Limits of joints, none of which turns fully."""

    def __init__(self, low, high):
        self.low, self.high = low, high

    def lower(self, i):
        return self.low[i]

    def upper(self, i):
        return self.high[i]

    def turns(self, i):
        return 0.0


def tables(n, m=6):
    """Scratch for n joints and m errors."""
    wide = max(n, m)
    shapes = [(wide, wide)] * 7 + [(wide,)] * (len(StepTables._fields) - 7)
    return StepTables._make(np.zeros(shape) for shape in shapes)


def test_the_size_of_a_level_is_its_own_error_but_no_less_than_its_tolerance():
    p = SimpleNamespace(group=lambda e, g: e[g], allowed=lambda g: (0.125, 0.01, 0.25, 0.0)[g])
    level = np.array([0.0, 1.0, 0.0, 2.0])
    e = np.array([0.25, 0.125, 0.5, 3.0])
    assert [size_of_level(p, e, c, level) for c in range(4)] == [0.75, 0.125, 1.0, QUADRATIC.small]
    assert size_of_level(p, 0.0 * e, 0, level) == 0.375


@pytest.mark.parametrize("far", [1.0, 100.0, -100.0])
def test_the_step_onto_a_constraint_is_damped_and_leaves_its_null_space(far):
    """Groups 0 and 2 are the constraint; joint 1 is held, and 100 times the error asks for more than the longest step."""
    rng, n, level, held = np.random.default_rng(1), 9, np.array([0.0, 1.0, 0.0]), 1
    s = SimpleNamespace(J=rng.normal(size=(n, 9)), y=far * 0.1 * rng.normal(size=9), dq=np.zeros(n))
    bench, free = tables(n, 9), [i for i in range(n) if i != held]
    bench.free[: n - 1] = free
    value = 0.5
    left = onto_constraint(s, level, 1, n - 1, value, bench)
    rows = [h for h in range(9) if level[h // 3] == 0.0]
    A = s.J[free][:, rows].T
    damped = A @ A.T + (QUADRATIC.damping * value + QUADRATIC.least_damping) * np.eye(6)
    step = A.T @ np.linalg.solve(damped, s.y[rows])
    assert (np.abs(step).max() > QUADRATIC.longest_along) == (abs(far) > 1.0)
    np.testing.assert_allclose(s.dq[free], step * min(1.0, QUADRATIC.longest_along / np.abs(step).max()), rtol=1e-9)
    basis = bench.basis[:n, :left]
    assert left == n - 1 - 6 and s.dq[held] == 0.0 and not basis[held].any()
    np.testing.assert_allclose(basis.T @ basis, np.eye(left), atol=1e-12)
    np.testing.assert_allclose(A @ basis[free], 0.0, atol=1e-12)
    bench.gradient[:n] = rng.normal(size=n)
    multipliers(level, 1, n - 1, bench)
    found = np.linalg.solve(damped, A @ bench.gradient[free])
    np.testing.assert_allclose(bench.multiplier[rows], -found, rtol=1e-9)
    assert not bench.multiplier[[h for h in range(9) if h not in rows]].any()


def newton(gradient, curvature=(1.0, 1.0), q=(0.0, 0.0), low=(-9.0, -9.0), high=(9.0, 9.0), dq=(0.0, 0.0), last=True):
    """The step that `down_level` adds for two free joints, and what it returns."""
    s, bench = SimpleNamespace(q=np.array(q), dq=np.array(dq)), tables(2)
    bench.basis[:2, :2], bench.hessian[:2, :2] = np.eye(2), np.diag(curvature)
    bench.gradient[:2] = gradient
    left, steep = down_level(s, 2, last, bench, Box(low, high))
    return s.dq - dq, left, steep


def test_a_level_goes_down_by_a_newton_step_over_positive_curvatures():
    step, left, steep = newton((0.2, 0.4), (2.0, -4.0), dq=(0.0, 0.05))
    np.testing.assert_allclose(step, [-0.1, -(0.4 - 4.0 * 0.05) / 4.0])
    assert (left, steep) == (0, pytest.approx(0.2))
    long, _, _ = newton((4.0, -3.0))
    np.testing.assert_allclose(long, QUADRATIC.longest_across * np.array([-0.8, 0.6]))
    np.testing.assert_allclose(newton((0.0, 0.9))[0], [0.0, -QUADRATIC.longest_across])
    flat = 0.5 * QUADRATIC.flat
    for last, count in ((False, 1), (True, 0)):  # What is flat and level is left to the next one.
        assert newton((0.1, 0.0), (1.0, flat), last=last)[1] == count
    assert newton((0.1, 0.1), (1.0, flat), last=False)[1] == 0


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_step_of_a_level_ends_at_the_limits(side):
    """The step is (0.4, 0.2) times the side, from 0.1 before one of the limits, or from there after the level above."""
    low, high = np.full(2, -0.5), np.full(2, 0.5)
    gradient, whole = -side * np.array([0.4, 0.2]), side * np.array([0.4, 0.2])
    np.testing.assert_allclose(newton(gradient, q=(0.0, 0.0), low=low, high=high)[0], whole)
    for i, share in ((0, 0.25), (1, 0.5)):
        q = np.zeros(2)
        q[i] = 0.4 * side
        np.testing.assert_allclose(newton(gradient, q=q, low=low, high=high)[0], share * whole)
        q[i] = -0.5 * side  # inwards from the other limit
        np.testing.assert_allclose(newton(gradient, q=q, low=low, high=high)[0], whole)
        q[i] = 0.5 * side  # At the limit `hold` sees to it.
        np.testing.assert_allclose(newton(gradient, q=q, low=low, high=high)[0], whole)
        q[i], dq = 0.3 * side, np.zeros(2)
        dq[i] = 0.3 * side  # already beyond
        bent = gradient - dq  # `down_level` adds the curvature of the step so far.
        np.testing.assert_allclose(newton(bent, q=q, dq=dq, low=low, high=high)[0], 0.0, atol=1e-15)
    both = newton(gradient, q=side * np.array([0.4, 0.4]), low=low, high=high)[0]
    np.testing.assert_allclose(both, 0.25 * whole)


def linear(slope, error):
    """A problem of three joints and two groups: joint 0 moves an error of level 0 that is met, the others those of level 1."""
    J = np.zeros((3, 6))
    J[0, 0] = J[1, 3] = 1.0
    J[2, 4] = slope
    bench, y = tables(3), np.array([0.0, 0.0, 0.0, 0.0, error, 0.0])
    matrices, vectors = bench[:7], np.array(bench[7:])
    desk = SimpleNamespace(q=np.zeros(3), dq=np.zeros(3), w=np.ones(3), J=J, y=y, tables=[*matrices, vectors])

    def curvature(pull, chosen, out):
        out[:3, :3] += J[:, 3:] @ J[:, 3:].T * chosen[1]

    return SimpleNamespace(
        desk=desk, bounds_of_step=lambda: Box(np.full(3, -9.0), np.full(3, 9.0)), stack=lambda e: None,
        group=lambda e, g: error**2 * g, allowed=lambda g: 0.0, tilt=lambda g: 1.0, curvature=curvature,
    )  # fmt: skip


@pytest.mark.parametrize("error", [0.01, 0.5])
def test_a_minimum_is_where_the_slope_is_small_beside_the_error(error):
    """The slope is that of the error's third component along the third joint, as a share of the error."""
    e, level = SimpleNamespace(ee=-1.0), np.array([0.0, 1.0])
    for share, said in ((0.5, AT_MINIMUM), (2.0, 0)):
        p = linear(share * QUADRATIC.first_order, error)
        assert step_by_levels(p, e, level, False) == said
    np.testing.assert_allclose(p.desk.dq, [0.0, 0.0, min(2.0 * error, QUADRATIC.longest_across)])
    p = linear(1.0, error)
    assert step_by_levels(p, e, level, False) == 0
    np.testing.assert_allclose(p.desk.dq, [0.0, 0.0, error], atol=1e-12)


def test_joints_are_held_by_mistake_if_leaving_their_limits_lowers_the_error_faster():
    box, weights = Box(np.full(3, -1.0), np.full(3, 1.0)), np.ones(3)

    def wrong(q, slopes, held=(1,), weights=weights):
        s = SimpleNamespace(q=np.array(q), J=np.array(slopes, dtype=float)[:, None], w=np.ones(3))
        s.w[list(held)] = 0.0
        return held_wrongly(s, np.ones(1), np.array(weights), box)

    for side in (1.0, -1.0):
        at = (0.0, -side, 0.0)
        assert wrong(at, (0.5, 0.6 * side, 0.0)) and not wrong(at, (0.5, 0.4 * side, 0.0))
        assert not wrong(at, (0.5, -0.6 * side, 0.0)), "it pushes outwards"
        assert not wrong(at, (0.5, 0.6 * side, -0.4)), "the free joints together are faster"
        assert not wrong(at, (0.5, 0.6 * side, 0.0), weights=(1.0, 0.0, 1.0)), "it is held on purpose"
    assert wrong((0.0, -1.0, 1.0), (0.5, 0.4, -0.4), held=(1, 2)) and not wrong((0, 0, 0), (0.0, 0.0, 0.0))
