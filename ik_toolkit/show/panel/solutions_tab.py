"""The list of solutions in the panel: a table, a ghost of the solution pointed at, and a button to go there."""

import html
from collections.abc import Callable
from typing import Any

import numpy as np

from .session import Session
from .tables import note_html

GO = "Go to this solution"
TALL = 230  # Height [pixels] of the list; the rest scrolls.
SIGNS = {1: "+", -1: "\N{MINUS SIGN}", 0: "0"}
CELL = "padding:2px 10px 2px 0;white-space:nowrap;font-variant-numeric:tabular-nums;text-align:right"
STAY = "position:sticky;top:0;background:#fff"  # The header stays visible while rows scroll.
# Pointing at a row enters its number into the field below, as typing would; a click also presses the button.
POINT = (
    "const e=document.getElementById('{field}');"
    "Object.getOwnPropertyDescriptor(HTMLInputElement.prototype,'value').set.call(e,'{k}');"
    "e.dispatchEvent(new Event('input',{{bubbles:true}}))"
)
CLICK = f"[...document.querySelectorAll('button')].find(b=>b.textContent.trim()==='{GO}').click()"


class SolutionsTab:
    """The solutions found, with their controls."""

    def __init__(
        self,
        gui: Any,
        session: Session,
        listen: Callable[..., None],
        ghost: Callable[[np.ndarray | None], None],
        go: Callable[[int], None],
    ) -> None:
        """Build the controls, hidden until there are solutions.

        ghost(q or None) shows a solution, go(k) moves there, and listen(handle, name, job) runs a job on a change.
        """
        self.session, self.ghost = session, ghost
        self.folder = gui.add_folder("Solutions", visible=False)
        with self.folder:
            self.table = gui.add_html("")
            self.number = gui.add_number(
                "Solution", 1, min=1, step=1, hint="Shown as a ghost, like a row you point at."
            )
            button = gui.add_button(GO)
        listen(self.number, "ghost", self.point)
        listen(button, "joints", lambda: go(self.chosen))

    @property
    def chosen(self) -> int:
        """Index of the chosen solution, counted from 0."""
        value = self.number.value if np.isfinite(self.number.value) else 1
        return int(np.clip(value, 1, max(len(self.session.solutions), 1))) - 1

    def point(self) -> None:
        """Show the chosen solution as a ghost."""
        if self.folder.visible:
            self.ghost(self.session.solutions[self.chosen])

    def hide(self) -> None:
        """Hide the list."""
        self.folder.visible = False
        self.ghost(None)

    def show(self, details: str) -> None:
        """List the session's solutions below a line of details."""
        self.table.content = note_html(details) + self.rows()
        self.number.value = 1
        self.folder.visible = bool(self.session.solutions)
        self.ghost(None)

    def rows(self) -> str:
        """Write the table of solutions: number, branch, distance, joint values under their names and units."""
        s = self.session
        signs = s.branches if s.branches is not None and np.any(s.branches) else None
        branch = ["branch"] if signs is not None else []
        joints = [f"{name} [{s.unit(i)}]" for i, name in enumerate(s.robot.joint_names)]
        head = "".join(f'<th style="{CELL};{STAY}">{html.escape(x)}</th>' for x in ["", *branch, "distance", *joints])
        lines = []
        for k, (q, distance) in enumerate(zip(s.solutions, s.distances, strict=True)):
            label = [] if signs is None else [" ".join(f"{a}{SIGNS[x]}" for a, x in zip("SEW", signs[k], strict=True))]
            values = [f"{s.scale(i) * x:.{s.digits(i)}f}" for i, x in enumerate(q)]
            cells = "".join(f'<td style="{CELL}">{x}</td>' for x in [f"{k + 1}", *label, f"{distance:.3f}", *values])
            point = POINT.format(field=self.number._impl.uuid, k=k + 1)
            lines.append(f'<tr style="cursor:pointer" onmouseenter="{point}" onclick="{CLICK}">{cells}</tr>')
        note = "<div>S, E, W: signs of shoulder, elbow and wrist.</div>" if branch else ""
        return (
            f'<div style="padding:2px 12px;font-size:12px;overflow:auto;max-height:{TALL}px">'
            f"{note}<table><tr>{head}</tr>{''.join(lines)}</table></div>"
        )
