"""The constrained step: published form, order of the objectives, direction, singular directions, limits to the bit."""

import numpy as np
import pytest
from constrained import Step, many, problem, some_rows
from numba import config
from scipy.optimize import linprog, lsq_linear

from ik_toolkit.servo.constrained_step import MODE, OUTCOME


def test_a_rate_that_fits_is_returned_bit_for_bit():
    rng = np.random.default_rng(0)
    for mode in (MODE.leave, MODE.direct):
        for _ in range(many(200)):
            J, v, low, high = problem(rng)
            want = rng.uniform(low, high)
            A = rng.normal(size=(3, len(low)))
            step = Step(J, low, high, (A, A @ want + rng.choice([1e-12, 1.0])), mode)
            x = step(J.T @ want, want)
            assert step.status == OUTCOME.wanted
            assert np.array_equal(x, want)
            assert not step.active.any() and not step.kept.any()


def test_inside_to_the_bit_and_always_solved():
    rng = np.random.default_rng(1)
    statuses = set()
    for _ in range(many(600)):
        J, v, low, high = problem(rng, tight=rng.choice([0.1, 1.0, 3.0]))
        fixed = rng.random(len(low)) < 0.1
        low[fixed] = high[fixed]
        scale = rng.uniform(0.5, 3.0, len(low))
        rows = some_rows(rng, low, high) if not fixed.any() and rng.random() < 0.7 else None
        mode = int(rng.integers(2))
        step = Step(J, low, high, rows, mode, rng.uniform(0.5, 2.0, 6), scale, rng.choice([0.0, 0.01]))
        for _ in range(4):  # warm
            x = step(v, rng.normal(size=len(low)) * rng.choice([0.0, 1.0]))
            statuses.add(step.status)
            assert step.status in (OUTCOME.wanted, OUTCOME.met, OUTCOME.short)
            assert np.all((low <= x) & (x <= high))
            assert np.array_equal(x[step.active == -1], low[step.active == -1])
            assert np.array_equal(x[step.active == 1], high[step.active == 1])
            assert rows is None or np.all(rows[0] @ x <= rows[1] + 1e-10)
            v = v + 0.1 * rng.normal(size=6)
    assert statuses >= {OUTCOME.met, OUTCOME.short}


def test_the_task_comes_first_and_the_wish_does_not_change_it():
    rng = np.random.default_rng(2)
    for _ in range(many(300)):
        J, v, low, high = problem(rng)
        step = Step(J, low, high)
        least = lsq_linear(J.T, v, (low, high), method="bvls", tol=1e-14).cost * 2.0
        residuals = [J.T @ step(v, rng.normal(size=len(low)) * size) - v for size in (0.0, 0.1, 3.0)]
        for one in residuals:
            assert np.abs(one - residuals[0]).max() <= 1e-8 * np.linalg.norm(v)
            assert one @ one <= least + 1e-9


def test_a_wider_box_is_never_worse():
    rng = np.random.default_rng(3)
    for _ in range(many(200)):
        J, v, low, high = problem(rng)
        zero = np.zeros(len(low))
        last = np.inf
        for wider in (0.3, 0.5, 1.0, 1.7):
            miss = np.linalg.norm(J.T @ Step(J, wider * low, wider * high)(v, zero) - v)
            assert miss <= last + 1e-10
            last = miss


def test_direction_is_kept_where_joints_are_too_slow():
    """What leaves the direction counts 100 times as much as falling behind, so all joints slow down together."""
    rng = np.random.default_rng(6)
    bent = []
    for _ in range(many(200)):
        J, v, size = rng.normal(size=(6, 6)), rng.normal(size=6), rng.uniform(0.1, 1.0, 6)
        want = np.linalg.solve(J.T, v)
        share = np.min(size / np.abs(want))
        if share < 1.0:
            x = {mode: Step(J, -size, size, mode=mode, scale=size)(v, want) for mode in (MODE.direct, MODE.leave)}
            along = {mode: J.T @ one @ v / (v @ v) for mode, one in x.items()}
            aside = {mode: np.linalg.norm(J.T @ one - along[mode] * v) / np.linalg.norm(v) for mode, one in x.items()}
            assert along[MODE.direct] >= share - 1e-9
            assert aside[MODE.direct] <= (1.0 - share) / (2.0 * 100.0) + 1e-9  # where cost and gain are equal
            bent.append((aside[MODE.direct], aside[MODE.leave]))
    assert np.median(bent, axis=0)[0] < 0.05 * np.median(bent, axis=0)[1]


