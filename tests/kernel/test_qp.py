"""The dual active set: optimality conditions, a library's objective, all active sets, warm starts, contradictions."""

import itertools

import numpy as np
import pytest
import quadprog
from constrained import many

from ik_toolkit.compile.array_view import keep, view
from ik_toolkit.compile.jit import cached
from ik_toolkit.servo import equality_qp
from ik_toolkit.servo.hierarchical_qp import CONTRADICTION, DONE, solve_levels


@cached
def kernel(C, d, want, low, high, A, b, state, y, multipliers):
    """|C y - d|^2 least, then |y - want|^2; multipliers (2, n + R) of the first and of the second, the rows' in their length."""
    n, count, r = want.shape[0], b.shape[0], d.shape[0]
    block = np.zeros(equality_qp.program_space(n, count + r + 1))
    p = equality_qp.resized(equality_qp.program_on(view(block), n, count + r + 1), n, count, r)
    for i in range(n):
        p.want[i], p.floor[i], p.roof[i], p.active[count + i] = want[i], low[i], high[i], state[i]
    for k in range(count + r):
        for i in range(n):
            p.P[k, i] = A[k, i] if k < count else C[k - count, i]
        p.rhs[k] = b[k] if k < count else d[k - count]
    for k in range(count):
        p.active[k] = state[n + k]
    end = solve_levels(p)
    for c in range(n + count):  # the bounds of unknowns, then half-planes
        at = count + c if c < n else c - n
        state[c] = p.active[at]
        multipliers[0, c], multipliers[1, c] = p.now.first[at], p.now.second[at]
    for i in range(n):
        y[i] = p.y[i]
    keep(block)
    return end


def solve(C, d, want, low, high, A=None, b=None, state=None):
    n = len(want)
    A, b = (np.empty((0, n)), np.empty(0)) if A is None else (A, b)
    length = np.linalg.norm(A, axis=1)
    y, multipliers = np.empty(n), np.zeros((2, n + len(b)))
    state = np.zeros(n + len(b), np.int8) if state is None else state.copy()
    end = kernel(np.ascontiguousarray(C), d, want, low, high, A / length[:, None], b / length, state, y, multipliers)
    multipliers[:, n:] /= length
    return end, y, multipliers, state


def half_planes(rng, low, high, most):
    """Rows that a point of the box satisfies, often touching it, some of them twice or parallel."""
    n, count = len(low), rng.integers(0, most + 1)
    inside = np.clip(rng.normal(size=n), low, high)
    A = rng.normal(size=(count, n)) * 10.0 ** rng.integers(-2, 3, (count, 1))
    for k in range(1, count):
        if rng.random() < 0.2:
            A[k] = A[rng.integers(k)] * rng.choice([1.0, 3.0, -1.0])
    return A, A @ inside + rng.choice([0.0, 1e-6, 0.3]) * np.linalg.norm(A, axis=1)


def box(rng, n):
    low, high = -rng.uniform(0.01, 1.0, n), rng.uniform(0.01, 1.0, n)
    kind = rng.integers(0, 8, n)
    low[kind == 0] = high[kind == 0]
    low[kind == 1] = -np.inf
    high[kind == 2] = np.inf
    return low, high


def convex(rng):
    n = int(rng.integers(1, 13))
    Q = np.linalg.qr(rng.normal(size=(n, n)))[0]
    digits = rng.choice([0, 3, 6, 12])
    H = (Q * 10.0 ** np.linspace(0, -digits, n)) @ Q.T
    H = 0.5 * (H + H.T)
    g = rng.normal(size=n) if rng.random() < 0.8 else H @ rng.normal(size=n)
    return H, g, digits, *box(rng, n)


@pytest.mark.parametrize(
    "seed, problems", [(0, 1000), pytest.param(1, 10_000, marks=pytest.mark.slow)], ids=["some", "many"]
)
def test_strictly_convex_problems(seed, problems):
    rng = np.random.default_rng(seed)
    worst, compared = 0.0, 0
    for _ in range(many(problems)):
        H, g, digits, low, high = convex(rng)
        A, b = half_planes(rng, low, high, 12)
        n = len(g)
        L = np.linalg.cholesky(H)
        end, y, (m, _), _ = solve(L.T, np.linalg.solve(L, -g), np.zeros(n), low, high, A, b)
        assert end == DONE
        size = 1.0 + np.abs(g).max() + np.abs(y).max()
        length = np.linalg.norm(A, axis=1)
        at_low, at_high = np.isclose(y, low, 1e-9, 1e-9), np.isclose(y, high, 1e-9, 1e-9)
        misses = [
            np.abs(H @ y + g + m[:n] + A.T @ m[n:]).max() / (size + np.abs(m).max()),
            max(np.max(low - y), np.max(y - high)) / size,
            np.max((A @ y - b) / length, initial=0.0) / size,
            -np.min(m[n:] * length, initial=0.0) / size,
            np.max(np.abs(m[n:] * (A @ y - b)), initial=0.0) / size**2,
            np.max(m[:n][~at_high], initial=0.0) / size,
            np.max(-m[:n][~at_low], initial=0.0) / size,
        ]
        worst = max(worst, *misses)
        unit = A / length[:, None]
        parallel = np.abs(np.tril(unit @ unit.T, -1)).max(initial=0.0) > 0.999
        # Theirs may never return where half-planes are parallel; at a condition of 1e12 its own conditions are off by 1e-5.
        theirs = library(H, g, low, high, A, b) if digits < 12 and not parallel else None
        if theirs is not None:
            compared += 1
            x, outside, slope, loose = theirs
            gap = 0.5 * (y @ H @ y - x @ H @ x) + g @ (y - x)
            outside = max(outside, np.max(A @ y - b, initial=0.0))
            own = outside * np.abs(m).sum() + slope * np.abs(x - y).sum() + loose  # what rounding explains
            assert abs(gap) <= 1e-9 * (1.0 + abs(0.5 * y @ H @ y + g @ y)) + own
            assert own <= 1e-5
    assert worst <= 1e-9
    assert compared > 0.2 * many(problems)


