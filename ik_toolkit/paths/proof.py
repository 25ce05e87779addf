"""What is proven of a motion between the poses."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np


class Contact(NamedTuple):
    """Where the motion touches: place among the poses (3.5: halfway from pose 3 to pose 4), and the names of the pair."""

    place: float
    pair: tuple[str, str]


@dataclass(frozen=True, eq=False)
class Continuity:
    """What is proven of a motion that is linear in the joints between the knots of a curve (M, n).

    deviation (M-1,) [m] and turn (M-1,) [rad]: bounds on how far a tip leaves the interpolated pose between two knots, counting
    what counts; NaN where the motion breaks. clearance [m]: nothing comes nearer than this, anywhere on the way (0: not
    proven; None: collisions were not asked for). contacts; unproven: places where shapes are too close to tell without contact.
    """

    deviation: np.ndarray
    turn: np.ndarray
    clearance: float | None = None
    contacts: tuple[Contact, ...] = ()
    unproven: tuple[float, ...] = ()

    @property
    def largest(self) -> tuple[float, float]:
        """Largest deviation [m] and turn [rad]; 0 where nothing moves."""
        return _largest(self.deviation), _largest(self.turn)


def _largest(values: np.ndarray) -> float:
    return float(np.nanmax(values)) if np.isfinite(values).any() else 0.0
