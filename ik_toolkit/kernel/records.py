"""Records that name the numbers of the flat arrays which Python passes to compiled loops and gets back.

The order of the fields is the layout of an array: Python packs `[*Orders(...), *Task(...), ...]` and reads `row[AT.status]`, and
the compiled code makes the same records from the same arrays. Flat arrays are used because numba unpacks them fastest: an array
takes 50 ns, and twice as long inside a record of arrays.
"""

# Numba's type hints lack options given in a dict, and functions that only numba calls, so pyright must not report these.
# pyright: reportCallIssue=false, reportArgumentType=false, reportGeneralTypeIssues=false
from typing import Any, NamedTuple

import numpy as np
from numba.extending import overload

from ..compile.array_view import View, counted_part, put_numbers
from ..compile.jit import BUILD, INLINE, compiled, inline

Array = np.ndarray


@compiled
class Orders(NamedTuple):
    """Options of a solve: the start of an `orders` array. A `Task` for each tip, n joint weights and solver parameters follow."""

    tol_p: float  # position tolerance [m]
    tol_r: float  # rotation tolerance [rad]
    given: float  # 1 if the first attempt starts at q0, else 0
    iterations: float  # highest number of iterations of an attempt
    attempts: float  # highest number of attempts
    c: float  # An attempt from a precomputed start is given up in iteration k if its squared error exceeds c rho^k.
    rho: float  # factor by which the bound c rho^k on the squared error falls in each iteration
    c_free: float  # An attempt from q0 or a random start is given up if its squared error exceeds c_free rho_free^k.
    rho_free: float  # factor by which the bound c_free rho_free^k falls in each iteration
    patience: float  # number of the first attempt that gets more iterations, see `search.GiveUpRules`; inf if none does
    evaluations: float  # highest number of evaluations of the errors
    limits: float  # 1 if the joint limits are kept, 0 if they are ignored
    seed: float  # seed of the random starts
    closest: float  # number of solutions to find, of which the one nearest q0 is chosen; 0 accepts the first
    hold: float  # 1 if joints that a step pushes past a limit are held and the step is computed again, else 0
    follow: float  # largest move of a revolute joint away from q0 [rad]; 0 allows any
    follow_slide: float  # largest move of a prismatic joint away from q0 [m]; 0 allows any


class Task(NamedTuple):
    """Which part of a tip's pose error counts: the numbers that stand for one target in an `orders` array.

    Lengths are divided by the arm's reach; the free axis is in the last joint's frame.
    """

    kind: float  # a number of `counted_error.TargetKinds`
    frame: float = 0.0  # axes in which weights and dead bands are given, a number of `counted_error.AxesOfParts`
    other: float = -1.0  # index of the tip that the target is relative to; -1 means the base
    free: float = 0.0  # 1 if the tip may turn freely about the axis (ax, ay, az), else 0
    ax: float = 0.0
    ay: float = 0.0
    az: float = 0.0
    # w0 to w2 are weights of the position error, w3 to w5 of the rotation error; a component with weight 0 does not count.
    w0: float = 1.0
    w1: float = 1.0
    w2: float = 1.0
    w3: float = 1.0
    w4: float = 1.0
    w5: float = 1.0
    # s0 to s5 are dead bands of the position (3) [arm reaches] and rotation errors (3) [rad]: a component up to this size counts as
    # 0.
    s0: float = 0.0
    s1: float = 0.0
    s2: float = 0.0
    s3: float = 0.0
    s4: float = 0.0
    s5: float = 0.0


@compiled
class Answer(NamedTuple):
    """Result of a solve: the start of a row of results. Then comes q (n), and for several tips a `Miss` for each tip."""

    status: float  # a number of `checks.StatusCodes`
    iterations: float  # number of iterations of all attempts
    restarts: float  # number of attempts after the first one
    position: float  # position error [m], the largest of all tips
    rotation: float  # rotation error [rad], the largest of all tips
    evaluations: float  # number of evaluations of the errors
    history: float  # number of rows of history that were written (one for each evaluation)
    excess: float  # length [m] by which the target is proven out of reach
    attempt: float  # number of the attempt that found q, 0 for the first
    held: float  # index of the joint that the option `follow` holds back most (status TOO_FAR), or -1
    agreed: float  # in a search by levels: number of attempts that found this minimum; else 0