@pytest.mark.parametrize(
    ("low", "high", "asked"),
    [
        ((-1.0, -1.0), (0.0, 1.0), (0.5, 0.5)),
        (
            (-1.0, 0.3),
            (0.0, 0.5),
            (1.0, 0.4),
        ),  # y has to go on: that is no reason to leave it behind what is asked of it
    ],
)
def test_a_blocked_direction_slides(low, high, asked):
    """There is no way along x."""
    step, asked = Step(np.eye(2), np.array(low), np.array(high), mode=MODE.direct), np.array(asked)
    np.testing.assert_allclose(step(asked, asked), [0.0, asked[1]], atol=1e-12)
    assert step.status == OUTCOME.short


def test_half_planes_that_contradict_are_loosened_by_the_least():
    rng = np.random.default_rng(8)
    seen = 0
    for _ in range(many(150)):
        J, v, low, high = problem(rng)
        n = len(low)
        A = rng.normal(size=(4, n))
        A /= np.linalg.norm(A, axis=1)[:, None]
        b = -rng.uniform(0.0, 1.0, 4) * np.sum(np.where(A > 0, -A * low, -A * high), axis=1)
        found = linprog(np.append(np.zeros(n), 1.0), np.column_stack([A, -np.ones(4)]), b, None, None,
                        [*zip(low, high, strict=True), (0.0, None)])  # fmt: skip
        step = Step(J, low, high, (A, b))
        x = step(v, np.zeros(n))
        assert np.all((low <= x) & (x <= high))
        assert np.max(A @ x - b) <= found.x[-1] + 1e-8
        assert (step.status == OUTCOME.relaxed) == (found.x[-1] > 1e-9)
        seen += step.status == OUTCOME.relaxed
    assert seen > many(20) // 5


@pytest.mark.parametrize("least", [1e-9, 1e-8, 1e-7])
def test_an_almost_singular_task_is_solved(least):
    """Where rows of different weight differ by rounding from dependent ones, the errors are as small as SciPy finds them."""
    for seed in range(many(60)):
        rng = np.random.default_rng(seed)
        U, s, Vt = np.linalg.svd(rng.normal(size=(9, 6)), full_matrices=False)
        s[-1] = least
        J, weight = U @ np.diag(s) @ Vt, np.repeat([1.0, 100.0], 3)
        low, high = -rng.uniform(0.02, 0.5, 9), rng.uniform(0.02, 0.5, 9)
        step, v = Step(J, low, high, weight=weight, step=0.005), rng.normal(size=6)
        for _ in range(3):
            x = step(v, 0.1 * rng.normal(size=9))
            best = lsq_linear((J * weight).T, weight * v, (low, high), method="bvls", tol=1e-14).x
            assert step.status == OUTCOME.short
            assert np.linalg.norm(weight * (J.T @ x - v)) <= 1.2 * np.linalg.norm(weight * (J.T @ best - v))
            v = v + 0.1 * rng.normal(size=6)


def test_columns_that_do_not_count():
    rng = np.random.default_rng(9)
    J, v, low, high = problem(rng, 7)
    weight = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
    one = Step(J, low, high, weight=weight)(0.1 * v, np.zeros(7))
    two = Step(np.ascontiguousarray(J[:, :3]), low, high)(0.1 * v[:3], np.zeros(7))
    np.testing.assert_allclose(one, two, atol=1e-12)


@pytest.mark.parametrize("mode", [MODE.leave, MODE.direct])
def test_what_held_before_changes_the_way_but_not_the_answer(mode):
    rng = np.random.default_rng(12)
    ended = set()
    for _ in range(many(300)):
        J, v, low, high = problem(rng, 7, 0.3)
        low = low + rng.random(7) * 0.9 * (high - low)  # moving joints, which cannot stop at once
        A, b = some_rows(rng, low, high)
        rows = (A, A @ (0.5 * (low + high)) + b) if rng.random() < 0.5 else None
        want, ask = 0.3 * rng.normal(size=7), rng.choice([0.3, 1.0]) * v
        cold = Step(J, low, high, rows, mode, step=0.01)
        x = cold(ask, want)
        for _ in range(2):
            other = Step(J, low, high, rows, mode, step=0.01)
            other.active[:], other.kept[:] = rng.integers(-1, 2, 7), rng.integers(0, 2, len(cold.b))
            np.testing.assert_allclose(other(ask, want), x, atol=1e-9)
            assert other.status == cold.status
        ended.add(cold.status)
    # the few cases of an uncompiled run end in some of them
    assert ended == {OUTCOME.met, OUTCOME.short} or config.DISABLE_JIT
