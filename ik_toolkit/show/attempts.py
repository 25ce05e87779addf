"""Separates the attempts in a solve's history: the one that gave the result, and the others."""

from collections.abc import Mapping
from typing import Any

import numpy as np


def attempts(history: Mapping[str, Any], q: Any = None) -> tuple[np.ndarray, list[np.ndarray]]:
    """Return the rows of the winning attempt, up to its result, and those of each other attempt.

    If the result q (n,) is not among the rows because it was refined, the last row is used instead, and without q the
    row with the smallest position error. A history without the column `attempt` is one attempt.
    """
    error = np.asarray(history["position_error"], dtype=float)
    number = np.asarray(history.get("attempt", np.zeros(len(error), dtype=int)))
    rows = np.arange(len(error))
    if q is None:
        answer = int(np.argmin(error))
    else:
        same = np.flatnonzero((np.asarray(history["q"]) == q).all(axis=1))
        answer = int(same[-1]) if len(same) else len(error) - 1
    won = number[answer]
    others = [rows[number == one] for one in np.unique(number[number >= 0]) if one != won]
    return rows[(number == won) & (rows <= answer)], others


def iterates(result: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[np.ndarray]]:
    """Return joint values (N, n), position errors [m] and angles [rad] of the winning attempt of a Result with history.

    They end at the result; an angle that does not count is NaN. The last value lists the rows of the other attempts.
    """
    won, others = attempts(result.history, result.q)
    Q, position, angle = (np.asarray(result.history[key])[won] for key in ("q", "position_error", "orientation_error"))
    if not np.array_equal(Q[-1], result.q):  # The answer was refined after the search.
        Q, position = np.vstack([Q, result.q]), np.append(position, result.position_error)
        angle = np.append(angle, np.nan if result.orientation_error is None else result.orientation_error)
    return Q, position, angle, others
