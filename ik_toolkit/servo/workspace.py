"""What a tracker's loop reads and writes, in four blocks: each array that a call from Python hands over takes it 0.1 microseconds.

Python and the kernel cut the parts of a block in the same way: Python once, as arrays, the kernel at every call, as views. The
first number of a block is that of `cut`; the next ones are counts, from which all lengths follow. A copy of one is a copy of its
block, cut anew. The scratch that a step computes in is cut from a block of its own.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ..compile.array_view import LINE, cut, fold
from ..compile.jit import compiled, inline, shared, spliced
from ..kernel.records import Array
from .laws import Law, State

LAW, STATES = len(Law._fields), len(State._fields)


@compiled
class Settings(NamedTuple):
    """What stays as it is during a call, for n coordinates and m errors."""

    block: Array
    law: Array  # a `Law`
    counts: Array  # (3, m) weights of the errors, slack, slack in m and rad
    limits: Array  # (4, n), see viability.py
    wish: Array  # (3, n) posture, gain, speed asked for
    lines: Array  # (rows, n) half-planes lines x <= level, of which the first law.rows hold
    level: Array  # (rows,)
    measured: Array  # (n,) where the joints are, when law.measured says so

    def __reduce__(self) -> tuple:
        return settings_of, (self.block,)


@compiled
class Carried(NamedTuple):
    """What is carried from step to step."""

    block: Array
    motion: Array  # (2, n) joints and their rates
    memory: Array  # of the method, or the rule
    swings: (
        Array  # (3, n) how often in a row each joint turned back, for how long it has not [s], its side, see `watch`
    )
    away: Array  # (n,) where joints go from a pose in which they are straight
    basis: Array  # (m, m) directions of the task at the last singular pose, zeros before one, see singular_step.py
    state: Array  # a `State`
    active: Array  # (n,) and kept, int8: the active set of `constrain` ...
    kept: Array  # (rows,)

    def __reduce__(self) -> tuple:
        return carried_of, (self.block,)


@compiled
class Samples(NamedTuple):
    """Targets of F tips at N samples."""

    block: Array
    T: Array  # (N, F, 4, 4) [m]
    V: Array  # (N, m) twist
    A: Array  # (N, m) acceleration

    def __reduce__(self) -> tuple:
        return samples_of, (self.block,)


@compiled
class Record(NamedTuple):
    """What N - 1 steps come to; N = 1 says how it is now."""

    block: Array
    Q: Array  # (N, n)
    R: Array  # (N, n) rates
    E: Array  # (N, m) errors [m, rad]
    S: Array  # (N,) lost directions of each step (1 in a step down near a singular pose)
    C: Array  # (N - 1, n) bits of limits, uint8

    def __reduce__(self) -> tuple:
        return record_of, (self.block,)


@shared
def settings_shapes(n, m, rows):
    """Shapes of `Settings`."""
    return LAW, (3, m), (4, n), (3, n), (rows, n), rows, n


@shared
def carried_shapes(n, memory, rows, m):
    """Shapes of `Carried`; bytes in whole numbers of eight."""
    return (2, n), memory, (3, n), n, (m, m), STATES, (n + 7) // 8, (rows + 7) // 8


@shared
def samples_shapes(N, F):
    """Shapes of `Samples`."""
    return (N, F, 4, 4), (N, 6 * F), (N, 6 * F)


@shared
def record_shapes(N, n, m):
    """Shapes of `Record`."""
    return (N, n), (N, n), (N, m), N, ((N - 1) * n + 7) // 8


@shared
def head(block):
    """The counts of a block, and its first number set back."""
    block[0] = 0.0
    return int(block[1]), int(block[2]), int(block[3])


@shared
def settings_of(block):
    """Parts of a block (K,) of n, m, rows."""
    n, m, rows = head(block)
    return Settings(block, *cut(block, np.float64, settings_shapes(n, m, rows)))


@shared
def carried_of(block):
    """Parts of a block (K,) of n, numbers of memory, rows, m."""
    n, memory, rows = head(block)
    shapes = carried_shapes(n, memory, rows, int(block[4]))
    motion, own, swings, away, basis, state, active, kept = cut(block, np.float64, shapes)
    return Carried(
        block, motion, own, swings, away, basis, state, fold(active, np.int8, 1, n)[0], fold(kept, np.int8, 1, rows)[0],
    )  # fmt: skip


@shared
def samples_of(block):
    """Parts of a block (K,) of N, F."""
    N, F, _ = head(block)
    return Samples(block, *cut(block, np.float64, samples_shapes(N, F)))


@shared
def record_of(block):
    """Parts of a block (K,) of N, n, m."""
    N, n, m = head(block)
    Q, R, E, S, codes = cut(block, np.float64, record_shapes(N, n, m))
    return Record(block, Q, R, E, S, fold(codes, np.uint8, N - 1, n))


# ------------------------------------------------------------------------------------------------------------- from Python
def _made(of: Callable, shapes: tuple, *counts: int) -> Any:
    """A new block of zeros, and its parts."""
    sizes = [math.prod(one) if isinstance(one, tuple) else one for one in shapes]
    block = np.zeros(LINE + sum(-(-size // LINE) * LINE for size in sizes))
    block[1 : 1 + len(counts)] = counts
    return of(block)


def new_settings(n: int, m: int, rows: int) -> Settings:
    """Settings for n coordinates, m errors, at most `rows` half-planes."""
    return _made(settings_of, settings_shapes(n, m, rows), n, m, rows)


def new_carried(n: int, memory: int, rows: int, m: int) -> Carried:
    """What is carried on of n coordinates and m errors, with `memory` numbers of the method, and `rows` of `constrain`."""
    return _made(carried_of, carried_shapes(n, memory, rows, m), n, memory, rows, m)


def new_samples(N: int, F: int) -> Samples:
    """Samples of F tips."""
    return _made(samples_of, samples_shapes(N, F), N, F)


def new_record(N: int, n: int, m: int) -> Record:
    """Record of N - 1 steps."""
    return _made(record_of, record_shapes(N, n, m), N, n, m)


@compiled
class Bench(NamedTuple):
    """Scratch of a tracker for n joints, a task of m, F tips."""

    why_low: Array  # of the box, see viability.py
    why_top: Array
    e: Array  # (m,) error now
    ahead: Array  # (m,) and to where the target will be
    f: Array  # (m,) twist of the target, as it counts
    a: Array  # (m,) acceleration
    ask: Array  # (m,) rate of the task without the target's motion
    bias: Array  # (m,)
    weight: Array  # (m,) of the errors; ones where they are weighed already
    t: Array  # (m,)
    y: Array  # (max(n, m),)
    G: Array  # (max(n, m), max(n, m))
    H: Array  # (max(n, m), max(n, m)) damped
    J: Array  # (n, m) of what is tracked
    W: Array  # (m, n) modes, see singular_step.py: sigma_k v_k by rows ...
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
    v: Array
    probe: Array
    before: Array
    at: Array  # where error and Jacobian are taken
    size: Array  # a speed for each joint
    even: Array  # 1 for all, see damped_descent.py
    floor: Array  # the box
    roof: Array
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
        m, m, m, m, m, m, m, m, k, (k, k), (k, k), (n, m), (m, n), (n, m), (m, m), m, m, m, m, (F, 3),
        n, n, n, n, n, n, n, n, n, n, n, n, n, n, n, (rows, n), rows,
    )))  # fmt: skip
