"""The robot: a Pinocchio model with a base and a tip frame.

The Pinocchio model defines joints, frames and limits, and computes FK and Jacobians for users. The arrays of the compiled solvers
are read from it.
"""

import math
import threading
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from ..errors import FrameNotFound, InvalidConfiguration, InvalidOption, JointNotFound, ModelError, floats
from ..kernel.chain import Chain
from ..kernel.records import POINTS
from ..text import how_many
from .base import describes, on_own_base, put_joint
from .configuration import near_joint, simple_joints, values_by_joint
from .constraints import Constraint
from .formats.convert import write_urdf
from .formats.mimic import followers, mimic_limits, mimic_speeds
from .formats.srdf import Srdf, group_chain, passive_joints, read_srdf
from .formats.urdf_model import build_model
from .geometry.link_shapes import light
from .geometry.shape import Shape, is_shape
from .joints import Joints
from .load import (
    based,
    doubted_size,
    folders_of,
    given_models,
    library_home,
    read_both,
    require_text_or_file,
    text_and_file,
)
from .pose import as_matrix, check_target
from .probe import AGREE, chain_deviation, find_path, good_start, kinds, limits, mid_range, probe, speed_limits
from .tips import frame_id, one_word, only_tip, root_link

# Attributes of a Robot that are caches; they are left out of copies and pickles.
CACHES = ("_local", "_sampling", "_circles", "mobility", "memo", "_sealed")


