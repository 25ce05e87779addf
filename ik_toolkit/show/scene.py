"""The 3-D view: robots, ghosts, targets, obstacles, trails, clouds and animations; live, in a notebook, or as one file."""

import itertools
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InvalidOption, whole
from ..robot.geometry.collision import CollisionModel
from ..robot.geometry.shape import is_shape
from ..robot.joints import Joints
from ..robot.pose import AxisTarget, as_matrix, check_target
from ..validate import positive, switch
from . import animation
from .animation import BLUE, GHOSTS, OBSTACLE, ORANGE, PURPLE, SLATE, numbered
from .body import Body, DrawnShape, drawn_shape, mapped, primitive, revolved, standing, tube
from .feed import Guest
from .meshcat_server import Cloud, write_page
from .notebook import InCell, PageInCell
from .scene_state import Color, css, read_color, read_labels, read_opacity, read_text

RED = (0.80, 0.20, 0.15)
AXES = ((0.82, 0.18, 0.16), (0.16, 0.62, 0.24), (0.13, 0.38, 0.78))  # colours of x, y and z axes
MAX_GHOSTS = 12


class Scene(InCell):
    """The drawing of a robot and of what is around it. Poses are in the robot's base axes [m], joint values as in `robot`.

    Everything has a name, by which it is moved, drawn anew or removed; the scene's robot is "robot", its tip "tip". `names` lists
    them, `drawn()` returns all poses. Raises MissingExtra without meshcat or trimesh.
    """

    # -------------------------------------------------------------------------------------------------- what is shown
    def update(self, what: Any, target: Any = None, *, cloud: Any = None, obstacles: Any = None) -> None:
        """Show another configuration or result, as `view` does; robot, tips, target, caption and drawings of a result are replaced.

        A target or a cloud that is not given stays, and so does what was added by name. The camera stays unless a tip or the target
        would be outside the picture. Invalid input raises, as in `view`, and changes nothing.
        """
        rows, motion = animation.shown_rows(self.robot, what)
        given = {} if target is None else animation.each_target(self.robot, target)
        targets = {numbered("target", k): (tip, T) for k, (tip, T) in enumerate(given.items())}
        for _, T in targets.values():
            self._target(T)
        points, success = cloud if isinstance(cloud, tuple) and len(cloud) == 2 else (cloud, None)
        if cloud is not None:
            self._cloud(points, success)
        if not isinstance(obstacles, CollisionModel | None):
            raise InvalidOption(f"obstacles must be a CollisionModel, not {obstacles!r:.60}")
        model = animation.model_of(what, motion) if obstacles is None else obstacles
        around = None if model is None else (model, model.version)
        kept = {
            *(targets or [one for one in self._marks if one.startswith("target")]),
            *(["cloud"] if cloud is None else []),
            *(one for one in self._boxes if one.startswith("obstacle/") and around == self._around),
        }
        self._forget(self._shown - kept)
        lines, several = self.window.about["lines"], len(self.robot.tips) > 1
        self._put("robot", self._poses("robot", rows[:1]), (None, None))
        for k, T in enumerate(self.body.tips(rows[0])):
            name = numbered("tip", k)
            self.frame(np.linalg.inv(self.body.T_world_base) @ T, name, self._size(name, 0.09))
            if several:
                self.name(name, self.robot.tips[k], below=True)
        before = {*self._boxes}
        if model is not None and around != self._around:
            animation.draw_obstacles(self, model)
        self._around = around
        if motion is not None:
            animation.animate(self, motion)
        elif hasattr(what, "history"):
            if what.history is not None:
                animation.draw_solve(self, what)
            self.say(f"{what.solver}: {what.status.name}", what.message)
        for name, (tip, T) in targets.items():
            label = "" if name != "target" else "targets" if several else "target"
            self.frame(T, name, self._size(name, 0.14), label)
            if several:
                self.name(name, f"target of {tip}")
        if len(rows) > 1 and motion is None:
            self._say("robot", (css(SLATE), "1 (solid)"))
            self.ghosts(rows[1:], [str(k) for k in range(2, len(rows) + 1)])
            more = f" (the first {MAX_GHOSTS + 1} are drawn)" if len(rows) > MAX_GHOSTS + 1 else ""
            self.say(f"{len(rows)} configurations{more}")
        if cloud is not None:
            self.cloud(points, success)
        self._shown |= {*self._boxes} - before
        self._captioned = self.window.about["lines"] is not lines
        self._follow(rows[0])

    def _size(self, name: str, share: float) -> float:
        """Return the size [m] of a drawn frame, or for a new one a share of the scene's."""
        return self._marks[name][-1] if name in self._marks else share * self._extent()

    def show(
        self, q: Any, name: str = "robot", color: Color | None = None, opacity: float | None = None, label: str = ""
    ) -> None:
        """Draw a robot at q (n,) [rad or m], or move it there, and give it a colour or an opacity, which it keeps.

        If it is the scene's robot, its tip axes move too; target, trail, caption and animation of an earlier result are removed.
        Any other name is that of a robot that was added or of a copy, whose parts that coincide with other copies are not drawn.

        Args:
            q: Joint values of the robot of this name.
            name: The robot.
            color: Red, green and blue in 0..1; by default those of its description.
            opacity: 0 (invisible) to 1 (solid).
            label: Text for the legend.

        Raises:
            InvalidConfiguration: q does not fit the robot.
            InvalidOption: The other arguments are wrong.
        """
        body, label = self._body(read_text(name, "name"))[0], read_text(label, "label")
        q, look = body.robot.check_q(q), (read_color(color), read_opacity(opacity))
        if name == "robot":
            self._forget({one for one in self._shown if not one.startswith(("ghost_", "cloud"))})
            self._around = None
            for k, T in enumerate(self.body.tips(q)):
                if numbered("tip", k) in self.window.transforms:
                    self.window.place(numbered("tip", k), T)
                    self._boxes[numbered("tip", k)] = T[None, :3, 3].repeat(2, axis=0)
        elif name not in self._placed and name in self._boxes:
            self._drop(name)
        self._put(name, self._poses(name, q[None]), look)
        if name == "robot":
            self._follow(q)
        if label:
            self._say(name, (css(self._looks[name][0] or SLATE), label))

    def ghosts(self, Q: Any, labels: Iterable[str] = ()) -> None:
        """Draw translucent copies of the robot at the rows of Q (N, n), at most the first 12, in eight alternating colours."""
        rows, names = animation.shown_rows(self.robot, Q)[0][:MAX_GHOSTS], read_labels(labels)
        for name in [one for one in self._placed if one.startswith("ghost_")][len(rows) :]:
            self._drop(name)
        for k, q in enumerate(rows):
            label = names[k] if k < len(names) else ""
            self.show(q, f"ghost_{k + 1}", GHOSTS[k % len(GHOSTS)], 0.32, label)

    # --------------------------------------------------------------------------------------------- surroundings
    def add(
        self, what: Any, at: Any = None, name: str | None = None, *, T_base: Any = None,
        color: Color | None = None, opacity: float | None = None, label: str = "",
    ) -> str:  # fmt: skip
        """Draw another robot, a shape, or the shapes of a CollisionModel around the robot and in its hand.

        Args:
            what: A Robot or Tree, a Shape, or a CollisionModel of the scene's robot.
            at: For a robot its q (n,) [rad or m], by default home; for a shape its pose (4, 4), pin.SE3 or position (3,) [m].
            name: Name for `show` (a robot), `move` (a shape) and `remove`; by default one is made, of a model "obstacle".
            T_base: Pose of the other robot's base; by default that of the scene's robot.
            color: Red, green and blue in 0..1.
            opacity: 0 (invisible) to 1 (solid).
            label: Text for the legend.

        Returns:
            The name.

        Raises:
            InvalidOption, InvalidConfiguration, InvalidTarget: An argument is wrong.
        """
        color, opacity, label = read_color(color), read_opacity(opacity), read_text(label, "label")
        name = None if name is None else read_text(name, "name")
        if isinstance(what, CollisionModel):
            animation.draw_obstacles(self, what, name or "obstacle")
            return name or "obstacle"
        stem = "robot" if isinstance(what, Joints) else is_shape(what).kind
        free = (f"{stem}_{k}" for k in itertools.count(1 + (stem == "robot")) if f"{stem}_{k}" not in self._boxes)
        name = name or next(free)
        if isinstance(what, Joints):
            q, T = what.check_q(what.home if at is None else at), np.eye(4) if T_base is None else as_matrix(T_base)
            body = Body(what)
            self._clear(name)
            self._bodies[name] = body, self.body.T_world_base @ T @ np.linalg.inv(body.T_world_base)
            self._put(name, self._poses(name, q[None]), (color, opacity))
        else:
            self._shape(what, np.zeros(3) if at is None else at, name, color, opacity)
        if label:
            self._say(name, (css(color or (SLATE if name in self._bodies else OBSTACLE)), label))
        return name

    def _shape(self, shape: Any, at: Any, name: str, color: Any = None, opacity: float | None = None) -> None:
        T, drawn = as_matrix(at, "shape"), drawn_shape(shape, color or OBSTACLE, 0.75 if opacity is None else opacity)
        self._clear(name)
        self.window.draw(name, drawn)
        self.window.place(name, self.body.T_world_base @ T)
        self._see(name, self._world(drawn.vertices @ T[:3, :3].T + T[:3, 3]))

    def frame(self, T_base: Any, name: str = "target", size: float | None = None, label: str = "") -> None:
        """Draw the axes (x red, y green, z blue) of a pose; of a position (3,) or an axis target only what it fixes."""
        (target, free), label, name = self._target(T_base), read_text(label, "label"), read_text(name, "name")
        size = 0.14 * self._extent() if size is None else positive(size, "size")
        mark, T = (target.ndim, tuple(T_base.axis) if free else (), size), self.body.T_world_base @ as_matrix(target)
        if self._marks.get(name) != mark:
            self._clear(name)
            self._marks[name] = mark
            for k, shape in enumerate(_axes(T_base.axis if free else None, target.ndim == 1, size)):
                self.window.draw(f"{name}/{k}", shape)
        self.window.place(name, T)
        if not self._see(name, T[None, :3, 3]):
            label = label and f"{label} (outside the picture)"
        if label:
            bands = f"linear-gradient(90deg, {', '.join(css(color) for color in AXES)})"
            self._say(name, (css(RED) if target.ndim == 1 else css(PURPLE) if free else bands, label))

    def name(self, path: str, text: str, below: bool = False) -> None:
        """Write a label above or below a drawn frame. Raises InvalidOption if no frame has this name."""
        self._known(path)
        others = [one for one in self.window.about["names"] if one[0] != path]
        self.window.say(names=[*others, (path, read_text(text, "text"), 6 if below else -24)])

    def move(self, T_base: Any, name: str = "target") -> None:
        """Move a drawn frame or shape to another pose (4, 4), pin.SE3 or position (3,) [m].

        Raises InvalidOption if there is none of this name, InvalidTarget if it is no pose.
        """
        self._known(name)
        self.window.place(name, self.body.T_world_base @ as_matrix(T_base))

    def trail(
        self, points: Any, name: str = "trail", color: Color = ORANGE, radius: float | None = None, label: str = ""
    ) -> None:
        """Draw the path of a tip through points (N, 3) [m]."""
        P, color, label = self._world(points), read_color(color) or ORANGE, read_text(label, "label")
        wide = 0.005 * self._extent() if radius is None else positive(radius, "radius")
        self._draw(read_text(name, "name"), tube(P, wide, color), P, (css(color), label))

    def cloud(self, points: Any, success: Any = None, name: str = "cloud", size: float | None = None) -> None:
        """Draw points (N, 3) [m]; success (N,) colours them blue (reached) and orange (not reached)."""
        (P, good), name = self._cloud(points, success), read_text(name, "name")
        size = 0.012 * self._extent() if size is None else positive(size, "size")
        drawn = Cloud(P, np.where(good[:, None], BLUE, ORANGE), size)
        known = [(css(BLUE), f"reached: {good.sum()} of {len(good)}"), (css(ORANGE), "not reached")]
        self._draw(name, drawn, P, *(known if success is not None else []))

    # ------------------------------------------------------------------------------------------------- animations
    def animate(
        self, Q: Any, labels: Sequence[str] | None = None, fps: float = 25.0, first: int = 0, name: str = "robot"
    ) -> None:
        """Animate a robot through the rows of Q (F, n) with a time slider; labels (F,) are shown next to the slider.

        At first the robot is shown at row number `first`. Raises InvalidConfiguration or InvalidOption.
        """
        body, base = self._body(read_text(name, "name"))
        Q = animation.shown_rows(body.robot, Q)[0]
        labels = read_labels([f"{k} of {len(Q)}" for k in range(1, len(Q) + 1)] if labels is None else labels)
        if len(Q) != len(labels):
            raise InvalidOption(f"an animation needs one label per row: {len(Q)} rows, {len(labels)} labels")
        fps, first = positive(fps, "fps"), whole(first, "first", 0)
        if first >= len(Q):
            raise InvalidOption(f"first must be the number of a row, 0 to {len(Q) - 1}, not {first}")
        self._stop()
        poses = self._poses(name, Q)
        self._put(name, np.concatenate([poses[first : first + 1], poses]), (None, None))
        paths = [f"{name}/{part.name}" for part in body.parts]
        if name == "robot":
            drawn = [k for k in range(len(self.robot.tips)) if numbered("tip", k) in self.window.transforms]
            poses = np.concatenate([poses, np.array([self.body.tips(q)[drawn] for q in Q])], axis=1)
            paths += [numbered("tip", k) for k in drawn]
        self.window.animate(paths, poses, labels, fps, first)

    # ---------------------------------------------------------------------------------------------------- the page
    def html(self) -> str:
        """Return the scene as one self-contained page: a single file that needs no network and opens from disk."""
        return self._aimed().html()

    def save(self, path: str | Path) -> Path:
        """Write the self-contained page. Raises InvalidOption if the name does not end in .html."""
        return write_page(path, "a scene", self.html)

    def controls(self, shown: bool = True) -> None:
        """Show or hide meshcat's control panel, in which everything drawn can be hidden and the lights set."""
        self.window.say(controls=switch(shown, "shown"))

    def screenshot(self, path: str | Path, size: tuple[int, int] = (1000, 640)) -> Path:
        """Write the scene as it is now as a .png file of a size [pixels]; no browser is needed.

        Raises InvalidOption if the name does not end in .png, or the size is wrong; MissingExtra without matplotlib.
        """
        return animation.write_pictures(path, self._aimed(), size)

    def record(self, path: str | Path, size: tuple[int, int] = (640, 400), pictures: int = 48) -> Path:
        """Write the animation as a .gif or .mp4 file that lasts as long, with a limited number of pictures; no browser is needed.

        A picture takes about a second. An .mp4 file (H.264) is made by ffmpeg: that of the package imageio-ffmpeg, else one on the
        PATH. Raises InvalidOption if there is no animation, the name ends in something else or another argument is wrong;
        MissingExtra without matplotlib or ffmpeg.
        """
        return animation.write_pictures(path, self._aimed(), size, whole(pictures, "pictures", 2))

    def page(self, path: str | Path | None = None) -> Any:
        """Write the live page: the robot with its solvers and a target to drag, in one file that needs no Python or network.

        Without a path the page displays itself in the cell of a notebook. A result, ghosts or a cloud are left out. Raises
        InvalidOption if the name does not end in .html.
        """
        from .live_page import page_html

        def made() -> str:
            return page_html(self.robot, self.body, self.window.about["title"])

        return PageInCell(made(), self._aimed()) if path is None else write_page(path, "a live page", made)

    def serve(self, port: int = 0) -> str:
        """Serve the scene live on 127.0.0.1 until `close()` or the end of the program; return the address."""
        if whole(port, "port", 0) >= 2**16:
            raise InvalidOption(f"port must be between 0 and 65535, not {port}")
        return self._aimed().serve(port)

    def close(self) -> None:
        """Stop serving the scene over the network; it can still be changed and saved."""
        self.window.close()

    def _target(self, T_base: Any) -> tuple[np.ndarray, bool]:
        """Return a pose (4, 4) or position (3,) [m], and whether rotation about an axis is free. Raises InvalidTarget."""
        free = isinstance(T_base, AxisTarget)
        return T_base.T_base_tip if free else check_target(T_base)[0], free


