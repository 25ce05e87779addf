"""Shapes around a robot and held by it: added, moved, removed, attached and detached by name."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

import numpy as np
import pinocchio as pin

from ...copying import ReadOnly
from ...errors import InvalidOption, near_match
from ..pose import as_matrix
from .shape import Shape, is_shape


@dataclass(frozen=True)
class PlacedShape:
    """A shape around the robot (`arm` is None), or held by an arm.

    `form` is its coal object, T (4, 4) [m] its pose in the base frame, or for a held shape in the tip frame, `arm` the index of the
    arm, and `touch` has the names of parts that it may touch.
    """

    shape: Shape
    form: Any
    T: np.ndarray
    arm: int | None = None
    touch: frozenset[str] = frozenset()


class Surroundings(ReadOnly):
    """Base class of CollisionModel: obstacles and held shapes; `version` counts their changes."""

    robot: Any
    geometry: Any
    pairs: Any
    margins: Any
    _names: list[str]

    def __init__(self) -> None:
        """Start with no shapes."""
        self.version = 0
        self._placed: dict[str, PlacedShape] = {}
        # The convex hulls of meshes, by name for shapes that were added and by index for those of the robot.
        self._hulls: dict[Any, Any] = {}

    def _rebuild(self) -> None:
        """Update the model after shapes were added or removed."""
        raise NotImplementedError

    def _moved(self, name: str) -> None:
        """Update the model after a shape was moved."""
        raise NotImplementedError

    def _object(self, name: str, one: PlacedShape) -> pin.GeometryObject:
        """Return an added shape as a Pinocchio geometry object."""
        arm = self.robot.arms[one.arm or 0]
        held = one.arm is not None
        # An obstacle is attached to the base frame, which may itself move in the model.
        at = arm._ids[1] if held else arm._ids[0]
        frame = self.robot.model.frames[at]
        place = frame.placement * (arm.tool if held else pin.SE3.Identity()) * pin.SE3(one.T)
        return pin.GeometryObject(name, frame.parentJoint, at, place, one.form)

    @property
    def obstacles(self) -> tuple[str, ...]:
        """Names of the shapes around the robot that it does not hold."""
        return tuple(name for name, one in self._placed.items() if one.arm is None)

    @property
    def attached(self) -> tuple[str, ...]:
        """Names of the shapes that the robot holds, which move with a tip."""
        return tuple(name for name, one in self._placed.items() if one.arm is not None)

    def placed(self) -> list[tuple[str, Shape, np.ndarray]]:
        """Return the name, shape and pose (4, 4) [m] in the base frame of each obstacle."""
        return [(name, one.shape, one.T) for name, one in self._placed.items() if one.arm is None]

    def contents(self) -> str:
        """Return a text that identifies what is tested: pairs, margins, and the names, extents and poses of all shapes.

        Stored results are reused only if this text is the same.
        """
        shapes = []
        for one in self.geometry.geometryObjects:
            one.geometry.computeLocalAABB()  # Coal does not compute the bounding box of a new shape by itself.
            box = one.geometry.aabb_local
            place = (one.parentJoint, one.placement.homogeneous.tolist())
            shapes.append((one.name, type(one.geometry).__name__, box.min_.tolist(), box.max_.tolist(), place))
        return repr((self.pairs, self.margins.tolist(), shapes))

    # ------------------------------------------------------------------------------------------------ obstacles
    def add_box(self, size: Sequence[float], pose: Any, name: str | None = None) -> Self:
        """Add a box of size (x, y, z) [m] at a pose (4, 4), pin.SE3 or position (3,) [m] in the base frame; return the model."""
        return self.add(Shape.box(size), pose, name)

    def add_sphere(self, radius: float, position: Any, name: str | None = None) -> Self:
        """Add a sphere with this radius [m], centred at a position (3,) [m] in the base frame; return the model itself."""
        return self.add(Shape.sphere(radius), position, name)

    def add_cylinder(self, radius: float, length: float, pose: Any, name: str | None = None) -> Self:
        """Add a cylinder of this radius and length [m] along the z axis of a pose, at which it is centred; return the model itself.

        The pose is a (4, 4), a pin.SE3 or a position (3,) [m] in the base frame.
        """
        return self.add(Shape.cylinder(radius, length), pose, name)

    def add_mesh(self, path: str | Path, pose: Any, scale: float = 1.0, name: str | None = None) -> Self:
        """Add a mesh file (STL, OBJ, DAE), scaled to metres by `scale`, at a pose in the base frame; return the model itself.

        The pose is a (4, 4), a pin.SE3 or a position (3,) [m]. Only the surface counts: a part wholly inside it touches nothing.
        """
        return self.add(Shape.mesh(path, scale), pose, name)

    def add(self, shape: Shape, pose: Any, name: str | None = None) -> Self:
        """Add a shape around the robot.

        Args:
            shape: The shape, for example `ik.Shape.box((0.1, 0.2, 0.3))`.
            pose: Its pose (4, 4), pin.SE3 or position (3,) [m] in the base frame.
            name: Its name, by default made of its kind and a number.

        Returns:
            The model itself, so that calls can be chained.

        Raises:
            InvalidOption: `shape` is no Shape, or the name is taken.
            InvalidTarget: `pose` is neither a pose nor a position.
        """
        form, T = is_shape(shape).form(), as_matrix(pose, "shape", self.robot.reach)
        self._placed[self._new_name(shape, name)] = PlacedShape(shape, form, T)
        self._rebuild()
        return self

    def move(self, name: str, pose: Any) -> Self:
        """Give an obstacle a new pose in the base frame, or an attached shape one in its tip frame; return the model itself.

        Raises InvalidOption if there is no such shape, InvalidTarget if `pose` is neither a pose nor a position.
        """
        one = self._placed[self._known(name)]
        self._placed[name] = replace(one, T=as_matrix(pose, "shape", self.robot.reach))
        self._moved(name)
        return self

    def remove(self, name: str) -> Self:
        """Remove an obstacle or an attached shape; return the model itself. Raises InvalidOption if there is none of this name."""
        del self._placed[self._known(name)]
        self._hulls.pop(name, None)
        self._rebuild()
        return self

    def attach(
        self,
        shape: Shape | str,
        T_tip_shape: Any = None,
        *,
        q: Any = None,
        tip: str | None = None,
        name: str | None = None,
        touch: Iterable[str] = (),
    ) -> Self:
        """Attach a shape to a tip, so that it moves with the robot.

        It is tested against every part it can move relative to.

        Args:
            shape: A shape, or the name of an obstacle that is grasped.
            T_tip_shape: Pose (4, 4) or position (3,) [m] in the tip frame. By default a shape is at the tip, and an
                obstacle stays where it is at q.
            q: Configuration (n,) [rad or m] at which an obstacle is grasped.
            tip: The tip of a Tree that holds the shape.
            name: Name of the shape, by default made of its kind and a number.
            touch: Names of links and obstacles that it may touch.

        Returns:
            The model itself, so that calls can be chained.

        Raises:
            InvalidOption: A name is unknown or taken, or neither q nor T_tip_shape is given for an obstacle.
            InvalidTarget: T_tip_shape is not a pose.
            FrameNotFound: There is no such tip.
        """
        arm = self._arm(tip)
        try:
            touch = frozenset([touch] if isinstance(touch, str) else touch)
        except TypeError:
            raise InvalidOption(f"touch must be names of links and obstacles, not {touch!r:.60}") from None
        for other in touch:
            if other not in self._names:
                raise InvalidOption(
                    f"touch= names '{other}', which is not a known part.{near_match(other, dict.fromkeys(self._names))}"
                )
        given = None if T_tip_shape is None else as_matrix(T_tip_shape, "shape", self.robot.reach)
        if isinstance(shape, str):
            one = self._placed[self._known(shape)]
            if one.arm is not None:
                raise InvalidOption(f"'{shape}' is already attached")
            if given is None and q is None:
                raise InvalidOption(
                    f"to attach '{shape}' where it is, give the q at which the robot grasps it, or T_tip_shape"
                )
            T = self._tip(arm, q).inverse().homogeneous @ one.T if given is None else given
            self._placed[shape] = replace(one, T=T, arm=arm, touch=touch)
        else:
            form, T = is_shape(shape).form(), np.eye(4) if given is None else given
            self._placed[self._new_name(shape, name)] = PlacedShape(shape, form, T, arm, touch)
        self._rebuild()
        return self

    def detach(self, name: str, q: Any = None) -> Self:
        """Remove an attached shape or, if q (n,) [rad or m] is given, make it an obstacle where it is at q.

        Returns the model itself. Raises InvalidOption if the shape is not attached.
        """
        one = self._placed[self._known(name)]
        if one.arm is None:
            raise InvalidOption(f"'{name}' is an obstacle, not attached; use remove()")
        if q is None:
            return self.remove(name)
        T = self._tip(one.arm, q).homogeneous @ one.T
        self._placed[name] = PlacedShape(one.shape, one.form, T)
        self._rebuild()
        return self

    def _arm(self, tip: str | None) -> int:
        if tip is None and len(self.robot.tips) > 1:
            raise InvalidOption(f"choose with tip= the tip that holds it: {', '.join(self.robot.tips)}")
        if tip is not None:
            self.robot.check_tips([tip])
        return 0 if tip is None else self.robot.tips.index(tip)

    def _tip(self, arm: int, q: Any) -> pin.SE3:
        """Return the pose of an arm's tip in the base frame at q (n,) [rad or m]."""
        return self.robot.arms[arm]._fk(self.robot.check_q(q)[self.robot.places[arm]])

    def _known(self, name: str) -> str:
        if not (isinstance(name, str) and name in self._placed):
            raise InvalidOption(
                f"there is no obstacle or attached shape named '{name!s:.60}'.{near_match(name, self._placed)}"
            )
        return name

    def _new_name(self, shape: Shape, name: str | None) -> str:
        if name is None:
            return next(n for n in (f"{shape.kind}_{k}" for k in range(1, 10**6)) if n not in self._names)
        if not isinstance(name, str):
            raise InvalidOption(f"name must be text, not {name!r:.60}")
        if name in self._names:
            raise InvalidOption(f"there is already a link or obstacle named '{name}'")
        return name
