"""The flat arrays that describe a robot to the compiled code, and how its geometry is packed into them.

A robot with several tips has one chain for each tip; all chains read the same vector of joint coordinates.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ..compile.jit import cached
from .algebra import V3, at3, product, rotation_at
from .kinematics import RATIO, ROW, TAU, fk, own_coordinates, room
from .problem import fill
from .records import POINTS, SIZE, Array, Ends
from .starts import DISTANCE, FEATURES, PAD, SEEDS, known_configurations

__all__ = ["ROW", "Chain", "pack"]
WINDING = 5 * TAU  # During a search, an endless joint beyond this angle [rad] is brought back by multiples of 2 pi.
TURNING = 1e4  # A revolute joint with a wider range [rad] counts as endless when random starts are drawn.
LONGEST_UNIT = 1e4  # largest internal unit of length [m], unless the links are longer
LEAST_REACH = 1e-10  # A sum of link lengths below this [m] is only rounding, and the reach is then set to 1 m.


@cached
def forward_kinematics(rows, ends, Q, unit, T, J) -> None:
    """Fill T (N, 4, 4) with tip poses [m, base axes] and J with Jacobians at Q (N, n) [rad or m].

    J is (N, 6, n), or (0, 6, n) to skip the Jacobians. rows, ends and unit are arrays of the chain, see `Chain`.
    """
    n = Q.shape[1]
    box = Ends(ends, n)
    base, tool = rotation_at(ends, 0), rotation_at(ends, 12)
    size, angles = room(rows.shape[0])
    q, joints, trig = np.empty(n), np.empty(size), np.zeros(angles)
    own = own_coordinates(rows, n)
    task, kept, K = np.zeros(SIZE.task), np.empty(0), np.empty((n, 6))
    for t in range(Q.shape[0]):
        for i in range(n):
            q[i] = Q[t, i] / unit[i]
        now = fk(rows, q, joints, trig)
        tip = now.point + now.axes.times(at3(ends, 21))
        p = (base.times(tip) + at3(ends, 9)) * box.scale()
        x, y, z = product(base, product(now.axes, tool))
        T[t, 0, 0], T[t, 0, 1], T[t, 0, 2], T[t, 0, 3] = x.x, y.x, z.x, p.x
        T[t, 1, 0], T[t, 1, 1], T[t, 1, 2], T[t, 1, 3] = x.y, y.y, z.y, p.y
        T[t, 2, 0], T[t, 2, 1], T[t, 2, 2], T[t, 2, 3] = x.z, y.z, z.z, p.z
        T[t, 3, 0], T[t, 3, 1], T[t, 3, 2], T[t, 3, 3] = 0.0, 0.0, 0.0, 1.0
        if J.shape[0] > 0:
            fill(rows, own, task, kept, joints, tip, K, 0)
            for i in range(n):
                u = base.times(V3(K[i, 0], K[i, 1], K[i, 2])) * (box.scale() / unit[i])
                v = base.times(V3(K[i, 3], K[i, 4], K[i, 5])) * (1.0 / unit[i])
                J[t, 0, i], J[t, 1, i], J[t, 2, i] = u.x, u.y, u.z
                J[t, 3, i], J[t, 4, i], J[t, 5, i] = v.x, v.y, v.z


def poses_at(rows, ends, Q, unit, jacobian=False):
    """Return tip poses (N, 4, 4) [m] at Q (N, n) [rad or m] and, if asked for, Jacobians (N, 6, n); other arrays as in `Chain`."""
    Q = np.ascontiguousarray(np.atleast_2d(np.asarray(Q, dtype=float)))
    T = np.empty((len(Q), 4, 4))
    J = np.empty((len(Q) if jacobian else 0, 6, Q.shape[1]))
    forward_kinematics(rows, ends, Q, unit, T, J)
    return T, J


def evaluate(rows, ends, Q, unit, jacobian=False):
    """Return what `poses_at` returns, computed by numpy instead of compiled code, so that loading a robot compiles nothing."""
    L, (N, n) = len(rows), Q.shape
    scale, base, tip = ends[POINTS + 7 * n], np.eye(4), np.eye(4)
    for M, flat in ((base, ends[:12]), (tip, ends[12:24])):
        M[:3, :3], M[:3, 3] = flat[:9].reshape(3, 3), flat[9:]
    owner = rows[:, 8].astype(int)
    q = (Q / unit).T[owner]
    turn, slide = rows[:, 4, None] * q + rows[:, 5, None], rows[:, 6, None] * q + rows[:, 7, None]
    c, s = np.cos(turn), np.sin(turn)
    cb, sb = rows[:, 0, None], rows[:, 1, None]
    steps = np.zeros((L, N, 4, 4))
    steps[..., 0, 0], steps[..., 0, 1], steps[..., 0, 3] = c, -s, rows[:, 2, None]
    steps[..., 1, 0], steps[..., 1, 1], steps[..., 1, 2] = cb * s, cb * c, -sb
    steps[..., 2, 0], steps[..., 2, 1], steps[..., 2, 2] = sb * s, sb * c, cb
    steps[..., 1, 3], steps[..., 2, 3] = cb * rows[:, 3, None] - sb * slide, sb * rows[:, 3, None] + cb * slide
    steps[..., 3, 3] = 1.0
    frames = np.empty((L, N, 4, 4))
    at = np.broadcast_to(base, (N, 4, 4))
    for i in range(L):
        at = frames[i] = at @ steps[i]
    T = at @ tip
    point = T[:, :3, 3].copy()
    T[:, :3, 3] *= scale
    if not jacobian:
        return T, np.empty((0, 6, n))
    axes, points = frames[..., :3, 2], frames[..., :3, 3]
    turns = rows[:, 9, None, None] > 0.0
    linear = np.where(turns, np.cross(axes, point - points), axes)
    columns = (
        np.concatenate([scale * linear, np.where(turns, axes, 0.0)], axis=2) * (rows[:, 4] + rows[:, 6])[:, None, None]
    )
    J = np.zeros((n, N, 6))
    np.add.at(J, owner, columns)
    return T, J.transpose(1, 2, 0) / unit


class Chain(NamedTuple):
    """One serial chain from base to tip, as arrays for the compiled code, with L joints and n coordinates.

    Internal units: radians, and lengths divided by `scale`, a power of two near the arm's reach.
    """

    rows: np.ndarray  # (L, 10) geometry, one joint a row; the columns are listed at `kinematics.ROW`
    ends: np.ndarray  # one flat array: base and tip frames, joint limits and reach, see `records.Ends`
    seeds: np.ndarray  # (256, n) configurations to start from
    features: np.ndarray  # (13, 272) tip pose at each of `seeds`, to find those nearest a target, see `table`
    unit: np.ndarray  # (n,) size of an internal unit: 1 rad, or `scale` metres for a prismatic joint
    lower: np.ndarray  # (n,) lower limits [rad or m]
    upper: np.ndarray  # (n,) upper limits [rad or m]
    turns: np.ndarray  # (n,) 1 if a coordinate may wrap by 2 pi, within its limits or without limits, else 0
    scale: float  # internal unit of length [m]
    reach: float  # longest distance of the tip from the first joint [m]
    plain: bool  # whether there are no mimic joints, so that row i belongs to coordinate i

    @property
    def n(self) -> int:
        """Return the number of coordinates."""
        return len(self.lower)

    def forward(self, Q: np.ndarray, jacobian: bool = False) -> tuple[np.ndarray, np.ndarray]:
        """Return poses T_base_tip (N, 4, 4) [m] at Q (N, n) [rad or m] and, if asked for, Jacobians (N, 6, n).

        The Jacobians are in base axes, with the linear rows first.
        """
        return poses_at(self.rows, self.ends, Q, self.unit, jacobian)


def segments(rows: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Return the longest possible distance (L,) of each joint from the one before; infinite after an unlimited prismatic joint."""
    lengths = np.zeros(len(rows))
    for i, row in enumerate(rows):
        k = int(row[8])
        ends = [row[7]] if row[6] == 0.0 else [row[7] + row[6] * x for x in (lower[k], upper[k])]
        cross = 0.0 if i == 0 else np.hypot(row[2], row[3])
        lengths[i] = max(np.hypot(cross, d) for d in ends)
    return lengths


