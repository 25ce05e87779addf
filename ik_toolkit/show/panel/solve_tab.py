"""The panel's Solve tab: typed or dragged targets, solutions (one shown as a translucent robot), and the error per iteration."""

from typing import Any

import numpy as np

from ...style import COLOURS
from ..plots import FLOOR, iterates
from .session import KINDS, NONE
from .tables import note_html, table_rows
from .viser_scene import Handle


class Goal:
    """The fields in which the target of one tip is typed; `kind` is the form of its orientation (KINDS), or NONE for no target."""

    def __init__(self, desk: Any, tip: str, kind: str, handle: Handle) -> None:
        """Build the controls on a visitor's page; handle: the target's arrows and rings in the 3-D view."""
        self.session, self.tip, self.kind, self.handle = desk.session, tip, kind, handle
        gui, session = desk.gui, self.session
        T = session.goals()[tip]
        xyz, rotation = session.words(T, kind)
        self.xyz = gui.add_text("x y z [m]", xyz, visible=self._placed)
        kinds = (*KINDS, NONE) if session.robot.by_tip else KINDS
        desk._ask(gui.add_dropdown("Orientation", kinds, initial_value=kind), f"kind {tip}", self.give)
        self.rotation = gui.add_text(self._label(), rotation, visible=self.posed, multiline=kind == "matrix")
        # The texts that this program wrote last. As long as the user has not edited them, the target of the dragged handle is used,
        # which has more digits.
        self.written = xyz, rotation
        handle.turns(self.posed, kind != NONE)

    @property
    def posed(self) -> bool:
        """Whether the target has an orientation, and not only a position."""
        return self.kind not in ("free", NONE)

    def give(self, kind: str) -> None:
        """Set the form in which the orientation is typed: `kind` is one of KINDS ('matrix', 'free', ...), or NONE for no target."""
        self.kind = kind
        self.xyz.visible, self.rotation.visible = self._placed, self.posed
        self.rotation.multiline = kind == "matrix"
        if self.posed:
            self.rotation.label = self._label()
            self._write(self.handle.target)
        self.handle.turns(self.posed, kind != NONE)

    @property
    def _placed(self) -> bool:
        """Whether the position has a field of its own."""
        return self.kind not in ("matrix", NONE)

    def _label(self) -> str:
        names = {"quaternion": "quaternion x y z w", "matrix": "matrix, row by row"}
        return names.get(self.kind, f"r p y [{'deg' if self.session.degrees else 'rad'}]")

    def typed(self) -> np.ndarray | None:
        """Read the target from the fields and move its arrows in the view there; return the target, or None if there is none.

        Raises InvalidTarget.
        """
        if self.kind == NONE:
            return None
        if self.written == (self.xyz.value, self.rotation.value if self.posed else ""):
            target = self.handle.target if self.posed else self.handle.target[:3, 3].copy()
        else:
            target = self.session.typed(self.xyz.value, self.kind, self.rotation.value)
        self.handle.put(target)
        return target

    def dragged(self) -> np.ndarray | None:
        """Return the target to which the handle's arrows were dragged, after writing it into the fields."""
        if self.kind == NONE:
            return None
        T = self.handle.read()
        self._write(T)
        return T if self.posed else T[:3, 3]

    def put(self, T: np.ndarray) -> None:
        """Show a pose (4, 4) [m] of the target in the fields, and move its handle there."""
        self.handle.put(T)
        self._write(T)

    def _write(self, T: np.ndarray) -> None:
        self.written = self.session.words(T, self.kind)
        self.xyz.value, rotation = self.written
        if self.posed:
            self.rotation.value = rotation


GO = "Go to this solution"
SIGNS = {1: "+", -1: "\N{MINUS SIGN}", 0: "0"}
CELL = "padding:2px 10px 2px 0;white-space:nowrap;font-variant-numeric:tabular-nums;text-align:right"
# CSS that keeps the column of joint names in view while the others scroll
STAY = "position:sticky;left:0;background:#fff;text-align:left;font-weight:400"
# JavaScript of the table of solutions: pointing at a column enters its number into the field below, and a click also presses the
# button, which moves the robot there.
POINT = (
    "const e=document.getElementById('{field}'),k=event.target.cellIndex;if(k&&e.value!==String(k)){{"
    "Object.getOwnPropertyDescriptor(HTMLInputElement.prototype,'value').set.call(e,String(k));"
    "e.dispatchEvent(new Event('input',{{bubbles:true}}))}}"
)
CLICK = f"[...document.querySelectorAll('button')].find(b=>b.textContent.trim()==='{GO}').click()"


