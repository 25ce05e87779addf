"""Contents of a scene by name: robots and their copies, bounding boxes, legend entries, and the drawings of a result."""

import logging
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..copying import Unique
from ..errors import InvalidOption, floats, near_match
from ..robot.joints import Joints
from ..validate import number
from .body import Body, DrawnShape, grid_cell
from .meshcat_server import Cloud, Copy, Window

# An object farther away or larger than FAR [scene sizes] is ignored when the camera is moved back to see everything.
FAR = 3.0


Color = tuple[float, float, float]  # red, green and blue in 0..1


def css(color: Sequence[float]) -> str:
    """Convert a colour (r, g, b) in 0..1 to CSS text such as '#3a7bd5'."""
    return "#" + "".join(f"{round(255 * c):02x}" for c in color)


def read_color(color: Any) -> Color | None:
    """Check a colour given by the user, three numbers from 0 to 1 or None, and return it as (r, g, b). Raises InvalidOption."""
    if color is None:
        return None
    what = "a colour must be red, green and blue from 0 to 1, such as (0.8, 0.2, 0.1)"
    rgb = floats(color, what, InvalidOption)
    if rgb.shape != (3,) or not ((rgb >= 0.0) & (rgb <= 1.0)).all():
        bytes_ = rgb.shape == (3,) and ((rgb >= 0.0) & (rgb <= 255.0)).all()
        meant = f"; for 0 to 255 write {tuple((rgb / 255.0).round(3).tolist())}" if bytes_ else ""
        raise InvalidOption(f"{what}, not {rgb.tolist()}{meant}")
    r, g, b = rgb.tolist()
    return r, g, b


def read_opacity(opacity: Any) -> float | None:
    """Check an opacity given by the user, a number from 0 to 1 or None, and return it. Raises InvalidOption."""
    if opacity is not None and not 0.0 <= number(opacity, "opacity") <= 1.0:
        raise InvalidOption(f"opacity must be from 0 (invisible) to 1 (solid), not {opacity!r:.60}")
    return None if opacity is None else float(opacity)


def read_text(text: Any, what: str) -> str:
    """Check a text given by the user and return it; if `what` is 'name', it must not be empty or have a slash.

    Raises InvalidOption.
    """
    if not isinstance(text, str) or (what == "name" and not text):
        raise InvalidOption(f"{what} must be text, not {text!r:.60}")
    if what == "name" and "/" in text:
        raise InvalidOption(f"a name has no '/', which leads to the parts of a drawing; got {text!r:.60}")
    return text


def read_labels(labels: Any) -> list[str]:
    """Check labels given by the user and return them as a list of texts. Raises InvalidOption for anything else."""
    if isinstance(labels, str) or not isinstance(labels, Iterable):
        raise InvalidOption(f"labels must be a list of texts, not {labels!r:.60}")
    return [read_text(label, "a label") for label in labels]


