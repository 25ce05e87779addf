"""One step of a tracker: a published law with a clock, the effect of limits, two levels of objectives, scratch arrays."""

import itertools

import numpy as np
import pytest
import random_arms as arms
from random_arms import make_levels, orders, task

from ik_toolkit.kernel import constrain as constrain_module
from ik_toolkit.kernel import levels, motion, obey, qp, wanted
from ik_toolkit.kernel.bench import bench_on, bench_space
from ik_toolkit.kernel.box import RECOVERING, ROW
from ik_toolkit.kernel.constrain import DIRECT, LEAVE, SLOW, SLOWED, constrain, make_room, room_on, room_space
from ik_toolkit.kernel.motion import AA, AT_RATE_AND_STEP, AV, CA, CV, RUNNING, STATE, Law
from ik_toolkit.kernel.problem import make_desk
from ik_toolkit.kernel.serial import make_serial
from ik_toolkit.kernel.stages import CAUTIOUS


def law(code=CV, **values):
    return Law(**{**dict.fromkeys(Law._fields, 0.0), "code": code, "gamma": 1.0, "mode": LEAVE, **values})


def bench(n, m, rows=3):
    return bench_on(np.zeros(bench_space(n, m, rows)), n, m, rows)


def test_shapes_of_scratch():
    n, m, rows = 7, 12, 4
    s = bench(n, m, rows)
    shapes = {name: getattr(s, name).shape for name in s._fields}
    of = {
        (n,): "why_low why_top move null x1 x2 x w g lead v probe before at size even floor roof", (2, 4, 4): "Ts", (2, 3): "flip",
        (m,): "Vs As e ahead f pace a ask bias weight t sv lost xk pull y", (m, m): "G H U", (n, m): "J V", (m, n): "W",
        (n + rows,): "multiplier", (rows, n): "planes", (rows,): "edges",
    }  # fmt: skip
    assert shapes == {name: shape for shape, names in of.items() for name in names.split()}
    assert bench(9, 6).G.shape == (9, 9) and bench(9, 6).y.shape == (9,)
    K, N = 6, 9
    s = make_levels(N, K)
    want = {
        "P": (K, N),
        "W": (K, N),
        "L": (K, K),
        "U": (2 * K, K),
        "V": (8, N),
        "S": (12, K),
        "state": (N + K,),
        "order": (K,),
    }
    assert {name: getattr(s, name).shape for name in s._fields} == want
    for room in (make_room(n, m, rows), room_on(np.zeros(room_space(n, m, rows)), n, m, rows)):
        assert room.task.shape == (rows + m + 1, 2) and room.levels.P.shape == (rows + m + 1, n + m + 1)
    desk = make_desk(np.zeros(4000), n, m)
    assert {name: getattr(desk, name).shape for name in desk._fields} == {
        "q": (n,), "dq": (n,), "start": (n,), "w": (n,), "x": (4 * n + 8,), "J": (n, m), "A": (m, m), "y": (m,),
        "e": (m,), "spent": (2,),
        "errors": (3, 2, 2),
    }  # fmt: skip
    assert not desk.J.any() and not desk.spent.any()


