"""The program over tracks: the best of all paths, and states looked up by a joint that separates them."""

import numpy as np
import pytest

from ik_toolkit.paths import shortest_path
from ik_toolkit.paths.shortest_path import LEAP, Program

TAU = 2.0 * np.pi


def enumerated(Q, most, endless):
    """Count and cost of the best path through states Q (N, K, n), every one of them whole, from all pairs of each layer."""
    counts, costs = np.zeros(Q.shape[1], dtype=int), np.zeros(Q.shape[1])
    for before, layer in zip(Q[:-1].astype(float), Q[1:].astype(float), strict=True):
        d = layer[None] - before[:, None]
        d = np.abs(d - endless * TAU * np.rint(d / TAU))
        price = (d + d * d / most).sum(axis=2)
        near = (d <= most).all(axis=2)
        np.fill_diagonal(price, np.where(near.diagonal(), price.diagonal(), np.inf))
        best = np.lexsort((costs, counts))[0]
        again = np.where(near, counts[:, None], counts[best] + 1)
        paid = np.where(near, costs[:, None] + price, costs[best] + LEAP)
        chosen = np.lexsort((paid, again), axis=0)[0]
        columns = np.arange(Q.shape[1])
        counts, costs = again[chosen, columns], paid[chosen, columns]
    return min(zip(counts.tolist(), costs.tolist(), strict=True))


def states(rng, layers=12, count=60):
    """Random tracks (layers, count, 3) that stay near their neighbours: joint 1 is endless and crosses half a turn."""
    start = np.column_stack(
        [rng.uniform(-0.02, 0.02, count), rng.uniform(-9.0, 9.0, count), rng.uniform(0, 0.3, count)]
    )
    walk = rng.uniform(-0.1, 0.1, (layers, count, 3)) * [0.1, 1.0, 0.5]
    return (start + np.cumsum(walk, axis=0)).astype(np.float32)


def test_best_of_all_paths_with_states_looked_up_on_an_endless_joint():
    endless, most = np.array([0.0, 1.0, 0.0]), np.array([0.1, 0.15, 0.1])
    for seed in range(20):
        Q = states(np.random.default_rng(seed))
        program = Program(Q, np.tile([0, len(Q) - 1], (Q.shape[1], 1)), most, endless > 0)
        assert program.axis == 1, "the only joint in which the states differ widely"
        program.run()
        k, count = program.best(len(Q) - 1)
        known = enumerated(Q, most, endless)
        # states are in single precision
        assert (count, program.costs[-1, k]) == (known[0], pytest.approx(known[1], rel=1e-5))


def test_contact_is_looked_for_beside_the_path_only_where_it_is_met():
    rng = np.random.default_rng(3)
    Q = states(rng, layers=40)
    tests = []

    def asked(q, touching):
        tests.append(q)
        return touching(q)

    def searched(touching):
        tests.clear()
        program = Program(Q, np.tile([0, len(Q) - 1], (Q.shape[1], 1)), np.full(3, 0.2), np.array([False, True, False]))
        tester = shortest_path.Tester(lambda q: asked(q, touching), np.ones(3), 10_000)
        tracks, _ = shortest_path.free_path(program, tester.of(program))
        return Q[np.arange(len(Q)), tracks]

    free = searched(lambda q: False)
    assert len(tests) == len(Q), "the states of the path and no others"
    middle = free[20, 1]
    around = searched(lambda q: abs(q[1] - middle) < 0.3)
    assert (np.abs(around[:, 1] - middle) >= 0.3).all()
    assert len(tests) > len(Q)
    assert len({q.tobytes() for q in tests}) == len(tests), "no state is tested twice"
