"""Result of `solve_path`: a joint motion through the poses, what is proven of it, where it breaks, and a sentence with advice."""

import json
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..errors import InvalidOption, NotSolved
from ..files import as_path, whole_file, write_table, write_whole
from ..motion.trajectory import Trajectory
from ..solvers.options import Options
from ..text import plain
from .certificate import Continuity


class PathStatus(Enum):
    """How a path ended; the first two are successes."""

    FOLLOWED = "every pose, one continuous motion"
    RECONFIGURES = "every pose, with reconfigurations, no more than allowed"
    INCOMPLETE = "a pose is not reached, or it takes more reconfigurations than allowed"
    COLLISION = "every pose, but only in collision"
    CONSTRAINT_OPEN = "every pose, but at one a loop of the robot's description is open"


class Reconfiguration(NamedTuple):
    """Between pose `index` and the next the robot changes to another branch of solutions.

    move (n,): the smallest joint move [rad or m] found from one side to the other.
    """

    index: int
    move: np.ndarray


class Unreachable(NamedTuple):
    """A pose that is not reached, why, and whether that is proven (or just no solution was found)."""

    index: int
    reason: str
    proven: bool


@dataclass(frozen=True, eq=False)
class PathResult:
    """A joint motion through N poses (read-only).

    q (N, n) [rad or m], one row per pose, NaN where a pose is not reached; status; message (one sentence, with what to try);
    reconfigurations, and lower_bound, the proven minimum (None: not proven); unreachable poses. position_error (N,) [m] and
    orientation_error (N,) [rad] (None: free): the errors that count at the poses, the largest over the tips, by Pinocchio.
    The motion is linear in the joints between the rows of curve (M, n): q and the inserted poses; at (M,) is their place
    among the poses (3.5: halfway from pose 3 to pose 4). continuity: what is proven about it.
    fraction: share of the path's length that one motion follows from its start (1 where it is FOLLOWED). robot,
    targets (N, F, 4, 4) [m] by tip, kinds and options: the request; max_step (rad, m), path_tolerance (m, rad),
    collision (model or None), seed; elapsed [s].
    """

    robot: Any
    targets: np.ndarray
    kinds: tuple
    options: Options
    q: np.ndarray
    status: PathStatus
    message: str
    position_error: np.ndarray
    orientation_error: np.ndarray | None
    curve: np.ndarray
    at: np.ndarray
    continuity: Continuity
    reconfigurations: tuple[Reconfiguration, ...] = ()
    lower_bound: int | None = None
    unreachable: tuple[Unreachable, ...] = ()
    max_step: tuple[float, float] = (np.radians(7.0), 0.02)
    path_tolerance: tuple[float, float] = (1e-3, np.radians(1.0))
    collision: Any = field(default=None, repr=False)
    seed: int = 0
    elapsed: float = 0.0
    fraction: float = 1.0
    tolerance_given: bool = field(default=False, repr=False)

    @property
    def success(self) -> bool:
        """Whether every pose is reached, with no more reconfigurations than allowed, without contact or an open loop."""
        return self.status in (PathStatus.FOLLOWED, PathStatus.RECONFIGURES)

    @property
    def deviation(self) -> tuple[float, float]:
        """Bound on the deviation of a tip [m] and [rad] from the interpolated poses, anywhere between the poses."""
        return self.continuity.largest

    @property
    def clearance(self) -> float | None:
        """Proven clearance [m] of all parts along the whole path; None if collisions were not checked."""
        return self.continuity.clearance

    @property
    def pieces(self) -> list[slice]:
        """Continuous pieces of the motion, as rows of `curve`: it breaks at reconfigurations and at poses not reached."""
        return pieces(self.curve, self.at, [one.index for one in self.reconfigurations])

    @property
    def largest_step(self) -> tuple[float, float]:
        """Largest step of a joint between neighbouring rows of `curve`, within the pieces: revolute [rad] and prismatic [m]."""
        moves = [np.abs(np.diff(self.curve[piece], axis=0)).max(axis=0, initial=0.0) for piece in self.pieces]
        return self._apart(np.max(moves, axis=0) if moves else np.zeros(self.robot.n), np.max)

    @property
    def length(self) -> tuple[float, float]:
        """Sum of |dq| over neighbouring rows of q: revolute joints [rad] and prismatic joints [m]."""
        moves = np.abs(np.diff(self.q, axis=0))
        return self._apart(np.nansum(moves, axis=0), np.sum)

    def _apart(self, values: np.ndarray, of: Any) -> tuple[float, float]:
        slides = self.robot.slides
        return float(of(values[~slides], initial=0.0)), float(of(values[slides], initial=0.0))

    def raise_for_status(self) -> "PathResult":
        """Return self, or raise NotSolved with the message if the path was not followed."""
        if not self.success:
            raise NotSolved(self)
        return self

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers, strings and lists, ready for JSON; rows of poses that are not reached contain nulls."""
        return plain(
            {
                "success": self.success,
                "status": self.status.name,
                "message": self.message,
                "robot": self.robot.name,
                "base": self.robot.base,
                "tips": self.robot.tips,
                "joint_names": self.robot.joint_names,
                "poses": len(self.q),
                "q": self.q,
                "position_error": self.position_error,
                "orientation_error": self.orientation_error,
                "reconfigurations": [{"index": one.index, "move": one.move} for one in self.reconfigurations],
                "lower_bound": self.lower_bound,
                "fraction": self.fraction,
                "unreachable": [one._asdict() for one in self.unreachable],
                "curve": self.curve,
                "at": self.at,
                "largest_step": dict(zip(("rad", "m"), self.largest_step, strict=True)),
                "length": dict(zip(("rad", "m"), self.length, strict=True)),
                "deviation": dict(zip(("m", "rad"), self.deviation, strict=True)),
                "clearance": self.clearance,
                "contacts": [one._asdict() for one in self.continuity.contacts],
                "unproven": self.continuity.unproven,
                "max_step": dict(zip(("rad", "m"), self.max_step, strict=True)),
                "path_tolerance": dict(zip(("m", "rad"), self.path_tolerance, strict=True)),
                "seed": self.seed,
                "elapsed": self.elapsed,
            }
        )

    def save(self, path: str | Path) -> Path:
        """Write .csv (one row per pose: joints, then errors), .npz (the arrays) or .json (`to_dict`). Raises InvalidOption."""
        file = as_path(path, "path")
        suffix = file.suffix.lower()
        if suffix == ".json":
            write_whole(file, json.dumps(self.to_dict(), indent=2, allow_nan=False) + "\n")
        elif suffix == ".npz":
            arrays: dict[str, Any] = {"targets": self.targets, "q": self.q, "position_error": self.position_error}
            arrays |= {} if self.orientation_error is None else {"orientation_error": self.orientation_error}
            arrays |= {"curve": self.curve, "at": self.at, "tips": np.array(self.robot.tips)}
            arrays["reconfigurations"] = np.array([one.index for one in self.reconfigurations], dtype=int)
            with whole_file(file) as stream:
                np.savez_compressed(stream, joint_names=np.array(self.robot.joint_names), **arrays)
        elif suffix == ".csv":
            head = ["pose", *self.robot.joint_names, "position_error"]
            columns = [self.q, self.position_error[:, None]]
            if self.orientation_error is not None:
                head.append("orientation_error")
                columns.append(self.orientation_error[:, None])
            write_table(file, head, ([k, *row] for k, row in enumerate(np.hstack(columns).tolist())))
        else:
            raise InvalidOption(f"a path is saved as .csv, .npz or .json, not '{file.suffix or file.name}'")
        return file

    def retime(
        self,
        velocity: Any = None,
        acceleration: Any = None,
        *,
        rate: float = 100.0,
        seed: int = 0,
        path_tolerance: Any = None,
        tip_speed: float | None = None,
    ) -> Trajectory:
        """Time-optimal motion within joint speed and acceleration limits, see `Trajectory`.

        The poses are samples of a motion: a smooth curve goes through them. It stops only where it must, which the result says
        (`Trajectory.stops`). At a reconfiguration the robot stops and moves freely from one branch to the other.

        Args:
            velocity: one number, or one per joint (n,) [rad/s or m/s]; default the robot's own limits.
            acceleration: the same [rad/s^2 or m/s^2]; must be given.
            rate: of the samples [1/s].
            seed: of the search for a free motion.
            path_tolerance: how far (m, rad) a tip may leave the chords between the poses. Default: the one given to `solve_path`;
                where none was, its default or the chords' own sagitta, which is how far an arc through the poses leaves them.
            tip_speed: speed [m/s] of the tip along the path, kept wherever the limits allow (`Trajectory.slower` says where not).

        Raises:
            InvalidOption: limits are missing or not positive.
            NotSolved: the path was not followed.
            MissingExtra: without toppra or SciPy.
        """
        from .timing import retime

        return retime(self, velocity, acceleration, rate, seed, path_tolerance, tip_speed)

    def __repr__(self) -> str:
        """One line."""
        turn, slide = self.length
        parts = [f"{len(self.q)} poses", f"{len(self.reconfigurations)} reconfigurations", f"length {turn:.4g} rad"]
        return f"PathResult({self.status.name}, {', '.join(parts)}{f' and {slide:.4g} m' if slide else ''})"


def pieces(curve: np.ndarray, at: np.ndarray, breaks: list[int]) -> list[slice]:
    """Runs of rows of a curve (M, n) without NaN or a break (between pose k and the next, for k in breaks)."""
    finite = np.asarray(np.isfinite(curve).all(axis=1))
    cut = ~(finite[:-1] & finite[1:])  # (M-1,) whether the motion stops between two rows
    for k in breaks:
        cut[np.searchsorted(at, k)] = True
    starts = np.flatnonzero(np.append(True, cut))
    ends = np.append(starts[1:], len(curve))
    return [slice(int(a), int(b)) for a, b in zip(starts, ends, strict=True) if finite[a]]


def path_sentence(path: PathResult, needed: int, allowed: float) -> str:
    """One sentence. needed: reconfigurations of the best path found through all poses; allowed: largest number allowed."""
    N = len(path.q)
    if path.status == PathStatus.INCOMPLETE:
        reached = np.flatnonzero(np.isfinite(path.q[:, 0]))
        last = int(reached[-1]) if len(reached) else -1
        most = f"{allowed:g} reconfiguration{'s' * (allowed != 1)}" if allowed else "no reconfiguration"
        ends = f"with {most} the path found ends at pose {last} of {N}"
        far = f"from the start {100.0 * path.fraction:.3g} % of its length can be followed in one motion"
        if path.unreachable:
            first, more = path.unreachable[0], len(path.unreachable) - 1
            others = f" and {more} more" if more else ""
            cut = f"; {ends}, and all of them take {needed}" if needed > allowed else ""
            return (
                f"{len(reached)} of {_poses(N)} reached; not pose {first.index}{others}: {first.reason}{cut}; {far}; move the "
                "poses, relax the targets (free_turn, slack, mask), or widen the limits"
            )
        return (
            f"{ends}: pose {last + 1} cannot be passed, and the whole path needs {needed}; {far}; allow them "
            "(reconfigurations='fewest'), or relax the targets (free_turn, slack, mask)"
        )
    turn, slide = path.length
    length = f"{turn:.3g} rad" + (f" and {slide:.3g} m" if slide else "")
    if path.status == PathStatus.COLLISION:
        touching = path.continuity.contacts[:1]
        where = f" ({' and '.join(touching[0].pair)} touch at pose {touching[0].place:.4g})" if touching else ""
        return f"{_poses(N)} followed, but only in collision{where}; move the poses or the obstacle"
    places = len(path.continuity.unproven)
    close = f"; at {places} place{'s' * (places != 1)} shapes are too close to rule out contact" if places else ""
    if path.status == PathStatus.FOLLOWED:
        return f"{_poses(N)} followed in one motion of {length}{close}"
    breaks = ", ".join(str(one.index) for one in path.reconfigurations[:5])
    few = "provably the fewest" if path.lower_bound == needed else "the fewest found"
    several = f"{needed} reconfiguration{'s' * (needed != 1)}"
    return f"{_poses(N)} followed with {several} ({few}), after pose {breaks}{close}"


def _poses(count: int) -> str:
    return f"{count} pose{'s' * (count != 1)}"
