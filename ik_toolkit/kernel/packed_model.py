"""All arrays of a robot that a search reads, packed into one, because passing an array to compiled code takes 60 ns.

The packed array begins with five counts (see `array_sizes`); rows, ends, seeds and features of a `chain.Chain` or a
`chain.TreeChain` follow. The features are single precision, so each float64 of the array holds two of them.
"""

from typing import NamedTuple

import numpy as np

from ..compile.array_view import LINE, fold, space
from ..compile.jit import compiled, inline
from .kinematics import ROW
from .records import Array
from .starts import FEATURES, PAD

COUNTS = 5  # how many numbers at the start of a packed array give the shapes of its parts


def join(rows: np.ndarray, ends: np.ndarray, seeds: np.ndarray, features: np.ndarray) -> np.ndarray:
    """Return the arrays of a chain or a tree (see `chain.Chain`, `chain.TreeChain`) packed into one array (K,)."""
    first = len(rows), ends.size // ends.shape[-1], ends.shape[-1], seeds.shape[1], len(seeds)
    return np.concatenate([first, rows.ravel(), ends.ravel(), seeds.ravel(), features.ravel().view(float)])


@compiled
class Parts(NamedTuple):
    """The arrays of a robot that `join` has packed into one: L joints, F tips, n coordinates and N precomputed starts."""

    rows: Array  # (L, 10) geometry of the joints
    ends: Array  # (F * K,) K numbers for each tip: base, tip and limits, see `records.Ends`
    seeds: Array  # (N, n) configurations to start from
    features: Array  # (F * FEATURES, N + PAD) features of the seeds, float32 (see `chain.table`)


@inline
def array_sizes(chain):
    """Return the five counts at the start of a packed array: joints, tips, numbers in `ends` of a tip, coordinates, and starts."""
    return int(chain[0]), int(chain[1]), int(chain[2]), int(chain[3]), int(chain[4])


@inline
def part(chain):
    """Return the four arrays that `join` has packed into the array `chain`, as views of it."""
    L, F, K, n, N = array_sizes(chain)
    at_ends = COUNTS + ROW * L
    at_seeds = at_ends + F * K
    seeds = fold(chain[at_seeds:], np.float64, N, n)
    features = fold(chain[at_seeds + N * n :], np.float32, F * FEATURES, N + PAD)
    return Parts(fold(chain[COUNTS:], np.float64, L, ROW), chain[at_ends:at_seeds], seeds, features)


@inline
def scratch(chain):
    """Return the length of the scratch memory that a search needs for a packed array `chain`.

    It has room for a copy of `ends`, in which the option `follow` narrows the limits.
    """
    L, F, K, n, N = array_sizes(chain)
    return space(n, 6 * F, L, N) + F * K + LINE
