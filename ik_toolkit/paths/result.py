"""The result of `solve_path`: a joint motion through poses, what is proven about it, and a message with advice."""

import json
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..errors import NotSolved
from ..files import as_output, whole_file, write_table, write_whole
from ..motion.trajectory import Trajectory
from ..solvers.options import Options
from ..style import BAD, GOOD
from ..text import TextTable, angle, duration, how_many, length, plain
from .certificate import Continuity


class PathStatus(Enum):
    """How a path search ended; FOLLOWED and RECONFIGURES are successes."""

    FOLLOWED = "every pose, one continuous motion"
    RECONFIGURES = "every pose, with reconfigurations, no more than allowed"
    INCOMPLETE = "a pose is not reached, or it takes more reconfigurations than allowed"
    COLLISION = "every pose, but only in collision"
    CONSTRAINT_OPEN = "every pose, but at one a loop of the robot's description is open"


class Reconfiguration(NamedTuple):
    """A reconfiguration: a jump of the joints to another branch of solutions, between pose `index` and the next one.

    move (n,): joint values after the jump minus those before it [rad or m].
    """

    index: int
    move: np.ndarray


class Unreachable(NamedTuple):
    """A pose that is not reached: its index, the reason, and whether that is proven (else no solution was found)."""

    index: int
    reason: str
    proven: bool


