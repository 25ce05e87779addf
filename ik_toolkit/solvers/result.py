"""What a solve returns."""

import enum
import html
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import NotSolved
from ..kernel.records import ANSWER, AT
from .fallback import SEARCHED
from .registry import GENERAL

if TYPE_CHECKING:
    from .solve import Solver


class Status(enum.IntEnum):
    """How a solve ended. Numbers are those of the kernel."""

    CONVERGED = 0
    STALLED = 1
    ITERATION_LIMIT = 2
    LIMIT_BLOCKED = 3
    UNREACHABLE = 4
    SINGULAR = 5
    NOT_FINITE = 6
    CHECK_FAILED = 7
    COLLISION = 10  # 8 and 9 are the kernel's own
    TOO_FAR = 11


ADVICE = {
    Status.CONVERGED: "",
    Status.STALLED: "try more restarts, another q0, or a looser tolerance",
    Status.ITERATION_LIMIT: "try more iterations, restarts, another q0, or solver 'lm'",
    Status.LIMIT_BLOCKED: "try restarts, another q0, a partial target, or wider limits",
    Status.UNREACHABLE: "move the target inside the reach",
    Status.SINGULAR: "start from another q0, or use solver 'lm' with restarts",
    Status.NOT_FINITE: "lower the gains",
    Status.CHECK_FAILED: "please report this with the robot and the target",
    Status.TOO_FAR: "move the target in smaller steps, or allow larger moves (follow)",
    Status.COLLISION: "try more restarts, another q0, or move the target or what is in the way",
}


# The configuration returned with a failure is the best that the closed form or the search after it found.
CLOSED_FORM_SAYS = {
    Status.CONVERGED: "closed form, the legal branch nearest q0; evaluated to {left}",
    Status.UNREACHABLE: "the target is out of reach by about {beyond}{kept}; the best configuration found is {left} away{at}",
    Status.LIMIT_BLOCKED: (
        "the target is in reach but {why}; the best configuration found inside the limits is "
        "{left} away{at}; widen the limits or move the target"
    ),
}
BROKEN = "every branch breaks a joint limit"


