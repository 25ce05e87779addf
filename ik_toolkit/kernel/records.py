"""Records that name the numbers of the flat arrays which Python hands to compiled loops and gets back.

The order of the fields is the layout of an array: Python packs `[*Orders(...), *Task(...), ...]` and reads `row[AT.status]`, and
the kernel makes the same records from the same arrays. Flat arrays are used because numba unpacks them fastest: an array takes
50 ns, and twice as long inside a record of arrays.
"""

# Pyright must ignore what numba's type hints lack: options in a dict, and functions that only numba calls.
# pyright: reportCallIssue=false, reportArgumentType=false, reportGeneralTypeIssues=false
from typing import Any, NamedTuple

import numpy as np
from numba.extending import overload

from ..compile.array_view import View, counted_part, put_numbers
from ..compile.jit import BUILD, INLINE, compiled, inline

Array = np.ndarray


@compiled
class Orders(NamedTuple):
    """Options of a solve. An array of orders holds them, a `Task` for each tip, n joint weights, then the rule's parameters."""

    tol_p: float  # position tolerance [m]
    tol_r: float  # rotation tolerance [rad]
    given: float  # 1 if the first attempt starts at q0, else 0
    iterations: float  # highest number of iterations of an attempt
    attempts: float  # highest number of attempts
    c: float  # An attempt from a start in the table is given up in iteration k if its squared error exceeds c rho^k.
    rho: float  # see c
    c_free: float  # An attempt from q0 or a random start is given up if its squared error exceeds c_free rho_free^k.
    rho_free: float  # see c_free
    patience: float  # number of the first attempt that gets more iterations, see `search.Endings`; inf if none does
    evaluations: float  # highest number of evaluations of the errors
    limits: float  # 1 if the joint limits are kept, 0 if they are ignored
    seed: float  # seed of the random starts
    closest: float  # number of solutions of which the one nearest q0 is taken; 0 takes the first solution
    hold: float  # 1 if joints pushed past a limit are held and the step is computed again, else 0
    follow: float  # largest move of a turning joint away from q0 [rad]; 0 allows any
    follow_slide: float  # largest move of a sliding joint away from q0 [m]; 0 allows any


class Task(NamedTuple):
    """Which part of a tip's pose error counts. Lengths are in kernel units; the free axis is given in the last joint's frame."""

    kind: float  # POSE, POSITION, FREE or PART of `counted_error`
    frame: float = 0.0  # axes in which weights and slacks are given: BASE, TIP or TARGET of `counted_error`
    other: float = -1.0  # index of the tip that the target is relative to; -1 means the base
    free: float = 0.0  # 1 if the tip may turn about the axis (ax, ay, az), else 0
    ax: float = 0.0
    ay: float = 0.0
    az: float = 0.0
    # w0 to w2 weight the position error, w3 to w5 the rotation error; an error of weight 0 does not count.
    w0: float = 1.0
    w1: float = 1.0
    w2: float = 1.0
    w3: float = 1.0
    w4: float = 1.0
    w5: float = 1.0
    s0: float = 0.0  # s0 to s5 are the sizes up to which the same six errors count as zero
    s1: float = 0.0
    s2: float = 0.0
    s3: float = 0.0
    s4: float = 0.0
    s5: float = 0.0


@compiled
class Answer(NamedTuple):
    """Result of a solve. An array of results holds it, then q (n), then for several tips a `Miss` for each tip."""

    status: float  # one of the codes of `checks`
    iterations: float  # number of iterations of all attempts
    restarts: float  # attempts after the first one
    position: float  # position error [m], the largest of all tips
    rotation: float  # rotation error [rad], the largest of all tips
    evaluations: float  # how often the errors were evaluated
    history: float  # number of rows of history (one per evaluation) that were written
    excess: float  # length [m] by which the target is proven out of reach
    attempt: float  # number of the attempt that found q, 0 for the first
    held: float  # index of the joint that the option `follow` holds back (status TOO_FAR), or -1
    agreed: float  # of a search by levels: number of attempts that found this minimum, else 0


