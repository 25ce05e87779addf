"""The interface of a solver, and the defaults for what a class leaves out.

A rule is one step of an iterative method; the search does everything else (kernel/search.py). A closed form lists the branches of
one target. Both are NamedTuple classes whose fields are their parameters. The decorators `@rule` and `@closed_form` mark them, and
add the methods that a class leaves out. The rest of the toolkit never tests a solver's name or class. It uses these methods, or the
solver's row in the registry (`registry.Row`), which can be read without importing the class.
"""

import inspect
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeVar, overload

import numpy as np

from ..compile.jit import compiled
from ..errors import IKError, InvalidOption, UnknownSolver
from ..kernel.counted_error import KIND
from ..kernel.search import entry
from .closed_form.geometry import Branches, Fit
from .closed_form.nearest import nearest_of
from .explain.worked_solution import WorkedSolution, listed_branches
from .options import NAMES, Options
from .registry import GENERAL, find_row
from .rows import Row
from .task import counted_rows, counts_in_part

Class = TypeVar("Class", bound=type)
SHOWN = 16  # An explanation of a solve shows this many samples of a self-motion.


@dataclass(frozen=True)
class Asked:
    """What a solver is asked to do: the robot, the kind of each tip's target, whether the caller gives q0, and the options.

    A kind is pose, position or free (`kernel.counted_error.TargetKinds`), or a pair (AXIS, axis) for a target that leaves the
    turn about a tip axis free.
    """

    robot: Any
    kinds: tuple = (KIND.pose,)
    given: bool = True
    options: Options = field(default_factory=Options)

    @property
    def position_only(self) -> bool:
        """Whether the target of every tip is a position, without an orientation."""
        return all(kind == KIND.position for kind in self.kinds)

    @property
    def span(self) -> np.ndarray:
        """Orthonormal basis (6 F, r) of the pose errors of the F tips that some joint motion can change at all.

        The position of a planar arm, for example, adds two columns, not three. Lengths are divided by the robot's length scale.
        """
        rng = np.random.default_rng(0)
        Q = np.array([self.robot.random_q(rng) for _ in range(4)])
        J = np.concatenate(list(self.robot.chain.forward(Q, jacobian=True)[1] * self.robot.chain.unit), axis=1)
        J[np.arange(len(J)) % 6 < 3] /= self.robot.chain.scale
        J[~counted_rows(self.robot, self.kinds, self.options)] = 0.0
        U, size, _ = np.linalg.svd(J, full_matrices=False)
        return U[:, size > 1e-9 * size[0]]

    @property
    def rows(self) -> int:
        """Number of independent pose errors that the joints of the robot can change."""
        return self.span.shape[1]


class Rule(Protocol):
    """Base class of iterative solvers: a rule computes one step dq from the error and the Jacobian.

    The search around it tests, counts and restarts. `step(p, e)` is compiled; p is the problem (robot and target), e the error.
    It writes the step to p.desk.dq (n,) and returns 0, SINGULAR_STEP or WAITING (see `solvers.rules`).
    """

    hold = False
    """True: joints that a step would push past a limit are held and the step is computed again; False: it is clipped there."""
    wrap = False
    """Whether a bounded joint with a range of 2 pi or more may continue from the other end of its range."""
    preset: Any = None
    """Class method preset(name) that returns a rule with published or tuned parameters (see `presets`), or None."""
    space: Any = None
    """Class method space(robot, position_only, initial) that returns what `ik tune` searches (`tuning_space.Space`).

    A method with several maps also takes maps=. None, the default, means that the fields damping and gain are tuned.
    """

    def pack(self, robot: Any, asked: Asked | None = None) -> Any:
        """Return the parameters of the compiled step: a NamedTuple with a method `step`, an array, or (default) the rule itself."""
        return self

    def refuses(self, asked: Asked) -> str:
        """Return why the rule cannot do what is asked ("needs as many task rows as joints, ..."), or '' if it can."""
        return ""

    def start_table(self, robot: Any, position_only: bool) -> np.ndarray | None:
        """Return this rule's own starts (M, n) [rad or m] for attempts without q0; None means the robot's usual ones."""
        return None

    def options(self) -> dict[str, Any]:
        """Return the options of the preset from which the rule was made (its field `tuned`), used where the caller gives none."""
        return dict(getattr(self, "tuned", None) or {})

    def loop(self, robot: Any) -> Callable:
        """Return the compiled function that solves targets with this rule; `kernel.search.entry` describes its arguments."""
        return entry(type(self))

    def lanes(self) -> Callable | None:
        """Return the compiled function that solves eight targets at once (see `kernel.simd_search.lanes`), or None."""
        return None


