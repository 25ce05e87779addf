"""Reads the targets of a batch part by part, in any form: arrays, dicts by tip, lists, iterators."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from ...errors import InvalidOption, InvalidTarget, doubt_lengths, masked
from ...kernel.checks import RIGID
from ...kernel.counted_error import KIND
from ...robot.pose import AxisTarget, as_array, check_target, row_hint
from ...robot.ros import is_by_name, listed_poses, read_pose

SHAPES = {(4, 4): KIND.pose, (3,): KIND.position}
STACKED = "an array (N, 4, 4) or (N, 3), or an iterator of such arrays"
# A rotation matrix whose axes deviate from orthonormal by more than ROUGH, but at most `RIGID.axes`, is replaced by the nearest
# exact one.
ROUGH = 1e-12


class Block(NamedTuple):
    """N targets of a batch: for each tip an array of poses (N, 4, 4) or positions (N, 3), or None if the tip has no target."""

    parts: tuple[np.ndarray | None, ...]
    pose_shape: tuple[int, ...]  # shape of one target as the compiled search takes it: (4, 4), or (F, 4, 4) for F tips

    @property
    def kinds(self) -> tuple:
        """The kind of target of each tip: pose, position or free."""
        return tuple(KIND.free if part is None else SHAPES[part.shape[1:]] for part in self.parts)

    @property
    def rows(self) -> int:
        """How many targets the block has."""
        return next(len(part) for part in self.parts if part is not None)

    def poses(self, a: int, b: int) -> np.ndarray:
        """Return targets a to b (excluded) as an array of poses for the compiled search: (m, 4, 4), for several tips (m, F, 4, 4).

        Rotations that are orthonormal only to 1e-6 are replaced by the nearest exact ones; worse ones, and NaN, are rejected by the
        search.
        """
        T = np.tile(np.eye(4), (max(0, min(b, self.rows) - a), len(self.parts), 1, 1))
        for f, part in enumerate(self.parts):
            if part is None:
                continue
            if part.ndim == 2:
                T[:, f, :3, 3] = part[a:b]
            else:
                T[:, f] = part[a:b]
                _straighten(T[:, f])
        return T.reshape(-1, *self.pose_shape)


def _straighten(T: np.ndarray) -> None:
    """Make rotations in T (m, 4, 4) exact, in place, that deviate from orthonormal by at least ROUGH and at most RIGID.axes."""
    x, y, z = (np.ascontiguousarray(T[:, :3, k].T) for k in range(3))
    off = np.zeros(len(T))
    with np.errstate(invalid="ignore", over="ignore"):
        for u, v in ((x, x), (y, y), (z, z), (x, y), (x, z), (y, z)):
            np.maximum(off, np.abs((u * v).sum(axis=0) - (u is v)), out=off)
    rough = (off > ROUGH) & (off < RIGID.axes)
    if rough.any():
        U, _, Vt = np.linalg.svd(T[rough, :3, :3])
        T[rough, :3, :3] = U @ Vt


def with_free_turns(robot: Any, targets: Any, options: Any) -> tuple[Any, Any]:
    """Replace AxisTargets by poses, and add the option `free_turn` about their common axis; return the targets and the options.

    Raises:
        InvalidTarget: some of a tip's targets are AxisTargets and others not, or their axes differ.
        InvalidOption: `free_turn` is given as well.
    """
    # a list of AxisTargets that was turned into a numpy array has the type object
    if isinstance(targets, np.ndarray) and targets.dtype == object and targets.ndim == 1:
        targets = targets.tolist()
    if isinstance(targets, list | tuple) and targets and all(map(is_by_name, targets)):
        targets = _columns(robot, targets)
    if is_by_name(targets):
        columns = robot.each_tip(targets)
    elif not isinstance(targets, list | tuple) or not targets:
        return targets, options
    elif not robot.by_tip:
        columns = {robot.tips[0]: targets}
    elif all(isinstance(row, list | tuple) and len(row) == len(robot.tips) for row in targets):
        columns = {tip: [row[f] for row in targets] for f, tip in enumerate(robot.tips)}
    else:
        return targets, options
    axes = {tip: axis for tip, column in columns.items() if (axis := _shared_axis(tip, column)) is not None}
    if not axes:
        return targets, options
    if options.get("free_turn") is not None:
        raise InvalidOption("an axis target frees the turn about its axis; leave free_turn out")
    made = {tip: [one.T_base_tip for one in columns[tip]] if tip in axes else column for tip, column in columns.items()}
    return robot.for_tips(made), {**options, "free_turn": robot.for_tips(axes)}


def _columns(robot: Any, rows: Sequence[Mapping[str, Any]]) -> dict[str, list[Any]]:
    """Return dicts by tip, one for each target, as one dict of lists. Raises FrameNotFound, InvalidTarget if their tips differ."""
    rows = [{tip: one for tip, one in row.items() if one is not None} for row in rows]
    for k, row in enumerate(rows):
        robot.check_tips(row)
        if row.keys() != rows[0].keys():
            tips, first = (", ".join(one) or "no tip" for one in (row, rows[0]))
            raise InvalidTarget(
                f"target {k} is of {tips} and target 0 of {first}; in a batch they are of the same tips"
            )
    return {tip: [row[tip] for row in rows] for tip in rows[0]}


def _shared_axis(tip: str, column: Any) -> tuple[float, float, float] | None:
    """Return the tip axis that all AxisTargets of a list share, or None if it holds none. Raises InvalidTarget if they differ."""
    axes = (
        [one.axis if isinstance(one, AxisTarget) else None for one in column]
        if isinstance(column, list | tuple)
        else []
    )
    if not any(axes):
        return None
    for k, axis in enumerate(axes):
        if axis != axes[0]:
            raise InvalidTarget(
                f"target {k} of {tip} has {'no free axis' if axis is None else f'the axis {axis}'} and target 0 "
                f"{'none' if axes[0] is None else axes[0]}; the targets of one call share the tip axis about which they may turn"
            )
    return axes[0]


def known(targets: Any, base: str = "") -> Any:
    """Convert targets in any form that `solve_batch` takes to one array, or for several tips a dict of arrays by tip.

    They are given in the frame `base`. Returns None for an iterator, whose targets are read later. Raises InvalidTarget for what
    is no target.
    """
    if isinstance(targets, str | bytes | set | frozenset):  # a set of targets is refused, because it has no order
        raise InvalidTarget(f"targets must be {STACKED}, not {targets!r:.60}")
    if isinstance(targets, np.ndarray):
        if targets.ndim == 0:
            raise InvalidTarget(f"targets must be {STACKED}, not one value of {targets.dtype}")
        return targets
    if not isinstance(targets, list | tuple) and (poses := listed_poses(targets, base)) is not None:
        targets = poses
    if read_pose(targets) is not None:
        raise InvalidTarget(f"targets must be many, and this is one ROS message; give a list of them, {STACKED}")
    if isinstance(targets, Mapping):
        if not is_by_name(targets):
            as_array(targets)  # raises InvalidTarget, which says which fields a dict must have to be a pose
        return {
            tip: _named(tip, lambda part: known(part, base), part) for tip, part in targets.items() if part is not None
        }
    if isinstance(targets, Iterator):
        return None
    try:
        # A table such as a polars DataFrame converts itself to an array; iteration would give its columns instead of its rows.
        if hasattr(targets, "__array__") and (array := np.asarray(targets)).dtype.kind in "fiu":
            return array
        return np.array([_plain(target, base) for target in targets])
    except (TypeError, ValueError) as error:
        if isinstance(error, InvalidTarget):
            raise
        raise InvalidTarget(f"targets must be {STACKED}, either poses or positions") from None


def _named(tip: str, read: Callable[[Any], Any], part: Any) -> Any:
    """Return read(part), the targets of one tip. Raises InvalidTarget with the tip's name if `read` does."""
    try:
        return read(part)
    except InvalidTarget as error:
        raise InvalidTarget(f"{tip}: {error}") from None


