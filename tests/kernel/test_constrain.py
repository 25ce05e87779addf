"""The constrained step: published form, order of the objectives, clock, direction, singular directions, limits to the bit."""

import numpy as np
import pytest
from constrained import Step, many, planar, problem, some_rows
from numba import config
from scipy.optimize import linprog, lsq_linear

from ik_toolkit.servo.constrained_step import DIRECT, LEAVE, MET, RELAXED, SHORT, SLOW, SLOWED, WANTED


def test_a_rate_that_fits_is_returned_bit_for_bit():
    rng = np.random.default_rng(0)
    for mode in (LEAVE, SLOW, DIRECT):
        for _ in range(many(200)):
            J, v, low, high = problem(rng)
            want = rng.uniform(low, high)
            cap = rng.uniform(0.1, 1.0) if mode == SLOW else 1.0
            A = rng.normal(size=(3, len(low)))
            step = Step(J, low, high, (A, A @ want + rng.choice([1e-12, 1.0])), mode, cap, singular=0.5, damping=0.5)
            x = step(J.T @ want - cap * v, v, want)
            assert step.status == WANTED and step.rate == cap
            assert np.array_equal(x, want)
            assert not step.active.any() and not step.kept.any() and not step.push.any()


def test_inside_to_the_bit_and_always_solved():
    rng = np.random.default_rng(1)
    statuses = set()
    for _ in range(many(600)):
        J, v, low, high = problem(rng, tight=rng.choice([0.1, 1.0, 3.0]))
        fixed = rng.random(len(low)) < 0.1
        low[fixed] = high[fixed]
        scale = rng.uniform(0.5, 3.0, len(low))
        rows = some_rows(rng, low, high) if not fixed.any() and rng.random() < 0.7 else None
        mode = int(rng.integers(3))
        step = Step(J, low, high, rows, mode, 1.0, rng.choice([0.0, 1.0]), 0.3, rng.uniform(0.5, 2.0, 6), scale)
        for _ in range(4):  # warm
            x = step(v * 0.3, v * 0.7, rng.normal(size=len(low)) * rng.choice([0.0, 1.0]))
            statuses.add(step.status)
            assert step.status in (WANTED, MET, SHORT)
            assert np.all((low <= x) & (x <= high)) and 0.0 <= step.rate <= 1.0
            assert np.array_equal(x[step.active == -1], low[step.active == -1])
            assert np.array_equal(x[step.active == 1], high[step.active == 1])
            assert rows is None or np.all(rows[0] @ x <= rows[1] + 1e-10)
            v = v + 0.1 * rng.normal(size=6)
    assert statuses >= {MET, SHORT}


def test_the_task_comes_first_and_the_wish_does_not_change_it():
    rng = np.random.default_rng(2)
    for _ in range(many(300)):
        J, v, low, high = problem(rng)
        zero = np.zeros(6)
        step = Step(J, low, high)
        least = lsq_linear(J.T, v, (low, high), method="bvls", tol=1e-14).cost * 2.0
        residuals = [J.T @ step(v, zero, rng.normal(size=len(low)) * size) - v for size in (0.0, 0.1, 3.0)]
        for one in residuals:
            assert np.abs(one - residuals[0]).max() <= 1e-8 * np.linalg.norm(v)
            assert one @ one <= least + 1e-9


def test_a_wider_box_is_never_worse():
    rng = np.random.default_rng(3)
    for _ in range(many(200)):
        J, v, low, high = problem(rng)
        zero = np.zeros(len(low))
        last, slower = np.inf, -1.0
        for wider in (0.3, 0.5, 1.0, 1.7):
            miss = np.linalg.norm(J.T @ Step(J, wider * low, wider * high)(v, np.zeros(6), zero) - v)
            assert miss <= last + 1e-10
            clock = Step(J, wider * low, wider * high, mode=SLOW)
            clock(np.zeros(6), v, zero)
            assert clock.rate >= slower - 1e-7
            last, slower = miss, clock.rate


def fastest(J, feedback, forward, low, high, rows=None):
    """Largest rate at which J'x = feedback + rate forward can be, of what J can do; None when it cannot at any."""
    U, s, _ = np.linalg.svd(J.T)
    U = U[:, : np.sum(s > 1e-9 * s[0])].T
    A, b = (None, None) if rows is None else (np.column_stack([rows[0], np.zeros(len(rows[1]))]), rows[1])
    found = linprog(
        np.append(np.zeros(len(low)), -1.0), A, b, np.column_stack([U @ J.T, -U @ forward]), U @ feedback,
        [*zip(low, high, strict=True), (0.0, 1.0)],
    )  # fmt: skip
    return found.x[-1] if found.status == 0 else None


