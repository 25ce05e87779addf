"""One interface for the two things that can drive a tracker: a published tracking law, or the iteration of a solver.

`Tracker` and `track` call `Published` (law) and `RuleSteps` (solver iteration) in the same way.
"""

import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from ..errors import InvalidOption, near_match, nearest
from ..kernel.counted_error import KIND
from ..kernel.records import SIZE, Task
from ..robot.robot import Robot
from ..robot.tree import Tree
from ..solvers.options import COUNTING, NAMES, OTHERWISE, Options, make_options
from ..solvers.registry import find_row, list_rows
from ..solvers.task import counted_rows, group_levels, kernel_tasks, relatives, what_counts
from . import laws
from .loop import servo
from .methods import DAMPING, METHODS, Method, make_method, pack_law
from .stability import GainCheck, check_gains

# weight of the errors of one priority level relative to those of the next higher level; with 0.01 lower levels would pull the tip
# up to 0.3 mm off what a higher level asks for
LOWER = 0.001
# factor on the weights of a tip whose target is given in another tip's frame, because two hands must above all keep their grip
RELATIVE = 100.0
LEVER = 0.2  # [m] default of length_scale: an angle of 1 rad counts as much as this length, about that of a hand
ALIKE = 0.6  # difflib similarity above which an unknown option is taken for a misspelt option of another method
WORDS = (*COUNTING, "relative_to", "priority", "length_scale")  # names of the options that select and weight errors


def even(robot: Robot | Tree, options: Options) -> np.ndarray:
    """Return weights (6,) of position errors [arm reaches] and rotation errors [rad] with which 1 rad counts as length_scale [m].

    The geometric mean of the weights is 1, so singular values keep their magnitude.
    """
    share = math.sqrt(robot.chain.scale / (options.length_scale or LEVER))
    return np.array([share] * 3 + [1.0 / share] * 3)


