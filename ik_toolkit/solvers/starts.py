"""Starts of a search in which some joints are held: every start has them at their values in the first."""

import numpy as np

from ..kernel.chain import table
from ..kernel.records import POINTS
from ..kernel.tree_chain import split
from .options import Options


def held_joints(options: Options) -> np.ndarray:
    """Places of the joints whose weight is 0."""
    return np.flatnonzero(np.array(options.joint_weights or (1.0,)) == 0.0)


def pin(arrays: tuple, held: np.ndarray, at: np.ndarray) -> tuple:
    """Arrays of a chain (or a tree's) whose table of starts and random starts have the `held` joints at `at` (kernel units)."""
    rows, ends, seeds, _ = arrays
    ends, seeds, n = ends.copy(), seeds.copy(), seeds.shape[1]
    seeds[:, held] = at
    ends[..., POINTS + 4 * n + held] = at
    ends[..., POINTS + 5 * n + held] = 0.0  # width of the range that random starts are drawn from
    return with_seeds(rows, ends, seeds)


def with_seeds(rows: np.ndarray, ends: np.ndarray, seeds: np.ndarray) -> tuple:
    """Arrays of a chain, or a tree's, with another table of starts (N, n), in kernel units."""
    if ends.ndim == 1:
        return rows, ends, seeds, table(rows, ends, seeds)
    parts = zip(split(rows, ends, seeds.shape[1]), ends, strict=True)
    return rows, ends, seeds, np.stack([table(part, end, seeds) for part, end in parts])
