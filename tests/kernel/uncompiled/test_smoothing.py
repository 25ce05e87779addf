"""Secondary objectives and whole paths: what they cost, derivatives, and where they end."""

import numpy as np
import pytest
import random_arms as arms
from scipy.optimize import approx_fprime

from ik_toolkit.kernel import null_space
from ik_toolkit.kernel.counted_error import KIND
from ik_toolkit.kernel.null_space import OBJECTIVE, Bounds
from ik_toolkit.kernel.records import AT, SIZE, Ends, Orders, Task
from ik_toolkit.kernel.serial import make_serial
from ik_toolkit.paths import smoothing

ORDERS = Orders(**{**dict.fromkeys(Orders._fields, 0.0), "tol_p": 1e-9, "tol_r": 1e-9, "limits": 1.0})


def box_of(lower, upper, counted=None):
    return Bounds(np.array([lower, upper, np.ones(len(lower)) if counted is None else counted], float))


def full(A):
    """The symmetric matrix of a band."""
    M, b = A.shape[0], A.shape[1] - 1
    S = np.zeros((M, M))
    for i in range(M):
        for k in range(max(0, i - b), i + 1):
            S[i, k] = S[k, i] = A[i, k - i + b]
    return S


def test_what_a_path_costs_and_its_derivatives():
    rng = np.random.default_rng(1)
    N, n, first, second, rounding = 6, 2, 0.7, 3.0, 0.05
    Q, longest = rng.normal(size=(N, n)) * 0.1, np.array([0.3, 0.1])

    def cost(x):
        D = np.diff(x.reshape(N, n), axis=0)
        return first * (np.sqrt(D**2 + rounding**2) - rounding).sum() + 0.5 * second * (np.diff(D, axis=0) ** 2).sum()

    total, worst = smoothing.cost_of(Q, smoothing.PathPrice(first, second, rounding), longest)
    assert total == pytest.approx(cost(Q.ravel()), rel=1e-12)
    assert worst == pytest.approx((np.abs(np.diff(Q, axis=0)) / longest).max())
    # below 1, too
    assert smoothing.cost_of(Q, smoothing.PathPrice(first, second, rounding), 10.0 * longest)[1] == pytest.approx(
        0.1 * worst
    )
    H, g = np.full((N * n, 2 * n + 1), 7.0), np.full(N * n, 7.0)
    smoothing.differences(Q, smoothing.PathPrice(first, second, rounding), H, g)
    np.testing.assert_allclose(g, approx_fprime(Q.ravel(), cost, 1e-7), atol=2e-6)
    w = first / np.sqrt(np.diff(Q, axis=0) ** 2 + rounding**2)
    D = np.kron(np.diff(np.eye(N), axis=0), np.eye(n))
    DD = np.kron(np.diff(np.eye(N), 2, axis=0), np.eye(n))
    np.testing.assert_allclose(
        full(H), D.T @ (w.ravel()[:, None] * D) + second * DD.T @ DD + 1e-9 * np.eye(N * n), atol=1e-10
    )
    held = rng.random(N * n) < 0.3
    A, x = np.full_like(H, 5.0), np.empty(N * n)
    smoothing.held_system(H, g, held, A, x)
    want = full(H)
    want[held], want[:, held] = 0.0, 0.0
    want[held, held] = 1.0
    np.testing.assert_allclose(full(A), want)
    np.testing.assert_allclose(x, np.where(held, 0.0, -g))
    assert not np.any(A[0, :-1])


def arm_at(seed, kind=KIND.pose, kinds="tttsttt", part=None):
    rng = np.random.default_rng(seed)
    chain, rows, base, tip = arms.arm(rng, kinds)
    t = np.array(Task(float(kind), **(part or {})))
    p = make_serial(chain.rows, chain.ends, t, chain.n, ORDERS)
    q = 0.5 * rng.uniform(chain.lower, chain.upper)
    T = arms.fk(rows, base, tip, q)[0]
    assert p.aim(T, ORDERS) == 0.0
    return rng, chain, rows, base, tip, p, q, T


@pytest.mark.parametrize("kind", [KIND.pose, KIND.position])
def test_objectives_and_where_they_fall(kind):
    rng, chain, rows, base, tip, p, q, _ = arm_at(4, kind)
    ends, n = Ends(chain.ends, chain.n), chain.n
    ref = rng.uniform(chain.lower, chain.upper)
    box = box_of(chain.lower / chain.unit, chain.upper / chain.unit, [1, 0] + [1] * (n - 2))
    x = q / chain.unit
    span, weights = (chain.upper - chain.lower) / chain.unit, rng.uniform(0.2, 3.0, chain.n)

    def volume(y):
        J = arms.jacobian(rows, base, tip, y * chain.unit, 1e-5)[: 3 if kind == KIND.position else 6]
        J = J / np.array([chain.scale] * 3 + [1.0] * 3)[: len(J), None]
        return 0.5 * np.linalg.slogdet(J @ J.T)[1]

    def value(what, y):
        p.desk.q[:] = y
        p.jacobian(p.evaluate(p.desk.q))
        return null_space.objective(p, what, ends, box, ref, weights)

    middle = 0.5 * (chain.lower + chain.upper) / chain.unit
    counted = np.array([box.counted(i) for i in range(n)])
    assert value(OBJECTIVE.mid_range, x) == pytest.approx((counted * 0.5 * ((x - middle) / span) ** 2).sum())
    assert value(OBJECTIVE.reference, x) == pytest.approx((counted * 0.5 * (x - ref / chain.unit) ** 2 / weights).sum())
    assert value(OBJECTIVE.manipulability, x) == pytest.approx(-volume(x), rel=1e-6)
    z = np.empty(n)
    for what, goal in ((OBJECTIVE.mid_range, middle), (OBJECTIVE.reference, ref / chain.unit)):
        value(what, x)
        null_space.downhill(p, what, ends, box, ref, 0.0, z)
        np.testing.assert_allclose(z, counted * (goal - x), rtol=1e-12)
    now = value(OBJECTIVE.manipulability, x)
    null_space.downhill(p, OBJECTIVE.manipulability, ends, box, ref, now, z)
    slope = [(volume(x + 1e-4 * e) - volume(x - 1e-4 * e)) / 2e-4 for e in np.eye(n)]
    np.testing.assert_allclose(2.0 * z, slope, atol=5e-4)
    np.testing.assert_allclose(p.desk.q, x, atol=1e-12)
    again = p.desk.J.copy()
    p.jacobian(p.evaluate(x))
    np.testing.assert_allclose(again, p.desk.J, atol=1e-9)