@compiled
class Miss(NamedTuple):
    """The errors of one tip in an answer for several tips."""

    position: float  # position error [m]
    rotation: float  # rotation error [rad]
    excess: float  # length [m] by which the target is proven out of reach


class ArraySizes(NamedTuple):
    """How many numbers each record takes in an array, which is also the index at which the next part of the array begins."""

    orders: int = len(Orders._fields)
    task: int = len(Task._fields)
    # length of `Orders` and one `Task` together: for one tip, the index at which the joint weights begin
    weights: int = len(Orders._fields) + len(Task._fields)
    answer: int = len(Answer._fields)
    miss: int = len(Miss._fields)
    # how many numbers precede q in a row of a search's history: position error [m], rotation error [rad], number of the attempt
    past: int = 3


SIZE = ArraySizes()
# The index of each field in its array, for example row[AT.status], orders[ORDER.seed], task[WHAT.kind].
AT = Answer._make(range(SIZE.answer))
ORDER = Orders._make(range(SIZE.orders))
WHAT: Any = Task._make(range(SIZE.task))
# index in the array of `Ends` at which the numbers of the coordinates begin, after the poses of base (12) and tip (12)
POINTS = 24


@compiled
class Ends(NamedTuple):
    """The base and tip of a chain and the limits of its n coordinates, in one flat array, which is faster to pass than several.

    The array holds the poses of base and tip (each a rotation matrix by rows, then a point), n numbers for each property of the
    coordinates, then the numbers of the chain as a whole. Lengths are divided by `scale`, a power of two near the reach.
    """

    flat: Array
    n: int

    def lower(self, i):
        return self.flat[POINTS + i]

    def upper(self, i):
        return self.flat[POINTS + self.n + i]

    def turns(self, i):
        """Return 0 if coordinate i never wraps, 1 if it wraps by 2 pi inside its limits, 2 if it is endless."""
        return self.flat[POINTS + 2 * self.n + i]

    def unit(self, i):
        """Return the size of the internal unit of coordinate i: 1 rad for an angle, `scale` metres for a prismatic joint."""
        return self.flat[POINTS + 3 * self.n + i]

    def low(self, i):
        """Return the lower end of the range from which coordinate i of a random start is drawn."""
        return self.flat[POINTS + 4 * self.n + i]

    def span(self, i):
        """Return the width of the range from which coordinate i of a random start is drawn."""
        return self.flat[POINTS + 5 * self.n + i]

    def home(self, i):
        return self.flat[POINTS + 6 * self.n + i]

    def scale(self):
        """Return the internal unit of length [m], a power of two near the reach."""
        return self.flat[POINTS + 7 * self.n]

    def bound(self, k):
        """Return one of six bounds [arm reaches] on where the arm can reach.

        k = 0 and 1: largest and smallest distance of the tip from the first joint; k = 2 and 3: the same for the last joint instead
        of the tip. k = 4 and 5: lowest and highest position of the base of the arm, which may be mounted on a vertical prismatic
        joint.
        """
        return self.flat[POINTS + 1 + 7 * self.n + k]

    def confine(self, i, low, high):
        """Set the limits of coordinate i to `low` and `high`, and keep it from wrapping."""
        self.flat[POINTS + i] = low
        self.flat[POINTS + self.n + i] = high
        self.flat[POINTS + 2 * self.n + i] = 0.0


# ---------------------------------------------------------------------------------------------------- arrays <-> records
def read(cls: type, array: Array, start: int = 0) -> Any:
    """Return a NamedTuple of class `cls` made of the numbers array[start:]; one whose only field is an array gets them all."""
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


# A record that holds an array needs numba's reference counting, which the option INLINE leaves out.
@overload(read, jit_options=BUILD)
def _read_array(cls, array, start=0):
    make = cls.instance_class
    if list(make.__annotations__.values()) != [Array] or isinstance(array, View):
        return None
    # If the only field of the class is an array, it receives all remaining numbers.
    return lambda cls, array, start=0: make(array[start:])


def write(array, start, record):
    """Write the numbers of a NamedTuple `record` to array[start:]."""
    array[start : start + len(record)] = record


@overload(write, jit_options=INLINE)
def _write(array, start, record):
    return lambda array, start, record: put_numbers(array, start, record)


@inline
def copy(source, target):
    """Copy the numbers of `source` (n,) to `target` one by one, because numba takes long to compile slices."""
    for i in range(source.shape[0]):
        target[i] = source[i]
