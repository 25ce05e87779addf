"""Scratch of a tracker."""

from typing import NamedTuple

import numpy as np

from .jit import compiled, inline, spliced
from .records import Array
from .view import LINE, cut


@compiled
class Bench(NamedTuple):
    """Scratch of a tracker for n joints, a task of m, F tips."""

    why_low: Array  # of the box, see box.py
    why_top: Array
    Ts: Array  # (F, 4, 4) reference
    Vs: Array  # (m,)
    As: Array  # (m,)
    e: Array  # (m,) error now
    ahead: Array  # (m,) and to where the target will be
    f: Array  # (m,) twist of the target, as it counts, at the clock's rate
    pace: Array  # (m,) ... and in time
    a: Array  # (m,) acceleration
    ask: Array  # (m,) rate of the task that does not scale with the clock
    bias: Array  # (m,)
    weight: Array  # (m,) of the errors; ones where they are weighed already
    t: Array  # (m,)
    y: Array  # (max(n, m),)
    G: Array  # (max(n, m), max(n, m))
    H: Array  # (max(n, m), max(n, m)) damped
    J: Array  # (n, m) of what is tracked
    W: Array  # (m, n) modes, see modes.py: sigma_k v_k by rows ...
    V: Array  # (n, m) ... v_k of the lost ones by columns ...
    U: Array  # (m, m) ... and u_k by rows
    sv: Array  # (m,)
    lost: Array  # (m,) 1 where a mode is out of the task
    xk: Array  # (m,) speed along it
    pull: Array  # (m,) and along what v_k leaves of its slope, over that, see `down_slopes`
    flip: Array  # (F, 3) mirrors of free turns
    move: Array  # (n,)
    null: Array
    x1: Array
    x2: Array
    x: Array  # rates wanted, then taken
    w: Array  # rates wanted, kept
    g: Array  # wishes
    lead: Array  # J^+ pace
    v: Array
    probe: Array
    before: Array
    at: Array  # where error and Jacobian are taken
    size: Array  # a speed for each joint
    even: Array  # 1 for all, see descent.py
    floor: Array  # the box
    roof: Array
    multiplier: Array
    planes: Array  # (rows, n) half-planes, those of slacks among them ...
    edges: Array  # ... and their right sides


@inline
def bench_space(n, m, rows):
    """Length of a block that has room for `Bench`: its matrices are less than (n + m)^2 together three times."""
    return 3 * (n + m) * (n + m) + 48 * (n + m + LINE) + rows


@spliced
def bench_on(block, n, m, rows):
    """Bench with its arrays, cut from a block of zeros."""
    k, F = max(n, m), m // 6
    why_low, why_top = cut(block, np.uint8, (n, n))
    return Bench(why_low, why_top, *cut(block, np.float64, (
        (F, 4, 4), m, m, m, m, m, m, m, m, m, m, m, k, (k, k), (k, k), (n, m), (m, n), (n, m), (m, m), m, m, m, m, (F, 3),
        n, n, n, n, n, n, n, n, n, n, n, n, n, n, n, n, n + rows, (rows, n), rows,
    )))  # fmt: skip
