"""The search around a rule, starts of several tips, records and scratch."""

import functools
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import pytest
import random_arms as arms

from ik_toolkit.kernel import checks, records, search, tree_starts, view
from ik_toolkit.kernel.checks import CONVERGED, ITERATION_LIMIT, NOT_FINITE, STALLED
from ik_toolkit.kernel.joined import join, part, scratch
from ik_toolkit.kernel.records import ANSWER, AT, Ends, Orders, Task
from ik_toolkit.kernel.search import GOING, LOOK, STILL, Spent
from ik_toolkit.kernel.seeds import BEST, rnd
from ik_toolkit.kernel.task import FREE, POSE
from ik_toolkit.solvers.registry import find_row

BASIC = Orders(**{
    **dict.fromkeys(Orders._fields, 0.0), "tol_p": 1e-8, "tol_r": 1e-8, "iterations": 50.0, "attempts": 20.0, "c": 3.0, "rho": 0.9,
    "c_free": np.inf, "rho_free": 0.95, "patience": np.inf, "evaluations": 1e6, "limits": 1.0, "seed": 3.0,
})  # fmt: skip


class Table(NamedTuple):
    """A record of an array."""

    flat: records.Array


def test_records_and_scratch():
    row = np.arange(40.0)
    o = records.read(Orders, row, 2)
    assert isinstance(o, Orders) and o.tol_p == 2.0 and o[-1] == 1.0 + len(o)
    assert records.read(Table, row, 3).flat[0] == 3.0
    out = np.zeros(8)
    records.write(out, 2, (5.0, 6.0))
    np.testing.assert_array_equal(out, [0, 0, 5, 6, 0, 0, 0, 0])
    records.copy(np.array([1.0, 2.0]), out)
    np.testing.assert_array_equal(out[:3], [1, 2, 5])
    assert records.HEAD == len(Orders._fields) and records.WEIGHTS == records.HEAD + records.TASK
    block = np.zeros(100)
    a, b = view.cut(block, np.float64, (3, (2, 4)))
    (c,) = view.cut(block, np.int8, (5,))
    a[:], b[:], c[:] = 1.0, 2.0, 3
    assert a.shape == (3,) and b.shape == (2, 4) and np.all(a == 1.0) and np.all(b == 2.0)
    with pytest.raises(MemoryError):
        view.cut(block, np.float64, (100,))
    assert view.fold(row, float, 3, 4)[1, 0] == 4.0 and view.flat(row.reshape(4, 10)).shape == (40,)
    assert view.fold(row, np.int32, 3, 4).shape == (3, 4)
    for n, m, L, N in ((1, 6, 1, 256), (7, 6, 9, 256), (20, 36, 40, 2048)):
        assert view.space(n, m, L, N) > n * m + m * m + 16 * m + 16 * L + N


def test_arrays_of_a_robot_in_one():
    for count, shape in ((1, ()), (3, (3,))):
        rng = np.random.default_rng(count)
        rows, ends, seeds = rng.normal(size=(5, 10)), rng.normal(size=(*shape, 9)), rng.normal(size=(16, 4))
        features = rng.normal(size=(*shape, 13, 16 + 16)).astype(np.float32)
        parts = part(join(rows, ends, seeds, features))
        np.testing.assert_array_equal(parts.rows, rows)
        np.testing.assert_array_equal(search.by_tip(parts.ends, np.empty((2, *shape, 4, 4)), count), ends)
        np.testing.assert_array_equal(parts.seeds, seeds)
        np.testing.assert_array_equal(parts.features, features.reshape(13 * count, -1))
        assert scratch(join(rows, ends, seeds, features)) > view.space(4, 6 * count, 5, 16) + 9 * count


def test_what_an_evaluation_means():
    o = BASIC._replace(evaluations=10.0)
    for good, ee, k, most, count, c, want in (
        (True, 9.0, 99, 5, 99, 0.0, CONVERGED), (False, np.nan, 0, 5, 1, np.inf, NOT_FINITE),
        (False, 1e300, 0, 5, 1, np.inf, NOT_FINITE),
        (False, 0.9e300, 0, 5, 1, np.inf, GOING), (False, 1.0, 5, 5, 1, np.inf, ITERATION_LIMIT),
        (False, 1.0, 4, 5, 9, np.inf, GOING),
        (False, 1.0, 4, 5, 10, np.inf, ITERATION_LIMIT), (False, 1.0, 0, 5, 1, 0.9, STALLED), (False, 1.0, 0, 5, 1, 1.0, GOING),
        (False, 1e-9, 0, 5, 1, 0.0, GOING), (False, 1.1e-9, 0, 5, 1, 0.0, STALLED),
    ):  # fmt: skip
        assert search.verdict(SimpleNamespace(good=good, ee=ee), k, most, count, c, o) == want


