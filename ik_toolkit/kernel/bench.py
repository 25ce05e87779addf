"""Scratch of a tracker."""

from typing import NamedTuple

import numpy as np

from .jit import build, compiled
from .records import Array


@compiled
class Bench(NamedTuple):
    """Scratch of a tracker for n joints, a task of m, F tips."""

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
    t: Array  # (m,)
    y: Array  # (max(n, m),)
    G: Array  # (max(n, m), max(n, m))
    J: Array  # (n, m) of what is tracked
    W: Array  # (n, m) modes, see modes.py: sigma_k v_k ...
    V: Array  # (n, m) ... v_k of the lost ones ...
    U: Array  # (m, m) ... and u_k
    sv: Array  # (m,)
    lost: Array  # (m,) 1 where a mode is out of the task
    xk: Array  # (m,) speed along it
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
    floor: Array  # the box
    roof: Array
    why_low: Array
    why_top: Array
    multiplier: Array


@build
def make_bench(n, m, rows):
    """Bench with its arrays."""
    k, F = max(n, m), m // 6
    return Bench(
        np.zeros((F, 4, 4)), np.zeros(m), np.zeros(m), np.zeros(m), np.zeros(m), np.zeros(m), np.zeros(m), np.zeros(m),
        np.zeros(m), np.zeros(m), np.zeros(m), np.zeros(k), np.zeros((k, k)), np.zeros((n, m)), np.zeros((n, m)), np.zeros((n, m)),
        np.zeros((m, m)), np.zeros(m), np.zeros(m), np.zeros(m), np.zeros((F, 3)), np.zeros(n), np.zeros(n), np.zeros(n),
        np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n),
        np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n, np.uint8), np.zeros(n, np.uint8), np.zeros(n + rows),
    )  # fmt: skip
