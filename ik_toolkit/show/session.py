"""What one visitor of the panel works with: a robot of one tip or several, q, targets, a solver. No drawing, no web."""

import json
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from ..errors import FrameNotFound, InvalidTarget
from ..kernel.task import POSE, POSITION
from ..robot.library import find
from ..robot.pose import length, matrix_quat, matrix_rpy, pose
from ..robot.robot import Robot
from ..robot.tips import path_ends
from ..robot.tree import Tree
from ..solvers.registry import find_row, list_rows, make_rule
from ..solvers.result import Result
from ..solvers.solve import solve
from ..solvers.solve_all import solve_all
from ..text import parameter, plain, vector
from .hand import Followed, follow, prepare

KINDS = ("roll pitch yaw", "quaternion", "free")  # how the orientation of a typed target is given
NONE = "no target"  # of one of several tips
SHOWN = 16  # solutions listed


class Session:
    """State of one visitor. q (n,) [rad or m]; target, as the robot takes it, or None; result and solutions of the last solve.

    robot: a Robot, or a Tree; tips: all there are to choose from. A target is (4, 4) or (3,) [m], of a Tree a dict of these by
    tip. solver (name) and parameters (name -> text as typed, '' for the default); degrees: how angles are typed and shown.
    """

    def __init__(self, source: str, tips: str | Sequence[str] | None = None) -> None:
        """Start with a robot by name or path, and with one tip or several. Raises RobotNotFound, ModelError, FrameNotFound."""
        self.degrees = True
        self.solver = "auto"
        self.parameters: dict[str, str] = {}
        self.tolerance = 1e-6
        self.random = np.random.default_rng(0)
        self.load(source, tips)

    def load(self, source: str, tips: str | Sequence[str] | None = None) -> None:
        """Switch to another robot; nothing changes when that fails. tips: default all that are known, or else the first."""
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
        self.source, self.entry, self.robot = source, entry, robot
        self.tips = tuple(entry.tips) if len(entry.tips) > 1 else path_ends(robot.model)
        self.q = robot.home.copy()
        self.target: Any = None
        self.result: Result | None = None
        self.followed: Followed | None = None
        self.solutions: list[np.ndarray] = []
        self.distances: list[float] = []

    # ------------------------------------------------------------------------------------------------------- joints
    def scale(self, i: int) -> float:
        """Factor from the value of joint i [rad or m] to what is shown."""
        return math.degrees(1.0) if self.degrees and self.robot.joint_kinds[i] != "prismatic" else 1.0

    def unit(self, i: int) -> str:
        """Unit shown of joint i."""
        return "m" if self.robot.joint_kinds[i] == "prismatic" else "deg" if self.degrees else "rad"

    def ends(self, i: int) -> tuple[float, float]:
        """Range of the slider of joint i [rad or m]: its limits, or one turn (one reach) where there are none."""
        span = math.pi if self.robot.joint_kinds[i] != "prismatic" else self.robot.reach
        low, high = float(self.robot.lower[i]), float(self.robot.upper[i])
        low = low if math.isfinite(low) else min(-span, float(self.q[i]))
        return low, (high if math.isfinite(high) else max(low + 2.0 * span, float(self.q[i])))

    def poses(self, q: np.ndarray | None = None) -> dict[str, np.ndarray]:
        """T_base_tip (4, 4) of each tip at q (n,), default where the robot stands."""
        T: Any = self.robot.fk(self.q if q is None else q)
        return {tip: (T[tip] if self.robot.by_tip else T).homogeneous for tip in self.robot.tips}

    def random_poses(self) -> dict[str, np.ndarray]:
        """Poses that the tips can take together, others at every call."""
        return self.poses(self.robot.random_q(self.random))

    def joined(self, targets: dict[str, np.ndarray]) -> Any:
        """Targets by tip as the robot takes them: one tip's without its name."""
        return targets if self.robot.by_tip else targets[self.robot.tips[0]]

    def goals(self) -> dict[str, np.ndarray]:
        """Pose (4, 4) of each tip's target; where the tip stands if it has none, turned as it is if the target is a position."""
        given = self.target if self.robot.by_tip else {self.robot.tips[0]: self.target}
        poses = self.poses()
        for tip, target in (given or {}).items():
            if target is not None:
                poses[tip] = target if target.ndim == 2 else np.r_[np.c_[poses[tip][:3, :3], target], [[0, 0, 0, 1]]]
        return poses

    # ------------------------------------------------------------------------------------------------------- target
    def typed(self, xyz: str, kind: str, rotation: str) -> np.ndarray:
        """Target of typed numbers; the words of the refusal name the field. Raises InvalidTarget."""
        place = vector(xyz, "the position x y z [m]", 3)
        if kind == "free":
            return pose(place)
        if kind == "quaternion":
            return pose(place, quat_xyzw=vector(rotation, "the quaternion x y z w", 4))
        angles = vector(rotation, f"roll pitch yaw [{'deg' if self.degrees else 'rad'}]", 3)
        return pose(place, rpy=[math.radians(a) if self.degrees else a for a in angles])

    def words(self, T: np.ndarray, kind: str) -> tuple[str, str]:
        """Texts of position and rotation of a pose, as `typed` reads them."""
        at = T if T.ndim == 1 else T[:3, 3]
        xyz = "  ".join(_figure(x) for x in at)
        if T.ndim == 1 or kind == "free":
            return xyz, ""
        if kind == "quaternion":
            return xyz, "  ".join(_figure(x) for x in matrix_quat(T[:3, :3]))
        angles = matrix_rpy(T[:3, :3]) * (math.degrees(1.0) if self.degrees else 1.0)
        return xyz, "  ".join(_figure(x) for x in angles)

    # -------------------------------------------------------------------------------------------------------- solve
    def choices(self) -> list[str]:
        """Names of solvers that can be tried on this robot."""
        from ..solvers.closed_form import fits

        closed = {fits(self.robot, kind) for kind in (POSITION, POSE)}
        rows = (row for row in list_rows() if not (self.robot.by_tip and row.one_tip))
        return ["auto", *(row.name for row in rows if not row.closed or row.name in closed)]

    def fields(self) -> dict[str, Any]:
        """Parameters of the chosen solver with their defaults."""
        if self.solver == "auto":
            return {}
        cls = find_row(self.solver).load()
        return {name: cls._field_defaults.get(name) for name in cls._fields if name not in ("tuned", "starts")}

    def rule(self) -> Any:
        """Solver name, or a rule with the typed parameters. Raises InvalidOption."""
        given = {name: text.strip() for name, text in self.parameters.items() if text.strip() and name in self.fields()}
        if not given:
            return self.solver
        return make_rule(find_row(self.solver), {name: parameter(name, text) for name, text in given.items()})

    def solve(self, target: Any) -> Result:
        """Solve from q, keep the way there; q moves only when it succeeds. Raises what `ik.solve` raises."""
        self.target, self.followed = _copy(target), None
        self.result = solve(self.robot, self.target, self.rule(), q0=self.q, history=True, tolerance=self.tolerance)
        if self.result.success:
            self.q = self.result.q.copy()
        return self.result

    def follow(self, target: Any) -> Followed:
        """Step towards a target that is being dragged, as far as the arm gets in a second. Raises what `Tracker` raises."""
        if self.robot.by_tip and not target:
            raise InvalidTarget(f"give a target for at least one of {', '.join(self.robot.tips)}")
        self.target, self.result = _copy(target), None
        self.followed = follow(self.robot, self.q, self.target, self.tolerance)
        self.q = self.followed.q.copy()
        return self.followed

    def prepare(self) -> None:
        """Get ready for `follow`; nothing moves."""
        prepare(self.robot, self.q, self.joined(self.poses()))

    def solve_all(self, target: Any) -> str:
        """Find solutions (the nearest 16 are kept) and say how many there are. Raises what `ik.solve_all` raises."""
        self.target = _copy(target)
        found = solve_all(self.robot, self.target, "auto", self.q, starts=200, count=SHOWN)
        self.solutions, self.distances = [q.copy() for q in found][:SHOWN], found.distance.tolist()[:SHOWN]
        complete = "; these are all" if found.complete else ""
        return f"{found.message}{complete}" if len(found) else f"no solution: {found.message}"

    # ---------------------------------------------------------------------------------------------------- for people
    def figures(self) -> list[tuple[str, str]]:
        """Rows (name, value) on the last solve, or on where a drag has got to."""
        if self.followed is not None:
            left = self.followed.errors
            words = {tip: f"{length(position)}, {_angle(angle)}" for tip, (position, angle) in left.items()}
            return [(tip, words.get(tip, NONE)) for tip in self.robot.tips]
        r = self.result
        if r is None:
            return []
        errors = [("position error", length(r.position_error)), ("orientation error", _angle(r.orientation_error))]
        if self.robot.by_tip:
            errors = []
            for tip, position in r.position_errors.items():
                left = f"{length(position)}, {_angle(r.orientation_errors[tip])}"
                errors.append((tip, left if tip in self.target else NONE))
        return [
            ("status", r.status.name),
            *errors,
            ("iterations", f"{r.iterations}, restarts {r.restarts}"),
            ("time", f"{1e3 * r.elapsed:.3g} ms, solver {r.solver}"),
        ]

    def table(self) -> tuple[str, tuple[str, ...], list[tuple[str, ...]]]:
        """Caption, head and rows: the D-H table of a robot that has one, otherwise its joint axes at home, in base axes."""
        if self.entry.dh_file is not None and not self.robot.by_tip and self.entry.tips == self.robot.tips:
            from ..robot.dh import read_dh_table

            table = read_dh_table(self.entry.dh_file)
            caption = (
                f"{table.convention.capitalize()} Denavit-Hartenberg table ({self.entry.table or self.entry.name})"
            )
            rows = []
            for r in table.rows:
                name = f"{r.name}{' (slides)' if r.type == 'prismatic' else ''}"
                rows.append((name, f"{math.degrees(r.theta):g}", f"{r.d:g}", f"{r.a:g}", f"{math.degrees(r.alpha):g}"))
            return caption, ("joint", "theta [deg]", "d [m]", "a [m]", "alpha [deg]"), rows
        seen: dict[str, tuple[str, ...]] = {}
        for arm, place in zip(self.robot.arms, self.robot.places, strict=True):
            q = self.robot.home[place]
            J, p = arm.jacobian(q), arm.fk(q).translation
            for name, kind, column in zip(arm.joint_names, arm.joint_kinds, J.T, strict=True):
                v, w = column[:3], column[3:]
                axis = w if kind != "prismatic" else v
                through = _triple(p + np.cross(w, v) / (w @ w)) if kind != "prismatic" else "any"
                seen[name] = (name, kind, _triple(axis / max(float(np.linalg.norm(axis)), 1e-12)), through)
        rows = [seen[name] for name in self.robot.joint_names]
        return "Joint axes at home, in base axes", ("joint", "kind", "axis", "through [m]"), rows

    def to_dict(self) -> dict[str, Any]:
        """What is on the screen, in metres and radians, ready for JSON."""
        each = {
            tip: {
                "T_base_tip": T.tolist(),
                "xyz": T[:3, 3].tolist(),
                "rpy": matrix_rpy(T[:3, :3]).tolist(),
                "quat_xyzw": matrix_quat(T[:3, :3]).tolist(),
            }
            for tip, T in self.poses().items()
        }
        return {
            "robot": self.source,
            "base": self.robot.base,
            **({"tips": each} if self.robot.by_tip else {"tip": self.robot.tips[0], **each[self.robot.tips[0]]}),
            "joint_names": list(self.robot.joint_names),
            "q": self.q.tolist(),
            "target": plain(self.target),
            "result": None if self.result is None else self.result.to_dict(),
            "dragged": None if self.followed is None else self.followed.message,
        }

    def to_json(self) -> str:
        """JSON text of `to_dict`."""
        return json.dumps(self.to_dict(), indent=1)


def _copy(target: Any) -> Any:
    """Target or targets by tip, of their own."""
    return {tip: np.array(T) for tip, T in target.items()} if isinstance(target, dict) else np.array(target)


def _angle(value: float | None) -> str:
    return "free" if value is None else f"{math.degrees(value):.3g} deg"


def _figure(value: float) -> str:
    return f"{round(float(value), 6) + 0.0:.6g}"


def _triple(values: np.ndarray) -> str:
    return " ".join(f"{round(float(x), 4) + 0.0:g}" for x in values)
