"""Times of the reports: works that take turns, in processor time, with the spread over the rounds."""

from collections.abc import Callable
from time import process_time
from typing import Any

import numpy as np

Work = tuple[Callable[[], Any], int]  # what is done, and how many solves that is


def rounds(works: dict[str, Work], count: int, warm: bool = False) -> dict[str, np.ndarray]:
    """Processor time (count,) [s] a solve of each work, in turns; unless `warm`, after a round that compiles.

    Processor time, because another process that gets the core in between is no cost of the method.
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
    """Median [least-most] of the rounds."""
    return f"{np.median(values):{form}} [{np.min(values):{form}}-{np.max(values):{form}}]"