def library(H, g, low, high, A, b):
    """Answer of quadprog, by how much it is outside, its errors of gradient and complementarity; None where it gives up."""
    n, fixed = len(g), low == high
    low, high = np.maximum(low, -1e9), np.minimum(high, 1e9)
    rows = np.vstack([np.eye(n)[fixed], np.eye(n)[~fixed], -np.eye(n)[~fixed], -A])
    bounds = np.concatenate([low[fixed], low[~fixed], -high[~fixed], -b])
    try:
        x, _, _, _, m, _ = quadprog.solve_qp(H, -g, rows.T, bounds, int(fixed.sum()))
    except ValueError:
        return None
    room = rows @ x - bounds
    return x, np.max(-room, initial=0.0), np.abs(H @ x + g - rows.T @ m).max(), np.abs(m * room).sum()


def two_levels(rng, n):
    """A task of any rank, a wanted point, a box."""
    r = int(rng.integers(1, 7))
    C = rng.normal(size=(r, n))
    if r > 1 and rng.random() < 0.3:
        C[-1] = 2.0 * C[0]
    if rng.random() < 0.2:
        C[:, rng.integers(n)] = 0.0
    return C, rng.normal(size=r) * rng.choice([0.1, 1.0, 5.0]), rng.normal(size=n) * rng.choice([0.0, 0.3, 2.0])


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5])
def test_the_best_of_all_active_sets(n):
    rng = np.random.default_rng(n)
    for _ in range(20):
        C, d, want = two_levels(rng, n)
        low, high = box(rng, n)
        end, y, _, _ = solve(C, d, want, low, high)
        best = (np.inf, np.inf)
        for sides in itertools.product((-1, 0, 1), repeat=n):
            free = np.array(sides) == 0
            x = np.where(free, 0.0, np.where(np.array(sides) < 0, low, high))
            if not np.isfinite(x).all():
                continue
            x[free] = want[free]
            if free.any():
                x[free] += np.linalg.pinv(C[:, free], 1e-10) @ (d - C @ x)
            if np.all(x >= low - 1e-12) and np.all(x <= high + 1e-12):
                first, second = np.sum((C @ x - d) ** 2), np.sum((x - want) ** 2)
                if first < best[0] - 1e-10 or (first < best[0] + 1e-10 and second < best[1]):
                    best = first, second
        assert end == DONE
        found = np.sum((C @ y - d) ** 2), np.sum((y - want) ** 2)
        np.testing.assert_allclose(found, best, rtol=1e-7, atol=1e-9)


def test_a_warm_start_gives_the_cold_answer():
    rng = np.random.default_rng(1)
    for _ in range(many(1000)):
        n = int(rng.integers(2, 20))
        C, d, want = two_levels(rng, n)
        low, high = box(rng, n)
        A, b = half_planes(rng, low, high, 6)
        end, y, _, state = solve(C, d, want, low, high, A, b)
        assert end == DONE
        guess = np.concatenate([rng.integers(-1, 2, n), rng.integers(0, 2, len(b))]).astype(np.int8)
        for start in (state, guess):
            end, again, _, _ = solve(C, d, want, low, high, A, b, state=start)
            assert end == DONE
            np.testing.assert_allclose(again, y, atol=1e-9 * (1.0 + np.abs(y).max()))


def test_contradictions_are_found():
    rng = np.random.default_rng(2)
    for _ in range(many(500)):
        n = int(rng.integers(1, 10))
        C, d, want = two_levels(rng, n)
        low, high = box(rng, n)
        A, b = half_planes(rng, low, high, 5)
        if len(b) and rng.random() < 0.5:  # a positive sum of rows, turned round
            share = rng.uniform(0.1, 1.0, len(b))
            row, bound = -share @ A, -share @ b - 0.01
        else:  # more than the box allows
            row = np.where(np.isinf(low) | np.isinf(high), 0.0, rng.normal(size=n))
            reach = np.where(row > 0.0, low, high)
            bound = row[row != 0.0] @ reach[row != 0.0] - 0.01
        if np.linalg.norm(row) > 0.1:
            end, *_ = solve(C, d, want, low, high, np.vstack([A, row]), np.append(b, bound))
            assert end == CONTRADICTION