def test_how_attempts_begin():
    calls = []
    p = SimpleNamespace(
        desk=SimpleNamespace(q=np.zeros(2)), rank=lambda t: calls.append("rank"), begin=lambda t, k, q: calls.append(("begin", k)),
        draw=lambda t, k, q: calls.append(("draw", k)),
    )  # fmt: skip
    o = BASIC._replace(patience=12.0)
    assert search.start_attempt(p, o, None, -1, np.array([3.0, 4.0])) == (50.0, np.inf, 0.95)
    np.testing.assert_array_equal(p.desk.q, [3.0, 4.0])
    assert search.start_attempt(p, o, None, 0, np.zeros(2)) == (50.0, 3.0, 0.9) and calls == ["rank", ("begin", 0)]
    assert search.start_attempt(p, o, None, BEST - 1, np.zeros(2)) == (50.0, 3.0, 0.9) and calls[-1] == ("begin", 7)
    assert search.start_attempt(p, o, None, BEST, np.zeros(2)) == (50.0, np.inf, 0.95) and calls[-1] == ("draw", 8)
    assert search.start_attempt(p, o, None, 11, np.zeros(2)) == (50.0, np.inf, 0.95)
    assert search.start_attempt(p, o, None, 12, np.zeros(2)) == (100.0, np.inf, 0.6)
    assert calls.count("rank") == 1


class Line:
    """A problem on a line: the error is the distance of q[0] from a goal; and a rule whose steps are given."""

    def __init__(self, goal, steps, n=2):
        self.goal, self.steps, self.kept, self.jacobians = goal, list(steps), {}, 0
        self.desk = SimpleNamespace(
            q=np.zeros(n), dq=np.zeros(n), w=np.zeros(n), spent=np.zeros(2), errors=np.zeros((3, 1, 2)),
            J=np.ones((n, 1)), x=np.ones(3),
        )  # fmt: skip

    def evaluate(self, q):
        return SimpleNamespace(ee=(self.goal - q[0]) ** 2, good=abs(self.goal - q[0]) < 1e-6, at=q[0])

    def jacobian(self, e):
        self.jacobians += 1

    def keep(self, e, place):
        self.kept[place] = e.at

    def left(self, place):
        return abs(self.goal - self.kept[place]), 0.0

    def slope(self, e, i):
        return self.goal - self.desk.q[0] if i == 0 else 0.0

    def step(self, p, e):
        code, *move = self.steps.pop(0)
        self.desk.dq[:] = move
        self.seen = self.desk.spent[0], self.desk.w.copy()
        return code


def ends_of(lower, upper, turns=(0.0, 0.0), unit=(1.0, 1.0)):
    return Ends(np.array([*np.zeros(24), *lower, *upper, *turns, *unit, *np.zeros(6), 1.0, *np.zeros(6)], float), 2)


def attempt(
    line, o=BASIC, most=9.0, c=np.inf, rho=1.0, near=None, needs=True, rows=0, spent=Spent(5, 2, 0), least=np.inf
):
    near = ends_of([-9.0, -9.0], [9.0, 9.0]) if near is None else near
    best, history = np.full(2, np.nan), np.full((rows, 4), np.nan)
    found = search.make_attempt(
        line, line, o, near, np.array([1.0, 2.0]), most, c, rho, spent, least, best, needs, history
    )
    return *found, best, history


