"""The registry of solvers, with one row for each; the CLI, `ik solvers`, the docs, the benchmark and contract tests use the rows.

Rows are plain data with dotted names, so that listing them imports neither Pinocchio nor numba. Another package registers a solver
by an entry point of the group `ik_toolkit.solvers`, named as the solver and leading to its row:

    [project.entry-points."ik_toolkit.solvers"]
    half-step = "my_package.rows:HALF_STEP"

where `my_package/rows.py` imports only this module and defines HALF_STEP = Row("half-step", "my_package.half_step:HalfStep", ...).
So its solvers are listed without importing the code that solves.
"""

import functools
import hashlib
import importlib
import importlib.util
import logging
import math
import re
import sys
import traceback
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

from ..errors import IKError, InvalidOption, UnknownSolver, near_match, nearest


class Length(NamedTuple):
    """Default limits on the length of a search.

    `give_up` is (C, rho, C_free, rho_free) or None: an attempt ends in iteration k if |e|^2 > C rho^k (first pair: precomputed
    starts, second pair: q0 and random starts). Attempts from random starts have twice the iterations and are given up later from
    attempt number `patience` on (the attempt from q0 is not counted).
    """

    iterations: int = 1000  # largest number of iterations of an attempt
    attempts: int = 1
    give_up: tuple[float, float, float, float] | None = None
    patience: float = math.inf


LENGTH = Length()


@dataclass(frozen=True)
class Row:
    """The registry's entry for a solver: what is known without importing it.

    `target` is "module:Class" of the rule or closed form, `search` its default length, `several` the same for several tips if that
    differs. `pose` and `position` say whether it solves such targets. A solver that is `one_tip` is not for several tips; one that
    `moves_all` moves every joint, so none can be held by a weight of 0; one that `tracks` makes sense with one step per sample.
    `joints` are the numbers of joints that a closed form may fit, which 'auto' uses. `levels` is true of the solver that serves the
    option `priority`. `package` is the package it comes from, if not this one (see `registered`), `cls` the class if it need not be
    imported. A solver declares everything else itself (see `protocol`).
    """

    name: str
    target: str
    summary: str
    handles: str
    citation: str
    search: Length = LENGTH
    several: Length | None = None
    closed: bool = False
    pose: bool = True
    position: bool = True
    one_tip: bool = False
    moves_all: bool = False
    tracks: bool = True
    joints: tuple[int, ...] = ()
    levels: bool = False
    package: str = ""
    cls: Any = None

    def load(self) -> Any:
        """Import and return the class. Raises UnknownSolver if another package's class cannot be imported or is not a solver."""
        if self.cls is not None:
            return self.cls
        module, name = self.target.split(":")
        try:
            cls = getattr(importlib.import_module(module), name)
        except Exception as error:
            if not self.package or isinstance(error, IKError):
                raise
            what = f"{type(error).__name__}: {error}"
            raise UnknownSolver(f"solver '{self.name}' of package {self.package} cannot be loaded: {what}") from error
        if not hasattr(cls, "loop"):
            raise UnknownSolver(
                f"solver '{self.name}': {self.target} is not a solver; put @ik_toolkit.rule above the class"
            )
        return cls

    def length(self, tips: int = 1) -> Length:
        """Return how long the search continues for this number of tips."""
        return self.several if tips > 1 and self.several is not None else self.search