def _plain(target: Any, base: str) -> np.ndarray:
    """Return one entry of a list of targets as numbers: a target, or a list with the targets of several tips."""
    if isinstance(target, list | tuple) and any(not isinstance(one, float | int | list | tuple) for one in target):
        return np.array([_numbers(as_array(one, base)) for one in target])
    return _numbers(as_array(target, base))


def _numbers(targets: Any) -> np.ndarray:
    """Return targets as an array of real numbers (see `errors.floats`), without a copy if they are one already."""
    if masked(targets):
        raise InvalidTarget("targets must be numbers, and some of these are masked")
    if isinstance(targets, AxisTarget):
        raise InvalidTarget("an AxisTarget goes into a list of them; or give its T_base_tip, and its axis as free_turn")
    try:
        array = np.asarray(targets)
    except (TypeError, ValueError):
        raise InvalidTarget(f"targets must be {STACKED}, not {type(targets).__name__}") from None
    if array.dtype.kind not in "fiu":
        given = f"{array.dtype} of shape {array.shape}" if array.ndim else f"{targets!r:.60}"
        raise InvalidTarget(f"targets must be numbers, not {given}")
    return array


def blocks(chunks: Iterator[Any], robot: Any) -> Iterator[Block]:
    """Yield the targets of a batch in chunks (Block), with checked shapes; the compiled search later checks the numbers.

    Raises InvalidTarget for a wrong shape, and for a chunk whose kinds differ from those of the first.
    """
    kinds = None
    for chunk in chunks:
        if isinstance(chunk, Mapping):
            block = _named_tips(chunk, robot)
        else:
            array = _numbers(chunk)
            if array.size == 0 and array.ndim < 2:
                continue
            block = _stacked(array, robot)
        if kinds not in (None, block.kinds):
            raise InvalidTarget("a batch holds either poses or positions for each tip, not both")
        kinds = block.kinds
        yield block


