"""Inputs and outputs of the compiled loops, by name. The order of the fields is the layout of the flat arrays.

Python packs `[*Orders(...), *Task(...), ...]` and reads `row[AT.status]`; the kernel makes the same records from the same
arrays. Flat arrays cross the boundary because they are cheap there (50 ns each, a record of arrays twice that).
"""

# numba's own types know neither options in a dict nor that overloads and intrinsics are called by numba.
# pyright: reportCallIssue=false, reportArgumentType=false, reportGeneralTypeIssues=false
from typing import Any, NamedTuple

import numpy as np
from numba.extending import overload

from ..compile.array_view import View, counted_part, put_numbers
from ..compile.jit import BUILD, INLINE, compiled, inline

Array = np.ndarray


@compiled
class Orders(NamedTuple):
    """Head of `orders`; a `Task` for each tip, the joint weights (n) and the parameters of the rule follow."""

    tol_p: float  # [m]
    tol_r: float  # [rad]
    given: float  # 1: the first attempt starts at q0
    iterations: float  # of an attempt
    attempts: float
    c: float  # an attempt from the table ends when |e|^2 > c rho^k
    rho: float
    c_free: float  # the same for one from q0 or a random start
    rho_free: float
    patience: float  # from this attempt after q0's on, each has twice the iterations and is given up later; inf: none
    evaluations: float  # budget
    limits: float  # 0: ignore them
    seed: float
    closest: float  # how many answers to compare when the one nearest q0 is wanted, 0: take the first
    hold: float  # 1: joints pushed past a limit are held and the step is redone
    follow: float  # largest move of a turning joint [rad] from q0 ...
    follow_slide: float  # ... and of a slide [m]; 0: any


class Task(NamedTuple):
    """Which part of a tip's error counts, as `task` reads it; lengths in kernel units, the axis in the last joint's frame."""

    kind: float  # POSE, POSITION, FREE or PART
    frame: float = 0.0  # the axes of weights and slacks: those of BASE, TIP or TARGET
    other: float = -1.0  # the tip that the target is relative to, -1: the base
    free: float = 0.0  # 1: the tip may turn about an axis
    ax: float = 0.0
    ay: float = 0.0
    az: float = 0.0
    w0: float = 1.0  # weights, 0 where an error does not count: three of the position, three of the rotation
    w1: float = 1.0
    w2: float = 1.0
    w3: float = 1.0
    w4: float = 1.0
    w5: float = 1.0
    s0: float = 0.0  # half widths inside which the error counts as zero
    s1: float = 0.0
    s2: float = 0.0
    s3: float = 0.0
    s4: float = 0.0
    s5: float = 0.0


@compiled
class Answer(NamedTuple):
    """Head of a row of `out`; q (n) follows, then for several tips the `Miss` of each."""

    status: float
    iterations: float
    restarts: float
    position: float  # [m], the largest over the tips
    rotation: float  # [rad]
    evaluations: float
    history: float  # rows of `history` written
    excess: float  # [m] by which a target lies out of reach
    attempt: float  # the attempt that found q, 0 the first
    held: float  # joint that the neighbourhood of q0 holds back (TOO_FAR) or that went to its other end (CONVERGED), -1: none


@compiled
class Miss(NamedTuple):
    """Remaining error of one tip."""

    position: float  # [m]
    rotation: float  # [rad]
    excess: float  # [m]


HEAD, TASK, ANSWER, MISS = len(Orders._fields), len(Task._fields), len(Answer._fields), len(Miss._fields)
WEIGHTS = HEAD + TASK  # where the joint weights begin in the orders for one tip
AT = Answer._make(range(ANSWER))  # places in a row: row[AT.status]
ORDER = Orders._make(range(HEAD))  # in the orders
WHAT: Any = Task._make(range(TASK))  # and in a task
POINTS = 24  # numbers of `ends` before what belongs to the coordinates: base (12), tip (12)


@compiled
class Ends(NamedTuple):
    """Base (rotation by rows, point), tip (the same, from 12 on), then what belongs to each coordinate, by place.

    One array, so that a kernel carries one. Lengths in kernel units.
    """

    flat: Array
    n: int

    def lower(self, i):
        return self.flat[POINTS + i]

    def upper(self, i):
        return self.flat[POINTS + self.n + i]

    def turns(self, i):
        """0: never wraps, 1: by full turns inside its limits, 2: endless."""
        return self.flat[POINTS + 2 * self.n + i]

    def unit(self, i):
        """1 for an angle, the chain's scale for a slide."""
        return self.flat[POINTS + 3 * self.n + i]

    def low(self, i):
        """Where random starts are drawn from ..."""
        return self.flat[POINTS + 4 * self.n + i]

    def span(self, i):
        """... and how wide that is."""
        return self.flat[POINTS + 5 * self.n + i]

    def home(self, i):
        return self.flat[POINTS + 6 * self.n + i]

    def scale(self):
        """Length of one kernel unit [m]."""
        return self.flat[POINTS + 7 * self.n]

    def bound(self, k):
        """Reach of the tip, hole of the tip, reach of the last joint, hole of the last joint, lift low, lift high."""
        return self.flat[POINTS + 1 + 7 * self.n + k]

    def confine(self, i, low, high):
        """Put a coordinate between new limits, where it does not wrap."""
        self.flat[POINTS + i] = low
        self.flat[POINTS + self.n + i] = high
        self.flat[POINTS + 2 * self.n + i] = 0.0


# ---------------------------------------------------------------------------------------------------- arrays <-> records
def read(cls: type, array: Array, start: int = 0) -> Any:
    """Record of class `cls` from array[start:]."""
    if list(cls.__annotations__.values()) == [Array]:
        return cls(array[start:])
    return cls(*array[start : start + len(cls._fields)])  # type: ignore[attr-defined]


@overload(read, jit_options=INLINE)
def _read(cls, array, start=0):
    make = cls.instance_class
    if list(make.__annotations__.values()) == [Array]:
        return (lambda cls, array, start=0: make(array[start:])) if isinstance(array, View) else None
    size = len(make._fields)
    return lambda cls, array, start=0: make(*counted_part(array, start, size))


@overload(read, jit_options=BUILD)  # it returns an array, so it counts references, and so must its callers
def _read_array(cls, array, start=0):
    make = cls.instance_class
    if list(make.__annotations__.values()) != [Array] or isinstance(array, View):
        return None
    return lambda cls, array, start=0: make(array[start:])  # a rule with many numbers takes them as they are


def write(array, start, record):
    """Write a record of numbers to array[start:]."""
    array[start : start + len(record)] = record


@overload(write, jit_options=INLINE)
def _write(array, start, record):
    return lambda array, start, record: put_numbers(array, start, record)


@inline
def copy(source, target):
    """target[:] = source, element by element: slices compile slowly."""
    for i in range(source.shape[0]):
        target[i] = source[i]
