"""Panel controls for one tip's target: typed numbers, and how its orientation is given."""

from collections.abc import Callable
from typing import Any

import numpy as np

from .session import KINDS, NONE, Session
from .viser_scene import Handle


class Goal:
    """The target of one tip, typed or dragged; `kind` is one of KINDS, or NONE if the tip has no target."""

    def __init__(self, gui: Any, session: Session, tip: str, kind: str, listen: Callable[..., None]) -> None:
        """Build the controls; listen(handle, name, job) runs a job when the visitor changes one."""
        self.session, self.tip, self.kind = session, tip, kind
        T = session.goals()[tip]
        xyz, rotation = session.words(T, kind)
        self.xyz = gui.add_text("x y z [m]", xyz, visible=self._placed)
        kinds = (*KINDS, NONE) if len(session.robot.tips) > 1 else KINDS
        orientation = gui.add_dropdown("Orientation", kinds, initial_value=kind)
        listen(orientation, f"kind {tip}", lambda: self.give(orientation.value))
        self.rotation = gui.add_text(self._label(), rotation, visible=self.posed, multiline=kind == "matrix")
        # While the fields hold these texts, the handle's target is used, which has more digits.
        self.written = xyz, rotation
        self.handle: Handle  # The handle is set by `join`.

    @property
    def posed(self) -> bool:
        """Whether the target has an orientation."""
        return self.kind not in ("free", NONE)

    def join(self, handle: Handle) -> None:
        """Attach the arrows and rings of this target."""
        self.handle = handle
        handle.turns(self.posed, self.kind != NONE)

    def give(self, kind: str) -> None:
        """Change how the orientation is given."""
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
        """Read the target from the fields and move the arrows there; return None without a target.

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
        """Return the target to which the arrows were dragged, after writing it into the fields."""
        if self.kind == NONE:
            return None
        T = self.handle.read()
        self._write(T)
        return T if self.posed else T[:3, 3]

    def put(self, T: np.ndarray) -> None:
        """Set arrows and fields to a pose (4, 4) [m]."""
        self.handle.put(T)
        self._write(T)

    def _write(self, T: np.ndarray) -> None:
        self.written = self.session.words(T, self.kind)
        self.xyz.value, rotation = self.written
        if self.posed:
            self.rotation.value = rotation