class Result:
    """Answer of one solve (read-only).

    q (n,) [rad or m], evaluated and inside the limits; success; status; message (one sentence, with what to try);
    position_error [m] and orientation_error [rad] (None when the target leaves orientation free) at q; iterations (steps
    taken), restarts, fk_evaluations; attempt (the one q comes from: 0 is the first, which starts at q0 when that was
    given); limited_joints (names standing on a limit); elapsed [s]; seed; solver (name); notice (what was corrected in the
    input, or that q comes from another attempt than the one from q0 or is half a turn from it, or ''); collision (pair of
    names that touch at q, when
    collisions are avoided and no answer without one was found, else None); history (dict of arrays q, position_error,
    orientation_error, one row an evaluation, or None).
    """

    __slots__ = (
        "_checked",
        "_given",
        "_history",
        "_notice",
        "_row",
        "_solver",
        "_status",
        "collision",
        "elapsed",
        "position_only",
    )

    def __init__(self, solver: "Solver", row: np.ndarray, elapsed: float, position_only: bool) -> None:
        """Keep the kernel's row; everything else is made when asked for."""
        self._solver = solver
        self._row = row
        self._status: Status | None = None
        self._checked: tuple[float, float | None] | None = None
        self._history: dict[str, np.ndarray] | None = None
        self.elapsed = elapsed
        self.position_only = position_only
        self._notice = ""
        self._given = False
        self.collision: tuple[str, str] | None = None

    @property
    def q(self) -> np.ndarray:
        """Joint values (n,) [rad or m]; the best configuration evaluated when the solve failed."""
        return self._row[ANSWER:]

    @property
    def status(self) -> Status:
        """How the solve ended."""
        return Status(int(self._row[AT.status])) if self._status is None else self._status

    @property
    def success(self) -> bool:
        """Whether both errors are inside their tolerances."""
        return self.status == Status.CONVERGED

    @property
    def position_error(self) -> float:
        """Distance of the tip from the target at q [m]."""
        return float(self._row[AT.position]) if self._checked is None else self._checked[0]

    @property
    def orientation_error(self) -> float | None:
        """Rotation angle left at q [rad]; None for a position-only target."""
        if self.position_only:
            return None
        return float(self._row[AT.rotation]) if self._checked is None else self._checked[1]

    @property
    def iterations(self) -> int:
        """Steps taken, over all descents."""
        return int(self._row[AT.iterations])

    @property
    def restarts(self) -> int:
        """Attempts after the first."""
        return int(self._row[AT.restarts])

    @property
    def attempt(self) -> int:
        """Number of the attempt that q comes from: 0 is the first, which starts at q0 when that was given."""
        return int(self._row[AT.attempt])

    @property
    def notice(self) -> str:
        """What was corrected in the input, and whether q is another attempt's, or half a turn or more from q0; or ''."""
        jump = ""
        if self._given and not self._solver.options.closest:
            if self.attempt:
                jump = f"q was found by attempt {self.attempt}, not from q0, and may be far from it"
            elif self.status == Status.CONVERGED and self._row[AT.held] >= 0.0:
                joint = self.robot.joint_names[int(self._row[AT.held])]
                jump = f"joint {joint} went to the other end of its range, more than half a turn from q0"
        if jump:
            jump += "; in a loop use follow=True"
        return "; ".join(filter(None, (self._notice, jump)))

    @property
    def fk_evaluations(self) -> int:
        """Forward-kinematics evaluations made."""
        return int(self._row[AT.evaluations])

    @property
    def limited_joints(self) -> tuple[str, ...]:
        """Names of the joints that stand on a limit at q."""
        return tuple(self._solver.robot.at_limits(self.q))

    @property
    def seed(self) -> int:
        """Seed of the random restarts."""
        return self._solver.options.seed

    @property
    def solver(self) -> str:
        """Name of the solver that was used."""
        return GENERAL if self._solver.row.closed and self._row[AT.excess] == SEARCHED else self._solver.row.name

    @property
    def robot(self) -> Any:
        """The robot that was solved for."""
        return self._solver.robot

    @property
    def history(self) -> dict[str, np.ndarray] | None:
        """Errors and q of every evaluation, when `history=True` was asked for."""
        return self._history

    @property
    def message(self) -> str:
        """One sentence on how the solve ended and, on failure, what to try."""
        return sentence(self)

    def raise_for_status(self) -> "Result":
        """Return self, or raise NotSolved with the sentence when the solve failed."""
        if not self.success:
            raise NotSolved(self)
        return self

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers, strings and lists, ready for JSON."""
        return {
            "success": self.success,
            "status": self.status.name,
            "message": self.message,
            "solver": self.solver,
            "robot": self.robot.name,
            "joint_names": list(self.robot.joint_names),
            "q": self.q.tolist(),
            "position_error": self.position_error,
            "orientation_error": self.orientation_error,
            "iterations": self.iterations,
            "restarts": self.restarts,
            "attempt": self.attempt,
            "fk_evaluations": self.fk_evaluations,
            "limited_joints": list(self.limited_joints),
            "elapsed": self.elapsed,
            "seed": self.seed,
            "notice": self.notice,
            "collision": self.collision,
        }

    def __repr__(self) -> str:
        """One line."""
        with np.printoptions(precision=6, suppress=True):
            return f"Result({self.status.name}, q={self.q}, position_error={self.position_error:.3g}, solver='{self.solver}')"

    def _repr_html_(self) -> str:
        """Table for notebooks."""
        colour = "#1b7837" if self.success else "#b2182b"
        cells = "".join(
            f"<tr><td>{html.escape(j)}</td><td>{x:.6f}</td></tr>"
            for j, x in zip(self.robot.joint_names, self.q, strict=True)
        )
        return f"<b style='color:{colour}'>{self.status.name}</b> {html.escape(self.message)}<table>{cells}</table>"


def sentence(result: Result) -> str:
    """One sentence on how a result ended and what to try."""
    row, status = result._row, result.status
    away = result.position_error
    left = f"{away:.3g} m" if away >= 1.0 else f"{1000 * away:.3g} mm"
    if result.orientation_error is not None:
        left += f", {np.degrees(result.orientation_error):.3g} deg"
    starts = int(row[AT.restarts]) + 1
    if result.collision is not None:
        touching = " and ".join(result.collision)
        text = f"every solution found in {starts} start{'s' * (starts > 1)} collides; in this one {touching} touch"
        return f"{text}; {ADVICE[status]}"
    if result._solver.row.closed and status in CLOSED_FORM_SAYS and row[AT.excess] != SEARCHED:
        joints = ", ".join(result.limited_joints)
        beyond = f"{1000 * row[AT.excess]:.4g} mm"
        robot = result.robot
        slides = [j for j, kind in zip(robot.joint_names, robot.joint_kinds, strict=True) if kind == "prismatic"]
        return CLOSED_FORM_SAYS[status].format(
            left=left,
            beyond=beyond,
            why=f"the stroke of {', '.join(slides)} is {beyond} too short" if row[AT.excess] > 0.0 else BROKEN,
            kept="" if result.position_only else " with its orientation kept",
            at=f", with {joints} at a limit" if joints else "",
        )
    if status == Status.CONVERGED:
        text = f"converged in {result.iterations} iterations to {left}"
        if result.restarts:
            text += f" after {result.restarts} restarts"
        return text
    budget = result._solver.options.max_evaluations
    if budget and row[AT.evaluations] >= budget and status == Status.ITERATION_LIMIT:
        text = f"the {budget} evaluations allowed were used up in {starts} start{'s' * (starts > 1)}; closest {left}"
        return f"{text}; allow more (max_evaluations)"
    if status == Status.UNREACHABLE:
        text = f"the target is beyond reach by {1000 * row[AT.excess]:.4g} mm (a bound from the link lengths); closest {left}"
    elif status == Status.TOO_FAR:
        robot, joint = result.robot, int(row[AT.held])
        far = result._solver.options.follow
        most = f"{far * robot.reach:.3g} m" if robot.joint_kinds[joint] == "prismatic" else f"{far:.3g} rad"
        text = f"{left} away where joint {robot.joint_names[joint]} has moved the {most} allowed from q0"
    elif status == Status.STALLED and starts > 1:
        text = f"closest {left} after {starts} starts; the target may be unreachable"
    elif status == Status.STALLED:
        text = f"no further progress at {left}: a local minimum of the error"
    elif status == Status.LIMIT_BLOCKED:
        joints = ", ".join(result.limited_joints)
        text = f"joint limits ({joints}) seem to block the way to the target"
        text += f"; closest {left} after {starts} start{'s' * (starts > 1)}"
    elif status == Status.ITERATION_LIMIT and result._solver.options.follow:
        return f"{left} away after {result.iterations} iterations; move the target in smaller steps, or use the tracker"
    elif status == Status.ITERATION_LIMIT:
        text = f"{left} away after {result.iterations} iterations"
    elif status == Status.SINGULAR:
        text = f"singular: no joint motion reduces the error to first order (J'e = 0, or J has no inverse); {left} away"
    elif status == Status.NOT_FINITE:
        text = "the iteration left the finite numbers; best configuration returned"
    else:
        text = "the kernel reports success but Pinocchio's own kinematics do not confirm it"
    return f"{text}; {ADVICE[status]}"
