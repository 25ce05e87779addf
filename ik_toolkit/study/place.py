"""Search for base poses from which a robot reaches as many of given poses as possible.

First an inverse reachability map proposes bases (Vahrenkamp, Asfour, Dillmann 2013). Sampled tip poses are sorted by what a motion
of the base on the floor does not change (height of the tip, direction of the vertical in its frame), and each of the given poses
votes for the bases from which it is reached. Bases spread over the floor are added, the best are refined, and the poses that the
last candidates reach are counted.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Unpack

import numpy as np

from ..errors import Interrupted, InvalidOption, InvalidTarget, check_progress, floats, whole
from ..robot.geometry.collision import CollisionModel
from ..robot.robot import Robot
from ..robot.tree import Tree
from ..solvers.batch.targets import known, with_free_turns
from ..solvers.collision_free import collision_model
from ..solvers.options import BatchOptions, PathOptions, avoided
from ..solvers.solve import require_robot
from ..text import Tabled, TextTable, angle, figure, how_many, length, plain
from ..validate import number, switch
from . import place_search
from .place_search import Candidates, base_poses, in_base, put_together
from .reachability import quality

# attributes of each Placement that `Placements.to_dict` returns as numbers
NUMBERS = ("x", "y", "height", "yaw", "count", "clearance", "margin", "manipulability")


@dataclass(frozen=True, eq=False, repr=False)
class Placement:
    """A pose of the robot's base, and what the robot reaches from there.

    Attributes:
        T_world_base: Pose (4, 4) [m] of the base, in the frame of the poses.
        x, y, height, yaw: The same pose as numbers [m, rad].
        tips: Name of the tip of each pose (N,), one tip after another.
        reached: Which poses are reached (N,), and `count`, how many.
        q: Configurations (N, n) [rad or m], NaN where a pose is not reached.
        clearance: Least distance [m] of any two parts (links, tools, obstacles), at a sample of the configurations; NaN without
            avoid_collisions.
        margin: Mean distance to the nearest limit over half the range, 0 to 1.
        manipulability: Mean manipulability.
        path: For ordered poses the PathResult through those that are reached, or None.
    """

    T_world_base: np.ndarray
    tips: np.ndarray
    reached: np.ndarray
    q: np.ndarray
    clearance: float
    margin: float
    manipulability: float
    path: Any = None

    x = property(lambda self: float(self.T_world_base[0, 3]))
    y = property(lambda self: float(self.T_world_base[1, 3]))
    height = property(lambda self: float(self.T_world_base[2, 3]))
    yaw = property(lambda self: float(np.arctan2(self.T_world_base[1, 0], self.T_world_base[0, 0])))
    count = property(lambda self: int(self.reached.sum()))

    def __repr__(self) -> str:
        """Describe the placement in one line: base, and how many poses are reached from it."""
        at = ", ".join(f"{name}={getattr(self, name):.3f}" for name in ("x", "y", "height"))
        return f"Placement({at} m, yaw={angle(self.yaw)}, reached {self.counts}, margin {figure(self.margin)})"

    @property
    def counts(self) -> str:
        """Number of poses reached, as text: '12 of 40', for several tips a number each with its name."""
        names = list(dict.fromkeys(self.tips.tolist()))
        each = [self.reached[self.tips == tip] for tip in names]
        said = [f"{one.sum()} of {len(one)}" for one in each]
        return (
            said[0] if len(said) == 1 else ", ".join(f"{tip} {words}" for tip, words in zip(names, said, strict=True))
        )

    @property
    def rank(self) -> tuple[float, ...]:
        """Sort key, the larger the better: poses reached, then fewer reconfigurations, clearance, margin, manipulability.

        Reconfigurations are jumps of the path through the poses; if there is no path, or it cannot be followed, they count as
        infinitely many.
        """
        clear = 0.0 if np.isnan(self.clearance) else self.clearance
        breaks = len(self.path.reconfigurations) if self.path is not None and self.path.success else np.inf
        return (self.count, -breaks, clear, self.margin, self.manipulability)


@dataclass(frozen=True, eq=False, repr=False)
class Placements(Tabled, Sequence[Placement]):
    """Base poses, best first; and all bases that were examined, for a picture of the floor.

    Attributes:
        robot: Name of the robot.
        poses: The poses (N, 4, 4), or positions (N, 3), asked for; for a Tree a dict of these by tip.
        found: The placements.
        candidates: Bases (M, 4) that were examined: x, y, yaw, height [m, rad].
        shares: Share of the poses that is reached from each (M,), estimated from some of the poses. If even the share without the
            obstacles is too small to be among the best, it is that share.
        obstacles: Corners (K, 8, 3) [m] of boxes around the obstacles.
    """

    robot: str
    poses: Any
    found: tuple[Placement, ...]
    candidates: np.ndarray
    shares: np.ndarray
    obstacles: np.ndarray

    def __len__(self) -> int:
        """Return the number of placements."""
        return len(self.found)

    def __getitem__(self, k: Any) -> Any:
        """Return placement k; 0 is the best."""
        return self.found[k]

    def table(self) -> TextTable:
        """Return a table with a row for each placement: base pose, poses reached, clearance, margin."""
        rows = []
        for k, one in enumerate(self.found):
            at = f"{one.x:.3f}, {one.y:.3f}, {one.height:.3f}"
            clear = None if np.isnan(one.clearance) else length(one.clearance)
            rows.append((k, at, angle(one.yaw), one.counts, clear, figure(one.margin)))
        head = ("", "base x, y, z [m]", "yaw", "reached", "clearance", "margin")
        return TextTable(
            self.robot, f"{how_many(len(rows), 'place')} to stand", head, rows, "ik.plot(placements) draws the floor."
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the placements as plain numbers, strings and lists, ready for JSON; a clearance that was not asked for is None."""
        rows = [{key: getattr(one, key) for key in NUMBERS} | {"reached": one.reached.tolist()} for one in self.found]
        tips = self.found[0].tips.tolist() if self.found else []
        return plain({"robot": self.robot, "poses": len(tips), "tips": tips, "placements": rows})


