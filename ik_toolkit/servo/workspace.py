"""Memory of a tracker's loop: four arrays ("blocks") that Python and compiled code share, and scratch for a step.

Passing an array from Python to compiled code takes 0.1 microseconds, so all arrays of one record are views of one flat array, its
block. Python and compiled code divide a block in the same way: Python once, compiled code at every call. The first number of a
block says how much of it is already divided (used by `cut`); the next ones are sizes, from which all lengths follow. To copy a
record, copy its block and divide the copy. The scratch of a step is in a block of its own.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ..compile.array_view import LINE, cut, fold
from ..compile.jit import compiled, inline, shared, spliced
from ..kernel.records import Array
from .laws import PLACE


class StepStart(NamedTuple):
    """Codes of how a step begins."""

    with_target: int = 0  # the joints begin at the rate of the target
    given: int = 1  # the joints begin at a given rate
    running: int = 2  # the step continues from an earlier command
    ready: int = 3  # other code has moved the joints, so there is no earlier command to continue from


START = StepStart()


class State(NamedTuple):
    """Names for the numbers that a tracker's loop keeps between steps in one array; STATE.start etc. are their indices."""

    start: int  # how the next step begins: START.with_target, START.given, START.running or START.ready
    period: int  # length of the last step [s]
    stop: int  # why the loop ended, a code of `loop.STOP`
    # 0 before the first singular pose; at a singular pose 1 + the time [s] for which the target still counts as out of reach; -1
    # after it
    near: int
    share: int  # factor in the damping mu of a damped descent (Levenberg-Marquardt); 0: no such descent
    lowest: int  # value below which the entry `share` must not be lowered for now
    nearest: int  # least weighted error so far; an arm that is not stuck improves on it
    # time [s] in which the weighted error has not fallen; outside a damped descent, only while something hinders the joints
    stalled: int
    turned: int  # number of joint reversals outside a damped descent; it is lowered as time goes by
    free: int  # time [s] since limits, inequalities or a singular pose last hindered the joints
    pressed: int  # time [s] for which errors beyond their slack (dead band) are closed like errors without slack


STATE = State._make(range(len(State._fields)))


@compiled
class Settings(NamedTuple):
    """Inputs of a tracker that stay the same while the compiled loop runs, for n joints and m errors."""

    block: Array
    law: Array  # the method and its gains, in the order of the fields of `Law`
    # (4, m) weights of errors; slack (dead band) in arm reaches or rad, and in m or rad; weight of its level relative to level 0
    counts: Array
    limits: Array  # (4, n) joint limits: rows lower, upper, speed, acceleration
    wish: Array  # (3, n) null-space motion: posture, gain towards it [1/s], additional joint velocity
    lines: Array  # (rows, n) collision inequalities lines x <= level on joint rates; the first law.rows apply
    level: Array  # (rows,) right sides of the collision inequalities
    measured: Array  # (n,) measured joint values, used if the entry `measured` of law is 1

    def __reduce__(self) -> tuple:
        return settings_of, (self.block,)


@compiled
class Carried(NamedTuple):
    """State that a tracker carries from step to step."""

    block: Array
    motion: Array  # (2, n) joint values and rates
    memory: Array  # internal state of the tracking method or of the solver's iteration
    swings: Array  # (3, n) reversals of each joint, to detect oscillation (see `viability.watch`)
    away: Array  # (n,) direction in which joints leave a singular (straight) pose
    basis: Array  # (m, m) task directions u_k at the last singular pose (singular_step.py); zeros before the first one
    state: Array  # numbers kept between steps; STATE holds the indices
    active: Array  # (n,) int8: joints in the active set of the last step, see `StepTaken`
    kept: Array  # (rows,) int8: inequalities in the active set of the last step

    def __reduce__(self) -> tuple:
        return carried_of, (self.block,)


@compiled
class Samples(NamedTuple):
    """Targets of F tips at N sample times."""

    block: Array
    T: Array  # (N, F, 4, 4) poses [m]
    V: Array  # (N, m) twists
    A: Array  # (N, m) accelerations

    def __reduce__(self) -> tuple:
        return samples_of, (self.block,)


