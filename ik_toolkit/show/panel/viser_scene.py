"""The 3-D view of one visitor of the panel (viser): the robot, frames, and a target to drag for each tip."""

import math
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from ...errors import InvalidTarget
from ..body import Body, BodyPart, primitive

RED = (204, 51, 38)  # colour of the line to a target that is not reached
GHOST = (0, 114, 178)


class Picture(NamedTuple):
    """Constants of the view: camera, and size and colour of the targets' handles.

    Attributes:
        view: direction in which the camera looks, from the front right and from above.
        lens: [rad] vertical field of view.
        fill: share of the picture that the robot fills; arrows and other poses need the rest.
        narrow: [pixels] width of a page below which viser's controls cover the lower part of the picture.
        edge: share of the distance from the picture's middle to its edge; a target further out counts as outside.
        free: share of the picture's height that the controls leave visible on a narrow page.
        arrow: [robot sizes] length of a target's arrows.
        ball: [arrow lengths] radius of the ball at a target, larger than a flange.
        amber: colour of that ball.
    """

    view: np.ndarray = np.array([-0.66, 0.63, -0.41])
    lens: float = 0.7
    fill: float = 0.72
    narrow: int = 576
    edge: float = 0.95
    free: float = 0.5
    arrow: float = 0.22
    ball: float = 0.19
    amber: tuple[int, int, int] = (240, 170, 20)


PICTURE = Picture()


class Handle:
    """The arrows, rings and ball by which a visitor drags one tip's target in the view; target: T_base_target (4, 4) [m]."""

    def __init__(self, stage: "Stage", k: int, name: str, T: np.ndarray, dragged: Callable[[], None]) -> None:
        """Draw arrows and rings at T (4, 4); `dragged` is called when the visitor moves them."""
        self.stage, scene = stage, stage.client.scene
        path = stage.path(f"target/{k}")
        self.gizmo = scene.add_transform_controls(path, scale=PICTURE.arrow * stage.size, disable_sliders=True)
        self.name = scene.add_label(f"{path}/name", name, anchor="bottom-left") if name else None
        self.target = T
        _place(self.gizmo, stage.body.T_world_base @ T)
        self.gizmo.on_update(lambda event: self._moved(event, dragged))
        look: dict[str, Any] = {"color": PICTURE.amber, "opacity": 0.7, "cast_shadow": False}
        self.ball = scene.add_icosphere(f"{path}/ball", PICTURE.ball * PICTURE.arrow * stage.size, **look)
        if hasattr(self.ball, "on_drag"):  # In viser before 1.1 the ball cannot be dragged.
            self.ball.on_drag("left")(self._carried(dragged))

    def put(self, target: np.ndarray) -> None:
        """Move to T_base_target (4, 4), or to a position (3,) with the present rotation, and keep it in the picture."""
        if target.ndim == 1:
            place, target = target, self.target.copy()
            target[:3, 3] = place
        self.target = target
        _place(self.gizmo, self.stage.body.T_world_base @ target)
        self.stage.keep_in_view()

    def _moved(self, event: Any, dragged: Callable[[], None]) -> None:
        dragged()
        # at the end of a drag; events of older releases of viser have no phases
        if getattr(event, "phase", "") == "end":
            self.stage.keep_in_view()

    def _carried(self, dragged: Callable[[], None]) -> Callable[[Any], Any]:
        """Return a handler of drag events of the ball, which moves the target in the plane of the picture."""
        offset = np.zeros(3)

        async def carry(event: Any) -> None:  # async, because viser keeps the order of events only for coroutines
            nonlocal offset
            # A page may send any numbers, which must not cause warnings.
            with np.errstate(over="ignore", invalid="ignore"):
                # The visitor may grab the ball at its rim, so the offset from its centre is kept.
                if event.phase == "start":
                    offset = self.gizmo.position - np.array(event.start_position)
                place = np.array(event.end_position) + offset
                if np.isfinite(place).all():
                    self.gizmo.position = tuple(place.tolist())
                    self._moved(event, dragged)

        return carry

    def read(self) -> np.ndarray:
        """Return T_base_target (4, 4) to which the visitor has dragged the arrows and rings."""
        self.target = self.stage.dragged(self.gizmo)
        return self.target

    def turns(self, rotations: bool, visible: bool) -> None:
        """Show or hide the handle (`visible`), and its rings, by which the target is turned (`rotations`)."""
        self.gizmo.disable_rotations, self.gizmo.visible = not rotations, visible
        if self.name is not None:
            self.name.visible = visible


