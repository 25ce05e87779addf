"""The panel's Scene tab: contacts, clearance, box obstacles, manipulability, and self-motion while the tips stay in place."""

from typing import Any

import numpy as np

from ...solvers.solve import Solver
from ...style import BAD
from ...text import figure, length, vector
from .tables import note_html
from .viser_scene import Stage

BOX = (148, 103, 60)
SIDE = 0.15  # Edge of a new box, as a fraction of the robot's size.
CLEAR = 0.05  # Distance of a new box from the arm, as a fraction of the robot's size.
# The line between the nearest pair of shapes is drawn if it is shorter than this fraction of the robot's size.
NEAR = 0.25


class Around:
    """The panel's controls for obstacle boxes, contacts and velocity ellipsoids, and the drawings that belong to them."""

    def __init__(self, desk: Any) -> None:
        """Build the controls on a visitor's page, and draw the session's boxes."""
        self.desk, self.session, self.changed = desk, desk.session, desk.show
        self.stage: Stage = desk.stage
        self.handles, gui = self.stage.boxes, desk.gui
        hint = "When solving, listing solutions and dragging."
        desk._ask(gui.add_checkbox("Avoid collisions", self.session.avoid, hint=hint), "avoid", self.avoid)
        self.distance = desk._on(gui.add_checkbox("Show the nearest pair", True), "facts", self.changed)
        hint = "How fast each tip can move in each direction at joint speeds of norm 1."
        ellipsoid = gui.add_checkbox("Manipulability ellipsoid", False, hint=hint)
        self.ellipsoid = desk._on(ellipsoid, "facts", self.changed)
        side = f"{float(f'{SIDE * self.stage.size:.1g}'):g}"
        self.size = gui.add_text("Box x y z [m]", f"{side} {side} {side}")
        desk._button("Add a box", "boxes", self.add)
        desk._button("Remove the boxes", "boxes", self.clear)
        for name, (size, T) in self.session.boxes.items():
            self._draw(name, size, T)

    def avoid(self, wanted: bool) -> None:
        """Switch collision avoidance on or off."""
        self.session.avoid = wanted
        self.changed()

    def add(self) -> None:
        """Add a box of the typed size beside the arm, clear of it. Raises InvalidTarget, InvalidOption."""
        size = vector(self.size.value, "the size of the box x y z [m]", 3)
        s, clear = self.session, CLEAR * self.stage.size
        name = s.add_box(size, np.eye(4))
        for T in self.stage.spots(size):
            s.move_box(name, T)
            if not any(name in near.pair for near in s.world.distances(s.q, within=clear)):
                break
        self._draw(name, size, s.boxes[name][1])
        self.changed()

    def clear(self) -> None:
        """Remove all boxes from the session and the page."""
        for gizmo in self.handles.values():
            gizmo.remove()
        self.handles.clear()
        self.stage.keep_in_view()
        self.session.clear_boxes()
        self.changed()

    def _draw(self, name: str, size: Any, T: np.ndarray) -> None:
        self.desk._on(self.stage.box(name, size, T, BOX), name, lambda: self._moved(name))

    def _moved(self, name: str) -> None:
        self.session.move_box(name, self.stage.dragged(self.handles[name]))
        self.changed()

    def show(self) -> str:
        """Update the drawings to the session's q; return HTML with a sentence on contacts, clearance and manipulability."""
        s, stage = self.session, self.stage
        touching, near = s.contacts()
        words, color = "no pair of shapes to test", "inherit"
        if touching:
            words, color = f"in collision: {' and '.join(touching[0])}", BAD
        elif near is not None:
            words = f"clearance {length(near.distance)} ({near.pair[0]} to {near.pair[1]})"
        close = near is not None and not touching and near.distance < NEAR * stage.size and self.distance.value
        stage.line("near", [near.points] if close and near else [], (70, 70, 70))
        sizes = s.manipulability()
        for k, (tip, (axes, radii)) in enumerate(s.ellipsoids().items()):
            stage.ellipsoid(k, axes, radii, self.ellipsoid.value)
            words += f"; manipulability{f' of {tip}' if len(sizes) > 1 else ''} {figure(sizes[tip])}"
        return note_html(words, color)


# [rad or arm reaches] step along a self-motion before the tips are corrected; their error grows with the step's square
STEP = 0.02
THIN = 1e-6  # a joint motion does not move the tips if its singular value is below this fraction of the largest
LEFT = 1e-7  # [m, rad] a tip counts as staying in place if it moves by less than this


def null_directions(robot: Any, q: np.ndarray, turns: bool) -> np.ndarray:
    """Return a basis (k, n) of the joint motions at q (n,) that move no tip and, if `turns`, do not turn the tips either."""
    J = robot.jacobian(q).reshape(-1, 6, robot.n)[:, : 6 if turns else 3].reshape(-1, robot.n)
    _, sizes, V = np.linalg.svd(J, full_matrices=True)
    return V[int((sizes > THIN * max(sizes.max(initial=0.0), 1e-12)).sum()) :]


def slide(robot: Any, q: np.ndarray, along: np.ndarray, far: float, turns: bool, limits: bool) -> np.ndarray:
    """Move q (n,) by `far` [rad or arm reaches] along the self-motion nearest to direction `along`, or up to a limit.

    Each step goes in the direction of the null space that is nearest to that of the step before, so that moving back leads to the
    same place. After each step a solver corrects the tips.
    """
    poses = dict(zip(robot.tips, robot.tip_poses(q), strict=True))
    hold = robot.for_tips({tip: T.homogeneous if turns else T.translation for tip, T in poses.items()})
    solver = Solver(robot, "lm", tolerance=LEFT, limits=False, restarts=0)
    unit, done = np.where(robot.slides, robot.reach, 1.0), 0.0
    at = along / unit
    while done < abs(far):
        free = null_directions(robot, q, turns) / unit
        free = np.linalg.qr(free.T)[0].T if len(free) else free
        at = free.T @ (free @ at)
        if np.linalg.norm(at) < THIN:
            break
        at /= np.linalg.norm(at)
        step = min(STEP, abs(far) - done)
        new = solver(hold, q + np.sign(far) * step * at * unit)
        if not new.success or (limits and robot.outside(new.q)):
            break
        q, done = new.q, done + step
    return q