@compiled
class Record(NamedTuple):
    """Results of N - 1 steps: joints and errors at N samples. With N = 1 no step is taken and the present ones are stored."""

    block: Array
    Q: Array  # (N, n) joint values
    R: Array  # (N, n) joint rates
    E: Array  # (N, m) errors [m, rad], base axes
    # (N,) number of singular directions removed from the task in each step (1 in a damped descent near a singular pose)
    S: Array
    C: Array  # (N - 1, n) uint8: bits of the limits that held joints back in each step

    def __reduce__(self) -> tuple:
        return record_of, (self.block,)


@shared
def settings_shapes(n, m, rows):
    """Return the shapes of the arrays in Settings (inputs of a tracker) for n joints, m errors and `rows` inequalities."""
    return len(PLACE), (4, m), (4, n), (3, n), (rows, n), rows, n


@shared
def carried_shapes(n, memory, rows, m):
    """Return the shapes of the arrays in Carried (state of a tracker between steps); int8 arrays are counted in floats of 8 bytes.

    n: number of joints; memory: numbers that the method keeps; rows: inequalities; m: errors.
    """
    return (2, n), memory, (3, n), n, (m, m), len(STATE), (n + 7) // 8, (rows + 7) // 8


@shared
def samples_shapes(N, F):
    """Return the shapes of the arrays in Samples: poses, twists and accelerations of F targets at N samples."""
    return (N, F, 4, 4), (N, 6 * F), (N, 6 * F)


@shared
def record_shapes(N, n, m):
    """Return the shapes of the arrays in Record for N samples, n joints and m errors; its uint8 array is counted in floats."""
    return (N, n), (N, n), (N, m), N, ((N - 1) * n + 7) // 8


@shared
def head(block):
    """Return the three sizes that stand at the beginning of a block (K,), and mark the block as not yet divided into arrays.

    A block is a flat array that holds all arrays of a record, after their sizes.
    """
    block[0] = 0.0
    return int(block[1]), int(block[2]), int(block[3])


@shared
def settings_of(block):
    """Return Settings whose arrays are parts of the flat array block (K,), which stores their sizes n, m, rows at its beginning."""
    n, m, rows = head(block)
    return Settings(block, *cut(block, np.float64, settings_shapes(n, m, rows)))


@shared
def carried_of(block):
    """Return Carried whose arrays are parts of the flat array block (K,), which stores n, memory, rows, m at its beginning."""
    n, memory, rows = head(block)
    shapes = carried_shapes(n, memory, rows, int(block[4]))
    motion, own, swings, away, basis, state, active, kept = cut(block, np.float64, shapes)
    return Carried(
        block, motion, own, swings, away, basis, state, fold(active, np.int8, 1, n)[0], fold(kept, np.int8, 1, rows)[0],
    )  # fmt: skip


@shared
def samples_of(block):
    """Return Samples whose arrays are parts of the flat array block (K,), which stores their sizes N, F at its beginning."""
    N, F, _ = head(block)
    return Samples(block, *cut(block, np.float64, samples_shapes(N, F)))


@shared
def record_of(block):
    """Return a Record whose arrays are parts of the flat array block (K,), which stores their sizes N, n, m at its beginning."""
    N, n, m = head(block)
    Q, R, E, S, codes = cut(block, np.float64, record_shapes(N, n, m))
    return Record(block, Q, R, E, S, fold(codes, np.uint8, N - 1, n))


