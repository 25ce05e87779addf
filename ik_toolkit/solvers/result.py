"""Result of a solve."""

import html
from typing import Any

import numpy as np

from ..errors import NotSolved
from ..kernel.counted_error import FREE
from ..kernel.records import ANSWER, AT
from ..readonly import ReadOnly
from ..robot.ros import header
from ..style import BAD, GOOD
from .explain.explanation import Explanation
from .message import sentence
from .outcome import SPOKEN, SolveRecord
from .registry import GENERAL
from .status import SEARCHED, Status, constraints_of
from .task import all_errors


class Result(ReadOnly):
    """Answer of one solve, for one tip or several (read-only).

    q (n,) [rad or m], evaluated and inside the limits; success; status; message (one sentence, with what to try);
    position_error [m] and orientation_error [rad] (None when the target leaves orientation free) at q, of several tips the
    largest; position_errors and orientation_errors: the same by tip, what counts of them; raw_error (6,), raw_errors by tip:
    all of them; iterations (steps taken), restarts, fk_evaluations (all
    tips count as one); attempt (the one q comes from: 0 is the first, which starts at q0 when that was given); limited_joints
    (names standing on a limit); elapsed [s]; seed; solver (name); notice (what was corrected in the input, or that q comes
    from another attempt than the one from q0 or is half a turn from it, and what q does to loops of the description, or '');
    collision (pair of names that touch at q, when collisions are avoided and no answer without one was found, else None);
    history (dict of arrays q, position_error, orientation_error and attempt, one row per evaluation, or None; attempt is -1 in
    later attempts than the first 12 and the one that q comes from).
    """

    __slots__ = ("_of",)
    _sealed = True

    def __init__(self, outcome: SolveRecord) -> None:
        """Store the record; everything else is computed on demand."""
        keep(self, outcome)

    @property
    def q(self) -> np.ndarray:
        """Joint values (n,) [rad or m]; the best configuration evaluated when the solve failed."""
        return self._of.row[ANSWER : ANSWER + self._of.plan.robot.n]

    @property
    def status(self) -> Status:
        """How the solve ended."""
        return Status(int(self._of.row[AT.status]))

    @property
    def success(self) -> bool:
        """Whether all errors are inside their tolerances, and the constraints of the description hold."""
        return self.status == Status.CONVERGED

    @property
    def position_only(self) -> bool:
        """Whether every target leaves orientation free."""
        return all(kind in SPOKEN for kind in self._of.kinds)

    @property
    def position_error(self) -> float:
        """Distance of the tip from the target at q [m]; of several tips the largest."""
        return max(position for position, _ in self._of.left())

    @property
    def orientation_error(self) -> float | None:
        """Rotation angle left at q [rad], of several tips the largest; None where orientation is free."""
        return max((angle for _, angle in self._of.left() if angle is not None), default=None)

    @property
    def position_errors(self) -> dict[str, float]:
        """Distance of each tip from its target at q [m]."""
        return {tip: position for tip, (position, _) in zip(self.robot.tips, self._of.left(), strict=True)}

    @property
    def orientation_errors(self) -> dict[str, float | None]:
        """Rotation angle left at each tip [rad]; None where the target leaves orientation free."""
        return {tip: angle for tip, (_, angle) in zip(self.robot.tips, self._of.left(), strict=True)}

    @property
    def raw_errors(self) -> dict[str, np.ndarray]:
        """e (6,) of each tip at q by Pinocchio: target - tip [m] and the rotation vector left [rad], in the axes of `frame`.

        Before slack, free turn and mask; NaN where a tip has no target, or in a row of a batch, which keeps no targets.
        """
        of = self._of
        if not of.T.size:
            return {tip: np.full(6, np.nan) for tip in self.robot.tips}
        each = all_errors(self.robot, self.q, of.T, of.kinds, of.plan.options)
        return {tip: raw for tip, (raw, _, _) in zip(self.robot.tips, each, strict=True)}

    @property
    def raw_error(self) -> np.ndarray:
        """The same (6,) of the tip; of several the one with the largest position error."""
        errors = self.position_errors
        return self.raw_errors[max(errors, key=lambda tip: errors[tip])]

    @property
    def iterations(self) -> int:
        """Steps taken, over all attempts."""
        return int(self._of.row[AT.iterations])

    @property
    def restarts(self) -> int:
        """Attempts after the first."""
        return int(self._of.row[AT.restarts])

    @property
    def attempt(self) -> int:
        """Number of the attempt that q comes from: 0 is the first, which starts at q0 when that was given."""
        return int(self._of.row[AT.attempt])

    @property
    def notice(self) -> str:
        """What was corrected in the input, whether q is another attempt's or half a turn or more from q0, and what q does to
        the constraints of the description; or ''.
        """
        jump, of = "", self._of
        if of.given and not of.plan.options.closest:
            if self.attempt:
                jump = f"q was found by attempt {self.attempt}, not from q0, and may be far from it"
            elif self.status == Status.CONVERGED and of.row[AT.held] >= 0.0:
                joint = self.robot.joint_names[int(of.row[AT.held])]
                jump = f"joint {joint} went to the other end of its range, more than half a turn from q0"
        if jump:
            jump += "; in a loop use follow=True"
        kept = constraints_of(self.robot, self.q, of.plan.options).text
        return "; ".join(filter(None, (of.notice, jump, kept)))

    @property
    def fk_evaluations(self) -> int:
        """Forward-kinematics evaluations made."""
        return int(self._of.row[AT.evaluations])

    @property
    def limited_joints(self) -> tuple[str, ...]:
        """Names of the joints that stand on a limit at q."""
        return tuple(self.robot.at_limits(self.q))

    @property
    def elapsed(self) -> float:
        """Time the call took [s]."""
        return self._of.elapsed

    @property
    def seed(self) -> int:
        """Seed of the random restarts."""
        return self._of.plan.options.seed

    @property
    def solver(self) -> str:
        """Name of the solver that was used."""
        row = self._of.plan.row
        return GENERAL if row.closed and self._of.row[AT.excess] == SEARCHED else row.name

    @property
    def robot(self) -> Any:
        """The robot that was solved for."""
        return self._of.plan.robot

    @property
    def collision(self) -> tuple[str, str] | None:
        """Names of two parts that touch at q, when collisions are avoided and no answer without one was found."""
        return self._of.collision

    @property
    def clearance(self) -> float | None:
        """Distance [m] of the nearest two parts at q, when collisions are avoided, with all obstacles where they are now.

        Measured on demand, as `CollisionModel.distance` does; None without collisions to avoid, or pairs to test.
        """
        from .collision_free import collision_model  # which reads this file

        asked = self._of.plan.options.avoid_collisions
        near = None if asked is False else collision_model(self.robot, asked).distance(self.q)
        return None if near is None else near.distance

    @property
    def history(self) -> dict[str, np.ndarray] | None:
        """Errors and q of every evaluation, when `history=True` was asked for."""
        return self._of.history

    @property
    def message(self) -> str:
        """One sentence on how the solve ended and, on failure, what to try (of several tips, which is how far)."""
        return sentence(self)

    def raise_for_status(self) -> "Result":
        """Return self, or raise NotSolved with the sentence when the solve failed."""
        if not self.success:
            raise NotSolved(self)
        return self

    def explain(self) -> Explanation:
        """How the answer comes about: D-H table, closed form with the numbers put in, branches, iterations (see `Explanation`).

        `print` shows it as text, a notebook with formulas. Raises InvalidTarget for a row of a batch, which keeps no
        target, and MissingExtra without SymPy where a closed form has formulas to show.
        """
        from .explain.explain import explain_result  # which reads this file

        return explain_result(self)

    def to_ros(self) -> dict[str, Any]:
        """Fields of a ROS sensor_msgs/JointState at q, without velocities and efforts."""
        return {
            "header": header(),
            "name": list(self.robot.joint_names),
            "position": self.q.tolist(),
            "velocity": [],
            "effort": [],
        }

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers, strings and lists, ready for JSON; of several tips the errors by tip under `tips`, None at a free one."""
        plain = {
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
            "clearance": self.clearance,
        }
        each = zip(self.robot.tips, self._of.kinds, self._of.left(), strict=True)
        tips = {
            tip: {"position_error": None if kind == FREE else p, "orientation_error": r} for tip, kind, (p, r) in each
        }
        return {**plain, "tips": tips} if len(tips) > 1 else plain

    def __repr__(self) -> str:
        """One line."""
        with np.printoptions(precision=6, suppress=True):
            return f"Result({self.status.name}, q={self.q}, position_error={self.position_error:.3g}, solver='{self.solver}')"

    def _repr_html_(self) -> str:
        """Table for notebooks."""
        colour = GOOD if self.success else BAD
        cells = "".join(
            f"<tr><td>{html.escape(j)}</td><td>{x:.6f}</td></tr>"
            for j, x in zip(self.robot.joint_names, self.q, strict=True)
        )
        return f"<b style='color:{colour}'>{self.status.name}</b> {html.escape(self.message)}<table>{cells}</table>"


keep = vars(Result)["_of"].__set__  # past the guard, faster than object.__setattr__ by a quarter of a microsecond
