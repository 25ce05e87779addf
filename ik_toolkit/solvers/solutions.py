"""What `solve_all` and `Solver.all` return: the distinct solutions of a target, and the self-motions they are samples of."""

import functools
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from ..copying import ReadOnly
from ..robot.robot import Robot
from ..text import TextTable, how_many, length
from .closed_form.elimination import certificate_of
from .closed_form.geometry import Family

__all__ = ["Family", "Solutions", "SolutionsBatch"]


class Solutions(ReadOnly):
    """Distinct solutions of one target, nearest to q0 first; len(), indexing and iteration give the rows of q.

    Attributes:
        q: Solutions (K, n) [rad or m].
        distance: Distances (K,) from q0 (angles [rad], lengths over the robot's scale).
        position_error, orientation_error: Errors (K,) [m], [rad], evaluated; the second is None for positions.
        branches: Signs (K, 3) of shoulder, elbow and wrist in one of our closed forms (0 if two branches merge or the arm has no
            such joint), otherwise None.
        found_by: Names (K,) of the solvers that found them.
        complete: Whether these are proven to be all of them, modulo 2 pi (with `all_turns`, all shifts by 2 pi k inside the
            limits).
        certificate: How complete the list is known to be, limits or not (`Certificate`, by the elimination), otherwise None.
        families: Self-motions (tuple of Family) of which the rows are a sample.
        solver, message: Name of the solver, and one sentence.
    """

    robot: Robot
    q: np.ndarray
    distance: np.ndarray
    position_error: np.ndarray
    orientation_error: np.ndarray | None
    branches: np.ndarray | None
    found_by: tuple[str, ...]
    complete: bool
    _evidence: Any
    families: tuple[Family, ...]
    solver: str
    message: str

    def __init__(
        self,
        robot: Robot,
        q: np.ndarray,
        distance: np.ndarray,
        errors: tuple[np.ndarray, np.ndarray | None],
        complete: bool,
        solver: str,
        message: str,
        families: tuple[Family, ...] = (),
        branches: np.ndarray | None = None,
        found_by: tuple[str, ...] | None = None,
        certificate: Any = None,
    ) -> None:
        """Store the arrays and texts; certificate: a Certificate, None, or the numbers of which `certificate_of` makes one."""
        self._put(
            robot=robot, q=q, distance=distance, position_error=errors[0], orientation_error=errors[1], complete=complete,
            solver=solver, message=message, families=families, branches=branches, _evidence=certificate,
            found_by=(solver,) * len(q) if found_by is None else found_by, _sealed=True,
        )  # fmt: skip

    @functools.cached_property
    def certificate(self) -> Any:
        """Evidence of how complete the list is (`Certificate`), or None; computed at the first access."""
        given = self._evidence
        return certificate_of(given) if isinstance(given, list) else given

    def __len__(self) -> int:
        """Return the number of solutions."""
        return len(self.q)

    def __iter__(self) -> Iterator[np.ndarray]:
        """Yield the solutions (n,), nearest first."""
        return iter(self.q)

    def __getitem__(self, k: int) -> np.ndarray:
        """Return solution number k (n,)."""
        return self.q[k]

    def keep(self, rows: np.ndarray) -> "Solutions":
        """Return some of the solutions, chosen by indices or booleans; the list is complete only if it was and has all of them."""
        rows = np.atleast_1d(np.arange(len(self))[rows])
        orientation = self.orientation_error
        return Solutions(
            self.robot, self.q[rows], self.distance[rows],
            (self.position_error[rows], None if orientation is None else orientation[rows]),
            self.complete and len(np.unique(rows)) == len(self), self.solver, self.message, self.families,
            None if self.branches is None else self.branches[rows], tuple(self.found_by[k] for k in rows),
            self.certificate,
        )  # fmt: skip

    def to_dict(self) -> dict[str, Any]:
        """Return numbers, strings and lists, ready for JSON."""
        orientation = self.orientation_error
        return {
            "success": len(self) > 0,
            "complete": self.complete,
            "message": self.message,
            "solver": self.solver,
            "robot": self.robot.name,
            "joint_names": list(self.robot.joint_names),
            "solutions": self.q.tolist(),
            "distance": self.distance.tolist(),
            "position_error": self.position_error.tolist(),
            "orientation_error": None if orientation is None else orientation.tolist(),
            "branches": None if self.branches is None else self.branches.tolist(),
            "found_by": list(self.found_by),
            "certificate": None if self.certificate is None else self.certificate.to_dict(),
            "families": [family._asdict() for family in self.families],
        }

    def _repr_html_(self) -> str:
        """Return a table for notebooks, a solution a row."""
        several = len({*self.found_by}) > 1
        rows = [
            (k, *(f"{x:.4f}" for x in q), gap, length(error), *([by] if several else []))
            for k, (q, gap, error, by) in enumerate(
                zip(self.q, self.distance, self.position_error, self.found_by, strict=True)
            )
        ]
        head = ("", *self.robot.joint_names, "distance", "position error", *(["found by"] if several else []))
        which = how_many(len(self), "solution") + ("; there are no others" if self.complete else "")
        how = "ik.view(robot, list(solutions)) shows them, ik.plot(solutions) draws them as lines."
        return TextTable(which, self.message, head, rows, how).html()

    def __repr__(self) -> str:
        """Describe the solutions in one line."""
        return f"Solutions({len(self)} of '{self.robot.name}', complete={self.complete}, solver='{self.solver}': {self.message})"


