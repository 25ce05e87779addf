"""What makes one step: a published tracking method, or a solver's feedback rule taken one step a sample.

Both have the same face, so that `Tracker` and `track` need not know which they drive.
"""

from typing import Any

import numpy as np

from ..errors import InvalidOption, near_match
from ..kernel import motion
from ..kernel.follow import rule_tracker, tracker
from ..robot.robot import Robot
from ..solvers.registry import list_rows
from .methods import METHODS, Method, make_method
from .stability import GainCheck, check_gains


class Published:
    """A method of tracking/methods.py on a robot."""

    def __init__(self, robot: Robot, method: Method) -> None:
        """Bind; nothing is compiled yet."""
        self.chain = robot.chain
        self.method = method
        self.name = method.name
        self.gamma = method.rate_weight
        self.previous = np.zeros(robot.n)
        self._p = np.zeros(0)
        self._key: tuple[float, float] | None = None

    def settings(self, h: float) -> dict[str, float]:
        """Gains and options used at sample time h."""
        return {**self.method.gains(h), **({"reading": self.method.reading} if self.name == "aa" else {})}

    def check(self, h: float) -> GainCheck | None:
        """Judgement of the gains at sample time h."""
        return check_gains(self.name, h, **self.method.gains(h))

    def run(self, T, V, A, h, m, brake, runaway, limits, q, rate, state, Q, R, E, C, D) -> int:
        """Take len(T) - 1 steps; see kernel/follow.py."""
        if self._key != (h, runaway):
            self._p, self._key = self.method.pack(h, runaway), (h, runaway)
        self._p[motion.PLACE.brake] = brake
        rows, ends = self.chain.rows, self.chain.ends
        return tracker()(rows, ends, T, V, A, h, m, self._p, limits, q, rate, self.previous, state, Q, R, E, C, D)

    def forget(self) -> None:
        """Start anew."""
        self.previous[:] = 0.0


class RuleSteps:
    """A solver's rule on a robot; its state is kept from sample to sample."""

    gamma = 1.0

    def __init__(self, robot: Robot, rule: Any, limits: bool, options: dict[str, Any]) -> None:
        """Bind the rule with its parameters (raises what `ik.Solver` raises)."""
        from ..solvers.solve import Solver

        self.chain = robot.chain
        self.solver = Solver(robot, rule, **({"tolerance": 1e-9, "limits": limits} | options))
        self.name = self.solver.name
        self.previous = np.zeros(4 * robot.n + 8)
        self._p = np.zeros(len(motion.Law._fields))

    def settings(self, h: float) -> dict[str, float]:
        """Parameters of the rule that are plain numbers."""
        return {k: v for k, v in self.solver.rule._asdict().items() if isinstance(v, int | float)}

    def check(self, h: float) -> GainCheck | None:
        """No closed form for rules."""
        return None

    def run(self, T, V, A, h, m, brake, runaway, limits, q, rate, state, Q, R, E, C, D) -> int:
        """Take len(T) - 1 steps; V and A are not used."""
        from ..kernel.task import POSE, POSITION

        self._p[motion.PLACE.runaway], self._p[motion.PLACE.brake] = runaway, brake
        opt = self.solver.plan.orders((POSITION if m == 3 else POSE,), True)
        follow = rule_tracker(type(self.solver.rule))
        rows, ends = self.chain.rows, self.chain.ends
        return follow(rows, ends, T, h, opt, self._p, limits, q, rate, self.previous, state, Q, R, E, C)

    def forget(self) -> None:
        """Start anew."""
        self.previous[:] = 0.0


def bind(robot: Robot, method: Any, limits: bool, options: dict[str, Any]) -> Published | RuleSteps:
    """Return the engine of a method name, a Method, a solver name or a rule. Raises InvalidOption for none of these."""
    if isinstance(method, Method) or (isinstance(method, str) and method in METHODS):
        return Published(robot, make_method(method, **options))
    if method is None or isinstance(method, str):
        rules = [row.name for row in list_rows() if row.tracks]
        if method not in rules:
            raise InvalidOption(f"no tracking method '{method}'.{near_match(method, (*METHODS, *rules))}")
    return RuleSteps(robot, method, limits, options)
