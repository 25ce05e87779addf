"""Starts of a search in which some joints are held: every start has them where the first one has them."""

import numpy as np

from ..kernel.chain import table
from ..kernel.slots import E_VECTORS
from .options import Options


def held_joints(options: Options) -> np.ndarray:
    """Places of the joints whose weight is 0."""
    return np.flatnonzero(np.array(options.joint_weights or (1.0,)) == 0.0)


def pin(arrays: tuple, held: np.ndarray, at: np.ndarray) -> tuple:
    """Arrays of a chain (or a tree's) whose table of starts and random starts have the `held` joints at `at` (kernel units)."""
    *front, seeds, _ = arrays
    rows, ends = front[0], front[1 if len(front) == 2 else 2].copy()
    seeds, n = seeds.copy(), seeds.shape[1]
    seeds[:, held] = at
    ends[..., E_VECTORS + 4 * n + held] = at
    ends[..., E_VECTORS + 5 * n + held] = 0.0  # width of the range that random starts are drawn from
    if len(front) == 2:
        return rows, ends, seeds, table(rows, ends, seeds)
    cut = front[1]
    parts = zip(np.split(rows, cut[1:-1]), ends, strict=True)
    return rows, cut, ends, *front[3:], seeds, np.stack([table(part, end, seeds) for part, end in parts])