@compiled
class Miss(NamedTuple):
    """The errors of one tip in an answer for several tips."""

    position: float  # position error [m]
    rotation: float  # rotation error [rad]
    excess: float  # length [m] by which the target is proven out of reach


# How many numbers each of these NamedTuples takes in an array.
HEAD, TASK, ANSWER, MISS = len(Orders._fields), len(Task._fields), len(Answer._fields), len(Miss._fields)
PAST = 3  # numbers in a row of a search's history before q: position error [m], rotation error [rad], number of the attempt
WEIGHTS = HEAD + TASK  # index at which the joint weights begin in the Orders array for one tip
# The index of each field in its array: row[AT.status], orders[ORDER.seed], task[WHAT.kind].
AT = Answer._make(range(ANSWER))
ORDER = Orders._make(range(HEAD))
WHAT: Any = Task._make(range(TASK))
POINTS = 24  # index in the array of `Ends` at which the numbers of the coordinates begin, after base (12) and tip (12)


@compiled
class Ends(NamedTuple):
    """Both ends of a chain and its coordinates' limits, all in one flat array, because passing each array to a kernel takes time.

    The array holds the poses of base and tip (each a rotation matrix by rows, then a point), n numbers for each property of the
    coordinates, then the numbers of the chain as a whole. Lengths are in kernel units.
    """

    flat: Array
    n: int

    def lower(self, i):
        return self.flat[POINTS + i]

    def upper(self, i):
        return self.flat[POINTS + self.n + i]

    def turns(self, i):
        """Return 0 if coordinate i never wraps, 1 if it wraps by full turns inside its limits, 2 if it is endless."""
        return self.flat[POINTS + 2 * self.n + i]

    def unit(self, i):
        """Return the size of one kernel unit of coordinate i: 1 rad for an angle, `scale` metres for a slide."""
        return self.flat[POINTS + 3 * self.n + i]

    def low(self, i):
        """Return the lower end of the range in which coordinate i of random starts is drawn."""
        return self.flat[POINTS + 4 * self.n + i]

    def span(self, i):
        """Return the width of the range in which coordinate i of random starts is drawn."""
        return self.flat[POINTS + 5 * self.n + i]

    def home(self, i):
        return self.flat[POINTS + 6 * self.n + i]

    def scale(self):
        """Return the length of one kernel unit [m]."""
        return self.flat[POINTS + 7 * self.n]

    def bound(self, k):
        """Return one of six bounds [kernel units] on the reach.

        k = 0 and 1 bound the distance of the tip from the arm's foot from above and below; 2 and 3 likewise bound the distance of
        the last joint. 4 and 5 are the lowest and highest place of the foot, which a vertical slide may carry.
        """
        return self.flat[POINTS + 1 + 7 * self.n + k]

    def confine(self, i, low, high):
        """Give coordinate i new limits and keep it from wrapping."""
        self.flat[POINTS + i] = low
        self.flat[POINTS + self.n + i] = high
        self.flat[POINTS + 2 * self.n + i] = 0.0


# ---------------------------------------------------------------------------------------------------- arrays <-> records
def read(cls: type, array: Array, start: int = 0) -> Any:
    """Make a NamedTuple of class `cls` from the numbers array[start:]."""
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


@overload(read, jit_options=BUILD)  # A function that returns an array must count references, unlike those with INLINE.
def _read_array(cls, array, start=0):
    make = cls.instance_class
    if list(make.__annotations__.values()) != [Array] or isinstance(array, View):
        return None
    return lambda cls, array, start=0: make(array[start:])  # A class with a single array field takes all numbers.


def write(array, start, record):
    """Write the numbers of a NamedTuple to array[start:]."""
    array[start : start + len(record)] = record


@overload(write, jit_options=INLINE)
def _write(array, start, record):
    return lambda array, start, record: put_numbers(array, start, record)


@inline
def copy(source, target):
    """Copy `source` to `target` element by element, because numba compiles slices slowly."""
    for i in range(source.shape[0]):
        target[i] = source[i]
