"""Timing for the reports: methods run in turn, and their processor time is given with its spread."""

from collections.abc import Callable
from time import process_time
from typing import Any

import numpy as np

Work = tuple[Callable[[], Any], int]  # a function to time, and the number of solves that one call makes


def rounds(works: dict[str, Work], count: int, warm: bool = False) -> dict[str, np.ndarray]:
    """Time several functions in turn, for a number of rounds.

    Processor time is measured, because other processes on the same core should not count.

    Args:
        works: By name, the function to time and the number of solves in one call.
        count: Number of timed rounds.
        warm: Whether everything is compiled already. If not, a first round, which is not timed, compiles it.

    Returns:
        For each name the time of a solve in each round (count,) [s].
    """
    spent: dict[str, list[float]] = {name: [] for name in works}
    for k in range(warm, count + 1):
        for name, (work, solves) in works.items():
            begun = process_time()
            work()
            if k:
                spent[name].append((process_time() - begun) / solves)
    return {name: np.array(values) for name, values in spent.items()}


def spread(values: np.ndarray, form: str = ".3g") -> str:
    """Return the median and range of values as text, "MEDIAN [MIN-MAX]"."""
    return f"{np.median(values):{form}} [{np.min(values):{form}}-{np.max(values):{form}}]"