class ClosedForm(Protocol):
    """A solver that computes all solutions (branches) of a target without iterating, for arms whose geometry it recognises."""

    wrap = True
    hold = False

    @staticmethod
    def recognise(chain: Any) -> Fit:
        """Return a Fit: whether, and how exactly, the geometry of a chain suits this closed form, and the parameters for it."""
        ...

    def every(self, robot: Any, p: np.ndarray, T: np.ndarray, box: np.ndarray, count: int) -> Branches:
        """Return all solutions (branches) of the target T (4, 4); of a continuum of them (self-motion), about `count` samples.

        p is the result of `pack`; box (4, n) has lower limits, upper limits, reference configuration [rad or m] and distance
        weights.
        """
        ...

    def derive(self, robot: Any, p: np.ndarray, T: np.ndarray, box: np.ndarray) -> WorkedSolution:
        """Return the formulas with their numbers for T (4, 4), to explain a solve; by default the branches of `every` alone.

        p and box are as for `every`; the reference configuration box[2] is the answer to be explained, so that free
        angles keep its values.
        """
        return listed_branches(robot, self.every(robot, p, T, box, SHOWN))

    def pack(self, robot: Any, asked: Asked | None = None) -> Any:
        """Return the parameters of the closed form for a robot, by default those that `recognise` found.

        Raises UnknownSolver if the robot does not fit.
        """
        return fitted(self, robot).parameters

    def refuses(self, asked: Asked) -> str:
        """Return why the closed form cannot do what is asked, or '' if it can."""
        return ""

    def held(self, robot: Any) -> dict[int, float]:
        """Return {index in q: value [rad or m]} of the joints that parameters of this closed form hold fixed; by default none."""
        return {}

    preset, space = Rule.preset, Rule.space
    start_table, options, lanes = Rule.start_table, Rule.options, Rule.lanes

    def loop(self, robot: Any) -> Callable:
        """Return a function that solves; by default it takes the nearest branch of `every` that meets the tolerances.

        The function is called as solve(rows, ends, seeds, features, T, Q0, out, orders, history). The first four are arrays of
        the chain; T, Q0 and orders are targets, starts and options as for `kernel.search.entry`; the results are written to
        `out`, the history of a single target to `history`.
        """
        return nearest_of(self, robot)


@overload
def rule(cls: Class) -> Class: ...
@overload
def rule(*, step: type) -> Callable[[Class], Class]: ...
def rule(cls: Any = None, *, step: Any = None) -> Any:
    """Class decorator that turns a NamedTuple class with a method `step` into a rule (see `protocol.Rule`).

    Args:
        cls: The class; its fields are the rule's parameters.
        step: The `@compiled` class that has the step, if it is another one; `pack` makes it from the parameters.

    Returns:
        The class, with the defaults of `protocol.Rule` for what it leaves out.

    Raises:
        TypeError: There is no step, there are no fields (numba passes no empty NamedTuple), or a field is named like an option.
    """

    def mark(cls: Any) -> Any:
        record = step or cls
        if not hasattr(record, "_fields") or not hasattr(record, "step"):
            raise TypeError(
                f"{getattr(cls, '__name__', repr(cls))}: a rule is a NamedTuple class with a method step(self, p, e)"
            )
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
    """Class decorator that turns a NamedTuple class with the methods `recognise` and `every` into a closed form (see `ClosedForm`).

    Args:
        cls: The class; its fields are the closed form's parameters.

    Returns:
        The class, with the defaults of `protocol.ClosedForm` for what it leaves out.

    Raises:
        TypeError: `recognise` or `every` is missing, or a field is named like an option.
    """
    for name in ("_fields", "recognise", "every"):
        if not hasattr(cls, name):
            raise TypeError(
                f"{getattr(cls, '__name__', repr(cls))}: a closed form is a NamedTuple class with `recognise` and `every`"
            )
    return _filled(cls, ClosedForm)


