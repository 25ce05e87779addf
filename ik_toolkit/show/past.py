"""Undo in the panel: where the robot stood and what its targets were before a visitor's last changes."""

import time
from typing import Any

import numpy as np

KEPT = 100  # changes
TOGETHER = 1.0  # [s] changes of one kind that follow each other faster are one: a drag, a slider that is pushed


class Past:
    """What can be undone. Entries are (q (n,), poses (4, 4) of the targets by tip)."""

    def __init__(self) -> None:
        """Nothing has happened."""
        self._entries: list[tuple[np.ndarray, dict[str, np.ndarray]]] = []
        self._last = "", 0.0

    def note(self, name: str, q: np.ndarray, targets: dict[str, Any]) -> None:
        """Keep what there was before a change of some kind."""
        now = time.monotonic()
        kind, at = self._last
        self._last = name, now
        if kind != name or now - at > TOGETHER:
            self._entries = [*self._entries[1 - KEPT :], (q.copy(), {tip: T.copy() for tip, T in targets.items()})]

    def back(self) -> tuple[np.ndarray, dict[str, np.ndarray]] | None:
        """Take what there was before the last change; None when there was none."""
        self._last = "", 0.0
        return self._entries.pop() if self._entries else None
