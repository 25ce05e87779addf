"""The cells of a map of reach, and the poses asked for at their centres."""

import os
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ..errors import InvalidOption, InvalidTarget, floats, whole
from ..kernel.checks import RIGID
from ..kernel.counted_error import KIND
from ..robot.robot import Robot
from ..solvers.batch.targets import ROUGH, known, mended
from ..validate import positive
from .workspace import envelope


class GridEffort(NamedTuple):
    """How much work a study of reachability spends on each answer; `scripts/benchmarks/reach.py` measures what it misses."""

    few: int = 4  # number of attempts at each target of a grid, before the configurations of its neighbours are tried as starts
    # number of attempts at an unreached, unproven cell that touches a reached one, and at single poses, which have no neighbours
    many: int = 50
    # undecided cells beside reached ones are solved in `groups` groups, each with its own random starts
    groups: int = 16
    # number of solver attempts at each undecided answer that the audit (a check by random sample) tries again
    audited: int = 1000
    chunk: int = 2**16  # number of answers (cell and orientation) that are computed at a time, then written to the file
    cells: int = 40  # number of cells along the longest side of a region, unless the resolution is given


MOST_AXES = 1_000_000  # largest number of tool axes; neighbouring axes are then 0.2 degrees apart
EFFORT = GridEffort()


