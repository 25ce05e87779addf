"""What makes one step: a published tracking method, or a solver's feedback rule taken one step a sample.

Both have the same interface, so `Tracker` and `track` need not know which one they drive.
"""

import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from ..errors import InvalidOption, near_match, nearest
from ..kernel import motion
from ..kernel.records import HEAD, Task
from ..kernel.servo import servo
from ..kernel.task import PART
from ..robot.robot import Robot
from ..robot.tree import Tree
from ..solvers.options import COUNTING, NAMES, OTHERWISE, Options, make_options
from ..solvers.registry import find_row, list_rows
from ..solvers.task import kernel_tasks, relatives, what_counts
from .methods import DAMPING, METHODS, Method, make_method
from .stability import GainCheck, check_gains

LEVER = 0.2  # [m] lever by which an angle is compared with a length: about a hand
ALIKE = 0.6  # likeness (see `difflib`) above which an option of another method may have been meant
WORDS = (*COUNTING, "relative_to")  # options that say what counts


def even(scale: float) -> np.ndarray:
    """Weights (6,) of the errors of a tip in kernel units, with their geometric mean 1: singular values keep their size."""
    share = math.sqrt(scale / LEVER)
    return np.array([share] * 3 + [1.0 / share] * 3)


class Published:
    """A method of tracking/methods.py on a robot."""

    waits = True  # a reference's clock stands still while the error is above its tolerance

    def __init__(self, robot: Robot | Tree, method: Method, counting: Mapping[str, Any]) -> None:
        """Bind; nothing is compiled yet."""
        self.robot = robot
        self.method = method
        self.name = method.name
        self.gamma = method.rate_weight
        self.chosen = any(
            one is not None for one in (method.kappa, method.kp, method.share)
        )  # gains that somebody chose
        self.memory = robot.n  # numbers kept from step to step
        self.loop = servo()
        self.options: Options = make_options(dict(counting))
        what_counts(robot, self.options)
        relatives(robot, self.options)

    def __getstate__(self) -> dict[str, Any]:
        """All but the compiled loop, which is bound again."""
        return {name: value for name, value in vars(self).items() if name != "loop"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore."""
        vars(self).update(state, loop=servo())

    def settings(self, h: float) -> dict[str, float]:
        """Gains and options used at sample time h."""
        return {**self.method.gains(h), **({"reading": self.method.reading} if self.name == "aa" else {})}

    def check(self, h: float) -> GainCheck | None:
        """Verdict on the gains at sample time h."""
        return check_gains(self.name, h, **self.method.gains(h))

    def law(self, h: float, delay: float = 0.0) -> np.ndarray:
        """Parameters of the loop at sample time h, for joints measured `delay` samples ago."""
        return self.method.pack(h, delay)

    def orders(self, kinds: tuple) -> tuple[np.ndarray, np.ndarray]:
        """Input of the loop for kinds of target: orders, and weights and slack of the errors (3, m), see kernel/servo.py."""
        scale, n = self.robot.chain.scale, self.robot.n
        tasks, counts = [], []
        unit = np.array([scale] * 3 + [1.0] * 3)
        for task in kernel_tasks(self.robot, kinds, self.options):
            weights, slack = np.array(task[-12:-6]), np.array(task[-6:])
            weights[slack >= (*(math.inf,) * 3, *(math.pi,) * 3)] = 0.0
            slack[weights == 0.0] = 0.0
            if task.kind == PART:
                task = Task(*task[:-12], *(weights > 0.0), *np.zeros(6))
            tasks.append(task)
            counts.append([weights * even(scale), slack, slack * unit])
        orders = np.concatenate([np.zeros(HEAD), *tasks, np.ones(n), [0.0]])
        return orders, np.ascontiguousarray(np.concatenate(counts, axis=1))


class RuleSteps:
    """A solver's rule on a robot; its state is kept from sample to sample."""

    gamma = 1.0
    chosen = False
    waits = False  # a rule lags behind what moves, limits or not

    def __init__(self, robot: Robot | Tree, rule: Any, limits: bool, options: dict[str, Any]) -> None:
        """Bind the rule with its parameters (raises what `ik.Solver` raises)."""
        from ..solvers.solve import Solver

        self.robot = robot
        self.solver = Solver(robot, rule, **({"tolerance": 1e-9, "limits": limits} | options))
        self.name = self.solver.name
        self.memory = 4 * robot.n + 8
        self.loop = servo(type(self.solver.rule))
        self.options = self.solver.options

    def __getstate__(self) -> dict[str, Any]:
        """All but the compiled loop, which is bound again."""
        return {name: value for name, value in vars(self).items() if name != "loop"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore."""
        vars(self).update(state, loop=servo(type(state["solver"].rule)))

    def settings(self, h: float) -> dict[str, float]:
        """Parameters of the rule that are plain numbers."""
        return {k: v for k, v in self.solver.rule._asdict().items() if isinstance(v, int | float)}

    def check(self, h: float) -> GainCheck | None:
        """No closed form for rules."""
        return None

    def law(self, h: float, delay: float = 0.0) -> np.ndarray:
        """The same; a rule has its own parameters."""
        law = np.zeros(len(motion.Law._fields))
        law[motion.PLACE.gamma], law[motion.PLACE.damping] = 1.0, DAMPING
        return law

    def orders(self, kinds: tuple) -> tuple[np.ndarray, np.ndarray]:
        """Input of the loop; weights and slack are the rule's."""
        scale = self.robot.chain.scale
        counts = np.zeros((3, 6 * len(kinds)))
        counts[0] = np.tile(even(scale), len(kinds))
        return self.solver.plan.orders(kinds, True), counts


def bind(
    robot: Robot | Tree, method: Any, limits: bool, options: dict[str, Any], known: Iterable[str]
) -> Published | RuleSteps:
    """Return the engine of a method name, a Method, a solver name or a rule. Raises InvalidOption for anything else.

    known: names of the caller's own options, of which one may have been meant.
    """
    check_options(method, options, known)
    if not is_published(method):
        return RuleSteps(robot, method, limits, options)
    counting = {name: options[name] for name in WORDS if name in options}
    others = {name: value for name, value in options.items() if name not in WORDS}
    return Published(robot, make_method(method, **others), counting)


def is_published(method: Any) -> bool:
    """Whether this is a method of tracking/methods.py, and not a solver."""
    return isinstance(method, Method) or (isinstance(method, str) and method in METHODS)


def check_options(method: Any, options: Iterable[str], known: Iterable[str]) -> None:
    """Raise InvalidOption for an unknown method, or an option that it does not take; known: see `bind`."""
    if is_published(method):
        name = method if isinstance(method, str) else method.name
        allowed = (*METHODS[name][1], "damping", *WORDS)
    else:
        rows = list_rows()
        rules = [row.name for row in rows if row.tracks]
        if method is None or (isinstance(method, str) and method not in rules):
            if method in {row.name for row in rows}:
                raise InvalidOption(
                    f"'{method}' is a solver that cannot track; methods that can: {', '.join((*METHODS, *rules))}"
                )
            raise InvalidOption(f"no tracking method '{method}'.{near_match(method, (*METHODS, *rules))}")
        row = find_row(method)
        name = row.name
        allowed = (*(row.load()._fields if isinstance(method, str | type) else ()), "tolerance", *NAMES)
    for option in options:
        if option not in allowed and option not in OTHERWISE:
            here = [*dict.fromkeys((*allowed, *known))]
            near = near_match(option, here)
            meant = nearest(option, (other for _, of, _ in METHODS.values() for other in of), ALIKE)
            if meant is not None and nearest(option, here, ALIKE) is None:
                of = " and ".join(method for method, row in METHODS.items() if meant in row[1])
                if meant == option:
                    raise InvalidOption(f"{option} is an option of {of}, not of {name}")
                near = f" '{meant}' is an option of {of}.{near_match('', here)}"
            raise InvalidOption(f"{name} has no option '{option}'.{near}")