@pytest.mark.parametrize("what", [OBJECTIVE.mid_range, OBJECTIVE.reference, OBJECTIVE.manipulability])
def test_a_solution_is_improved_to_where_it_cannot_be_any_more(what):
    rng, chain, rows, base, tip, p, q, T = arm_at(6)
    n = chain.n
    row = np.zeros(SIZE.answer + n)
    row[SIZE.answer :] = q
    o = ORDERS._replace(tol_p=1e-8, tol_r=1e-8)
    ref = 0.5 * (chain.lower + chain.upper) if what == OBJECTIVE.reference else np.zeros(n)
    pack = np.array([*o, *Task(float(KIND.pose)), *np.ones(n)])
    null_space.refine(chain.rows, chain.ends, T[None], row, ref, pack, what, 60)
    x = row[SIZE.answer :]
    np.testing.assert_allclose(arms.fk(rows, base, tip, x)[0], T, atol=3e-8)
    assert row[AT.position] < 1e-8 and row[AT.rotation] < 1e-8
    span = chain.upper - chain.lower
    J = arms.jacobian(rows, base, tip, x) / chain.scale ** np.repeat([1.0, 0.0], 3)[:, None] * chain.unit
    null = np.linalg.svd(J)[2][-1]
    unit = chain.unit

    def value(y):
        if what == OBJECTIVE.manipulability:
            K = arms.jacobian(rows, base, tip, y, 1e-5)
            return -0.5 * np.linalg.slogdet(K @ K.T)[1]
        return 0.5 * (((y - 0.5 * (chain.lower + chain.upper)) / span) ** 2).sum()

    inside = np.all((x > chain.lower + 1e-6) & (x < chain.upper - 1e-6))
    assert value(x) < value(q)
    if inside:
        d = 1e-3 * null * unit
        assert abs(value(x + d) - value(x - d)) / 2e-3 < (2e-2 if what == OBJECTIVE.manipulability else 2e-3)


def test_a_path_gets_smooth_and_keeps_its_poses():
    rng, chain, rows, base, tip, p, q, _ = arm_at(8)
    n, N = chain.n, 9
    goals = q + np.linspace(0.0, 0.15, N)[:, None] * chain.unit
    T = np.array([[arms.fk(rows, base, tip, g)[0]] for g in goals])[:, 0]
    noise = 0.02 * rng.normal(size=(N, n)) * chain.unit
    noise[[0, 4, -1]] = 0.0
    Q, good = goals + noise, np.zeros(N, bool)
    pack = np.array([*ORDERS._replace(tol_p=1e-8, tol_r=1e-8), *Task(float(KIND.pose)), *np.ones(n)])
    smoothing.settle_rows(chain.rows, chain.ends, T, Q, pack, good)
    assert good.all()
    for k in range(N):
        np.testing.assert_allclose(arms.fk(rows, base, tip, Q[k])[0], T[k], atol=1e-9)
    fixed = np.zeros(N, bool)
    fixed[[0, 4]] = True
    start, longest = Q.copy(), 2.0 * np.abs(np.diff(Q, axis=0)).max(axis=0)
    taken, before, after = smoothing.smooth_rows(
        chain.rows, chain.ends, T, Q, fixed, pack, 1.0, 20.0, 1e-3, longest, 30, good
    )
    size = longest / chain.unit
    assert taken > 0 and after < before
    assert before == pytest.approx(smoothing.cost_of(start / chain.unit, smoothing.PathPrice(1.0, 20.0, 1e-3), size)[0])
    assert after == pytest.approx(smoothing.cost_of(Q / chain.unit, smoothing.PathPrice(1.0, 20.0, 1e-3), size)[0])
    np.testing.assert_array_equal(Q[fixed], start[fixed])
    assert good.all() and np.all(np.abs(np.diff(Q, axis=0)) <= longest)
    for k in range(N):
        np.testing.assert_allclose(arms.fk(rows, base, tip, Q[k])[0], T[k], atol=1e-9)
    assert after <= 1.02 * smoothing.cost_of(goals / chain.unit, smoothing.PathPrice(1.0, 20.0, 1e-3), size)[0]
    assert smoothing.smooth_rows(chain.rows, chain.ends, T, Q, fixed, pack, 1.0, 20.0, 1e-3, longest, 0, good)[0] == 0
