"""The reachability map of a robot: its cells and their answers, queries, and its file."""

import json
import logging
import os
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..errors import InvalidOption, InvalidTarget, floats
from ..files import as_output, as_path, check_arrays, whole_file, why_unread
from ..robot.pose import check_target
from ..text import Tabled, TextTable, figure, length
from ..validate import number, one_of
from .benchmark import wilson
from .reachability_grid import Grid


class Reach(IntEnum):
    """Possible answers to whether the tip reaches a cell in one orientation, as stored in a ReachabilityMap."""

    UNTRIED = 0
    YES = 1  # reached, with a configuration that was checked
    NO = 2  # proven out of reach
    FEW = 3  # undecided: a few attempts found no solution, and nothing is proven
    MANY = 4  # undecided: all attempts found no solution, and nothing is proven


# the keys of `ReachabilityMap.counts`, each with the words that tables use for it
ANSWERS = {
    "yes": "reached",
    "no": "proven out of reach",
    "unknown": "not found, not proven",
    "untried": "not tried",
}


class Audit(NamedTuple):
    """How reliable a map is: a random sample of its undecided cells, tried again with many more attempts."""

    unproven: int = 0  # number of undecided answers (not reached, but not proven out of reach) before the audit
    tried: int = 0  # how many of the undecided answers were tried again
    found: int = 0  # how many of the answers tried again turned out to be reached; the map then shows them as reached
    attempts: int = 0  # number of solver attempts at each answer that was tried again

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % interval (Wilson 1927) of the share of undecided answers that can be reached, before the audit's corrections."""
        return wilson(self.found, self.tried) if self.tried else (0.0, float(self.unproven > 0))

    def __str__(self) -> str:
        """Return the result of the audit in one sentence."""
        if not self.unproven:
            return "every no is proven"
        if not self.tried:
            return f"{self.unproven:,} answers were not found and not proven, and none was tried again"
        low, high = (figure(100.0 * x, 2) for x in self.interval)
        which = "all" if self.tried == self.unproven else f"{self.tried:,} of"
        again = f"{which} {self.unproven:,} answers not found were tried again with {self.attempts:,} attempts"
        return f"{again}: {self.found:,} were reached after all ({low} to {high} %, 95 %)"


