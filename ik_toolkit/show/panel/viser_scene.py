"""The 3-D view of one visitor of the panel (viser): the robot, frames, and a target to drag for each tip."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin

from ...errors import InvalidTarget
from ..body import Body, need_trimesh

RED = (204, 51, 38)  # line to a target that is not reached
GHOST = (0, 114, 178)
VIEW = np.array([-0.66, 0.63, -0.41])  # along which the robot is looked at: from the front right, from above
LENS = 0.7  # [rad] from top to bottom
FILL = 0.72  # of the picture, by the robot: its arrows and the next poses need the rest
NARROW = 576  # pixels of a page below which viser lays its controls over the lower part of the picture
EDGE = 0.95  # of the way from the middle of the picture to its edge: a target further out counts as not in it
FREE = 0.5  # of the height left there, see connection.STYLE


class Handle:
    """Arrows and rings of one tip's target; `target` is the pose T_base_target (4, 4) [m]."""

    def __init__(self, stage: "Stage", k: int, name: str, T: np.ndarray, dragged: Callable[[], None]) -> None:
        """Draw arrows and rings at T (4, 4); `dragged` is called when the visitor moves them."""
        self.T_world_base = stage.body.T_world_base
        scene = stage.client.scene
        self.gizmo = scene.add_transform_controls(f"/target/{k}", scale=0.22 * stage.size, disable_sliders=True)
        self.name = scene.add_label(f"/target/{k}/name", name, anchor="bottom-left") if name else None
        self.stage = stage
        self._put(T)
        self.gizmo.on_update(lambda event: self._moved(event, dragged))

    def put(self, target: np.ndarray) -> None:
        """Move to T_base_target (4, 4), or to a position (3,) with the present rotation, and keep it in the picture."""
        self._put(target)
        self.stage.keep_in_view()

    def _moved(self, event: Any, dragged: Callable[[], None]) -> None:
        dragged()
        if getattr(event, "phase", "") == "end":  # older releases of viser have no phases
            self.stage.keep_in_view()

    def _put(self, target: np.ndarray) -> None:
        if target.ndim == 1:
            place, target = target, self.target.copy()
            target[:3, 3] = place
        self.target = target
        _place(self.gizmo, self.T_world_base @ target)

    def read(self) -> np.ndarray:
        """Return T_base_target (4, 4) to which the visitor has dragged the arrows and rings."""
        self.target = _dragged(self.gizmo, self.T_world_base)
        return self.target

    def turns(self, rotations: bool, visible: bool) -> None:
        """Show or hide the rings, and the whole handle."""
        self.gizmo.disable_rotations, self.gizmo.visible = not rotations, visible
        if self.name is not None:
            self.name.visible = visible


