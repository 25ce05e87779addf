"""The search for the closest answer, and the starts of several tips."""

import functools
from types import SimpleNamespace

import numpy as np
import random_arms as arms

from ik_toolkit.kernel import search
from ik_toolkit.kernel import starts as tree_starts
from ik_toolkit.kernel.checks import CODE
from ik_toolkit.kernel.counted_error import KIND
from ik_toolkit.kernel.packed_model import join
from ik_toolkit.kernel.records import AT, SIZE, Orders, Task
from ik_toolkit.kernel.starts import rnd
from ik_toolkit.solvers.registry import find_row

BASIC = Orders(**{
    **dict.fromkeys(Orders._fields, 0.0), "tol_p": 1e-8, "tol_r": 1e-8, "iterations": 50.0, "attempts": 20.0, "c": 3.0, "rho": 0.9,
    "c_free": np.inf, "rho_free": 0.95, "patience": np.inf, "evaluations": 1e6, "limits": 1.0, "seed": 3.0,
})  # fmt: skip


def found(T, chain, o, q0=None, rule="lm", n_history=0):
    """A row of the search of a rule."""
    cls = find_row(rule).load()
    n = chain.n
    parameters = list(cls()) if isinstance(cls(), tuple) else []
    pack = np.array([*o, *Task(float(KIND.pose)), *np.ones(n), *parameters])
    out = np.full(len(T) * (SIZE.answer + n) + n_history * (3 + n), np.nan)
    q0 = np.zeros((1, n)) if q0 is None else q0
    search.entry(cls)(join(chain.rows, chain.ends, chain.seeds, chain.features), T, q0, out, pack)
    rows = len(T) * (SIZE.answer + n)
    return out[:rows].reshape(len(T), -1), out[rows:].reshape(n_history, 3 + n)


@functools.cache
def case():
    """An arm, its rows, base and tip, three of its poses and starts near them."""
    rng = np.random.default_rng(0)
    chain, rows, base, tip = arms.arm(rng, "tttsttt", wide=True)
    Q = 0.9 * rng.uniform(chain.lower, chain.upper, (3, chain.n))
    T = np.array([arms.fk(rows, base, tip, q)[0] for q in Q])
    return chain, rows, base, tip, T, Q + 0.05 * rng.normal(size=Q.shape)


def test_the_closest_of_several_answers():
    chain, rows, base, tip, T, near = case()
    closest, _ = found(T[:1], chain, BASIC._replace(closest=3.0), near[:1])
    alone, _ = found(T[:1], chain, BASIC)
    gap = [np.abs(o[0, SIZE.answer :] - near[0]).max() for o in (closest, alone)]
    assert closest[0, AT.status] == CODE.converged and gap[0] <= gap[1] + 1e-9
    assert closest[0, AT.restarts] > alone[0, AT.restarts] and closest[0, AT.attempt] <= closest[0, AT.restarts]
    np.testing.assert_allclose(arms.fk(rows, base, tip, closest[0, SIZE.answer :])[0], T[0], atol=3e-8)


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
        ((KIND.pose, KIND.pose), (-1, -1), [[1, 1, 0, 0], [0, 1, 1, 0]], [[0, 0, 1, -1], [1, 2, 1, 0]]),
        ((KIND.free, KIND.pose), (-1, -1), [[0, 0, 0, 0], [0, 1, 1, 0]], [[-1, 1, 1, -1], [0, 1, 1, 0]]),
        ((KIND.free, KIND.pose), (-1, 0), [[0, 0, 0, 0], [1, 1, 1, 0]], [[0, 1, 1, -1], [1, 2, 1, 0]]),
        ((KIND.pose, KIND.free), (-1, -1), [[1, 1, 0, 0], [0, 0, 0, 0]], [[0, 0, -1, -1], [1, 1, 0, 0]]),
        ((KIND.pose, KIND.pose), (-1, 0), [[1, 1, 0, 0], [1, 1, 1, 0]], [[0, 0, 1, -1], [1, 2, 1, 0]]),
    ):
        *_, m, c = starts(kinds, others)
        np.testing.assert_array_equal(m, moves)
        np.testing.assert_array_equal(c, choosers)


def test_starts_of_several_tips():
    ends, tasks, _, choosers = starts((KIND.pose, KIND.free))
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
    tree_starts.begin_each_tip(p, table, 0, q)
    np.testing.assert_array_equal(q, [seeds[5, 0], -1.0, seeds[5, 2], -1.0])
    tree_starts.begin_each_tip(p, table, 1, q)
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
    p.tasks = np.array([Task(float(KIND.free)), Task(1.0, other=0.0)])
    p.links = np.zeros((F, 24))
    p.links[1] = [*np.eye(3).ravel(), 0.1, 0.2, 0.3, *np.eye(3).ravel(), 1.0, 2.0, 3.0]
    tree_starts.rank_groups(p, table)
    assert placed == [0] and np.all(p.goals[0] == 0.25)
    np.testing.assert_allclose(p.goals[1, 9:12], np.array([1.0, 2.0, 3.0]) + 0.25 + 0.25 * 0.6)
    placed.clear()
    p.tasks = np.array([Task(1.0), Task(float(KIND.free), other=0.0)])  # carried by the other, so its goal is known
    tree_starts.rank_groups(p, table)
    assert not placed