def _axes(axis: Any, bare: bool, size: float) -> list[DrawnShape]:
    """Return the ball and arrows of a frame of a size [m], of one arrow along an axis (3,), or of a ball only (bare)."""
    r = 0.035  # radius of a drawn axis arrow, as a share of its length
    shapes = [(primitive("sphere", ((2.2 if bare else 1.7) * r,)), RED if bare else SLATE)]
    arrows = zip(np.eye(3), AXES, strict=True) if axis is None else [(np.asarray(axis), PURPLE)]
    rod, cone = revolved([(0, 0), (1, 0), (1, 1), (0, 1)], 20), revolved([(0, 0), (1, 0), (0, 1)], 24)
    for direction, color in () if bare else arrows:
        shapes.append((mapped(rod, standing(np.zeros(3), 0.8 * direction, r)), color))
        shapes.append((mapped(cone, standing(0.78 * direction, direction, 2.1 * r)), color))
    return [DrawnShape(size * vertices, faces, color) for (vertices, faces), color in shapes]


def view(
    robot: Joints,
    what: Any = None,
    *,
    target: Any = None,
    cloud: Any = None,
    obstacles: Any = None,
    title: str | None = None,
    live: bool = False,
    viewer: Any = None,
) -> Scene:
    """Show a robot in 3-D: at home, at a configuration, or with a result.

    A notebook displays the Scene; `.save("x.html")` writes it, `.page("x.html")` with the solvers, `.serve()` serves it.

    Args:
        robot: The Robot or Tree.
        what: One q (n,) [rad or m] or several, a Result (animated with a history), a map or another result; by default home.
        target: Pose or position [m] in the base frame to mark; for a Tree by tip, or in the order of its tips.
        cloud: Points (N, 3) [m] in the base frame, or a pair (points, success).
        obstacles: CollisionModel whose obstacles and held shapes are drawn; by default that of the result.
        title: Title of the page, by default the robot's name.
        live: Whether notebook cells that show the scene follow `Scene.update` and all other changes, over the connection to the
            kernel (extra 'notebook'), and targets can be dragged (`Scene.on_drag`). Without a connection the scene stays still.
        viewer: A meshcat.Visualizer, or Pinocchio's MeshcatVisualizer, in which the scene is drawn as well.

    Raises:
        InvalidConfiguration, InvalidTarget, InvalidOption: An argument does not fit the robot.
        MissingExtra: meshcat or trimesh is not installed.
    """
    scene = Scene(robot, title)
    cells, what = (what, None) if hasattr(what, "manipulability") and hasattr(what, "grid") else (None, what)
    scene.update(robot.home if what is None else what, target=target, cloud=cloud, obstacles=obstacles)
    if cells is not None:
        from .reach_pictures import draw_cells  # imported only when needed, because it loads the package's studies

        draw_cells(scene, cells)
    scene.look()
    if switch(live, "live"):
        scene.connect()
    if viewer is not None:
        Guest(scene.window, viewer, [part.name for part in scene.body.parts])
    return scene