def start_range(
    lower: np.ndarray, upper: np.ndarray, slides: np.ndarray, turns: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the range, lower and upper ends (n,) [internal units], from which starts are drawn: the limits where both exist.

    A missing limit is replaced so that the range is one turn for a revolute joint, and two internal units of length for a prismatic
    one. The range is also one turn for a joint that may wrap and whose limits are wider apart than TURNING.
    """
    half = np.where(slides, 1.0, np.pi)
    low = np.where(np.isfinite(lower), lower, np.where(np.isfinite(upper), upper - 2 * half, -half))
    high = np.where(np.isfinite(upper), upper, low + 2 * half)
    wide = turns & (high - low > TURNING)
    low = np.where(wide, np.clip(-np.pi, low, high - TAU), low)
    return low, np.where(wide, low + TAU, high)


def table(rows: np.ndarray, ends: np.ndarray, seeds: np.ndarray, kinematics: Callable = poses_at) -> np.ndarray:
    """Return a table (13, N + PAD) by which the precomputed starts nearest to a target are found, a column for each of `seeds`.

    The features in a column are the tip's position, the last joint's rotation (9 numbers) and the squared norm of the position,
    each with a factor. Their scalar product with a target's pose is thus a squared distance, up to a constant.
    """
    count, n = seeds.shape
    tip, tail = ends[12:24], ends[POINTS + 7 * n :]
    flat = np.concatenate([np.eye(3).ravel(), np.zeros(3), ends[12 : POINTS + 7 * n], [1.0], tail[1:7]])
    T = kinematics(rows, flat, seeds, np.ones(n))[0]
    features = np.zeros((FEATURES, count + PAD), np.float32)
    features[:3, :count] = -2.0 * T[:, :3, 3].T
    rotation = T[:, :3, :3] @ tip[:9].reshape(3, 3).T
    features[3:12, :count] = -2.0 * DISTANCE.rotation * rotation.reshape(count, 9).T
    features[12, :count] = (T[:, :3, 3] ** 2).sum(1)
    return features


def coordinate_numbers(
    lower: np.ndarray, upper: np.ndarray, home: np.ndarray, slides: np.ndarray, turns: np.ndarray, scale: float
) -> tuple[np.ndarray, list[np.ndarray], np.ndarray, np.ndarray]:
    """Return what a chain stores about its n coordinates: units (n,), seven arrays (n,) for `records.Ends`, and ranges of starts.

    slides, turns (n,): whether a coordinate is a length, and whether it may wrap by 2 pi; lower, upper, home (n,) [rad or m].
    """
    unit = np.where(slides, scale, 1.0)
    low, high = start_range(lower / unit, upper / unit, slides, turns)
    # An endless joint is brought back after five turns during the search; the answer is moved by 2 pi k to the value nearest q0.
    endless = turns & np.isinf(lower) & np.isinf(upper)
    inside = np.where(endless, -WINDING, lower / unit), np.where(endless, WINDING, upper / unit), turns + 1.0 * endless
    return unit, [*inside, unit, low, high - low, home / unit], low, high


def resize(rows: np.ndarray, slides: np.ndarray, factor: float) -> None:
    """Multiply all lengths in the geometry `rows` (L, 10) by a factor, in place; slides (n,): whether a coordinate is a length."""
    rows[:, [2, 3, 7]] *= factor
    follows = ~slides[rows[:, 8].astype(int)] & (rows[:, 9] == 0.0)
    # A prismatic joint that mimics a revolute one moves by a length per radian, so its ratio is scaled as well.
    rows[follows, 6] *= factor


def lengths_only(rows: np.ndarray, n: int) -> np.ndarray:
    """Return an array (n,): whether each of n coordinates moves prismatic joints only; rows: (L, 10) geometry."""
    return ~np.isin(np.arange(n), rows[rows[:, 9] > 0.0, 8])


def reach_bounds(rows: np.ndarray, tip: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> list[float]:
    """Return six bounds on where an arm can reach with coordinates within lower, upper (n,); see `records.Ends.bound`."""
    lengths = segments(rows, lower, upper)
    tool = float(np.linalg.norm(tip[9:]))
    shortest = np.where(rows[1:, 6] != 0.0, 0.0, lengths[1:])
    first = rows[0]
    k = int(first[8])
    lift = [first[7]] * 2 if first[6] == 0.0 else sorted(first[7] + first[6] * x for x in (lower[k], upper[k]))

    def hole(parts: np.ndarray, rest: np.ndarray) -> float:
        """Return a lower bound on the distance between the ends of a chain: its longest part minus the others at their longest."""
        if not parts.any():
            return 0.0
        i = int(np.argmax(parts))
        return max(0.0, float(parts[i] - (rest.sum() - rest[i])))

    wrist, whole = lengths[1:], np.append(lengths[1:], tool)
    return [
        float(whole.sum()), hole(np.append(shortest, tool), whole), float(wrist.sum()), hole(shortest, wrist), *lift
    ]  # fmt: skip


def without_limits(rows: np.ndarray, ends: np.ndarray, n: int) -> np.ndarray:
    """Return a copy of `ends` (`records.Ends`) whose bounds on the reach hold even if joint limits are ignored."""
    endless = np.full(n, np.inf)
    free = ends.copy()
    free[POINTS + 7 * n + 1 : POINTS + 7 * n + 7] = reach_bounds(rows, ends[12:24], -endless, endless)
    return free


def without_wrap(ends: np.ndarray, n: int) -> np.ndarray:
    """Return a copy of `ends` (`records.Ends`) in which joints with limits never wrap by 2 pi; endless joints still do."""
    ends = ends.copy()
    turns = ends[..., POINTS + 2 * n : POINTS + 3 * n]
    turns[turns == 1.0] = 0.0
    return ends


def pack(
    rows: np.ndarray,
    base: np.ndarray,
    tip: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    home: np.ndarray,
) -> Chain:
    """Make the arrays of a chain for the compiled code.

    A coordinate may wrap by 2 pi if it turns a single joint and its range covers a full turn.

    Args:
        rows: (L, 10) geometry [m]; the columns are listed at `kinematics.ROW`.
        base: (12,) pose of the first joint's frame in the base: rotation matrix by rows, then origin [m].
        tip: (12,) pose of the tip in the last joint's frame: rotation matrix by rows, then origin [m].
        lower: (n,) lower limits [rad or m].
        upper: (n,) upper limits [rad or m].
        home: (n,) where a search without q0 starts [rad or m].

    Returns:
        The chain, with lengths in internal units (divided by a power of two near the reach).
    """
    rows, base, tip = rows.copy(), base.copy(), tip.copy()
    n = len(lower)
    owner = rows[:, 8].astype(int)
    slides = lengths_only(rows, n)
    # A coordinate may wrap by 2 pi only if it moves a single joint, with ratio 1.
    own = np.bincount(owner, minlength=n) == 1
    own[owner[np.abs(rows[:, 4] + rows[:, 6] - 1.0) > RATIO]] = False
    turns = (upper - lower >= TAU - 1e-9) & ~slides & own
    # The reach is the sum of all offsets and finite strokes, or one metre if that sum is infinite or only rounding.
    lengths, tool = segments(rows, lower, upper), np.linalg.norm(tip[9:])
    offsets = np.hypot(rows[:, 2], rows[:, 3]) + np.abs(rows[:, 7])
    reach = float(np.where(np.isfinite(lengths), lengths, offsets)[1:].sum() + tool)
    if rows[0, 6] != 0.0 and np.isfinite(lengths[0]):
        reach += float(abs(rows[0, 6]) * (upper[owner[0]] - lower[owner[0]]))
    if not LEAST_REACH < reach < np.inf:
        reach = 1.0
    # Some files give a prismatic joint a stroke of 1000 km to say "far". If that were the unit of length, a tolerance of 1e-6 m
    # would be lost in rounding.
    longest = max(float(offsets[1:].sum() + tool), LONGEST_UNIT)
    scale = float(2.0 ** np.clip(np.round(np.log2(min(reach, longest))), -1000, 1000))
    resize(rows, slides, 1.0 / scale)
    base[9:] /= scale
    tip[9:] /= scale
    unit, vectors, low, high = coordinate_numbers(lower, upper, home, slides, turns, scale)
    tail = [scale, *reach_bounds(rows, tip, lower / unit, upper / unit)]
    ends = np.concatenate([base, tip, *vectors, tail])
    seeds = known_configurations(low, high, home / unit, SEEDS)
    features = table(rows, ends, seeds, evaluate)
    features[12, :SEEDS] += DISTANCE.from_home * ((seeds - home / unit) ** 2).sum(1)
    return Chain(rows, ends, seeds, features, unit, lower, upper, turns.astype(float), scale, reach, bool(own.all()))


@cached
def joint_levers(rows, ends, Q, unit, D) -> None:
    """Fill D (N, L) with the distances [m] of the tip from each joint's axis at Q (N, n) [rad or m]; other arrays as in `Chain`."""
    n = Q.shape[1]
    size, angles = room(rows.shape[0])
    q, joints, trig = np.empty(n), np.empty(size), np.zeros(angles)
    for t in range(Q.shape[0]):
        for i in range(n):
            q[i] = Q[t, i] / unit[i]
        now = fk(rows, q, joints, trig)
        tip = now.point + now.axes.times(at3(ends, 21))
        for i in range(rows.shape[0]):
            arm = at3(joints, 6 * i).cross(tip - at3(joints, 6 * i + 3))
            D[t, i] = math.sqrt(arm.square()) * Ends(ends, n).scale()


ROWS = 2048  # number of precomputed starts of a robot with several tips, where each tip chooses the row from which its joints start


class TreeChain(NamedTuple):
    """The chains of F tips over n shared coordinates, as arrays for the compiled code."""

    rows: Array  # (L, 10) geometry of all chains, one after the other
    # (F, K) for each tip: `records.Ends`, number of joints of its chain, and n flags (1 if the coordinate moves the tip)
    ends: Array
    # (N, n) precomputed starts; a joint that moves several tips starts at the row chosen for one of them
    seeds: Array
    features: Array  # (F, 13, N + PAD) tip poses at the seeds, to find those nearest a target, see `table`
    unit: Array  # (n,) size of an internal unit: 1 rad, or `scale` metres for a prismatic joint
    lower: Array  # (n,) lower limits [rad or m]
    upper: Array  # (n,) upper limits [rad or m]
    scale: float  # internal unit of length [m], a power of two near the reach

    # Row i of a chain need not belong to coordinate i, because no chain has all coordinates.
    plain = False

    @property
    def turns(self) -> Array:
        """Return an array (n,): 0 if a coordinate never wraps by 2 pi, 1 if it wraps inside its limits, 2 if it is endless."""
        n = len(self.lower)
        return self.ends[0, POINTS + 2 * n : POINTS + 3 * n]

    @property
    def parts(self) -> list[Array]:
        """Return a list with the geometry of each tip's chain, an array (L, 10) for L joints."""
        return split_rows(self.rows, self.ends, len(self.lower))

    def forward(self, Q: Array, jacobian: bool = False) -> tuple[Array, Array]:
        """Return poses T_base_tip (N, F, 4, 4) [m] at Q (N, n) [rad or m] and, if asked for, Jacobians (N, 6 F, n).

        The Jacobians are in base axes, six rows for each tip, with the linear rows first.
        """
        parts = zip(self.parts, self.ends, strict=True)
        poses, stack = zip(*(poses_at(rows, ends, Q, self.unit, jacobian) for rows, ends in parts), strict=True)
        return np.stack(poses, axis=1), np.concatenate(stack, axis=1)


def split_rows(rows: Array, ends: Array, n: int) -> list[Array]:
    """Return the geometry of each tip's chain, cut from the rows (L, 10) of a tree over n coordinates; ends as in `TreeChain`."""
    return np.split(rows, np.cumsum(ends[:, -n - 1].astype(int))[:-1])


def pack_tree(chains: list[Chain], places: list[Array], lower: Array, upper: Array, home: Array) -> Chain | TreeChain:
    """Return the chains of several tips, joined with a common internal unit of length; for one tip, its chain itself.

    places[f][i] is the index, among the shared coordinates, of coordinate i of chain f; lower, upper, home (n,) [rad or m].
    """
    n, F = len(lower), len(chains)
    if F == 1:
        ends = chains[0].ends.copy()
        ends[POINTS + 6 * n : POINTS + 7 * n] = home / chains[0].unit
        return chains[0]._replace(ends=ends)
    scale = max(chain.scale for chain in chains)
    parts = []
    # Lengths are converted back to metres, without rounding, because the scales are powers of two.
    turns = upper - lower >= TAU - 1e-9
    for chain, place in zip(chains, places, strict=True):
        rows = chain.rows.copy()
        resize(rows, lengths_only(rows, chain.n), chain.scale)
        rows[:, 8] = place[rows[:, 8].astype(int)]
        parts.append(rows)
        turns[place] &= chain.turns > 0.0
    slides = lengths_only(np.concatenate(parts), n)
    unit, vectors, low, high = coordinate_numbers(lower, upper, home, slides, turns, scale)
    ends = np.empty((F, POINTS + 8 * n + 8))
    for f, (chain, place, rows) in enumerate(zip(chains, places, parts, strict=True)):
        factor = chain.scale / scale
        resize(rows, slides, 1.0 / scale)
        points = chain.ends[:POINTS].copy()
        points[[9, 10, 11, 21, 22, 23]] *= factor
        moves = np.zeros(n)
        moves[place] = 1.0
        ends[f] = np.concatenate([points, *vectors, [scale], chain.ends[-6:] * factor, [len(rows)], moves])
    seeds = known_configurations(low, high, home / unit, ROWS)
    features = np.stack([table(rows, end, seeds, evaluate) for rows, end in zip(parts, ends, strict=True)])
    return TreeChain(np.concatenate(parts), ends, seeds, features, unit, lower, upper, scale)