@dataclass(frozen=True, eq=False)
class PathResult:
    """Result of `solve_path`: a joint motion through N poses, and what is proven about it (read-only).

    Attributes:
        robot, targets, kinds, options: the request; targets (N, F, 4, 4) [m] for F tips, kinds: the kind of each tip's target.
        q: (N, n) [rad or m], a solution of each pose, NaN where a pose is not reached.
        status, message: how the search ended, and one sentence that says what to try.
        position_error: (N,) [m], the counted error at each pose, the largest of all tips, computed with Pinocchio.
        orientation_error: (N,) [rad], likewise; None if every orientation is free.
        curve: (M, n) [rad or m], q and the rows inserted between; the motion is linear in the joints from row to row.
        at: (M,) position of each row of curve on the path (3.5 is halfway from pose 3 to pose 4).
        continuity: what is proven about the motion between the poses.
        reconfigurations, lower_bound: changes of branch, and their proven least number (None: not proven).
        unreachable: the poses that are not reached.
        max_step, path_tolerance, collision, seed: the options: (rad, m), (m, rad), a CollisionModel or None, a seed.
        elapsed: time of the search [s], without that of compiling.
        fraction: share of the path's length that one motion can follow from the start; 1 if FOLLOWED.
        tolerance_given: whether the caller gave path_tolerance.
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
        """Return whether all poses are reached, without contact, open kinematic loops or more reconfigurations than allowed."""
        return self.status in (PathStatus.FOLLOWED, PathStatus.RECONFIGURES)

    @property
    def deviation(self) -> tuple[float, float]:
        """Return upper bounds [m] and [rad] on how far a tip leaves the interpolated poses, anywhere on the path."""
        return self.continuity.largest

    @property
    def clearance(self) -> float | None:
        """Return the proven least distance [m] of any two parts on the path; None if collisions were not checked.

        The motion from one branch to another at a reconfiguration is not on the path; `Trajectory.clearance` of `retime` includes
        it.
        """
        return self.continuity.clearance

    @property
    def pieces(self) -> list[slice]:
        """Return the continuous pieces of the motion, each as a slice of the rows of `curve`.

        The motion breaks at reconfigurations and at poses that are not reached.
        """
        return pieces(self.curve, self.at, [one.index for one in self.reconfigurations])

    @property
    def largest_step(self) -> tuple[float, float]:
        """Return the largest joint step between rows of a piece: of revolute joints [rad], of prismatic joints [m]."""
        moves = [np.abs(np.diff(self.curve[piece], axis=0)).max(axis=0, initial=0.0) for piece in self.pieces]
        return self._apart(np.max(moves, axis=0) if moves else np.zeros(self.robot.n), np.max)

    @property
    def length(self) -> tuple[float, float]:
        """Return the sum of |dq| from pose to pose over all revolute joints [rad] and all prismatic joints [m]."""
        moves = np.abs(np.diff(self.q, axis=0))
        return self._apart(np.nansum(moves, axis=0), np.sum)

    def _apart(self, values: np.ndarray, of: Any) -> tuple[float, float]:
        slides = self.robot.slides
        return float(of(values[~slides], initial=0.0)), float(of(values[slides], initial=0.0))

    def raise_for_status(self) -> "PathResult":
        """Return self if the path was followed. Raises NotSolved, with the message, if not."""
        if not self.success:
            raise NotSolved(self)
        return self

    def to_dict(self) -> dict[str, Any]:
        """Return plain numbers, strings and lists, ready for JSON; rows of poses that are not reached contain None."""
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
        """Write the result to a file and return its path.

        Args:
            path: a name that ends in .csv (a row per pose: joints [rad or m], then errors), .npz (the arrays) or .json
                (`to_dict`).

        Raises:
            InvalidOption: another ending.
        """
        file = as_output(path, "a path", ".csv", ".npz", ".json")
        if (suffix := file.suffix.lower()) == ".json":
            write_whole(file, json.dumps(self.to_dict(), indent=2, allow_nan=False) + "\n")
        elif suffix == ".npz":
            # For one tip they are (N, 4, 4), so that the file can be read as poses.
            targets = self.targets if len(self.robot.tips) > 1 else self.targets[:, 0]
            arrays: dict[str, Any] = {"targets": targets, "q": self.q, "position_error": self.position_error}
            arrays |= {} if self.orientation_error is None else {"orientation_error": self.orientation_error}
            arrays |= {"curve": self.curve, "at": self.at, "tips": np.array(self.robot.tips)}
            arrays["reconfigurations"] = np.array([one.index for one in self.reconfigurations], dtype=int)
            with whole_file(file) as stream:
                np.savez_compressed(stream, joint_names=np.array(self.robot.joint_names), **arrays)
        else:
            head = ["pose", *self.robot.joint_names, "position_error"]
            columns = [self.q, self.position_error[:, None]]
            if self.orientation_error is not None:
                head.append("orientation_error")
                columns.append(self.orientation_error[:, None])
            write_table(file, head, ([k, *row] for k, row in enumerate(np.hstack(columns).tolist())))
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
        """Return the time-optimal motion along the path within joint speed and acceleration limits.

        The poses are taken as samples of a motion, and a smooth curve goes through them. It stops only where no smooth
        curve keeps the tolerance (`Trajectory.stops`). At a reconfiguration the robot stops and moves freely to the
        other branch.

        Args:
            velocity: largest joint speeds [rad/s or m/s], one number or one per joint (n,); default the robot's own.
            acceleration: largest joint accelerations [rad/s^2 or m/s^2], likewise; must be given.
            rate: samples per second.
            seed: number that fixes the random search for a free motion from one branch to another.
            path_tolerance: how far (m, rad) a tip may leave the straight chords between the poses, above the poses' own
                tolerance; the message says where straight pieces of the path itself leave them further. Default: the
                path_tolerance given to `solve_path`. If none was given, it is the larger of the default of `solve_path`
                and 1.25 times the chord's sagitta, which is how far an arc through the poses leaves the chord.
            tip_speed: speed [m/s] of the fastest tip, kept on the path wherever the limits allow (see `Trajectory.slower`), and
                exceeded nowhere, not in the free motion of a reconfiguration either.

        Returns:
            The sampled motion.

        Raises:
            InvalidOption: limits are missing or not positive, or path_tolerance is not above the poses' own tolerance.
            NotSolved: the path was not followed, or an obstacle has been moved into it since.
            MissingExtra: SciPy is not installed.
        """
        from .timing import retime

        return retime(self, velocity, acceleration, rate, seed, path_tolerance, tip_speed)

    def _repr_html_(self) -> str:
        """Return a table of the most important numbers for notebooks."""
        (turn, slide), (step, shift), (off, tilt) = self.length, self.largest_step, self.deviation
        least = "not proven" if self.lower_bound is None else f"{self.lower_bound}"
        rows = [
            ("poses", f"{len(self.q)}, not reached: {len(self.unreachable)}"),
            ("reconfigurations", f"{len(self.reconfigurations)}, the least possible: {least}"),
            ("length", f"{turn:.4g} rad" + (f" and {slide:.4g} m" if slide else "")),
            ("largest step", angle(step) + (f" and {length(shift)}" if shift else "")),
            ("off the path at most", f"{length(off)} and {angle(tilt)}"),
            ("clearance on the path at least", None if self.clearance is None else length(self.clearance)),
            ("time of the search", duration(self.elapsed)),
        ]
        how = "ik.plot(result) draws joints and bounds, ik.view(robot, result) shows the motion."
        color = GOOD if self.success else BAD
        return TextTable(self.status.name, self.message, (), [row for row in rows if row[1]], how, color=color).html()

    def __repr__(self) -> str:
        """Return one line: the status and the most important numbers."""
        turn, slide = self.length
        parts = [
            how_many(len(self.q), "pose"),
            how_many(len(self.reconfigurations), "reconfiguration"),
            f"length {turn:.4g} rad",
        ]
        return f"PathResult({self.status.name}, {', '.join(parts)}{f' and {slide:.4g} m' if slide else ''})"


def pieces(curve: np.ndarray, at: np.ndarray, breaks: list[int]) -> list[slice]:
    """Return the continuous pieces of a curve (M, n), each as a slice of its rows.

    A piece contains no NaN and no break; breaks are between pose k and the next, for k in breaks. at (M,): positions of the rows on
    the path (3.5: halfway from pose 3 to pose 4).
    """
    finite = np.asarray(np.isfinite(curve).all(axis=1))
    cut = ~(finite[:-1] & finite[1:])  # (M-1,) whether the motion breaks between two rows
    for k in breaks:
        # A contact at the last row has no step after it, so the last step is marked.
        cut[min(int(np.searchsorted(at, k)), len(cut) - 1)] = True
    starts = np.flatnonzero(np.append(True, cut))
    ends = np.append(starts[1:], len(curve))
    return [slice(int(a), int(b)) for a, b in zip(starts, ends, strict=True) if finite[a]]


def path_sentence(path: PathResult, needed: int, allowed: float, cause: str = "") -> str:
    """Return the sentence that says how a path search ended and, if it failed, what to try.

    needed: number of reconfigurations of the best path found through all poses; allowed: the largest number allowed; cause: why the
    first of the unreached poses is not reached, and what to try, or ''.
    """
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
            advice = (
                cause or "move the poses, relax the targets (free_turn, slack, mask, priority), or widen the limits"
            )
            if all(one.reason.startswith("beyond reach") for one in path.unreachable):
                advice = "move the poses inside the reach"
            met = f"{len(reached)} of {how_many(N, 'pose')} reached"
            return f"{met}; not pose {first.index}{others}: {first.reason}{cut}; {far}; {advice}"
        return (
            f"{ends}: pose {last + 1} cannot be passed, and the whole path needs {needed}; {far}; allow them "
            "(reconfigurations='fewest'), or relax the targets (free_turn, slack, mask, priority)"
        )
    turn, slide = path.length
    length = f"{turn:.3g} rad" + (f" and {slide:.3g} m" if slide else "")
    if path.status == PathStatus.COLLISION:
        touching = path.continuity.contacts[:1]
        where = f" ({' and '.join(touching[0].pair)} touch at pose {round(touching[0].place, 3):g})" if touching else ""
        return f"{how_many(N, 'pose')} followed, but only in collision{where}; move the poses or the obstacle"
    places = len(path.continuity.unproven)
    close = f"; at {how_many(places, 'place')} shapes are too close to rule out contact" if places else ""
    if path.status == PathStatus.FOLLOWED:
        return f"{how_many(N, 'pose')} followed in one motion of {length}{close}"
    breaks = ", ".join(str(one.index) for one in path.reconfigurations[:5])
    few = "provably the fewest" if path.lower_bound == needed else "the fewest found"
    return (
        f"{how_many(N, 'pose')} followed with {how_many(needed, 'reconfiguration')} ({few}), after pose {breaks}{close}"
    )