# -------------------------------------------------------------------------------------------------------- from Python
def _made(of: Callable, shapes: tuple, *counts: int) -> Any:
    """Allocate a flat array of zeros for arrays of these shapes.

    Write the sizes into its head, and return the views made by `of`.
    """
    sizes = [math.prod(one) if isinstance(one, tuple) else one for one in shapes]
    block = np.zeros(LINE + sum(-(-size // LINE) * LINE for size in sizes))
    block[1 : 1 + len(counts)] = counts
    return of(block)


def new_settings(n: int, m: int, rows: int) -> Settings:
    """Make Settings (inputs of a tracker), all zeros, for n joints, m errors and at most `rows` inequalities."""
    return _made(settings_of, settings_shapes(n, m, rows), n, m, rows)


def new_carried(n: int, memory: int, rows: int, m: int) -> Carried:
    """Make room for a tracker's state between steps: n joints, m errors, `memory` numbers of its method, `rows` inequalities."""
    return _made(carried_of, carried_shapes(n, memory, rows, m), n, memory, rows, m)


def new_samples(N: int, F: int) -> Samples:
    """Make room for the targets of F tips at N sample times, all zeros."""
    return _made(samples_of, samples_shapes(N, F), N, F)


def samples_from(T: np.ndarray, V: np.ndarray, A: np.ndarray) -> Samples:
    """Return Samples of N targets of F tips: T (N, F, 4, 4), twists V and accelerations A (N, m)."""
    made = new_samples(*T.shape[:2])
    made.T[:], made.V[:], made.A[:] = T, V, A
    return made


def new_record(N: int, n: int, m: int) -> Record:
    """Make room for the results of N - 1 steps of n joints and m errors, all zeros."""
    return _made(record_of, record_shapes(N, n, m), N, n, m)


@compiled
class Bench(NamedTuple):
    """Scratch arrays of one step, for n joints, a task of m rows and F tips."""

    why_low: Array  # (n,) uint8: limit bits of the lower rate bounds
    why_top: Array  # (n,) uint8: limit bits of the upper rate bounds
    e: Array  # (m,) error: target now minus tip now
    ahead: Array  # (m,) target at the end of the step minus tip now
    f: Array  # (m,) twist of the target, in the axes of the error
    a: Array  # (m,) acceleration of the target
    ask: Array  # (m,) rate asked for in each row of the task
    bias: Array  # (m,) product of dJ/dt with joint rates
    weight: Array  # (m,) weights of the errors; 1 (or 0) once the errors have been multiplied by them
    heavy: Array  # (m,) largest weight at the priority level of each error; the level's own weight once errors are weighted
    t: Array  # (m,) scratch
    y: Array  # (max(n, m),) scratch
    G: Array  # (max(n, m), max(n, m)) factor for the pseudo-inverse
    H: Array  # (max(n, m), max(n, m)) factor for corrections that are damped because limits block them, see `laws.ease`
    J: Array  # (n, m) transposed Jacobian of the task
    W: Array  # (m, n) rows sigma_k v_k: singular value times joint direction, see singular_step.py
    V: Array  # (m, n) joint direction of each singular direction, one a row
    free: Array  # (n, m) Jacobian without the joints that limits stop, see `damped_descent.stop_in_time`
    U: Array  # (m, m) task directions u_k of the singular values, one a row
    sv: Array  # (m,) singular values sigma_k
    lost: Array  # (m,) 1 if the singular direction is removed from the task
    xk: Array  # (m,) joint speed along each joint direction that is removed from the task
    pull: Array  # (m,) joint rates per unit of slope, see `singular_step.down_slopes`
    flip: Array  # (F, 3) normals of the mirror planes for free rotations, see `reflect`
    move: Array  # (n,) joint move that closes the error
    null: Array  # (n,) present null-space velocity
    x1: Array  # (n,) joint rates along which dJ/dt is taken
    x2: Array  # (n,) joint rates by which dJ/dt along x1 is multiplied
    x: Array  # (n,) first the commanded joint rates, then the rates that the limits allow
    w: Array  # (n,) copy of the commanded joint rates
    g: Array  # (n,) secondary motion in the null space
    v: Array  # (n,) scratch
    probe: Array  # (n,) joint values at which a difference quotient is evaluated
    before: Array  # (n,) rates before the step
    at: Array  # (n,) joint values at which error and Jacobian are evaluated
    size: Array  # (n,) speed limit of each joint, or UNLIMITED
    even: Array  # (n,) ones, used in place of `size` in a damped least-squares step of a stuck arm
    floor: Array  # (n,) lower rate bounds
    roof: Array  # (n,) upper rate bounds
    planes: Array  # (rows, n) inequalities planes x <= edges on the joint rates x: of collisions and of slack
    edges: Array  # (rows,) right sides of the inequalities


@inline
def bench_space(n, m, rows):
    """Return how many floats are enough for the scratch arrays of a step (`Bench`), whose matrices take less than 3 (n + m)^2."""
    return 3 * (n + m) * (n + m) + 48 * (n + m + LINE) + rows


@spliced
def bench_on(block, n, m, rows):
    """Return the scratch arrays of a step for n joints, m errors and `rows` inequalities, cut from block, a flat array of zeros."""
    k, F = max(n, m), m // 6
    why_low, why_top = cut(block, np.uint8, (n, n))
    return Bench(why_low, why_top, *cut(block, np.float64, (
        m, m, m, m, m, m, m, m, m, k, (k, k), (k, k), (n, m), (m, n), (m, n), (n, m), (m, m), m, m, m, m, (F, 3),
        n, n, n, n, n, n, n, n, n, n, n, n, n, n, n, (rows, n), rows,
    )))  # fmt: skip
