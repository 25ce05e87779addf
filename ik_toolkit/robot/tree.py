"""A robot with several tips: arms of one model that share joints and are solved together."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from ..errors import FrameNotFound, InvalidOption, InvalidTarget, ModelError
from ..kernel.chain import Chain, TreeChain, pack_tree
from ..text import first_few, how_many, in_shell
from .configuration import values_by_joint
from .formats.srdf import Srdf
from .joints import Joints
from .load import based, library_home, read_both
from .probe import JointPath, Motionless, find_path
from .robot import Robot
from .tips import tip_candidates

ENDS = 8  # A message lists at most this many links at the ends of a robot's branches.


def union(arms: Sequence[Robot]) -> tuple[str, ...]:
    """Return the names of all joints of several arms, each once: those of the first arm, then those that each further arm adds.

    A joint that an arm has only because it moves another arm's tip is listed with that other arm.
    """
    own = [joint for arm in arms for joint in arm.joint_names[: arm._path.own]]
    return tuple(dict.fromkeys([*own, *(joint for arm in arms for joint in arm.joint_names)]))


def arms_of(made: Mapping[str, Any], tips: Sequence[str]) -> list[Robot]:
    """Return a Robot for each tip, all made with the arguments `made`.

    A tip that no joint of its own path moves is accepted if joints of other tips' paths move it.
    """
    found: dict[str, Robot] = {}
    problem: Motionless | None = None
    for tip in tips:
        try:
            found[tip] = Robot(**made, tip=tip)
        except Motionless as error:
            problem = error
    if problem is not None and not found:
        raise problem
    moving = union(list(found.values()))
    return [found[tip] if tip in found else Robot(**made, tip=tip, others=moving) for tip in tips]


def _among(arm: Robot, names: Sequence[str], home: Mapping[str, float]) -> Robot:
    """Return an arm for a tree in which the joints `names` move: those on the base's branch become coordinates of the arm.

    home: values of all joints by name [rad or m]. If no coordinate is added, the arm itself is returned.
    """
    model = arm.model
    locked = {model.getJointId(joint) for joint in arm.locked_joints}
    path = find_path(model, *arm._ids, locked, [model.getJointId(joint) for joint in names])
    if set(path.leaders) == set(arm._path.leaders):
        return arm
    return arm._variant(_others=tuple(names))._build([home[model.names[j]] for j in path.leaders])


class Tree(Joints):
    """Several tips of one model: `Tree.load(name, tips=["left_tip", "right_tip"])`, or `Tree([left, right])` from robots.

    q (n,) has every joint of the paths once. Those of the first tip's path come first, from base to tip, then those that the next
    tip's path adds, and so on. The arms share model, base and resting joints (otherwise ModelError); each may have its own tool.
    Attributes are those of `Joints`, and as in `Robot` base, locked_joints, urdf, path, package_dirs, on_base and
    base_limits; reach [m] is the largest bound of the arms'.
    """

    by_tip = True
    named_tips = property(lambda self: self.tips)

    def __init__(self, arms: Sequence[Robot], home: Sequence[float] | np.ndarray | None = None) -> None:
        """Join robots that differ only in their tip. home (n,) is by default the arms' own. Raises ModelError, FrameNotFound."""
        if isinstance(arms, Robot) or not all(isinstance(arm, Robot) for arm in arms) or not len(arms):
            raise ModelError("a tree is made from a list of robots, one per tip")
        first = arms[0]
        self.tips = tuple(arm.tip for arm in arms)
        if len(set(self.tips)) < len(self.tips):
            raise FrameNotFound(f"each tip can be given only once: {', '.join(self.tips)}")
        for arm in arms[1:]:
            same = arm.model is first.model or arm.model == first.model
            if not same or arm.base != first.base or not np.array_equal(arm.rest, first.rest):
                raise ModelError(
                    f"'{arm.tip}' and '{first.tip}' must be tips of one model with the same base and the same resting joints"
                )
        self.name, self.model, self.base, self.rest = first.name, first.model, first.base, first.rest
        self._original, self._given = first._original, first._given
        self.on_base, self.base_limits = first.on_base, first.base_limits
        self.notes = tuple(dict.fromkeys(note for arm in arms for note in arm.notes))
        self.constraints = first.constraints
        self.urdf, self.path, self.package_dirs = first.urdf, first.path, first.package_dirs
        self.srdf = first.srdf
        self.collision_model, self.visual_model = first.collision_model, first.visual_model
        self.joint_names = names = union(arms)
        homes = {joint: x for arm in reversed(arms) for joint, x in zip(arm.joint_names, arm.home, strict=True)}
        self.arms = arms = tuple(_among(arm, names, homes) for arm in arms)
        self.locked_joints = {joint: x for arm in arms for joint, x in arm.locked_joints.items()}
        for joint in names:
            if joint in self.locked_joints:
                raise ModelError(f"joint '{joint}' is locked for one tip but moves another: lock it for all of them")
        self.memo: dict[Any, Any] = {}
        self.places = tuple(np.array([names.index(joint) for joint in arm.joint_names]) for arm in arms)
        lower, upper = np.full(self.n, -np.inf), np.full(self.n, np.inf)
        self.velocity_limits, middle = np.empty(self.n), np.empty(self.n)
        idx_q, circle = np.empty(self.n, dtype=int), np.empty(self.n, dtype=bool)
        kinds = {}
        # Arms may have different home values for a joint that they share. In reversed order the first arm is the last to set it.
        for arm, place in zip(reversed(arms), reversed(self.places), strict=True):
            lower[place] = np.maximum(lower[place], arm.lower)
            upper[place] = np.minimum(upper[place], arm.upper)
            self.velocity_limits[place], middle[place] = arm.velocity_limits, arm.home
            idx_q[place], circle[place] = arm._path.idx_q, arm._path.circle
            for joint, kind in zip(arm.joint_names, arm.joint_kinds, strict=True):
                # An arm in which a revolute joint mimics a prismatic one counts the coordinate of both as revolute, so the tree
                # does too.
                if kinds.get(joint, "prismatic") == "prismatic":
                    kinds[joint] = kind
        for joint, low, high in zip(names, lower, upper, strict=True):
            if not low <= high:
                raise ModelError(f"joint '{joint}' has no legal position: its ranges on the tips' paths do not overlap")
        self.joint_kinds = tuple(kinds[joint] for joint in names)
        self.lower, self.upper = lower, upper
        self._path = JointPath([], 0, [], self.n, {}, idx_q, circle)
        self.home = self.check_home(np.clip(middle, lower, upper) if home is None else home)
        self.chain: Chain | TreeChain = pack_tree(
            [arm.chain for arm in arms], list(self.places), lower, upper, self.home
        )
        for array in (lower, upper, self.home, self.velocity_limits):
            array.setflags(write=False)
        self._seal()

    @classmethod
    def load(
        cls,
        source: str | Path,
        tips: Sequence[str] | None = None,
        *,
        base: str | None = None,
        package_dirs: Iterable[str | Path] = (),
        locked: Mapping[str, float] | None = None,
        xacro_args: Mapping[str, Any] | None = None,
        on_base: Any = None,
        base_limits: Any = None,
        srdf: str | Path | Srdf | bool | None = None,
        group: str | None = None,
    ) -> "Tree":
        """Load several tips of a robot, by name, from a file or from text.

        If the library has a home configuration of the robot, each joint gets its value from it.

        Args:
            source: As in `Robot.load`.
            tips: Frame names; by default the known tips of the robot (see `ik robots`), if it has several.
            base: Frame in which poses are given, shared by all tips; by default the root.
            package_dirs: Folders in which ROS packages are searched.
            locked: Values [rad or m] at which joints are held, by name.
            xacro_args: Values of a xacro file's arguments, by name.
            on_base: As in `Robot.load`.
            base_limits: As in `Robot.load`.
            srdf: As in `Robot.load`.
            group: SRDF group that sets base and tips.

        Returns:
            The tree.

        Raises:
            FrameNotFound: A tip does not exist, or none is given or known; the message lists the ends of paths.
            RobotNotFound, ModelError, JointNotFound, InvalidOption, MissingExtra: As in `Robot.load`.
        """
        entry, made = read_both(source, package_dirs, xacro_args, srdf, group)
        if group is not None:
            start, ends = made["srdf"].ends(group, made["model"])
            tips, base = tips or list(ends), base if base or on_base is not None else start
        if tips is None:
            tips = entry.tips
            if len(tips) < 2:
                ends = tip_candidates(made["model"])
                some = first_few(ends, ENDS) or "none"
                more = " (ik info ROBOT --list-tips)" if len(ends) > ENDS else ""
                raise FrameNotFound(
                    f"give the tips of robot '{made['name']}' with tips=[...]; its paths end at: {some}{in_shell(more)}"
                )
        if not isinstance(tips, list | tuple):
            raise InvalidOption(
                f"tips= takes a list of frame names, not {tips!r}; for one tip use ik.Robot.load(source, tip=)"
            )
        if not tips:
            raise FrameNotFound("tips=[] is empty; give at least one tip")
        known = base in (None, entry.base)
        made = based(entry, made, base, tips[0], on_base, base_limits)
        arms = arms_of(made, tips)
        tree = cls(arms)
        if known and (given := library_home(entry, made)):
            home = dict(zip(tree.joint_names, tree.home.tolist(), strict=True)) | given
            tree = cls(arms, [home[joint] for joint in tree.joint_names])
        held = values_by_joint(locked)
        return tree.locked(held) if held else tree

    def fk(self, q: Any) -> dict[str, pin.SE3]:
        """Compute by Pinocchio the pose T_base_tip (pin.SE3) [m] of every tip at q (n,) [rad or m], as a dict by name of tip."""
        return dict(zip(self.tips, self.tip_poses(self.check_q(q)), strict=True))

    def jacobian(self, q: Any) -> np.ndarray:
        """Compute by Pinocchio the Jacobian (6 F, n) of F tips at q (n,) in base axes: six rows for each tip, linear ones first."""
        q = self.check_q(q)
        J = np.zeros((6 * len(self.arms), self.n))
        for f, (arm, place) in enumerate(zip(self.arms, self.places, strict=True)):
            J[6 * f : 6 * f + 6, place] = arm.jacobian(q[place])
        return J

    def errors(self, q: Any, targets: Any) -> list[tuple[float, float | None]]:
        """Compute position error [m] and rotation angle [rad] of each tip at q from its target, in the order of `tips`.

        Args:
            q: Configuration (n,) [rad or m].
            targets: One for every tip, as in `Robot.errors`, in the order of `tips` or as a dict by tip.

        Returns:
            A pair for each tip; the angle is None for a position.

        Raises:
            InvalidConfiguration, InvalidTarget, FrameNotFound: q, a target or a name is wrong.
        """
        q = self.check_q(q)
        if isinstance(targets, Mapping):
            self.check_tips(targets)
            targets = [targets[tip] for tip in self.tips if tip in targets]
        if not isinstance(targets, list | tuple | np.ndarray) or len(targets) != len(self.tips):
            raise InvalidTarget(f"give a target for every tip ({', '.join(self.tips)}), not {targets!r:.60}")
        return [arm.errors(q[place], T) for arm, place, T in zip(self.arms, self.places, targets, strict=True)]

    def _locked(self, joints: Mapping[str, float]) -> "Tree":
        arms = [arm._locked(joints) for arm in self.arms]
        home = {joint: x for joint, x in zip(self.joint_names, self.home, strict=True) if joint not in joints}
        return Tree(arms, list(home.values()))

    def _narrowed(self, ranges: Mapping[str, tuple[float, float]]) -> "Tree":
        arms = [arm._narrowed({joint: ranges[joint] for joint in arm.joint_names}) for arm in self.arms]
        return Tree(arms, np.clip(self.home, *np.transpose([ranges[joint] for joint in self.joint_names])))

    def with_tool(self, T_tip_tool: Any, shape: Any = None, T_tip_shape: Any = None) -> "Tree":
        """Return a copy whose tips are moved by T_tip_tool.

        Args:
            T_tip_tool: Pose (4, 4) or pin.SE3 of the tool in the tip frame, one for all tips or a dict by tip.
            shape: Collision shape of the tool, likewise (see `Robot.with_tool`).
            T_tip_shape: Pose of the shape in the tip frame, likewise.

        Returns:
            A tree whose targets, fk and errors refer to the tools.

        Raises:
            FrameNotFound: A tip does not exist.
            InvalidTarget, InvalidOption: A pose or a shape is invalid.
        """
        given = [x if isinstance(x, Mapping) else dict.fromkeys(self.tips, x) for x in (T_tip_tool, shape, T_tip_shape)]
        for one in given:
            self.check_tips(one)
        tools = given[0]
        made = [arm.with_tool(*(one.get(arm.tip) for one in given)) if arm.tip in tools else arm for arm in self.arms]
        return Tree(made, self.home)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the arms, from which the tree is made again."""
        return Tree, (self.arms, self.home), {"_wide": self._wide}

    def __repr__(self) -> str:
        """Describe the tree in one line: name, tips and joints."""
        joints = f"{how_many(self.n, 'joint')}: {', '.join(self.joint_names)}"
        return f"Tree('{self.name}', {self.base} -> {' + '.join(self.tips)}, {joints})"

    def _route(self) -> str:
        return f"{self.base} → {', '.join(self.tips)}"


def require_one_tip(robot: Any, what: str) -> None:
    """Raise InvalidOption unless `robot` is a Robot, for calls that work for a single tip.

    what: the call or option, with which the message begins. For a Tree the message says how to choose one tip.
    """
    if isinstance(robot, Tree):
        raise InvalidOption(
            f"{what} needs one tip, and this tree has {', '.join(robot.tips)}; choose one: ik.Robot.load(source, tip="
            f"'{robot.tips[0]}'), or --tip in a shell"
        )
    if not isinstance(robot, Robot):
        raise InvalidOption(f"{what} takes a Robot (see Robot.load), not {type(robot).__name__}")
