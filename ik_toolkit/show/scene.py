"""The 3-D view: robot, ghosts, targets, trails, clouds and animations; live in a browser, in a notebook, or as one file."""

import base64
import html
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..copying import Unique
from ..errors import InvalidOption, InvalidTarget, floats
from ..robot.joints import Joints
from ..robot.pose import AxisTarget, check_target
from ..text import angle as in_words
from ..text import length
from .animation import MAX_FRAMES, SLATE, animate, motion_of
from .body import GREY, Body, DrawnShape, grid_cell, need_trimesh, split_sharp_edges, tube
from .feed import Guest
from .meshcat_server import Window, write_page
from .plots import iterates

# Colours of Okabe and Ito (2008), as in the plots.
BLUE, ORANGE, GREEN, PURPLE = (0.0, 0.447, 0.698), (0.835, 0.369, 0.0), (0.0, 0.62, 0.451), (0.8, 0.475, 0.655)
YELLOW, SKY, RED = (0.902, 0.624, 0.0), (0.337, 0.706, 0.914), (0.80, 0.20, 0.15)
TRAILS = (ORANGE, PURPLE, GREEN, SKY, YELLOW)  # colours of the paths of several tips
GHOSTS = (BLUE, GREEN, YELLOW, PURPLE, SKY, ORANGE, (0.94, 0.89, 0.26), (0.45, 0.30, 0.18))
AXES = ((0.82, 0.18, 0.16), (0.16, 0.62, 0.24), (0.13, 0.38, 0.78))  # colours of x, y and z axes
FAR = 3.0  # [scene sizes] a target farther away does not shrink the picture
BETWEEN = 6  # frames between two iterates of a solve, so that the eye can follow
MAX_GHOSTS = 12


def css(color: Sequence[float]) -> str:
    """Return a CSS colour for (r, g, b) in 0..1."""
    return "#" + "".join(f"{round(255 * c):02x}" for c in color)


