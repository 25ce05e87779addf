"""Orientations 180 degrees apart: there are two shortest rotations from one to the next, and one must be chosen.

The choice is made by rotating the second pose by far less than its tolerance, so that everything else finds one shortest way.
"""

import numpy as np

from ..solvers.result import SPOKEN
from ..tracking.reference import exp

DOUBT = 0.1  # share of the tolerance: a rotation this close to half a turn may go either way
SHORT = 1e-10  # [rad] by which the chosen rotation is shorter than half a turn: rounding is 1e-16


class HalfTurns:
    """Half turns between poses T (N, F, 4, 4): gaps (P,), each from pose k to the next; tips (P,); axes (P, 3), base axes.

    The first choice alternates: each half turn undoes the direction of the previous one.
    """

    def __init__(self, T: np.ndarray, kinds: tuple, tolerance: float) -> None:
        """Find them among the poses; tolerance [rad] of their orientation."""
        self._T = T
        gaps, tips, axes = [], [], []
        for f, kind in enumerate(kinds):
            if kind in SPOKEN:
                continue
            R = T[1:, f, :3, :3] @ np.swapaxes(T[:-1, f, :3, :3], 1, 2)
            sine = 0.5 * np.linalg.norm(
                np.stack([R[:, i, j] - R[:, j, i] for i, j in ((0, 1), (0, 2), (1, 2))]), axis=0
            )
            before = np.zeros(3)
            for k in np.flatnonzero((sine <= DOUBT * tolerance) & (np.trace(R, axis1=1, axis2=2) < 0.0)).tolist():
                square = 0.25 * (R[k] + R[k].T) + 0.5 * np.eye(3)  # outer product of the axis with itself
                axis = square[:, np.argmax(np.diag(square))]
                before = axis * ((-1.0 if axis @ before > 0.0 else 1.0) / np.linalg.norm(axis))
                gaps.append(k)
                tips.append(f)
                axes.append(before)
        self.gaps, self.tips, self.axes = np.array(gaps, dtype=int), tips, np.array(axes).reshape(-1, 3)

    def turn_round(self, gaps: list[int]) -> bool:
        """Rotate the other way at these gaps; False if none of them is a half turn."""
        meant = np.isin(self.gaps, gaps)
        self.axes[meant] *= -1.0
        return bool(meant.any())

    def poses(self) -> np.ndarray:
        """The poses (N, F, 4, 4) with a unique shortest rotation between neighbours."""
        T = self._T.copy() if len(self.gaps) else self._T
        for p in np.argsort(self.gaps, kind="stable").tolist():
            k, f = self.gaps[p], self.tips[p]
            T[k + 1, f, :3, :3] = exp((np.pi - SHORT) * self.axes[p : p + 1])[0] @ T[k, f, :3, :3]
        return T
