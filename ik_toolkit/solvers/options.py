"""Options every solver understands, with their defaults: one table, used by the API, the CLI and `ik solvers NAME`."""

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, Literal, TypedDict

import numpy as np

from ..errors import InvalidOption, doubt_angles, floats, near_match
from ..robot.geometry.collision import CollisionModel, as_margin
from ..robot.pose import named_axis

# Values of the options that turn off choosing among solutions and improving one. Searches that only collect solutions use them.
PLAIN: dict[str, Any] = {
    "closest": False, "objective": None, "history": False, "check": False, "avoid_collisions": False
}  # fmt: skip
MAX_ITERATIONS = 1_000_000  # upper bound on the value of the option max_iterations
# A solve with a timeout runs in pieces and reads the clock after each. The first has SLICE evaluations, which take about 0.25 ms.
SLICE = 256
FOLLOW = 0.5  # [rad, or length / reach] with the option follow=True no joint may move farther than this from q0
WORDS = {
    "objective": ("mid-range", "reference", "manipulability"),
    "q0_outside": ("clamp", "refuse"),
    "frame": ("base", "tip", "target"),
}
OTHERWISE = {  # names of options in other packages, each with a message that says what to use here
    "from_q": "there is no option 'from_q'; the target that a configuration reaches is robot.fk(q)",
}
AVOID = "avoid_collisions must be True, a margin of at least 0 [m] or a CollisionModel"
# Names of the options that say which part of a tip's pose error counts. Each is one value for every tip, or a dict by tip.
COUNTING = ("mask", "slack", "free_turn", "frame")
GROUPS = ("position", "orientation")  # the two groups of a tip's errors that the option `priority` can put in order


@dataclass(frozen=True)
class Options:
    """Options of a solve, the same for every solver.

    position_tolerance [m], orientation_tolerance [rad]: both errors of a solution must be below them; at least 1e-14.
    max_iterations: steps per attempt; restarts: further attempts from other starts (None: the solver's own). max_evaluations:
    budget of FK evaluations over all attempts. timeout: the same budget in seconds, which is not deterministic;
    max_evaluations=result.fk_evaluations gives the same answer again. At least 256 evaluations are always made. seed: number that
    fixes the random starts. length_scale: after a failure q is a local minimum of the error, in which a position error of this
    length [m] counts as much as one radian (None: the robot's reach). limits: whether joints are kept inside their limits.
    Functions with these options also accept narrower limits: a dict from joints to (lower, upper), or a pair of arrays (see
    `robot.narrowed`). wrap: whether a bounded joint with a range of 2 pi or more may continue from the other end of its range,
    where it stops otherwise (None: the solver's own way; the default search wraps, the published methods stop).
    q0_outside: 'clamp' (with a notice) or 'refuse'.

    These options say which part of the errors counts. A tip has the errors x, y, z [m] (target - tip) and rx, ry, rz [rad] (the
    rotation vector left), along the axes of `frame`: 'base', 'tip' or 'target'. First, free_turn is a tip axis ("z", or three
    numbers) about which rotation is free. Then slack (6,) are half widths of dead bands, inside which the error is zero (inf, or pi
    for a rotation, frees a component). Then mask (6,) are weights (0 = free). Each is one value for every tip or a dict by tip, and
    the tolerances hold for what is left.

    priority: which errors come first. "position" solves the position to its tolerance and makes the orientation as good as that
    allows; "orientation" is the other way round. For several tips it may be a list, most important first, of tips ("left_tip"),
    pairs ("left_tip", "position"), or lists of these that are equally important; what is not named comes last.

    relative_to: for a Tree, a dict from a tip to the tip in whose frame its target is given. joint_weights (n,): how freely each
    joint moves (1 = as usual, 0 = held where q0, or home, has it). closest: of several solutions return the one nearest q0.
    objective: for redundant tasks, what to improve in the null space once solved: 'mid-range', 'reference' (near q0) or
    'manipulability'. history: keep errors and q of every iteration. check: re-check with Pinocchio. avoid_collisions: True (the
    robot's own links), a margin [m] to keep between them, or a CollisionModel: only answers without contact count, and the search
    continues until one is found. follow: for control loops, one attempt from q0 (required) in which no joint moves further than
    this [rad; prismatic joints: times the robot's reach]; True is 0.5. A target beyond that ends as TOO_FAR. It cannot be combined
    with closed forms, closest, restarts or objective.
    """

    position_tolerance: float = 1e-6
    orientation_tolerance: float = 1e-6
    max_iterations: int | None = None
    restarts: int | None = None
    max_evaluations: int | None = None
    timeout: float | None = None
    seed: int = 0
    length_scale: float | None = None
    limits: bool = True
    wrap: bool | None = None
    q0_outside: str = "clamp"
    mask: Any = None
    slack: Any = None
    free_turn: Any = None
    frame: Any = "base"
    priority: Any = None
    relative_to: dict[str, str] | None = None
    joint_weights: tuple[float, ...] | None = None
    closest: bool = False
    objective: str | None = None
    history: bool = False
    check: bool = True
    avoid_collisions: Any = False
    follow: float = 0.0

    @functools.cached_property  # computed once, because every check of an answer needs it
    def in_part(self) -> bool:
        """Whether only part of the errors counts, or targets are relative to another tip."""
        return any(getattr(self, name) is not None for name in (*COUNTING[:3], "relative_to"))

    @property
    def budget(self) -> int | None:
        """Largest number of FK evaluations of the search (with a timeout: of its first, shortest run); None for no limit."""
        return SLICE if self.timeout is not None and self.max_evaluations is None else self.max_evaluations


