"""All that a search reads of a robot in one array: each array that a call from Python hands over takes it 60 nanoseconds.

First five counts, see `Parts`; then rows, ends, seeds and features as `chain.Chain` and `tree_chain.TreeChain` have them, one
after the other. The features are single precision, two to a number.
"""

from typing import NamedTuple

import numpy as np

from ..compile.array_view import LINE, fold, space
from ..compile.jit import compiled, inline
from .kinematics import ROW
from .records import Array
from .starts import FEATURES, PAD

COUNTS = 5


def join(rows: np.ndarray, ends: np.ndarray, seeds: np.ndarray, features: np.ndarray) -> np.ndarray:
    """One array (K,) of the arrays of a chain, or a tree's."""
    first = len(rows), ends.size // ends.shape[-1], ends.shape[-1], seeds.shape[1], len(seeds)
    return np.concatenate([first, rows.ravel(), ends.ravel(), seeds.ravel(), features.ravel().view(float)])


@compiled
class Parts(NamedTuple):
    """The arrays again, of L joints, F tips, n coordinates and N known configurations."""

    rows: Array  # (L, 10)
    ends: Array  # (F * numbers of a tip,)
    seeds: Array  # (N, n)
    features: Array  # (F * FEATURES, N + PAD), float32


@inline
def array_sizes(chain):
    """Joints, tips, numbers of a tip, coordinates, known configurations."""
    return int(chain[0]), int(chain[1]), int(chain[2]), int(chain[3]), int(chain[4])


@inline
def part(chain):
    """Parts of a joined array, as views."""
    L, F, K, n, N = array_sizes(chain)
    at_ends = COUNTS + ROW * L
    at_seeds = at_ends + F * K
    seeds = fold(chain[at_seeds:], np.float64, N, n)
    features = fold(chain[at_seeds + N * n :], np.float32, F * FEATURES, N + PAD)
    return Parts(fold(chain[COUNTS:], np.float64, L, ROW), chain[at_ends:at_seeds], seeds, features)


@inline
def scratch(chain):
    """Length of a block with room for a search on a joined array, and for ends narrowed by `follow`."""
    L, F, K, n, N = array_sizes(chain)
    return space(n, 6 * F, L, N) + F * K + LINE
