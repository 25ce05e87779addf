"""The panel's Learn tab: joint values to n, o, a, p and back, with the D-H table, the closed form and its branches."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from ...errors import IKError
from ...kernel.counted_error import KIND
from ...robot.pose import LAST
from ...solvers.closed_form import fits
from ...solvers.explain.dh_table import dh_blocks, dh_of
from ...solvers.explain.explanation import target_table
from ...solvers.explain.layout import SCALES, UNITS, Sentence, Table, decimals, digits, to_html, unit_of
from ...solvers.explain.worked_solution import Branch
from ...solvers.registry import find_row
from ...solvers.result import Result
from ...solvers.solve import solve
from ...style import BAD, GOOD
from .connection import QUIET, empty
from .session import Session
from .tables import as_sentence, note_html

CHOSEN = (31, 95, 153)  # colour of the button of the solution (branch) that is shown
FREEDOMS = 6  # An arm with fewer joints gets a position as target, unless a closed form solves poses.
STEP = 0.001  # [mm or deg] step of the slider for a joint value that the target leaves free


class Lesson:
    """The computations behind the tab "Learn" of the panel: forward and inverse kinematics, explained, in mm and degrees.

    `made` is the Explanation of the last inverse solution, or None; `shown` is the index of the solution (branch) that is shown;
    `T` is its target (4, 4) [m].
    """

    def __init__(self, session: Session) -> None:
        """Start a lesson on the session's robot, which has one tip."""
        self.session = session
        self.robot: Any = session.robot
        self.made: Any = None
        self.shown = 0
        self.T = np.eye(4)
        kind = KIND.pose if fits(self.robot, KIND.pose) else KIND.position if fits(self.robot, KIND.position) else None
        self.posed = self.robot.n >= FREEDOMS if kind is None else kind == KIND.pose
        self.places = decimals(self.robot.reach)
        self.table = dh_of(self.robot)

    def scale(self, i: int) -> float:
        """Return the factor from the value of joint i [rad or m] to degrees or millimetres."""
        return SCALES[unit_of(self.robot.joint_kinds[i])]

    def unit(self, i: int) -> str:
        """Return the unit in which joint i is displayed, 'deg' or 'mm'."""
        return UNITS[unit_of(self.robot.joint_kinds[i])]

    def read(self, values: list[float], shown: list[float]) -> np.ndarray:
        """Return q (n,) [rad or m] from typed joint values; an unchanged one keeps its full precision.

        Raises InvalidConfiguration.
        """
        return self.session.read_joints(values, shown, self.scale, True)

    def columns(self, T: np.ndarray) -> dict[str, tuple[float, float, float]]:
        """Return the columns n, o, a and p [mm] of a pose (4, 4)."""
        rounded = [*T[:3, :3].T.round(6), (SCALES["m"] * T[:3, 3]).round(self.places)]
        return {name: tuple((column + 0.0).tolist()) for name, column in zip("noap", rounded, strict=True)}

    def sample(self) -> np.ndarray | None:
        """Return the example pose (4, 4) that the publication of this robot computes, as printed there, or None."""
        given = self.session.entry.sample
        return matrix_of(given) if given is not None and self.posed else None

    def inverse(self, columns: dict[str, Any]) -> Result:
        """Solve for columns n, o, a and p [mm] from the current q, and explain the result. Raises InvalidTarget."""
        T = matrix_of(columns)
        T[:3, 3] /= SCALES["m"]
        return self._explain(T, "auto")

    def at(self, value: float) -> Result:
        """Solve the same target again with the free joint at a value [mm or deg]; the same branch (by its label) stays shown."""
        free, label = self.worked.free, self.label
        form = find_row(self.made.form).load()
        result = self._explain(self.T, form(**{free.parameter: value / self.scale(free.joint)}))
        self.shown = next((k for k, branch in enumerate(self.branches) if branch.label == label), self.shown)
        return result

    def _explain(self, T: np.ndarray, rule: Any) -> Result:
        result = solve(self.robot, T if self.posed else T[:3, 3], rule, q0=self.session.q)
        self.made = result.explain()
        # The target is taken from the explanation, because a typed rotation may have been corrected to an orthogonal matrix.
        self.T = self.made.targets[self.robot.tip] if self.posed else T
        self.shown = self.made.nearest
        return result

    @property
    def worked(self) -> Any:
        """The WorkedSolution of the last inverse solution by a closed form, or None."""
        return self.made.worked if self.made is not None else None

    @property
    def branches(self) -> tuple[Branch, ...]:
        """The solutions (branches) that the closed form found for the last target; () without a closed form."""
        return self.worked.branches if self.worked is not None else ()

    @property
    def label(self) -> str:
        """The label (signs of shoulder, elbow, wrist) of the solution that is shown, or ''."""
        return self.branches[self.shown].label if self.branches else ""

    def span(self) -> tuple[float, float] | None:
        """Return the range [mm or deg] for the slider of the free joint, or None; it spans all intervals within limits."""
        free = self.worked.free if self.worked is not None else None
        if free is None or not free.inside:
            return None
        low, high = (self.scale(free.joint) * x for x in (free.inside[0][0], free.inside[-1][1]))
        # The ends are rounded inwards, so that the pose is reached at both ends of the slider.
        return math.ceil(low / STEP) * STEP, math.floor(high / STEP) * STEP


