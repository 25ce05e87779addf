"""Solvers of other people: rows that other packages register, and a class in a file.

A package registers a solver by an entry point of the group `ik_toolkit.solvers`, named as the solver and leading to its row:

    [project.entry-points."ik_toolkit.solvers"]
    half-step = "my_package.rows:HALF_STEP"

where `my_package/rows.py` imports nothing but `ik_toolkit.solvers.registry` and says HALF_STEP = Row("half-step",
"my_package.half_step:HalfStep", ...). So solvers are listed without importing what solves.
"""

import functools
import hashlib
import importlib.metadata
import importlib.util
import logging
import re
import sys
import traceback
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from ..errors import InvalidOption, near_match
from .registry import BY_NAME, Row

GROUP = "ik_toolkit.solvers"
NAME = re.compile(r"[a-z0-9][a-z0-9_.-]*")  # commands take lists of names with commas, and FILE:CLASS with a colon
LOG = logging.getLogger("ik_toolkit.solvers")


@functools.cache  # once a process: reading what is installed takes some milliseconds
def registered() -> dict[str, Row]:
    """Rows of other packages by name. What is broken is left out, with a warning that names the package."""
    found: dict[str, tuple[Row, str]] = {}
    refused = set()
    for point in importlib.metadata.entry_points(group=GROUP):
        package = point.dist.name if point.dist is not None else point.value
        try:
            row = _row(point)
        except Exception as error:  # whatever somebody else's package does, ours goes on without it
            why = f"{type(error).__name__}: {error}" if not isinstance(error, InvalidOption) else error
            LOG.warning("package %s: solver '%s' is left out: %s", package, point.name, why)
            continue
        if row.name in found:
            LOG.warning(
                "packages %s and %s both register a solver '%s': neither is taken",
                *sorted((found[row.name][1], package)),
                row.name,
            )
            refused.add(row.name)
        found[row.name] = replace(row, package=package), package
    return {name: row for name, (row, _) in sorted(found.items()) if name not in refused}


def _row(point: importlib.metadata.EntryPoint) -> Row:
    """Row of an entry point. Raises InvalidOption for what is no row, or cannot have its name."""
    row = point.load()
    if not isinstance(row, Row):
        raise InvalidOption(f"{point.value} is a {type(row).__name__}, not a Row of ik_toolkit.solvers.registry")
    if row.name != point.name:
        raise InvalidOption(f"its row is called '{row.name}'")
    if not NAME.fullmatch(row.name) or row.name == "auto":
        raise InvalidOption("a name is made of small letters, digits, '-', '_' and '.', and is not 'auto'")
    if row.name in BY_NAME:
        raise InvalidOption("ik_toolkit has a solver of that name")
    if row.target.count(":") != 1:
        raise InvalidOption(f"its target '{row.target}' is not MODULE:CLASS")
    return replace(
        row, joints=()
    )  # 'auto' stands for solvers of this package: installing another must not change answers


# ------------------------------------------------------------------------------------------------------ a class in a file
def is_file(text: str) -> bool:
    """Whether a solver is given as FILE.py:CLASS."""
    return ".py:" in text or text.endswith(".py")


def from_file(text: str) -> type:
    """The class of FILE.py:CLASS, run as Python runs a script: files beside it can be imported.

    Raises InvalidOption when there is no such file or class, when it does not run, or when the class is no solver.
    """
    name, _, wanted = text.rpartition(":") if not text.endswith(".py") else (text, "", "")
    path = Path(name).expanduser().resolve()
    if not path.is_file():
        near = near_match(path.name, _names(path.parent.glob("*.py")))
        raise InvalidOption(f"solver '{text}': there is no file '{name}'.{near}")
    classes = _classes(path)
    solvers = {key: cls for key, cls in classes.items() if hasattr(cls, "loop")}
    if not wanted:
        raise InvalidOption(f"solver '{text}': say which class, {name}:CLASS.{near_match(path.stem, solvers)}")
    if wanted in solvers:
        return solvers[wanted]
    mark = "a solver is marked by @ik_toolkit.rule or @ik_toolkit.closed_form"
    if wanted in classes:
        raise InvalidOption(f"solver '{text}': the class {wanted} is no solver; {mark}")
    tail = near_match(wanted, solvers) or f" It has no solver at all; {mark}."
    raise InvalidOption(f"solver '{text}': the file has no class '{wanted}'.{tail}")


def _names(paths: Iterable[Path]) -> list[str]:
    return sorted(path.name for path in paths)


@functools.cache  # a file is run once a process
def _classes(path: Path) -> dict[str, type]:
    """Classes that a file makes, by name. Raises InvalidOption when it does not run."""
    # A name of its own, so that a file called as a module (numpy.py) hides nothing. It goes by the content, so that what was
    # compiled for a file that moved is found again.
    module_name = f"{path.stem}_{hashlib.sha256(path.read_bytes()).hexdigest()[:8]}"
    spec = importlib.util.spec_from_file_location(module_name, path)
    assert spec is not None and spec.loader is not None
    module = sys.modules[module_name] = importlib.util.module_from_spec(spec)
    sys.path.insert(0, str(path.parent))
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        del sys.modules[module_name]
        at = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(path)]
        line = getattr(error, "lineno", None) or (at[-1] if at else None)
        where = f", line {line}" if line is not None else ""
        raise InvalidOption(f"{path.name}{where}: {type(error).__name__}: {error}") from error
    finally:
        sys.path.remove(str(path.parent))
    return {k: cls for k, cls in vars(module).items() if isinstance(cls, type) and cls.__module__ == module_name}
