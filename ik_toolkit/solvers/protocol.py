"""The interface of a solver, and the defaults for what a class leaves out.

A rule is one step of an iterative method; the search does the rest (kernel/search.py). A closed form lists the branches of one
target. Both are NamedTuple classes whose fields are their parameters, marked by `@rule` or `@closed_form`, which fill in what
the class leaves out. Nothing else in the toolkit asks for a solver by its name or class: it asks these calls, or the registry
row (`registry.Row`), which says what must be known without importing the class.
"""

import inspect
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeVar, overload

import numpy as np

from ..compile.jit import compiled
from ..errors import IKError, InvalidOption, UnknownSolver
from ..kernel.counted_error import POSE, POSITION
from ..kernel.search import entry
from .closed_form.geometry import Branches, Fit
from .closed_form.nearest import nearest_of
from .explain.worked_solution import WorkedSolution, listed_branches
from .options import NAMES, Options
from .registry import GENERAL, Row, find_row
from .task import counted_rows, counts_in_part

Class = TypeVar("Class", bound=type)
SHOWN = 16  # branches of a family in an explanation


@dataclass(frozen=True)
class Asked:
    """The request to a solver: the robot, a kind of target per tip, whether the caller gives q0, and the options.

    kinds: of kernel.task (POSE, POSITION, ...), a pair with the axis for AXIS.
    """

    robot: Any
    kinds: tuple = (POSE,)
    given: bool = True
    options: Options = field(default_factory=Options)

    @property
    def position_only(self) -> bool:
        """Whether no tip has a target orientation."""
        return all(kind == POSITION for kind in self.kinds)

    @property
    def rows(self) -> int:
        """How many rows of the task the joints can influence at all (a planar arm's position has two, not three)."""
        rng = np.random.default_rng(0)
        Q = np.array([self.robot.random_q(rng) for _ in range(4)])
        J = self.robot.chain.forward(Q, jacobian=True)[1]
        rows = np.abs(J).max(axis=(0, 2)) > 1e-9 * np.abs(J).max()
        return int((rows & counted_rows(self.robot, self.kinds, self.options)).sum())


class Rule(Protocol):
    """One step of an iterative method.

    `step(p, e)`, compiled, writes p.desk.dq (n,) and returns 0, SINGULAR_STEP or WAITING: see `solvers.rules`.
    """

    hold = False
    """Redo a step without the joints it would push past a limit; otherwise the step is cut off there."""
    wrap = False
    """Let a bounded joint with a full turn or more go on from the other end of its range."""
    preset: Any = None
    """Class method preset(name) -> rule with published or tuned parameters (see `presets`). Default None: there are none."""
    space: Any = None
    """Class method space(robot, position_only, initial) -> what `ik tune` searches (`space.Space`); with maps= where there are
    several. Default None: the fields called damping and gain."""

    def pack(self, robot: Any, asked: Asked | None = None) -> Any:
        """Numbers of the compiled step: a record of the class that has `step`, or an array of them. Default: the rule itself."""
        return self

    def refuses(self, asked: Asked) -> str:
        """Why the rule does not do what is asked ("needs as many task rows as joints, ..."), or ''."""
        return ""

    def start_table(self, robot: Any, position_only: bool) -> np.ndarray | None:
        """Starts (M, n) [rad, m] to choose from without q0. Default None: home, or the table of the robot."""
        return None

    def options(self) -> dict[str, Any]:
        """Options that come with the rule (a preset's tolerance); the caller's take precedence."""
        return {}

    def loop(self, robot: Any) -> Callable:
        """The compiled solve: see `kernel.search.entry`."""
        return entry(type(self))

    def lanes(self) -> Callable | None:
        """The same steps for eight targets side by side (arguments of `kernel.lanes.lanes`). Default None: there are none."""
        return None


class ClosedForm(Protocol):
    """All branches of one target at once, for the structures it recognises."""

    wrap = True
    hold = False

    @staticmethod
    def recognise(chain: Any) -> Fit:
        """Whether a chain has the structure, how nearly, and the numbers of the closed form."""
        ...

    def every(self, robot: Any, p: np.ndarray, T: np.ndarray, box: np.ndarray, count: int) -> Branches:
        """All branches of T (4, 4), as many as `count` of a family.

        p: what `pack` returned; box (4, n): lower and upper limits, the configuration to be near [rad or m], weights of the
        distance to it.
        """
        ...

    def derive(self, robot: Any, p: np.ndarray, T: np.ndarray, box: np.ndarray) -> WorkedSolution:
        """Formulas with their numbers for T (4, 4), to explain a solve. Default: the branches of `every` alone.

        p, box: as for `every`. box[2] is the answer to be explained, so what is free stays as it is there.
        """
        return listed_branches(robot, self.every(robot, p, T, box, SHOWN))

    def pack(self, robot: Any, asked: Asked | None = None) -> Any:
        """Numbers of the closed form. Default: those that `recognise` found. Raises UnknownSolver where it does not fit."""
        return fitted(self, robot).parameters

    def refuses(self, asked: Asked) -> str:
        """Why the closed form does not do what is asked, or ''."""
        return ""

    def held(self, robot: Any) -> dict[int, float]:
        """Joints (place in q) that the parameters put at a value [rad or m]."""
        return {}

    preset, space = Rule.preset, Rule.space
    start_table, options, lanes = Rule.start_table, Rule.options, Rule.lanes

    def loop(self, robot: Any) -> Callable:
        """The solve with the arguments of `kernel.search.entry`. Default: of `every`, the nearest that meets the tolerances."""
        return nearest_of(self, robot)