def test_one_attempt():
    line = Line(1.0, [(0, 0.5, 1.0), (0, 0.25, 0.0), (0, 0.25, 0.0)])
    status, e, least, spent, best, history = attempt(line, rows=3)
    assert status == CONVERGED and e.good and least == 0.0 and spent == (9, 5, 3) and line.jacobians == 3
    np.testing.assert_allclose(best, [1.0, 1.0])
    np.testing.assert_allclose(history, [[1.0, 0, 0, 0], [0.5, 0, 0.5, 1.0], [0.25, 0, 0.75, 1.0]])
    assert line.seen[0] == 8.0 and list(line.seen[1]) == [1.0, 2.0] and line.kept[0] == 1.0
    line = Line(1.0, [(0, 0.5, 0.0), (0, -0.7, 0.0), (0, 0.1, 0.0)])
    status, e, least, spent, best, _ = attempt(line, most=2.0, needs=False)
    assert status == ITERATION_LIMIT and least == 0.25 and best[0] == 0.5 and spent == (8, 4, 0) and line.jacobians == 0
    status, _, least, _, best, _ = attempt(Line(1.0, [(0, 0.5, 0.0)]), most=1.0, least=0.2)
    assert least == 0.2 and np.isnan(best).all()
    status, *_, spent, best, _ = attempt(Line(1.0, [(0, 0.1, 0.0)] * 9), c=1.5, rho=0.5)
    assert status == STALLED and spent.steps == 2 + 1  # 0.81 > 1.5 / 2
    assert attempt(Line(1.0, [(0, 0.0, 0.0)]))[0] == STILL
    assert attempt(Line(1.0, [(-2, 0.0, 0.0)] * 9), most=3.0)[0] == ITERATION_LIMIT
    assert attempt(Line(1.0, [(-1, 0.5, 0.0)]))[0] == checks.SINGULAR
    assert attempt(Line(1.0, [(0, np.nan, 0.5)]))[0] == NOT_FINITE
    assert attempt(Line(1.0, [(0, 0.5, np.nan)]))[0] == NOT_FINITE
    free = BASIC._replace(limits=0.0)
    assert attempt(Line(1.0, [(0, 1.1e6, 0.0)]), free)[0] == NOT_FINITE
    assert attempt(Line(1.0, [(0, 0.9e6, 0.0)]), free, most=1.0)[0] == ITERATION_LIMIT
    near = ends_of([-9.0, -9.0], [0.5, 9.0])
    status, e, *_ = attempt(Line(1.0, [(0, 0.7, 0.0), (0, 0.2, 0.0)]), near=near)
    assert status == STILL and e.at == 0.5
    line = Line(1.0, [(0, 0.7, 0.0), (0, 0.2, 0.3), (0, 0.2, -0.1), (0, 0.0, 0.0), (0, 0.0, 0.0)])
    status, *_ = attempt(line, BASIC._replace(hold=1.0), near=near)  # held, and the step is made again
    assert status == STILL and line.desk.q[1] == pytest.approx(-0.1)
    line = Line(1.0, [(0, 0.7, 0.0), (0, 0.2, 0.3), (0, 0.0, 0.0)])
    attempt(line, BASIC._replace(hold=1.0, limits=0.0), near=near, most=1.0)
    assert line.desk.q[0] == 0.7
    status, e, least, spent, _, history = attempt(Line(1.0, []), most=LOOK, rows=2, needs=False)
    assert status == GOING and least == np.inf and spent == (6, 2, 0) and np.isnan(history).all()


def found(T, chain, o, q0=None, rule="lm", n_history=0):
    """A row of the search of a rule."""
    cls = find_row(rule).load()
    n = chain.n
    parameters = list(cls()) if isinstance(cls(), tuple) else []
    pack = np.array([*o, *Task(float(POSE)), *np.ones(n), *parameters])
    out = np.full(len(T) * (ANSWER + n) + n_history * (2 + n), np.nan)
    q0 = np.zeros((1, n)) if q0 is None else q0
    search.entry(cls)(join(chain.rows, chain.ends, chain.seeds, chain.features), T, q0, out, pack)
    rows = len(T) * (ANSWER + n)
    return out[:rows].reshape(len(T), -1), out[rows:].reshape(n_history, 2 + n)


@functools.cache
def case():
    """An arm, its rows, base and tip, three of its poses and starts near them."""
    rng = np.random.default_rng(0)
    chain, rows, base, tip = arms.arm(rng, "tttsttt", wide=True)
    Q = 0.9 * rng.uniform(chain.lower, chain.upper, (3, chain.n))
    T = np.array([arms.fk(rows, base, tip, q)[0] for q in Q])
    return chain, rows, base, tip, T, Q + 0.05 * rng.normal(size=Q.shape)


def test_searches_from_the_table():
    chain, rows, base, tip, T, _ = case()
    out, _ = found(T, chain, BASIC)
    for row, pose in zip(out, T, strict=True):
        q = row[ANSWER:]
        assert row[AT.status] == CONVERGED and np.all((chain.lower <= q) & (q <= chain.upper))
        np.testing.assert_allclose(arms.fk(rows, base, tip, q)[0], pose, atol=3e-8)
        assert row[AT.position] < 1e-8 and row[AT.rotation] < 1e-8 and row[AT.held] == -1.0
        assert row[AT.excess] == 0.0 and row[AT.attempt] == row[AT.restarts]
        assert row[AT.evaluations] >= row[AT.iterations]


