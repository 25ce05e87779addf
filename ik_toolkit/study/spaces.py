"""What can be tuned of each solver: names, ranges, logarithmic or not, units, and the rule that a point of it stands for."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import InvalidOption
from ..robot.robot import Robot
from ..solvers.registry import find_row, make_rule
from ..solvers.rules.pid import PID
from ..solvers.rules.state_space import UNITS, StateSpace, inverse_maps, sampling_box, spread_starts

C_FIXED = -0.05  # (A, B, C) and (TAT^-1, TB, CT^-1) are the same solver, so C need not be searched


@dataclass(frozen=True)
class Parameter:
    """One declared parameter: lower and upper end (scalars or arrays of one shape), log scale or not, unit, where to start."""

    name: str
    low: Any
    high: Any
    initial: Any
    unit: str = ""
    log: bool = False

    @property
    def size(self) -> int:
        """Number of values."""
        return int(np.size(self.initial))

    def to_unit(self) -> np.ndarray:
        """The initial values in [0, 1]."""
        low, high, value = (np.broadcast_to(x, np.shape(self.initial)).ravel() for x in self._ends(self.initial))
        return np.clip((value - low) / np.where(high > low, high - low, 1.0), 0.0, 1.0)

    def from_unit(self, x: np.ndarray) -> Any:
        """Values of a point in [0, 1]: a float, or an array shaped as `initial`."""
        low, high, _ = self._ends(self.initial)
        value = low + (high - low) * x.reshape(np.shape(self.initial))
        value = np.exp(value) if self.log else value
        return float(value) if np.ndim(self.initial) == 0 else value

    def _ends(self, value: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        ends = (np.asarray(part, dtype=float) for part in (self.low, self.high, value))
        low, high, value = (np.log(part) if self.log else part for part in ends)
        return low, high, value


@dataclass(frozen=True)
class Space:
    """Declared parameters of a search, the rule it starts from, and what makes a rule of values by name."""

    parameters: tuple[Parameter, ...]
    initial: Any
    make: Callable[[dict[str, Any]], Any]
    spread: float = 0.15

    @property
    def size(self) -> int:
        """Numbers searched."""
        return sum(parameter.size for parameter in self.parameters)

    @property
    def start(self) -> np.ndarray:
        """The initial point in the unit box."""
        return np.concatenate([parameter.to_unit() for parameter in self.parameters])

    def values(self, x: np.ndarray) -> dict[str, Any]:
        """Values by name of a point in the unit box."""
        ends = np.cumsum([0, *(parameter.size for parameter in self.parameters)])
        parts = zip(self.parameters, ends[:-1], ends[1:], strict=True)
        return {parameter.name: parameter.from_unit(np.asarray(x)[a:b]) for parameter, a, b in parts}

    def build(self, x: np.ndarray) -> Any:
        """The rule of a point in the unit box."""
        return self.make(self.values(x))


def make_space(robot: Robot, solver: str, position_only: bool, maps: int = 1, initial: Any = None) -> Space:
    """Space of a solver on a robot. Raises InvalidOption for solvers without parameters and rules it cannot start from."""
    if isinstance(maps, bool) or int(maps) != maps or not 1 <= maps <= 4096:
        raise InvalidOption(f"maps must be a whole number from 1 to 4096, not {maps!r}")
    if solver == "state-space":
        if maps == 1:
            return _one_map(robot, position_only, initial)
        return _several_maps(robot, position_only, maps) if initial is None else _split(robot, maps, initial)
    if maps != 1:
        raise InvalidOption(f"only state-space has maps, not '{solver}'")
    if solver == "pid":
        return _pid(robot, position_only, initial)
    row = find_row(solver)
    ranges = {"damping": (1e-4, 1.0, True), "gain": (0.05, 1.9, False)}
    defaults = getattr(row.load(), "_field_defaults", {})
    parameters = tuple(
        Parameter(name, *ranges[name][:2], float(getattr(initial, name, value)), log=ranges[name][2])
        for name, value in defaults.items()
        if name in ranges
    )
    if not parameters:
        raise InvalidOption(f"solver '{solver}' has nothing to tune")
    return Space(parameters, initial or make_rule(row, {}), lambda values: make_rule(row, values))


def _start(robot: Robot, initial: np.ndarray) -> Parameter:
    low, width = sampling_box(robot)
    return Parameter("starts", low, low + width, np.clip(initial, low, low + width), "rad, m")


def _one_map(robot: Robot, position_only: bool, initial: StateSpace | None) -> Space:
    """The published structure: A = a I, B, C = -0.05 I, literal delay, one start."""
    n, scale, unit = robot.n, robot.chain.scale, robot.chain.unit
    start = robot.home[None]
    if initial is None:  # a = -0.5 puts both poles at 0.25 for a loop gain of 0.5625
        B = 0.5625 / C_FIXED * inverse_maps(robot, start, position_only)[0]
        initial = StateSpace(A=-0.5 * np.eye(n), B=B, C=C_FIXED * np.eye(n), starts=start)
    a, B = _plain(initial, n)
    if initial.starts is not None:
        start = np.atleast_2d(np.asarray(initial.starts, dtype=float))[:1]
    size = np.concatenate([np.full(3, 1.0 / scale), np.ones(3)])[: B.shape[1]] * unit[:, None] / abs(C_FIXED)
    reach = np.maximum(1.5, 1.5 * np.abs(B / size).max()) * size

    def make(values: dict[str, Any]) -> StateSpace:
        return StateSpace(A=values["a"] * np.eye(n), B=values["B"], C=C_FIXED * np.eye(n), starts=values["starts"])

    parameters = (
        _start(robot, start),
        Parameter("B", -reach, reach, B, "rad/m, 1"),
        Parameter("a", -0.95, 0.6, a),
    )
    return Space(parameters, initial, make)


def _plain(rule: StateSpace, n: int) -> tuple[float, np.ndarray]:
    """(a, B) [SI, base axes] of a rule with A = a I and C = c I, rescaled to C = -0.05 I. Raises InvalidOption."""
    A, B, C = (np.asarray(part, dtype=float) for part in (rule.A, rule.B, rule.C))
    if A.shape != (n, n) or C.shape != (n, n) or B.ndim != 2 or rule.D is not None:
        raise InvalidOption("the search can start from a rule with A (n, n), one B, C (n, n) and no D")
    a, c = A[0, 0], C[0, 0]
    if not (np.allclose(A, a * np.eye(n)) and np.allclose(C, c * np.eye(n)) and c != 0.0):
        raise InvalidOption("the search can start from a rule with A = a I and C = c I only")
    per_metre, increment = UNITS[rule.units]
    frame = np.eye(3) if rule.frame is None else np.asarray(rule.frame, dtype=float)
    B = np.concatenate([B[:, :3] @ frame * per_metre, B[:, 3:] @ frame if B.shape[1] == 6 else B[:, 3:]], axis=1)
    return float(a), B * (c * increment / C_FIXED)


def _several_maps(robot: Robot, position_only: bool, maps: int) -> Space:
    """Starts are searched; the map of each is the damped inverse of the Jacobian averaged around it, times one loop gain."""
    starts = spread_starts(robot, position_only, maps)

    def make(values: dict[str, Any]) -> StateSpace:
        where = values["starts"]
        return StateSpace(D=values["kappa"] * inverse_maps(robot, where, position_only), starts=where)

    parameters = (_start(robot, starts), Parameter("kappa", 0.2, 1.6, 0.9 if position_only else 0.6))
    initial = make({"starts": starts, "kappa": parameters[1].initial})
    return Space(parameters, initial, make, spread=0.08)


def _split(robot: Robot, maps: int, initial: StateSpace) -> Space:
    """A = a I, C = -0.05 I, literal delay, several starts: each B between the given (share 0) and that start's own (share 1)."""
    n, eye = robot.n, np.eye(robot.n)
    a, B = _plain(initial, n)
    position_only = B.shape[1] == 3
    starts = spread_starts(robot, position_only, maps)

    def make(values: dict[str, Any]) -> StateSpace:
        where, share = values["starts"], values["share"]
        own = values["kappa"] / C_FIXED * inverse_maps(robot, where, position_only)
        return StateSpace(A=values["a"] * eye, B=(1.0 - share) * B + share * own, C=C_FIXED * eye, starts=where)

    parameters = (
        _start(robot, starts),
        Parameter("share", 0.0, 1.0, 0.0),
        Parameter("kappa", 0.1, 1.4, 0.5625),  # both poles at 0.25 for a = -0.5
        Parameter("a", -0.95, 0.6, a),
    )
    return Space(parameters, initial, make)


def _pid(robot: Robot, position_only: bool, initial: PID | None) -> Space:
    """Gains on log scales, and one start."""
    initial = initial or PID()
    packed = np.array(initial.pack(robot)) / robot.chain.scale
    kp, ki, kd = (float(x) for x in packed[:3])
    start = robot.home[None] if initial.starts is None else np.atleast_2d(np.asarray(initial.starts, dtype=float))[:1]
    parameters = [
        Parameter("kp", kp / 8, kp * 8, kp, "rad/m", True),
        Parameter("ki", 1e-7 * kp, 1e-1 * kp, min(max(ki, 1e-7 * kp), 1e-1 * kp), "rad/m", True),
        Parameter("kd", 1e-2 * kp, 100 * kp, min(max(kd, 1e-2 * kp), 100 * kp), "rad/m", True),
        _start(robot, start),
    ]
    if not position_only:
        scale = float(initial.pack(robot).orientation * robot.chain.scale)
        parameters.append(Parameter("orientation_scale", scale / 10, scale * 10, scale, "m/rad", True))
    return Space(tuple(parameters), initial, lambda values: PID(**values))
