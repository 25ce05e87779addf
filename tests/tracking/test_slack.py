"""Errors that may be as large as their slack: joints stay calm at its border, out of reach and within."""

import numpy as np
import pytest
from references import Q0
from robots import have_data

import ik_toolkit as ik
from ik_toolkit.tracking.tracker import Tracker


def turns_back(Q, speed, h=0.01):
    """Most changes of sign of a joint's speed in 100 ms at Q (N, n), as far as it is above 5 % of its limit (n,)."""
    rates, most = np.diff(Q, axis=0) / h, 0
    for v, fast in zip(rates.T, speed, strict=True):
        places = np.flatnonzero(np.abs(v) > 0.05 * fast)
        flips = places[1:][np.diff(np.sign(v[places])) != 0.0]
        most = max([most, *(int(np.sum((flips >= k) & (flips < k + 10))) for k in flips)])
    return most


@pytest.mark.parametrize("method", ["cv", "aad"])
@pytest.mark.parametrize("mode", ["direct", "leave"])
def test_joints_do_not_chatter_beyond_reach(panda, method, mode):
    """All joints turned back at full speed from sample to sample, and the tip stayed 0.3 m further away than it has to."""
    tracker = Tracker(panda, method, q0=Q0, on_limit=mode, slack=[0.03, 0.03, 0.03, 0.1, 0.1, 0.1])
    start, Q, errors = panda.fk(Q0).homogeneous, [Q0], []
    for k in range(300):
        target = start.copy()
        target[:3, 3] *= 1.0 + np.sin(np.pi * min(0.005 * (k + 1), 1.0)) ** 2
        step = tracker.update(target, 0.01)
        Q.append(step.q)
        errors.append(step.position_error)
    assert turns_back(np.array(Q), panda.velocity_limits) <= 3
    assert max(errors) < 0.7 and errors[-1] < 1e-9


@pytest.mark.skipif(not have_data(), reason="example-robot-data is not installed (extra 'robots')")
@pytest.mark.parametrize("slack", [[0.03, 0.03, 0.03, 0.1, 0.1, 0.1], [0.03, 0, 0.03, 0.1, np.inf, np.inf]])
def test_joints_do_not_chatter_along_the_border(slack):
    """Closed like any other error from its border on, it is left and met again in turns."""
    tree = ik.Tree.load("baxter")
    rng = np.random.default_rng(1)
    low, high = np.maximum(tree.lower, -3.0), np.minimum(tree.upper, 3.0)
    q0 = low + (high - low) * rng.uniform(0.3, 0.7, tree.n)
    pace = rng.uniform(1.0, 2.5, tree.n)
    way = 0.3 * tree.velocity_limits / pace * rng.choice([-1, 1], tree.n)
    way = np.clip(way, 0.45 * (low - q0), 0.45 * (high - q0))
    tracker, Q, most = Tracker(tree, "cv", q0=q0, slack=slack), [q0], 0.0
    for k in range(300):
        poses = tree.fk(q0 + way * (1.0 - np.cos(0.01 * (k + 1) * pace)))
        step = tracker.update(poses, 0.01)
        Q.append(step.q)
        most = max(most, step.position_error, step.orientation_error)
    assert turns_back(np.array(Q), tree.velocity_limits) <= 3 and most < 5e-3