@dataclass(frozen=True, eq=False)
class Grid:
    """The cells of a map, and the poses asked for at their centres.

    Attributes:
        low: Lower corner (3,) of the first cell [m], base frame.
        size: Width (3,) of a cell [m]; 0 along an axis of a single plane.
        shape: Number of cells along x, y and z; (N, 1, 1) for single poses.
        rotations: R_base_tip (K, 3, 3) asked for at every centre; None if the orientation is free.
        free: Whether the tip may turn about its own `axis` at each of the rotations.
        poses: Single poses (N, 4, 4), instead of cells; or None.
        axis: The tip axis (3,) about which it may turn.
    """

    low: np.ndarray
    size: np.ndarray
    shape: tuple[int, ...]
    rotations: np.ndarray | None = None
    free: bool = False
    poses: np.ndarray | None = None
    axis: tuple[float, ...] = (0.0, 0.0, 1.0)

    @property
    def cells(self) -> int:
        """Number of cells of the map, or of single poses."""
        return int(np.prod(self.shape, dtype=object))

    @property
    def turns(self) -> int:
        """Number of orientations that are asked for at the centre of each cell."""
        return 1 if self.rotations is None else len(self.rotations)

    @property
    def answers(self) -> int:
        """Number of answers, one for each cell and orientation."""
        return self.cells * self.turns

    def memory(self, n: int) -> int:
        """Return the largest memory [bytes] of a study with n joints, in addition to that of the program."""
        # Each answer needs its q, its state, two numbers, and bits that say which neighbours were tried; each cell needs the best q
        # and its measures.
        return self.answers * (8 * n + 1 + 8 + 4) + self.cells * (8 * n + 16) + EFFORT.chunk * 8 * (2 * 16 + 3 * n + 20)

    @property
    def low_centre(self) -> np.ndarray:
        """Centre (3,) of the first cell [m]."""
        return self.low + 0.5 * self.size

    def centres(self) -> np.ndarray:
        """Return the centres (N, 3) of all cells [m], in the order of the answers."""
        return self.targets(np.arange(self.cells) * self.turns)[:, :3, 3] if self.turns > 1 else self._positions(None)

    def _positions(self, cells: np.ndarray | None) -> np.ndarray:
        cells = np.arange(self.cells) if cells is None else cells
        if self.poses is not None:
            return self.poses[cells, :3, 3]
        return self.low_centre + self.size * np.stack(np.unravel_index(cells, self.shape), axis=-1)

    def targets(self, rows: np.ndarray) -> np.ndarray:
        """Return the targets of answers (m,): positions (m, 3) [m], or poses (m, 4, 4)."""
        if self.poses is not None:
            return self.poses[rows]
        at = self._positions(rows // self.turns)
        if self.rotations is None:
            return at
        T = np.zeros((len(rows), 4, 4))
        T[:, :3, :3], T[:, :3, 3], T[:, 3, 3] = self.rotations[rows % self.turns], at, 1.0
        return T

    def index(self, points: np.ndarray) -> np.ndarray:
        """Return the cell (m,) that holds each point (m, 3) [m], -1 outside."""
        wide = self.size > 0.0
        k = np.zeros(points.shape)
        # In a map of one plane, points within a micrometre of it belong to it.
        k[:, ~wide] = np.where(np.abs(points[:, ~wide] - self.low[~wide]) <= 1e-6, 0.0, -1.0)
        k[:, wide] = np.floor((points[:, wide] - self.low[wide]) / self.size[wide])
        inside = np.all((k >= 0.0) & (k < self.shape), axis=1)
        flat = np.ravel_multi_index(tuple(np.where(inside[:, None], k, 0.0).astype(np.int64).T), self.shape)
        return np.where(inside, flat, -1)


def grid_of(
    robot: Robot, region: Any = None, resolution: float | None = None, orientations: Any = "any", axis: Any = None
) -> Grid:
    """Return the grid of cells and target poses that arguments of `reachability` describe; nothing is solved."""
    if _are_poses(region):
        if resolution is not None or not (isinstance(orientations, str) and orientations == "any"):
            raise InvalidOption("loose poses are answered as they are; omit resolution and orientations")
        T = _exact_poses(robot, region)
        return Grid(np.zeros(3), np.zeros(3), (len(T), 1, 1), poses=T)
    if region is None:
        low, high, _ = envelope(robot)
        flat = high - low < 1e-9 * robot.reach
        low, high = np.where(flat, 0.5 * (low + high), low), np.where(flat, 0.5 * (low + high), high)
    else:
        box = floats(
            region, "region must be two corners, (lower, upper) (3,) each [m], or poses (N, 4, 4)", InvalidOption
        )
        if box.shape != (2, 3) or not (np.abs(box) < RIGID.far).all() or not np.all(box[0] <= box[1]):
            raise InvalidOption(
                f"region must be two corners, (lower, upper) (3,) each [m], the lower first, or poses (N, 4, 4), not {region!r:.80}"
            )
        low, high = box
    wide = high - low
    if resolution is None:
        resolution = float(wide.max()) / EFFORT.cells or 1.0
    pitch = positive(resolution, "resolution [m]")
    with np.errstate(over="ignore"):
        counts = np.maximum(np.ceil(wide / pitch - 1e-9), 1.0)
        cells = counts.prod()
    if cells > np.iinfo(np.int64).max:
        raise InvalidOption(
            f"a resolution of {pitch:g} m makes {cells:.3g} cells; make it coarser, or the region smaller"
        )
    size = np.where(wide > 0.0, pitch, 0.0)
    # whole cells are a little larger than the region, so they are centred in it
    low = 0.5 * (low + high) - 0.5 * size * counts
    rotations, free = _rotations(orientations)
    if rotations is not None and free and axis is not None:
        # turn the tip so that `axis`, instead of its z axis, points in the wanted directions
        rotations = rotations @ _frame(np.array([axis]))[0].T
    shape = tuple(int(k) for k in counts)
    return Grid(low, size, shape, rotations, free, None, (0.0, 0.0, 1.0) if axis is None else tuple(axis))


def _are_poses(region: Any) -> bool:
    """Return whether a region is an array or a list of loose poses, rather than the two corners of a box."""
    if isinstance(region, np.ndarray):
        return region.ndim == 3
    # The corners of a box are rows of numbers; what else stands in a list is read as a pose, in any form that a batch takes.
    return isinstance(region, list | tuple) and any(
        not isinstance(one, int | float | str | list | tuple | np.ndarray | np.generic) or np.shape(one) == (4, 4)
        for one in region
    )


def _exact_poses(robot: Robot, given: Any) -> np.ndarray:
    """Return loose poses (N, 4, 4), with rotations that are not quite orthonormal made exact. Raises InvalidTarget."""
    T = np.array(floats(known(given, robot.base), "poses must be numbers", InvalidTarget))
    if T.shape[1:] != (4, 4):
        raise InvalidTarget(f"loose poses have the shape (N, 4, 4), not {T.shape}")
    R = T[:, :3, :3]
    exact = np.abs(R @ R.swapaxes(1, 2) - np.eye(3)).max(axis=(1, 2), initial=0.0) < ROUGH
    for k in np.flatnonzero(~(exact & np.isfinite(T).all(axis=(1, 2)))):
        T[k] = mended(T[k], (KIND.pose,), robot.tips, int(k))
    return T


def _rotations(orientations: Any) -> tuple[np.ndarray | None, bool]:
    """Return the target rotations (K, 3, 3), or None if orientation is free, and whether only their z axes count."""
    if isinstance(orientations, str):
        if orientations != "any":
            raise InvalidOption(
                f"orientations must be 'any', a number of tool axes, or rotations, not '{orientations:.60}'"
            )
        return None, False
    if not isinstance(orientations, Iterable) or getattr(orientations, "ndim", 1) == 0:
        count = whole(orientations, "the number of orientations")
        if count > MOST_AXES:
            raise InvalidOption(f"at most {MOST_AXES:,} tool axes are asked for at each place, not {count:,}")
        return _spread(count), True
    given = [getattr(one, "homogeneous", getattr(one, "T_base_tip", one)) for one in orientations]
    R = floats(given, "orientations must be rotations (K, 3, 3) or poses (K, 4, 4)", InvalidOption)
    if R.ndim != 3 or R.shape[1:] not in ((3, 3), (4, 4)) or not len(R):
        raise InvalidOption(f"orientations must be rotations (K, 3, 3) or poses (K, 4, 4), not of shape {R.shape}")
    R = R[:, :3, :3]
    if not np.abs(R @ R.swapaxes(1, 2) - np.eye(3)).max() < 1e-6 or not (np.linalg.det(R) > 0.0).all():
        raise InvalidOption("orientations must be rotations: orthonormal and right-handed")
    U, _, Vt = np.linalg.svd(R)
    return U @ Vt, False


def _spread(count: int) -> np.ndarray:
    """Return rotations (count, 3, 3) whose z axes are spread over the sphere (Fibonacci's lattice, Gonzalez 2010)."""
    k = np.arange(count)
    z, turn = 1.0 - (2.0 * k + 1.0) / count, np.pi * (3.0 - np.sqrt(5.0)) * k
    r = np.sqrt(1.0 - z * z)
    return _frame(np.stack([r * np.cos(turn), r * np.sin(turn), z], axis=-1))


def _frame(Z: np.ndarray) -> np.ndarray:
    """Return rotations (K, 3, 3) whose z axes are unit vectors Z (K, 3)."""
    X = np.cross(Z, np.eye(3)[np.abs(Z).argmin(axis=1)])
    X /= np.linalg.norm(X, axis=1, keepdims=True)
    return np.stack([X, np.cross(Z, X), Z], axis=-1)


def memory_allowed() -> float:
    """Return how much memory [bytes] a study may take: half of this machine's."""
    return 0.5 * os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


def require_memory(grid: Grid, n: int) -> None:
    """Raise InvalidOption if a study takes more than half of this machine's memory; the message says what would fit."""
    need, have = grid.memory(n), memory_allowed()
    if need > have:
        fits = have / need
        many = f"{grid.answers:,} answers take {need / 1e9:,.3g} GB, more than half of this machine's memory"
        if grid.poses is not None:
            raise InvalidOption(f"{many}; some {int(fits * grid.answers):,} fit")
        axes = int((grid.size > 0.0).sum())
        coarser = float(grid.size.max()) * fits ** (-1.0 / max(axes, 1))
        raise InvalidOption(f"{many}; a resolution of {coarser:.3g} m fits, or a part of the region")
