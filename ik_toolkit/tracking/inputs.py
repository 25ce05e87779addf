"""Numbers and names given to tracking, validated in one place."""

import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from ..errors import InvalidOption, floats, near_match

MOST_PARTS = 100_000  # of one step: about a second of computing


def number(value: Any, name: str) -> float:
    """Return a finite number. Raises InvalidOption."""
    array = floats(value, f"{name} must be a number", InvalidOption)
    if array.ndim or not math.isfinite(array):
        raise InvalidOption(f"{name} must be a finite number, not {value!r:.60}")
    return float(array)


def positive(value: Any, name: str) -> float:
    """Return a positive, finite number. Raises InvalidOption."""
    found = value if type(value) is float else number(value, name)  # most are floats, once a sample
    if not 0.0 < found < math.inf:
        raise InvalidOption(f"{name} must be a positive number, not {value!r:.60}")
    return found


def parts_of(dt: float, longest: float) -> int:
    """Return in how many parts a step of dt [s] is taken, none over longest [s]. Raises InvalidOption where it would take ages."""
    if dt > MOST_PARTS * longest:
        raise InvalidOption(f"dt [s] is {dt:g}, and the steps before were up to {longest:g} s: milli- or nanoseconds?")
    return math.ceil(dt / longest)


def switch(value: Any, name: str) -> bool:
    """Return True or False. Raises InvalidOption for anything else: "no" would count as true."""
    if not isinstance(value, bool | np.bool_):
        raise InvalidOption(f"{name} is True or False, not {value!r:.60}")
    return bool(value)


def one_of(value: Any, names: Iterable[str], what: str) -> str:
    """Return a name that exists. Raises InvalidOption, "no WHAT 'VALUE'", with a near match."""
    if not (isinstance(value, str) and value in names):
        raise InvalidOption(f"no {what} '{value!s:.60}'.{near_match(value, names)}")
    return value
