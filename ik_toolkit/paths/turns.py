"""Joints with more than a full turn: copies of a track on other turns, and the turn chosen for each piece of a path.

The limits of such a joint apply to a whole continuous piece: the total winding must fit. That cannot be seen from state to state,
so paths are first searched without these limits. If the best one fits, nothing is lost; if not, the joint's tracks are copied to
every turn, and its limits are enforced from state to state.
"""

import numpy as np

from ..kernel.kinematics import TAU

ROUNDING = 1e-6  # rad: tracks are stored in single precision


def alive(Q: np.ndarray, span: np.ndarray, limits: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """Which states (N, K) of the tracks Q (N, K, n) exist (spans (K, 2)) and keep the limits (2, n) of the given joints (n,)."""
    t = np.arange(len(Q))[:, None]
    there = (span[:, 0] <= t) & (t <= span[:, 1])
    for i in np.flatnonzero(joints):
        there &= (Q[:, :, i] >= limits[0, i] - ROUNDING) & (Q[:, :, i] <= limits[1, i] + ROUNDING)
    return there


def copies(Q: np.ndarray, span: np.ndarray, i: int, low: float, high: float) -> tuple[np.ndarray, np.ndarray]:
    """Tracks and spans with joint i on every turn that lies inside its limits somewhere."""
    t = np.arange(len(Q))[:, None]
    there = (span[:, 0] <= t) & (t <= span[:, 1])
    least = np.where(there, Q[:, :, i], np.inf).min(axis=0)
    most = np.where(there, Q[:, :, i], -np.inf).max(axis=0)
    first = np.ceil((low - ROUNDING - most) / TAU).astype(int)
    last = np.floor((high + ROUNDING - least) / TAU).astype(int)
    made, spans = [], []
    for turn in range(int(first.min()), int(last.max()) + 1):
        fits = (first <= turn) & (turn <= last)
        part = Q[:, fits].copy()
        part[:, :, i] += np.float32(TAU * turn)
        made.append(part)
        spans.append(span[fits])
    return np.concatenate(made, axis=1), np.concatenate(spans)


def unwound(
    q: np.ndarray,
    breaks: list[int],
    free: np.ndarray,
    limits: np.ndarray,
    ends: tuple[np.ndarray | None, np.ndarray | None],
    fixed: list[bool],
) -> set[int]:
    """Unwrap joints `free` (n,) of a path q (N, n) in place, piece by piece; returns the joints that do not fit their limits.

    breaks: poses after which it reconfigures; limits (2, n), infinite for continuous joints. Each piece is put on the legal turn
    nearest to the end of the previous one, the first on that nearest ends[0], the last, if fixed[1], on that of ends[1].
    """
    unfit: set[int] = set()
    there = np.flatnonzero(np.isfinite(q[:, 0]))
    if not len(there):
        return unfit
    cut = np.isin(there[:-1], breaks) | (np.diff(there) > 1)
    pieces = np.split(there, np.flatnonzero(cut) + 1)
    before = ends[0]
    for k, piece in enumerate(pieces):
        near, at, must = before, piece[0], k == 0 and fixed[0]
        if piece is pieces[-1] and fixed[1] and not must:
            near, at, must = ends[1], piece[-1], True
        for i in np.flatnonzero(free):
            q[piece, i] = np.unwrap(q[piece, i])
            low, high = limits[:, i]
            first = np.ceil((low - ROUNDING - q[piece, i].min()) / TAU)
            last = np.floor((high + ROUNDING - q[piece, i].max()) / TAU)
            aim = near[i] if near is not None else 0.5 * (low + high) if np.isfinite(high - low) else 0.0
            turn = np.rint((aim - q[at, i]) / TAU)
            if first > last or (must and not first <= turn <= last):
                unfit.add(int(i))
            q[piece, i] += TAU * np.clip(turn, first, max(first, last))
            far = len(pieces) == 1 and fixed[0] and fixed[1] and abs(q[-1, i] - ends[1][i]) > np.pi  # pyright: ignore
            if far and np.isfinite(high - low):
                unfit.add(int(i))
        before = q[piece[-1]]
    return unfit