def test_a_search_from_a_start_and_its_history():
    chain, rows, base, tip, T, near = case()
    out, history = found(T[:1], chain, BASIC._replace(given=1.0), near[:1], n_history=30)
    row = out[0]
    assert row[AT.restarts] == 0.0 and row[AT.iterations] < 8
    assert row[AT.history] == row[AT.evaluations] == row[AT.iterations] + 1
    np.testing.assert_allclose(history[0, 2:], near[0], rtol=1e-14)
    np.testing.assert_allclose(history[int(row[AT.history]) - 1, 2:], row[ANSWER:], atol=1e-14)
    assert np.isnan(history[int(row[AT.history]) :]).all()
    first = arms.fk(rows, base, tip, near[0])[0]
    assert history[0, 0] == pytest.approx(np.linalg.norm(first[:3, 3] - T[0, :3, 3]))


def test_targets_and_starts_that_are_refused():
    chain, rows, base, tip, T, near = case()
    bad = T.copy()
    bad[1, 0, 0] = np.nan
    out, _ = found(bad, chain, BASIC._replace(given=1.0), np.array([near[0], near[1], near[2] + 99.0]))
    assert out[:, AT.status].tolist() == [CONVERGED, checks.BAD_TARGET, checks.BAD_START]
    out, _ = found(T[:1], chain, BASIC._replace(evaluations=4.0))
    assert out[0, AT.status] == ITERATION_LIMIT and out[0, AT.evaluations] == 4.0


def test_a_search_for_what_is_out_of_reach():
    chain, *_, T, _ = case()
    far = T[:1].copy()
    far[0, :3, 3] = 3.0 * chain.reach
    out, _ = found(far, chain, BASIC._replace(iterations=20.0))
    assert out[0, AT.status] == checks.UNREACHABLE and out[0, AT.restarts] == 2.0 and out[0, AT.excess] > chain.reach


def test_the_closest_of_several_answers():
    chain, rows, base, tip, T, near = case()
    closest, _ = found(T[:1], chain, BASIC._replace(closest=3.0), near[:1])
    alone, _ = found(T[:1], chain, BASIC)
    gap = [np.abs(o[0, ANSWER:] - near[0]).max() for o in (closest, alone)]
    assert closest[0, AT.status] == CONVERGED and gap[0] <= gap[1] + 1e-9
    assert closest[0, AT.restarts] > alone[0, AT.restarts] and closest[0, AT.attempt] <= closest[0, AT.restarts]
    np.testing.assert_allclose(arms.fk(rows, base, tip, closest[0, ANSWER:])[0], T[0], atol=3e-8)


def test_a_search_in_the_neighbourhood_of_its_start():
    chain, *_, T, near = case()
    tight = BASIC._replace(given=1.0, follow=0.01, follow_slide=0.001, attempts=1.0)
    out, _ = found(T[:1], chain, tight, near[:1] - 0.3 * np.sign(near[:1]))
    assert out[0, AT.status] == checks.TOO_FAR and out[0, AT.held] >= 0.0
    out, _ = found(T[:1], chain, tight._replace(follow=0.5, follow_slide=0.5), near[:1])
    assert out[0, AT.status] == CONVERGED and np.abs(out[0, ANSWER:] - near[0]).max() <= 0.5


# -------------------------------------------------------------------------------------------------------- several tips
def starts(kinds, others=(-1.0, -1.0), moves=((1, 1, 0, 0), (0, 1, 1, 0))):
    n, F = 4, 2
    ends = np.zeros((F, 24 + 8 * n + 8))
    ends[:, -n:] = moves
    ends[:, 24 + 4 * n : 24 + 5 * n], ends[:, 24 + 5 * n : 24 + 6 * n] = 10.0, 2.0
    tasks = np.array([Task(float(kind), other=other) for kind, other in zip(kinds, others, strict=True)])
    made = np.full((F, n), 9.0), np.full((2, n), 9.0)
    tree_starts.choose_moves(ends, tasks, n, np.empty(F), *made)
    return ends, tasks, *made


def test_which_tip_chooses_a_coordinate():
    for kinds, others, moves, choosers in (
        ((POSE, POSE), (-1, -1), [[1, 1, 0, 0], [0, 1, 1, 0]], [[0, 0, 1, -1], [1, 2, 1, 0]]),
        ((FREE, POSE), (-1, -1), [[0, 0, 0, 0], [0, 1, 1, 0]], [[-1, 1, 1, -1], [0, 1, 1, 0]]),
        ((FREE, POSE), (-1, 0), [[0, 0, 0, 0], [1, 1, 1, 0]], [[0, 1, 1, -1], [1, 2, 1, 0]]),
        ((POSE, FREE), (-1, -1), [[1, 1, 0, 0], [0, 0, 0, 0]], [[0, 0, -1, -1], [1, 1, 0, 0]]),
        ((POSE, POSE), (-1, 0), [[1, 1, 0, 0], [1, 1, 1, 0]], [[0, 0, 1, -1], [1, 2, 1, 0]]),
    ):
        *_, m, c = starts(kinds, others)
        np.testing.assert_array_equal(m, moves)
        np.testing.assert_array_equal(c, choosers)