def test_the_clock_is_as_fast_as_it_can_be():
    rng = np.random.default_rng(4)
    slowed = 0
    for _ in range(many(200)):
        J, v, low, high = problem(rng)
        back = J.T @ rng.uniform(low, high) * rng.choice([0.0, 0.3])
        rows = some_rows(rng, low, high) if rng.random() < 0.3 else None
        rate = fastest(J, back, v, low, high, rows)
        if rate is None:
            continue
        step = Step(J, low, high, rows, SLOW)
        x = step(back, v, rng.normal(size=len(low)) * rng.choice([0.0, 0.5]))
        slowed += 0.0 < rate < 1.0
        assert step.status == MET
        assert abs(step.rate - rate) <= 1e-6
        assert step.rate == 1.0 or rate < 1.0
        np.testing.assert_allclose(J @ (J.T @ x - back - step.rate * v), 0.0, atol=1e-8)
    assert slowed > many(50) // 5


def test_the_clock_is_full_to_the_bit_where_nothing_binds():
    rng = np.random.default_rng(5)
    for _ in range(many(100)):
        J, v, low, high = problem(rng, 7)
        step = Step(J, 1e6 * low, 1e6 * high, mode=SLOW, cap=0.75)
        step(0.1 * v, v, rng.normal(size=7))  # a wish that does not fit the task
        assert step.rate == 0.75 and step.status == MET


def test_what_no_joint_can_do_neither_slows_the_clock_nor_stops_the_arm():
    J = np.array([[1.0, 0.0, 0.0, 0.0, 0.0, 1.0], [0.4, 0.8, 0.0, 0.0, 0.0, 1.0]])  # two joints in a plane
    step = Step(J, np.full(2, -9.0), np.full(2, 9.0), mode=SLOW)
    x = step(np.zeros(6), np.array([0.3, 0.1, 0.2, 0.0, 0.1, 0.5]), np.zeros(2))
    assert step.rate == 1.0
    np.testing.assert_allclose(x, np.linalg.pinv(J.T) @ [0.3, 0.1, 0.2, 0.0, 0.1, 0.5], atol=1e-12)


def test_direction_is_kept_where_a_joint_saturates():
    rng = np.random.default_rng(6)
    between = 0
    for _ in range(many(200)):
        J = rng.normal(size=(7, 6))
        v = rng.normal(size=6)
        low, high = -rng.uniform(0.05, 1.0, 7), rng.uniform(0.05, 1.0, 7)
        step = Step(J, low, high, mode=DIRECT)
        x = step(v, np.zeros(6), np.zeros(7))
        alpha = fastest(J, np.zeros(6), v, low, high)
        assert abs(step.rate - alpha) <= 1e-6
        done = J.T @ x
        along = done @ v / (v @ v)
        aside = np.linalg.norm(done - along * v) / np.linalg.norm(v)
        assert along >= alpha - 1e-6
        assert aside <= (1.0 - alpha) / (2.0 * (1.0 + 99.0 * alpha)) + 1e-6  # where cost and gain are equal
        if alpha == 1.0:
            assert step.status == MET and aside <= 1e-9
        between += 0.1 < alpha < 0.9
    assert between > many(30) // 5


def test_a_blocked_direction_slides():
    J = np.array([[1.0, 0.0], [0.0, 1.0]])
    step = Step(J, np.array([-1.0, -1.0]), np.array([0.0, 1.0]), mode=DIRECT)  # no way along x
    x = step(np.array([0.5, 0.5]), np.zeros(2), np.zeros(2))
    assert step.status == SHORT and step.rate <= 1e-12
    np.testing.assert_allclose(x, [0.0, 0.5], atol=1e-12)


def test_a_joint_that_cannot_stop_at_once_does_not_choose_the_direction():
    """No way along x, and y has to go on: that is no reason to leave y behind what is asked of it."""
    step = Step(np.eye(2), np.array([-1.0, 0.3]), np.array([0.0, 0.5]), mode=DIRECT)
    x = step(np.array([1.0, 0.4]), np.zeros(2), np.zeros(2))
    assert step.status == SHORT and step.rate <= 1e-12
    np.testing.assert_allclose(x, [0.0, 0.4], atol=1e-12)


