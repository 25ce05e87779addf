"""State of one panel visitor: a robot with one or several tips, q, targets and solver; nothing is drawn or served here."""

import contextlib
import itertools
import json
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ...errors import FrameNotFound, InvalidConfiguration, InvalidTarget, ModelError
from ...kernel.counted_error import KIND
from ...robot.geometry.collision import CollisionModel
from ...robot.geometry.distance import Near
from ...robot.library import find
from ...robot.pose import check_target, pose
from ...robot.probe import screw
from ...robot.robot import Robot
from ...robot.rotation import matrix_quat, matrix_rpy
from ...robot.tips import path_ends
from ...robot.tree import Tree
from ...solvers.registry import find_row, list_rows, make_rule
from ...solvers.result import Result
from ...solvers.solve import solve, solve_all
from ...text import angle, duration, how_many, length, parameter, plain, vector
from .drag_follower import Followed, Hand, prepare

# the forms in which the orientation of a target can be typed
KINDS = ("roll pitch yaw", "quaternion", "matrix", "free")
NONE = "no target"  # entry in the list of target forms for a tip (one of several) that shall have no target
SHOWN = 16  # largest number of solutions that the panel lists
# The rank of a tip's Jacobian is taken as the largest at SAMPLES random configurations, which are hardly ever all singular.
SAMPLES = 8
PATIENCE = 20  # [s of robot time] how long an arm may go on moving towards a target after a drag or a failed solve