def doubt_far(robot: Any, T: np.ndarray, what: str = "targets") -> None:
    """Warn if targets T (m, 4, 4) or (m, F, 4, 4) [m] are so far out of reach that they are probably in millimetres.

    There is one warning for each tip.
    """
    for f, tip in enumerate(robot.tips):
        away = np.abs(T.reshape(len(T), -1, 4, 4)[:, f, :3, 3])
        doubt_lengths(f"{what} of {tip} on {robot.name}", float(np.nanmax(away, initial=0.0)), robot.reach)


def _stacked(array: np.ndarray, robot: Any) -> Block:
    tips, F = robot.tips, len(robot.tips)
    if not robot.by_tip:
        if array.shape[1:] not in SHAPES:
            hint = row_hint(array.shape)
            if array.shape in SHAPES:
                hint = "; ik.solve takes one target, and targets one by one go into a list"
            raise InvalidTarget(
                f"targets must be numbers of shape (N, 4, 4) or (N, 3), not of shape {array.shape}{hint}"
            )
        return Block((array,), robot.pose_shape)
    if array.shape[1:] not in ((F, 4, 4), (F, 3)):
        raise InvalidTarget(
            f"targets of {', '.join(tips)} must be numbers of shape (N, {F}, 4, 4) or (N, {F}, 3), or a dict by tip, not of "
            f"shape {array.shape}"
        )
    return Block(tuple(array[:, f] for f in range(F)), robot.pose_shape)


def _named_tips(chunk: Mapping[str, Any], robot: Any) -> Block:
    tips = robot.tips
    robot.check_tips(chunk)
    parts = tuple(None if chunk.get(tip) is None else _named(tip, _numbers, chunk[tip]) for tip in tips)
    if all(part is None for part in parts):
        raise InvalidTarget(f"a dict of targets needs at least one of {', '.join(tips)}")
    for tip, part in zip(tips, parts, strict=True):
        if part is not None and part.shape[1:] not in SHAPES:
            raise InvalidTarget(
                f"{tip}: targets must be numbers of shape (N, 4, 4) or (N, 3), not of shape {part.shape}"
            )
    if len({len(part) for part in parts if part is not None}) > 1:
        counts = ", ".join(f"{tip} {len(part)}" for tip, part in zip(tips, parts, strict=True) if part is not None)
        raise InvalidTarget(f"every tip needs the same number of targets, not {counts}")
    return Block(parts, robot.pose_shape)


def mended(T: np.ndarray, kinds: tuple, tips: tuple[str, ...], number: int) -> np.ndarray:
    """Make the rotations of a target T (4, 4) or (F, 4, 4) exact, after the compiled search has rejected it; return the target.

    Raises InvalidTarget, which names the target (its `number` in the batch) and the tip, if a pose cannot be corrected.
    """
    good = T.copy().reshape(-1, 4, 4)
    for tip, kind, one in zip(tips, kinds, good, strict=True):
        if kind == KIND.free:
            continue
        try:
            if kind == KIND.position:
                check_target(one[:3, 3])
            else:
                one[:] = check_target(one)[0]
        except InvalidTarget as error:
            name = "" if len(tips) == 1 else f" of {tip}"
            raise InvalidTarget(f"target {number}{name}: {error}") from None
    return good.reshape(T.shape)
