"""What is proven about a motion between the poses of a path: deviation of the tips, clearance, contacts."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np


class Contact(NamedTuple):
    """A contact of two shapes: its position on the path (3.5: halfway from pose 3 to pose 4), and the names of the shapes."""

    place: float
    pair: tuple[str, str]


@dataclass(frozen=True, eq=False)
class Continuity:
    """What is proven about a motion that is linear in the joints between M configurations, the rows of a curve (M, n).

    deviation (M-1,) [m] and turn (M-1,) [rad]: upper bounds on how far a tip's position and rotation leave the interpolated pose
    between two rows, in the pose components that count; NaN where the motion breaks. clearance [m]: proven least distance of any
    two parts (0: not proven; None: collisions were not checked). contacts: where shapes touch. unproven: positions on the path
    (3.5: halfway from pose 3 to pose 4) where shapes are too close to rule out contact. lacking (2, M-1): the part of deviation and
    turn that cannot be avoided, because the arm has too few joints to follow the interpolated poses.
    """

    deviation: np.ndarray
    turn: np.ndarray
    lacking: np.ndarray
    clearance: float | None = None
    contacts: tuple[Contact, ...] = ()
    unproven: tuple[float, ...] = ()

    @property
    def largest(self) -> tuple[float, float]:
        """Return the largest deviation [m] and the largest rotation deviation [rad] of the whole motion; 0 if nothing moves."""
        return _largest(self.deviation), _largest(self.turn)

    @property
    def judged(self) -> tuple[np.ndarray, np.ndarray]:
        """Return deviation (M-1,) [m] and turn (M-1,) [rad], less the part that an arm with too few joints cannot avoid."""
        return self.deviation - self.lacking[0], self.turn - self.lacking[1]


def _largest(values: np.ndarray) -> float:
    return float(np.nanmax(values)) if np.isfinite(values).any() else 0.0