class Session:
    """The state of one visitor: robot, q (n,) [rad or m], target, and the result and solutions of the last solve.

    `robot` is a Robot or a Tree, `tips` are all available ones, `ranks` the number of directions in which each tip can
    move (2 for a planar arm). A target is (4, 4) or (3,) [m], for a Tree a dict of these by tip, or None. `parameters`
    maps names to text as typed, '' for the default; `degrees` is the unit of typed and shown angles.
    """

    def __init__(self, source: str, tips: str | Sequence[str] | None = None) -> None:
        """Start with a robot given by name or path, and one or several tips. Raises RobotNotFound, ModelError, FrameNotFound."""
        self.degrees = True
        self.solver = "auto"
        self.parameters: dict[str, str] = {}
        self.tolerance = 1e-6
        self.limits, self.avoid = True, False  # whether joint limits are kept, and whether collisions are avoided
        # the obstacle boxes by name: size [m], and pose (4, 4) in the base frame
        self.boxes: dict[str, tuple[list[float], np.ndarray]] = {}
        self.source = ""
        self.random = np.random.default_rng(0)
        self.warm: set[tuple] = set()  # solvers and kinds of target whose code is already compiled
        self.load(source, tips)

    def load(self, source: str, tips: str | Sequence[str] | None = None) -> None:
        """Switch to another robot; nothing changes if that fails. The tips are by default all known ones or the first."""
        source = source.strip()
        entry = find(source)
        chosen = [tips] if isinstance(tips, str) else list(tips or entry.tips)
        robot: Robot | Tree
        if len(chosen) > 1:
            robot = Tree.load(source, tips=chosen)
        else:
            try:
                robot = Robot.load(source, tip=chosen[0] if chosen else None)
            except FrameNotFound as several:
                if chosen or not several.tips:
                    raise
                robot = Robot.load(source, tip=several.tips[0])
        if source != self.source:
            self.boxes = {}
        self.source, self.entry, self.robot = source, entry, robot
        self._world: CollisionModel | None = None
        self._hand: Hand | None = None
        self.tips = tuple(entry.tips) if len(entry.tips) > 1 else path_ends(robot.model)
        self.q = robot.home.copy()
        samples = robot.random_q(np.random.default_rng(0), SAMPLES)
        ranks = [[np.linalg.matrix_rank(J) for J in self._rates(q)] for q in samples]
        self.ranks = np.max(ranks, axis=0).tolist()
        self.target: Any = None
        self.result: Result | None = None
        self.followed: Followed | None = None
        self.solutions: list[np.ndarray] = []
        self.distances: list[float] = []
        self.branches: np.ndarray | None = None
        # configurations (n,) that the visitor has recorded so far, to be saved as a motion
        self.recorded: list[np.ndarray] = []

    # ------------------------------------------------------------------------------------------------------- joints
    def scale(self, i: int) -> float:
        """Return the factor from the value of joint i [rad or m] to the displayed unit."""
        return math.degrees(1.0) if self.degrees and self.robot.joint_kinds[i] != "prismatic" else 1.0

    def unit(self, i: int) -> str:
        """Return the unit in which joint i is displayed: 'deg', 'rad' or 'm'."""
        return "m" if self.robot.joint_kinds[i] == "prismatic" else "deg" if self.degrees else "rad"

    def digits(self, i: int) -> int:
        """Return the number of decimals with which joint i is displayed: 2 for degrees (0.01 deg), 4 for m and rad."""
        return 2 if self.unit(i) == "deg" else 4

    @property
    def kind(self) -> str:
        """How targets are typed at first: as poses for arms of six or more joints, otherwise as positions."""
        return KINDS[0] if min(arm.n for arm in self.robot.arms) >= 6 else "free"

    def range(self, i: int) -> tuple[float, float]:
        """Return the slider range of joint i in displayed units, rounded inwards if there is room."""
        low, high = (self.scale(i) * x for x in self.ends(i))
        unit = 10.0 ** -self.digits(i)
        inner = (unit * math.ceil(low / unit - 1e-6), unit * math.floor(high / unit + 1e-6))
        low, high = inner if inner[1] - inner[0] > 100.0 * unit else (low, high)
        return round(low, 9), round(high, 9)

    def ends(self, i: int) -> tuple[float, float]:
        """Return the range of joint i's slider [rad or m]: its limits, or without limits a turn (prismatic: a reach either way)."""
        span = math.pi if self.robot.joint_kinds[i] != "prismatic" else self.robot.reach
        low, high = float(self.robot.lower[i]), float(self.robot.upper[i])
        if not self.limits:
            low, high = min(low, -span), max(high, span)
        low = low if math.isfinite(low) else min(-span, float(self.q[i]))
        return low, (high if math.isfinite(high) else max(low + 2.0 * span, float(self.q[i])))

    def read_joints(
        self, fields: Sequence[float], shown: list[float], scale: Callable[[int], float], limits: bool
    ) -> np.ndarray:
        """Return q (n,) [rad or m] for numbers typed or set by sliders, which are in the displayed unit of each joint.

        A number that still equals the rounded one on display means that this joint was not changed, so it keeps its full
        precision. Raises InvalidConfiguration.
        """
        values = np.array(fields, dtype=float) / [scale(i) for i in range(self.robot.n)]
        q = np.where(np.array(fields) != shown, values, self.q)
        if not np.isfinite(q).all():
            raise InvalidConfiguration("a joint value is not a finite number")
        return np.clip(q, self.robot.lower, self.robot.upper) if limits else q

    def poses(self, q: np.ndarray | None = None) -> dict[str, np.ndarray]:
        """Return T_base_tip (4, 4) of each tip at q (n,), by default the current q."""
        each = self.robot.each_tip(self.robot.fk(self.q if q is None else q))
        return {tip: T.homogeneous for tip, T in each.items()}

    def random_poses(self) -> dict[str, np.ndarray]:
        """Return random poses that the tips can reach together, new ones at every call."""
        return self.poses(self.robot.random_q(self.random))

    def goals(self) -> dict[str, np.ndarray]:
        """Return where each tip's target is drawn (4, 4): at the tip if it has none; a position gets the tip's rotation."""
        poses = self.poses()
        for tip, target in (self.robot.each_tip(self.target) or {}).items():
            if target is not None:
                poses[tip] = target if target.ndim == 2 else np.r_[np.c_[poses[tip][:3, :3], target], [[0, 0, 0, 1]]]
        return poses

    # ------------------------------------------------------------------------------------------------------- target
    def typed(self, xyz: str, kind: str, rotation: str) -> np.ndarray:
        """Make a target from typed numbers. Raises InvalidTarget, which names the field."""
        if kind == "matrix":
            values = vector(rotation.translate(str.maketrans("[],;", "    ")), "the matrix, row by row,")
            if len(values) not in (12, 16):
                raise InvalidTarget(f"the matrix, row by row, takes 12 or 16 numbers; got {len(values)}")
            return check_target(np.reshape([*values, 0.0, 0.0, 0.0, 1.0][:16], (4, 4)))[0]
        place = vector(xyz, "the position x y z [m]", 3)
        if kind == "free":
            return pose(place)
        if kind == "quaternion":
            return pose(place, quat_xyzw=vector(rotation, "the quaternion x y z w", 4))
        angles = vector(rotation, f"roll pitch yaw [{'deg' if self.degrees else 'rad'}]", 3)
        return pose(place, rpy=[math.radians(a) if self.degrees else a for a in angles])

    def words(self, T: np.ndarray, kind: str) -> tuple[str, str]:
        """Write position and rotation of a pose as texts for the fields that `typed` reads."""
        at = T if T.ndim == 1 else T[:3, 3]
        xyz = "  ".join(_figure(x) for x in at)
        if T.ndim == 1 or kind == "free":
            return xyz, ""
        if kind == "matrix":
            return xyz, "\n".join("  ".join(f"{x + 0.0:.6f}" for x in row) for row in np.round(T, 6))
        if kind == "quaternion":
            return xyz, "  ".join(_figure(x) for x in matrix_quat(T[:3, :3]))
        angles = matrix_rpy(T[:3, :3]) * (math.degrees(1.0) if self.degrees else 1.0)
        return xyz, "  ".join(_figure(x) for x in angles)

    # -------------------------------------------------------------------------------------------------------- solve
    def choices(self) -> list[str]:
        """Return the names of the solvers available for this robot."""
        from ...solvers.closed_form import fits

        closed = {fits(self.robot, kind) for kind in (KIND.position, KIND.pose)}
        rows = (row for row in list_rows() if not (len(self.robot.tips) > 1 and row.one_tip))
        return ["auto", *(row.name for row in rows if not row.closed or row.name in closed)]

    def fields(self) -> dict[str, Any]:
        """Return the parameters of the chosen solver with their defaults."""
        if self.solver == "auto":
            return {}
        cls = find_row(self.solver).load()
        return {name: cls._field_defaults.get(name) for name in cls._fields if name not in ("tuned", "starts")}

    def rule(self) -> Any:
        """Return the solver's name, or the solver with the typed parameters. Raises InvalidOption."""
        given = {name: text.strip() for name, text in self.parameters.items() if text.strip() and name in self.fields()}
        if not given:
            return self.solver
        return make_rule(find_row(self.solver), {name: parameter(name, text) for name, text in given.items()})

    def options(self) -> dict[str, Any]:
        """Return tolerance, limits and collision options for `ik.solve`."""
        avoided = self.world if self.avoid else False
        return {"tolerance": self.tolerance, "limits": self.limits, "avoid_collisions": avoided}

    def solve(self, target: Any) -> Result:
        """Solve from q with history and move to the result, or to the closest pose. Raises what `ik.solve` raises."""
        self.target, self.followed, rule = _copy(target), None, self.rule()
        how = self.solver, *(T.ndim for T in self.robot.each_tip(self.target).values())
        # A first call, which loads or compiles code, is repeated, so that the time shown is that of a solve.
        for _ in range(1 if how in self.warm else 2):
            result = solve(self.robot, self.target, rule, q0=self.q, history=True, **self.options())
        self.warm.add(how)
        if np.isfinite(result.q).all():
            self.q = result.q.copy()
        if not result.success:
            self._approach()
        self.result = result
        return result

    def _approach(self) -> None:
        """Continue from a failed attempt to the closest pose near it."""
        # A target that is too far away, or an arm that is in contact already, raises an error; then the arm stays where it is.
        with contextlib.suppress(InvalidTarget, InvalidConfiguration):
            # The arm must not change to another posture (reconfigure=False), because the solver has found none that reaches the
            # target.
            hand = Hand(self.robot, self.q, **self.options(), reconfigure=False)
            for _ in range(PATIENCE):
                if self._move(hand).settled:
                    return

    def follow(self, target: Any) -> Followed:
        """Move the arm towards a dragged target for up to a second of motion; return its state. Raises what `Tracker` raises."""
        if not len(target):
            raise InvalidTarget(f"give a target for at least one of {', '.join(self.robot.tips)}")
        self.target, self.result = _copy(target), None
        if self._hand is None or self._hand.options != self.options():
            self._hand = Hand(self.robot, self.q, **self.options())
        return self._move(self._hand)

    def _move(self, hand: Hand) -> Followed:
        self.followed = hand.follow(self.q, self.target)
        self.q = self.followed.q.copy()
        return self.followed

    def prepare(self) -> None:
        """Load or compile the code that `follow` runs, so that the first drag need not wait; the arm does not move."""
        prepare(self.robot, self.q, self.robot.for_tips(self.poses()))

    def solve_all(self, target: Any) -> tuple[str, str]:
        """Find all solutions for a target and keep up to 16 in the session; return two texts: their number, and details.

        Raises what `ik.solve_all` does.
        """
        self.target = _copy(target)
        found = solve_all(self.robot, self.target, self.rule(), self.q, starts=200, count=SHOWN, **self.options())
        self.solutions, self.distances = [q.copy() for q in found][:SHOWN], found.distance.tolist()[:SHOWN]
        self.branches = found.branches
        if not len(found):
            return f"no solution: {found.message}", ""
        more = f"; the nearest {SHOWN} of {len(found)} are listed" if len(found) > SHOWN else ""
        few = "infinitely many solutions" if found.families else how_many(len(found), "solution")
        return f"{few}{'; these are all' if found.complete else more}", found.message

    # --------------------------------------------------------------------------------------------------- surroundings
    @property
    def world(self) -> CollisionModel:
        """The CollisionModel of the robot's shapes and the obstacle boxes. Raises what CollisionModel raises."""
        if self._world is None:
            self._world = CollisionModel(self.robot)
            for name, (size, T) in self.boxes.items():
                self._world.add_box(size, T, name)
        return self._world

    def add_box(self, size: Sequence[float], T: np.ndarray) -> str:
        """Add a box of size (x, y, z) [m] at a pose (4, 4) in the base; return its name."""
        name = next(name for k in itertools.count(1) if (name := f"box {k}") not in self.boxes)
        self.world.add_box(size, T, name)
        self.boxes[name] = list(size), T
        self._hand = None
        return name

    def move_box(self, name: str, T: np.ndarray) -> None:
        """Move a box to a pose (4, 4) in the base frame."""
        self.world.move(name, T)
        self.boxes[name] = self.boxes[name][0], T
        self._hand = None

    def clear_boxes(self) -> None:
        """Remove all obstacle boxes that the user has added."""
        self.boxes, self._world, self._hand = {}, None, None

    def contacts(self) -> tuple[list[tuple[str, str]], Near | None]:
        """Return pairs that touch at the current q, and the nearest pair; none if the robot's shapes cannot be read."""
        try:
            return self.world.collisions(self.q), self.world.distance(self.q)
        except ModelError:
            return [], None

    def ellipsoids(self) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Return the velocity ellipsoid of each tip at joint speeds of norm 1: axes (3, 3) in the base and radii (3,) [m/s]."""
        missing = max(0, 3 - self.robot.n)
        svd = [np.linalg.svd(np.pad(J, ((0, 0), (0, missing))), full_matrices=False) for J in self._rates(self.q)]
        return {tip: (U, sizes) for tip, (U, sizes, _) in zip(self.robot.tips, svd, strict=True)}

    def manipulability(self) -> dict[str, float]:
        """Return for each tip the product of the ellipsoid's radii, without radii that are 0 at every q (as for a planar arm)."""
        radii = (radii for _, radii in self.ellipsoids().values())
        return {tip: float(np.prod(r[:rank])) for tip, r, rank in zip(self.robot.tips, radii, self.ranks, strict=True)}

    def _rates(self, q: np.ndarray) -> np.ndarray:
        """Return the linear rows (tips, 3, n) of the Jacobian at q (n,)."""
        return self.robot.jacobian(q).reshape(-1, 6, self.robot.n)[:, :3]

    # ------------------------------------------------------------------------------------------------------- display
    def figures(self) -> list[tuple[str, str]]:
        """Return a table of texts (name, value) about the last solve or, while a target is dragged, about the errors left."""
        r, followed = self.result, self.followed
        if r is None:
            return self._tip_errors(followed.errors) if followed is not None else []
        errors = [("position error", length(r.position_error)), ("orientation error", _angle(r.orientation_error))]
        if len(self.robot.tips) > 1:
            errors = self._tip_errors({tip: (r.position_errors[tip], r.orientation_errors[tip]) for tip in self.target})
        return [
            ("status", r.status.name),
            *errors,
            ("iterations", f"{r.iterations}, restarts {r.restarts}"),
            ("computed in", f"{duration(r.elapsed)}, solver {r.solver}"),
        ]

    def _tip_errors(self, errors: dict[str, tuple[float, float | None]]) -> list[tuple[str, str]]:
        words = {tip: f"{length(position)}, {_angle(turned)}" for tip, (position, turned) in errors.items()}
        return [(tip, words.get(tip, NONE)) for tip in self.robot.tips]

    def axes(self) -> list[tuple[str, ...]]:
        """Return for each joint its name, its kind, and direction and a point [m] of its axis at home, in base axes."""
        seen: dict[str, tuple[str, ...]] = {}
        for arm, place in zip(self.robot.arms, self.robot.places, strict=True):
            arm._fk(self.robot.home[place])
            T_base = arm.data.oMf[arm._ids[0]]
            for name, kind in zip(arm.joint_names, arm.joint_kinds, strict=True):
                j = arm.model.getJointId(name)
                joint = T_base.actInv(arm.data.oMi[j])
                axis = _triple(joint.rotation @ screw(arm.model, arm.data, j)[2])
                seen[name] = (name, kind, axis, _triple(joint.translation) if kind != "prismatic" else "any")
        return [seen[name] for name in self.robot.joint_names]

    def to_dict(self) -> dict[str, Any]:
        """Return everything on the screen, in metres and radians, ready for JSON."""
        each = {}
        for tip, T in self.poses().items():
            R, p = T[:3, :3], T[:3, 3]
            each[tip] = {"T_base_tip": T, "xyz": p, "rpy": matrix_rpy(R), "quat_xyzw": matrix_quat(R)}
        return {
            "robot": self.source,
            "base": self.robot.base,
            **plain({"tips": each} if len(each) > 1 else {"tip": self.robot.tips[0], **each[self.robot.tips[0]]}),
            "joint_names": list(self.robot.joint_names),
            "q": self.q.tolist(),
            "target": plain(self.target),
            "result": None if self.result is None else self.result.to_dict(),
            "followed": None if self.followed is None else self.followed.message,
        }

    def to_json(self) -> str:
        """Return `to_dict` as JSON text."""
        return json.dumps(self.to_dict(), indent=1)


def _copy(target: Any) -> Any:
    """Copy a target, or targets by tip."""
    return {tip: np.array(T) for tip, T in target.items()} if isinstance(target, dict) else np.array(target)


def _angle(value: float | None) -> str:
    return "free" if value is None else angle(value)


def _figure(value: float) -> str:
    return f"{round(float(value), 6) + 0.0:.6g}"


def _triple(values: np.ndarray) -> str:
    return " ".join(f"{round(float(x), 4) + 0.0:g}" for x in values)
