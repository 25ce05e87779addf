"""The 3-D view of one visitor of the panel (viser): the robot, frames, and a target to drag for each tip."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin

from ..errors import InvalidTarget
from .parts import Body

RED = (204, 51, 38)  # of the line to a target that is not met
GHOST = (0, 114, 178)


class Handle:
    """Arrows and rings of one tip's target. target: T_base_target (4, 4)."""

    def __init__(self, stage: "Stage", k: int, name: str, T: np.ndarray, dragged: Callable[[], None]) -> None:
        """Draw them at T (4, 4); `dragged` is called when the visitor moves them."""
        self.T_world_base = stage.body.T_world_base
        scene = stage.client.scene
        self.gizmo = scene.add_transform_controls(f"/target/{k}", scale=0.22 * stage.size, disable_sliders=True)
        self.name = scene.add_label(f"/target/{k}/name", name, anchor="bottom-left") if name else None
        self.put(T)
        self.gizmo.on_update(lambda _: dragged())

    def put(self, target: np.ndarray) -> None:
        """Put them at T_base_target (4, 4), or at a position (3,) with the rotation they have."""
        if target.ndim == 1:
            place, target = target, self.target.copy()
            target[:3, 3] = place
        self.target = target
        _place(self.gizmo, self.T_world_base @ target)

    def read(self) -> np.ndarray:
        """T_base_target (4, 4) where the visitor has dragged them to."""
        if not np.isfinite([*self.gizmo.wxyz, *self.gizmo.position]).all() or not np.any(self.gizmo.wxyz):
            raise InvalidTarget("the target was dragged to no pose")
        T = np.eye(4)
        T[:3, :3] = pin.Quaternion(*(float(x) for x in self.gizmo.wxyz)).normalized().matrix()
        T[:3, 3] = self.gizmo.position
        self.target = np.linalg.inv(self.T_world_base) @ T
        return self.target

    def turns(self, rotations: bool, visible: bool) -> None:
        """Whether there are rings, and whether there is anything."""
        self.gizmo.disable_rotations, self.gizmo.visible = not rotations, visible
        if self.name is not None:
            self.name.visible = visible


class Stage:
    """A robot in the view of a viser client (or server). handles: one a tip."""

    def __init__(
        self,
        client: Any,
        body: Body,
        q: np.ndarray,
        targets: dict[str, np.ndarray],
        frames: bool,
        dragged: Callable[[], None],
    ) -> None:
        """Draw the robot at q and targets (4, 4) by tip; `dragged` is called when the visitor moves one."""
        self.client, self.body = client, body
        self.robot: Any = body.robot
        scene, robot = client.scene, self.robot
        low, high = body.bounds(q)
        self.size = float(np.linalg.norm(high - low))
        scene.set_up_direction("+z")
        cell = 10.0 ** np.round(np.log10(self.size / 8.0))
        floor = (0.0, 0.0, min(low[2], 0.0))
        faint, clear = (228, 231, 235), (198, 204, 211)
        scene.add_grid(
            "/grid",
            40 * cell,
            40 * cell,
            cell_size=cell,
            section_size=5 * cell,
            cell_color=faint,
            section_color=clear,
            position=floor,
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
        self.gap: Any = None
        self.shade: list[Any] = []
        self.aim(q)

    def show(self, q: np.ndarray) -> None:
        """Place everything but the target for joint values q (n,)."""
        body, model = self.body, self.robot.model
        for handle, M in zip(self.parts, body.placements(q), strict=True):
            _place(handle, M)
        for handle, T in zip(self.tips, body.tips(q), strict=True):
            _place(handle, T)
        for handle, joint in zip(self.axes, self.robot.joint_names, strict=True):
            _place(handle, body.data.oMi[model.getJointId(joint)].homogeneous)

    def gaps(self, targets: dict[str, np.ndarray | None]) -> None:
        """Draw a line from each tip, as it stands, to its target: a pose (4, 4) or position (3,); {} draws none."""
        ends = [T for T in targets.values() if T is not None]
        if not ends:
            if self.gap is not None:
                self.gap.visible = False
            return
        base = self.body.T_world_base
        goals = [base[:3, :3] @ (T if T.ndim == 1 else T[:3, 3]) + base[:3, 3] for T in ends]
        tips = [tip.position for tip, T in zip(self.tips, targets.values(), strict=True) if T is not None]
        points = np.array([*zip(tips, goals, strict=True)], dtype=np.float32)
        if self.gap is not None:
            self.gap.remove()
        self.gap = self.client.scene.add_line_segments("/gap", points, RED, thickness=0.004 * self.size)

    def ghost(self, q: np.ndarray | None) -> None:
        """Show the robot at q (n,) as well, translucent; None: no more."""
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

    def show_frames(self, visible: bool) -> None:
        """Show or hide the joints' axes."""
        for frame in self.axes:
            frame.visible = visible

    def aim(self, q: np.ndarray) -> None:
        """Look at the robot at q from the front right."""
        camera = getattr(self.client, "camera", None)
        if camera is not None:  # a server has none
            centre = self.body.bounds(q).mean(axis=0)
            camera.up_direction = (0.0, 0.0, 1.0)
            camera.position = tuple((centre + 1.35 * self.size * np.array([0.66, -0.63, 0.41])).tolist())
            camera.look_at = tuple(centre.tolist())


def _place(handle: Any, T: np.ndarray) -> None:
    x, y, z, w = pin.Quaternion(T[:3, :3]).coeffs()
    handle.wxyz, handle.position = (float(w), float(x), float(y), float(z)), tuple(T[:3, 3].tolist())
