"""Timing for the reports: alternating runs, in processor time, with the spread over the rounds."""

from collections.abc import Callable
from time import process_time
from typing import Any

import numpy as np

Work = tuple[Callable[[], Any], int]  # function to time, and its number of solves


def rounds(works: dict[str, Work], count: int, warm: bool = False) -> dict[str, np.ndarray]:
    """Processor time (count,) [s] per solve of each work, alternating; unless `warm`, after a first round that compiles.

    Processor time, because other processes on the same core are not a cost of the method.
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
    """Median [min-max] of the rounds."""
    return f"{np.median(values):{form}} [{np.min(values):{form}}-{np.max(values):{form}}]"