class Scene(Unique):
    """The drawing of one robot. Poses are in the robot's base axes [m], joint values as in `robot`.

    `drawn()` returns all poses for tests. Raises MissingExtra without meshcat or trimesh.
    """

    def __init__(self, robot: Joints, title: str | None = None) -> None:
        """Create an empty scene for a Robot or a Tree."""
        self.robot = robot
        self.body = Body(robot)
        self.window = Window()
        self._corners: list[np.ndarray] = []
        self._placed: dict[str, np.ndarray] = {}  # poses (P, 4, 4) of the parts of the robot and its copies
        self._legend: list[tuple[str, str]] = []
        self._names: list[tuple[str, str, int]] = []
        self.window.say(title=title or robot.name)
        self.say()

    def show(
        self,
        q: Any,
        name: str = "robot",
        color: tuple[float, float, float] | None = None,
        opacity: float = 1.0,
        label: str = "",
    ) -> None:
        """Draw the robot at q (n,), or move it; with a colour, a translucent copy, without parts that others have there."""
        poses = self.body.placements(q)
        if color is not None:
            self._placed.pop(name, None)
            self.window.delete(name)
            if "robot" not in self._placed:
                self.show(q)
            drawn = np.all([self.body.apart(poses, others) for others in self._placed.values()], axis=0)
            for part, alone in zip(self.body.parts, drawn, strict=True):
                for k in range(len(part.shapes) if alone else 0):
                    self.window.copy(f"{name}/{part.name}/{k}", f"robot/{part.name}/{k}", color, opacity)
        elif name not in self._placed:
            for part in self.body.parts:
                for k, shape in enumerate(part.shapes):
                    self.window.shape(f"{name}/{part.name}/{k}", shape)
        self._placed[name] = poses
        for part, T in zip(self.body.parts, poses, strict=True):
            self.window.place(f"{name}/{part.name}", T)
        self._corners.append(self.body.bounds(q))
        if label:
            self._say(css(color or SLATE), label)

    def ghosts(self, Q: Any, labels: Iterable[str] = ()) -> None:
        """Draw the robot translucent at the rows of Q (N, n), at most the first 12, in eight alternating colours."""
        names = [*labels]
        for k, q in enumerate(np.atleast_2d(Q)[:MAX_GHOSTS]):
            label = names[k] if k < len(names) else ""
            self.show(q, f"ghost_{k + 1}", GHOSTS[k % len(GHOSTS)], 0.32, label)

    def frame(self, T_base: Any, name: str = "target", size: float | None = None, label: str = "") -> None:
        """Draw the axes (x red, y green, z blue) of a pose; of a position (3,) or an axis target only what it fixes."""
        trimesh = need_trimesh()
        size = size or 0.14 * self._extent()
        r = 0.035  # radius of an axis over its length
        free = isinstance(T_base, AxisTarget)
        T = np.eye(4)
        shapes = []
        target = T_base.T_base_tip if free else check_target(T_base)[0]
        if target.ndim == 1:
            T[:3, 3] = target
        else:
            T = target
        ball = trimesh.creation.uv_sphere(radius=(2.2 if target.ndim == 1 else 1.7) * r, count=(16, 16))
        shapes.append((ball, RED if target.ndim == 1 else SLATE))
        arrows = [(np.asarray(T_base.axis), PURPLE)] if free else [*zip(np.eye(3), AXES, strict=True)]
        for direction, color in arrows if target.ndim == 2 else ():
            shaft = trimesh.creation.cylinder(r, segment=[np.zeros(3), 0.8 * direction], sections=20)
            cone = trimesh.creation.cone(radius=2.1 * r, height=0.22, sections=24)
            cone.apply_transform(trimesh.geometry.align_vectors((0, 0, 1), direction))
            cone.apply_translation(0.78 * direction)
            shapes += [(shaft, color), (cone, color)]
        self.window.delete(name)
        for k, (mesh, color) in enumerate(shapes):
            self.window.shape(f"{name}/{k}", DrawnShape(*split_sharp_edges(mesh, size), color))
        self.move(T, name)
        point = (self.body.T_world_base @ T)[:3, 3]
        if self._corners and np.linalg.norm(point - np.mean(self._corners, axis=(0, 1))) > FAR * self._extent():
            label = label and f"{label} (outside the picture)"
        else:
            self._corners.append(np.array([point, point]))
        if label:
            bands = f"linear-gradient(90deg, {', '.join(css(color) for color in AXES)})"
            self._say(css(shapes[-1][1]) if free or target.ndim == 1 else bands, label)

    def name(self, path: str, text: str, below: bool = False) -> None:
        """Label a drawn frame, above or below it."""
        self._names = [one for one in self._names if one[0] != path] + [(path, text, 6 if below else -24)]
        self.window.say(names=self._names)

    def move(self, T_base: np.ndarray, name: str = "target") -> None:
        """Move a drawn frame to another pose (4, 4) [m]."""
        self.window.place(name, self.body.T_world_base @ T_base)

    def trail(
        self,
        points: Any,
        name: str = "trail",
        color: tuple[float, float, float] = ORANGE,
        radius: float | None = None,
        label: str = "",
    ) -> None:
        """Draw the path of a tip through points (N, 3) [m]."""
        P = self._world(points)
        self.window.delete(name)
        self.window.shape(name, tube(P, radius or 0.005 * self._extent(), color))
        self._corners.append(np.array([P.min(axis=0), P.max(axis=0)]))
        if label:
            self._say(css(color), label)

    def cloud(self, points: Any, success: Any = None, name: str = "cloud", size: float | None = None) -> None:
        """Draw points (N, 3) [m]; success (N,) colours them blue (reached) and orange (not reached)."""
        P = self._world(points)
        good = np.ones(len(P), dtype=bool) if success is None else np.asarray(success, dtype=bool)
        if good.shape != (len(P),):
            raise InvalidOption(f"success must have one value per point ({len(P)}), not shape {good.shape}")
        self.window.delete(name)
        colors = np.where(good[:, None], BLUE, ORANGE)
        self.window.points(name, P, colors, size or 0.012 * self._extent())
        self._corners.append(np.array([P.min(axis=0), P.max(axis=0)]))
        if success is not None:
            self._say(css(BLUE), f"reached: {good.sum()} of {len(good)}")
            self._say(css(ORANGE), "not reached")

    def animate(self, Q: Any, labels: Sequence[str], fps: float, first: int = 0, name: str = "robot") -> None:
        """Animate the robot through the rows of Q (F, n) with a time slider; labels (F,) are shown next to it."""
        Q = np.atleast_2d(np.asarray(Q, dtype=float))
        if len(Q) != len(labels) or not len(Q):
            raise InvalidOption(f"an animation needs one label per row: {len(Q)} rows, {len(labels)} labels")
        self.show(Q[first], name)
        poses = np.array([self.body.placements(q) for q in Q], dtype="<f4")[:, :, :3]
        paths = [f"/meshcat/{name}/{part.name}" for part in self.body.parts]
        drawn = [tip for tip in range(len(self.robot.tips)) if numbered("tip", tip) in self.window.transforms]
        tips = np.array([self.body.tips(q)[drawn, :3] for q in Q])
        poses = np.concatenate([poses, tips.astype("<f4")], axis=1)
        paths += [f"/meshcat/{numbered('tip', tip)}" for tip in drawn]
        self._corners += [self.body.bounds(q) for q in Q[:: max(1, len(Q) // 12)]]
        self.window.say(
            animation={
                "paths": paths,
                "count": len(Q),
                "first": first,
                "fps": fps,
                "labels": list(labels),
                "data": base64.b64encode(np.ascontiguousarray(poses).tobytes()).decode(),
            }
        )

    def converge(self, result: Any) -> None:
        """Animate a solve, a Result with history: the iterates of the attempt that found the result, ending there.

        Also drawn are the tip path, a ghost at the attempt's start, and the other attempts' tip paths, thin and grey.
        """
        Q, position, angle, others = iterates(result)
        rows = np.unique(np.linspace(0, len(Q) - 1, min(len(Q), MAX_FRAMES)).astype(int))
        between = max(1, min(BETWEEN, MAX_FRAMES // len(rows)))
        frames, labels = [], []
        for k, row in enumerate(rows):
            text = f"evaluation {row}: {length(float(position[row]))}"
            if np.isfinite(angle[row]):
                text += f", {in_words(float(angle[row]))}"
            last = k + 1 == len(rows)
            for step in range(1 if last else between):
                frames.append(Q[row] if last else Q[row] + (step / between) * (Q[rows[k + 1]] - Q[row]))
                labels.append(text)
        self.show(Q[0], "start", SLATE, 0.22, "start")
        for number, other in enumerate(others):
            ways = np.array([self._tips(q) for q in result.history["q"][other]])
            for k in range(ways.shape[1]):
                label = "" if number or k else "other attempts"
                self.trail(ways[:, k], f"trail_of_{number}_{k}", GREY, 0.0015 * self._extent(), label)
        ways = np.array([self._tips(q) for q in Q[rows]])
        several = len(self.robot.tips) > 1
        for k, tip in enumerate(self.robot.tips):
            label = f"path of {tip}" if several else "tip path"
            self.trail(ways[:, k], numbered("trail", k), TRAILS[k % len(TRAILS)], label=label)
        self.animate(frames, labels, fps=max(12.0, len(frames) / 12.0), first=len(frames) - 1)

    def follow(self, result: Any) -> None:
        """Show a tracking run (TrackResult): the arm moving in real time, its trail and the requested path."""
        rows = np.unique(np.linspace(0, len(result.t) - 1, min(len(result.t), MAX_FRAMES)).astype(int))
        wide = 0.005 * self._extent()
        ways, wanted = (array[rows].reshape(len(rows), -1, 3) for array in (result.xyz, result.target_xyz))
        for k in range(ways.shape[1]):  # labels for the first tip only
            self.trail(wanted[:, k], numbered("path", k), SLATE, 0.7 * wide, "" if k else "requested path")
            self.trail(ways[:, k], numbered("trail", k), ORANGE, wide, "" if k else "tip path")
        labels = [f"t = {result.t[k]:.2f} s, error {length(result.position_error[k])}" for k in rows]
        span = float(result.t[rows[-1]] - result.t[rows[0]]) or 1.0
        self.animate(result.q[rows], labels, fps=max(1.0, (len(rows) - 1) / span))

    def say(self, *lines: str) -> None:
        """Write lines under the title."""
        notice = [self.body.notice] if self.body.notice else []
        self.window.say(lines=[*notice, *lines])

    def look(self, eye: Sequence[float] | None = None, target: Sequence[float] | None = None) -> None:
        """Aim the camera from `eye` at `target` [m], world axes; without arguments it sees everything drawn so far."""
        box = np.array([np.min([c[0] for c in self._corners], axis=0), np.max([c[1] for c in self._corners], axis=0)])
        centre, radius = box.mean(axis=0), 0.5 * float(np.linalg.norm(box[1] - box[0]))
        to = centre if target is None else np.asarray(target, dtype=float)
        away = 1.6 * max(radius, 1e-3) * np.array([0.66, -0.63, 0.41])
        at = to + away if eye is None else np.asarray(eye, dtype=float)
        cell = grid_cell(max(radius, 1e-3))
        self.window.say(camera=[at.tolist(), to.tolist(), 2.0 * cell, self.body.floor])
        grid = ("#b9c2cc", f"grid {1000 * cell:g} mm" if cell < 1.0 else f"grid {cell:g} m")
        self.window.say(legend=[*self._legend, grid])

    def html(self) -> str:
        """Return the scene as one self-contained page: a single file that needs no network and opens from disk."""
        if self.window.about["camera"] is None:
            self.look()
        return self.window.html()

    def save(self, path: str | Path) -> Path:
        """Write the self-contained page. Raises InvalidOption if the name does not end in .html."""
        return write_page(path, "a scene", self.html)

    def page(self, path: str | Path) -> Path:
        """Write the live page: the robot with its solvers and a target to drag, in one file that needs no Python or network.

        A result, ghosts or a cloud are left out. Raises InvalidOption if the name does not end in .html.
        """
        from .live_page import page_html

        return write_page(path, "a live page", lambda: page_html(self.robot, self.body, self.window.about["title"]))

    def serve(self, port: int = 0) -> str:
        """Serve the scene live on 127.0.0.1 until `close()` or the end of the program; return the address."""
        if self.window.about["camera"] is None:
            self.look()
        return self.window.serve(port)

    def close(self) -> None:
        """Stop serving the scene."""
        self.window.close()

    def _repr_html_(self) -> str:
        """Return the output of a notebook cell, which embeds the whole page so that it lives as long as the notebook."""
        page = html.escape(self.html(), quote=True)
        return f'<iframe srcdoc="{page}" style="width:100%;height:460px;border:0" sandbox="allow-scripts"></iframe>'

    def drawn(self) -> dict[str, np.ndarray]:
        """Return the world pose (4, 4) of everything drawn, by path ('robot/PART', 'target', ...); trails have identity."""
        found = {path: T.copy() for path, T in self.window.transforms.items()}
        for path in self.window.objects:
            if path.startswith(("trail", "path")) or path == "cloud":
                found[path] = np.eye(4)
        return found

    def _extent(self) -> float:
        corners = self._corners or [self.body.bounds(self.robot.home)]
        low, high = np.min([c[0] for c in corners], axis=0), np.max([c[1] for c in corners], axis=0)
        return max(0.7 * float(np.linalg.norm(high - low)), 1e-3)

    def _tips(self, q: np.ndarray) -> np.ndarray:
        """Return the positions (tips, 3) [m] of the tips in base axes."""
        world = self.body.tips(q)[:, :3, 3]
        base = self.body.T_world_base
        return (world - base[:3, 3]) @ base[:3, :3]

    def _world(self, points: Any) -> np.ndarray:
        P = np.atleast_2d(floats(points, "points must be finite numbers (N, 3)", InvalidOption))
        if P.ndim != 2 or P.shape[1] != 3 or not len(P) or not np.isfinite(P).all():
            raise InvalidOption(f"points must be finite numbers (N, 3), not shape {P.shape}")
        base = self.body.T_world_base
        return P @ base[:3, :3].T + base[:3, 3]

    def _say(self, color: str, label: str) -> None:
        if (color, label) not in self._legend:
            self._legend.append((color, label))
            self.window.say(legend=self._legend)


def view(
    robot: Joints, what: Any = None, *, target: Any = None, cloud: Any = None, title: str = "", viewer: Any = None
) -> Scene:
    """Show a robot in 3-D: at home, at a configuration, or with a result.

    A notebook displays the Scene; `.save("x.html")` writes it, `.page("x.html")` with the solvers, `.serve()` serves it.

    Args:
        robot: The Robot or Tree.
        what: One q (n,) [rad or m] or several, a Result (animated if it has a history) or another result; by default home.
        target: Pose or position [m] in the base frame to mark; for a Tree by tip, or in the order of its tips.
        cloud: Points (N, 3) [m] in the base frame, or a pair (points, success).
        title: Title of the page, by default the robot's name.
        viewer: A meshcat.Visualizer, or Pinocchio's MeshcatVisualizer, in which the scene is drawn as well.

    Raises:
        InvalidConfiguration, InvalidTarget, InvalidOption: An argument does not fit the robot.
        MissingExtra: meshcat or trimesh is not installed.
    """
    scene = Scene(robot, title)
    run, motion = hasattr(what, "target_xyz"), motion_of(what)
    what = next(one for one in (motion, what, robot.home) if one is not None)
    rows = np.atleast_2d(what.q) if hasattr(what, "q") else _rows(robot, what)
    if not len(rows):
        raise InvalidOption("there is nothing to show: the list of configurations is empty")
    many = len(rows) > 1 and not run and motion is None
    scene.show(rows[0], label="1 (solid)" if many else "")
    back = np.linalg.inv(scene.body.T_world_base)
    tips = scene.body.tips(rows[0])
    size = 0.09 * scene._extent()
    for k, T in enumerate(tips):
        scene.frame(back @ T, numbered("tip", k), size)
        if len(tips) > 1:
            scene.name(numbered("tip", k), robot.tips[k], below=True)
    if run:
        scene.follow(what)
        scene.say(f"{what.method} at {1 / what.dt:.4g} Hz: {what.message or what.status.value}")
    elif motion is not None:
        animate(scene, motion)
    elif many:
        scene.ghosts(rows[1:], [str(k) for k in range(2, len(rows) + 1)])
        more = f" (the first {MAX_GHOSTS + 1} are drawn)" if len(rows) > MAX_GHOSTS + 1 else ""
        scene.say(f"{len(rows)} configurations{more}")
    elif hasattr(what, "history"):
        if what.history is not None:
            scene.converge(what)
        scene.say(f"{what.solver}: {what.status.name}", what.message)
    if target is not None:
        size = 0.14 * scene._extent()
        for k, (tip, T) in enumerate(_each(robot, target).items()):
            scene.frame(T, numbered("target", k), size, label="" if k else "targets" if len(tips) > 1 else "target")
            if len(tips) > 1:
                scene.name(numbered("target", k), f"target of {tip}")
    if cloud is not None:
        scene.cloud(*cloud) if isinstance(cloud, tuple) else scene.cloud(cloud)
    scene.look()
    if viewer is not None:
        Guest(scene.window, viewer, [part.name for part in scene.body.parts])
    return scene


def numbered(word: str, k: int) -> str:
    """Return the scene path for tip k, which is the bare word for the first tip."""
    return f"{word}{k + 1 if k else ''}"


def _each(robot: Joints, target: Any) -> dict[str, Any]:
    """Return targets by tip, from a dict, a list in the order of the tips, or one. Raises FrameNotFound, InvalidTarget."""
    if isinstance(target, Mapping):
        robot.check_tips(target)
        return {tip: target[tip] for tip in robot.tips if target.get(tip) is not None}
    if not robot.by_tip:
        return {robot.tips[0]: target}
    if len(target) != len(robot.tips):
        raise InvalidTarget(f"give one target for each of {', '.join(robot.tips)}, or a dict by tip; not {len(target)}")
    return dict(zip(robot.tips, target, strict=True))


def _rows(robot: Joints, what: Any) -> np.ndarray:
    """Return configurations (N, n) from q, several q, or several results."""
    if isinstance(what, list | tuple) and any(hasattr(item, "q") or np.ndim(item) for item in what):
        return np.array([robot.check_q(getattr(item, "q", item)) for item in what]).reshape(-1, robot.n)
    rows = what if np.ndim(what) == 2 else [what]
    return np.array([robot.check_q(row) for row in rows]).reshape(-1, robot.n)
