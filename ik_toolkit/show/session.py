"""What one visitor of the panel works with: a robot, a configuration, a target, a solver. No drawing, no web."""

import json
import math
from typing import Any

import numpy as np

from ..errors import FrameNotFound
from ..kernel.task import POSE, POSITION
from ..robot.library import find
from ..robot.pose import length, matrix_quat, matrix_rpy, pose
from ..robot.robot import Robot, path_ends
from ..solvers.registry import find_row, list_rows, make_rule
from ..solvers.result import Result
from ..solvers.solve import bound, is_auto, solve
from ..solvers.solve_all import solve_all
from ..text import parameter, vector

KINDS = ("roll pitch yaw", "quaternion", "free")  # how the orientation of a typed target is given
SHOWN = 16  # solutions listed
DRAG_RESTARTS = 8  # a dragged target is near: a long search would only make the drag stutter


class Session:
    """State of one visitor. q (n,) [rad or m]; target (4, 4) or (3,) [m] or None; result and solutions of the last solve.

    solver (name) and parameters (name -> text as typed, '' for the default); degrees: how angles are typed and shown.
    """

    def __init__(self, source: str, tip: str | None = None) -> None:
        """Start with a robot by name or path. Raises RobotNotFound, ModelError, FrameNotFound."""
        self.degrees = True
        self.solver = "auto"
        self.parameters: dict[str, str] = {}
        self.tolerance = 1e-6
        self.load(source, tip)

    def load(self, source: str, tip: str | None = None) -> None:
        """Switch to another robot; nothing changes when that fails."""
        entry = find(source.strip())
        if tip is None and len(entry.tips) > 1:
            tip = entry.tips[0]
        try:
            robot = Robot.load(source.strip(), tip=tip)
        except FrameNotFound as several:
            if tip is not None or not several.tips:
                raise
            robot = Robot.load(source.strip(), tip=several.tips[0])
        self.source, self.entry, self.robot = source.strip(), entry, robot
        self.tips = tuple(entry.tips) if len(entry.tips) > 1 else path_ends(robot.model)
        self.q = robot.home.copy()
        self.target: np.ndarray | None = None
        self.result: Result | None = None
        self.solutions: list[np.ndarray] = []

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

    def tip(self) -> np.ndarray:
        """T_base_tip (4, 4) at q."""
        return self.robot.fk(self.q).homogeneous

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
        return ["auto", *(row.name for row in list_rows() if not row.closed or row.name in closed)]

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

    def solve(self, target: np.ndarray) -> Result:
        """Solve from q, keep the way there; q moves only when it succeeds. Raises what `ik.solve` raises."""
        self.target = np.array(target)
        self.result = solve(self.robot, self.target, self.rule(), q0=self.q, history=True, tolerance=self.tolerance)
        if self.result.success:
            self.q = self.result.q.copy()
        return self.result

    def follow(self, target: np.ndarray) -> Result:
        """Solve as `solve` does, without keeping the way there: for a target that is being dragged."""
        self.target = np.array(target)
        rule = self.rule()
        options: dict[str, Any] = {"check": True, "tolerance": self.tolerance}
        if is_auto(rule) or find_row(rule).length().attempts > 1:
            options["restarts"] = DRAG_RESTARTS
        self.result = bound(self.robot, rule, options)(self.target, self.q)
        if self.result.success:
            self.q = self.result.q.copy()
        return self.result

    def solve_all(self, target: np.ndarray) -> str:
        """Find solutions (the nearest 16 are kept) and say how many there are. Raises what `ik.solve_all` raises."""
        self.target = np.array(target)
        found = solve_all(self.robot, self.target, "auto", self.q, starts=200, count=SHOWN)
        self.solutions = [q.copy() for q in found][:SHOWN]
        complete = "; these are all" if found.complete else ""
        return f"{found.message}{complete}" if len(found) else f"no solution: {found.message}"

    # ---------------------------------------------------------------------------------------------------- for people
    def figures(self) -> list[tuple[str, str]]:
        """Rows (name, value) on the last solve."""
        r = self.result
        if r is None:
            return []
        angle = "free" if r.orientation_error is None else f"{math.degrees(r.orientation_error):.3g} deg"
        return [
            ("status", r.status.name),
            ("position error", length(r.position_error)),
            ("orientation error", angle),
            ("iterations", f"{r.iterations}, restarts {r.restarts}"),
            ("time", f"{1e3 * r.elapsed:.3g} ms, solver {r.solver}"),
        ]

    def table(self) -> tuple[str, tuple[str, ...], list[tuple[str, ...]]]:
        """Caption, head and rows: the D-H table of a robot that has one, otherwise its joint axes at home, in base axes."""
        if self.entry.dh_file is not None and self.entry.tips == (self.robot.tip,):
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
        J, p = self.robot.jacobian(self.robot.home), self.robot.fk(self.robot.home).translation
        rows = []
        for name, kind, column in zip(self.robot.joint_names, self.robot.joint_kinds, J.T, strict=True):
            v, w = column[:3], column[3:]
            axis = w if kind != "prismatic" else v
            through = _triple(p + np.cross(w, v) / (w @ w)) if kind != "prismatic" else "any"
            rows.append((name, kind, _triple(axis / max(float(np.linalg.norm(axis)), 1e-12)), through))
        return "Joint axes at home, in base axes", ("joint", "kind", "axis", "through [m]"), rows

    def to_dict(self) -> dict[str, Any]:
        """What is on the screen, in metres and radians, ready for JSON."""
        T = self.tip()
        return {
            "robot": self.source,
            "base": self.robot.base,
            "tip": self.robot.tip,
            "joint_names": list(self.robot.joint_names),
            "q": self.q.tolist(),
            "T_base_tip": T.tolist(),
            "xyz": T[:3, 3].tolist(),
            "rpy": matrix_rpy(T[:3, :3]).tolist(),
            "quat_xyzw": matrix_quat(T[:3, :3]).tolist(),
            "target": None if self.target is None else self.target.tolist(),
            "result": None if self.result is None else self.result.to_dict(),
        }

    def to_json(self) -> str:
        """JSON text of `to_dict`."""
        return json.dumps(self.to_dict(), indent=1)


def _figure(value: float) -> str:
    return f"{round(float(value), 6) + 0.0:.6g}"


def _triple(values: np.ndarray) -> str:
    return " ".join(f"{round(float(x), 4) + 0.0:g}" for x in values)