_RULES = "ik_toolkit.solvers.rules."
_CLOSED = "ik_toolkit.solvers.closed_form."
_CLOSED_FORM: dict[str, Any] = dict(search=Length(0), closed=True, one_tip=True, moves_all=True, tracks=False)
ROWS: tuple[Row, ...] = (
    Row(
        "lm",
        _RULES + "jacobian:LM",
        "Levenberg-Marquardt: error-based damping, joint limits enforced, restarts from a table of starts (default)",
        "any robot; position, pose, masks",
        "Sugihara 2011",
        # The bounds that end an attempt early were measured on six arms; easy targets are solved by attempt 20.
        search=Length(30, 250, (30.0, 0.18, 100.0, 0.35), 20),
        several=Length(40, 400, (60.0, 0.25, 200.0, 0.4)),
    ),
    Row(
        "dls",
        _RULES + "jacobian:DLS",
        "Damped least squares with constant damping",
        "any robot; position, pose, masks",
        "Wampler 1986",
    ),
    Row(
        "pinv",
        _RULES + "jacobian:Pinv",
        "Jacobian pseudo-inverse by singular values",
        "any robot; position, pose, masks",
        "Whitney 1969; Burrell 2016 eq. 7",
    ),
    Row(
        "transpose",
        _RULES + "jacobian:Transpose",
        "Jacobian transpose with the exact line-search gain",
        "any robot; position, pose, masks; slow near the solution",
        "Buss 2004; Burrell 2016 eq. 11-12",
        search=Length(5000),
    ),
    Row(
        "newton",
        _RULES + "jacobian:Newton",
        "Newton-Raphson, plain or with a line search; stops where the Jacobian has no inverse",
        "square tasks only: as many task rows as joints",
        "Chinyai eq. 6-9",
        search=Length(100),
        one_tip=True,
        moves_all=True,
        tracks=False,
    ),
    Row(
        "ccd",
        _RULES + "ccd:CCD",
        "Cyclic coordinate descent, one joint at a time from the tip",
        "any robot; position exact per joint, pose by least squares per joint",
        "Wang and Chen 1991; Olsen and Petersen 2011",
    ),
    Row(
        "pid",
        _RULES + "pid:PID",
        "IK-PID: each joint's step from a PID law on the error, its sign found by trial",
        "any robot; position, pose with scaled orientation",
        "Burrell 2016, Algorithm I",
    ),
    Row(
        "state-space",
        _RULES + "state_space:StateSpace",
        "A static linear system maps the error to joint increments, no Jacobian",
        "any robot; position (B n x 3) or pose (B n x 6)",
        "Burrell 2016, Algorithm II",
        one_tip=True,
    ),
    Row(
        "sqp",
        _RULES + "sqp:SQP",
        "Sequential quadratic programming: errors in order of priority, with exact second derivatives (option priority)",
        "any robot; pose, masks, several tips; an arm with fewer joints than the target fixes",
        "Nocedal and Wright 2006, ch. 18",
        # First 48 attempts with all errors at one level, if the arm has as many joints as errors, then at most 30 by level.
        search=Length(40, 78, (30.0, 0.18, 100.0, 0.35), 20),
        several=Length(60, 108, (60.0, 0.25, 200.0, 0.4)),
        tracks=False,
        levels=True,
    ),
    Row(
        "planar-2r",
        _CLOSED + "planar_2r:Planar2R",
        "Closed form of a planar two-link arm: both elbow branches; returns the one within limits nearest q0",
        "two revolute joints with parallel axes (recognised by geometry); position",
        "Chinyai eq. 1-5, corrected",
        **_CLOSED_FORM,
        pose=False,
        joints=(2,),
    ),
    Row(
        "inspection",
        _CLOSED + "inspection:Inspection",
        "Closed form of a spherical shoulder on a lift: 8 branches at each lift; returns the one within limits nearest q0",
        "a lift and six revolute joints of the inspection robot's structure (recognised by geometry); pose",
        "Shanmugasundar 2012 eq. 7-13, completed",
        **_CLOSED_FORM,
        position=False,
        joints=(6, 7),
    ),
    Row(
        "elimination",
        _CLOSED + "elimination:Elimination",
        "Every solution by elimination, with a certificate that it is all; returns the one within limits nearest q0",
        "any six revolute joints; pose",
        "Raghavan and Roth 1993; Manocha and Canny 1994",
        **_CLOSED_FORM,
        position=False,
    ),
    Row(
        "eaik",
        _CLOSED + "eaik:EAIK",
        "All solutions of the EAIK package, re-evaluated; returns the one within limits nearest q0",
        "six revolute joints of a structure EAIK decomposes (extra `analytic`); pose",
        "Ostermeier, Kuelz, Althoff 2025",
        **_CLOSED_FORM,
        position=False,
    ),
)
GROUP = "ik_toolkit.solvers"  # group of the entry points by which packages offer solvers
# names have no commas or colons, which commands use in lists and in FILE:CLASS
NAME = re.compile(r"[a-z0-9][a-z0-9_.-]*")
LOG = logging.getLogger("ik_toolkit.solvers")
OWN = ("search", "several", "pose", "position", "one_tip", "moves_all", "tracks")
BY_NAME = {row.name: row for row in ROWS}
GENERAL = ROWS[0].name  # 'auto' takes this solver if no closed form fits.
BY_LEVELS = next(row.name for row in ROWS if row.levels)


