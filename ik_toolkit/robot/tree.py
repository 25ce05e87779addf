"""A robot with several tips: arms of one model that share joints, solved for together."""

import functools
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from ..errors import FrameNotFound, InvalidTarget, ModelError, near_match
from ..kernel.records import POINTS
from ..kernel.tree_chain import TreeChain, pack_tree
from .joints import Joints
from .library import find
from .pose import AxisTarget, check_target
from .probe import Path as JointPath
from .robot import Robot


def union(arms: Sequence[Robot]) -> tuple[str, ...]:
    """Names of the joints on any of the paths: the first arm's, base to tip, then what each next one adds."""
    return tuple(dict.fromkeys(joint for arm in arms for joint in arm.joint_names))


class Tree(Joints):
    """Several tips of one model: `Robot.load(name, tip=["left_tip", "right_tip"])`, or `Tree([left, right])` from robots.

    q (n,) holds every joint of the paths once: those of the first tip's path, base to tip, then what the next tip's path
    adds, and so on. Attributes: arms (Robot per tip); tips, base (frame names); name, model, joint_names, joint_kinds, lower,
    upper, home, velocity_limits, rest as in Robot; chain (kernel arrays). The arms share model, base and resting joints
    (else ModelError); each may have a tool of its own.
    """

    def __init__(self, arms: Sequence[Robot], home: Sequence[float] | np.ndarray | None = None) -> None:
        """Join robots that differ in their tip only. home (n,): default the arms' own. Raises ModelError, FrameNotFound."""
        if isinstance(arms, Robot) or not all(isinstance(arm, Robot) for arm in arms) or not len(arms):
            raise ModelError("a tree is made from a list of robots, one per tip")
        first = arms[0]
        self.arms = tuple(arms)
        self.tips = tuple(arm.tip for arm in arms)
        if len(set(self.tips)) < len(self.tips):
            raise FrameNotFound(f"each tip can be given once only: {', '.join(self.tips)}")
        for arm in arms[1:]:
            same = arm.model is first.model or arm.model == first.model
            if not same or arm.base != first.base or not np.array_equal(arm.rest, first.rest):
                raise ModelError(
                    f"'{arm.tip}' and '{first.tip}' must be tips of one model with the same base and the same resting joints"
                )
        self.name, self.model, self.base, self.rest = first.name, first.model, first.base, first.rest
        self.joint_names = names = union(arms)
        self._places = [np.array([names.index(joint) for joint in arm.joint_names]) for arm in arms]
        lower, upper = np.full(self.n, -np.inf), np.full(self.n, np.inf)
        self.velocity_limits, middle = np.empty(self.n), np.empty(self.n)
        idx_q, circle = np.empty(self.n, dtype=int), np.empty(self.n, dtype=bool)
        kinds = {}
        for arm, place in zip(reversed(arms), reversed(self._places), strict=True):  # the first tip's values stay
            lower[place] = np.maximum(lower[place], arm.lower)
            upper[place] = np.minimum(upper[place], arm.upper)
            self.velocity_limits[place], middle[place] = arm.velocity_limits, arm.home
            idx_q[place], circle[place] = arm._path.idx_q, arm._path.circle
            kinds.update(zip(arm.joint_names, arm.joint_kinds, strict=True))
        for joint, low, high in zip(names, lower, upper, strict=True):
            if not low <= high:
                raise ModelError(f"joint '{joint}' has no legal position: what the tips' paths allow does not overlap")
        self.joint_kinds = tuple(kinds[joint] for joint in names)
        self.lower, self.upper = lower, upper
        self._path = JointPath([], 0, [], {}, idx_q, circle)
        self.home = self.check_home(np.clip(middle, lower, upper) if home is None else home)
        self.chain: TreeChain = pack_tree([arm.chain for arm in arms], self._places, lower, upper, self.home)
        for array in (lower, upper, self.home, self.velocity_limits):
            array.setflags(write=False)

    @functools.cached_property
    def _sampling(self) -> tuple[np.ndarray, np.ndarray]:
        n, ends, v = self.n, self.chain.ends[0], POINTS
        return ends[v + 4 * n : v + 5 * n] * self.chain.unit, ends[v + 5 * n : v + 6 * n] * self.chain.unit

    def fk(self, q: Any) -> dict[str, pin.SE3]:
        """T_base_tip of every tip by name [m], computed by Pinocchio."""
        q = self.check_q(q)
        return {arm.tip: arm._fk(q[place]) for arm, place in zip(self.arms, self._places, strict=True)}

    def jacobian(self, q: Any) -> np.ndarray:
        """Stacked Jacobian (6 F, n): six rows a tip in the order of `tips`, base axes, linear rows first, by Pinocchio."""
        q = self.check_q(q)
        J = np.zeros((6 * len(self.arms), self.n))
        for f, (arm, place) in enumerate(zip(self.arms, self._places, strict=True)):
            J[6 * f : 6 * f + 6, place] = arm.jacobian(q[place])
        return J

    def check_targets(self, targets: Any) -> tuple[list[np.ndarray], str]:
        """Validate one target a tip: a dict by tip, or a sequence in the order of `tips`; each (4, 4) or (3,), and a notice.

        Raises FrameNotFound (unknown tip), InvalidTarget (missing tip, wrong number, not a pose; names the tip).
        """
        expected = f"robot '{self.name}' takes one target for each of {', '.join(self.tips)}"
        if isinstance(targets, Mapping):
            for tip in targets:
                if tip not in self.tips:
                    raise FrameNotFound(f"'{tip}' is not one of the tips solved for.{near_match(tip, self.tips)}")
            missing = [tip for tip in self.tips if tip not in targets]
            if missing:
                raise InvalidTarget(f"{expected}; missing: {', '.join(missing)}")
            given = [targets[tip] for tip in self.tips]
        else:
            if not isinstance(targets, list | tuple | np.ndarray) or getattr(targets, "shape", ()) in ((4, 4), (3,)):
                raise InvalidTarget(f"{expected} (a dict, or a list in this order), not a single one")
            given = list(targets)
            if len(given) != len(self.tips):
                raise InvalidTarget(f"{expected}; got {len(given)}")
        checked, notices = [], []
        for tip, target in zip(self.tips, given, strict=True):
            if isinstance(target, AxisTarget):
                raise InvalidTarget(f"{tip}: an axis target is for one tip; give a pose or a position")
            try:
                T, notice = check_target(target)
            except InvalidTarget as error:
                raise InvalidTarget(f"{tip}: {error}") from None
            checked.append(T)
            if notice:
                notices.append(f"{tip}: {notice}")
        return checked, "; ".join(notices)

    def errors(self, q: np.ndarray, targets: Sequence[np.ndarray]) -> list[tuple[float, float | None]]:
        """Position error [m] and rotation angle [rad] (None for a (3,) target) of each tip, by Pinocchio."""
        return [arm.errors(q[place], T) for arm, place, T in zip(self.arms, self._places, targets, strict=True)]

    def locked(self, joints: Mapping[str, float]) -> "Tree":
        """Return a copy with joints held at values [rad or m] and left out of q. Raises JointNotFound."""
        arms = [arm.locked(joints) for arm in self.arms]
        home = {joint: x for joint, x in zip(self.joint_names, self.home, strict=True) if joint not in joints}
        return Tree(arms, list(home.values()))

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the arms."""
        return Tree, (self.arms, self.home)

    def __repr__(self) -> str:
        """One line: name, tips and joints."""
        return f"Tree('{self.name}', {self.base} -> {' + '.join(self.tips)}, {self.n} joints: {', '.join(self.joint_names)})"

    def _route(self) -> str:
        return f"{self.base} &rarr; {', '.join(self.tips)}"


def load_tree(
    source: Any,
    tips: Sequence[str],
    base: str | None,
    package_dirs: Iterable[str | Path],
    locked: Mapping[str, float] | None,
) -> Tree:
    """Tree over `tips` of a robot that is read once; see Robot.load. A shipped robot's home is used joint by joint."""
    if not len(tips):
        raise FrameNotFound("tip=[] names no tip; give at least one")
    first = Robot.load(source, tip=tips[0], base=base, package_dirs=package_dirs, locked=locked)

    def arm(tip: str) -> Robot:
        return Robot(
            first.model,
            tip=tip,
            base=first.base,
            name=first.name,
            locked=locked,
            urdf=first.urdf,
            path=first.path,
            package_dirs=first.package_dirs,
        )

    tree = Tree([first, *(arm(tip) for tip in tips[1:])])
    found = find(source)
    if found.home is None or base is not None or locked:
        return tree
    known = dict(zip(union([arm(tip) for tip in found.tips]), found.home, strict=True))
    home = {**dict(zip(tree.joint_names, tree.home.tolist(), strict=True)), **known}
    return Tree(tree.arms, [home[joint] for joint in tree.joint_names])