NAMES = tuple(field.name for field in fields(Options))
Numbers = Sequence[float] | np.ndarray


End = float | None  # lower or upper end of a narrowed joint range; None leaves that end unchanged
Limits = bool | Mapping[str, tuple[End, End] | Sequence[End]] | Sequence[Numbers | None] | np.ndarray


class PathOptions(TypedDict, total=False):
    """Options (see `Options`) that `solve_path` takes by keyword: tolerances, limits, and which part of the errors counts."""

    tolerance: float
    position_tolerance: float
    orientation_tolerance: float
    limits: Limits
    mask: Numbers | Mapping[str, Numbers | None] | None
    slack: Numbers | Mapping[str, Numbers | None] | None
    free_turn: str | Numbers | Mapping[str, str | Numbers | None] | None
    frame: Literal["base", "tip", "target"] | Mapping[str, Literal["base", "tip", "target"]]
    priority: Any
    relative_to: Mapping[str, str] | None
    joint_weights: Numbers | None


class BatchOptions(PathOptions, total=False):
    """Keyword arguments of `solve_batch`, for editors and type checkers: options (see `Options`) and parameters of our solvers."""

    max_iterations: int | None
    restarts: int | None
    max_evaluations: int | None
    seed: int
    length_scale: float | None
    wrap: bool | None
    q0_outside: Literal["clamp", "refuse"]
    closest: bool | Numbers
    objective: Literal["mid-range", "reference", "manipulability"] | None
    avoid_collisions: Any
    follow: bool | float
    # The parameters of our solvers follow.
    damping: float
    hold: bool
    gain: float
    rcond: float
    kp: float | None
    ki: float
    kd: float | None
    orientation_scale: float | None
    A: Any
    B: Any
    C: Any
    D: Any
    units: str
    tuned: Any
    lift: float | str
    line_search: bool


class AllOptions(BatchOptions, total=False):
    """Keyword arguments of `solve_all`; its `check` is True or False, whereas that of a batch is a fraction of the results."""

    check: bool
    history: bool


class SolveOptions(AllOptions, total=False):
    """Keyword arguments of `solve` and `Solver`; their `starts` are configurations, whereas those of `solve_all` are a number."""

    starts: Any
    timeout: float | None


def avoided(value: Any) -> bool | float | CollisionModel:
    """Check a value of the option avoid_collisions: False (also for None), True, a margin [m] or a model. Raises InvalidOption."""
    if isinstance(value, CollisionModel):
        return value
    if value is None or isinstance(value, bool | np.bool_):
        return bool(value)
    return as_margin(value, AVOID)


