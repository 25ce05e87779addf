"""Tests a robot for collisions with itself and with shapes around it or in its hand, by Pinocchio and coal.

A broad phase compares bounding boxes first (a tree of them, in C++); shapes are tested exactly only where boxes
overlap.
"""

import threading
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
import pinocchio as pin

from ...errors import InvalidOption, ModelError, floats, near_match
from ...text import how_many
from ..robot import Robot
from ..tree import Tree
from .convex import is_flat, owner_above, read_shapes, request
from .distance import Clearance, Near
from .link_shapes import placed
from .surroundings import PlacedShape, Surroundings

SAMPLES = 8  # Links that keep their relative pose at this many random configurations count as fixed to each other.
# Two parts count as fixed to each other if no entry of their relative pose (4, 4) [m] varies by more than this.
STILL = 1e-9


class CollisionModel(Surroundings):
    """Tests a robot for collisions of its links and tools, shapes around it, and shapes that it holds.

    Links joined by one joint, links that cannot move relative to each other, and pairs that the robot's SRDF allows to touch are
    never tested. Neither are pairs that touch both at home and at zero (if zero is within the limits), which are listed in
    `excluded`. Shapes may be added, moved and removed between calls; code that uses the model respects them from its next
    call on, and a tracker from its next step.

    Args:
        robot: The Robot or Tree whose links are tested, also those of different arms. Their collision shapes are read
            from its URDF; meshes are read only from the URDF's folder, its ROS package and package_dirs.
        geometry: Shapes to use in place of those of the URDF.
        ignore: Pairs of names of links that may touch.
        margin: Distance [m] below which two parts count as touching. Links that are nearer than this at home keep half
            of their distance there.

    Attributes:
        links, obstacles, attached: Names of the parts.
        pairs: Pairs of names that are tested.
        excluded: Pairs of links that are left out because they touch at home and at zero.
        allowed: Pairs of links that the SRDF allows to touch, with its reason.
        margin: The margin [m].

    Raises:
        ModelError: There are no collision shapes or over 300, one has no extent, or a mesh cannot be read.
        InvalidOption: An argument is of the wrong kind, or `ignore` names a link without collision shapes.
    """

    _INSTEAD: ClassVar[Mapping[str, str]] = {
        "margin": "make a CollisionModel with margin=",
        "ignore": "make a CollisionModel with ignore=",
        "obstacles": "use add, move and remove",
        "attached": "use attach and detach",
        "": "make a new CollisionModel",
    }

    def __init__(
        self,
        robot: Robot | Tree,
        *,
        geometry: pin.GeometryModel | None = None,
        ignore: Iterable[Sequence[str]] = (),
        margin: float = 0.0,
    ) -> None:
        """Read the collision shapes and choose the pairs to test."""
        if not isinstance(robot, Robot | Tree):
            raise InvalidOption(f"a CollisionModel needs a Robot or a Tree, not a {type(robot).__name__}")
        self.robot = robot
        try:
            self.ignore = [tuple(pair) for pair in ignore]
        except TypeError:
            raise InvalidOption(f"ignore takes pairs of links with collision shapes, not {ignore!r:.60}") from None
        if not isinstance(geometry, pin.GeometryModel | None):
            raise InvalidOption(f"geometry must be a pin.GeometryModel, not {type(geometry).__name__}")
        self.margin = as_margin(margin)
        self._given = None if geometry is None else geometry.clone()
        self._own = read_shapes(robot) if geometry is None else placed(geometry, robot)
        self._own.removeAllCollisionPairs()
        self._links = [robot.model.frames[o.parentFrame].name for o in self._own.geometryObjects]
        self._tools = len(self._links)
        self._add_tools()
        if not self._links:
            raise ModelError(
                f"robot '{robot.name}' has no collision shapes (<collision> elements): there is nothing to test; "
                "add them to the URDF, or pass geometry="
            )
        self.links = tuple(dict.fromkeys(self._links))
        for pair in self.ignore:
            unknown = [name for name in pair if name not in self.links]
            if len(pair) != 2 or unknown:
                close = near_match(next(iter(unknown or pair), ""), self.links)
                raise InvalidOption(f"ignore takes pairs of links with collision shapes, not {pair}.{close}")
        super().__init__()
        self._closer: dict[tuple[int, int], float] = {}
        self.excluded: tuple[tuple[str, str], ...] = ()
        self._pair_links()
        self._seal()

    # ------------------------------------------------------------------------------------------------ what is tested
    def _add_tools(self) -> None:
        """Attach the arms' tools to their tips."""
        model = self.robot.model
        for arm in self.robot.arms:
            frame = model.frames[arm._ids[1]]
            for k, (shape, T) in enumerate(arm.tool_shapes):
                name = f"tool at {arm.tip}" + f" {k + 1}" * (k > 0)
                place = frame.placement * T
                self._own.addGeometryObject(
                    pin.GeometryObject(name, frame.parentJoint, arm._ids[1], place, shape.form())
                )
                self._links.append(name)

    def _pair_links(self) -> None:
        robot, model = self.robot, self.robot.model
        owners = [o.parentJoint for o in self._own.geometryObjects]
        hands = [model.frames[arm._ids[1]].parentJoint for arm in robot.arms]
        base = model.frames[robot.arms[0]._ids[0]].parentJoint
        placements = self._sample([base, *owners, *hands])
        joints = list(placements)
        # The entry apart[a, b] tells whether the parts moved by joints a and b can move relative to each other.
        apart = np.zeros((len(joints), len(joints)), dtype=bool)
        for b, jb in enumerate(joints):
            for a, ja in enumerate(joints[:b]):
                between = np.linalg.inv(placements[ja]) @ placements[jb]
                apart[a, b] = apart[b, a] = np.ptp(between, axis=0).max() > STILL
        of_shape = np.array([joints.index(j) for j in owners])
        carriers = set(owners[: self._tools])
        above = [owner_above(model, j, carriers) for j in joints]
        joined = np.array(
            [[above[a] == jb or above[b] == ja for b, jb in enumerate(joints)] for a, ja in enumerate(joints)]
        )
        links = np.arange(len(owners)) < self._tools
        self._tested = np.triu(apart[of_shape[:, None], of_shape], 1)
        self._tested &= ~(joined[of_shape[:, None], of_shape] & links & links[:, None])
        self._moving = apart[joints.index(base)][of_shape]
        self._in_hand = [apart[joints.index(hand)][of_shape] for hand in hands]
        self._hand_moves = [bool(apart[joints.index(base), joints.index(hand)]) for hand in hands]
        self._between_hands = [[bool(apart[joints.index(a), joints.index(b)]) for b in hands] for a in hands]
        places = {name: [k for k, other in enumerate(self._links) if other == name] for name in self.links}

        def leave_out(pairs: Iterable[tuple[str, ...]]) -> None:
            for first, second in pairs:
                self._tested[np.ix_(places[first], places[second])] = False
                self._tested[np.ix_(places[second], places[first])] = False
            self._rebuild()

        self.allowed = robot.srdf.may_touch(self.links)
        margin, self.margin = self.margin, 0.0
        leave_out([*self.ignore, *self.allowed])
        zero = np.zeros(robot.n)
        touching = dict.fromkeys(self.collisions(robot.home))
        # Only pairs that touch both at home and at zero are excluded. Contact at one of the two may be real, as of a folded arm.
        if not robot.outside(zero):
            touching = {pair: None for pair in self.collisions(zero) if pair in touching}
        self.excluded = tuple(touching)
        leave_out(self.excluded)
        if margin > 0.0:
            near = Clearance(self).near(robot.home, margin)
            self._closer = {pair: max(0.5 * found.distance, 0.0) for pair, found in near}
            self.margin = margin
            self._rebuild()

    def _sample(self, owners: list[int]) -> dict[int, np.ndarray]:
        """Return the placements (SAMPLES, 4, 4) of the joints that carry shapes, all at the same random configurations."""
        robot, data = self.robot, self.robot.model.createData()
        rng = np.random.default_rng(0)
        found: dict[int, list] = {j: [] for j in owners}
        for _ in range(SAMPLES):
            pin.forwardKinematics(robot.model, data, robot._filled(robot.random_q(rng)))
            for j, list_j in found.items():
                list_j.append(data.oMi[j].homogeneous)
        return {j: np.array(list_j) for j, list_j in found.items()}

    def _rebuild(self) -> None:
        """Rebuild geometry, pairs and margins after a change of shapes; existing `workspace` data keep the old ones."""
        geometry, own = self._own.copy(), len(self._links)
        tested = np.zeros((own + len(self._placed), own + len(self._placed)), dtype=bool)
        tested[:own, :own] = self._tested
        placed = list(self._placed.items())
        for k, (name, one) in enumerate(placed, own):
            geometry.addGeometryObject(self._object(name, one))
            moves = self._moving if one.arm is None else self._in_hand[one.arm]
            tested[:own, k] = moves & np.array([link not in one.touch for link in self._links])
            for i, (other, two) in enumerate(placed[: k - own], own):
                tested[i, k] = self._meet(one, two) and other not in one.touch and name not in two.touch
        geometry.setCollisionPairs(tested)
        pairs = [(pair.first, pair.second) for pair in geometry.collisionPairs]
        margins = np.array([self._closer.get(pair, self.margin) for pair in pairs])
        margins.setflags(write=False)  # `margins` returns this array to users, who must not change it.
        self._names = [*self._links, *self._placed]
        self._state = geometry, margins
        self._local = threading.local()
        self._put(version=self.version + 1)

    def _moved(self, name: str) -> None:
        shape = self.geometry.geometryObjects[self._names.index(name)]
        shape.placement = self._object(name, self._placed[name]).placement
        self._put(version=self.version + 1)

    def _meet(self, one: PlacedShape, two: PlacedShape) -> bool:
        """Return whether two added shapes can move relative to each other."""
        if one.arm is None or two.arm is None:
            arm = two.arm if one.arm is None else one.arm
            return arm is not None and self._hand_moves[arm]
        return self._between_hands[one.arm][two.arm]

    @property
    def geometry(self) -> pin.GeometryModel:
        """The pin.GeometryModel with all shapes and the pairs to test; it is replaced whenever a shape is added or removed."""
        return self._state[0]

    @property
    def margins(self) -> np.ndarray:
        """For each of the P pairs of shapes in `geometry` the distance [m] below which it counts as touching (read-only)."""
        return self._state[1]

    @property
    def pairs(self) -> tuple[tuple[str, str], ...]:
        """Pairs of names (links, obstacles and attached shapes) that are tested."""
        named = ((self._names[p.first], self._names[p.second]) for p in self.geometry.collisionPairs)
        return tuple(dict.fromkeys(named))

    # ------------------------------------------------------------------------------------------------ questions
    def _workspace(self) -> tuple[Any, Any, Any, pin.GeometryModel]:
        """Return Pinocchio's data for tests (model data, geometry data, box tree or None), one set per thread, and the geometry."""
        local = self._local
        if not hasattr(local, "space"):
            geometry = self.geometry
            local.space = (*self.workspace(0.0), geometry)
        return local.space

    def workspace(self, more: float | np.ndarray) -> tuple[Any, Any, Any]:
        """Make working memory for collision tests in which a pair nearer than its margin plus `more` [m] counts as touching.

        `more` is a number or (P,), one for each pair. The result is a pin.Data, a pin.GeometryData and a tree of bounding boxes,
        which is None if a shape has no volume.
        """
        geometry, margins = self._state
        data, found = self.robot.model.createData(), geometry.createData()
        # Pinocchio's default requests start from the result of the last call. These do not, so results depend on no earlier call.
        for k, margin in enumerate((margins + more).tolist()):
            found.collisionRequests[k] = request(margin)
        boxes = pin.BroadPhaseManager_DynamicAABBTreeCollisionManager(self.robot.model, geometry, found)
        # Pinocchio leaves shapes whose box has no volume (flat meshes) out of the tree, so every pair is tested then.
        return data, found, None if any(is_flat(o.geometry) for o in geometry.geometryObjects) else boxes

    def collides(self, q: Any) -> bool:
        """Return whether anything touches, which means is nearer than its margin, at q (n,) [rad or m]."""
        if not len(self.geometry.collisionPairs):
            return False
        full = self._full(q)
        data, found, boxes, geometry = self._workspace()
        if boxes is None:
            return bool(pin.computeCollisions(self.robot.model, data, geometry, found, full, True))
        return bool(pin.computeCollisions(self.robot.model, data, boxes, full, True))

    def collisions(self, q: Any) -> list[tuple[str, str]]:
        """Return every pair of names that touches, which means is nearer than its margin, at q (n,) [rad or m]."""
        full = self._full(q)
        data, found, _, geometry = self._workspace()
        pin.computeCollisions(self.robot.model, data, geometry, found, full, False)
        hits = [
            pair for pair, hit in zip(geometry.collisionPairs, found.collisionResults, strict=True) if hit.isCollision()
        ]
        return list(
            dict.fromkeys((self._name(geometry, pair.first), self._name(geometry, pair.second)) for pair in hits)
        )

    def distances(self, q: Any, within: float = np.inf) -> list[Near]:
        """Measure the pairs of parts that are near each other, nearest first.

        A distance is between the convex hulls of meshes, which is exact for all other shapes. If two hulls are nearer than the
        margin, at q or at home, the distance is between the meshes themselves. So a distance is never more than that of the exact
        shapes, and it is 0 or less where they touch.

        Args:
            q: Configuration (n,) [rad or m].
            within: Largest distance [m] of a pair that is returned.

        Returns:
            A Near for each pair: names, distance [m], nearest points [m] and normal.

        Raises:
            InvalidConfiguration: q does not fit the robot.
            InvalidOption: `within` is negative or no number.
        """
        if not (isinstance(within, float) and within == np.inf):
            within = as_margin(within, "within must be a distance [m]")
        return [found for _, found in self._measure().near(self.robot.check_q(q), within)]

    def distance(self, q: Any) -> Near | None:
        """Measure the nearest pair at q (n,) [rad or m] as `distances` does; return None if no pair is tested."""
        return self._measure().nearest(self.robot.check_q(q))

    def _measure(self) -> Clearance:
        """Return the object that measures distances, of which each thread has its own."""
        local = self._local
        if getattr(local, "version", None) != self.version:
            local.clearance, local.version = Clearance(self), self.version
        return local.clearance

    def _name(self, geometry: pin.GeometryModel, k: int) -> str:
        return self._links[k] if k < len(self._links) else geometry.geometryObjects[k].name

    def _full(self, q: Any) -> np.ndarray:
        return self.robot._filled(self.robot.check_q(q))

    def __getstate__(self) -> dict[str, Any]:
        """Keep the constructor's arguments; shapes of the URDF are read again, a given geometry is pickled whole."""
        placed = {name: replace(one, form=None) for name, one in self._placed.items()}
        asked = {"robot": self.robot, "geometry": self._given, "ignore": self.ignore, "margin": self.margin}
        return {"asked": asked, "placed": placed}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Make the model again from the stored arguments."""
        asked = dict(state["asked"])
        self.__init__(asked.pop("robot"), **asked)
        self._placed = {name: replace(one, form=one.shape.form()) for name, one in state["placed"].items()}
        self._rebuild()

    def __repr__(self) -> str:
        """Describe the model in one line."""
        around = f", around it: {', '.join(self.obstacles)}" if self.obstacles else ""
        held = f", attached: {', '.join(self.attached)}" if self.attached else ""
        kept = f", margin {self.margin:g} m" if self.margin else ""
        counts = f"{how_many(len(self.pairs), 'pair')} tested, {len(self.excluded)} excluded"
        return f"CollisionModel('{self.robot.name}', {counts}{kept}{around}{held})"


def as_margin(value: Any, what: str = "margin must be a distance of at least 0 [m]") -> float:
    """Return a margin [m] as a float. Raises InvalidOption, with a message that begins with `what`, if it is not a number >= 0."""
    number = floats(value, what, InvalidOption)
    if number.shape != () or not 0.0 <= number < np.inf:
        raise InvalidOption(f"{what}, not {value!r:.60}")
    return float(number)