class SolutionsTab:
    """The list of solutions of `solve_all` on a visitor's page, with controls to show one and to move there."""

    def __init__(self, desk: Any) -> None:
        """Build the controls on a visitor's page, hidden until there are solutions."""
        self.session, self.ghost, gui = desk.session, desk.stage.ghost, desk.gui
        with gui.add_folder("Solutions", visible=False) as self.folder:
            self.table = gui.add_html("")
            hint = "Shown as a ghost, like a column you point at."
            self.number = desk._on(gui.add_number("Solution", 1, min=1, step=1, hint=hint), "ghost", self.point)
            desk._button(GO, "joints", lambda: desk._pick(self.chosen), color=None)

    @property
    def chosen(self) -> int:
        """Index of the chosen solution, counted from 0."""
        value = self.number.value if np.isfinite(self.number.value) else 1
        return int(np.clip(value, 1, max(len(self.session.solutions), 1))) - 1

    def point(self) -> None:
        """Show the chosen solution in the view as a second, translucent robot."""
        if self.folder.visible:
            self.ghost(self.session.solutions[self.chosen])

    def hide(self) -> None:
        """Hide the list of solutions."""
        self.folder.visible = False
        self.ghost(None)

    def show(self, details: str) -> None:
        """List the session's solutions in the panel, below the line `details`."""
        self.table.content = note_html(details) + self.rows()
        self.number.value = 1
        self.folder.visible = bool(self.session.solutions)
        self.ghost(None)

    def rows(self) -> str:
        """Write the table of solutions, one column per solution: number, branch, distance, joint values."""
        s = self.session
        signs = s.branches if s.branches is not None and np.any(s.branches) else None
        lines = [("", *(str(k + 1) for k in range(len(s.solutions))))]
        if signs is not None:
            words = [" ".join(f"{a}{SIGNS[x]}" for a, x in zip("SEW", row, strict=True)) for row in signs]
            lines.append(("branch", *words[: len(s.solutions)]))
        for i, name in enumerate(s.robot.joint_names):
            values = (f"{round(s.scale(i) * q[i], s.digits(i)) + 0.0:.{s.digits(i)}f}" for q in s.solutions)
            lines.append((f"{name} [{s.unit(i)}]", *values))
        lines.append(("distance [rad]", *(f"{distance:.3f}" for distance in s.distances)))
        rows = table_rows(lines, CELL, STAY)
        note = "<div>S, E, W: signs of shoulder, elbow and wrist.</div>" if signs is not None else ""
        point = POINT.format(field=self.number._impl.uuid)
        return (
            f'<div style="padding:2px 12px;font-size:12px;overflow:auto">{note}<table style="cursor:pointer" '
            f'onmouseover="{point}" onclick="if(event.target.cellIndex){CLICK}">{rows}</table></div>'
        )


CURVES: Any = (  # the series of the chart: iteration (abscissa), then the errors
    {"label": "iteration"},
    {"label": "position, 10^x m", "stroke": COLOURS[0], "width": 2},
    {"label": "orientation, 10^x rad", "stroke": COLOURS[1], "width": 2, "dash": (6, 4)},
)


class Chart:
    """A chart of a solve's errors over its iterations, in the page of a viser client."""

    def __init__(self, client: Any) -> None:
        """Build the chart, empty and hidden."""
        self.client = client
        empty, look = (np.array([0.0, 1.0]), np.zeros(2)), {"title": "error per iteration (log scale)", "height": 200}
        self.plot = client.gui.add_uplot(empty, CURVES[:2], scales={"x": {"time": False}}, visible=False, **look)

    def hide(self) -> None:
        """Hide the chart, because the robot was moved by something other than a solve."""
        self.plot.visible = False

    def show(self, result: Any) -> None:
        """Draw the errors of the attempt that found a Result, which has a history."""
        position, angle = iterates(result)[1:3] if result.history else (np.zeros(0), np.zeros(0))
        if len(position) < 2:
            self.hide()
            return
        # The target of a position has no orientation error, so only one curve is drawn.
        known = [position, angle] if np.isfinite(angle).all() else [position]
        curves = [np.log10(np.maximum(values, FLOOR)) for values in known]
        with self.client.atomic():
            self.plot.series = CURVES[: 1 + len(curves)]
            self.plot.data = (np.arange(len(position), dtype=float), *curves)
            self.plot.visible = True
