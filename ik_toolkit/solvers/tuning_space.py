"""Tunable parameters of a solver: names, ranges, log scale or not, units, and the solver that parameter values make.

A solver rule that knows what to tune has a class method `space(robot, position_only, initial=None)`, see
`study.engines.make_space`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..kernel.kinematics import TAU
from ..kernel.records import POINTS


@dataclass(frozen=True)
class Parameter:
    """One parameter of a solver that is to be tuned: its range, initial value, unit, and whether the search uses a log scale."""

    name: str
    low: Any
    high: Any
    initial: Any
    unit: str = ""
    log: bool = False

    @property
    def size(self) -> int:
        """How many numbers the parameter consists of (1 unless it is an array)."""
        return int(np.size(self.initial))

    def to_unit(self) -> np.ndarray:
        """Return the parameter's initial value as numbers in 0..1, where 0 and 1 are the ends of its range."""
        low, high, value = (np.broadcast_to(x, np.shape(self.initial)).ravel() for x in self._ends(self.initial))
        return np.clip((value - low) / np.where(high > low, high - low, 1.0), 0.0, 1.0)

    def from_unit(self, x: np.ndarray) -> Any:
        """Convert numbers in 0..1 to a value in the parameter's range: a float, or an array shaped as `initial`."""
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
    """What `tune` searches: the parameters, the solver it starts from, and a function that makes a solver from parameter values.

    The search runs in the unit box, where each parameter goes from 0 to 1; spread is the standard deviation of its first
    candidates about the start.
    """

    parameters: tuple[Parameter, ...]
    initial: Any
    make: Callable[[dict[str, Any]], Any]
    spread: float = 0.15

    @property
    def size(self) -> int:
        """How many numbers the tuner varies: those of all parameters together."""
        return sum(parameter.size for parameter in self.parameters)

    @property
    def start(self) -> np.ndarray:
        """The initial point (size,) of the search, in the unit box."""
        return np.concatenate([parameter.to_unit() for parameter in self.parameters])

    def values(self, x: np.ndarray) -> dict[str, Any]:
        """Return the parameter values for a point in the unit box, by name."""
        ends = np.cumsum([0, *(parameter.size for parameter in self.parameters)])
        parts = zip(self.parameters, ends[:-1], ends[1:], strict=True)
        return {parameter.name: parameter.from_unit(np.asarray(x)[a:b]) for parameter, a, b in parts}

    def build(self, x: np.ndarray) -> Any:
        """Return the solver for a point in the unit box, which has a coordinate in 0..1 for each number."""
        return self.make(self.values(x))


def sampling_box(robot: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return the lower end and width (n,) [rad, m] of the box in which tuned starts lie: the limits, at most one turn wide."""
    n, chain = robot.n, robot.chain
    # a robot with several tips has a row for each; all rows have the same joint limits
    ends = np.atleast_2d(chain.ends)[0]
    low, span = (ends[POINTS + k * n : POINTS + (k + 1) * n] * chain.unit for k in (4, 5))
    turning = chain.unit == 1.0
    width = np.where(turning, np.minimum(span, TAU), span)
    return low + 0.5 * (span - width), width


def start_parameter(robot: Any, initial: np.ndarray) -> Parameter:
    """Return a tuning parameter that stands for M starts (M, n) [rad, m] of a solver; its range is that of `sampling_box`.

    initial: the starts with which tuning begins.
    """
    low, width = sampling_box(robot)
    return Parameter("starts", low, low + width, np.clip(initial, low, low + width), "rad, m")