class SolutionsBatch(ReadOnly):
    """Solutions of many targets, all rows together; len() is the number of targets, batch[k] the Solutions of target k.

    q (M, n), distance, position_error, orientation_error and branches are as in Solutions, with a row each; target (M,)
    is the number of the target of each row; complete (N,) has a bool for each target.
    """

    def __init__(self, each: list[Solutions | None], lists: Sequence[Any]) -> None:
        """Join the solutions of all targets; where `each` has None, they are in `lists`, for successive blocks of targets."""
        self._each, self._lists = each, lists
        self._size = len(lists[0].notes) if lists and lists[0] else 1
        kept = np.concatenate([made.notes[:, 1] for made in lists if made] or [()]).tolist()
        counts = [int(kept[k]) if one is None else len(one) for k, one in enumerate(each)]
        self.target = np.repeat(np.arange(len(each)), counts)
        self.complete = np.array([one is None or one.complete for one in each], dtype=bool)
        self._seal()

    def _rows(self, k: int) -> np.ndarray:
        return self._lists[k // self._size].rows(k % self._size)

    def _joined(self, name: str) -> np.ndarray | None:
        columns = {"q": slice(3, None), "distance": 2, "position_error": 0, "orientation_error": 1}
        parts: list[Any] = [
            getattr(one, name) if one is not None else self._rows(k)[:, columns[name]]
            for k, one in enumerate(self._each)
        ]
        return None if not parts or parts[0] is None else np.concatenate(parts)

    q = property(lambda self: self._joined("q"))
    distance = property(lambda self: self._joined("distance"))
    position_error = property(lambda self: self._joined("position_error"))
    orientation_error = property(lambda self: self._joined("orientation_error"))
    branches = property(lambda self: None if None in self._each else self._joined("branches"))

    def __len__(self) -> int:
        """Return the number of targets."""
        return len(self._each)

    def __getitem__(self, k: Any) -> Any:
        """Return the Solutions of target k, of a slice a list of them."""
        at = range(len(self))[k]
        if isinstance(k, slice):
            return [self[i] for i in at]
        if self._each[at] is None:
            made = self._lists[at // self._size]
            self._each[at] = made.solutions(at % self._size, made.notice)
        return self._each[at]

    def __repr__(self) -> str:
        """Describe the solutions in one line."""
        return f"SolutionsBatch({how_many(len(self), 'target')}, {how_many(len(self.target), 'solution')})"
