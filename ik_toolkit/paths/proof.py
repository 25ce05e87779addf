"""What is proven about a motion between the poses."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np


class Contact(NamedTuple):
    """A contact: place among the poses (3.5: halfway from pose 3 to pose 4), and the names of the pair."""

    place: float
    pair: tuple[str, str]


@dataclass(frozen=True, eq=False)
class Continuity:
    """What is proven about a motion that is linear in the joints between the knots of a curve (M, n).

    deviation (M-1,) [m] and turn (M-1,) [rad]: bounds on a tip's deviation from the interpolated pose between two knots, in the
    components that count; NaN where the motion breaks. lacking (2, M-1): the part of both that an arm leaves because it has fewer
    directions than the targets, or None. clearance [m]: nothing comes nearer than this anywhere (0: not proven;
    None: collisions were not checked). contacts; unproven: places where shapes are too close to rule out contact.
    """

    deviation: np.ndarray
    turn: np.ndarray
    clearance: float | None = None
    contacts: tuple[Contact, ...] = ()
    unproven: tuple[float, ...] = ()
    lacking: np.ndarray | None = None

    @property
    def largest(self) -> tuple[float, float]:
        """Largest deviation [m] and turn [rad]; 0 where nothing moves."""
        return _largest(self.deviation), _largest(self.turn)

    @property
    def judged(self) -> tuple[np.ndarray, np.ndarray]:
        """Deviation (M-1,) [m] and turn (M-1,) [rad] without what the arm can do nothing about."""
        return (
            (self.deviation, self.turn)
            if self.lacking is None
            else (self.deviation - self.lacking[0], self.turn - self.lacking[1])
        )


def _largest(values: np.ndarray) -> float:
    return float(np.nanmax(values)) if np.isfinite(values).any() else 0.0
