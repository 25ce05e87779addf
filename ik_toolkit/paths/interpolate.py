"""Interpolation between poses: straight lines in position, rotations about one fixed axis (geodesics)."""

import numpy as np
import pinocchio as pin

from ..kernel.counted_error import FREE, POSITION
from ..motion.reference import exp


def interpolate_poses(T: np.ndarray, at: np.ndarray, kinds: tuple) -> np.ndarray:
    """Return poses (M, F, 4, 4) at places `at` (M,) among the poses T (N, F, 4, 4).

    Place 3.5 is halfway from pose 3 to pose 4. Positions lie on the straight line, rotations on the geodesic. kinds: a
    target kind per tip; the rotation of a tip whose orientation is free is copied from the pose before.
    """
    k = np.minimum(at.astype(int), max(len(T) - 2, 0))
    share = at - k
    made = T[k].copy()
    if len(T) < 2:
        return made
    made[..., :3, 3] += share[:, None, None] * (T[k + 1][..., :3, 3] - T[k][..., :3, 3])
    for f, kind in enumerate(kinds):
        if kind in (POSITION, FREE):
            continue
        between = np.flatnonzero(share > 0.0)
        gaps, which = np.unique(k[between], return_inverse=True)
        turns = np.array([pin.log3(T[j, f, :3, :3].T @ T[j + 1, f, :3, :3]) for j in gaps.tolist()]).reshape(-1, 3)
        made[between, f, :3, :3] = T[k[between], f, :3, :3] @ exp(share[between, None] * turns[which])
    return made