@dataclass(frozen=True, eq=False, repr=False)
class ReachabilityMap(Tabled):
    """What a robot reaches, cell by cell; made by `ik.reachability`.

    An answer is about the pose at the centre of its cell: yes means that a configuration inside the limits was computed and
    checked. No is proven (by a bound, a closed form or a certificate), or means that no attempt found one; `audit` says how often
    that is wrong.

    Attributes:
        robot, tip, base: Names of the robot and of its frames.
        joint_names: Names of the joints of q.
        grid: The cells.
        states: Answers (cells, K) for K orientations: 1 reached, 2 proven out of reach, 3 and 4 nothing found by few and by all
            attempts, 0 not tried.
        manipulability: Largest of the reached answers of each cell (cells,), 0 where none is reached. It is the product of the
            singular values of the Jacobian (of its linear rows if orientation is free), without those that are always 0.
        margin: Largest of the reached answers (cells,): distance of q to its nearest limit over half the range, 0 to 1.
        q: The configuration (cells, n) [rad or m] of the largest manipulability, NaN where nothing is reached.
        audit: How many of the answers that were neither found nor proven are wrong.
        options: Options of the solver, as text.
    """

    robot: str
    tip: str
    base: str
    joint_names: tuple[str, ...]
    grid: Grid
    states: np.ndarray
    manipulability: np.ndarray
    margin: np.ndarray
    q: np.ndarray
    audit: Audit
    options: str = "{}"

    @property
    def share(self) -> np.ndarray:
        """Share of the orientations that are reached in each cell (nx, ny, nz)."""
        return (self.states == Reach.YES).mean(axis=1).reshape(self.grid.shape)

    @property
    def reached(self) -> np.ndarray:
        """Whether any orientation is reached in each cell (nx, ny, nz)."""
        return (self.states == Reach.YES).any(axis=1).reshape(self.grid.shape)

    def counts(self) -> dict[str, int]:
        """Count the answers: 'yes', 'no' (proven), 'unknown' (nothing found, nothing proven), 'untried'."""
        found = np.bincount(self.states.ravel(), minlength=5)
        return {
            "yes": int(found[Reach.YES]),
            "no": int(found[Reach.NO]),
            "unknown": int(found[Reach.FEW] + found[Reach.MANY]),
            "untried": int(found[Reach.UNTRIED]),
        }

    # ------------------------------------------------------------------------------------------------- questions
    def _answers(self, poses: Any) -> tuple[np.ndarray, np.ndarray, bool]:
        """Return the cells (N,) of poses (N, 4, 4) or positions (N, 3), the nearest orientations (N,), and whether these count."""
        if self.grid.poses is not None:
            raise InvalidOption("this map is about loose poses: map.reached has their answers, in their order")
        try:
            T = np.asarray(poses)
        except ValueError:
            raise InvalidTarget("poses must all be poses (4, 4), or all positions (3,)") from None
        if T.shape[1:] not in ((4, 4), (3,)):
            one = check_target(poses)[0]  # `poses` may be a single pose or position in any accepted form
            T = np.asarray(one)[None]
        T = floats(T, "poses must be numbers", InvalidTarget)
        if not np.isfinite(T).all():
            raise InvalidTarget("poses must be finite numbers")
        cell = self.grid.index(T if T.ndim == 2 else T[:, :3, 3])
        R = self.grid.rotations
        if T.ndim == 2 or R is None:
            return cell, np.zeros(len(T), np.int64), False
        if self.grid.free:
            return cell, (T[:, :3, :3] @ self.grid.axis @ (R @ self.grid.axis).T).argmax(axis=1), True
        return cell, (T[:, :3, :3].reshape(-1, 9) @ R.reshape(-1, 9).T).argmax(axis=1), True

    def contains(self, poses: Any) -> np.ndarray:
        """Return whether poses (N, 4, 4) or positions (N, 3) [m] lie in cells that are reached (N,); nothing is solved.

        A pose is answered by its cell and the nearest orientation of the map, a position by its cell and any orientation. Near
        the border only part of a cell is in reach, so use `ik.solve` for an exact answer. Outside the map the answer is False.
        """
        cell, turn, turned = self._answers(poses)
        found = self.states[cell, turn] == Reach.YES if turned else (self.states == Reach.YES).any(axis=1)[cell]
        return found & (cell >= 0)

    def score(self, poses: Any, what: str = "manipulability") -> np.ndarray:
        """Return a score (N,) from 0 to 1 of the cells of poses (N, 4, 4) or positions (N, 3) [m]; 0 where `contains` is False.

        what: 'manipulability' relative to the largest in the map, 'margin' to the limits, or 'share' of the orientations reached.
        """
        cell, values = self._answers(poses)[0], self._values(what)
        if what == "manipulability":
            values = values / (float(values.max(initial=0.0)) or 1.0)
        return np.where(self.contains(poses), values[cell], 0.0)

    def _values(self, what: str) -> np.ndarray:
        """Return a score of every cell (cells,)."""
        one_of(what, ("share", "manipulability", "margin"), "score")
        return self.share.ravel() if what == "share" else getattr(self, what)

    def slice(self, axis: str, at: float | None = None, what: str = "share") -> tuple[np.ndarray, float]:
        """Return the values of a plane of cells normal to an axis, and the coordinate [m] of their centres on this axis.

        Args:
            axis: Normal of the plane, 'x', 'y' or 'z'.
            at: Coordinate [m] of the plane, by default the middle; the nearest plane of cells is used.
            what: 'share' of orientations reached, 'manipulability' or 'margin'.
        """
        values = self._values(what).reshape(self.grid.shape)
        k = "xyz".index(one_of(axis, "xyz", "axis"))
        if self.grid.poses is not None:
            raise InvalidOption("loose poses have no planes; map.reached has the answer of each")
        first, size, count = self.grid.low_centre[k], self.grid.size[k], self.grid.shape[k]
        if at is None:
            at = first + size * (count // 2)
        near = min(max(number(at, f"{axis} [m]"), first - size), first + size * count)
        row = 0 if size == 0.0 else round((near - first) / size)
        if not 0 <= row < count:
            ends = f"{first:.4g} to {first + size * (count - 1):.4g} m"
            raise InvalidOption(f"the planes of this map across {axis} are at {ends}, not at {at:.4g} m")
        return np.take(values, row, axis=k), float(first + size * row)

    # ------------------------------------------------------------------------------------------------------ words
    def table(self) -> TextTable:
        """Return a table of the shares reached, out of reach and undecided, with the audit below it."""
        counts, total = self.counts(), max(self.states.size, 1)
        rows = [(ANSWERS[key], count, f"{100.0 * count / total:.2f} %") for key, count in counts.items() if count]
        if self.grid.poses is not None:
            what = f"loose poses with {self.tip}"
        else:
            sides = " x ".join(str(k) for k in self.grid.shape)
            kinds = ("pose", "poses") if not self.grid.free else ("tool axis", "tool axes")
            turns = self.grid.turns
            of = ", any orientation" if self.grid.rotations is None else f" x {turns} {kinds[turns > 1]}"
            what = f"{sides} cells of {length(float(self.grid.size.max()))}{of}, with {self.tip}"
        return TextTable(self.robot, what, ("answer", "number", "share"), rows, f"{self.audit}. ik.plot(map) draws it.")

    def to_dict(self) -> dict[str, Any]:
        """Return the summary as plain numbers and texts, without the cells."""
        low, high = self.audit.interval
        audit = self.audit._asdict() | {"interval": [low, high]}
        about = {"robot": self.robot, "tip": self.tip, "base": self.base, "cells": self.grid.cells}
        return about | {"orientations": self.grid.turns, "answers": self.counts(), "audit": audit}

    # ------------------------------------------------------------------------------------------------------- file
    def save(self, path: str | Path) -> Path:
        """Write the map to an NPZ file, completely or not at all; the guide lists its arrays. Raises InvalidOption, OSError."""
        path = as_output(path, "a map", ".npz")
        about = {"format": 1, "robot": self.robot, "tip": self.tip, "base": self.base, "free": self.grid.free}
        about |= {"axis": list(self.grid.axis), "options": self.options}
        empty, grid = np.empty((0, 3, 3)), self.grid
        with whole_file(path) as stream:
            np.savez(
                stream,
                about=np.array(json.dumps(about)),
                joint_names=np.array(self.joint_names),
                low=grid.low,
                size=grid.size,
                shape=np.array(grid.shape),
                rotations=empty if grid.rotations is None else grid.rotations,
                poses=np.empty((0, 4, 4)) if grid.poses is None else grid.poses,
                states=self.states,
                manipulability=self.manipulability,
                margin=self.margin,
                q=self.q,
                audit=np.array(self.audit),
            )
        return path

    @classmethod
    def load(cls, path: str | Path) -> "ReachabilityMap":
        """Read a map from a file that `save` wrote, on any machine. Raises InvalidOption if the file is missing or no map."""
        path = as_path(path)
        arrays = ("low", "size", "shape", "rotations", "poses", "states", "manipulability", "margin", "q", "audit")
        try:
            texts = ("about", "joint_names")
            check_arrays(path, (*arrays, *texts), texts, InvalidOption)
            with np.load(path, allow_pickle=False) as file:
                about = json.loads(str(file["about"]))
                a = {name: file[name] for name in (*arrays, "joint_names")}
            grid = Grid(
                a["low"].astype(float),
                a["size"].astype(float),
                tuple(int(k) for k in a["shape"]),
                a["rotations"] if len(a["rotations"]) else None,
                bool(about["free"]),
                a["poses"] if len(a["poses"]) else None,
                tuple(float(x) for x in about["axis"]),
            )
            names, cells = tuple(str(name) for name in a["joint_names"]), grid.cells
            wanted = {
                "low": (3,),
                "size": (3,),
                "shape": (3,),
                "rotations": (len(a["rotations"]), 3, 3),
                "poses": (len(a["poses"]), 4, 4),
                "states": (cells, grid.turns),
                "manipulability": (cells,),
                "margin": (cells,),
                "q": (cells, len(names)),
                "audit": (len(Audit._fields),),
            }
            reached = (a["states"] == Reach.YES).any(axis=1)
            finite = [a[name] for name in wanted if name != "q"]
            if (
                about["format"] != 1
                or any(a[name].shape != shape for name, shape in wanted.items())
                or len(grid.axis) != 3
                or not np.isin(a["states"], list(Reach)).all()
                or not all(np.isfinite(one).all() for one in (*finite, np.array(grid.axis), a["q"][reached]))
            ):
                raise ValueError
            return cls(
                str(about["robot"]), str(about["tip"]), str(about["base"]), names, grid, a["states"].astype(np.int8),
                a["manipulability"], a["margin"], a["q"], Audit(*(int(k) for k in a["audit"])), str(about["options"]),
            )  # fmt: skip
        except OSError as error:
            raise InvalidOption(f"cannot read the map '{path.name}': {why_unread(error)}") from None
        except InvalidOption:
            raise
        except Exception:
            raise InvalidOption(f"'{path.name}' is no map that ik.reachability wrote, or it is damaged") from None


class Log:
    """The file of an unfinished study, NAME.partial: a description of the study, then an entry with the answers of each chunk.

    Entries are appended and never changed. A process that is killed loses only the chunk in progress; an incomplete entry (also due
    to a full disk) is dropped when the file is read again.
    """

    def __init__(self, path: Path, asked: str) -> None:
        """Create the file, or continue one of the same study. Raises InvalidOption if it is of another study or kind, OSError."""
        self.path, self.asked, self.good = path, asked, 0
        self.entries: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
        self.broken: OSError | None = None
        if path.exists():
            self._read()
        self.stream = path.open("r+b" if path.exists() else "xb")
        self.stream.truncate(self.good)
        self.stream.seek(self.good)
        if not self.good:
            self._append(lambda stream: np.save(stream, np.array(asked)))
            if self.broken:
                raise self.broken

    def _read(self) -> None:
        """Read the complete entries."""
        end = os.path.getsize(self.path)
        with self.path.open("rb") as stream:
            try:
                head = str(np.load(stream, allow_pickle=False))
            except (ValueError, EOFError):  # Either its first entry is cut off, or the file is of another kind.
                stream.seek(0)
                if not np.lib.format.MAGIC_PREFIX.startswith(stream.read(len(np.lib.format.MAGIC_PREFIX))):
                    raise InvalidOption(
                        f"'{self.path}' is no unfinished map; remove it, or choose another name"
                    ) from None
                return
            if head != self.asked:
                raise InvalidOption(
                    f"'{self.path}' was begun with another robot, region or options; remove it, or choose another name"
                )
            self.good = stream.tell()
            while stream.tell() < end:
                try:
                    rows, states, q = (np.load(stream, allow_pickle=False) for _ in range(3))
                except (ValueError, EOFError):
                    return
                self.entries.append((rows, states, q))
                self.good = stream.tell()

    def add(self, rows: np.ndarray, states: np.ndarray, q: np.ndarray) -> None:
        """Append an entry: answers `rows` (m,), their states (m,), and q (k, n) of those reached, in the same order."""
        self._append(lambda stream: [np.save(stream, one) for one in (rows, states, q)])

    def _append(self, write: Callable[[Any], Any]) -> None:
        if self.broken is not None:
            return
        try:
            write(self.stream)
            self.stream.flush()
            self.good = self.stream.tell()
        except OSError as error:  # the disk may be full; the study continues without the file
            self.broken = OSError(error.errno, error.strerror, str(self.path))
            logging.getLogger("ik_toolkit").warning(
                "%s: %s; what is computed from here on is lost if the study is stopped", self.path, error.strerror
            )

    def close(self, finished: bool) -> None:
        """Close the file, and remove it if the study is `finished` and its map was written."""
        try:
            self.stream.close()
        except OSError:  # Closing flushes again, which fails on a full disk; that was already reported.
            pass
        if finished:
            self.path.unlink(missing_ok=True)