def search_for(priority: Any) -> str:
    """Return the name of the general search for a value of the option `priority`."""
    return GENERAL if priority is None else BY_LEVELS


def list_rows() -> tuple[Row, ...]:
    """Return the registry rows of our solvers, then those of other packages."""
    return (*ROWS, *registered().values())


@functools.cache  # the result is cached, because listing installed packages takes milliseconds
def registered() -> dict[str, Row]:
    """Return the registry rows of other packages' solvers by name; unusable ones are left out with a warning."""
    import importlib.metadata

    found: dict[str, tuple[Row, str]] = {}
    refused = set()
    for point in importlib.metadata.entry_points(group=GROUP):
        package = point.dist.name if point.dist is not None else point.value
        try:
            row = _row(point)
        except Exception as error:  # An error in another package must not stop our solvers.
            why = f"{type(error).__name__}: {error}" if not isinstance(error, InvalidOption) else error
            LOG.warning("package %s: solver '%s' is left out: %s", package, point.name, why)
            continue
        if row.name in found:
            LOG.warning(
                "packages %s and %s both register a solver '%s': neither is used",
                *sorted((found[row.name][1], package)),
                row.name,
            )
            refused.add(row.name)
        found[row.name] = replace(row, package=package), package
    return {name: row for name, (row, _) in sorted(found.items()) if name not in refused}


def _row(point: Any) -> Row:
    """Return the row of an entry point. Raises InvalidOption for anything but a row, or an unusable name."""
    row = point.load()
    if not isinstance(row, Row):
        raise InvalidOption(f"{point.value} is a {type(row).__name__}, not a Row of ik_toolkit.solvers.registry")
    if row.name != point.name:
        raise InvalidOption(f"its row has the name '{row.name}'")
    if not NAME.fullmatch(row.name) or row.name == "auto":
        raise InvalidOption(
            "a name must consist of lowercase letters, digits, '-', '_' and '.', and must not be 'auto'"
        )
    if row.name in BY_NAME:
        raise InvalidOption("ik_toolkit already has a solver of that name")
    if row.target.count(":") != 1:
        raise InvalidOption(f"its target '{row.target}' is not MODULE:CLASS")
    # 'auto' is for solvers of this package, because installing another one must not change answers.
    return replace(row, joints=())


def find_row(solver: Any) -> Row:
    """Return the registry row of a solver name, solver class or instance. Raises UnknownSolver with a near match."""
    if isinstance(solver, str):
        if solver in BY_NAME:
            return BY_NAME[solver]
        rows = {row.name: row for row in list_rows()}
        if solver not in rows:
            raise UnknownSolver(f"there is no solver '{solver}'.{near_match(solver, rows)}")
        return rows[solver]
    cls = solver if isinstance(solver, type) else type(solver)
    if hasattr(cls, "loop"):  # the attribute `loop` is set by protocol.rule or protocol.closed_form
        for row in (row for rows in (lambda: ROWS, list_rows) for row in rows()):
            if row.target.split(":")[1] == cls.__name__ and row.load() is cls:
                return row
        return _own(cls)
    if hasattr(cls, "_fields") and hasattr(cls, "step"):
        raise UnknownSolver(f"{cls.__name__} is not marked as a rule: put @ik_toolkit.rule above the class")
    what = f"the class {cls.__name__}" if isinstance(solver, type) else f"{solver!r:.60}"
    names = ", ".join(BY_NAME)
    raise UnknownSolver(f"a solver must be a name, a rule class or an instance of one, not {what}. Available: {names}.")


def _own(cls: type) -> Row:
    """Make a registry row for a user's own solver class, whose class attributes may set the fields of the row."""
    said = {name: getattr(cls, name) for name in OWN if hasattr(cls, name)}
    kind = _CLOSED_FORM if hasattr(cls, "every") else {}
    summary = (cls.__doc__ or cls.__name__).splitlines()[0]
    target = f"{cls.__module__}:{cls.__qualname__}"
    return Row(cls.__name__, target, summary, "a solver of your own", "", **{**kind, **said, "cls": cls})


