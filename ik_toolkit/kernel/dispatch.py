"""What depends on classes when a search is compiled: one tip or several, and methods that a solver rule may override."""

# Numba's type hints lack options given in a dict, and functions that only numba calls, so pyright must not report these.
# pyright: reportCallIssue=false, reportArgumentType=false
import numpy as np
from numba.extending import overload

from ..compile.array_view import fold
from ..compile.jit import INLINE
from .serial import serial_on
from .tree import tree_on


def problem_on(block, rows, ends, tasks, n, orders):
    """Return the problem of one tip (Serial, if `ends` is one row) or of several (TreeProblem).

    block: memory, from which scratch arrays are cut; rows: (L, 10) geometry; ends: the array of a `records.Ends`, a row for each
    tip; tasks: the fields of a `Task` for each tip, one after the other; n: number of coordinates; orders: an `Orders`.
    """
    return (serial_on if ends.ndim == 1 else tree_on)(block, rows, ends, tasks, n, orders)


@overload(problem_on, jit_options=INLINE)
def _problem_on(block, rows, ends, tasks, n, orders):
    if ends.ndim == 1:
        return lambda block, rows, ends, tasks, n, orders: serial_on(block, rows, ends, tasks, n, orders)
    return lambda block, rows, ends, tasks, n, orders: tree_on(block, rows, ends, tasks, n, orders)


def shaped(ends, T, tips):
    """Return the array `ends` (see `records.Ends`) in the shape that suits targets T: flat for one tip, else one row a tip.

    T is (N, 4, 4) for one tip, and (N, F, 4, 4) for several.
    """
    return ends if T.ndim == 3 else ends.reshape(tips, -1)


@overload(shaped, jit_options=INLINE)
def _shaped(ends, T, tips):
    if T.ndim == 3:
        return lambda ends, T, tips: ends
    return lambda ends, T, tips: fold(ends, np.float64, tips, ends.shape[0] // tips)


def evaluation(rule, p, q):
    """Return the errors of problem p at q (n,).

    A solver rule with a method `evaluated` is asked instead of the problem: it may rank configurations in another way.
    """
    return rule.evaluated(p, q) if hasattr(rule, "evaluated") else p.evaluate(q)


@overload(evaluation, jit_options=INLINE)
def _evaluation(rule, p, q):
    if hasattr(rule.instance_class, "evaluated"):
        return lambda rule, p, q: rule.evaluated(p, q)
    return lambda rule, p, q: p.evaluate(q)


def aim_at(rule, p, T, orders):
    """Set the target T of problem p, by the solver rule's method `aimed` if it has one.

    Returns the length [arm reaches] by which the target is proven out of reach, -1 if it is not a pose. orders: an `Orders`.
    """
    return rule.aimed(p, T, orders) if hasattr(rule, "aimed") else p.aim(T, orders)


@overload(aim_at, jit_options=INLINE)
def _aim_at(rule, p, T, orders):
    if hasattr(rule.instance_class, "aimed"):
        return lambda rule, p, T, orders: rule.aimed(p, T, orders)
    return lambda rule, p, T, orders: p.aim(T, orders)