class SceneState(Unique):
    """Base class of Scene: keeps everything drawn in a 3-D scene by name, with the page's texts and camera."""

    def __init__(self, robot: Joints, title: str | None = None) -> None:
        """Start with nothing drawn of a Robot or a Tree."""
        self.robot = robot
        self.body = Body(robot)
        self.window = Window()
        # For each robot drawn with meshes of its own: its Body, and the pose (4, 4) of its world frame in the scene. Other robots
        # are drawn as copies of "robot".
        self._bodies = {"robot": (self.body, np.eye(4))}
        # Poses (F, P, 4, 4) of the P parts of each robot, by its name: row 0 as it stands now, then a row for each frame of an
        # animation.
        self._placed: dict[str, np.ndarray] = {}
        self._looks: dict[str, tuple[Color | None, float]] = {}  # colour and opacity of each robot
        self._parts: dict[str, np.ndarray] = {}  # which parts (P,) of each robot are drawn
        # corners (2, 3) [m] of the bounding box of everything drawn, by name, in world axes
        self._boxes: dict[str, np.ndarray] = {}
        self._legend: dict[str, list[tuple[str, str]]] = {}
        self._grid: list[tuple[str, str]] = []
        self._shown: set[str] = set()  # names of what was drawn for a result, and is removed with it
        # how each coordinate frame is drawn (its properties, the size last), by name
        self._marks: dict[str, tuple[Any, ...]] = {}
        self._around: Any = None  # the CollisionModel whose obstacles belong to the result, and its version
        self._inline = False  # whether a notebook cell shows an earlier state of the scene
        self._captioned = False  # whether the lines under the title are those of a result
        self.window.say(title=read_text(robot.name if title is None else title, "title"))
        self.say()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of everything drawn, by which it can be moved or removed."""
        return tuple(self._boxes)

    def remove(self, name: str) -> None:
        """Remove something by its name, or everything whose name begins with it and "/".

        Raises InvalidOption if there is nothing of this name.
        """
        found = [one for one in self._boxes if one == name or one.startswith(f"{name}/")]
        if not found:
            raise InvalidOption(f"nothing named '{name!s:.60}' is drawn.{near_match(name, self._boxes)}")
        if self.window.about["animation"] is not None and name in self._placed:
            self._stop()
        for one in found:
            self._drop(one)

    def _known(self, name: Any) -> None:
        """Raise InvalidOption unless a frame or a shape of this name is drawn."""
        if name in self._placed:
            raise InvalidOption(f"'{name}' is a robot: show(q, {name!r}) moves it")
        if not isinstance(name, str) or name not in self.window.transforms:
            movable = [one for one in self._boxes if one in self.window.transforms]
            raise InvalidOption(f"no frame or shape named '{name!s:.60}' is drawn.{near_match(name, movable)}")

    def _clear(self, name: str) -> None:
        """Remove what is drawn under a name, before it is drawn anew. Raises InvalidOption for the scene's own robot."""
        if name == "robot":
            raise InvalidOption("'robot' is the name of the scene's robot: give another name")
        self._drop(name)

    def _draw(self, name: str, drawn: DrawnShape | Cloud, points: np.ndarray, *entries: tuple[str, str]) -> None:
        """Draw something that surrounds points (N, 3) [m], world axes, and its legend entries without empty labels."""
        self._clear(name)
        self.window.draw(name, drawn)
        self._boxes[name] = np.array([points.min(axis=0), points.max(axis=0)])
        if entries := tuple(one for one in entries if one[1]):
            self._say(name, *entries)

    def _drop(self, name: str) -> None:
        self.window.delete(name)
        moved = name in self._placed
        for kept in (self._placed, self._looks, self._parts, self._boxes, self._legend, self._marks):
            kept.pop(name, None)
        # The translucent copies of the robot use its meshes, which are removed with it, so they are drawn anew.
        if name == "robot":
            for one in self._placed.keys() - self._bodies.keys():
                self._put(one, self._placed[one], self._looks.pop(one))
        elif moved:
            self._bodies.pop(name, None)
            self._refresh()
        self.window.say(names=[one for one in self.window.about["names"] if one[0] != name])
        self._tell()

    # ------------------------------------------------------------------------------------------------------- robots
    def _body(self, name: str) -> tuple[Body, np.ndarray]:
        """Return the drawn parts of the robot of a name, and the pose (4, 4) of its world frame in the scene's."""
        return self._bodies.get(name, self._bodies["robot"])

    def _poses(self, name: str, Q: np.ndarray) -> np.ndarray:
        """Return the poses (N, P, 4, 4) [m] of the parts of a robot at Q (N, n), and widen its box."""
        body, T = self._body(name)
        ends = np.array([body.bounds(q, world=T) for q in Q[:: max(1, len(Q) // 12)]])
        self._boxes[name] = np.array([ends[:, 0].min(axis=0), ends[:, 1].max(axis=0)])
        return np.array([T @ body.placements(q) for q in Q])

    def _put(self, name: str, poses: np.ndarray, look: tuple[Any, Any]) -> None:
        """Draw a robot at the first of F sets of part poses (F, P, 4, 4); look: colour and opacity, None keeps the present ones."""
        if self._inline and not self.window.feeds:
            self._inline = False
            told = "the scene in the cell does not move: view(..., live=True) makes one that does, or end a cell with it again"
            logging.getLogger("ik_toolkit").warning(told)
        before = self._looks.get(name)
        color, opacity = before or (None, 1.0)
        now = color if look[0] is None else look[0], opacity if look[1] is None else look[1]
        if now != before:
            self.window.delete(name)
            self._parts.pop(name, None)
        self._looks[name], self._placed[name] = now, poses
        self._refresh()
        for part, T in zip(self._body(name)[0].parts, poses[0], strict=True):
            self.window.place(f"{name}/{part.name}", T)

    def _refresh(self) -> None:
        """Draw each copy without the parts that coincide, in all frames of the animation, with those of a robot drawn before."""
        earlier: list[np.ndarray] = []
        for name in sorted(self._placed, key=lambda name: name != "robot"):
            body, _ = self._body(name)
            wanted, poses = np.ones(len(body.parts), dtype=bool), self._placed[name]
            if body is self.body:
                for other in earlier if name != "robot" else ():
                    wanted &= body.apart(poses, other)
                earlier.append(poses)
            drawn = self._parts.get(name, np.zeros(len(wanted), dtype=bool))
            color, opacity = self._looks[name]
            for p in np.flatnonzero(wanted != drawn):
                for k, shape in enumerate(body.parts[p].shapes):
                    path, source = (f"{who}/{body.parts[p].name}/{k}" for who in (name, "robot"))
                    if drawn[p]:
                        self.window.delete(path)
                    elif color is not None and name not in self._bodies and source in self.window.objects:
                        self.window.draw(path, Copy(source, color, opacity))
                    else:
                        look = {"color": color or shape.color, "opacity": opacity * shape.opacity}
                        self.window.draw(path, replace(shape, **look))
            self._parts[name] = wanted

    def _stop(self) -> None:
        """End the animation: robots stay at their initial poses."""
        if self.window.about["animation"] is not None:
            self.window.say(animation=None)
        for name, poses in self._placed.items():
            self._placed[name] = poses[:1]

    # ---------------------------------------------------------------------------------------------- results and text
    def _forget(self, those: set[str]) -> None:
        """Remove what belonged to a result, with its caption and animation."""
        self._stop()
        self._legend.pop("robot", None)
        self._tell()
        for name in sorted(those & self._boxes.keys()):
            self._drop(name)
        self._shown -= those
        if self._captioned:
            self.say()

    def say(self, *lines: str) -> None:
        """Write lines under the title. Raises InvalidOption for anything but text."""
        notice = [self.body.notice] if self.body.notice else []
        self.window.say(lines=[*notice, *(read_text(line, "a line") for line in lines)])
        self._captioned = False

    def _say(self, name: str, *entries: tuple[str, str]) -> None:
        """Set the legend entries (colour, label) of a drawn object; they are removed with it."""
        self._legend[name] = [*entries]
        self._tell()

    def _tell(self) -> None:
        told = dict.fromkeys([*(entry for entries in self._legend.values() for entry in entries), *self._grid])
        if [*told] != self.window.about["legend"]:
            self.window.say(legend=[*told])

    def look(self, eye: Sequence[float] | None = None, target: Sequence[float] | None = None) -> None:
        """Put the camera at `eye`, looking at `target` [m], world axes; without arguments it sees everything drawn so far.

        Raises InvalidOption if eye and target are not finite numbers (3,), or are the same point.
        """
        low, high = self._box()
        centre, radius = 0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low))
        to = centre if target is None else self._points(target, "target must be a point (3,) [m]", False)[0]
        away = 1.6 * max(radius, 1e-3) * np.array([0.66, -0.63, 0.41])
        at = to + away if eye is None else self._points(eye, "eye must be a point (3,) [m]", False)[0]
        if np.linalg.norm(at - to) <= 1e-9 * (1.0 + radius):
            raise InvalidOption(f"the camera cannot look from {at.tolist()} at the same point")
        cell = grid_cell(max(radius, 1e-3))
        self.window.say(camera=[at.tolist(), to.tolist(), 2.0 * cell, self.body.floor])
        self._grid = [("#b9c2cc", f"grid {1000 * cell:g} mm" if cell < 1.0 else f"grid {cell:g} m")]
        self._tell()

    def _aimed(self) -> Window:
        if self.window.about["camera"] is None:
            self.look()
        return self.window

    def _follow(self, q: np.ndarray) -> None:
        """Aim the camera anew, from the same side, if a tip of the robot at q (n,) or a target is outside a square picture.

        It stays if it is not aimed yet, and while targets can be dragged, because it would move under the pointer.
        """
        about = self.window.about
        if about["camera"] is None or "drag" in about:
            return
        eye, to = np.array(about["camera"][:2])
        targets = [box for name, box in self._boxes.items() if name.startswith("target")]
        seen, ahead = np.vstack([self.body.tips(q)[:, :3, 3], *targets]) - eye, (to - eye) / np.linalg.norm(to - eye)
        # Tangent of half the angle that the viewer's camera sees from top to bottom (75 degrees).
        if (seen @ ahead < np.cos(np.radians(37.5)) * np.linalg.norm(seen, axis=1)).any():
            low, high = self._box()
            self.look((0.5 * (low + high) - 0.9 * np.linalg.norm(high - low) * ahead).tolist())

    # ---------------------------------------------------------------------------------------------- sizes and places
    def drawn(self) -> dict[str, np.ndarray]:
        """Return the world pose (4, 4) of everything drawn, by path ('robot/PART', 'target', ...); for a trail, the identity."""
        still = [path for path in self._boxes if path in self.window.objects]
        return {path: self.window.pose(path) for path in (*self.window.transforms, *still)}

    def _box(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the corners (3,) [m] of the box around everything drawn, or around the robot at home."""
        boxes = np.array([*self._boxes.values()] or [self.body.bounds(self.robot.home)])
        return boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)

    def _extent(self) -> float:
        low, high = self._box()
        return max(0.7 * float(np.linalg.norm(high - low)), 1e-3)

    def _see(self, name: str, points: np.ndarray) -> bool:
        """Store the bounding box of points (N, 3) [m], world axes, for aiming the camera; return whether it is used.

        It is not if it is far away or much larger than everything else.
        """
        low, high = points.min(axis=0), points.max(axis=0)
        near, size = [*self._boxes.values()], self._extent()
        centre = np.mean(near, axis=(0, 1)) if near else 0.5 * (low + high)
        seen = max(np.linalg.norm(0.5 * (low + high) - centre), np.linalg.norm(high - low)) <= FAR * size
        self._boxes[name] = np.array([low, high]) if seen else np.array([centre, centre])
        return bool(seen)

    def _points(self, points: Any, what: str, several: bool = True) -> np.ndarray:
        """Return finite points (N, 3) [m]. Raises InvalidOption."""
        P = np.atleast_2d(floats(points, what, InvalidOption))
        finite = np.isfinite(P).all()
        if P.ndim != 2 or P.shape[1] != 3 or not len(P) or not finite or (len(P) > 1 and not several):
            raise InvalidOption(f"{what}, not {f'shape {P.shape}' if finite else P.tolist()!s:.80}")
        return P

    def _world(self, points: Any) -> np.ndarray:
        """Return points (N, 3) [m] of the base in world axes. Raises InvalidOption."""
        base = self.body.T_world_base
        return self._points(points, "points must be finite numbers (N, 3)") @ base[:3, :3].T + base[:3, 3]

    def _cloud(self, points: Any, success: Any) -> tuple[np.ndarray, np.ndarray]:
        """Return points (N, 3) [m] in world axes, and which of them succeeded (N,). Raises InvalidOption."""
        P = self._world(points)
        success = np.ones(len(P), dtype=bool) if success is None else success
        good = floats(success, "success must be bools", InvalidOption, "biu")
        if good.shape != (len(P),):
            raise InvalidOption(f"success must have one value per point ({len(P)}), not shape {good.shape}")
        return P, good.astype(bool)

    def _tips(self, Q: np.ndarray) -> np.ndarray:
        """Return the positions (N, tips, 3) [m] of the tips in base axes at Q (N, n)."""
        return np.array([[T.translation for T in self.robot.tip_poses(q)] for q in Q])