@pytest.mark.parametrize("code", [CV, AV, CA, AA])
@pytest.mark.parametrize("mode", [LEAVE, SLOW])
def test_a_law_with_a_clock_that_changes_its_rate(code, mode):
    rng = np.random.default_rng(code)
    chain, rows, base, tip = arms.arm(rng, "tttsttt")
    n, m, h = chain.n, 6, 0.02
    p = make_serial(chain.rows, chain.ends, task(), n, orders())
    q = 0.5 * rng.uniform(chain.lower, chain.upper) / chain.unit
    p.aim(arms.fk(rows, base, tip, q * chain.unit)[0], orders())
    look = p.evaluate(q)
    p.jacobian(look)
    s = bench(n, m)
    s.J[:], s.at[:], s.floor[:], s.roof[:] = p.desk.J, q, -9e9, 9e9
    s.e[:], s.ahead[:], s.f[:], s.a[:] = rng.normal(size=(4, m)) * 0.1
    pace, rate, memory = s.f.copy(), rng.normal(size=n), rng.normal(size=n)
    old, state = memory.copy(), np.zeros(len(STATE))
    state[STATE.start], state[STATE.period], state[STATE.sigma] = RUNNING, 0.04, 0.5
    rule = law(code, mode=mode, kappa=3.0, kp=20.0, kd=8.0, gamma=0.7, null=0.9, reading=AT_RATE_AND_STEP)
    limits = np.array([np.full(n, -9e9), np.full(n, 9e9), np.full(n, 1e12), np.full(n, np.inf)])
    sigma = 0.75
    lost = wanted.by_law(
        rule,
        None,
        p,
        look,
        None,
        s,
        np.zeros(m),
        limits,
        np.zeros((3, n)),
        0,
        sigma,
        h,
        rate,
        memory,
        np.zeros(n),
        np.zeros((m, m)),
        state,
    )
    assert lost == 0.0 and state[STATE.near] == 0.0
    J, f, ratio = p.desk.J, sigma * pace, h / 0.04
    pinv = np.linalg.pinv(J.T)
    jump, lead = (sigma - 0.5, pinv @ pace) if mode == SLOW else (0.0, np.zeros(n))
    step, own = pinv @ s.ahead, rate - pinv @ (J.T @ rate)
    bias = np.empty(m)
    if code >= CA:
        p.bending(look, rate, rate if code == CA else step / h + own, bias)
    if code == CV:
        u = pinv @ (f + 3.0 * s.e)
        want = u + 0.5 * ratio * (u - (old + jump * lead))
    elif code == AV:
        u, want = old, step / h
    elif code == CA:
        u = pinv @ (s.a + 8.0 * (f - jump * pace - J.T @ rate) + 20.0 * s.e - bias) - 0.9 * own
        want = rate + h * (u + 0.5 * ratio * (u - old)) + jump * lead
    else:
        u, want = old, rate + h * ((step / h - rate + own) / (0.7 * h) - 0.5 / 0.7 * (pinv @ bias) - 0.9 * own)
    np.testing.assert_allclose(s.x, want, rtol=1e-7, atol=1e-7)
    np.testing.assert_allclose(memory, u, rtol=1e-7, atol=1e-7)
    np.testing.assert_allclose(s.f, f, atol=1e-13)
    np.testing.assert_allclose(s.pace, pace)
    if mode == SLOW:
        np.testing.assert_allclose(s.lead, lead, atol=1e-9)


def given(mode, roof=0.5, h=0.1, sigma=1.0, plane=None, want=None, mu=0.0):
    """A step of six joints that each move one error; the first may go half as fast as is wanted."""
    n = 6
    s, state = bench(n, n), np.zeros(len(STATE))
    s.J[:], s.size[:], s.weight[:], s.floor[:], s.roof[:] = np.eye(n), 1.0, 1.0, -2.0, 2.0
    s.why_low[:], s.why_top[:] = 2, 1
    s.roof[0] = roof
    s.f[:] = sigma * np.ones(n)
    s.x[:] = s.f if want is None else want
    count = 0
    if plane is not None:
        s.planes[0], s.edges[0], count = plane[0], plane[1], 1
    motion.factor(s.J, n, 0.0, s.G, s.y)
    state[STATE.sigma] = sigma
    if mu > 0.0:  # a step down
        s.ask[:], s.size[:], s.even[:], s.f[:], s.x[:] = s.x, 7.0, 1.0, 0.0, 0.0
    code, active, kept = np.zeros(n, np.uint8), np.zeros(n, np.int8), np.zeros(4, np.int8)
    starts = np.zeros((4, n + 4), np.int8)
    found = obey.by_constraints(
        law(mode=mode, rows=float(count)), s, count, sigma, mu, h, state, make_room(n, n, 3), active, kept, starts, code
    )
    holds = [k < count and bool(abs(s.planes[k] @ s.x - s.edges[k]) < 1e-9) for k in range(3)]
    assert kept[:3].tolist() == holds
    return *found, s.x, code, active


