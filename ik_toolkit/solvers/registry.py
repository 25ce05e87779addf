"""The registry of solvers, with one row for each; the CLI, `ik solvers`, the docs, the benchmark and contract tests use the rows.

Rows are plain data with dotted names, so that listing them imports neither Pinocchio nor numba. Another package registers a solver
by an entry point of the group `ik_toolkit.solvers`, named as the solver and leading to its row:

    [project.entry-points."ik_toolkit.solvers"]
    half-step = "my_package.rows:HALF_STEP"

where `my_package/rows.py` imports only `ik_toolkit.solvers.rows` and defines
HALF_STEP = Row("half-step", "my_package.half_step:HalfStep", ...). So its solvers are listed without importing the code that
solves.
"""

import functools
import hashlib
import importlib.util
import logging
import os
import re
import sys
import traceback
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..errors import InvalidOption, UnknownSolver, near_match, nearest
from ..files import from_home
from .rows import CLOSED_FORM, ROWS, Row

GROUP = "ik_toolkit.solvers"  # name of the entry-point group in which other installed packages declare solvers
# Solver names may not contain commas or colons: commands read commas as separators of a list, and a colon as FILE:CLASS.
NAME = re.compile(r"[a-z0-9][a-z0-9_.-]*")
LOG = logging.getLogger("ik_toolkit.solvers")
OWN = ("search", "several", "pose", "position", "one_tip", "moves_all", "tracks")
BY_NAME = {row.name: row for row in ROWS}
GENERAL = ROWS[0].name  # 'auto' takes this solver if no closed form fits.
BY_LEVELS = next(row.name for row in ROWS if row.levels)


def search_for(priority: Any) -> str:
    """Return the name of the default iterative solver: 'sqp' if the option `priority` is given, otherwise 'lm'."""
    return GENERAL if priority is None else BY_LEVELS


def list_rows() -> tuple[Row, ...]:
    """Return the registry rows (`Row`) of this package's solvers, then those of solvers in other installed packages."""
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
        raise InvalidOption(f"{point.value} is a {type(row).__name__}, not a Row of ik_toolkit.solvers.rows")
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
    # The solver 'auto' chooses only among solvers of this package, because installing another package must not change answers.
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
    if hasattr(cls, "loop"):  # Every solver class has `loop`, set by its decorator.
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
    kind = CLOSED_FORM if hasattr(cls, "every") else {}
    summary = (cls.__doc__ or cls.__name__).splitlines()[0]
    target = f"{cls.__module__}:{cls.__qualname__}"
    return Row(cls.__name__, target, summary, "a solver of your own", "", **{**kind, **said, "cls": cls})


def solvers_with(parameter: str, known: Iterable[str]) -> str:
    """Return a sentence that names this package's solvers with a parameter of this name, for the end of an error message; or ''.

    If no solver has it, and none of the valid names `known` is similar, the most similar parameter of any solver is taken instead.
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
    """Return whether a text names a solver class in a file, as FILE.py:CLASS, instead of a registered solver."""
    return ".py:" in text or text.endswith(".py")


def solver_from_file(text: str) -> type:
    """Return the class of FILE.py:CLASS; the file runs like a script, so files beside it can be imported.

    Raises InvalidOption when there is no such file or class, when it does not run, or when the class is not a solver.
    """
    name, _, wanted = text.rpartition(":") if not text.endswith(".py") else (text, "", "")
    path = from_home(name).resolve()
    if not os.path.isfile(path):
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