@overload
def rule(cls: Class) -> Class: ...
@overload
def rule(*, step: type) -> Callable[[Class], Class]: ...
def rule(cls: Any = None, *, step: Any = None) -> Any:
    """Class decorator: turn a NamedTuple class with a `step` into a rule.

    step: the `@compiled` class that has the step, where that is another one: `pack` makes it of the parameters. Raises
    TypeError where there is no step, nothing for numba to pass (a record without fields), or a field named like an option.
    """

    def mark(cls: Any) -> Any:
        record = step or cls
        if not hasattr(record, "_fields") or not hasattr(record, "step"):
            raise TypeError(f"{cls.__name__}: a rule is a NamedTuple class with a method step(self, p, e)")
        if not record._fields:
            raise TypeError(
                f"{cls.__name__}: numba cannot pass a record without fields; give it at least one parameter"
            )
        if step is None:
            compiled(cls)
        cls.COMPILED = record
        return _filled(cls, Rule)

    return mark if cls is None else mark(cls)


def closed_form(cls: Class) -> Class:
    """Class decorator: turn a NamedTuple class with `recognise` and `every` into one. Raises TypeError without them."""
    for name in ("_fields", "recognise", "every"):
        if not hasattr(cls, name):
            raise TypeError(f"{cls.__name__}: a closed form is a NamedTuple class with `recognise` and `every`")
    return _filled(cls, ClosedForm)


def _filled(cls: Any, protocol: Any) -> Any:
    for name in cls._fields:
        if name in NAMES:  # `solve` takes both as keywords, and one would hide the other
            raise TypeError(f"{cls.__name__}: '{name}' is an option of every solver; give the parameter another name")
    if hasattr(cls, "pack") and len(inspect.signature(cls.pack).parameters) < 3:
        raise TypeError(f"{cls.__name__}: pack takes (self, robot, asked)")
    for name, value in vars(protocol).items():
        if not name.startswith("_") and not hasattr(cls, name):
            setattr(cls, name, value)
    return cls


# -------------------------------------------------------------------------------------------------------------- asking
def misfit(row: Row, solver: Any, robot: Any) -> str:
    """Why a solver cannot run on a robot, whatever the target; or ''."""
    if row.one_tip and len(robot.tips) > 1:
        return f"solver '{row.name}' is for one tip; for several use '{GENERAL}'"
    if row.closed and (reason := solver.recognise(robot.chain).reason):
        return f"solver '{row.name}' does not fit robot '{robot.name}': {reason}"
    return ""


def fitted(form: Any, robot: Any) -> Fit:
    """Structure that a closed form recognises in a robot. Raises UnknownSolver with the reason where it does not fit."""
    if reason := misfit(find_row(form), form, robot):
        raise UnknownSolver(reason)
    return form.recognise(robot.chain)


def require(row: Row, solver: Any, asked: Asked) -> None:
    """Raise UnknownSolver where the solver does not fit the robot, InvalidOption where it does not do what is asked."""
    if reason := misfit(row, solver, asked.robot):
        raise UnknownSolver(reason)
    if reason := refusal(row, solver, asked):
        raise InvalidOption(f"solver '{row.name}' {reason}")


def refusal(row: Row, solver: Any, asked: Asked) -> str:
    """Why a solver does not do what is asked on a robot it fits, or ''. To be preceded by the solver's name."""
    o = asked.options
    if row.closed and (o.closest or o.follow or counts_in_part(asked.kinds, o)):
        return f"is a closed form and takes no mask, slack, free_turn, axis target, closest or follow; use '{GENERAL}'"
    if row.moves_all and o.joint_weights is not None and 0.0 in o.joint_weights:
        return f"moves every joint, so it cannot hold one (joint weight 0); use '{GENERAL}'"
    for kind, word, solved in ((POSITION, "positions", row.position), (POSE, "poses", row.pose)):
        if kind in asked.kinds and not solved:
            return f"does not solve {word}: {row.handles}"
    return solver.refuses(asked)


def parameters(row: Row, solver: Any, asked: Asked) -> np.ndarray:
    """Numbers of the compiled step. Raises InvalidOption when a parameter is missing or not finite."""
    try:
        numbers = np.asarray(solver.pack(asked.robot, asked), dtype=float)
    except IKError:
        raise
    except (TypeError, ValueError, OverflowError):
        numbers = np.array(np.nan)
    if numbers.ndim != 1 or not np.isfinite(numbers).all():
        given = ", ".join(f"{key}={value!r:.60}" for key, value in solver._asdict().items() if value is not None)
        raise InvalidOption(f"the parameters of solver '{row.name}' must be finite numbers, not {given}")
    return numbers