def _filled(cls: Any, protocol: Any) -> Any:
    for name in cls._fields:
        if name in NAMES:  # `solve` takes both parameters and options as keywords, so their names must differ
            raise TypeError(f"{cls.__name__}: '{name}' is an option of every solver; give the parameter another name")
    if hasattr(cls, "pack") and len(inspect.signature(cls.pack).parameters) < 3:
        raise TypeError(f"{cls.__name__}: pack takes (self, robot, asked)")
    for name, value in vars(protocol).items():
        if not name.startswith("_") and not hasattr(cls, name):
            setattr(cls, name, value)
    return cls


# -------------------------------------------------------------------------------------------------------------- asking
def misfit(row: Row, solver: Any, robot: Any) -> str:
    """Return why a solver cannot run on a robot, whatever the target, or '' if it can."""
    if row.one_tip and len(robot.tips) > 1:
        return f"solver '{row.name}' is for one tip; for several use '{GENERAL}'"
    if row.closed and (reason := solver.recognise(robot.chain).reason):
        return f"solver '{row.name}' does not fit robot '{robot.name}': {reason}"
    return ""


def fitted(form: Any, robot: Any) -> Fit:
    """Return the Fit of a closed form to a robot. Raises UnknownSolver, with the reason, if the robot does not fit."""
    if reason := misfit(find_row(form), form, robot):
        raise UnknownSolver(reason)
    return form.recognise(robot.chain)


def require(row: Row, solver: Any, asked: Asked) -> None:
    """Raise UnknownSolver if a solver does not fit a robot, InvalidOption if it cannot do the task."""
    if reason := misfit(row, solver, asked.robot):
        raise UnknownSolver(reason)
    if reason := refusal(row, solver, asked):
        raise InvalidOption(f"solver '{row.name}' {reason}")


def refusal(row: Row, solver: Any, asked: Asked) -> str:
    """Return why a solver cannot do a task although it fits the robot, or ''; the text is to follow the solver's name."""
    o = asked.options
    if row.closed and (o.closest or o.follow or counts_in_part(asked.kinds, o)):
        return f"is a closed form and takes no mask, slack, free_turn, axis target, closest or follow; use '{GENERAL}'"
    if o.priority is not None and not row.levels:
        return "has all errors at one level, so it takes no priority; leave the solver out"
    if row.moves_all and o.joint_weights is not None and 0.0 in o.joint_weights:
        return f"moves every joint, so it cannot hold one (joint weight 0); use '{GENERAL}'"
    for kind, word, solved in ((KIND.position, "positions", row.position), (KIND.pose, "poses", row.pose)):
        if kind in asked.kinds and not solved:
            return f"does not solve {word}: {row.handles}"
    return solver.refuses(asked)


def parameters(row: Row, solver: Any, asked: Asked) -> np.ndarray:
    """Return the parameters of a solver as an array (K,) of the numbers that its compiled code reads (see `pack`).

    Raises InvalidOption if one is missing, not finite, or complex.
    """
    try:
        if any(np.iscomplexobj(value) for value in solver):  # numpy would drop the imaginary part with a mere warning
            raise TypeError
        numbers = np.asarray(solver.pack(asked.robot, asked), dtype=float)
    except IKError:
        raise
    except (TypeError, ValueError, OverflowError):
        numbers = np.array(np.nan)
    if numbers.ndim != 1 or not np.isfinite(numbers).all():
        given = ", ".join(f"{key}={value!r:.60}" for key, value in solver._asdict().items() if value is not None)
        raise InvalidOption(f"the parameters of solver '{row.name}' must be finite numbers, not {given}")
    return numbers