def test_starts_of_several_tips():
    ends, tasks, _, choosers = starts((POSE, FREE))
    choosers[:] = [[0, 1, 0, -1], [1, 2, 2, 0]]
    seeds = np.arange(80.0).reshape(20, 4)
    table = SimpleNamespace(
        seeds=seeds, choice=np.array([[3, 4], [5, 6]]), best=np.array([1, 0]), state=np.array([7], np.uint64)
    )
    p = SimpleNamespace(
        choosers=choosers,
        tasks=tasks,
        ends=ends,
        desk=SimpleNamespace(start=np.full(4, -1.0), q=np.zeros(4)),
        arrived=lambda f: False,
    )
    q = np.zeros(4)
    tree_starts.begin_by_tips(p, table, 0, q)
    np.testing.assert_array_equal(q, [seeds[5, 0], -1.0, seeds[5, 2], -1.0])
    tree_starts.begin_by_tips(p, table, 1, q)
    np.testing.assert_array_equal(q, [seeds[3, 0], -1.0, seeds[3, 2], -1.0])
    for k, near, kept in ((1, (), []), (1, (0,), [0, 1, 2]), (4, (0,), []), (3, (1,), [1, 2])):
        p.arrived = lambda f, near=near: f in near
        table.state[0], q[:] = 7, 5.0
        tree_starts.draw_some(p, table, k, q)
        again = np.array([7], np.uint64)
        drawn = np.array([10.0 + 2.0 * rnd(again) for _ in range(4)])
        want = np.where(np.isin(np.arange(4), kept), 5.0, drawn)
        want[3] = -1.0
        np.testing.assert_array_equal(q, want)


def test_groups_of_starts_in_order():
    rng = np.random.default_rng(2)
    count, F = 32, 2
    features = np.zeros((F, 13, count + 16), np.float32)
    points = rng.normal(size=(F, count, 3))
    features[:, :3, :count], features[:, 12, :count] = -2.0 * points.transpose(0, 2, 1), (points**2).sum(-1)
    goals = rng.normal(size=(F, 15))
    score = ((points - goals[:, None, 9:12]) ** 2).sum(-1) - (goals[:, 9:12] ** 2).sum(-1)[:, None]
    table = SimpleNamespace(
        features=features.reshape(13 * F, -1), score=np.empty(count, np.float32), val=np.empty(8, np.float32),
        best=np.empty(8, np.int64), choice=np.empty((8, F), np.int64), total=np.empty(8),
    )  # fmt: skip
    tasks = np.array([Task(1.0), Task(1.0)])
    p = SimpleNamespace(
        tasks=tasks,
        goals=goals.copy(),
        poses=np.zeros((F, 15)),
        links=np.zeros((F, 24)),
        desk=SimpleNamespace(start=None),
    )
    tree_starts.rank_groups(p, table)
    totals = np.zeros(8)
    for g in range(8):
        for f in range(F):
            k = g + 8 * int(np.argmin(score[f, g::8]))
            assert table.choice[g, f] == k
            totals[g] += score[f, k]
    np.testing.assert_array_equal(table.best, np.argsort(totals))
    placed = []

    def place(f, q):
        placed.append(f)
        p.poses[f] = 0.25

    p.place = place
    p.tasks = np.array([Task(float(FREE)), Task(1.0, other=0.0)])
    p.links = np.zeros((F, 24))
    p.links[1] = [*np.eye(3).ravel(), 0.1, 0.2, 0.3, *np.eye(3).ravel(), 1.0, 2.0, 3.0]
    tree_starts.rank_groups(p, table)
    assert placed == [0] and np.all(p.goals[0] == 0.25)
    np.testing.assert_allclose(p.goals[1, 9:12], np.array([1.0, 2.0, 3.0]) + 0.25 + 0.25 * 0.6)
    placed.clear()
    p.tasks = np.array([Task(1.0), Task(float(FREE), other=0.0)])  # carried by the other, so its goal is known
    tree_starts.rank_groups(p, table)
    assert not placed
