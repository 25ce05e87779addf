"""The result of a solve."""

from typing import Any

import numpy as np

from ..copying import ReadOnly
from ..errors import InvalidConfiguration, InvalidTarget, NotSolved
from ..kernel.counted_error import KIND
from ..kernel.records import AT
from ..robot.configuration import joint_values
from ..robot.ros import header
from ..style import BAD, GOOD
from ..text import TextTable, length
from .decide import Blocked, blocked
from .explain.explanation import Explanation
from .message import sentence
from .options import GROUPS
from .outcome import SPOKEN, SolveRecord
from .registry import GENERAL
from .status import DECIDED, SEARCHED, Status, constraints_of, is_proven
from .task import all_errors, group_levels

# A singular value of the Jacobian (lengths over the robot's length scale) below SINGULAR times the largest counts as 0.
SINGULAR = 1e-8
# [rad, or length / reach] The result of a `Solver` gets a notice if a joint moved farther than FAR_MOVE from q0.
FAR_MOVE = 0.5


class Result(ReadOnly):
    """The answer of one solve, for one tip or several (read-only).

    Attributes:
        q: Joint values (n,) [rad or m], evaluated and inside the limits.
        success, status, message: Whether and how the solve succeeded, and one sentence on it, with what to try.
        position_error, orientation_error: Errors [m], [rad] at q, for several tips the largest, times the weights of the mask if it
            has any; the second is None if the target leaves orientation free.
        position_errors, orientation_errors: The same errors of each tip, by its name.
        level_errors: The errors by level of priority, most important first.
        raw_error, raw_errors: All six errors of the tip, and of each tip by its name, along the axes of the option frame, before
            slack, free_turn and mask.
        iterations, restarts, fk_evaluations: Counts of steps, of attempts after the first, and of FK evaluations (all tips count as
            one).
        attempt: Number of the attempt that q comes from; 0 is the first, which starts at q0 if that was given.
        limited_joints: Names of joints at a limit.
        largest_move: Joint that moved farthest from q0 and how far [rad or m], or None.
        elapsed, compile_time: Time of the call [s], and how long it waited before for code to be compiled or loaded.
        seed, solver, robot: Seed of the random starts, name of the solver used, and the robot.
        notice: What was corrected in the input, that q may be far from q0, and whether q keeps the closed loops of the robot
            description, or ''.
        collision: Names of two parts that touch at q if collisions are avoided and no other answer was found, otherwise None.
        clearance: Distance [m] of the nearest two parts, if collisions are avoided.
        history: Arrays q, position_error, orientation_error and attempt with a row for each start and iteration, or None.
    """

    __slots__ = ("_of",)
    _sealed = True

    def __init__(self, outcome: SolveRecord) -> None:
        """Store the SolveRecord; everything else is computed on demand."""
        keep(self, outcome)

    @property
    def q(self) -> np.ndarray:
        """Joint values (n,) [rad or m]; the best configuration evaluated if the solve failed."""
        return self._of.row[self._of.plan.q_columns]

    @property
    def status(self) -> Status:
        """The `Status` that says how the solve ended."""
        return Status(int(self._of.row[AT.status]))

    @property
    def success(self) -> bool:
        """Whether all errors are in tolerance (with a priority, only its first level) and the description's constraints hold."""
        return self.status == Status.CONVERGED

    @property
    def position_only(self) -> bool:
        """Whether every target leaves orientation free."""
        return all(kind in SPOKEN for kind in self._of.kinds)

    @property
    def position_error(self) -> float:
        """Distance of the tip from the target at q [m]; for several tips the largest."""
        return max(position for position, _ in self._of.left())

    @property
    def orientation_error(self) -> float | None:
        """Angle [rad] between the tip at q and the target, for several tips the largest; None if orientation is free."""
        return max((angle for _, angle in self._of.left() if angle is not None), default=None)

    @property
    def position_errors(self) -> dict[str, float]:
        """Distance of each tip from its target at q [m]."""
        return {tip: position for tip, (position, _) in zip(self.robot.tips, self._of.left(), strict=True)}

    @property
    def orientation_errors(self) -> dict[str, float | None]:
        """Angle [rad] between each tip and its target; None if the target leaves orientation free."""
        return {tip: angle for tip, (_, angle) in zip(self.robot.tips, self._of.left(), strict=True)}

    @property
    def level_errors(self) -> tuple[dict[str, float], ...]:
        """Errors [m], [rad] of each level of priority, most important first, under "position" and "orientation".

        With several tips the keys are "TIP position" and "TIP orientation". Without a priority there is one level.
        """
        levels = group_levels(self.robot, self._of.plan.options)
        names = [f"{tip} {group}" if len(self.robot.tips) > 1 else group for tip in self.robot.tips for group in GROUPS]
        errors = [error for pair in self._of.left() for error in pair]
        found: list[dict[str, float]] = [{} for _ in range(max(levels) + 1)]
        for level, name, error in zip(levels, names, errors, strict=True):
            if error is not None:
                found[level][name] = error
        return tuple(level for level in found if level)

    @property
    def raw_errors(self) -> dict[str, np.ndarray]:
        """Errors (6,) of each tip at q by Pinocchio: target - tip [m] and the rotation vector left [rad], in the axes of `frame`.

        The options slack, free_turn and mask are not applied. NaN if a tip has no target, and in a solved row of a batch, which
        keeps no targets.
        """
        of = self._of
        if not of.T.size:
            return {tip: np.full(6, np.nan) for tip in self.robot.tips}
        each = all_errors(self.robot, self.q, of.T, of.kinds, of.plan.options)
        return {tip: raw for tip, (raw, _, _) in zip(self.robot.tips, each, strict=True)}

    @property
    def raw_error(self) -> np.ndarray:
        """Errors (6,) of the tip as in `raw_errors`; for several tips those of the one with the largest position error."""
        errors = self.position_errors
        return self.raw_errors[max(errors, key=lambda tip: errors[tip])]

    @property
    def iterations(self) -> int:
        """Number of steps taken in all attempts."""
        return int(self._of.row[AT.iterations])

    @property
    def restarts(self) -> int:
        """Number of attempts after the first one."""
        return int(self._of.row[AT.restarts])

    @property
    def attempt(self) -> int:
        """Number of the attempt that q comes from: 0 is the first, which starts at q0 if that was given."""
        return int(self._of.row[AT.attempt])

    @property
    def notice(self) -> str:
        """What was corrected in the input, that q may be far from q0, and which constraints of the description q breaks, or ''."""
        jump, of = "", self._of
        move = None if of.plan.options.closest else self.largest_move
        if move is not None:
            joint, amount = move
            at = self.robot.joint_names.index(joint)
            slide = self.robot.joint_kinds[at] == "prismatic"
            moved = f"joint {joint} moved by {length(amount) if slide else f'{amount:.3g} rad'}"
            # Without the option `check` the solve is part of a loop, where moves are short, so a shorter move is worth a notice.
            most = np.pi if of.plan.options.check else FAR_MOVE
            if self.attempt:
                jump = f"q was found by attempt {self.attempt}, not from q0: {moved}; in a loop use follow=True"
            elif amount / self.robot.chain.unit[at] > most:
                jump = f"{moved} from q0; in a loop use follow=True"
        kept = constraints_of(self.robot, self.q, of.plan.options).text
        return "; ".join(filter(None, (of.notice, jump, kept)))

    @property
    def largest_move(self) -> tuple[str, float] | None:
        """Joint that moved farthest from q0, and how far [rad or m].

        To compare prismatic with revolute joints, lengths are divided by the size of the robot. None if no q0 was given,
        and in a solved row of a batch, which keeps no q0.
        """
        of = self._of
        if not of.given:
            return None
        moves = np.abs(self.q - np.frombuffer(of.q0))
        at = int(np.argmax(moves / self.robot.chain.unit))
        return self.robot.joint_names[at], float(moves[at])

    @property
    def fk_evaluations(self) -> int:
        """Number of evaluations of the forward kinematics."""
        return int(self._of.row[AT.evaluations])

    @property
    def limited_joints(self) -> tuple[str, ...]:
        """Names of the joints that are at a limit at q."""
        return tuple(self.robot.at_limits(self.q))

    @property
    def elapsed(self) -> float:
        """Time the call took [s], without `compile_time`."""
        return self._of.elapsed

    @property
    def compile_time(self) -> float:
        """Time [s] in which the call waited for code to be compiled (first use) or loaded (first in a process), else 0."""
        return self._of.compile_time

    @property
    def seed(self) -> int:
        """Seed of the random restarts."""
        return self._of.plan.options.seed

    @property
    def solver(self) -> str:
        """Name of the solver that was used."""
        row = self._of.plan.row
        if self._of.row[AT.excess] <= DECIDED:
            return "elimination"
        return GENERAL if row.closed and self._of.row[AT.excess] == SEARCHED else row.name

    @property
    def proven(self) -> bool:
        """Whether it is proven that no joint values within the limits reach the target.

        For a success with the option `closest`: whether it is proven that no solution is nearer to q0. The elimination certifies
        both (see `Solutions.certificate`). A target is also proven unreachable by a bound from the link lengths or by a closed
        form that fits exactly. Such a form also proves that limits block a target, unless a prismatic joint is free.
        """
        row = self._of.row
        return bool(is_proven(row[AT.status], row[AT.excess], self._of.plan))

    @property
    def blocked(self) -> Blocked | None:
        """The solution that breaks the limits least (`decide.Blocked`) if every solution is certified to break one, else None."""
        return blocked(self)

    @property
    def robot(self) -> Any:
        """The robot that was solved for."""
        return self._of.plan.robot

    @property
    def collision(self) -> tuple[str, str] | None:
        """Names of two parts that touch at q, if collisions are avoided and no answer without a contact was found."""
        return self._of.collision

    @property
    def clearance(self) -> float | None:
        """Distance [m] of the nearest two parts at q, if collisions are avoided, with all obstacles where they are now.

        It is computed on demand, as by `CollisionModel.distance`; None if collisions are not avoided, or there are no pairs to
        test.
        """
        from .collision_free import collision_model  # imported here, because that module imports this one

        asked = self._of.plan.options.avoid_collisions
        near = None if asked is False else collision_model(self.robot, asked).distance(self.q)
        return None if near is None else near.distance

    @property
    def history(self) -> dict[str, np.ndarray] | None:
        """Arrays `q`, `position_error`, `orientation_error`, `attempt` of every iteration if history=True was given, else None."""
        return self._of.history

    @property
    def message(self) -> str:
        """One sentence on how the solve ended and, after a failure, what to try (with several tips, the errors left at each)."""
        return sentence(self)

    def raise_for_status(self) -> "Result":
        """Return self, or raise NotSolved with the message if the solve failed."""
        if not self.success:
            raise NotSolved(self)
        return self

    def derivative(self) -> np.ndarray:
        """Return how q follows a small motion x of the target: dq/dx (n, 6), or (n, 3) for a position.

        By the implicit function theorem, dq/dx is the inverse of the Jacobian. x is in base axes: a displacement [m], then a
        rotation vector [rad]. Of several joint motions that follow x the smallest is chosen (angles [rad], lengths over the
        robot's scale). Joints with weight 0 (option joint_weights) stay; limits are ignored.

        Raises:
            NotSolved: The solve failed, so q is not a function of the target.
            InvalidTarget: The target is neither a pose nor a position of one tip, or only a part of it counts.
            InvalidConfiguration: The arm is singular at q, or has too few joints to follow every motion of the target.
        """
        self.raise_for_status()
        of, robot = self._of, self.robot
        if of.kinds not in ((KIND.pose,), (KIND.position,)) or of.plan.options.in_part:
            raise InvalidTarget("a derivative exists for a whole pose or a position of one tip")
        J = robot.chain.forward(self.q, jacobian=True)[1][0][: 3 if self.position_only else 6]
        weight = np.ones(len(J))
        weight[:3] = 1.0 / robot.chain.scale
        moving = np.setdiff1d(np.arange(robot.n), of.plan.held)
        unit = robot.chain.unit[moving]
        U, values, V = np.linalg.svd(J[:, moving] * weight[:, None] * unit, full_matrices=False)
        if len(values) < len(J) or values[-1] < SINGULAR * values[0]:
            able = min(robot.mobility.moves if self.position_only else robot.mobility.directions, len(moving))
            why = f"the arm moves in only {able} directions" if able < len(J) else "the arm is singular at q"
            raise InvalidConfiguration(f"{why}: no joint motion follows every motion of the target")
        made = np.zeros((robot.n, len(J)))
        made[moving] = unit[:, None] * (V.T / values @ U.T) * weight
        return made

    def explain(self) -> Explanation:
        """Explain how q was computed: D-H table, formulas of the closed form with their numbers, branches, iterations.

        Returns:
            An Explanation, which `print` shows as text, a notebook with formulas.

        Raises:
            InvalidTarget: The result is a solved row of a batch, which keeps no target.
            MissingExtra: A closed form has formulas to show, and SymPy is not installed.
        """
        from .explain.explain import explain_result  # imported here, because that module imports this one

        return explain_result(self)

    def to_ros(self) -> dict[str, Any]:
        """Return the fields of a ROS sensor_msgs/JointState at q, without velocities and efforts."""
        return {
            "header": header(),
            "name": list(self.robot.joint_names),
            "position": self.q.tolist(),
            "velocity": [],
            "effort": [],
        }

    def to_dict(self) -> dict[str, Any]:
        """Return numbers, strings and lists, ready for JSON.

        For several tips, the entry `tips` has the errors of each tip by its name; an error is None where the target leaves it
        free.
        """
        at = joint_values(self.robot, self.q)
        plain = {
            "success": self.success,
            "status": self.status.name,
            "proven": self.proven,
            "message": self.message,
            "solver": self.solver,
            "robot": self.robot.name,
            "joint_names": list(self.robot.joint_names),
            "q": self.q.tolist(),
            "mimic_joints": {joint: at[joint] for joint in self.robot.mimic_joints},
            "position_error": self.position_error,
            "orientation_error": self.orientation_error,
            "level_errors": list(self.level_errors),
            "iterations": self.iterations,
            "restarts": self.restarts,
            "attempt": self.attempt,
            "fk_evaluations": self.fk_evaluations,
            "limited_joints": list(self.limited_joints),
            "largest_move": self.largest_move,
            "elapsed": self.elapsed,
            "compile_time": self.compile_time,
            "seed": self.seed,
            "notice": self.notice,
            "collision": self.collision,
            "clearance": self.clearance,
        }
        each = zip(self.robot.tips, self._of.kinds, self._of.left(), strict=True)
        tips = {
            tip: {"position_error": None if kind == KIND.free else p, "orientation_error": r}
            for tip, kind, (p, r) in each
        }
        return {**plain, "tips": tips} if len(tips) > 1 else plain

    def __repr__(self) -> str:
        """Describe the result in one line."""
        with np.printoptions(precision=6, suppress=True):
            return f"Result({self.status.name}, q={self.q}, position_error={self.position_error:.3g}, solver='{self.solver}')"

    def _repr_html_(self) -> str:
        """Return a table for notebooks."""
        rows = zip(self.robot.joint_names, [f"{x:.6f}" for x in self.q], strict=True)
        color = GOOD if self.success else BAD
        return TextTable(self.status.name, self.message, (), rows, color=color, most=100).html()


# A Result is read-only, so its one attribute is set through the slot itself, 0.25 us faster than with object.__setattr__.
keep = vars(Result)["_of"].__set__
