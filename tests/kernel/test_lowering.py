"""Parts of kernels do what the same Python does, though `compile/lowering.py` writes loops, variables and calls its own way."""

from typing import NamedTuple

import numpy as np
import pytest
from numba import njit

from ik_toolkit.compile.array_view import cut, view
from ik_toolkit.compile.jit import compiled, inline, inner


@inner
def by_steps(first, stop, step):
    total, last = 0, -7
    for i in range(first, stop, step):
        for k in range(i, stop):
            if k == 5:
                continue
            total += 10 * i + k
            last = k
    return total, last


@inner
def counted(stop):
    seen = 0
    for i in range(stop):
        if i == 4:
            break
        seen += i + 1
    other = seen * 2 if stop > 2 else -seen
    while other > 3:
        other, seen = other - 3, seen + other
    return seen, other


@compiled
class Couple(NamedTuple):
    a: float
    whole: bool

    def doubled(self):
        return Couple(2.0 * self.a, not self.whole)


@inner
def couple(x):
    return Couple(x, x > 1.0).doubled()


@inline
def taken(block, n):
    block[0] = 0.0
    for _ in range(2):
        one, two = cut(block, np.float64, (n, (n, 2)))
    return one.shape[0] + two.shape[1]


@inner
def handed_on(block, n):
    return taken(block, n) + 1


@njit
def steps(first, stop, step):
    return by_steps(first, stop, step)


@njit
def count(stop):
    return counted(stop)


@njit
def pair(x):
    return couple(x)


@njit
def room(block, n):
    return handed_on(view(block), n)


def test_loops_with_any_step():
    for first in (-3, 0, 4):
        for stop in (-4, 0, 3, 9):
            for step in (1, 2, -1, -3):
                assert steps(first, stop, step) == getattr(by_steps, "py_func", by_steps)(first, stop, step)


def test_variables_in_loops_and_branches():
    for stop in range(-1, 8):
        assert count(stop) == getattr(counted, "py_func", counted)(stop)


def test_records_are_handed_over_whole():
    assert pair(3.0) == Couple(6.0, False) and pair(0.5) == Couple(1.0, True)


def test_an_error_comes_through_all_calls():
    assert room(np.zeros(200), 5) == 8
    with pytest.raises(MemoryError, match="too short"):
        room(np.zeros(40), 5)
    assert room(np.zeros(200), 5) == 8