class Stage:
    """The drawing of a robot in a viser client, with a handle for the target of each tip."""

    def __init__(
        self,
        client: Any,
        body: Body,
        q: np.ndarray,
        targets: dict[str, np.ndarray],
        frames: bool,
        dragged: Callable[[], None],
        before: "Stage | None" = None,
    ) -> None:
        """Draw the robot at q and targets (4, 4) by tip; `dragged` is called when the visitor moves one.

        `before`: the drawing that this one replaces, or None.
        """
        # viser puts a new object at the pose of an earlier one of the same name, so the names of each Stage contain a number of its
        # own.
        self.number = before.number + 1 if before else 0
        self.widest = before.widest if before else 0  # largest width [pixels] of the picture so far
        self.away = False  # whether the camera was moved back to see a target outside the picture
        self.client, self.body = client, body
        self.robot: Any = body.robot
        scene = client.scene
        low, high = body.bounds(q)
        self.size = float(np.linalg.norm(high - low))
        scene.set_up_direction("+z")
        cell = 10.0 ** np.round(np.log10(self.size / 8.0))
        sizes: dict[str, Any] = {"width": 40 * cell, "height": 40 * cell, "cell_size": cell, "section_size": 5 * cell}
        colors: dict[str, Any] = {"cell_color": (228, 231, 235), "section_color": (198, 204, 211)}
        scene.add_grid(self.path("grid"), position=(0.0, 0.0, body.floor), **sizes, **colors)
        self.parts = [self._drawn("robot", part, side="double") for part in body.parts]

        def frame(name: str, length: float, radius: float, visible: bool = True) -> Any:
            return scene.add_frame(self.path(name), axes_length=length, axes_radius=radius, visible=visible)

        long, thick = 0.1 * self.size, 0.003 * self.size
        self.tips = [frame(f"tip/{k}", long, thick) for k in range(len(targets))]
        self.axes = [frame(f"joint/{k}", 0.8 * long, thick / 1.5, frames) for k in range(len(body.joints))]
        self.handles = [
            Handle(self, k, tip if len(targets) > 1 else "", T, dragged) for k, (tip, T) in enumerate(targets.items())
        ]
        self.lines: dict[str, Any] = {}
        self.boxes: dict[str, Any] = {}
        shape, look = primitive("sphere", (1.0,)), {"color": GHOST, "opacity": 0.35, "cast_shadow": False}
        balls = [self.path(f"ellipsoid/{k}") for k in range(len(targets))]
        self.ellipsoids = [scene.add_mesh_simple(ball, *shape, visible=False, **look) for ball in balls]
        self.shade: list[Any] = []
        self.ghosted: np.ndarray | None = None
        self.poses = body.placements(q)
        self.aim(q)

    def path(self, name: str) -> str:
        """Return the path under which viser draws an object; it is new for each Stage, whose `number` it contains."""
        return f"/{self.number}/{name}"

    def _drawn(self, copy: str, part: BodyPart, **look: Any) -> Any:
        """Draw a part of the robot; return its viser handle, which sets its pose, and for a bar also its length."""
        scene, path = self.client.scene, self.path(f"{copy}/{part.name}")
        handle = None if part.end else scene.add_frame(path, show_axes=False)
        for k, shape in enumerate(part.shapes):
            opacity = None if shape.opacity >= 1.0 else shape.opacity
            own: dict[str, Any] = {"color": tuple(round(255 * c) for c in shape.color), "opacity": opacity}
            mesh = scene.add_mesh_simple(f"{path}/{k}" if handle else path, shape.vertices, shape.faces, **own | look)
            handle = handle or mesh
        return handle

    def show(self, q: np.ndarray) -> None:
        """Draw robot, tips and axes at joint values q (n,); targets stay."""
        body = self.body
        self.poses = body.placements(q)
        self._place_parts(self.parts, self.poses)
        for handle, T in zip([*self.tips, *self.axes], [*body.tips(q), *body.frames[body.joints]], strict=True):
            _place(handle, T)
        self.ghost(self.ghosted)

    def _place_parts(self, handles: list[Any], poses: np.ndarray) -> None:
        for handle, part, T in zip(handles, self.body.parts, poses, strict=True):
            _place(handle, T, bar=part.end is not None)

    def gaps(self, shown: bool) -> None:
        """Draw a line from each tip to its target, to show how far it is missed; or remove these lines (shown=False)."""
        pairs = [(tip, handle.gizmo) for tip, handle in zip(self.tips, self.handles, strict=True)]
        ends = [(tip.position, gizmo.position) for tip, gizmo in pairs if shown and gizmo.visible]
        self.line("gap", ends, RED)

    def ghost(self, q: np.ndarray | None) -> None:
        """Show a second, translucent robot at q (n,), without the parts that coincide with the first robot's; None removes it."""
        self.ghosted = q
        if q is None:
            for handle in self.shade:
                handle.visible = False
            return
        if not self.shade:
            look = {"color": GHOST, "opacity": 0.35, "cast_shadow": False}
            self.shade = [self._drawn("ghost", part, **look) for part in self.body.parts]
        with self.client.atomic():
            poses = self.body.placements(q)
            self._place_parts(self.shade, poses)
            for handle, alone in zip(self.shade, self.body.apart(poses, self.poses), strict=True):
                handle.visible = bool(alone)

    def box(self, name: str, size: Any, T: np.ndarray, color: tuple[int, int, int]) -> Any:
        """Draw a box of size (x, y, z) [m] at T_base_box (4, 4), and move the camera if it would be out of view.

        Return the arrows and rings with which the user drags the box.
        """
        scene, path = self.client.scene, self.path(f"box/{name}")
        gizmo = scene.add_transform_controls(path, scale=1.2 * max(size), disable_sliders=True)
        scene.add_box(f"{path}/shape", dimensions=tuple(size), color=color, opacity=0.85)
        _place(gizmo, self.body.T_world_base @ T)
        self.boxes[name] = gizmo
        self.keep_in_view()
        return gizmo

    def spots(self, size: Any) -> Iterator[np.ndarray]:
        """Yield poses (4, 4) in the base for a new box of size (x, y, z) [m], beside the arm in the present view, nearest first.

        Places at a target, in another box or under the floor are left out.
        """
        base, half = self.body.T_world_base, 0.5 * float(np.linalg.norm(size))
        across = np.cross(PICTURE.view, (0.0, 0.0, 1.0)) / np.hypot(*PICTURE.view[:2])
        still = self.body.bounds(self.robot.home, still=True)
        taken = [*(handle.gizmo for handle in self.handles if handle.gizmo.visible), *self.boxes.values()]
        centre = np.mean([tip.position for tip in self.tips], axis=0)
        for far in half + self.size * np.arange(1.2 * PICTURE.arrow, 4.0, 0.1):
            for way in (across, -across, np.array([0.0, 0.0, 1.0]), PICTURE.view * (1.0, 1.0, 0.0)):
                place = centre + far * way / np.linalg.norm(way)
                place[2] = max(place[2], self.body.floor + half)
                free = np.linalg.norm(place - np.clip(place, *still)) > half
                if free and all(np.linalg.norm(place - one.position) > half + one.scale for one in taken):
                    yield pin.SE3(np.eye(3), base[:3, :3].T @ (place - base[:3, 3])).homogeneous

    def dragged(self, gizmo: Any) -> np.ndarray:
        """Return the pose (4, 4) in the base frame of a viser handle that was dragged. Raises InvalidTarget."""
        (w, x, y, z), place = gizmo.wxyz, gizmo.position
        if not np.isfinite([w, x, y, z, *place]).all() or not np.any(gizmo.wxyz):
            raise InvalidTarget("the dragged target is not a valid pose")
        turn = pin.Quaternion(float(w), float(x), float(y), float(z)).normalized()
        return np.linalg.inv(self.body.T_world_base) @ pin.SE3(turn, np.array(place)).homogeneous

    def line(self, name: str, points: Any, color: tuple[int, int, int]) -> None:
        """Draw lines between pairs of points (K, 2, 3) [m], world axes; replaces earlier ones of this name."""
        if name in self.lines:
            self.lines.pop(name).remove()
        if len(points):
            ends = np.asarray(points, dtype=np.float32)
            draw, thick = self.client.scene.add_line_segments, 0.004 * self.size
            self.lines[name] = draw(self.path(name), ends, color, thickness=thick)

    def ellipsoid(self, k: int, axes: np.ndarray, radii: np.ndarray, visible: bool) -> None:
        """Draw a velocity ellipsoid around tip k: axes (3, 3) in the base, radii (3,) [m/s] drawn as 0.25 s long."""
        R = self.body.T_world_base[:3, :3] @ axes
        if np.linalg.det(R) < 0.0:
            R[:, 2] *= -1.0
        ball = self.ellipsoids[k]
        ball.scale = tuple(np.maximum(0.25 * radii, 1e-3 * self.size).tolist())
        ball.visible = visible
        _place(ball, pin.SE3(R, np.array(self.tips[k].position)).homogeneous)

    def aim(self, q: np.ndarray) -> None:
        """Aim the camera at the robot at q (n,) from the front right, so that it fills the picture."""
        camera = self.client.camera
        # [pixels] The largest width seen is that of the page: at first the picture is as wide, until the controls are docked beside
        # it.
        self.widest = max(self.widest, camera.image_width)
        self.extent, self.away = self.body.bounds(q), False
        camera.up_direction = (0.0, 0.0, 1.0)
        camera.fov = PICTURE.lens
        self._look(camera, self.extent, PICTURE.view)

    @np.errstate(all="ignore")  # A page may send any numbers for camera and targets, which must not cause warnings.
    def keep_in_view(self) -> None:
        """Move the camera back along its viewing direction until all targets are in view, and later forward again."""
        camera = self.client.camera
        seen = [*(handle.gizmo for handle in self.handles if handle.gizmo.visible), *self.boxes.values()]
        goals = np.array([gizmo.position for gizmo in seen])
        w, x, y, z = camera.wxyz
        turn = pin.Quaternion(w, x, y, z).matrix()
        across, down, ahead = turn.T @ (goals.reshape(-1, 3) - camera.position).T
        edge, free = PICTURE.edge * np.tan(0.5 * camera.fov) * ahead, self._free()
        aspect = camera.image_width / max(camera.image_height, 1)
        inside = (np.abs(across) < aspect * edge) & (-edge < down) & (down < (2.0 * free - 1.0) * edge)
        if not inside.all() or self.away:
            box = np.array([self.extent[0], self.extent[1], *goals])
            box = np.array([box.min(axis=0), box.max(axis=0)])
            self.away = not np.allclose(box, self.extent)
            self._look(camera, box, turn[:, 2])

    def _free(self) -> float:
        """Return the share of the picture's height, from the top, that no controls cover."""
        return PICTURE.free if self.widest < PICTURE.narrow else 1.0

    def _look(self, camera: Any, box: np.ndarray, view: np.ndarray) -> None:
        eye, to = camera_for(box, view, camera.image_width / max(camera.image_height, 1), self._free())
        if np.isfinite([eye, to]).all():
            camera.position, camera.look_at = tuple(eye.tolist()), tuple(to.tolist())