class PlaceInterrupted(Interrupted):
    """Ctrl-C during a search for base poses; `result` has the Placements of the best candidates so far."""


def place(
    robot: Robot | Tree,
    poses: Any,
    where: Any = "floor",
    *,
    yaw: Any = None,
    height: Any = 0.0,
    ordered: bool = False,
    count: int = 5,
    progress: Callable[[int], None] | None = None,
    **options: Unpack[BatchOptions],
) -> Placements:
    """Find base poses of a robot from which it reaches as many of the given poses as possible.

    Args:
        robot: The Robot whose base is placed; for a robot on a rail (`on_base="rail"`) the rail is placed, along whose x axis it
            moves. For a Tree, each tip reaches its own poses, one at a time, while the other tips are free.
        poses: Poses (N, 4, 4), positions (N, 3) [m], or a list of AxisTargets, in a frame whose z is up; for a Tree a dict of these
            by tip.
        where: 'floor', as far around the poses as the robot reaches, or a rectangle ((x, y), (x, y)) [m], lower corner first.
        yaw: Rotation of the base about z [rad]: None for any, a number, or (lower, upper).
        height: Height of the base [m], a number or (lower, upper).
        ordered: Whether the poses are a path. `solve_path` then follows it from the three best places, and of places that reach
            equally many poses, those with fewer reconfigurations come first.
        count: Number of placements to return; fewer if those that were examined are too near each other.
        progress: Called as progress(done) with the number of candidates examined.
        **options: As for `solve_batch`, but for closest, follow and restarts: tolerances, limits, free_turn, seed, ...; the shapes
            of a CollisionModel given as avoid_collisions are those of the scene, in the frame of the poses.

    Returns:
        The placements, sorted by poses reached, then clearance, margin to the limits and manipulability.

    Raises:
        InvalidOption, InvalidTarget: An argument is wrong, or the search would not fit into memory as the poses are too far apart.
        PlaceInterrupted: Ctrl-C; its `result` has the best so far, without paths (KeyboardInterrupt if there are none yet).
    """
    require_robot(robot)
    if robot.on_base is not None and not isinstance(robot.on_base, str):
        raise InvalidOption("place chooses the pose of the base; load the robot without a pose as on_base")
    if switch(ordered, "ordered") and len(robot.tips) > 1:
        raise InvalidOption("ordered poses are followed by one tip; choose one: ik.Robot.load(source, tip=)")
    check_progress(progress, "the number of candidates counted")
    count = whole(count, "count")
    poses, asked = with_free_turns(robot, poses, options)
    W = _poses(robot, poses)
    if asked.get("relative_to"):
        raise InvalidOption("place takes the poses of every tip in the world; omit relative_to")
    if "restarts" in asked:
        raise InvalidOption("place chooses the number of attempts; omit restarts")
    low, high = _region(robot, W, where, yaw, height)
    scene = _scene(robot, asked.pop("avoid_collisions", False))
    study = Candidates(
        robot, W, (low, high), scene, {**asked, "seed": whole(asked.get("seed", 0), "seed", 0)}, progress
    )
    try:
        study.run()
        return _result(study, count, ordered)
    except KeyboardInterrupt:
        if not study.tried:
            raise
        found = _result(study, count, False)
        raise PlaceInterrupted(found, f"after {len(found.candidates)} candidates") from None