def changed(carried: Mapping[str, Any], given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options that come with a rule or preset, changed by those given; a given `tolerance` replaces both tolerances."""
    both = "tolerance" in given
    return {name: value for name, value in carried.items() if not (both and name.endswith("_tolerance"))} | dict(given)


def make_options(given: dict[str, Any], parameters: Sequence[str] = ()) -> Options:
    """Return Options of validated keyword arguments; `tolerance` sets both tolerances. Raises InvalidOption naming the option.

    `parameters` are the solver's own parameter names, which may be suggested for a misspelt name.
    """
    values = dict(given)
    if "tolerance" in values:
        tolerance = _tolerance("tolerance", values.pop("tolerance"))
        values.setdefault("position_tolerance", tolerance)
        values.setdefault("orientation_tolerance", tolerance)
    for name, value in values.items():
        if name in OTHERWISE:
            raise InvalidOption(OTHERWISE[name])
        if name not in NAMES:
            from .registry import solvers_with  # imported only for errors, because the registry loads each solver

            known = (*parameters, "tolerance", *NAMES)
            raise InvalidOption(f"there is no option '{name}'.{near_match(name, known)}{solvers_with(name, known)}")
        if name in COUNTING and isinstance(value, Mapping):
            values[name] = {tip: _read(name, one) for tip, one in value.items()}
        else:
            values[name] = _read(name, value)
    refused = [name for name in ("closest", "restarts", "objective") if values.get("follow") and values.get(name)]
    if refused:
        raise InvalidOption(
            f"follow makes one attempt that stays near q0, so it cannot be combined with {' and '.join(refused)}"
        )
    if values.get("timeout") is not None and values.get("max_evaluations") is not None:
        raise InvalidOption("give timeout or max_evaluations, not both: each ends the search")
    return Options(**values)


def _read(name: str, value: Any) -> Any:
    """Return a value of the option `name`, for all tips or for one, as Options keeps it; None only where that is the default."""
    return None if value is None and getattr(Options, name) is None else READERS[name](name, value)


def levels_of(value: Any) -> tuple[tuple[tuple[str, str], ...], ...]:
    """Convert the option `priority` to levels, most important first, each a tuple of pairs (tip, "position" or "orientation").

    The tip "" means every tip. Raises InvalidOption.
    """
    pair = isinstance(value, tuple) and len(value) == 2 and isinstance(value[1], str) and value[1] in GROUPS
    single = isinstance(value, str) or pair
    levels = [value] if single else value
    if not isinstance(levels, list | tuple) or not levels:
        raise InvalidOption(
            f"priority must be 'position', 'orientation' or a list of tips and pairs, not {value!r:.60}"
        )
    alike = [list(level) if isinstance(level, list) and level else [level] for level in levels]
    return tuple(tuple(pair for one in level for pair in _groups_of(one)) for level in alike)


def _groups_of(entry: Any) -> list[tuple[str, str]]:
    """Return the pairs (tip, group) of one entry of `priority`."""
    if isinstance(entry, str) and entry:
        return [("", entry)] if entry in GROUPS else [(entry, group) for group in GROUPS]
    if isinstance(entry, tuple) and len(entry) == 2 and all(isinstance(x, str) and x for x in entry):
        if entry[1] not in GROUPS:
            raise InvalidOption(
                f"priority: {entry[1]!r} is neither 'position' nor 'orientation'.{near_match(entry[1], GROUPS)}"
            )
        return [(entry[0], entry[1])]
    raise InvalidOption(f"priority: {entry!r:.60} is neither a tip nor a pair such as ('tip', 'position')")


def _tolerance(name: str, value: Any) -> float:
    number = _number(name, value, 1e-14)  # A tolerance below 1e-14 is smaller than the rounding of the error itself.
    if name == "orientation_tolerance" and number >= math.pi:
        doubt_angles(name, {"": number})
    return number


def _whole(name: str, value: Any) -> int:
    if name == "seed" and isinstance(value, list | tuple | np.ndarray):  # other packages call the start (q0) a seed
        raise InvalidOption("seed is the random seed of the restarts; the start is q0")
    low = 1 if name == "max_evaluations" else 0
    if isinstance(value, bool) or int(_number(name, value, low, 2**31)) != value:
        raise InvalidOption(f"{name} must be a whole number of at least {low}, not {value!r}")
    if name == "max_iterations" and value > MAX_ITERATIONS:
        raise InvalidOption(
            f"max_iterations is at most {MAX_ITERATIONS}, not {value}; use restarts for longer searches"
        )
    return int(value)


def _switch(name: str, value: Any) -> bool:
    if not isinstance(value, bool | np.bool_):  # only True or False, because a text such as "no" counts as true
        hint = " (q0 is what the solution is nearest to)" if name == "closest" else ""
        raise InvalidOption(f"{name} must be True or False here{hint}, not {value!r:.60}")
    return bool(value)


def _word(name: str, value: Any) -> str:
    if not (isinstance(value, str) and value in WORDS[name]):
        raise InvalidOption(f"{name} must be one of {', '.join(WORDS[name])}, not {value!r}")
    return value


def _mask(name: str, value: Any) -> tuple[float, ...] | None:
    """Return six weights; None for ones, which change nothing."""
    weights = _weights(name, value)
    if len(weights) != 6:
        raise InvalidOption(f"mask must have six weights (x, y, z, rx, ry, rz), not {len(weights)}")
    return weights if set(weights) != {1.0} else None


def _slack(name: str, value: Any) -> tuple[float, ...] | None:
    """Return six half widths; None for zeros, which change nothing."""
    array = floats(value, f"{name} must be numbers", InvalidOption)
    if array.shape != (6,) or not (array >= 0).all():
        raise InvalidOption(
            f"slack must have six half widths of at least 0 (x, y, z [m], rx, ry, rz [rad]; inf frees one), not {value!r}"
        )
    return tuple(array.tolist()) if array.any() else None


def _free_turn(name: str, value: Any) -> tuple[float, ...]:
    array = floats(named_axis(value, name, InvalidOption), f"{name} must be numbers", InvalidOption)
    length = float(np.linalg.norm(array)) if array.shape == (3,) else 0.0
    if not 1e-9 < length < math.inf:  # A shorter vector has no usable direction.
        raise InvalidOption(f"free_turn must be an axis of the tip, three numbers that are not all 0, not {value!r}")
    return tuple((array / length).tolist())


def _relative_to(name: str, value: Any) -> dict[str, str] | None:
    if not isinstance(value, Mapping) or not all(isinstance(x, str) for pair in value.items() for x in pair):
        raise InvalidOption(f"{name} must be a dict from a tip to the tip its target is relative to, not {value!r}")
    return dict(value) or None


def _weights(name: str, value: Any) -> tuple[float, ...]:
    # Besides numbers, booleans ("b") are accepted: True counts as 1.
    array = floats(value, f"{name} must be numbers of at least 0", InvalidOption, "fiub")
    if array.ndim != 1 or not np.isfinite(array).all() or (array < 0).any() or not array.any():
        raise InvalidOption(f"{name} must be numbers of at least 0, not all 0: {value!r}")
    return tuple(array.tolist())


def _number(name: str, value: Any, low: float = 0.0, high: float = math.inf) -> float:
    number = floats(value, f"{name} must be a number", InvalidOption)
    if number.shape != ():
        raise InvalidOption(f"{name} must be a number, not an array of shape {number.shape}")
    number = float(number)
    if not low <= number <= high or number == math.inf:
        allowed = f"between {low:.10g} and {high:.10g}" if high < math.inf else f"finite and at least {low:.10g}"
        raise InvalidOption(f"{name} must be {allowed}, not {value!r}")
    return number


READERS: dict[
    str, Callable[[str, Any], Any]
] = {  # for each option, the function that checks a value given by the user and converts it to the one stored in Options
    **dict.fromkeys(("position_tolerance", "orientation_tolerance"), _tolerance),
    **dict.fromkeys(("max_iterations", "restarts", "max_evaluations", "seed"), _whole),
    **dict.fromkeys(("limits", "wrap", "closest", "history", "check"), _switch),
    **dict.fromkeys(WORDS, _word),
    "timeout": _number,
    "length_scale": lambda name, value: _number(name, value, 1e-6),
    "mask": _mask,
    "slack": _slack,
    "free_turn": _free_turn,
    "priority": lambda _, value: levels_of(value),
    "relative_to": _relative_to,
    "joint_weights": _weights,
    "avoid_collisions": lambda _, value: avoided(value),
    "follow": lambda name, value: FOLLOW * value if isinstance(value, bool | np.bool_) else _number(name, value),
}
