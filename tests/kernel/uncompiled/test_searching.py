"""The starts of several tips."""

from types import SimpleNamespace

import numpy as np

from ik_toolkit.kernel import starts as tree_starts
from ik_toolkit.kernel.counted_error import KIND
from ik_toolkit.kernel.records import Task
from ik_toolkit.kernel.starts import rnd


def starts(kinds, others=(-1.0, -1.0), moves=((1, 1, 0, 0), (0, 1, 1, 0))):
    n, F = 4, 2
    ends = np.zeros((F, 24 + 8 * n + 8))
    ends[:, -n:] = moves
    ends[:, 24 + 4 * n : 24 + 5 * n], ends[:, 24 + 5 * n : 24 + 6 * n] = 10.0, 2.0
    tasks = np.array([Task(float(kind), other=other) for kind, other in zip(kinds, others, strict=True)])
    made = np.full((F, n), 9.0), np.full((2, n), 9.0)
    tree_starts.choose_moves(ends, tasks, n, np.empty(F), *made)
    return ends, tasks, *made


def test_starts_of_several_tips():
    ends, tasks, _, choosers = starts((KIND.pose, KIND.free))
    choosers[:] = [[0, 1, 0, -1], [1, 2, 2, 0]]
    seeds = np.arange(80.0).reshape(20, 4)
    choice, state = np.array([[3, 4], [5, 6]]), np.array([7], np.uint64)
    table = SimpleNamespace(seeds=seeds, choice=choice, best=np.array([1, 0]), state=state)
    desk = SimpleNamespace(start=np.full(4, -1.0), q=np.zeros(4))
    p = SimpleNamespace(choosers=choosers, tasks=tasks, ends=ends, desk=desk, arrived=lambda f: False)
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
