"""Presets: named parameters of a solver with the tolerance and iteration limit they are meant for, in TOML files.

A preset file has `solver`, optionally `robot`, `position` and `source`, a table [parameters] (of the solver class) and a table
[options]. Shipped ones are in the folder presets/; `ik tune` writes others.
"""

import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InvalidOption, floats, near_match
from ..files import why_unread, write_whole
from .options import make_options
from .registry import make_rule

FOLDER = Path(__file__).with_name("presets")
LARGEST = 16_000_000  # largest size of a preset file that is read [bytes]


def list_presets(solver: str) -> list[str]:
    """Return the names of the presets (published or tuned parameters) of a solver that come with this package."""
    return sorted(path.stem for path in (FOLDER / solver).glob("*.toml"))


def read_preset(solver: str, name: str | Path) -> dict[str, Any]:
    """Return the content of a preset file: a shipped preset of the solver or, if the name ends in .toml, that file.

    A file may be of any solver if `solver` is "auto". Raises InvalidOption.
    """
    name = str(name)  # the name may be a pathlib.Path
    path = Path(name) if name.endswith(".toml") else FOLDER / solver / f"{name}.toml"
    known = list_presets(solver)
    if not name.endswith(".toml") and name not in known:
        have = ", ".join(sorted(folder.name for folder in FOLDER.iterdir() if folder.is_dir()))
        others = near_match(name, known) or f" These solvers have presets: {have}."
        raise InvalidOption(f"solver '{solver}' has no preset '{name}'.{others} A file ends in .toml")
    try:
        if path.stat().st_size > LARGEST:
            raise InvalidOption(f"preset {name} is too large")
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except InvalidOption:
        raise
    except (OSError, ValueError, RecursionError) as error:  # An integer with thousands of digits raises ValueError.
        raise InvalidOption(f"preset {name} cannot be read: {why_unread(error)}") from None
    tables = ("parameters", "options")
    for key in (key for key, value in content.items() if isinstance(value, dict) and key not in tables):
        raise InvalidOption(f"preset {name} has an unknown table [{key}].{near_match(key, tables)}")
    of = content.get("solver")
    if of is None or solver not in (of, "auto"):
        said = f"is for solver '{of}', not '{solver}'" if of else "does not name its solver"
        raise InvalidOption(f"preset {name} {said}")
    return content


def load_preset(solver: str, name: str | Path, fields: Sequence[str]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the parameters and options of a preset. Raises InvalidOption for a wrong file, field or option."""
    content = read_preset(solver, name)
    values, options = content.get("parameters", {}), content.get("options", {})
    if not isinstance(values, dict) or not isinstance(options, dict):
        raise InvalidOption(f"preset {name}: [parameters] and [options] must be tables")
    for key in values:
        if key not in fields or key == "tuned":
            raise InvalidOption(f"preset {name}: solver '{solver}' has no parameter '{key}'.{near_match(key, fields)}")
    try:
        make_options(options)
    except InvalidOption as error:
        raise InvalidOption(f"preset {name}: {error}") from None
    return values, options


def from_preset(row: Any, name: str | Path, values: dict[str, Any] | None = None) -> Any:
    """Make a solver with the parameters and options of a preset, some parameters (`values`) changed. Raises InvalidOption."""
    cls = row.load()
    made = make_rule(row, values or {})  # raises InvalidOption for a parameter that does not exist
    if cls.preset is None:
        return made._replace(**{**load_preset(row.name, name, cls._fields)[0], **(values or {})})
    return cls.preset(name)._replace(**(values or {}))


def check_starts(solver: str, starts: Any, robot: Any) -> np.ndarray:
    """Check the starts given to a solver; return them as an array (M, n), clipped to the limits. Raises InvalidOption."""
    array = np.atleast_2d(floats(starts, f"{solver}: starts must be numbers", InvalidOption))
    if array.ndim != 2 or array.shape[1] != robot.n or not len(array) or not np.isfinite(array).all():
        raise InvalidOption(
            f"{solver}: starts hold {robot.n} finite values each ({', '.join(robot.joint_names)}), not {array.shape}"
        )
    return np.clip(array, robot.lower, robot.upper)


def write_preset(
    path: Path, solver: str, parameters: dict[str, Any], options: dict[str, Any], about: dict[str, Any]
) -> None:
    """Write the parameters and options of a solver to a preset file, for `--preset FILE` and `preset(FILE)`.

    about: further entries at the top of the file, such as the robot's name. Numbers are written with all their digits.
    """
    lines = [f"solver = {_toml(solver)}", *(f"{key} = {_toml(value)}" for key, value in about.items())]
    for title, table in (("parameters", parameters), ("options", options)):
        lines += ["", f"[{title}]", *(f"{key} = {_toml(value)}" for key, value in table.items() if value is not None)]
    write_whole(path, "\n".join(lines) + "\n")


def _toml(value: Any) -> str:
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        escaped = value.replace("\\", "\\\\").replace('"', '\\"').replace("\n", " ")
        return f'"{escaped}"'
    if isinstance(value, list | tuple):
        inner = ", ".join(_toml(x) for x in value)
        return f"[{inner}]"
    return repr(value)