class Published:
    """Makes a tracker follow its target by a control law: one of the methods cv, av, ca, aa, aad (see `Method`)."""

    waits = True  # if the error exceeds its tolerance, `track` slows the clock by which the reference is run through

    def __init__(self, robot: Robot | Tree, method: Method, counting: Mapping[str, Any]) -> None:
        """Bind the method to the robot, without compiling. counting: options such as mask and slack that select errors."""
        self.robot = robot
        self.method = method
        self.name = method.name
        self.gamma = method.rate_weight
        # whether the caller chose the gains of the method; if not, they follow from the sample time
        self.chosen = any(one is not None for one in (method.kappa, method.kp, method.share))
        self.memory = robot.n  # number of values that the method keeps from one step to the next
        self.loop = servo()
        self.options: Options = make_options(dict(counting))
        what_counts(robot, self.options)
        relatives(robot, self.options)
        self.levels = np.array(group_levels(robot, self.options))  # (2 F,) priority of each tip's position, orientation

    def __getstate__(self) -> dict[str, Any]:
        """Return all attributes for pickling, without the compiled loop, which cannot be pickled."""
        return {name: value for name, value in vars(self).items() if name != "loop"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore the attributes and bind the compiled loop again."""
        vars(self).update(state, loop=servo())

    def settings(self, h: float) -> dict[str, float]:
        """Return the gains and options that the method uses at sample time h [s], by name."""
        return {**self.method.gains(h), **({"reading": self.method.reading} if self.name == "aa" else {})}

    def check(self, h: float) -> GainCheck | None:
        """Return whether the gains are stable at sample time h [s], as a GainCheck."""
        return check_gains(self.name, h, **self.method.gains(h))

    def law(self, h: float) -> np.ndarray:
        """Return the method and its gains at sample time h [s] as an array, in the order of the fields of `Law`."""
        return pack_law(self.method, h)

    def natural(self, h: float) -> float:
        """Return the rate [1/s] at which the method removes an error in steps of h [s] if nothing hinders it; 0: never."""
        return laws.natural(laws.Law._make(self.law(h).tolist()), h)

    def orders(self, kinds: tuple) -> tuple[np.ndarray, np.ndarray]:
        """Return the task as arrays for the compiled loop: which errors count, and how much.

        kinds: kind of target (KIND.pose or KIND.position) of each tip.

        Returns:
            A flat array (the fields of `Orders`, those of a `Task` for each tip, joint weights), and an array (4, m) with a column
                for each error: its weight, its slack (dead band) in arm reaches or rad, the same slack in m or rad, and the weight
                of its priority level relative to level 0.
        """
        scale, n = self.robot.chain.scale, self.robot.n
        tasks, counts = [], []
        unit = np.array([scale] * 3 + [1.0] * 3)
        for task, level in zip(kernel_tasks(self.robot, kinds, self.options), self.levels.reshape(-1, 2), strict=True):
            weights, slack = np.array(task[-12:-6]), np.array(task[-6:])
            weights[slack >= (*(math.inf,) * 3, *(math.pi,) * 3)] = 0.0
            slack[weights == 0.0] = 0.0
            if task.kind == KIND.part:
                task = Task(*task[:-12], *(weights > 0.0), *np.zeros(6))
            tasks.append(task)
            share = (RELATIVE if task.other >= 0 else 1.0) * np.repeat(LOWER**level, 3)
            counts.append([weights * even(self.robot, self.options) * share, slack, slack * unit, share])
        orders = np.concatenate([np.zeros(SIZE.orders), *tasks, np.ones(n), [0.0]])
        return orders, np.ascontiguousarray(np.concatenate(counts, axis=1))


class RuleSteps:
    """Makes a tracker follow its target by an iterative solver: one iteration per sample; the solver's state is kept in between."""

    gamma = 1.0
    chosen = False
    # A solver's iteration always lags behind a moving target, so its error does not show whether limits held it back.
    waits = False

    def __init__(self, robot: Robot | Tree, rule: Any, limits: bool, options: dict[str, Any]) -> None:
        """Bind a solver's iteration (rule) to the robot. options: its parameters. Raises what `ik.Solver` raises."""
        from ..solvers.solve import Solver

        self.robot = robot
        self.solver = Solver(robot, rule, **({"tolerance": 1e-9, "limits": limits} | options))
        self.name = self.solver.name
        self.memory = 4 * robot.n + 8
        self.loop = servo(type(self.solver.rule))
        self.options = self.solver.options

    def __getstate__(self) -> dict[str, Any]:
        """Return all attributes for pickling, without the compiled loop, which cannot be pickled."""
        return {name: value for name, value in vars(self).items() if name != "loop"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore the attributes and bind the compiled loop again."""
        vars(self).update(state, loop=servo(type(state["solver"].rule)))

    def settings(self, h: float) -> dict[str, float]:
        """Return the numerical parameters of the solver, by name; they do not depend on the sample time h [s]."""
        return {k: v for k, v in self.solver.rule._asdict().items() if isinstance(v, int | float)}

    def check(self, h: float) -> GainCheck | None:
        """Return None: for the iteration of a solver no formula says at which sample times h [s] it is stable."""
        return None

    def law(self, h: float) -> np.ndarray:
        """Return an array in the order of the fields of `Law`. A solver needs only gamma = 1 and a damping; all gains are 0."""
        law = np.zeros(len(laws.Law._fields))
        law[laws.PLACE.gamma], law[laws.PLACE.damping] = 1.0, DAMPING
        return law

    def natural(self, h: float) -> float:
        """Return the rate [1/s] at which an error is taken to fall in steps of h [s]: an iteration should remove all of it."""
        return 1.0 / h

    def orders(self, kinds: tuple) -> tuple[np.ndarray, np.ndarray]:
        """Return the task for the compiled loop: a flat array for the solver, and one (4, m) whose first row weights the errors.

        kinds: kind of target (KIND.pose or KIND.position) of each tip. The weights are only used for null-space motion. They are 0
        where no position error, or no rotation error, of a tip counts. The other rows are those of errors without slack and of one
        priority level, because the solver's iteration handles both itself.
        """
        counts = np.ones((4, 6 * len(kinds)))
        counts[1:3] = 0.0
        counted = counted_rows(self.robot, kinds, self.options).reshape(-1, 2, 3).any(axis=2)
        counts[0] = (np.repeat(counted, 3, axis=1) * even(self.robot, self.options)).ravel()
        return self.solver.plan.orders(kinds, True), counts


def bind(
    robot: Robot | Tree, method: Any, limits: bool, options: dict[str, Any], known: Iterable[str]
) -> Published | RuleSteps:
    """Return what makes a tracker follow its target: a control law (`Published`) or the iteration of a solver (`RuleSteps`).

    Args:
        robot: The robot.
        method: Name of a method or solver, a Method, or a solver's rule (its iteration).
        limits: Whether joint limits apply.
        options: Options of the method, and those that say which errors count.
        known: Names of further options of the calling function, which an error message may suggest for a misspelt one.

    Raises:
        InvalidOption: There is no such method, or it does not take one of the options.
    """
    check_options(method, options, known)
    if not is_published(method):
        return RuleSteps(robot, method, limits, options)
    counting = {name: options[name] for name in WORDS if name in options}
    others = {name: value for name, value in options.items() if name not in WORDS}
    return Published(robot, make_method(method, **others), counting)


def is_published(method: Any) -> bool:
    """Return whether `method` is one of the tracking methods (cv, av, ca, aa, aad) and not a solver."""
    return isinstance(method, Method) or (isinstance(method, str) and method in METHODS)


def check_options(method: Any, options: Iterable[str], known: Iterable[str]) -> None:
    """Raise InvalidOption if there is no such method, or if it does not take one of the options.

    known: names of further options of the calling function, which the error message may suggest for a misspelt one.
    """
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
            if meant is not None and (meant == option or nearest(option, here, ALIKE) is None):
                of = " and ".join(method for method, row in METHODS.items() if meant in row[1])
                if meant == option:
                    raise InvalidOption(f"{option} is an option of {of}, not of {name}")
                near = f" '{meant}' is an option of {of}.{near_match('', here)}"
            raise InvalidOption(f"{name} has no option '{option}'.{near}")