class Stage:
    """A robot in the view of a viser client (or server), with a handle for each tip."""

    def __init__(
        self,
        client: Any,
        body: Body,
        q: np.ndarray,
        targets: dict[str, np.ndarray],
        frames: bool,
        dragged: Callable[[], None],
        widest: int = 0,
    ) -> None:
        """Draw the robot at q and targets (4, 4) by tip; `dragged` is called when the visitor moves one.

        `widest` is the largest width [pixels] of the picture so far.
        """
        self.widest, self.away = widest, False  # whether the camera has moved away to see a target
        self.client, self.body = client, body
        self.robot: Any = body.robot
        scene, robot = client.scene, self.robot
        low, high = body.bounds(q)
        self.size = float(np.linalg.norm(high - low))
        scene.set_up_direction("+z")
        cell = 10.0 ** np.round(np.log10(self.size / 8.0))
        faint, clear = (228, 231, 235), (198, 204, 211)
        scene.add_grid(
            "/grid",
            40 * cell,
            40 * cell,
            cell_size=cell,
            section_size=5 * cell,
            cell_color=faint,
            section_color=clear,
            position=(0.0, 0.0, body.floor),
        )
        self.parts = []
        for part in body.parts:
            self.parts.append(scene.add_frame(f"/robot/{part.name}", show_axes=False))
            for k, shape in enumerate(part.shapes):
                rgb = tuple(round(255 * c) for c in shape.color)
                opacity = None if shape.opacity >= 1.0 else shape.opacity
                scene.add_mesh_simple(
                    f"/robot/{part.name}/{k}", shape.vertices, shape.faces, color=rgb, opacity=opacity, side="double"
                )
        length = 0.1 * self.size
        self.tips = [
            scene.add_frame(f"/tip/{k}", axes_length=length, axes_radius=0.03 * length) for k in range(len(targets))
        ]
        self.axes = [
            scene.add_frame(f"/joint/{k}", axes_length=0.8 * length, axes_radius=0.02 * length, visible=frames)
            for k in range(robot.n)
        ]
        self.handles = [
            Handle(self, k, tip if len(targets) > 1 else "", T, dragged) for k, (tip, T) in enumerate(targets.items())
        ]
        self.lines: dict[str, Any] = {}
        self.ellipsoids: dict[int, Any] = {}
        self.shade: list[Any] = []
        self.aim(q)

    def show(self, q: np.ndarray) -> None:
        """Place everything except the target for joint values q (n,)."""
        body, model = self.body, self.robot.model
        for handle, M in zip(self.parts, body.placements(q), strict=True):
            _place(handle, M)
        for handle, T in zip(self.tips, body.tips(q), strict=True):
            _place(handle, T)
        for handle, joint in zip(self.axes, self.robot.joint_names, strict=True):
            _place(handle, body.data.oMi[model.getJointId(joint)].homogeneous)

    def gaps(self, targets: dict[str, np.ndarray | None]) -> None:
        """Draw a line from each tip to its target, a pose (4, 4) or position (3,); {} draws none."""
        ends = [T for T in targets.values() if T is not None]
        base = self.body.T_world_base
        goals = [base[:3, :3] @ (T if T.ndim == 1 else T[:3, 3]) + base[:3, 3] for T in ends]
        tips = [tip.position for tip, T in zip(self.tips, targets.values(), strict=False) if T is not None]
        self.line("/gap", [*zip(tips, goals, strict=True)], RED)

    def ghost(self, q: np.ndarray | None) -> None:
        """Also show the robot at q (n,), translucent; None removes it."""
        if q is None:
            for handle in self.shade:
                handle.visible = False
            return
        scene = self.client.scene
        if not self.shade:
            for part in self.body.parts:
                self.shade.append(scene.add_frame(f"/ghost/{part.name}", show_axes=False))
                for k, shape in enumerate(part.shapes):
                    scene.add_mesh_simple(
                        f"/ghost/{part.name}/{k}",
                        shape.vertices,
                        shape.faces,
                        color=GHOST,
                        opacity=0.35,
                        cast_shadow=False,
                    )
        with self.client.atomic():
            for handle, M in zip(self.shade, self.body.placements(q), strict=True):
                _place(handle, M)
                handle.visible = True

    def box(self, name: str, size: Any, T: np.ndarray, color: tuple[int, int, int]) -> Any:
        """Draw a box of size (x, y, z) [m] at T_base_box (4, 4) with arrows and rings; return the handle to drag."""
        scene = self.client.scene
        gizmo = scene.add_transform_controls(f"/box/{name}", scale=1.2 * max(size), disable_sliders=True)
        scene.add_box(f"/box/{name}/shape", dimensions=tuple(size), color=color, opacity=0.85)
        _place(gizmo, self.body.T_world_base @ T)
        return gizmo

    def dragged(self, gizmo: Any) -> np.ndarray:
        """Return the pose (4, 4) of a dragged handle in the base frame. Raises InvalidTarget."""
        return _dragged(gizmo, self.body.T_world_base)

    def line(self, name: str, points: Any, color: tuple[int, int, int]) -> None:
        """Draw lines between pairs of points (K, 2, 3) [m], world axes; replaces earlier ones of this name."""
        if name in self.lines:
            self.lines.pop(name).remove()
        if len(points):
            ends = np.asarray(points, dtype=np.float32)
            self.lines[name] = self.client.scene.add_line_segments(name, ends, color, thickness=0.004 * self.size)

    def ellipsoid(self, k: int, axes: np.ndarray, radii: np.ndarray, visible: bool) -> None:
        """Draw a velocity ellipsoid around tip k: axes (3, 3) in the base, radii (3,) [m/s] as the way of a quarter of a second."""
        R = self.body.T_world_base[:3, :3] @ axes
        if np.linalg.det(R) < 0.0:
            R[:, 2] *= -1.0
        ball = self.ellipsoids.get(k)
        if ball is None:
            if not visible:
                return
            form = need_trimesh().creation.icosphere(subdivisions=3)
            ball = self.ellipsoids[k] = self.client.scene.add_mesh_simple(
                f"/ellipsoid/{k}", form.vertices, form.faces, color=GHOST, opacity=0.35, cast_shadow=False
            )
        ball.scale = tuple(np.maximum(0.25 * radii, 1e-3 * self.size).tolist())
        ball.visible = visible
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = R, self.tips[k].position
        _place(ball, T)

    def show_frames(self, visible: bool) -> None:
        """Show or hide the joints' axes."""
        for frame in self.axes:
            frame.visible = visible

    def aim(self, q: np.ndarray) -> None:
        """Look at the robot at q from the front right."""
        camera = getattr(self.client, "camera", None)
        if camera is None:  # a server has no camera
            return
        # the picture is as wide as the page until the controls are docked beside it
        self.widest = max(self.widest, camera.image_width)
        self.extent, self.away = self.body.bounds(q), False
        camera.up_direction = (0.0, 0.0, 1.0)
        camera.fov = LENS
        self._look(camera, self.extent, VIEW)

    def keep_in_view(self) -> None:
        """Move the camera away, along the direction it looks in, until all targets are in the picture, and later back again."""
        camera = getattr(self.client, "camera", None)
        if camera is None:
            return
        goals = np.array([handle.gizmo.position for handle in self.handles if handle.gizmo.visible])
        w, x, y, z = camera.wxyz
        turn = pin.Quaternion(w, x, y, z).matrix()
        across, down, ahead = turn.T @ (goals.reshape(-1, 3) - camera.position).T
        edge, free = EDGE * np.tan(0.5 * camera.fov) * ahead, self._free()
        aspect = camera.image_width / max(camera.image_height, 1)
        seen = (np.abs(across) < aspect * edge) & (-edge < down) & (down < (2.0 * free - 1.0) * edge)
        if not seen.all() or self.away:
            box = np.array([self.extent[0], self.extent[1], *goals])
            box = np.array([box.min(axis=0), box.max(axis=0)])
            self.away = not np.allclose(box, self.extent)
            self._look(camera, box, turn[:, 2])

    def _free(self) -> float:
        """Return the share of the picture's height, from the top, that no controls cover."""
        return FREE if self.widest < NARROW else 1.0

    def _look(self, camera: Any, box: np.ndarray, view: np.ndarray) -> None:
        eye, to = camera_for(box, view, camera.image_width / max(camera.image_height, 1), self._free())
        camera.position, camera.look_at = tuple(eye.tolist()), tuple(to.tolist())


