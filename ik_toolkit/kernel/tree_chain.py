"""The flat arrays of several tips of one tree: one chain per tip, all reading one shared vector of coordinates."""

from typing import NamedTuple

import numpy as np

from .chain import WINDING, Chain, box, evaluate, run, table
from .kinematics import TAU
from .records import POINTS, Array

ROWS = 2048  # of the table of starts; each tip picks its own joints from it


class TreeChain(NamedTuple):
    """Chains of F tips over n shared coordinates, ready for the kernel.

    rows (L, 10) of all chains, one after the other; ends (F, ...) as in Chain, with the shared coordinates, then the number of
    rows of the tip and `moves` (n), 1 where a coordinate moves it; seeds (N, n) and features (F, 13, N + PAD) are the table of
    starts: each tip picks its own joints from it, the first the shared ones too. unit, lower, upper (n,); scale: length of one
    kernel unit [m].
    """

    rows: Array
    ends: Array
    seeds: Array
    features: Array
    unit: Array
    lower: Array
    upper: Array
    scale: float

    plain = False  # columns are scattered: no chain has all the coordinates

    @property
    def turns(self) -> Array:
        """As in Chain: 0 where a coordinate never wraps."""
        n = len(self.lower)
        return self.ends[0, POINTS + 2 * n : POINTS + 3 * n]

    @property
    def parts(self) -> list[Array]:
        """Rows of each chain."""
        return split(self.rows, self.ends, len(self.lower))

    def forward(self, Q: Array, jacobian: bool = False) -> tuple[Array, Array]:
        """T_base_tip (N, F, 4, 4) and, when asked, stacked Jacobians (N, 6 F, n; base axes, linear first) at Q (N, n)."""
        Q = np.ascontiguousarray(np.atleast_2d(np.asarray(Q, dtype=float)))
        parts = zip(self.parts, self.ends, strict=True)
        poses, stack = zip(*(run(rows, ends, Q, self.unit, jacobian) for rows, ends in parts), strict=True)
        return np.stack(poses, axis=1), np.concatenate(stack, axis=1)


def split(rows: Array, ends: Array, n: int) -> list[Array]:
    """Rows of each chain of a tree over n coordinates."""
    return np.split(rows, np.cumsum(ends[:, -n - 1].astype(int))[:-1])


def pack_tree(chains: list[Chain], places: list[Array], lower: Array, upper: Array, home: Array) -> TreeChain:
    """Join chains; places[f][i] is the shared coordinate of coordinate i of chain f. lower, upper, home (n,) [rad or m]."""
    n, F = len(lower), len(chains)
    scale = max(chain.scale for chain in chains)
    parts = []
    for chain, place in zip(chains, places, strict=True):  # back to metres (scales are powers of two, so exactly)
        rows, own = chain.rows.copy(), chain.rows[:, 8].astype(int)
        turning = [rows[own == k, 9].any() for k in range(chain.n)]
        rows[:, [2, 3, 7]] *= chain.scale
        for i, k in enumerate(own):
            if turning[k] and not rows[i, 9]:
                rows[i, 6] *= chain.scale
        rows[:, 8] = place[own]
        parts.append(rows)
    every = np.concatenate(parts)
    slides = np.array([not every[every[:, 8] == k, 9].any() for k in range(n)])
    unit = np.where(slides, scale, 1.0)
    turns = upper - lower >= TAU - 1e-9
    for chain, place in zip(chains, places, strict=True):
        turns[place] &= chain.turns > 0.0
    endless = turns & np.isinf(lower) & np.isinf(upper)
    low, high = box(lower / unit, upper / unit, slides, turns)
    inside = [
        np.where(endless, -WINDING, lower / unit),
        np.where(endless, WINDING, upper / unit),
        turns + 1.0 * endless,
    ]
    vectors = [*inside, unit, low, high - low, home / unit]
    ends = np.empty((F, POINTS + 8 * n + 8))
    for f, (chain, place, rows) in enumerate(zip(chains, places, parts, strict=True)):
        factor = chain.scale / scale
        rows[:, [2, 3, 7]] /= scale
        for i, k in enumerate(rows[:, 8].astype(int)):
            if not slides[k] and not rows[i, 9]:
                rows[i, 6] /= scale
        points = chain.ends[:POINTS].copy()
        points[[9, 10, 11, 21, 22, 23]] *= factor
        moves = np.zeros(n)
        moves[place] = 1.0
        ends[f] = np.concatenate([points, *vectors, [scale], chain.ends[-6:] * factor, [len(rows)], moves])
    seeds = np.random.default_rng(0x5EED7AB1E).uniform(low, high, (ROWS, n))
    features = np.stack([table(rows, end, seeds, evaluate) for rows, end in zip(parts, ends, strict=True)])
    return TreeChain(np.concatenate(parts), ends, seeds, features, unit, lower, upper, scale)