def camera_for(box: np.ndarray, view: np.ndarray, aspect: float, free: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the position of a camera, and the point it looks at (3,) [m], so that a box (2, 3) [m] fills the picture.

    `view` (3,) is the direction in which it looks, not straight up or down; `aspect` is width over height of the
    picture; `free` is the share of its height, from the top, in which the box is to be seen.
    """
    ahead = view / np.linalg.norm(view)
    across = np.cross(ahead, (0.0, 0.0, 1.0))
    across /= np.linalg.norm(across)
    up, centre, half = np.cross(across, ahead), box.mean(axis=0), math.tan(0.5 * PICTURE.lens)
    corners = np.array(np.meshgrid(*(box - centre).T)).reshape(3, -1).T
    wide, tall, deep = np.abs(corners @ across), np.abs(corners @ up), corners @ ahead
    away = (np.maximum(wide / max(aspect, 0.1), tall / free) / (half * PICTURE.fill) - deep).max()
    to = centre - (1.0 - free) * half * away * up
    return to - away * ahead, to


def _place(handle: Any, T: np.ndarray, bar: bool = False) -> None:
    """Place a drawing at a pose (4, 4) [m]; the matrix of a bar also stretches it."""
    if bar:
        sizes = np.linalg.norm(T[:3, :3], axis=0)
        handle.scale, T = tuple(sizes.tolist()), T / [*sizes, 1.0]
    x, y, z, w = pin.Quaternion(T[:3, :3]).normalized().coeffs()
    handle.wxyz, handle.position = (float(w), float(x), float(y), float(z)), tuple(T[:3, 3].tolist())