def test_what_limits_make_of_the_rates_wanted():
    for mode in (LEAVE, SLOW):
        sigma, held, x, code, _ = given(mode, 1.5, sigma=0.8)
        assert sigma == 0.8 and not held and not code.any()
        np.testing.assert_array_equal(x, 0.8)
    sigma, held, x, code, active = given(LEAVE)
    assert sigma == 1.0 and held and code.tolist() == [1, 0, 0, 0, 0, 0] and active[0] == 1
    np.testing.assert_allclose(
        x, [0.5, *[1.0 / (1.0 + CAUTIOUS * 0.1 * 0.5)] * 5], atol=1e-9
    )  # damped by what is left, 0.5
    for mode in (LEAVE, DIRECT):
        _, held, x, code, active = given(mode, mu=0.3)
        assert held and code.tolist() == [1, 0, 0, 0, 0, 0] and active[0] == 1
        np.testing.assert_allclose(x, [0.5, *[1.0 / 1.3] * 5], atol=1e-12)
    sigma, held, x, code, _ = given(SLOW, h=0.2)
    assert sigma == pytest.approx(0.5, abs=1e-6) and held and code[0] == 1
    np.testing.assert_allclose(x, 0.5, atol=1e-6)
    sigma, held, x, code, _ = given(SLOW, h=0.02)  # the clock cannot stop so fast
    assert sigma == pytest.approx(0.8) and held
    np.testing.assert_allclose(x, [0.5, *[0.8 / (1.0 + CAUTIOUS * 0.02 * 0.3)] * 5], atol=1e-6)
    row = np.array([0.0, 0.1, 0.0, 0.9, 0.0, 0.0])
    sigma, held, x, code, active = given(LEAVE, 2.0, plane=(row, 0.3))
    assert held and code.tolist() == [0, 0, 0, ROW, 0, 0] and row @ x == pytest.approx(0.3)
    sigma, held, x, code, _ = given(LEAVE, 2.0, want=np.array([1.0, 1, 1, 1, 1, -3.0]))
    assert held and code[5] == 2 and x[5] == -2.0 and RECOVERING == 16
    row = np.array([0.0, 0.1, 0.0, -0.9, 0.0, 0.0])  # the joint that the row holds most, whichever way
    _, held, x, code, _ = given(LEAVE, 2.0, plane=(row, -1.0))
    assert held and code.tolist() == [0, 0, 0, ROW, 0, 0] and row @ x == pytest.approx(-1.0)


def test_what_is_wished_beside_the_task_has_no_part_along_it():
    rng = np.random.default_rng(8)
    for n, m in ((7, 6), (4, 3), (7, 3)):
        s, state = bench(n, m), np.zeros(len(STATE))
        s.J[:], s.f[:], s.x[:] = rng.normal(size=(n, m)), rng.normal(size=m), rng.normal(size=n)
        s.size[:], s.weight[:], s.floor[:], s.roof[:] = 1.0, 1.0, -9.0, 9.0
        motion.factor(s.J, m, 0.0, s.G, s.y)
        state[STATE.sigma], wanted_rates = 1.0, s.x.copy()
        lists = np.zeros(n, np.int8), np.zeros(4, np.int8), np.zeros((4, n + 4), np.int8), np.zeros(n, np.uint8)
        obey.by_constraints(law(), s, 0, 1.0, 0.0, 0.1, state, make_room(n, m, 3), *lists)
        np.testing.assert_allclose(s.J.T @ s.v, 0.0, atol=1e-12)
        pinv = np.linalg.pinv(s.J.T)
        np.testing.assert_allclose(s.v, wanted_rates - pinv @ (s.J.T @ wanted_rates), atol=1e-10)