def solvers_with(parameter: str, known: Iterable[str]) -> str:
    """Return a sentence that names our solvers with this parameter, to end a message with, or ''.

    A parameter that no solver has, and that is like none of the names `known` where it was given, may be another's, misspelled.
    """
    fields = sorted({field for row in ROWS for field in row.load()._fields})
    meant = parameter if parameter in fields or nearest(parameter, known) else nearest(parameter, fields)
    owners = [row.name for row in ROWS if meant in row.load()._fields]
    return f" Solvers with '{meant}': {', '.join(owners)}." if owners else ""


def make_rule(row: Row, parameters: dict[str, Any]) -> Any:
    """Make an instance of the class of a registry row with these parameters. Raises InvalidOption for a wrong one."""
    cls = row.load()
    fields = cls._fields
    for key, value in parameters.items():
        if key not in fields:
            hint = near_match(key, fields) if fields else " It has no parameters."
            raise InvalidOption(f"solver '{row.name}' has no parameter '{key}'.{hint}{solvers_with(key, fields)}")
        if isinstance(value, str) and not isinstance(cls._field_defaults.get(key), str):
            wanted = "true or false" if isinstance(cls._field_defaults.get(key), bool) else "a number or an array"
            raise InvalidOption(f"parameter '{key}' of solver '{row.name}' takes {wanted}, not '{value}'")
        if isinstance(value, float) and value != value:
            raise InvalidOption(f"parameter '{key}' of solver '{row.name}' must be a number, not NaN")
    return cls(**parameters)


def is_solver_file(text: str) -> bool:
    """Return whether a solver is given as FILE.py:CLASS."""
    return ".py:" in text or text.endswith(".py")


def solver_from_file(text: str) -> type:
    """Return the class of FILE.py:CLASS; the file runs like a script, so files beside it can be imported.

    Raises InvalidOption when there is no such file or class, when it does not run, or when the class is not a solver.
    """
    name, _, wanted = text.rpartition(":") if not text.endswith(".py") else (text, "", "")
    path = Path(name).expanduser().resolve()
    if not path.is_file():
        near = near_match(path.name, sorted(one.name for one in path.parent.glob("*.py") if one.is_file()))
        raise InvalidOption(f"solver '{text}': there is no file '{name}'.{near}")
    classes = _classes(path)
    solvers = {key: cls for key, cls in classes.items() if hasattr(cls, "loop")}
    if not wanted:
        raise InvalidOption(f"solver '{text}': name the class: {name}:CLASS.{near_match(path.stem, solvers)}")
    if wanted in solvers:
        return solvers[wanted]
    mark = "a solver is marked by @ik_toolkit.rule or @ik_toolkit.closed_form"
    if wanted in classes:
        raise InvalidOption(f"solver '{text}': the class {wanted} is not a solver; {mark}")
    tail = near_match(wanted, solvers) or f" It defines no solver; {mark}."
    raise InvalidOption(f"solver '{text}': the file has no class '{wanted}'.{tail}")


@functools.cache  # cached, so that each file runs once per process
def _classes(path: Path) -> dict[str, type]:
    """Return the classes that a Python file defines, by name. Raises InvalidOption if it does not run."""
    # The module gets a name of its own, so that a file called numpy.py does not hide that package. The name depends on the content,
    # so that compiled code is found again after the file has moved.
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InvalidOption(f"cannot read '{path}': {error.strerror}") from None
    module_name = f"{path.stem}_{hashlib.sha256(content).hexdigest()[:8]}"
    spec = importlib.util.spec_from_file_location(module_name, path)
    assert spec is not None and spec.loader is not None
    module = sys.modules[module_name] = importlib.util.module_from_spec(spec)
    sys.path.insert(0, str(path.parent))
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:  # SystemExit, because a script may call sys.exit
        del sys.modules[module_name]
        at = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(path)]
        line = getattr(error, "lineno", None) or (at[-1] if at else None)
        where = f", line {line}" if line is not None else ""
        raise InvalidOption(f"{path.name}{where}: {type(error).__name__}: {error}") from error
    finally:
        sys.path.remove(str(path.parent))
    return {k: cls for k, cls in vars(module).items() if isinstance(cls, type) and cls.__module__ == module_name}
