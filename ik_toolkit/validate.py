"""Checks of arguments that several functions take. They raise before any work begins."""

import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from .errors import InvalidConfiguration, InvalidOption, floats, near_match

# numpy has a single dtype object for float64, so `is` suffices to recognise it; other dtypes take a slower way.
FLOAT = np.dtype(np.float64)
# factor by which a control step may be longer than the first one; a longer step is divided, so that limits are kept
LATE = 5.0
MOST_PARTS = 100_000  # largest number of parts into which a control step is divided; that many take some seconds
# The one function that accepts a special value of an option, by value; error messages of other functions name it.
ELSEWHERE = {"on_limit": {"slow": "ik.track", "direct": "ik.Tracker"}}


def number(value: Any, name: str) -> float:
    """Return a value as a finite float. Raises InvalidOption, which names the argument, if it is not finite."""
    array = floats(value, f"{name} must be a number", InvalidOption)
    if array.ndim or not math.isfinite(array):
        raise InvalidOption(f"{name} must be a finite number, not {value!r:.60}")
    return float(array)


def positive(value: Any, name: str) -> float:
    """Return a value as a positive float. Raises InvalidOption, which names the argument, if it is not, or 1e100 or more."""
    # A shortcut for floats, because this check runs in every control step.
    found = value if type(value) is float else number(value, name)
    if not 0.0 < found < 1e100:  # squares of larger numbers soon overflow
        below = " below 1e+100" if 0.0 < found < math.inf else ""
        raise InvalidOption(f"{name} must be a positive number{below}, not {value!r:.60}")
    return found


def not_negative(value: Any, name: str) -> float:
    """Return a value as a finite float that is not negative. Raises InvalidOption, which names the argument, if it is."""
    if (found := number(value, name)) < 0.0:
        raise InvalidOption(f"{name} must not be negative, not {found:g}")
    return found


def parts_of_step(dt: float, longest: float, given: bool = False) -> int:
    """Return the number of parts, none longer than `longest` [s], into which a control step of dt [s] is divided.

    given: whether the caller chose `longest` as dt_max, so that it does not follow from the first step.

    Raises InvalidOption if there are more than MOST_PARTS, because dt was then probably given in another unit.
    """
    if dt > MOST_PARTS * longest:
        whole = f"{longest:g} s, {'which is dt_max' if given else f'{LATE:g} times the first one'}"
        raise InvalidOption(f"dt [s] is {dt:g}: {dt / longest:,.9g} parts of at most {whole}. Was another unit meant?")
    return math.ceil(dt / longest)


def switch(value: Any, name: str) -> bool:
    """Return a value if it is True or False, else raise InvalidOption, because text such as "no" would count as true."""
    if not isinstance(value, bool | np.bool_):
        raise InvalidOption(f"{name} is True or False, not {value!r:.60}")
    return bool(value)


def one_of(value: Any, names: Iterable[str], what: str) -> str:
    """Return a name if it is among `names`. Raises InvalidOption, "no WHAT 'VALUE'", with a near match, if it is not."""
    if not (isinstance(value, str) and value in names):
        taken_by = ELSEWHERE.get(what, {}).get(str(value))
        meant = f"; '{value}' is for {taken_by}" if taken_by else ""
        raise InvalidOption(f"no {what} '{value!s:.60}'{meant}.{near_match(value, names)}")
    return value


def rates(robot: Any, rate0: Any) -> np.ndarray:
    """Return joint rates at the start of a motion as an array (n,) [rad/s or m/s]; InvalidConfiguration if they do not fit."""
    found = robot.read_q(rate0, "rate0")[0]
    if not np.isfinite(found).all():
        raise InvalidConfiguration(f"rate0 must be finite, not {found}")
    return found


def solver_list(solvers: Any) -> list[Any]:
    """Return one solver or several (names, classes or instances) as a list. Raises InvalidOption for anything else."""
    # An instance of an iterative solver is a tuple (NamedTuple), but counts as one solver.
    if isinstance(solvers, str | type) or hasattr(type(solvers), "loop"):
        return [solvers]
    if not isinstance(solvers, Iterable):
        raise InvalidOption(f"solvers must be names, rule classes or instances of them, not {solvers!r:.60}")
    return list(solvers)
