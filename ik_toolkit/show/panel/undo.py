"""Undo in the panel: the robot's configuration and targets before a visitor's last changes."""

import time
from typing import Any

import numpy as np

KEPT = 100  # Number of changes that can be undone.
TOGETHER = 1.0  # Changes of one kind within this time [s] are merged, such as a drag or a slider being moved.


class Past:
    """The states before a visitor's changes: pairs of q (n,) and poses (4, 4) of the targets by tip."""

    def __init__(self) -> None:
        """Start with an empty history."""
        self._entries: list[tuple[np.ndarray, dict[str, np.ndarray]]] = []
        self._last = "", 0.0

    def note(self, name: str, q: np.ndarray, targets: dict[str, Any]) -> None:
        """Store the state before a change of the given kind."""
        now = time.monotonic()
        kind, at = self._last
        self._last = name, now
        if kind != name or now - at > TOGETHER:
            self._entries = [*self._entries[1 - KEPT :], (q.copy(), {tip: T.copy() for tip, T in targets.items()})]

    def back(self) -> tuple[np.ndarray, dict[str, np.ndarray]] | None:
        """Remove and return the state before the last change, or None if there is none."""
        self._last = "", 0.0
        return self._entries.pop() if self._entries else None