def _poses(robot: Robot | Tree, given: Any) -> dict[str, np.ndarray]:
    """Return the poses (N, 4, 4) or positions (N, 3) of each tip that has any. Raises InvalidTarget, FrameNotFound."""
    made, each = {}, robot.each_tip(given)
    if not isinstance(each, Mapping):
        raise InvalidTarget(f"place needs the poses of several tips as a dict by tip: {', '.join(robot.tips)}")
    for tip in [tip for tip in robot.tips if each.get(tip) is not None]:
        W, of = known(each[tip], robot.base), f" of {tip}" if robot.named_tips else ""
        if not isinstance(W, np.ndarray) or W.shape[1:] not in ((4, 4), (3,)) or not len(W):
            raise InvalidTarget(f"place needs poses (N, 4, 4) or positions (N, 3){of}")
        W = floats(W, f"poses{of} must be numbers", InvalidTarget)
        if not np.isfinite(W).all():
            raise InvalidTarget(f"poses{of} must be finite numbers")
        made[tip] = W
    if not made:
        raise InvalidTarget(f"place needs poses of at least one of {', '.join(robot.tips)}")
    return made


def _region(robot: Any, W: dict[str, np.ndarray], where: Any, yaw: Any, height: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return the lower and upper bounds (4,) of x, y, yaw, height [m, rad] of the base."""
    at = np.concatenate([one if one.ndim == 2 else one[:, :3, 3] for one in W.values()])
    if isinstance(where, str):
        if where != "floor":
            raise InvalidOption(f"where must be 'floor' or two corners ((x, y), (x, y)) [m], not '{where:.60}'")
        xy = np.array([at[:, :2].min(axis=0) - robot.reach, at[:, :2].max(axis=0) + robot.reach])
    else:
        xy = floats(where, "where must be 'floor' or two corners ((x, y), (x, y)) [m]", InvalidOption)
        if xy.shape != (2, 2) or not np.isfinite(xy).all() or (xy[0] > xy[1]).any():
            raise InvalidOption(
                f"where must be 'floor' or two corners ((x, y), (x, y)) [m], lower first, not {where!r:.60}"
            )
    turns = (-np.pi, np.pi) if yaw is None else _ends(yaw, "yaw [rad]")
    if max(abs(x) for x in turns) > 2.0 * np.pi + 1e-9:
        raise InvalidOption(f"yaw [rad] must be within a turn, not {yaw!r:.60}; were degrees meant?")
    heights = _ends(height, "height [m]")
    ends = np.array([[*xy[0], turns[0], heights[0]], [*xy[1], turns[1], heights[1]]])
    return ends[0], ends[1]


def _ends(value: Any, what: str) -> tuple[float, float]:
    """Return a range (lower, upper) from such a pair or from a single number."""
    if not isinstance(value, list | tuple | np.ndarray):
        return number(value, what), number(value, what)
    pair = floats(value, f"{what} must be a number or (lower, upper)", InvalidOption)
    if pair.shape != (2,) or not np.isfinite(pair).all() or pair[0] > pair[1]:
        raise InvalidOption(f"{what} must be a number or (lower, upper), not {value!r:.60}")
    return float(pair[0]), float(pair[1])


def _scene(robot: Any, asked: Any) -> CollisionModel | None:
    """Return a copy of the collision model to be avoided, whose shapes can be moved; None without avoid_collisions."""
    if (found := avoided(asked)) is False:
        return None
    given = collision_model(robot, found)
    if given.attached:
        raise InvalidOption(
            "place keeps no shapes that the robot holds; give it a tool with shapes (`Robot.with_tool`)"
        )
    made = CollisionModel(given.robot, geometry=given._given, ignore=given.ignore, margin=given.margin)
    for name, shape, T in given.placed():
        made.add(shape, T, name)
    return made


def _result(study: Candidates, count: int, ordered: bool) -> Placements:
    """Return the placements at the best bases, which differ by more than a hundredth of the reach or a degree."""
    reach = study.robot.reach
    bases = study.apart(study.best(), np.array([0.01 * reach, 0.01 * reach, 0.0175, 0.01 * reach]), count + 3)
    measures = [
        (arm.tip, at, quality(arm, position_only=study.W[arm.tip].ndim == 2))
        for arm, at in zip(study.robot.arms, study.robot.places, strict=True)
        if arm.tip in study.W
    ]
    found = [_placement(study, base, measures) for base in bases]
    found = sorted(found, key=lambda one: one.rank, reverse=True)[:count]
    # Computing a path through the poses takes long, so only the first few placements get one, and are sorted again by fewer
    # reconfigurations.
    if ordered:
        few = place_search.SEARCH.followed
        found = [replace(one, path=_followed(study, one)) for one in found[:few]] + found[few:]
        found = sorted(found, key=lambda one: one.rank, reverse=True)
    bases, shares = put_together(study.tried)
    return Placements(study.robot.name, study.robot.for_tips(study.W), tuple(found), bases, shares, study.boxes)


def _placement(study: Candidates, base: np.ndarray, measures: list[Any]) -> Placement:
    """Return the Placement for one base (4,), from many solver attempts at every pose."""
    tips = np.repeat(list(study.W), [len(W) for W in study.W.values()])
    good, q = study.solve_beside(base, place_search.SEARCH.sure)
    q = np.where(good[:, None], q, np.nan)
    clear = np.nan
    if study.scene is not None and good.any():
        looked = q[good][:: max(1, int(good.sum()) // place_search.SEARCH.measured)]
        nearest = filter(None, map(study.scene.distance, looked))
        clear = min((near.distance for near in nearest), default=np.inf)
    each = [measure(q[good & (tips == tip)][:, at]) for tip, at, measure in measures]
    size, margin = np.concatenate(each, axis=1).mean(axis=1) if good.any() else (0.0, 0.0)
    return Placement(base_poses(base[None])[0], tips, good, q, float(clear), float(margin), float(size))


def _followed(study: Candidates, one: Placement) -> Any:
    """Return the path through the poses that a placement reaches, or None where there are fewer than two."""
    from ..paths.solve_path import solve_path  # imported when needed: most searches follow no path

    if one.count < 2:
        return None
    asked: Any = {key: study.options[key] for key in {*PathOptions.__annotations__, "seed"} & study.options.keys()}
    base = np.array([one.x, one.y, one.yaw, one.height])
    study.stand(base)
    ((tip, W),) = study.W.items()
    seen = study.robot.for_tips({tip: in_base(base[None], W)[0][one.reached]})
    return solve_path(study.robot, seen, avoid_collisions=False if study.scene is None else study.scene, **asked)