def test_a_singular_direction_alone_is_damped():
    rng = np.random.default_rng(7)
    top, most = 0.3, 0.2
    for bend in (0.5, 0.1, 1e-2, 1e-4):
        J = planar(np.array([0.3, bend, -0.4 * bend]))
        want, v = rng.normal(size=3) * 0.1, rng.normal(size=2)
        x = Step(J, np.full(3, -1e9), np.full(3, 1e9), singular=top, damping=most)(v, np.zeros(2), want)
        U, s, Vt = np.linalg.svd(J.T)
        fade = np.where(s < top, 1.0 - (s / top) ** 2, 0.0)
        extra = (most * fade) ** 2
        share = (s * (U.T @ v) + extra * (Vt[:2] @ want)) / (s**2 + extra)
        np.testing.assert_allclose(x, want + Vt[:2].T @ (share - Vt[:2] @ want), atol=1e-9)


@pytest.mark.parametrize("mode", [LEAVE, SLOW, DIRECT])
def test_no_chatter_along_a_singular_direction(mode):
    """A target slowly pulled through full extension: joint rates change smoothly, what holds changes a few times."""
    step = Step(planar(np.zeros(3)), np.full(3, -2.0), np.full(3, 2.0), mode=mode, singular=0.2, damping=0.1)
    X, held = [], []
    for t in np.linspace(0.0, 1.0, 2001):
        step.J[:] = planar(np.array([0.2, 0.4 * (0.6 - t), 0.3 * (0.6 - t)]))  # straight at t = 0.6
        pull = np.array([np.cos(0.2), np.sin(0.2)]) * 0.4
        X.append(step(pull + 0.01 * np.sin(6.0 * t), 0.2 * pull, np.zeros(3)))
        held.append(step.active.copy())
    moves = np.abs(np.diff(X, axis=0))
    assert np.sum(np.any(np.diff(held, axis=0) != 0, axis=1)) <= 12
    assert np.median(moves) < 0.01
    turns = np.sum(np.diff(np.sign(np.diff(X, axis=0)), axis=0) != 0, axis=0)  # of the rates
    assert turns.max() <= 20


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
        x = step(v, np.zeros(6), np.zeros(n))
        assert np.all((low <= x) & (x <= high))
        assert np.max(A @ x - b) <= found.x[-1] + 1e-8
        assert (step.status == RELAXED) == (found.x[-1] > 1e-9)
        seen += step.status == RELAXED
    assert seen > many(20) // 5


def test_columns_that_do_not_count():
    rng = np.random.default_rng(9)
    J, v, low, high = problem(rng, 7)
    weight = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
    one = Step(J, low, high, weight=weight)(0.1 * v, np.zeros(6), np.zeros(7))
    two = Step(np.ascontiguousarray(J[:, :3]), low, high)(0.1 * v[:3], np.zeros(3), np.zeros(7))
    np.testing.assert_allclose(one, two, atol=1e-12)


@pytest.mark.parametrize("mode", [SLOW, DIRECT])
def test_what_held_before_changes_the_way_but_not_the_answer(mode):
    rng = np.random.default_rng(12)
    ended = set()
    for _ in range(many(300)):
        J, v, low, high = problem(rng, 7, 0.3)
        low = low + rng.random(7) * 0.9 * (high - low)  # moving joints, which cannot stop at once
        A, b = some_rows(rng, low, high)
        rows = (A, A @ (0.5 * (low + high)) + b) if rng.random() < 0.5 else None
        want, ask = 0.3 * rng.normal(size=7), (0.2 * v, rng.choice([0.1, 0.8]) * v)
        cold = Step(J, low, high, rows, mode, step=0.01)
        x = cold(*ask, want)
        for state in (1, 31):
            other = Step(J, low, high, rows, mode, step=0.01)
            other.active[:] = rng.integers(-1, 2, 7)
            other.kept[:-1], other.kept[-1] = rng.integers(0, 2, cold.count or 1), state
            other.starts[:, :7], other.starts[:, 7:] = (
                rng.integers(-1, 2, (4, 7)),
                rng.integers(0, 2),
            )
            np.testing.assert_allclose(other(*ask, want), x, atol=1e-9)
            assert other.status == cold.status and other.rate == pytest.approx(cold.rate, abs=1e-9)
        ended.add((int(cold.kept[-1]) & SLOWED, cold.status))
    ways = {(0, MET), (0, SHORT), (1, SHORT), *([(1, MET)] if mode == SLOW else [])}
    assert ended <= ways and (
        config.DISABLE_JIT or ended == ways
    )  # the few cases of an uncompiled run end in some of them