class Robot(Joints):
    """A robot arm with one tip: model, base, tip, limits and home. It has the attributes of `Joints`, and these.

    Attributes:
        base, tip: Names of the frames between which poses are given.
        locked_joints: Values [rad or m] at which joints are held, by name.
        tool, tool_shapes: T_tip_tool (pin.SE3), and collision shapes with their poses in the tip frame.
        urdf, path, package_dirs: Text and file of the description, each or None, and folders of ROS packages.
        on_base, base_limits: As given to `load`.
    """

    def __init__(
        self,
        model: Any = None,
        collision_model: pin.GeometryModel | None = None,
        visual_model: pin.GeometryModel | None = None,
        *,
        tip: str | None = None,
        ee_link: str | None = None,
        base: str | None = None,
        home: Sequence[float] | None = None,
        name: str | None = None,
        locked: Mapping[str, float] | None = None,
        urdf: str | Path | None = None,
        path: Path | None = None,
        package_dirs: Iterable[str | Path] = (),
        on_base: Any = None,
        base_limits: Any = None,
        srdf: str | Path | Srdf | None = None,
        notes: Sequence[str] = (),
        constraints: Sequence[Constraint] = (),
        others: Sequence[str] = (),
    ) -> None:
        """Wrap a pin.Model with its shapes, as pin.buildModelsFromUrdf returns them, or a RobotWrapper; the rest is as in `load`.

        home (n,) [rad or m] is a good, non-singular start, by default mid-range. urdf (text or path) has what the model lacks:
        limits of mimic joints, and shapes; without a model it is read from there. A free-flyer of the model counts as a floating
        base and needs base_limits. others are joints that move for other tips (see Tree); those on the base's branch are
        coordinates too. Raises FrameNotFound, JointNotFound, RobotNotFound, ModelError, InvalidConfiguration, InvalidOption.
        """
        tip = one_word(tip, ee_link)
        urdf, path = text_and_file(urdf, path)
        model, self.collision_model, self.visual_model = given_models(model, collision_model, visual_model, urdf)
        if on_base is not None and base is not None:
            raise InvalidOption("on_base places the robot in the world, in which poses are then given; omit base")
        self.on_base, self.base_limits = on_base, base_limits
        self.notes, self.constraints = tuple(notes), tuple(constraints)
        self._others = tuple(others)
        self._settle(model)
        self.name = name or model.name
        self.urdf, self.path, self.package_dirs = urdf, path, tuple(folders_of(package_dirs))
        root = "universe" if on_base is not None else root_link(self.model)
        self.base = root if base is None else base
        base_id = frame_id(self.model, self.base, self.name)
        self.tip = tip if tip is not None else only_tip(model, self.name)
        tip_id = frame_id(self.model, self.tip, self.name)
        self.tool, self.tool_shapes = pin.SE3.Identity(), ()
        self.rest = pin.neutral(self.model)
        self.locked_joints: dict[str, float] = {}
        self._ranges: Mapping[str, tuple[float, float]] = {}  # Limits by joint that `narrowed` gave to this variant.
        self.srdf = read_srdf(srdf) if srdf is not None else Srdf()
        for joint, value in followers(urdf).rest.items():
            self._set_rest(joint, value, False)
        held = passive_joints(self.srdf, self.model, base_id, tip_id, values_by_joint(locked))
        for joint, (value, counts) in held.items():
            self._set_rest(joint, value, counts)
        self._build(home)

    @classmethod
    def load(
        cls,
        source: str | Path,
        *,
        tip: str | None = None,
        ee_link: str | None = None,
        base: str | None = None,
        package_dirs: Iterable[str | Path] = (),
        locked: Mapping[str, float] | None = None,
        xacro_args: Mapping[str, Any] | None = None,
        on_base: Any = None,
        base_limits: Any = None,
        srdf: str | Path | Srdf | bool | None = None,
        group: str | None = None,
    ) -> "Robot":
        """Load a robot by name, from a file or from text; meshes are not read.

        Args:
            source: A shipped name, the path of a URDF, xacro or MJCF file, its text, or a name of example-robot-data.
            tip: A frame, link or joint; by default guessed by its name, and reported. `Tree.load` takes several.
            ee_link: Another name of the argument tip.
            base: Frame in which poses are given; by default the root.
            package_dirs: Folders in which ROS packages are searched.
            locked: Values [rad or m] at which joints are held, by name; they are left out of q.
            xacro_args: Values of a xacro file's arguments, by name.
            on_base: Pose (4, 4) of the root in the world, in which poses are then given; 'rail' puts base_x before q, 'planar'
                base_x, base_y, base_yaw, 'floating' base_x, base_y, base_z, base_yaw, base_pitch, base_roll (Rz Ry Rx).
            base_limits: (lower, upper) [m] of the base's prismatic joints, one pair for all, one pair each, or a dict by name.
                Rotations are unlimited unless given, except pitch (+-85 degrees).
            srdf: File or text of an SRDF, by default the one next to the file (see `srdf_beside`); False uses none.
            group: SRDF group that sets base and tip, with on_base only the tip.

        Raises:
            RobotNotFound, FrameNotFound, JointNotFound: A name is unknown; the message lists what exists.
            ModelError: The file is malformed or hostile.
            InvalidOption, InvalidConfiguration: An argument is wrong.
            MissingExtra: xacro or mujoco is needed and not installed.
        """
        tip = one_word(tip, ee_link)
        entry, made = read_both(source, package_dirs, xacro_args, srdf, group)
        if group is not None:
            start, end = group_chain(made["srdf"], group, made["model"], tip)
            tip, base = end, base if base or on_base is not None else start
        if tip is None and len(entry.tips) > 1:
            raise FrameNotFound(
                f"robot '{entry.name}' has {len(entry.tips)} tips; choose one with tip=, or solve for several with "
                f"ik.Tree.load(source, tips=[...]): {', '.join(entry.tips)}"
            )
        known = tip in (None, entry.tip) and base in (None, entry.base)
        made = based(entry, made, base, tip, on_base, base_limits)
        home = [*library_home(entry, made).values()] or None if known else None
        robot = cls(**made, tip=tip if tip is not None else entry.tip, home=home)
        held = values_by_joint(locked)
        return robot.locked(held) if held else robot

    @classmethod
    def from_mjcf(cls, source: str | Path, **options: Any) -> "Robot":
        """Load a robot from an MJCF file or text (needs the extra `formats`); options and errors as in `load`."""
        return cls.from_urdf(source, **options)

    @classmethod
    def from_urdf(cls, source: str | Path, **options: Any) -> "Robot":
        """Load a robot from a URDF or xacro file, or from URDF text; options and errors as in `load`, but no library names."""
        require_text_or_file(source)
        return cls.load(source, **options)

    def _set_rest(self, joint: str, value: float, counts: bool = True) -> None:
        joints = dict(simple_joints(self.model))
        if joint not in joints:
            raise JointNotFound(
                f"robot '{self.name}' has no movable joint '{joint}' to lock.{near_joint(joint, self.model, joints)}"
            )
        what = f"the value of locked joint '{joint}' must be a finite number"
        number = floats(value, what, InvalidConfiguration)
        if number.shape != () or not np.isfinite(number):
            raise InvalidConfiguration(f"{what}, not {number.tolist()}")
        put_joint(joints[joint], self.rest, float(number))
        if counts:
            self.locked_joints[joint] = float(number)

    def _settle(self, model: pin.Model) -> None:
        """Take over a model, placed on its base, and set everything that follows from it: path, limits, home and chain."""
        self.model, self._original, self._given, self._of_base, self._slides = on_own_base(
            model, self.on_base, self.base_limits
        )

    def _build(self, home: Sequence[float] | np.ndarray | None) -> "Robot":
        self.memo: dict[Any, Any] = {}
        self._wide = None
        model = self.model
        base_id, tip_id = (frame_id(model, name, self.name) for name in (self.base, self.tip))
        self._ids = base_id, tip_id
        locked = {model.getJointId(joint) for joint in self.locked_joints}
        others = [model.getJointId(joint) for joint in self._others]
        self._path = path = find_path(model, base_id, tip_id, locked, others)
        loose = followers(self.urdf).loose
        for joint in (model.names[j] for j in path.joints):
            if joint in loose:
                raise ModelError(
                    f"joint '{joint}' between '{self.base}' and '{self.tip}' {loose[joint]}: correct its <mimic>"
                )
        self.joint_names = tuple(model.names[j] for j in path.leaders)
        self.tips, self.places = (self.tip,), (np.arange(self.n),)
        lower, upper, notes = limits(model, path, mimic_limits(self.urdf))
        self.velocity_limits, slower = speed_limits(model, path, mimic_speeds(self.urdf))
        self._note([*notes, *slower])
        ends = dict(zip(self.joint_names, upper.tolist(), strict=True))
        free = [joint for joint in self._slides if math.isinf(ends.get(joint, 0.0))]
        if free:
            raise InvalidOption(f"base_limits= is needed: the lower and upper limits [m] of {', '.join(free)}")
        for i, joint in enumerate(self.joint_names):
            lower[i], upper[i] = self._ranges.get(joint, (lower[i], upper[i]))
        self.lower, self.upper = lower, upper
        based = np.array([joint in self._of_base for joint in self.joint_names])
        self.home = start = mid_range(lower, upper, ~based)
        self.chain: Chain = probe(model, path, self.rest, base_id, tip_id, self.tool, lower, upper, start)
        self.joint_kinds = kinds(self.chain)
        self._local = threading.local()
        self._compare()
        strokes = np.array([lower, upper])[:, self.slides & ~based]
        self._note(doubted_size(model, path.joints, tip_id, strokes))
        # The home of a library robot has no values for the joints of a moving base, so start values of these are put first.
        if home is not None and len(home) == self.n - based.sum():
            home = np.concatenate([start[based], home])
        self.home = self.check_home(home) if home is not None else good_start(self.chain, lower, upper, start, ~based)
        at = POINTS + 6 * self.n
        self.chain.ends[at : at + self.n] = self.home / self.chain.unit
        for array in (self.lower, self.upper, self.home, self.velocity_limits, self.rest):
            array.setflags(write=False)
        self._seal()
        return self

    def _compare(self) -> None:
        """Reject a robot if the arrays for the compiled solvers (chain) disagree with Pinocchio, as results would be wrong."""
        self._kinematics(self.home)
        far = math.hypot(*self.data.oMf[self._ids[0]].translation)
        off = chain_deviation(self.chain, self.slides, self._kinematics, far)
        if not off <= AGREE:  # Unlike `off > AGREE`, this is true for NaN too.
            raise ModelError(
                f"robot '{self.name}' from '{self.base}' to '{self.tip}' is rejected: its kinematics differ from "
                f"Pinocchio's by {off:.2g}, so results would be wrong; please report this with its URDF"
            )

    @property
    def arms(self) -> tuple["Robot"]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """A tuple with this robot alone, so that it can be used like a Tree, whose `arms` are a Robot for each tip."""
        return (self,)

    @property
    def data(self) -> pin.Data:
        """Working memory of Pinocchio (pin.Data) for this model; each thread has its own."""
        data = getattr(self._local, "data", None)
        if data is None:
            data = self._local.data = self.model.createData()
        return data

    def fk(self, q: Any) -> pin.SE3:
        """Compute T_base_tip [m], the pose of the tip in the base frame, at q (n,) [rad or m] by Pinocchio."""
        return self._fk(self.check_q(q))

    def _fk(self, q: np.ndarray) -> pin.SE3:
        data = self.data
        pin.forwardKinematics(self.model, data, self._filled(q))
        # The base frame may move in the model, because a joint between root and base may mimic one on the path.
        base = pin.updateFramePlacement(self.model, data, self._ids[0])
        return base.actInv(pin.updateFramePlacement(self.model, data, self._ids[1])) * self.tool

    def jacobian(self, q: Any) -> np.ndarray:
        """Compute the Jacobian (6, n) of the tip in base axes, linear rows first [m or rad per rad or m], by Pinocchio."""
        return self._kinematics(self.check_q(q))[1]

    def _kinematics(self, q: np.ndarray) -> tuple[pin.SE3, np.ndarray]:
        """Compute pose and Jacobian (see `fk` and `jacobian`) at q (n,) [rad or m]."""
        model, data = self.model, self.data
        pin.computeJointJacobians(model, data, self._filled(q))
        base, tip = (pin.updateFramePlacement(model, data, i) for i in self._ids)
        columns = [model.joints[j].idx_v for j in self._path.leaders]
        point = tip.act(self.tool.translation)
        J = np.zeros((6, self.n))
        # The base frame may move in the model too, so its Jacobian is subtracted from that of the tip.
        for sign, frame, i in ((1.0, tip, self._ids[1]), (-1.0, base, self._ids[0])):
            K = pin.getFrameJacobian(model, data, i, pin.LOCAL_WORLD_ALIGNED).reshape(6, -1)[:, columns]
            K[:3] -= pin.skew(point - frame.translation) @ K[3:]
            J += sign * K
        R = base.rotation.T
        return base.actInv(tip) * self.tool, np.vstack([R @ J[:3], R @ J[3:]])

    def errors(self, q: Any, target: Any) -> tuple[float, float | None]:
        """Compute by Pinocchio how far the tip at q (n,) [rad or m] is from a target: distance [m] and rotation angle [rad].

        The target is a pose or, with angle None, a position [m] in the base frame. Raises InvalidConfiguration, InvalidTarget.
        """
        target = self.each_tip(target).get(self.tip, target)
        return self._errors(self.check_q(q), check_target(target, self.base)[0])

    def _errors(self, q: np.ndarray, target: np.ndarray) -> tuple[float, float | None]:
        T = self._fk(q)
        if target.ndim == 1:
            return math.hypot(*(target - T.translation).tolist()), None
        rotation = pin.log3(T.rotation.T @ target[:3, :3])
        return math.hypot(*(target[:3, 3] - T.translation).tolist()), math.hypot(*rotation.tolist())

    def _is_described(self) -> bool:
        """Return whether the URDF describes the model, which may have been given beside it, with other joints or lengths."""
        model = self.model if self._original is None else self._original
        return self.urdf is not None and describes(build_model(self.urdf), model, (self.base, self.tip))

    def _variant(self, **changes: Any) -> "Robot":
        """Return a copy that shares the model, with other attributes `changes` and none of the caches; `_build` makes the rest."""
        other = Robot.__new__(Robot)
        kept = {key: value for key, value in self.__dict__.items() if key not in CACHES}
        other.__dict__.update(kept | changes)
        return other

    def _locked(self, joints: Mapping[str, float]) -> "Robot":
        keep = [j for j in self.joint_names if j not in joints]
        other = self._variant(rest=self.rest.copy(), locked_joints=dict(self.locked_joints))
        for joint, value in joints.items():
            other._set_rest(joint, value)
        home = [x for j, x in zip(self.joint_names, self.home, strict=True) if j in keep]
        return other._build(home if keep else None)

    def _narrowed(self, ranges: Mapping[str, tuple[float, float]]) -> "Robot":
        home = np.clip(self.home, *np.transpose([ranges[joint] for joint in self.joint_names]))
        return self._variant(_ranges=ranges)._build(home)

    def with_tool(self, T_tip_tool: Any, shape: Shape | None = None, T_tip_shape: Any = None) -> "Robot":
        """Return a copy whose targets, fk and errors refer to a tool frame, at T_tip_tool (4, 4) in the tip frame.

        `shape` is a collision shape (Shape) of the tool, at T_tip_shape (4, 4) in the tip frame, by default at T_tip_tool.
        """
        T = as_matrix(T_tip_tool, "tool", self.reach)
        shapes = self.tool_shapes
        if shape is not None:
            place = self.tool * pin.SE3(T if T_tip_shape is None else as_matrix(T_tip_shape, "shape", self.reach))
            shapes = (*shapes, (is_shape(shape), place))
        return self._variant(tool=self.tool * pin.SE3(T), tool_shapes=shapes)._build(self.home)

    write = write_urdf  # robot.write(file) saves the robot's description as one plain URDF.

    def __getstate__(self) -> dict[str, Any]:
        """Leave out thread-local state; a model with mimic joints is pickled as its URDF (otherwise Pinocchio 4.1 crashes)."""
        state = {key: value for key, value in self.__dict__.items() if key not in CACHES}
        state["visual_model"] = light(self.visual_model)
        if not len(self.model.mimicking_joints):
            return state
        if not self._is_described():
            raise ModelError(
                f"robot '{self.name}' has mimic joints and no URDF that describes its model, so it cannot be pickled"
            )
        state["model"] = state["_original"] = state["_given"] = None
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore the robot, with a new pin.Data for each thread."""
        self.__dict__.update(state)
        if self.model is None and self.urdf is not None:
            self._settle(build_model(self.urdf))
        self._local, self.memo = threading.local(), {}
        self._seal()

    def __repr__(self) -> str:
        """Describe the robot in one line: name, path and joints."""
        return f"Robot('{self.name}', {self.base} -> {self.tip}, {how_many(self.n, 'joint')}: {', '.join(self.joint_names)})"

    def _route(self) -> str:
        return f"{self.base} → {self.tip}, reach at most {self.reach:.3g} m"
