"""Loads a user's solver from a file, given as FILE.py:CLASS."""

import functools
import hashlib
import importlib.util
import sys
import traceback
from pathlib import Path

from ..errors import InvalidOption, near_match


def is_file(text: str) -> bool:
    """Return whether a solver is given as FILE.py:CLASS."""
    return ".py:" in text or text.endswith(".py")


def from_file(text: str) -> type:
    """Return the class of FILE.py:CLASS; the file is run as Python runs a script, so files beside it can be imported.

    Raises InvalidOption if there is no such file or class, if it does not run, or if the class is not a solver.
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


@functools.cache  # The cache makes a file run once per process.
def _classes(path: Path) -> dict[str, type]:
    """Return the classes that a file makes, by name. Raises InvalidOption if it does not run."""
    # The module gets a name of its own, so that a file called as a module (numpy.py) hides nothing.
    # The name depends on the content, so that what was compiled for a file that moved is found again.
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
    except (Exception, SystemExit) as error:  # A script may call sys.exit().
        del sys.modules[module_name]
        at = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(path)]
        line = getattr(error, "lineno", None) or (at[-1] if at else None)
        where = f", line {line}" if line is not None else ""
        raise InvalidOption(f"{path.name}{where}: {type(error).__name__}: {error}") from error
    finally:
        sys.path.remove(str(path.parent))
    return {k: cls for k, cls in vars(module).items() if isinstance(cls, type) and cls.__module__ == module_name}
