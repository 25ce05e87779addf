"""The panel's Scene tab: contacts, clearance, box obstacles and manipulability."""

import html
from collections.abc import Callable
from typing import Any

import numpy as np

from ..errors import InvalidTarget
from ..robot.pose import length
from ..style import BAD
from ..text import vector
from .session import Session
from .stage import Stage

BOX = (148, 103, 60)
SIDE = 0.15  # edge of a new box, as a fraction of the robot's size
NEAR = 0.25  # distances below this fraction of the robot's size are drawn


class Around:
    """Controls and drawings of a robot's surroundings. facts: text below the status line, updated by `show`."""

    def __init__(self, gui: Any, session: Session, listen: Callable[..., None], changed: Callable[[], None]) -> None:
        """Build the controls; changed() is called after something was moved. listen: see Goal."""
        self.session, self.listen, self.changed = session, listen, changed
        self.stage: Stage  # set by `join`
        avoid = gui.add_checkbox(
            "Avoid collisions", session.avoid, hint="When solving, listing solutions and dragging."
        )
        listen(avoid, "avoid", lambda: self.avoid(avoid.value))
        self.distance = gui.add_checkbox("Show the nearest pair", True)
        listen(self.distance, "facts", changed)
        self.ellipsoid = gui.add_checkbox(
            "Manipulability ellipsoid",
            False,
            hint="How fast each tip can move in each direction at joint speeds of norm 1.",
        )
        listen(self.ellipsoid, "facts", changed)
        self.size = gui.add_text("Box x y z [m]", "")
        add, remove = (gui.add_button(text, color=(71, 85, 105)) for text in ("Add a box", "Remove the boxes"))
        listen(add, "boxes", self.add)
        listen(remove, "boxes", self.clear)

    def join(self, stage: Stage) -> None:
        """Draw on a new stage, including the existing boxes."""
        self.stage, self.handles = stage, {}
        side = float(f"{SIDE * stage.size:.1g}")
        self.size.value = self.size.value or f"{side:g} {side:g} {side:g}"
        for name, (size, T) in self.session.boxes.items():
            self._draw(name, size, T)

    def avoid(self, wanted: bool) -> None:
        """Switch collision avoidance on or off."""
        self.session.avoid = wanted
        self.changed()

    def add(self) -> None:
        """Add a box of the typed size in front of the robot. Raises InvalidTarget."""
        size = vector(self.size.value, "the size of the box x y z [m]", 3)
        if min(size) <= 0.0:
            raise InvalidTarget("the size of the box x y z [m] must be positive")
        T = np.eye(4)
        tips = np.array([pose[:3, 3] for pose in self.session.poses().values()])
        T[:3, 3] = tips.mean(axis=0)
        T[2, 3] += 0.5 * size[2] + 0.1 * self.stage.size  # above them
        self._draw(self.session.add_box(size, T), size, T)
        self.changed()

    def clear(self) -> None:
        """Remove all boxes."""
        for gizmo in self.handles.values():
            gizmo.remove()
        self.handles = {}
        self.session.clear_boxes()
        self.changed()

    def _draw(self, name: str, size: Any, T: np.ndarray) -> None:
        gizmo = self.handles[name] = self.stage.box(name, size, T, BOX)
        self.listen(gizmo, name, lambda: self._moved(name))

    def _moved(self, name: str) -> None:
        self.session.move_box(name, self.stage.dragged(self.handles[name]))
        self.changed()

    def show(self) -> str:
        """Update the drawings to the session's q; returns a line of HTML on contacts, clearance and manipulability."""
        s, stage = self.session, self.stage
        touching, near = s.contacts()
        words, color = "no pair of shapes to test", "inherit"
        if touching:
            words, color = f"in collision: {' and '.join(touching[0])}", BAD
        elif near is not None:
            words = f"clearance {length(near.distance)} ({near.pair[0]} to {near.pair[1]})"
        close = near is not None and not touching and near.distance < NEAR * stage.size and self.distance.value
        stage.line("/near", [near.points] if close and near else [], (70, 70, 70))
        for k, (axes, radii) in enumerate(s.ellipsoids().values()):
            stage.ellipsoid(k, axes, radii, self.ellipsoid.value)
        values = []
        for tip, size in s.manipulability().items():
            values.append(f"manipulability{f' of {tip}' if s.robot.by_tip else ''} {size:.3g}")
        words = html.escape("; ".join([words, *values]))
        return f'<div style="padding:0 12px 8px;font-size:12px;color:{color}">{words}</div>'