def matrix_of(columns: Mapping[str, Any]) -> np.ndarray:
    """Return the homogeneous matrix (4, 4) of a pose given by its columns n, o, a (rotation) and p (position)."""
    return np.vstack([np.column_stack([columns[name] for name in "noap"]), LAST])


class Learn:
    """The controls of the tab "Learn" on a visitor's page."""

    def __init__(self, desk: Any) -> None:
        """Build the controls; there are none for a robot with several tips."""
        self.desk, self.gui = desk, desk.gui
        self.session: Session = desk.session
        self.robot: Any = self.session.robot
        self.alone = len(self.robot.tips) == 1
        if self.alone:
            self._build()
        else:
            self.gui.add_html(to_html([Sentence("Choose one tip to see its kinematics step by step.")]))

    # ------------------------------------------------------------------------------------------------------------ build
    def _build(self) -> None:
        gui = self.gui
        self.lesson = Lesson(self.session)
        with gui.add_folder("Forward: joint values to n, o, a, p"):
            self._build_forward()
        with gui.add_folder("Inverse: n, o, a, p to joint values"):
            self._build_inverse()
        self.found = gui.add_folder("Branches", visible=False)
        with gui.add_folder("D-H table"):
            self.table = gui.add_html("")
        with gui.add_folder("Closed form", visible=False) as self.form:
            self.formulas = gui.add_html("")
        with gui.add_folder("Iterations", visible=False) as self.way:
            self.iterations = gui.add_html("")
        self.free: Any = None
        self.buttons: list[Any] = []
        self.show(self.session.q)

    def _build_forward(self) -> None:
        lesson, self.values = self.lesson, []
        self.shown = [0.0] * self.robot.n
        for i, name in enumerate(self.robot.joint_names):
            low, high = (lesson.scale(i) * x for x in self.session.ends(i))
            label = f"{name} [{lesson.unit(i)}] "
            field = self.gui.add_number(label, 0.5 * (low + high), min=low, max=high, step=0.0001)
            self.values.append(self.desk._on(field, "forward", self._forward))
        self.pose = self.gui.add_html("")

    def _build_inverse(self) -> None:
        gui, lesson = self.gui, self.lesson
        self.fields = {}
        for name in "noap":
            hint, step = f"{name}_x, {name}_y, {name}_z", 10.0**-lesson.places if name == "p" else 1e-6
            shown, label = lesson.posed or name == "p", "p [mm]" if name == "p" else name
            self.fields[name] = gui.add_vector3(label, (0.0, 0.0, 0.0), step=step, visible=shown, hint=hint)
        if not lesson.posed:
            gui.add_html(to_html([Sentence("The target of this arm is a position; n, o and a follow from it.")]))
        button = self.desk._button
        button("Joint values", "solve", self._inverse, "blue")
        button("Use FK output", "fields", lambda: self._fill(self.session.poses()[self.robot.tip]))
        sample, given = lesson.sample(), self.session.entry.sample
        if sample is not None and given is not None:
            button("Load the paper's sample", "fields", lambda: self._fill(sample), hint=given["from"])
        button("Clear", "fields", self._clear)
        self.outcome = gui.add_html("")

    # ---------------------------------------------------------------------------------------------------------- actions
    def show(self, q: np.ndarray) -> None:
        """Show the joint values q (n,), and the pose matrix and D-H table for them."""
        if not self.alone:
            return
        lesson = self.lesson
        for i, field in enumerate(self.values):
            field.value = self.shown[i] = float(np.clip(round(lesson.scale(i) * q[i], 4) + 0.0, field.min, field.max))
        T = self.session.poses(q)[self.robot.tip]
        self.pose.content = to_html([target_table(T, lesson.places), Sentence("Position p in mm.")])
        self.table.content = to_html(dh_blocks(self.robot, lesson.table, q))

    def _go(self, q: np.ndarray) -> None:
        """Move the robot to q (n,) and update all controls of the panel."""
        self.session.q = q.copy()
        self.desk.show()

    def _forward(self) -> None:
        self._go(self.lesson.read([field.value for field in self.values], self.shown))

    def _fill(self, T: np.ndarray) -> None:
        for name, column in self.lesson.columns(T).items():
            self.fields[name].value = column

    def _clear(self) -> None:
        for field in self.fields.values():
            field.value = (0.0, 0.0, 0.0)
        self.lesson.made = None
        self.outcome.content = ""
        self.found.visible = self.form.visible = self.way.visible = False
        self.desk.stage.ghost(None)
        self._go(self.session.q)

    def _inverse(self) -> None:
        try:
            result = self.lesson.inverse({name: field.value for name, field in self.fields.items()})
        except IKError as error:
            self.outcome.content = note_html(str(error), BAD)
            raise
        self._branches()
        self._go(result.q)
        self._tell(result)

    def _at(self, value: float) -> None:
        """Handle a change of the free parameter."""
        result = self.lesson.at(value)
        self.pick(self.lesson.shown)
        self._tell(result)

    def _tell(self, result: Result) -> None:
        """Write the outcome, and show the target, with a line to one that is not reached."""
        goal = self.lesson.T if self.lesson.posed else self.session.poses()[self.robot.tip]
        goal[:3, 3] = self.lesson.T[:3, 3]
        self.desk._put({self.robot.tip: goal})
        words = f"{as_sentence(result.message)} {as_sentence(result.notice)}".strip()
        color = GOOD if result.success else BAD
        self.outcome.content = note_html(words, color)
        self.desk.say(words, color)
        self.desk.stage.gaps(not result.success)

    def _branches(self) -> None:
        """Build the branch buttons and the slider of the free parameter."""
        lesson = self.lesson
        empty(self.found)
        self.free, self.buttons = None, []
        span = lesson.span()
        with self.found:
            if span is not None and span[1] - span[0] > STEP:
                i = lesson.worked.free.joint
                name = f"{self.robot.joint_names[i]} [{lesson.unit(i)}]  "
                at = float(np.clip(lesson.scale(i) * lesson.made.q[i], *span))
                slider = self.gui.add_slider(name, round(span[0], 6), round(span[1], 6), STEP, at)
                self.free = self.desk._ask(slider, "free", self._at)
            self.words = self.gui.add_html("")
        self.found.visible = bool(lesson.branches)
        self._write()

    def pick(self, k: int) -> None:
        """Show solution number k of a closed form: move the arm there, and show its formulas."""
        lesson = self.lesson
        if k >= len(lesson.branches):
            return
        lesson.shown = k
        branch = lesson.branches[k]
        if branch.outside:
            self.desk.stage.show(branch.q)
            self.desk.say(f"{branch.label}: only drawn, outside the limits of {', '.join(branch.outside)}", BAD)
        else:
            self._go(branch.q)
            self.desk.say(f"branch {k + 1}: {branch.label}", GOOD)
        self._write()

    def _write(self) -> None:
        """Update formulas, text and button colours for the branch shown."""
        lesson, made = self.lesson, self.lesson.made
        for k in range(len(self.buttons), len(lesson.branches)):
            with self.found:
                self.buttons.append(self.desk._button("", "branch", lambda k=k: self.pick(k)))
        for k, button in enumerate(self.buttons):
            if k < len(lesson.branches):
                branch = lesson.branches[k]
                button.label = f"{k + 1}: {branch.label}" + (" (outside limits)" if branch.outside else "")
            button.color = CHOSEN if k == lesson.shown else QUIET
            button.visible = k < len(lesson.branches)
        if made.worked is not None and lesson.branches:
            free = [Sentence(made.free_words())] if made.worked.free is not None else []
            free += (
                [Sentence("The solver's solution is not exactly one of these branches.")] if made.chosen is None else []
            )
            values = values_table(self.robot, lesson.branches[lesson.shown].q, lesson.places)
            legend = [Sentence(made.worked.legend)] if made.worked.legend else []
            self.words.content = to_html([*free, values, *legend])
        self.form.visible = True
        blocks = made.formula_blocks(lesson.shown) if made.worked is not None else [Sentence(made.why)]
        self.formulas.content = to_html(blocks)
        self.way.visible = made.iterations is not None
        if made.iterations is not None:
            self.way.label = f"Iterations of {made.iterations.solver}"
            self.iterations.content = to_html(made.iteration_blocks())
        others = [branch for k, branch in enumerate(lesson.branches) if k != lesson.shown]
        self.desk.stage.ghost(others[0].q if len(others) == 1 else None)


def values_table(robot: Any, q: np.ndarray, places: int) -> Table:
    """Make the table of the joint values of one configuration."""
    values = zip(robot.joint_names, q, map(unit_of, robot.joint_kinds), strict=True)
    return Table(("joint", "value", ""), [(name, digits(x, unit, places), UNITS[unit]) for name, x, unit in values])