@pytest.mark.parametrize("mode", [SLOW, DIRECT])
def test_a_step_like_the_last_one_takes_one_iteration_a_problem(monkeypatch, mode):
    counted, solve = [], constrain_module.solve_levels
    problems, equality = [], qp.equality
    monkeypatch.setattr(qp, "equality", lambda *parts: counted.append(1) or equality(*parts))
    monkeypatch.setattr(constrain_module, "solve_levels", lambda *parts: problems.append(1) or solve(*parts))
    rng = np.random.default_rng(3)
    first, second, slowed = [], [], []
    for _ in range(30):
        J, v, want = rng.normal(size=(7, 6)), rng.normal(size=6), np.zeros(7)
        low, room = rng.uniform(-0.3, 0.1, 7), make_room(7, 6, 1)
        high = low + 0.2
        active, kept, starts = np.zeros(7, np.int8), np.zeros(2, np.int8), np.zeros((4, 9), np.int8)
        x, push, ask = np.empty(7), np.empty(8), rng.choice([0.02, 1.0]) * v
        step = rng.choice([0.0, 0.01])
        for again in (False, True):
            counted.clear()
            problems.clear()
            constrain(
                J, np.ones(6), ask, 0.0 * v, want, want, np.ones(7), low, high, np.empty((1, 7)), np.empty(1), 0, mode, 1.0, 0.0,
                0.0, room, x, active, kept, starts, push, step,
            )  # fmt: skip
            (second if again else first).append((len(problems), len(counted)))
            slowed.append(kept[-1] & SLOWED)
    ways = {problems for (problems, _), way in zip(second, slowed[1::2], strict=True) if way}
    assert ways == (
        set() if mode == SLOW else {2, 4}
    )  # the clock and what is beside the direction; with damping two more
    for (problems, iterations), way in zip(second, slowed[1::2], strict=True):
        assert not way or iterations == problems
    # Where the clock could not help, all is first tried in full, from what held at the end.
    assert np.mean([a[1] for a in first]) > 2.0 * np.mean([b[1] for b in second])


# ----------------------------------------------------------------------------------------------------------- two levels
def solved(C, d, want, low, high, A, b, state=None):
    n, count, r = len(want), len(b), len(d)
    s = make_levels(n, count + r + 1)
    s.V[levels.WANT, :n], s.V[levels.LOW, :n], s.V[levels.HIGH, :n] = want, low, high
    s.P[:count, :n], s.P[count : count + r, :n] = A, C
    s.S[levels.RHS, :count], s.S[levels.RHS, count : count + r] = b, d
    if state is not None:
        s.state[:n], s.state[n : n + count] = state[:n], state[n:]
    end = qp.solve_levels(s.P, s.W, s.L, s.U, s.V, s.S, s.state, s.order, n, count, r, False)
    first = np.append(s.V[levels.ONE, :n], s.S[levels.ROW_ONE, :count])
    second = np.append(s.V[levels.TWO, :n], s.S[levels.ROW_TWO, :count])
    return end, s.V[levels.Y, :n].copy(), first, second, np.append(s.state[:n], s.state[n : n + count]), s


def enumerated(C, d, want, low, high, A, b):
    """The best of all active sets, bounds and half-planes."""
    n, best, found = len(want), (np.inf, np.inf), None
    for sides in itertools.product((-1, 0, 1), repeat=n):
        free = np.array(sides) == 0
        x = np.where(free, 0.0, np.where(np.array(sides) < 0, low, high))
        if not np.isfinite(x).all():
            continue
        for size in range(min(len(b), int(free.sum())) + 1):
            for rows in itertools.combinations(range(len(b)), size):
                y = x.copy()
                B = A[list(rows)][:, free]
                if size and np.linalg.matrix_rank(B, 1e-9) < size:
                    continue
                part = np.linalg.pinv(B) @ (b[list(rows)] - A[list(rows)] @ x) if size else np.zeros(free.sum())
                Z = np.linalg.svd(B)[2][size:].T if size else np.eye(free.sum())
                y[free] = part + Z @ (Z.T @ (want[free] - part))
                if free.any() and Z.shape[1]:
                    y[free] += Z @ np.linalg.pinv(C[:, free] @ Z, 1e-10) @ (d - C @ y)
                if np.all(y >= low - 1e-11) and np.all(y <= high + 1e-11) and np.all(A @ y <= b + 1e-11):
                    one, two = ((C @ y - d) ** 2).sum(), ((y - want) ** 2).sum()
                    if one < best[0] - 1e-10 or (one < best[0] + 1e-10 and two < best[1]):
                        best, found = (one, two), y
    return best, found