def _dragged(gizmo: Any, T_world_base: np.ndarray) -> np.ndarray:
    """Return the pose (4, 4) of a dragged handle in the base frame. Raises InvalidTarget."""
    if not np.isfinite([*gizmo.wxyz, *gizmo.position]).all() or not np.any(gizmo.wxyz):
        raise InvalidTarget("the dragged target is not a valid pose")
    T = np.eye(4)
    T[:3, :3] = pin.Quaternion(*(float(x) for x in gizmo.wxyz)).normalized().matrix()
    T[:3, 3] = gizmo.position
    return np.linalg.inv(T_world_base) @ T


def camera_for(box: np.ndarray, view: np.ndarray, aspect: float, free: float) -> tuple[np.ndarray, np.ndarray]:
    """Return where a camera must be, and the point (3,) [m] it must look at, to see a box (2, 3) as large as fits.

    `view` (3,) is the direction in which it looks, not straight up or down; `aspect` is width over height of the
    picture; `free` is the share of its height, from the top, in which the box is to be seen.
    """
    ahead = view / np.linalg.norm(view)
    across = np.cross(ahead, (0.0, 0.0, 1.0))
    across /= np.linalg.norm(across)
    up, centre, half = np.cross(across, ahead), box.mean(axis=0), math.tan(0.5 * LENS)
    corners = np.array(np.meshgrid(*(box - centre).T)).reshape(3, -1).T
    wide, tall, deep = np.abs(corners @ across), np.abs(corners @ up), corners @ ahead
    away = (np.maximum(wide / max(aspect, 0.1), tall / free) / (half * FILL) - deep).max()
    to = centre - (1.0 - free) * half * away * up
    return to - away * ahead, to


def _place(handle: Any, T: np.ndarray) -> None:
    x, y, z, w = pin.Quaternion(T[:3, :3]).coeffs()
    handle.wxyz, handle.position = (float(w), float(x), float(y), float(z)), tuple(T[:3, 3].tolist())