@pytest.mark.parametrize("seed", range(16))
def test_two_objectives_inside_bounds_and_half_planes(seed):
    rng = np.random.default_rng(seed)
    for _ in range(3):
        n, rows, r = int(rng.integers(1, 4)), int(rng.integers(0, 3)), int(rng.integers(1, 4))
        C = rng.normal(size=(r, n))
        if r > 1 and rng.random() < 0.5:
            C[-1] = 2.0 * C[0]
        d, want = rng.normal(size=r) * rng.choice([0.1, 1.0, 4.0]), rng.normal(size=n)
        low, high = -rng.uniform(0.05, 1.0, n), rng.uniform(0.05, 1.0, n)
        if rng.random() < 0.2:
            low[0] = high[0]
        A = rng.normal(size=(rows, n))
        if rows == 2 and rng.random() < 0.3:
            A[1] = -A[0]
        A /= np.linalg.norm(A, axis=1)[:, None]
        b = A @ np.clip(0.3 * rng.normal(size=n), low, high) + rng.choice([0.0, 0.1], rows)
        best, y = enumerated(C, d, want, low, high, A, b)
        starts = [None, *(np.concatenate([rng.integers(-1, 2, n), rng.integers(0, 2, rows)]) for _ in range(3))]
        for start in starts:
            end, x, one, two, state, s = solved(C, d, want, low, high, A, b, start)
            assert end == qp.DONE
            np.testing.assert_allclose(x, y, atol=2e-8)
            G = np.vstack([np.eye(n), A]).T  # what holds pushes back: on the first objective, then on the second
            np.testing.assert_allclose(C.T @ (C @ x - d) + G @ one, 0.0, atol=1e-9)
            rest = x - want + G @ two
            null = np.eye(n) - np.linalg.pinv(C, 1e-9) @ C
            np.testing.assert_allclose(null @ rest, 0.0, atol=1e-8)
            fixed = np.append(low == high, np.zeros(rows, bool))
            sides = np.where(state > 0, 1.0, -1.0)
            for k in np.flatnonzero(~fixed):
                assert one[k] * sides[k] >= -1e-9 and (one[k] != 0.0 or two[k] * sides[k] >= -1e-9)
                assert state[k] != 0 or (one[k] == 0.0 and two[k] == 0.0)
            assert qp.unmet(s.S, rows, r) == (np.linalg.norm(C @ x - d) > 1e-9 * np.linalg.norm(d))


def test_signs_and_shares_of_multipliers():
    for one, two, side, want in (
        (0.5, -9.0, 1, 0.0), (-0.5, 9.0, 1, 1.5), (0.5, 0.0, -1, 1.5), (0.0, 0.3, 1, 0.0), (0.0, -0.3, 1, 0.3), (0.0, 3.0, -1, 1.0),
        (0.0, -0.9e-11, 1, 0.0), (0.0, -1.1e-11, 1, 1.1e-11), (0.0, 0.0, 1, 0.0),
    ):  # fmt: skip
        assert qp.wrong(one, two, side) == pytest.approx(want, rel=1e-12)
    assert qp.share(1.0, 2.0, 3.0, -9.0, 1) == (2.0, 0.0)
    assert qp.share(1.0, 2.0, -1.0, 4.0, 1) == (0.5, (2.0 + 0.5 * 2.0) / 2.0)
    assert qp.share(0.0, 2.0, 0.0, -2.0, 1) == (0.5, 0.0) and qp.share(0.0, -2.0, 0.0, 2.0, -1) == (0.5, 0.0)
    assert qp.share(-1.0, 0.0, -3.0, 0.0, 1)[0] == 0.0
    V, S = np.zeros((8, 2)), np.zeros((12, 1))
    V[levels.LOW], V[levels.HIGH], V[levels.Y] = -1.0, 1.0, [0.5, 1.4]
    P, state = np.array([[1.0, 1.0]]), np.zeros(3, np.int8)
    S[levels.RHS] = 1.8
    assert qp.violated(P, V, S, state, 2, 1) == (1, 1)
    V[levels.Y] = [-1.4, 0.5]
    assert qp.violated(P, V, S, state, 2, 1) == (0, -1)
    V[levels.Y] = [0.95, 0.95]
    assert qp.violated(P, V, S, state, 2, 1) == (2, 1)
    state[2] = 1
    assert qp.violated(P, V, S, state, 2, 1) == (levels.NONE, 0)
    V[levels.HIGH], V[levels.Y] = [1e9, 0.0], [1e4, 3e-12]
    assert qp.violated(P, V, S, state, 2, 1) == (levels.NONE, 0), "the rounding of a large unknown"
    V[levels.Y, 1] = 3e-8
    assert qp.violated(P, V, S, state, 2, 1) == (1, 1)
    V[levels.Y] = [0.5, 3e-12]
    assert qp.violated(P, V, S, state, 2, 1) == (1, 1)
